"""extended_model.json <-> a robot with effects, ready to use: `invdyn-model/1`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import jax.numpy as jnp
import numpy as np

from invdyn_cli import untrusted
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import (
    EffectInstance,
    Span,
    TimeWindow,
    body_torque,
    channel,
    in_chain,
    joint_terms,
    link_torque,
    shares,
    sign_of,
)
from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.interfaces import AbstractEffect, JointState
from invdyn_cli.types import Array, Motion, Robot

SCHEMA = "invdyn-model/1"
SHARP = 1e-3
"""[rad/s] Within it sign(qd) is replaced by a straight line through zero."""


@dataclass(frozen=True)
class ExtendedModel:
    """A nominal robot, and the effects that a diagnosis found.

    Attributes:
        robot: the nominal robot.
        acting: effects with their parameters, in any order: they are composed as `effects.composition` says.
        intervals: per effect {parameter: (value, lower, upper)}, {} where it was declared.
        filter: what the parameters were found behind.
        provenance: of which log.
        transition: (n,) [rad/s; m/s] how gradually each joint's friction changes its side; 0, and (): it jumps.
    """

    robot: Robot
    acting: tuple[EffectInstance, ...]
    intervals: tuple[Mapping[str, tuple], ...] = ()
    filter: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    transition: tuple[float, ...] = ()

    def apply(self, motion: Motion, t: Array | float = 0.0) -> Array:
        """Torque (n,) of one sample, without effects that a single sample cannot show: delay, lag, gears, time windows;
        hysteresis is fully developed. Pure jax."""
        body = body_torque(self.robot, self.acting, motion)
        motion = Motion(*(jnp.asarray(x) for x in (motion.q, motion.qd, motion.qdd)))
        out, states = [], self._states(jnp.asarray(t), motion, body)
        for j in range(self.robot.dofs):
            tau = body[j] + sum(joint_terms(self.acting, j, states, self.robot.parents))
            for one in self.acting:
                memoryless = one.effect.factor or not one.effect.invertible
                if one.joint == j and memoryless and not one.when:
                    tau = one.effect.logged(one.parameters, tau, 1.0)  # type: ignore[attr-defined]
            out.append(tau)
        return jnp.stack(out)

    def predict(
        self, q: Array, qd: Array, qdd: Array, t: Array | None = None, trajectory: str | None = None
    ) -> np.ndarray:
        """Logged torque (T, n) [N m; N] of one recording (T, n), including all effects with a memory.

        Args:
            t: (T,) [s]; None: the clock that makes qd the derivative of q.
            trajectory: name of the log's own trajectory that this is: what came and went there does so again; None: it
                does not.
        """
        motion = Motion(*(np.asarray(x, float).T for x in (q, qd, qdd)))
        t = period_of(motion.q, motion.qd) * np.arange(motion.q.shape[1]) if t is None else np.asarray(t, float)
        t = t - t[:1]
        rate = 1 / np.median(np.diff(t)) if len(t) > 1 else 1.0
        stretch = Span(trajectory, t, float(rate))
        body = link_torque(self.robot, self.acting, motion, stretch)
        out, states = np.empty_like(body), self._states(t, motion, body)
        for j in range(len(body)):
            tau = body[j] + sum(np.asarray(x) for x in joint_terms(self.acting, j, states, self.robot.parents))
            out[j] = channel(self.acting, j, tau, stretch) if len(t) > 3 else tau
        return out.T

    def _states(self, t: Array, motion: Motion, body: Array) -> list[JointState]:
        """Every joint's state in a motion (n, …) that takes the torques `body` (n, …)."""
        speeds = zip(motion.qd, self.transition or (0.0,) * self.robot.dofs, strict=True)
        signs = [sign_of(qd, SHARP, transition) for qd, transition in speeds]
        rows = zip(motion.q, motion.qd, motion.qdd, signs, body, strict=True)
        return in_chain([JointState(t, *row, width=SHARP) for row in rows], self.robot.parents)


def period_of(q: Array, qd: Array) -> float:
    """The sampling period [s] of a motion (n, T) that was sampled evenly: the factor from qd to the steps of q."""
    if q.shape[1] < 3:
        return 1e-3
    steps, speed = (q[:, 2:] - q[:, :-2]).ravel() / 2, qd[:, 1:-1].ravel()
    squares = float(speed @ speed)
    return max(float(steps @ speed) / squares, 1e-6) if squares > 0 else 1e-3


def _windows(one: EffectInstance) -> dict[str, Any]:
    """When an effect acts, as extended_model.json has it; empty for one that always acts."""
    if one.when is None:
        return {}
    first, *others = [[w.start, w.end] for w in one.when.each]
    return {"trajectory": one.when.trajectory, "window": first, **({"again": others} if others else {})}


