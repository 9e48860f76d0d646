"""A learned model in the control loop of the simulated arm: how closely it follows, and how much feedback that takes.

    tau = tau_FF(q_d, qd_d, qdd_d) + Kp e + Kd ed,   e = q_d - q                      (paper, equations 2 to 4)

A simulated arm (data=pick_place) does its task with feedback of several gains, without and with the object. The
feedforward is zero, the model learned without the object, or the adapting model. Velocities are difference quotients of
the measured angles after a first-order low-pass filter. No files, no config, no printing.
"""

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from invdyn_cli.data.tasks import AbstractTaskSource, Task
from invdyn_cli.errors import UsageError
from invdyn_cli.experiment import Stage
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, silent
from invdyn_cli.maths.metrics import rms
from invdyn_cli.maths.regression import torque_spread
from invdyn_cli.online import Online, online
from invdyn_cli.simulation.arm import quiet
from invdyn_cli.simulation.closed_loop import ClosedLoop
from invdyn_cli.simulation.plant import USUAL
from invdyn_cli.types import Motion, Robot

ALONE, LEARNED, ADAPTED = "feedback alone", "as learned", "adapted"
"""Kinds of feedforward."""

KIND_WORDS = {ALONE: "feedback alone", LEARNED: "not adapted", ADAPTED: "adapted"}
"""What tables and figures call them."""

LOOK_EVERY = 50
"""Ticks between two checks of whether the arm is still under control."""


@dataclass(frozen=True)
class Sweep:
    """The feedback, and what it is tried on.

    Attributes:
        gains: [1/rad] gains to try: Kp of a joint is a gain times the standard deviation of its training torque.
        damping_time: [s] Kd / Kp.
        velocity_cutoff: [Hz] cut-off of the first-order low-pass filter on the measured velocity.
        settle: [s] time for which the loop holds the first posture before the task begins and counts.
        largest_error: [rad] tracking error at which the arm counts as out of control and is stopped.
        repetitions: repetitions of the task for each gain, feedforward and object.
    """

    gains: Sequence[float] = (100.0, 50.0, 25.0, 12.5, 6.25)
    damping_time: float = 0.1
    velocity_cutoff: float = 25.0
    settle: float = 1.0
    largest_error: float = 2.0
    repetitions: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "gains", tuple(self.gains))
        for name, good, allowed in (
            (
                "gains",
                len(self.gains) > 0 and all(0 < x < np.inf for x in self.gains),
                "a list of numbers above 0 /rad",
            ),
            ("gains", len(set(self.gains)) == len(self.gains), "each gain once"),
            ("damping_time", 0 <= self.damping_time < np.inf, "from 0 s"),
            ("velocity_cutoff", self.velocity_cutoff > 0, "above 0 Hz"),
            ("settle", 0 <= self.settle <= 60, "0 to 60 s"),
            ("largest_error", self.largest_error > 0, "above 0 rad"),
            ("repetitions", isinstance(self.repetitions, int) and self.repetitions >= 1, "a whole number from 1"),
        ):
            if not good:
                got = getattr(self, name)
                raise UsageError(f"{name}={list(got) if isinstance(got, tuple) else got}; allowed: {allowed}")


@dataclass(frozen=True)
class Case:
    """One run of the arm.

    Attributes:
        gain: [1/rad].
        loaded: whether with the object.
        kind: of the feedforward.
        repetition: from 1.
        error, peak: (n,) [deg] RMS and largest of q_d - q, of the measured angles.
        stages: name -> (n,) [deg] RMS.
        feedback, torque: (n,) [N m] RMS of the feedback's torque, and of the whole.
        tick: [s] of computing the feedforward and learning, median and 99 % over ticks.
        failed: a sentence where the arm went out of control, and there are no numbers; else "".
    """

    gain: float
    loaded: bool
    kind: str
    repetition: int
    error: np.ndarray
    peak: np.ndarray
    stages: Mapping[str, np.ndarray]
    feedback: np.ndarray
    torque: np.ndarray
    tick: tuple[float, float]
    failed: str = ""

    @property
    def rms(self) -> float:
        """[deg] over time and joints."""
        return float(rms(self.error))

    @property
    def share(self) -> float:
        """Feedback torque over total torque, RMS each, mean over joints."""
        return float(np.mean(self.feedback / self.torque))


