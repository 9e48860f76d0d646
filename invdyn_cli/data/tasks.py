"""Sources whose arm does a task without and with an object: what `invdyn control` needs of them beside their data."""

import abc
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from invdyn_cli.interfaces import AbstractSource
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import AbstractReference
from invdyn_cli.simulation.sensors import Noise, Side
from invdyn_cli.types import Motion, Robot


@dataclass(frozen=True)
class Task:
    """One repetition before it is simulated: the reference and everything that is hidden in the arm.

    Attributes:
        name: the trajectory's.
        reference: the motion, drawn by `seed`.
        duration: [s].
        seed: of the motion and the noise.
        hidden: in the arm, the object with its window among it.
        noise: of the sensors.
        begins: [s] when each stage does, in time, the first at 0.
    """

    name: str
    reference: AbstractReference
    duration: float
    seed: int
    hidden: tuple[Hidden, ...]
    noise: Noise
    begins: Mapping[str, float]

    def motion(self, robot: Robot, rate: float) -> Motion:
        """The motion (T, n) at `rate` [Hz]."""
        return self.reference.motion(robot, self.duration, rate, self.seed)

    def stages(self, t: np.ndarray) -> np.ndarray:
        """Name of the stage at each t (T,) [s]."""
        return np.array(list(self.begins))[np.searchsorted(list(self.begins.values()), t, side="right") - 1]


class AbstractTaskSource(AbstractSource):
    """A source that can draw more repetitions of its task than its data have.

    Attributes:
        rate: [Hz] of the samples, and of a loop that controls the arm.
        torque_side: where the torque is measured.
        filter_cutoff, filter_order, causal, torque_lag, decimate: as in data=real_log; control asks for causal ones.
        seed: of all that is drawn.
    """

    rate: float
    torque_side: Side
    filter_cutoff: float | None
    filter_order: int
    causal: bool
    torque_lag: int
    decimate: int
    seed: int

    @abc.abstractmethod
    def trial(self, robot: Robot, number: int, *, loaded: bool) -> Task:
        """A repetition, from 0, that is not in the data, without the object or with it."""
