"""No tracker: results are in the run's folder alone."""

from dataclasses import dataclass

from invdyn_cli.tracking.contract import AbstractTracker, Tracked


@dataclass(frozen=True)
class Nothing(AbstractTracker):
    """Hands nothing on."""

    def track(self, run: Tracked) -> None:
        """Nothing."""