@dataclass(frozen=True)
class ControlRecord:
    """All runs of a sweep and their settings; spread (n,) [N m] is the standard deviation of the training torques."""

    joints: tuple[str, ...]
    spread: np.ndarray
    sweep: Sweep
    cases: tuple[Case, ...]
    warnings: tuple[str, ...]
    seconds: Mapping[str, float]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of feedforward that were tried."""
        return tuple(dict.fromkeys(x.kind for x in self.cases))

    def runs(self, gain: float, loaded: bool, kind: str) -> list[Case]:
        """Repetitions of one and the same."""
        return [x for x in self.cases if (x.gain, x.loaded, x.kind) == (gain, loaded, kind)]

    def rms(self, gain: float, loaded: bool, kind: str) -> float:
        """[deg] over repetitions, time and joints; NaN where one of them went out of control."""
        return float(np.sqrt(np.mean([x.rms**2 for x in self.runs(gain, loaded, kind)])))

    def share(self, gain: float, loaded: bool, kind: str) -> float:
        """Feedback's share of the torque, mean over repetitions and joints."""
        return float(np.mean([x.share for x in self.runs(gain, loaded, kind)]))


def run(
    source: AbstractTaskSource,
    model: AbstractModel,
    adaptation: AbstractAdapter,
    robot: Robot,
    sweep: Sweep,
    *,
    seed: int = 0,
    stage: Stage = lambda name: silent,
) -> ControlRecord:
    """Learn from the task without the object, then control the arm.

    Raises:
        UsageError: for an arm with sliding joints, thinned samples, or a filter beyond what the rate allows.
    """
    if any(robot.prismatic):
        raise UsageError(
            f"control of {robot.name}, which has prismatic joints; allowed: arms with revolute joints only"
        )
    if source.decimate != 1:
        got = f"data.decimate={source.decimate}"
        raise UsageError(f"{got}; allowed here: 1, because the loop runs at {source.rate:g} Hz")
    if not sweep.velocity_cutoff < source.rate / 2:
        raise UsageError(
            f"velocity_cutoff={sweep.velocity_cutoff:g}; allowed: above 0 and below {source.rate / 2:g} Hz"
        )
    started = time.perf_counter()
    model = adaptation.extended(model)
    splits = source.load(robot, stage("data"))
    learning = time.perf_counter()
    fit = adaptation.fit(
        model, splits.train, jax.random.key(seed), validation=splits.validation, progress=stage("learn")
    )
    learned, spread, cases = time.perf_counter(), torque_spread(splits.train), []
    ticking = online(adaptation, model, fit, rate=source.rate, cutoff=source.filter_cutoff, order=source.filter_order)
    kinds = (ALONE, LEARNED, ADAPTED) if adaptation.adapts else (ALONE, LEARNED)
    progress = stage("control")
    wanted = list(itertools.product((False, True), range(sweep.repetitions), sweep.gains, kinds))
    with quiet():
        for loaded, k, gain, kind in wanted:
            task = source.trial(robot, k, loaded=loaded)
            desired = task.motion(robot, source.rate)
            if kind == ADAPTED:
                feedforward = Learner(ticking, desired, source.torque_lag)
            else:
                feedforward = Table(model.predict(fit, desired) if kind == LEARNED else np.zeros_like(desired.q))
            loop = _arm(robot, task, sweep, source)
            cases.append(_measured(loop, task, desired, feedforward, gain, spread, sweep, (loaded, kind, k + 1)))
            progress(len(cases) / len(wanted), f"{cases[-1].rms:.3g} deg at {gain:g} /rad, {KIND_WORDS[kind]}")
    return ControlRecord(
        joints=robot.joints,
        spread=spread,
        sweep=sweep,
        cases=tuple(cases),
        warnings=fit.warnings,
        seconds={
            "data": learning - started,
            "fit": learned - learning,
            "control": time.perf_counter() - learned,
            "total": time.perf_counter() - started,
        },
    )


