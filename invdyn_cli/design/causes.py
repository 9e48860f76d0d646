"""Causes that a design distinguishes: the torque that each adds along a motion, and the columns by which it would
imitate another.

Sizes are given or estimated; otherwise those of `sizes`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np

from invdyn_cli.effects.composition import LEAST_INERTIA, EffectInstance, changed, inertia_column, sign_of
from invdyn_cli.effects.friction import STICK_TIME, about_reversals
from invdyn_cli.effects.rigid import body_columns, gravity_columns, rigid_torque
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractGearEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
    JointState,
    Parameters,
)
from invdyn_cli.types import Motion, Robot

OFFSET_STEP = 1e-3
"""[rad] Step of the slope of an encoder's zero."""

ANGLE_STEP = 1e-3
"""[rad; m] Step of the slope of a torque over a joint's angle."""

INERTIAL_SHARE = 0.3
"""Relative errors of a link's mass, first moments and inertia that are allowed for."""


@dataclass(frozen=True)
class Cause:
    """An effect on a joint (None: the whole arm); without parameters, of a typical size."""

    effect: AbstractEffect
    joint: int | None
    parameters: Parameters | None = None

    @property
    def key(self) -> tuple[str, int | None]:
        """The effect's name and its joint."""
        return self.effect.name, self.joint


@dataclass(frozen=True)
class Usual:
    """Usual values of the joints, (n,) each: torque [N m; N], speed, carried inertia, range, and middle posture."""

    torque: np.ndarray
    speed: np.ndarray
    inertia: np.ndarray
    range: np.ndarray
    middle: np.ndarray


@dataclass(frozen=True)
class Scenes:
    """Motions (n, S, L) of S scenes of L samples at `rate` [Hz], `t` (S, L) [s] since the recording began, and the
    nominal torque (n, S, L); `kept`: what was worked out for a joint."""

    t: np.ndarray
    motion: Motion
    torque: np.ndarray
    rate: float
    kept: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, init=False, compare=False)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(n, S, L)."""
        return self.torque.shape  # type: ignore[return-value]

    def states(self, joint: int, driver: int = -1) -> list[JointState]:
        """One joint's state in each scene, (L,) arrays."""
        whole = self.state(joint, driver)
        return [jax.tree.map(lambda x, s=s: x[s], whole) for s in range(self.shape[1])]

    def state(self, joint: int, driver: int = -1) -> JointState:
        """One joint's state in all scenes, (S, L) arrays; with that of its driver, unless that is -1."""
        q, qd, qdd = (np.asarray(x)[joint] for x in (self.motion.q, self.motion.qd, self.motion.qdd))
        width = np.maximum(np.abs(qdd) / (2 * self.rate), 1e-5)
        sign, before = np.asarray(sign_of(qd, width)), self.state(driver) if driver >= 0 else None
        return JointState(self.t, q, qd, qdd, sign, self.torque[joint], width=width, driver=before)


Trial = tuple[Sequence["Column"], np.ndarray]
"""Columns, and the prior precision 1 / scale^2 of their factors."""

Column = Mapping[int, np.ndarray]
"""Torques of some joints for a unit of a cause: joint -> (S, L)."""


def scenes_of(robot: Robot, motions: Sequence[Motion], starts: Sequence[float] | np.ndarray, rate: float) -> Scenes:
    """Scenes of motions (n, L) of one length, which begin at `starts` [s]."""
    stacked = Motion(*(np.stack([np.asarray(getattr(m, x)) for m in motions], axis=1) for x in ("q", "qd", "qdd")))
    n, count, length = stacked.q.shape
    torque = rigid_torque(robot, _flat(stacked)).reshape(n, count, length)
    t = np.asarray(starts)[:, None] + np.arange(length) / rate
    return Scenes(t, stacked, torque, rate)


