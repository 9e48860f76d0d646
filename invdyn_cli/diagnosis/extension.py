"""The better simulation: the findings as an MJCF and a URDF, and their replay in MuJoCo beside the log.

Effects and simulation do not import each other: an effect describes in plain numbers what a file contains of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli import urdf
from invdyn_cli.diagnosis import known
from invdyn_cli.diagnosis.columns import hold
from invdyn_cli.effects.composition import EffectInstance, changed
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import LogError, listed
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.log import Log
from invdyn_cli.maths.pseudo_inertia import realisable
from invdyn_cli.recording.pieces import Recording
from invdyn_cli.simulation import mjcf
from invdyn_cli.simulation.driven import Segment
from invdyn_cli.simulation.replay import Replay
from invdyn_cli.simulation.replay import replay as play
from invdyn_cli.types import Motion, Robot

NEAR = 0.1
"""Share of a damping or friction within which the URDF's is the one that was found."""


@dataclass(frozen=True)
class Export:
    """The extended model as text for simulators, and sentences on what each text lacks; `urdf` is "" for a robot that
    was not made from one."""

    mjcf: str
    mjcf_lacks: tuple[str, ...]
    urdf: str
    urdf_lacks: tuple[str, ...]


def exported(model: ExtendedModel) -> Export:
    """The model as MJCF and URDF."""
    text, lacks = urdf_of(model) if model.robot.urdf else ("", ())
    return Export(*_mjcf_of(model), text, lacks)


def _mjcf_of(model: ExtendedModel) -> tuple[str, tuple[str, ...]]:
    """The MJCF, and what it does not contain: a payload is a separate body there, other bodies belong to the arm."""
    parts, bodies = [], []
    for one in model.acting:
        terms = one.effect.in_simulator(one.parameters)
        parts.append(mjcf.Part(None if one.joint is None else model.robot.joints[one.joint], one.effect.title, terms))
        bodies += [one] * (terms.body is None and not one.effect.passing)
    return mjcf.written(_bare(_changed(model.robot, bodies)), parts)


def _changed(robot: Robot, acting: Sequence[EffectInstance]) -> Robot:
    """The robot with the inertials and gravity of the bodies among these effects."""
    return changed(robot, acting, Motion(*np.zeros((3, robot.dofs, 1))))[0]


def _bare(robot: Robot) -> Robot:
    """The robot without the values of <dynamics> tags: a diagnosis ignores them, and finds all friction anew."""
    return replace(robot, damping=np.zeros(robot.dofs), friction=np.zeros(robot.dofs))


def urdf_of(model: ExtendedModel) -> tuple[str, tuple[str, ...]]:
    """The robot's URDF with other inertials, damping and friction, and what it does not hold.

    Damping and friction are those that were found, and replace those of the file. The change of a moving link is
    written into its own <inertial>, even if the robot's row is the sum of several links that are fixed to each
    other.
    """
    robot, said = model.robot, []
    heavier = _changed(robot, [x for x in model.acting if not x.effect.passing])
    change, links = {}, urdf.moving_links(robot.urdf, robot.joints)
    for link, old, new in zip(links, np.asarray(robot.inertial), np.asarray(heavier.inertial), strict=True):
        if np.array_equal(old, new):
            continue
        real = realisable(new)
        if not np.allclose(real, new, rtol=1e-9, atol=0):
            said.append(f"{link}: its inertials are not physically consistent; the nearest consistent ones are written")
        change[link] = real - old
    for one in model.acting:
        terms, joint = one.effect.in_simulator(one.parameters), "" if one.joint is None else robot.joints[one.joint]
        lacks = [x.replace("_", " ") for x in terms.joint if x not in ("damping", "friction")]
        lacks += ["drive"] if terms.drive else []
        without = f"is written without its {listed(lacks)}: a URDF cannot contain it" if lacks else ""
        said += [f"{joint or 'whole arm'}: {one.effect.title} {x}" for x in (terms.lost, without) if x]
    if not np.array_equal(robot.gravity, heavier.gravity):
        gravity = ",".join(f"{x:.5g}" for x in np.asarray(heavier.gravity))
        said.append(f"whole arm: a URDF does not contain gravity; load the URDF with robot.gravity=[{gravity}]")
    text, refused = urdf.with_changes(robot.urdf, change, _dynamics(model))
    return text, (*said, *refused)


def beside_dynamics(model: ExtendedModel) -> tuple[str, ...]:
    """A sentence on the friction that the URDF's <dynamics> tags state, beside what was found; none where they state
    none."""
    stated, found = urdf.dynamics(model.robot.urdf, model.robot.joints) if model.robot.urdf else {}, _dynamics(model)
    pairs = [
        (f"{joint} {key}", *values)
        for joint in stated
        for key, *values in zip(("damping", "friction"), stated[joint], found[joint], strict=True)
        if any(values)
    ]
    if not any(a for _, a, _ in pairs):
        return ()
    others = [f"{name} {a:.3g}, estimated {b:.3g}" for name, a, b in pairs if abs(a - b) > NEAR * max(abs(a), abs(b))]
    said = "The URDF states friction in <dynamics> tags, which a diagnosis ignores and estimates itself: "
    said += f"{len(pairs) - len(others)} of {len(pairs)} values are within {100 * NEAR:.0f} % of the estimate"
    return (f"{said}; {listed(others, most=4)}." if others else f"{said}.",)


def _dynamics(model: ExtendedModel) -> dict[str, tuple[float, float]]:
    """Joint -> damping and friction that were found."""
    numbers = {x: (0.0, 0.0) for x in model.robot.joints}
    for one in model.acting:
        if one.joint is not None:
            terms, joint = one.effect.in_simulator(one.parameters).joint, model.robot.joints[one.joint]
            damping, friction = numbers[joint]
            numbers[joint] = damping + terms.get("damping", 0.0), friction + terms.get("friction", 0.0)
    return numbers


def stretches_of(log: Log, robot: Robot, recording: Recording, lead: float) -> list[Segment]:
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
    return [Segment(p.trajectory, p.t, p.q.T, p.qd.T, p.tau.T) for p in moved.pieces]


def why_not(log: Log) -> str:
    """Why a log cannot be replayed, "" if it can."""
    if log.torque_side == "link":
        return "its torques were measured on the link side of the gears, and the motor torques are not known"
    if log.torque_unit != "N m":
        return "its torques are currents, and their drive gains are not known"
    return ""


def replayed(model: ExtendedModel, stretches: Sequence[Segment], progress: Progress = silent) -> Replay:
    """The nominal and the extended arm beside the log.

    Raises:
        LogError: if no stretch is long enough, or MuJoCo refuses the arm.
    """
    before, _ = mjcf.written(_bare(model.robot))
    after, lacks = _mjcf_of(model)
    try:
        return play(before, after, stretches, model.robot.joints, not_held=lacks, progress=progress)
    except ValueError as error:
        raise LogError(f"MuJoCo refuses the arm: {error}") from error
