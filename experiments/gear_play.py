"""What gear play looks like: the residual of three arms, filtered at 40 Hz (gear_play.md)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from experiments.cases import draw_effect, draw_scene, felt, inverse_dynamics, play
from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.report.canvas import BLUE, VERMILLION, house_style

JOINTS = (3, 5, 7)
SHOWN = 6.0
"""[s] that are drawn."""
NEAR = 0.1
"""[s] around a zero of the load."""


@dataclass(frozen=True)
class Shown:
    """One arm: joint, gap [rad], t (T,) [s], residual and load (T,) [N m] at 40 Hz."""

    said: str
    gap: float
    t: np.ndarray
    residual: np.ndarray
    load: np.ndarray

    def __post_init__(self) -> None:
        for name in ("t", "residual", "load"):  # rows that were kept hold tuples
            object.__setattr__(self, name, np.asarray(getattr(self, name)))

    @property
    def zeros(self) -> np.ndarray:
        """Times [s] at which the load changes sign."""
        return self.t[:-1][np.diff(np.sign(self.load)) != 0]

    @property
    def near(self) -> tuple[float, float]:
        """Share of the residual's power within NEAR of a zero of the load, and share of the time."""
        close = np.min(np.abs(self.t[:, None] - self.zeros[None]), axis=1) < NEAR
        return float(np.sum(self.residual[close] ** 2) / np.sum(self.residual**2)), float(close.mean())


def shown(seed: int, joints: int) -> Shown:
    """An arm with play in a gear whose load changes sign, and what its nominal model leaves."""
    draw = np.random.default_rng([23, seed, joints])
    while True:
        scene = draw_scene(draw, joints)
        low, high = np.quantile(scene.tau, [0.1, 0.9], axis=0)
        fitting = [j for j in felt(scene, "backlash") if low[j] < 0 < high[j]]
        if fitting:
            break
    joint = int(draw.choice(fitting))
    hidden = draw_effect(draw, scene, "backlash", joint)
    case = play(draw, scene, [hidden])
    raw, rate = case.log.trajectories[0], case.log.rate
    sections = butter(4, 40.0, fs=rate, output="sos")
    q, tau = (sosfiltfilt(sections, x, axis=0) for x in (raw.q, (raw.tau + np.roll(raw.tau, 1, axis=0)) / 2))
    spline = make_interp_spline(raw.t, q, k=5)
    rows = slice(400, -400, 4)
    motion = [f(raw.t[rows]) for f in (spline, spline.derivative(1), spline.derivative(2))]
    load = inverse_dynamics(scene.robot, *motion)[:, joint]
    said = f"{case.said}, {hidden.joint}: play of {1e3 * hidden.parameters['gap']:.2g} mrad"
    return Shown(said, hidden.parameters["gap"], raw.t[rows], tau[rows, joint] - load, load)


def drawn(arms: Sequence[Shown]) -> Figure:
    """Residual and zeros of the load, a panel an arm."""

    with house_style():
        figure = Figure(figsize=(9, 2.3 * len(arms)), layout="constrained")
        for axes, arm in zip(np.atleast_1d(figure.subplots(len(arms), 1)), arms, strict=True):
            middle = arm.zeros[len(arm.zeros) // 2]
            rows = np.abs(arm.t - middle) < SHOWN / 2
            for k, zero in enumerate(arm.zeros[np.abs(arm.zeros - middle) < SHOWN / 2]):
                axes.axvline(zero, color=VERMILLION, lw=1.2, ls="--", label=None if k else "the load changes sign")
            axes.plot(arm.t[rows], arm.residual[rows], color=BLUE, label="logged less nominal torque, 40 Hz")
            axes.set_title(arm.said)
            axes.set_ylabel("residual [N m]")
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        axes.set_xlabel("t [s]")
    return figure


@dataclass(frozen=True)
class GearPlay(AbstractExperiment):
    """Three arms with play in one gear and nothing else."""

    row: ClassVar[type] = Shown

    seed: int = 0

    def plan(self, rows: Sequence[Shown]) -> Iterable[tuple]:
        """A job per arm: the seed and the number of joints."""
        return [(self.seed, joints) for joints in JOINTS]

    def run(self, folder: Path, seed: int, joints: int) -> Iterable[Shown]:
        """Draw and play one arm."""
        yield shown(seed, joints)

    def line(self, row: Shown) -> str:
        """The arm."""
        return row.said

    def table(self, rows: Sequence[Shown]) -> str:
        """A line per arm: how much of the residual's power is near zeros of the load."""
        shares = [tuple(100 * x for x in row.near) for row in rows]
        return "\n".join(
            f"{row.said}: {power:.0f} % of the residual's power in the {time:.0f} % of the time near zeros"
            for row, (power, time) in zip(rows, shares, strict=True)
        )

    def figures(self, rows: Sequence[Shown]) -> Mapping[str, Figure]:
        """Residual and zeros of the load, a panel an arm."""
        return {"gear_play": drawn(rows)}