def term(robot: Robot, cause: Cause, scenes: Scenes) -> Column:
    """The change of the logged torque by a cause with given parameters."""
    effect, joint, parameters = cause.effect, cause.joint, cause.parameters
    assert parameters is not None
    if isinstance(effect, AbstractTorqueEffect):
        assert joint is not None
        driver = _driver(robot, effect, joint)
        made = np.stack([np.asarray(effect.term(parameters, s)) for s in scenes.states(joint, driver)])
        return _felt({joint: made}, driver, effect.share_on_driver(parameters))
    if isinstance(effect, AbstractChannelEffect):
        assert joint is not None
        tau = scenes.torque[joint]
        return {joint: np.stack([np.asarray(effect.logged(parameters, x, scenes.rate)) - x for x in tau])}
    if isinstance(effect, AbstractGearEffect):
        assert joint is not None
        return _behind_gear(effect, parameters, joint, scenes, _answers(robot, joint, scenes))
    flat, shape = _flat(scenes.motion), scenes.shape
    moved = rigid_torque(*changed(robot, (EffectInstance(effect, joint, parameters),), flat)).reshape(shape)
    return dict(enumerate(moved - scenes.torque))


def columns(robot: Robot, cause: Cause, scenes: Scenes, level: np.ndarray, exact: bool = False) -> list[Trial]:
    """Trials of a rival: for each value of its nonlinear parameters its columns, and the prior precision of their
    factors.

    Args:
        level: (n,) [N m; N] usual size of what is hidden.
        exact: its own nonlinear parameters alone.
    """
    effect, joint = cause.effect, cause.joint
    if isinstance(effect, AbstractTorqueEffect):
        assert joint is not None
        shapes, driver = _shapes(cause, scenes.state(joint), exact), _driver(robot, effect, joint)
        return [_torque_columns(effect, joint, driver, shape, scenes, level) for shape in shapes]
    if isinstance(effect, AbstractChannelEffect):
        assert joint is not None
        tau, rate = scenes.torque[joint], scenes.rate
        if effect.factor:
            return [([{joint: tau}], np.zeros(1))]
        trials = [p for p in effect.shapes(tau.ravel(), rate) if all(v > 0 for v in p.values())]
        trials = [cause.parameters] if exact and cause.parameters is not None else trials
        made = [np.stack([x - np.asarray(effect.delivered(p, x, rate)) for x in tau]) for p in trials]
        made = made or [np.zeros_like(tau)]  # a joint without torque has nothing to cut off
        return [([{joint: x}], np.zeros(1)) for x in made]
    if isinstance(effect, AbstractGearEffect):
        return _gear_columns(robot, cause, scenes, exact)
    flat, shape = _flat(scenes.motion), scenes.shape
    if isinstance(effect, AbstractMotionEffect):
        assert joint is not None
        (name,) = effect.parameters
        ends = [rigid_torque(robot, effect.true({name: x}, flat, joint)) for x in (OFFSET_STEP, -OFFSET_STEP)]
        slope = ((ends[0] - ends[1]) / (2 * OFFSET_STEP)).reshape(shape)
        return [([dict(enumerate(slope))], np.array([1 / 0.3**2]))]
    assert isinstance(effect, AbstractBodyEffect)
    directions = effect.directions(robot, joint)
    precision = np.array([1 / scale**2 for *_, scale in directions])
    return [(body(robot, directions, flat, shape), precision)]


def body(robot: Robot, directions, flat: Motion, shape: tuple[int, int, int]) -> list[Column]:
    """Columns of directions in which inertials or gravity move."""
    moves = np.stack([np.asarray(m).reshape(-1) for m, _, _ in directions])
    if moves.any():
        made = body_columns(robot, moves, flat)
    else:
        made = gravity_columns(robot, np.stack([g for _, g, _ in directions]), flat.q)
    return [dict(enumerate(x.reshape(shape))) for x in made]


def link_columns(robot: Robot, joint: int, scenes: Scenes) -> tuple[list[Column], np.ndarray]:
    """Columns of one link's inertials and their precision: they are assumed to be about right."""
    own = np.asarray(robot.inertial)[joint]
    scales = INERTIAL_SHARE * np.array([own[0], *[own[0] * 0.1] * 3, *[max(np.abs(own[4:]).max(), 1e-4)] * 6])
    directions = []
    for k, scale in enumerate(scales):
        move = np.zeros((robot.dofs, 10))
        move[joint, k] = 1.0
        directions.append((move, np.zeros(3), scale))
    return body(robot, directions, _flat(scenes.motion), scenes.shape), 1 / np.maximum(scales, 1e-9) ** 2


