"""The arm that replaces the real one: a reference, hidden effects and sensors give a trajectory of a log.

At t the log has the measurement of the controller, and the torque that it commands from then on, held until the next
tick (zero-order hold): a torque is on average half a tick later than its t.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np

from invdyn_cli.errors import UsageError, listed
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.simulation.arm import quiet
from invdyn_cli.simulation.closed_loop import EXACT, ClosedLoop
from invdyn_cli.simulation.control import Control, commissioned
from invdyn_cli.simulation.events import refuse_outside, refuse_trajectory
from invdyn_cli.simulation.hidden import Hidden, refuse
from invdyn_cli.simulation.references import AbstractReference
from invdyn_cli.simulation.sensors import SIDES, Noise, Side, stepped
from invdyn_cli.types import Motion, Robot

SOURCE = f"simulated arm (invdyn, MuJoCo {mujoco.__version__})"
USUAL = Control()
LOOK_EVERY = 50
"""Ticks between two checks of whether the arm is still under control."""


def simulate(
    robot: Robot,
    reference: AbstractReference,
    hidden: Sequence[Hidden] = (),
    *,
    noise: Noise = EXACT,
    duration: float = 60.0,
    rate: float = 1000.0,
    substeps: int = 4,
    control: Control = USUAL,
    seed: int = 0,
    torque_side: Side = "command",
    position_side: str = "unknown",
    link_encoder: bool = False,
    name: str = "trajectory_1",
    progress: Progress = silent,
) -> RawTrajectory:
    """One recording of the arm with these effects hidden in it.

    Args:
        robot: what everybody believes the arm to be.
        reference: what it shall do.
        hidden: what is different about it.
        noise: of the sensors.
        duration: [s].
        rate: [Hz] of the controller and the log.
        substeps: steps of the physics per tick.
        control: the controller.
        seed: of the reference and the noise.
        torque_side: what is logged as torque, see `sensors.Side`.
        position_side: "link": the links' angles are logged; else the motors', which the controller sees in any case.
        link_encoder: log the links' angles as well, beside the motors' (position_side="motor").
        name: the trajectory's.

    Raises:
        UsageError: for effects that cannot be built, numbers out of range, or an arm that goes out of control.
    """
    refuse_clock(duration, rate, substeps)
    if torque_side not in SIDES:
        raise UsageError(f"torque_side={torque_side!r}; allowed: {listed(SIDES)}")
    for sensor in fields(noise):
        noise.of(sensor.name, robot.dofs)
    refuse_link_encoder(link_encoder, position_side)
    refuse_events(hidden, duration)
    wanted = reference.motion(robot, duration, rate, seed)
    how = {"noise": noise, "rate": rate, "substeps": substeps, "seed": seed, "torque_side": torque_side, "name": name}
    loop = ClosedLoop(robot, hidden, samples=len(wanted), before=round(control.settle * rate), **how)
    with quiet():
        logged = _run(loop, wanted, control, name, position_side == "link", progress)
    t = np.arange(len(wanted)) / rate
    tau = loop.logged(logged["link" if torque_side == "link" else "tau"])
    qd = None
    if noise.velocity is not None:
        qd = logged["qd"] + loop.noises.normal(size=tau.shape) * noise.of("velocity", robot.dofs)
    return RawTrajectory(
        name=name,
        t=t,
        q=logged["q"],
        tau=tau,
        qd=qd,
        q_ref=np.asarray(wanted.q),
        q_link=_second_encoder(logged["q_link"], noise, seed) if link_encoder else None,
        notes="; ".join(loop.arm.notes),
    )


def record(
    robot: Robot,
    references: Sequence[AbstractReference],
    hidden: Sequence[Hidden] = (),
    *,
    rate: float = 1000.0,
    torque_side: Side = "command",
    position_side: str = "unknown",
    urdf: str = "",
    seed: int = 0,
    progress: Progress = silent,
    **options: Any,
) -> Log:
    """A log of one recording for every reference: trajectory_1, trajectory_2, ... with seeds from `seed` on.

    `urdf` is the path that the log names; `options` are those of `simulate`. Positions are the same on both sides of
    the gear as long as nothing yields.
    """
    refuse_events(hidden, options.get("duration", 60.0), [f"trajectory_{i + 1}" for i in range(len(references))])
    trajectories = []
    for i, reference in enumerate(references):
        share = _between(progress, i / len(references), (i + 1) / len(references))
        name = f"trajectory_{i + 1}"
        how = {"rate": rate, "torque_side": torque_side, "seed": seed + i, "name": name, "progress": share}
        trajectories.append(simulate(robot, reference, hidden, position_side=position_side, **how, **options))
    return Log(
        robot=robot.name,
        joints=robot.joints,
        torque_side=torque_side,
        torque_unit="N m",
        rate=rate,
        trajectories=tuple(trajectories),
        urdf=urdf,
        source=SOURCE,
        position_side=position_side,
    )


MOST_SAMPLES, MOST_SUBSTEPS = 5_000_000, 1000
"""Samples of a log (83 minutes at 1 kHz; 2 GB for seven joints), and physics steps for each (0.1 us at 10 kHz)."""


def refuse_clock(duration: float, rate: float, substeps: int) -> None:
    """Raise a UsageError for a recording that cannot be made."""
    if not (np.isfinite(rate) and rate > 0 and np.isfinite(duration) and duration * rate >= 2):
        raise UsageError(f"duration={duration} s at rate={rate} Hz; allowed: both above 0, two samples or more")
    if duration * rate > MOST_SAMPLES:
        raise UsageError(
            f"{duration} s at {rate} Hz are {duration * rate:.3g} samples; allowed: up to {MOST_SAMPLES:.0e}"
        )
    if not (isinstance(substeps, int) and 1 <= substeps <= MOST_SUBSTEPS):
        raise UsageError(f"substeps={substeps}; allowed: a whole number from 1 to {MOST_SUBSTEPS}")


def refuse_link_encoder(link_encoder: bool, position_side: str) -> None:
    """Raise a UsageError for a link encoder if the logged angles are not those of the motors."""
    if link_encoder and position_side != "motor":
        got = f"link_encoder=True with position_side={position_side}"
        raise UsageError(f"{got}; allowed: position_side=motor, where q is the motor's angle and q_link the link's")


def refuse_events(hidden: Sequence[Hidden], duration: float, names: Sequence[str] | None = None) -> None:
    """Raise a UsageError for events after the end of a recording [s], or in others than `names`."""
    for one in hidden:
        if "window" in one.parameters:
            refuse(one)
            refuse_outside(one.effect, float(one.parameters["window"][1]), duration)
            if names is not None:
                refuse_trajectory(one.effect, one.parameters.get("trajectory"), names)


def _second_encoder(q: np.ndarray, noise: Noise, seed: int) -> np.ndarray:
    """Link angles (T, n) as measured by a separate encoder with the same noise as the motors'."""
    n = q.shape[1]
    measured = q + np.random.default_rng([seed, 2]).normal(size=q.shape) * noise.of("position", n)
    return stepped(measured, noise.of("position_quantum", n))


