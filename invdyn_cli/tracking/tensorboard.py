"""Runs as TensorBoard's event files."""

from dataclasses import dataclass
from pathlib import Path

from invdyn_cli.tracking.contract import AbstractTracker, Tracked


@dataclass(frozen=True)
class Tensorboard(AbstractTracker):
    """Parameters as text, metrics and losses by epoch as scalars, figures as images.

    Attributes:
        folder: folder that gets a subfolder for each run; `tensorboard --logdir` takes it.
    """

    folder: str = "outputs/tensorboard"

    library = "tensorboardX"
    extra = "tensorboard"

    def track(self, run: Tracked) -> None:
        """One event file."""
        from matplotlib.image import imread
        from tensorboardX import SummaryWriter

        with SummaryWriter(logdir=str(Path(self.folder) / run.name)) as writer:
            writer.add_text("params", "\n".join(f"    {name}: {value}" for name, value in run.params.items()))
            for name, value in run.metrics.items():
                writer.add_scalar(name, value, 0)
            for name, curve in run.losses.items():
                for epoch, value in enumerate(curve):
                    writer.add_scalar(name, float(value), epoch)
            for path in run.files:
                if path.suffix == ".png":
                    writer.add_image(path.stem, imread(path)[..., :3], dataformats="HWC")