class Table:
    """A feedforward that was computed in advance: tau (T, n)."""

    def __init__(self, tau: np.ndarray) -> None:
        self._tau = tau

    def torque(self, row: int, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """(n,) for a row of the reference."""
        return self._tau[row]


class Learner:
    """A feedforward that learns from the angles and torques so far. It is mutable and used for one run.

    Args:
        ticking: the model and its adapter, tick by tick.
        desired: the reference (T, n).
        lag: samples by which the torque is older than the angles that it is paired with.
    """

    def __init__(self, ticking: Online, desired: Motion, lag: int) -> None:
        self._ticking, self._desired, self._lag, self._state = ticking, desired, lag, None

    def torque(self, row: int, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """(n,) for a row of the reference.

        Args:
            row: the row.
            q: (k + 1, n) measured angles until now.
            tau: (k, n) torques until now.
        """
        if not self._lag:  # the torque that goes with the last angles is the one that is asked for
            q = q[:-1]
        of = max(len(q) - 1 - self._lag, 0)
        if self._state is None:
            self._state = self._ticking.init(q[-1], tau[of])
        desired = Motion(self._desired.q[row], self._desired.qd[row], self._desired.qdd[row])
        self._state, said = self._ticking.step(self._state, q[-1], tau[of], desired)
        return np.asarray(said)


def _arm(robot: Robot, task: Task, sweep: Sweep, source: AbstractTaskSource) -> ClosedLoop:
    """The arm of a repetition, held at its first posture by the simulation's own controller."""
    rate = source.rate
    held = round(USUAL.settle * rate)
    before = held + round(sweep.settle * rate)
    how = {"noise": task.noise, "rate": rate, "seed": task.seed, "torque_side": source.torque_side, "name": task.name}
    loop = ClosedLoop(robot, task.hidden, samples=round(task.duration * rate), before=before, **how)
    loop.hold(USUAL, task.motion(robot, rate), held)
    return loop


def _measured(
    loop: ClosedLoop,
    task: Task,
    desired: Motion,
    feedforward: Table | Learner,
    gain: float,
    spread: np.ndarray,
    sweep: Sweep,
    what: tuple[bool, str, int],
) -> Case:
    """The task in closed loop, from the posture in which the arm is held."""
    stiffness = gain * spread
    damping, follow = stiffness * sweep.damping_time, 1 - np.exp(-2 * np.pi * sweep.velocity_cutoff / loop.rate)
    goal, goal_qd = np.asarray(desired.q), np.asarray(desired.qd)
    ticks, n = loop.commands.shape
    q, tau, back = np.full((3, ticks, n), np.nan)
    took, failed = np.zeros(ticks), ""
    first = loop.tick
    q[first - 1] = last = loop.measure()
    tau[first - 1] = loop.logged(loop.commands[first - 1])
    velocity = np.zeros(n)
    for tick in range(first, ticks):
        row = max(loop.sample, 0)
        q[tick] = loop.measure()
        velocity += follow * ((q[tick] - last) * loop.rate - velocity)
        last = q[tick]
        if not tick % LOOK_EVERY and (failed := loop.lost(goal[row] - last, sweep.largest_error)):
            break
        started = time.perf_counter()
        ahead = feedforward.torque(row, q[first - 1 : tick + 1], tau[first - 1 : tick])
        took[tick] = time.perf_counter() - started
        if not np.isfinite(ahead).all():
            joint = loop.robot.joints[int(np.argmin(np.isfinite(ahead)))]
            failed = f"at {loop.sample / loop.rate:.2f} s the feedforward of {joint} is not finite: learning diverged"
            break
        back[tick] = stiffness * (goal[row] - last) + damping * (goal_qd[row] - velocity)
        loop.apply(ahead + back[tick])
        tau[tick] = loop.logged(loop.drive.felt if loop.drive.sense else loop.commands[tick])
    counted = slice(loop.before, None)
    error = np.rad2deg(goal - q[counted])
    stage = task.stages(np.arange(len(goal)) / loop.rate)
    loaded, kind, repetition = what
    return Case(
        gain=gain,
        loaded=loaded,
        kind=kind,
        repetition=repetition,
        error=rms(error),
        peak=np.abs(error).max(axis=0),
        stages={name: rms(error[stage == name]) for name in dict.fromkeys(stage.tolist())},
        feedback=rms(back[counted]),
        torque=rms(loop.commands[counted]) if not failed else np.full(n, np.nan),
        tick=(float(np.percentile(took[counted], 50)), float(np.percentile(took[counted], 99))),
        failed=failed,
    )
