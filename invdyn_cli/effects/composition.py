"""A robot with effects on it: from a motion to the torque that is logged, effects composed in one fixed order.

logged = channel(torque terms + forces + inverse dynamics of (changed bodies, true motion behind the gear)). The torque
of an effect with a time window is multiplied by the window's weight, between 0 and 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
    JointState,
    Parameters,
)
from invdyn_cli.maths import rigid_body
from invdyn_cli.types import Array, Motion, Robot

LEAST_INERTIA = 1e-6
"""[kg m^2; kg] Least inertia that a joint is assumed to carry: behind a gear, a link without mass has no defined
position."""


class TimeWindow(NamedTuple):
    """The window in which an effect acts: trajectory, start and end [s] from its first sample; `number` distinguishes
    several such effects of a log. In the windows `again`, too, the same acts."""

    trajectory: str
    start: float
    end: float
    number: int = 0
    again: tuple["TimeWindow", ...] = ()

    @property
    def each(self) -> tuple["TimeWindow", ...]:
        """This window and the others, one by one."""
        return self._replace(again=()), *self.again


LEAST = 1e-3
"""Share of the largest inertia that a joint carries, below which an inertia counts as zero."""


@dataclass(frozen=True)
class EffectInstance:
    """An effect with its joint (None: the whole arm), its parameters, and its window (None: always)."""

    effect: AbstractEffect
    joint: int | None
    parameters: Parameters
    when: TimeWindow | None = None

    @property
    def key(self) -> tuple:
        """The effect's name and its joint; for effects in a time window also their number."""
        return self.effect.name, self.joint, *(() if self.when is None else (self.when.number,))


def identity(acting: Sequence[EffectInstance]) -> tuple:
    """A key that is equal for equal effects with equal parameters, to cache results."""
    return tuple(
        (a.effect.name, a.joint, a.when, *((k, np.asarray(v).tobytes()) for k, v in a.parameters.items()))
        for a in acting
    )


@dataclass(frozen=True)
class Span:
    """Where and when a motion was: its trajectory, t (T,) [s] from its first sample, rate [Hz]."""

    trajectory: str | None
    t: np.ndarray
    rate: float


def weight(when: TimeWindow | None, stretch: Span) -> np.ndarray | float:
    """Weight (T,) of an effect: 1 in its window, 0 elsewhere, linear over one sample in between."""
    if when is None:
        return 1.0
    if stretch.trajectory != when.trajectory:
        return 0.0
    share = np.zeros(len(stretch.t))
    for one in when.each:
        begun, over = ((stretch.t - x) * stretch.rate + 0.5 for x in (one.start, one.end))
        share += np.clip(begun, 0, 1) - np.clip(over, 0, 1)
    return share


def changed(robot: Robot, acting: Sequence[EffectInstance], motion: Motion) -> tuple[Robot, Motion]:
    """The robot with the lasting body effects among `acting`, and the true motion (n, *batch) of a logged one, up to
    the gear; numpy or jax."""
    for one in acting:
        if one.when is not None:
            continue
        if isinstance(one.effect, AbstractMotionEffect):
            assert one.joint is not None
            motion = one.effect.true(one.parameters, motion, one.joint)
        elif isinstance(one.effect, AbstractBodyEffect):
            robot = one.effect.changed(one.parameters, robot, one.joint)
    return robot, motion


def body_torque(robot: Robot, acting: Sequence[EffectInstance], motion: Motion) -> Array:
    """Inverse dynamics (n, *batch) [N m; N] with the motion and body effects among `acting`; pure jax."""
    robot, motion = changed(robot, acting, motion)
    return rigid_body.inverse_dynamics(robot, robot.inertial, motion.q, motion.qd, motion.qdd)


def link_torque(
    robot: Robot,
    acting: Sequence[EffectInstance],
    motion: Motion,
    stretch: Span,
    kept: dict[tuple, Any] | None = None,
) -> np.ndarray:
    """Torque (n, T) [N m; N] that moves the links along a logged motion (n, T), with the motion, body, gear and force
    effects among `acting`; numpy in and out.

    Args:
        kept: of the same robot and motion, what calls with other gears had in common with this one; it grows.
    """
    kept = {} if kept is None else kept
    robot, motion = changed(robot, acting, motion)
    gears = [a for a in acting if isinstance(a.effect, AbstractGearEffect)]
    acting = [a for a in acting if not isinstance(a.effect, AbstractGearEffect)]
    q, bodies, before = motion.q, identity([a for a in acting if a.when is None]), identity(acting)
    for one in gears:
        assert one.joint is not None
        load, carried = ("load", before, one.joint), ("inertia", bodies, one.joint)
        before = *before, identity([one])
        if before not in kept:
            if load not in kept:
                kept[load] = _moving(robot, acting, motion, stretch)[one.joint]
            if carried not in kept:
                kept[carried] = inertia_column(robot, q, one.joint)[one.joint]
            motion = _behind(one, motion, kept[load], kept[carried], stretch.rate)
            if one is not gears[-1]:
                kept[before] = motion
        else:
            motion = kept[before]
    return _moving(robot, acting, motion, stretch)


