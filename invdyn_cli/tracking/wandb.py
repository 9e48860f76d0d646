"""Runs in Weights & Biases; offline unless asked for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from invdyn_cli.tracking.contract import AbstractTracker, Tracked


@dataclass(frozen=True)
class Wandb(AbstractTracker):
    """Parameters as config, metrics as summary, losses by epoch, figures and report as an artifact.

    Attributes:
        project: name of the project.
        mode: offline (nothing leaves this machine; `wandb sync` sends it later) or online.
        folder: folder in which wandb keeps its files.
    """

    project: str = "invdyn"
    mode: Literal["offline", "online"] = "offline"
    folder: str = "outputs/wandb"

    library = "wandb"
    extra = "wandb"

    def track(self, run: Tracked) -> None:
        """One wandb run, finished at once."""
        import wandb

        Path(self.folder).mkdir(parents=True, exist_ok=True)
        settings = wandb.Settings(silent=True, console="off")
        with wandb.init(
            project=self.project,
            mode=self.mode,
            dir=self.folder,
            name=run.name,
            config=dict(run.params),
            settings=settings,
        ) as made:
            epochs = max(map(len, run.losses.values()), default=0)
            for epoch in range(epochs):
                made.log({name: float(x[epoch]) for name, x in run.losses.items() if epoch < len(x)}, step=epoch)
            made.summary.update(dict(run.metrics))
            artifact = wandb.Artifact(f"run-{made.id}", type="run")
            for path in run.files:
                artifact.add_file(str(path))
            made.log_artifact(artifact)
        wandb.teardown()  # until then its service may hold what was logged in memory
