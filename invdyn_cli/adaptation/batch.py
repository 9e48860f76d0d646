"""adaptation=batch: learn once, then change nothing (paper, section V-B)."""

from dataclasses import dataclass

from invdyn_cli.adaptation.own_fit import AbstractOwnFit
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.types import Array, Motion, PyTree


@dataclass(frozen=True)
class Batch(AbstractOwnFit):
    """The model as it was fitted; new samples change nothing."""

    adapts = False

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state as it was."""
        return state
