"""What the user already knows: declared causes are used as given, or allowed for, and not found again.

A reference, an earlier log of the same robot, is also knowledge: effects that both logs show alike are allowed for, and
only changes are searched.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.columns.joint_torques import reversal_columns
from invdyn_cli.effects.composition import (
    EffectInstance,
    changed,
    delivered,
    has_driver,
    in_chain,
    joint_terms,
    link_torque,
    sign_of,
)
from invdyn_cli.effects.friction import STICK_TIME
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.interfaces import AbstractEffect, JointState
from invdyn_cli.recording.pieces import Recording
from invdyn_cli.types import Motion, Robot

COUNTS = {"com": 3, "moment": 3, "inertia": 6}
"""Parameters that are more than one number."""


def is_common(candidate: Candidate) -> bool:
    """Whether an effect that an earlier log of the same robot shows is allowed for: those that are linear in their
    parameters, and the ripples that were found."""
    return not candidate.is_trial and (not candidate.shape or bool(candidate.effect.scanned))


def read(
    declared: Sequence[Any], effects: Mapping[str, AbstractEffect], robot: Robot
) -> tuple[tuple[EffectInstance, ...], list[tuple[str, int | None]]]:
    """Declared causes with parameters, and those that are only allowed for.

    Raises:
        UsageError: for an effect, a joint or a parameter that does not exist.
    """
    facts, allowed = [], []
    for one in declared:
        if isinstance(one, str):
            name, _, joint = one.partition("@")
            one = {"effect": name} | ({"joint": joint} if joint else {})
        if not isinstance(one, Mapping) or "effect" not in one:
            raise UsageError(f"diagnosis.known has {one!r}; allowed: effect, effect@joint, or {{effect, joint, …}}")
        name, joint = str(one["effect"]), one.get("joint")
        if name not in effects:
            raise UsageError(f"diagnosis.known: no effect {name!r}{closest(name, effects)}; allowed: {listed(effects)}")
        if joint is not None and joint not in robot.joints:
            raise UsageError(f"diagnosis.known: no joint {joint!r}{closest(str(joint), robot.joints)}")
        effect = effects[name]
        whole = not effect.of_joint
        if whole and joint is not None:
            raise UsageError(f"diagnosis.known: {name} acts on the whole arm, and has no joint; got {joint!r}")
        given = {k: v for k, v in one.items() if k not in ("effect", "joint")}
        if not given:
            parts = effect.sum_of or (name,)
            allowed += [(part, None if joint is None else robot.joints.index(joint)) for part in parts]
            continue
        wanted, optional = set(effect.parameters), {"inertia"} if effect.load else set()
        if set(given) - wanted or wanted - optional - set(given):
            raise UsageError(f"diagnosis.known: {name} has parameters {listed(effect.parameters)}; got {listed(given)}")
        given |= {x: [0.0] * COUNTS[x] for x in optional - set(given)}
        if joint is None and not whole:
            raise UsageError(f"diagnosis.known: {name} needs a joint; allowed: {listed(robot.joints)}")
        parameters = {k: _numbers(name, k, v) for k, v in given.items()}
        if effect.coupled:
            can = [x for j, x in enumerate(robot.joints) if has_driver(robot, j)]
            if joint not in can:
                got = f"diagnosis.known: {name} on {joint!r}, which has no joint before it to share a gear with"
                raise UsageError(f"{got}; allowed: {listed(can)}")
        facts.append(EffectInstance(effect, None if whole else robot.joints.index(joint), parameters))
    return tuple(facts), allowed


def _numbers(effect: str, name: str, value: Any) -> Any:
    count = COUNTS.get(name)
    try:
        made = float(value) if count is None else np.asarray(value, float)
    except (TypeError, ValueError):
        made = np.nan
    if np.shape(made) != (() if count is None else (count,)) or not np.all(np.isfinite(made)):
        wanted = "a number" if count is None else f"{count} numbers"
        raise UsageError(f"diagnosis.known: {name} of {effect} is {value!r}; allowed: {wanted}")
    return made


def allowed_for(pool: Sequence[Candidate], allowed: Sequence[tuple[str, int | None]]) -> tuple[Candidate, ...]:
    """Candidates that are part of every hypothesis. Of a channel's trials this is the first, with the change by its
    parameters and without its own fixed effect."""
    made: dict[tuple, Candidate] = {}
    for c in pool:
        if is_allowed(c, allowed):
            free = replace(c, columns={j: ((), columns[1]) for j, columns in c.columns.items()})
            made.setdefault((*c.key, None if c.is_trial else tuple(c.shape.items())), free)
    return tuple(made.values())


def is_allowed(candidate: Candidate, allowed: Sequence[tuple[str, int | None]]) -> bool:
    """Whether a candidate was declared without parameters (for its joint, or for all)."""
    return any(candidate.effect.name == name and joint in (None, candidate.joint) for name, joint in allowed)


def taken_out(
    recording: Recording, robot: Robot, facts: Sequence[EffectInstance], gravity: bool
) -> tuple[Recording, Robot]:
    """The recording without declared causes, with gravity put back where the torque has it taken out already; and the
    robot with the declared bodies and mounting."""
    pieces, actual = [], robot
    for piece in recording.pieces:
        tau = piece.tau.copy()
        actual, motion = changed(robot, facts, piece.motion)
        body = link_torque(robot, facts, piece.motion, recording.stretch(piece))
        width = np.maximum(2 * piece.motion_noise, 1e-6)
        rows = zip(motion.q, piece.qd, piece.qdd, sign_of(piece.qd, width[:, None]), body, strict=True)
        states = [JointState(piece.t, *row, width=float(x)) for row, x in zip(rows, width, strict=True)]
        states = in_chain(states, robot.parents)
        for j in range(robot.dofs):
            tau[j] = delivered(facts, j, tau[j], recording.filter.rate)
            tau[j] = tau[j] - sum(np.asarray(x) for x in joint_terms(facts, j, states, robot.parents))
        if gravity:
            tau = tau + rigid_torque(robot, Motion(motion.q, 0 * motion.q, 0 * motion.q))
        pieces.append(replace(piece, q=np.asarray(motion.q), tau=tau))
    return replace(recording, pieces=tuple(pieces)), actual


def timed(evidence: Evidence, facts: Sequence[EffectInstance]) -> tuple[Candidate, ...]:
    """What corrects the times at which declared friction jumps, a candidate each: it was taken out as it is, and a
    joint turns back some milliseconds before or after the logged angle says so."""
    made = []
    for one in facts:
        if not one.effect.jumps or one.when is not None:
            continue
        parts = reversal_columns(evidence, one)
        columns = {j: ((), evidence.append(j, [part[j] for part in parts])) for j in parts[0]}
        made.append(Candidate(one.effect, one.joint, {}, columns, np.full(len(parts), 1 / STICK_TIME**2)))
    return tuple(made)


def compare(evidence: Evidence, pool: Sequence[Candidate]) -> None:
    """Give the evidence effects that both logs may show alike; the columns of the candidates, and of those that are yet
    to come, then vanish on the reference's rows."""
    always = []
    for c in pool:
        if is_common(c):
            copies = {
                j: ((), evidence.append(j, [evidence.tables[j][:, i].copy() for i in free]))
                for j, (_, free) in c.columns.items()
            }
            always.append(replace(c, columns=copies))
    rows = evidence.of_role("reference")
    for c in pool:
        for j, (fixed, free) in c.columns.items():
            for i in (*fixed, *free):
                evidence.tables[j][rows, i] = 0.0
    evidence.reference_rows = rows
    evidence.given = (*evidence.given, *always)
