"""The better simulation: what a diagnosis found as an MJCF and a URDF, and replayed in MuJoCo beside the log.

Effects and simulation do not know each other; here the one's names and parameters become the other's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli import urdf
from invdyn_cli.diagnosis import known
from invdyn_cli.diagnosis.columns import hold
from invdyn_cli.diagnosis.columns.recording import Recording
from invdyn_cli.effects.composition import changed
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import LogError
from invdyn_cli.interfaces import AbstractBodyEffect, Progress, silent
from invdyn_cli.logfile import Log
from invdyn_cli.maths.pseudo_inertia import realisable
from invdyn_cli.simulation import mjcf
from invdyn_cli.simulation.driven import Stretch
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.replay import Replay
from invdyn_cli.simulation.replay import replay as play
from invdyn_cli.types import Motion, Robot


@dataclass(frozen=True)
class Export:
    """The extended model as text for simulators, and in sentences what each of them lacks; `urdf` is "" for a robot
    that was made from none."""

    mjcf: str
    mjcf_lacks: tuple[str, ...]
    urdf: str
    urdf_lacks: tuple[str, ...]


def hidden_of(model: ExtendedModel) -> tuple[Hidden, ...]:
    """The model's effects as the simulation takes them."""
    joints = model.robot.joints
    return tuple(
        Hidden(one.effect.name, None if one.joint is None else joints[one.joint], one.parameters)
        for one in model.acting
    )


def exported(model: ExtendedModel) -> Export:
    """The model as MJCF and URDF."""
    text, lacks = urdf_of(model) if model.robot.urdf else ("", ())
    return Export(*mjcf.written(_bare(model.robot), hidden_of(model)), text, lacks)


def _bare(robot: Robot) -> Robot:
    """The robot without what <dynamics> tags say: a diagnosis does not count on them, and finds all friction anew."""
    return replace(robot, damping=np.zeros(robot.dofs), friction=np.zeros(robot.dofs))


def urdf_of(model: ExtendedModel) -> tuple[str, tuple[str, ...]]:
    """The robot's URDF with other inertials, damping and friction, and what it does not hold.

    Damping and friction are those that were found, whatever the file said before. A moving link's change stands on its
    own <inertial>, also where the robot's row is the sum of several links that are fixed to each other.
    """
    robot, said = model.robot, []
    bodies = [x for x in model.acting if isinstance(x.effect, AbstractBodyEffect)]
    still = Motion(*np.zeros((3, robot.dofs, 1)))
    heavier, _ = changed(robot, bodies, still)
    change, links = {}, urdf.moving_links(robot.urdf, robot.joints)
    for link, old, new in zip(links, np.asarray(robot.inertial), np.asarray(heavier.inertial), strict=True):
        if np.array_equal(old, new):
            continue
        real = realisable(new)
        if not np.allclose(real, new, rtol=1e-9, atol=0):
            said.append(f"{link}: its inertials are not of a real body; the nearest ones of one are written")
        change[link] = real - old
    numbers = {x: [0.0, 0.0] for x in robot.joints}
    for one in model.acting:
        joint = "" if one.joint is None else robot.joints[one.joint]
        held = _put(numbers.get(joint, [0.0, 0.0]), one.effect.name, one.parameters)
        if one.effect.name == "base_tilt":
            gravity = ",".join(f"{x:.5g}" for x in np.asarray(heavier.gravity))
            held = f"is left out: a URDF has no gravity; load it with robot.gravity=[{gravity}]"
        if held:
            said.append(f"{joint or 'whole arm'}: {one.effect.title} {held}")
    text, refused = urdf.with_changes(robot.urdf, change, {x: (a, b) for x, (a, b) in numbers.items()})
    return text, (*said, *refused)


def _put(numbers: list[float], effect: str, p) -> str:
    """Add an effect to a joint's damping and friction, in place; what is not held of it, "" if it is held."""
    match effect:
        case "viscous_friction":
            numbers[0] += float(p["damping"])
        case "thermal_friction_drift":
            numbers[0] += float(p["warm"])
            return f"is held warm, damping {p['warm']:.3g}"
        case "coulomb_friction":
            numbers[1] += float(p["coulomb"])
        case "asymmetric_coulomb_friction":
            numbers[1] += float(p["positive"] + p["negative"]) / 2
            return f"is held by the mean of both ways, {(p['positive'] + p['negative']) / 2:.3g}"
        case "stribeck_friction" | "presliding_hysteresis":
            numbers[1] += float(p["coulomb"])
            return f"is held by its level at speed, {p['coulomb']:.3g}"
        case "payload" | "link_inertia_error" | "base_tilt":
            pass  # an inertial, or told apart
        case _:
            return "is left out: a URDF has no place for it"
    return ""


def stretches_of(log: Log, robot: Robot, recording: Recording, lead: float) -> list[Stretch]:
    """What a replay starts from: the pieces that chose nothing, or all where none judges.

    Args:
        log: says whether gravity was taken out of its torques already; it is put back.
        robot: the nominal one.
        recording: as prepared, nothing else taken out.
        lead: [s] by which torques lead the motion, taken out here.
    """
    whole, _ = known.taken_out(recording, robot, (), gravity="gravity" in log.compensated)
    pieces = [p for p in whole.pieces if p.role == "test"] or [p for p in whole.pieces if p.role == "train"]
    moved = hold.moved(replace(whole, pieces=tuple(pieces)), lead)
    return [Stretch(p.trajectory, p.t, p.q.T, p.qd.T, p.tau.T) for p in moved.pieces]


def why_not(log: Log) -> str:
    """Why a log cannot be replayed, "" if it can."""
    if log.torque_side == "link":
        return "its torques were taken behind the gears, and what the motors gave is not known"
    if log.torque_unit != "N m":
        return "its torques are currents, and their drive gains are not known"
    return ""


def replayed(model: ExtendedModel, stretches: Sequence[Stretch], progress: Progress = silent) -> Replay:
    """The nominal and the extended arm beside the log.

    Raises:
        LogError: if no stretch is long enough, or MuJoCo refuses the arm.
    """
    before, _ = mjcf.written(_bare(model.robot))
    after, lacks = mjcf.written(_bare(model.robot), hidden_of(model))
    try:
        return play(before, after, stretches, model.robot.joints, not_held=lacks, progress=progress)
    except ValueError as error:
        raise LogError(f"MuJoCo refuses the arm: {error}") from error