def _shapes(cause: Cause, state: JointState, exact: bool) -> Sequence[Parameters]:
    effect = cause.effect
    assert isinstance(effect, AbstractTorqueEffect)
    if exact and cause.parameters is not None:
        return [effect.shape_of(cause.parameters)]
    if effect.scanned:
        own = [effect.shape_of(cause.parameters)] if cause.parameters else []
        return [*own, *(x for x in effect.scanned if x not in own)]
    return effect.shapes(state)


def _gear_columns(robot: Robot, cause: Cause, scenes: Scenes, exact: bool) -> list[Trial]:
    """A column for every trial value of the compliance; a linear factor covers the values between them."""
    effect, joint = cause.effect, cause.joint
    assert isinstance(effect, AbstractGearEffect) and joint is not None
    answers = _answers(robot, joint, scenes)
    load, inertia = scenes.torque[joint].ravel(), answers[0][joint].ravel()
    shapes = effect.shapes(load, inertia, scenes.rate)
    shapes = [cause.parameters] if exact and cause.parameters is not None else shapes
    return [([_behind_gear(effect, p, joint, scenes, answers)], np.zeros(1)) for p in shapes]


def _behind_gear(
    effect: AbstractGearEffect, parameters: Parameters, joint: int, scenes: Scenes, answers: tuple
) -> Column:
    """What a gear that yields changes of the torques: a straight line of the link's angle and acceleration against
    the motor's. A scene begins with the gear loaded."""
    mass, slope = answers
    loads = scenes.torque[joint] + effect.drag(parameters, np.asarray(scenes.motion.qd)[joint])
    each = [
        effect.deflection(parameters, load, inertia, scenes.rate)
        for load, inertia in zip(loads, mass[joint], strict=True)
    ]
    b, b2 = (np.stack(x) for x in zip(*each, strict=True))
    return dict(enumerate(mass * b2 + slope * b))


def _answers(robot: Robot, joint: int, scenes: Scenes) -> tuple[np.ndarray, np.ndarray]:
    """Torques (n, S, L) for unit acceleration of a joint, and the change of all torques with its angle; cached."""
    if joint in scenes.kept:
        return scenes.kept[joint]
    flat, own = _flat(scenes.motion), (np.arange(robot.dofs) == joint)[:, None]
    mass = inertia_column(robot, flat.q, joint)
    mass[joint] = np.maximum(mass[joint], LEAST_INERTIA)
    turned = rigid_torque(robot, replace(flat, q=flat.q + ANGLE_STEP * own))
    slope = (turned.reshape(scenes.shape) - scenes.torque) / ANGLE_STEP
    scenes.kept[joint] = mass.reshape(scenes.shape), slope
    return scenes.kept[joint]


def _driver(robot: Robot, effect: AbstractTorqueEffect, joint: int) -> int:
    """The other joint that drives the same gear; -1 for an effect of one joint."""
    return robot.parents[joint] if effect.coupled else -1


def _felt(column: dict[int, np.ndarray], driver: int, share: float) -> Column:
    """A column of one joint, and a share of it on the other joint that drives the same gear."""
    (own,) = column.values()
    return column | {driver: share * own} if driver >= 0 else column


def _torque_columns(
    effect: AbstractTorqueEffect, joint: int, driver: int, shape: Parameters, scenes: Scenes, level: np.ndarray
) -> Trial:
    states = scenes.states(joint, driver)
    made = [np.stack(x) for x in zip(*(effect.basis(s, shape) for s in states), strict=True)]
    precision = np.zeros(len(made))
    if effect.jumps:  # the milliseconds in which a joint that turns back sticks
        jump = np.asarray(effect.jump(made))
        scale = STICK_TIME * level[joint] / max(float(np.sqrt(np.mean(jump**2))), 1e-12)
        made += about_reversals(jump, scenes.rate)
        precision = np.append(precision, np.full(len(made) - len(precision), 1 / max(scale, 1e-12) ** 2))
    return [_felt({joint: x}, driver, effect.share_on_driver(shape)) for x in made], precision


def _flat(motion: Motion) -> Motion:
    """A motion (n, S, L) as one of all scenes, (n, S L)."""
    return Motion(*(np.asarray(x).reshape(len(x), -1) for x in (motion.q, motion.qd, motion.qdd)))