def _moving(robot: Robot, acting: Sequence[EffectInstance], motion: Motion, stretch: Span) -> np.ndarray:
    """Torque (n, T) that moves the links of a robot along their motion, with the effects in time windows among
    `acting`."""
    torque = bare = rigid_torque(robot, motion)
    for one in acting:
        share = weight(one.when, stretch)
        if isinstance(one.effect, AbstractForceEffect) and np.any(share):
            columns = one.effect.placed(one.parameters, robot, one.joint, motion)
            torque = torque + share * np.tensordot(one.effect.coefficients(one.parameters), columns, 1)
        elif isinstance(one.effect, AbstractBodyEffect) and one.when is not None and np.any(share):
            other = one.effect.changed(one.parameters, robot, one.joint)
            torque = torque + share * (rigid_torque(other, motion) - bare)
    return torque


def _behind(one: EffectInstance, motion: Motion, load: np.ndarray, inertia: np.ndarray, rate: float) -> Motion:
    """The motion (n, T) of the links behind a compliant gear that transmits the load (T,) and carries the inertia
    (T,)."""
    assert isinstance(one.effect, AbstractGearEffect) and one.joint is not None
    # on the way to other inertials there may be none
    inertia = np.maximum(inertia, max(LEAST * np.abs(inertia).max(), LEAST_INERTIA))
    load = load + one.effect.drag(one.parameters, motion.qd[one.joint])
    b, b2 = one.effect.deflection(one.parameters, load, inertia, rate)
    b1 = np.gradient(b) * rate
    own = (np.arange(len(motion.q)) == one.joint)[:, None]
    return Motion(motion.q + own * b, motion.qd + own * b1, motion.qdd + own * b2)


def inertia_column(robot: Robot, q: Array, joint: int) -> np.ndarray:
    """Torques (n, T) for unit acceleration of a joint, at rest in postures q (n, T) [kg m^2; kg]."""
    still = np.zeros_like(q)
    unit = still + (np.arange(len(still)) == joint)[:, None]
    return rigid_torque(replace(robot, gravity=np.zeros(3)), Motion(q, still, unit))


def joint_terms(
    acting: Sequence[EffectInstance], joint: int, states: Sequence[JointState], parents: Sequence[int]
) -> list[Array]:
    """The term of each torque effect that acts on a joint, in the shape of the arrays of the joints' `states`; coupled
    effects are those of `in_chain`."""
    made = []
    for one in acting:
        share = shares(one, parents).get(joint)
        if isinstance(one.effect, AbstractTorqueEffect) and share is not None:
            assert one.joint is not None
            made.append(share * one.effect.term(one.parameters, states[one.joint]))
    return made


def shares(one: EffectInstance, parents: Sequence[int]) -> dict[int | None, float]:
    """The share of a torque or channel effect on its own joint, and on the one before it if their gear is coupled."""
    if not one.effect.coupled or not isinstance(one.effect, AbstractTorqueEffect):
        return {one.joint: 1.0}
    assert one.joint is not None
    return {one.joint: 1.0, parents[one.joint]: one.effect.share_on_driver(one.parameters)}


def has_driver(robot: Robot, joint: int) -> bool:
    """Whether a joint may share a gear with the one before it: there is one, and both turn or both slide."""
    before = robot.parents[joint]
    return before >= 0 and robot.prismatic[before] == robot.prismatic[joint]


def in_chain(states: Sequence[JointState], parents: Sequence[int]) -> list[JointState]:
    """The joints' states, each with that of the joint before it."""
    return [s._replace(driver=states[p]) if p >= 0 else s for s, p in zip(states, parents, strict=True)]


def channels(acting: Sequence[EffectInstance]) -> list[EffectInstance]:
    """The effects among `acting` between the logged and the delivered torque."""
    return [one for one in acting if isinstance(one.effect, AbstractChannelEffect)]


def delivered(acting: Sequence[EffectInstance], joint: int, tau: Array, rate: float) -> Array:
    """The torque (T,) that reaches a joint if this torque is logged, at `rate` [Hz]; time windows are ignored."""
    for one in acting:
        if isinstance(one.effect, AbstractChannelEffect) and one.joint == joint:
            tau = one.effect.delivered(one.parameters, tau, rate)
    return tau


def channel(acting: Sequence[EffectInstance], joint: int, tau: Array, stretch: Span) -> Array:
    """The torque that is logged if tau (T, …) reaches a joint."""
    for one in acting:
        if isinstance(one.effect, AbstractChannelEffect) and one.joint == joint:
            logged = one.effect.logged(one.parameters, tau, stretch.rate)
            share = np.reshape(weight(one.when, stretch), (-1, *(1,) * (tau.ndim - 1)))
            tau = logged if one.when is None else tau + share * (logged - tau)
    return tau


ALIKE = 0.72
"""1 / ln 4: tanh(qd / v) lacks as much of the sign's area as a straight line within v / 0.72."""


def sign_of(qd: Array, width: Array | float, transition: float = 0.0) -> Array:
    """sign(qd), but linear within `width` [rad/s] of zero; tanh(qd / transition) where a joint's friction changes its
    side so gradually [rad/s], and no sharper than within that width."""
    xp = qd.__array_namespace__()
    if not transition > 0:
        return xp.clip(qd / width, -1, 1)
    return xp.tanh(qd / xp.maximum(transition, ALIKE * xp.asarray(width)))