def as_dict(model: ExtendedModel) -> dict[str, Any]:
    """What extended_model.json holds."""
    robot = {f.name: _plain(getattr(model.robot, f.name)) for f in fields(Robot) if f.name != "urdf"}
    rows = []
    intervals = model.intervals or ({},) * len(model.acting)
    for one, ends in zip(model.acting, intervals, strict=True):
        rows.append(
            {
                "effect": one.effect.name,
                "acts_on": one.effect.point,
                "joint": None if one.joint is None else model.robot.joints[one.joint],
                **driver_name(one, model.robot),
                **_windows(one),
                "parameters": {
                    name: {
                        "value": _plain(value),
                        "unit": one.effect.parameters[name].unit,
                        "interval95": [_plain(x) for x in ends[name][1:]] if name in ends else None,
                    }
                    for name, value in one.parameters.items()
                },
            }
        )
    return {
        "schema": SCHEMA,
        "robot": robot,
        "urdf": model.robot.urdf,
        "order": ["motion", "body", "gear", "force", "torque", "channel"],
        "effects": rows,
        **({"friction_transition": list(model.transition)} if any(model.transition) else {}),
        "filter": dict(model.filter),
        "provenance": dict(model.provenance),
    }


def from_dict(stored: Any, where: str = "the model", effects: Mapping[str, AbstractEffect] = EFFECTS) -> ExtendedModel:
    """The model of an extended_model.json, of these effects by name.

    Raises:
        UsageError: if it is none, or names an effect that there is not.
    """
    if not isinstance(stored, Mapping) or stored.get("schema") != SCHEMA:
        got = stored.get("schema") if isinstance(stored, Mapping) else type(stored).__name__
        raise UsageError(f"{where}: schema is {got!r}; allowed: {SCHEMA}", advice="an extended_model.json of diagnose")
    try:
        tree = untrusted.mapping(stored["robot"], "robot")
        texts = {name: tree[name] for name in ("name", "joints", "notes")}
        numbers = {name: _numbers(x) for name, x in tree.items() if name not in texts}
        robot = untrusted.robot({**numbers, **texts, "urdf": stored.get("urdf", "")})
        acting, intervals = [], []
        for number, row in enumerate(stored["effects"]):
            name = row["effect"]
            if name not in effects:
                got = f"{where}: no effect {name!r}{closest(name, effects)}; allowed: {listed(effects)}"
                raise UsageError(got, advice="model.effects=[{_target_: mine.MyEffect}] for an effect of your own")
            joint = None if row["joint"] is None else robot.joints.index(row["joint"])
            parameters = effects[name].whole({k: _numbers(v["value"]) for k, v in row["parameters"].items()})
            when = None
            if effects[name].passing:
                start, end = row["window"]
                when = TimeWindow(row["trajectory"], float(start), float(end), number)
                again = [when._replace(start=float(a), end=float(b)) for a, b in row.get("again", ())]
                when = when._replace(again=tuple(again))
            acting.append(EffectInstance(effects[name], joint, parameters, when))
            ends = {k: v["interval95"] for k, v in row["parameters"].items() if v.get("interval95")}
            intervals.append({k: (parameters[k], *(_numbers(x) for x in pair)) for k, pair in ends.items()})
        transition = tuple(float(x) for x in stored.get("friction_transition", ()))
        if transition and not (len(transition) == robot.dofs and all(0 <= x < np.inf for x in transition)):
            raise ValueError(f"friction_transition={list(transition)}; allowed: {robot.dofs} speeds from 0")
    except KeyError as error:
        raise UsageError(f"{where} lacks {error}", advice="the unchanged file of invdyn diagnose") from error
    except (TypeError, ValueError, AttributeError, RecursionError) as error:
        got = f"{where} is not a complete model ({error})"
        raise UsageError(got, advice="the unchanged file of invdyn diagnose") from error
    more = stored.get("filter", {}), stored.get("provenance", {}), transition
    return ExtendedModel(robot, tuple(acting), tuple(intervals), *more)


def driver_name(one: EffectInstance, robot: Robot) -> dict[str, str]:
    """The name of the joint that drives the gear of a coupled effect; empty for other effects."""
    joints = [robot.joints[j] for j in list(shares(one, robot.parents))[1:] if j is not None]
    return {"driver": joints[0]} if joints else {}


def _plain(value: Any) -> Any:
    """Numbers as JSON has them; infinite ones as text."""
    if isinstance(value, str | bool | int) or value is None:
        return value
    if isinstance(value, tuple | list):
        return [_plain(x) for x in value]
    array = np.asarray(value, float)
    return [_plain(x) for x in array] if array.ndim else (float(array) if np.isfinite(array) else str(float(array)))


def _numbers(value: Any) -> Any:
    if isinstance(value, list):
        return np.asarray([_numbers(x) for x in value])
    if value in ("inf", "-inf", "nan"):
        return float(value)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else value