def _run(
    loop: ClosedLoop, wanted: Motion, control: Control, name: str, link: bool, progress: Progress
) -> Mapping[str, np.ndarray]:
    """The control loop: measured "q", true "qd" (of the links if `link`), the links' true "q_link", commanded "tau" and
    "link" torque, (T, n) each."""
    goal, drive = np.asarray(wanted.q), loop.drive
    samples, n = goal.shape
    q, qd, q_link, felt = np.empty((4, samples, n))
    controller = commissioned(control, loop.robot, loop.made, wanted, loop.rate, loop.step)
    loop.start(goal[0])
    ticks = len(loop.commands)
    for tick in range(ticks):
        k = loop.sample
        measured = loop.measure()
        if k >= 0:
            q_link[k], qd[k] = drive.q(link=True), drive.qd(link=link)
            q[k] = loop.measure(link=True) if link else measured
        if not tick % LOOK_EVERY:
            if why := loop.lost(goal[max(k, 0)] - measured, control.largest_error):
                advice = "smaller hidden effects, a slower reference, or another control.frequency"
                raise UsageError(f"{name}: {why}", advice=advice)
            progress(tick / ticks, f"{max(k, 0) / loop.rate:.0f} s of {name}")
        loop.apply(controller.torque(max(k, 0), measured))
        if k >= 0 and drive.sense:
            felt[k] = drive.felt
    progress(1.0, name)
    return {"q": q, "qd": qd, "q_link": q_link, "tau": loop.commands[loop.before :], "link": felt}


def _between(progress: Progress, start: float, end: float) -> Progress:
    return lambda done, note: progress(start + (end - start) * done, note)
