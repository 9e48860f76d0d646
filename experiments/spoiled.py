"""Defects that are put into logs, their size and place at random, each with a test of what a check says of it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.samples import nominal_torque
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.types import Check, Motion, Robot

Change = Callable[[np.random.Generator, Log, Robot], tuple[Log, Callable[[Check], bool]]]
"""What puts a defect into a log, and the test of whether a check says just that."""


def put(log: Log, change: Callable[[RawTrajectory], dict[str, Any]]) -> Log:
    """The log with channels of every recording changed."""
    return replace(log, trajectories=tuple(replace(raw, **change(raw)) for raw in log.trajectories))


def _scaled(channel: str, factor: float, joint: int | None = None, n: int = 0) -> Callable[[RawTrajectory], dict]:
    by = np.where(np.arange(n) == joint, factor, 1.0) if joint is not None else factor
    return lambda raw: {channel: getattr(raw, channel) * by}


def _about(check: Check, channel: str) -> bool:
    return isinstance(check.threshold, dict) and channel == check.threshold.get("channel")


def unit(channel: str, factors: Sequence[float]) -> Change:
    """A channel of all joints in another unit."""

    def change(draw, log, robot):
        factor = float(draw.choice(factors))
        bad = put(log, lambda raw: {} if getattr(raw, channel) is None else _scaled(channel, factor)(raw))

        def right(check: Check) -> bool:
            return _about(check, channel) and abs((check.threshold["factor"] or 0) / factor - 1) < 1e-3

        return bad, right

    return change


def unit_of_one(draw, log, robot):
    """The torque of one joint in N mm."""
    j = int(draw.integers(robot.dofs))
    bad = put(log, _scaled("tau", 1e3, j, robot.dofs))

    def right(check: Check) -> bool:
        unjudged = check.severity == "skipped" and log.joints[j] in check.seen.split(": ")[-1].split(", ")
        return _about(check, "tau") and (unjudged or check.joint == log.joints[j])

    return bad, right


def unit_of_one_position(draw, log, robot):
    """The position of one joint, commanded or not, in degrees or in revolutions."""
    j, factor = int(draw.integers(robot.dofs)), float(draw.choice([180 / np.pi, 0.5 / np.pi]))
    bad = put(log, _scaled("q", factor, j, robot.dofs))
    return bad, lambda c: c.joint == log.joints[j] and _about(c, "q")


def sign(channel: str, every: bool = False) -> Change:
    """The torque, q with qd, or both of one joint turned round; or all torques."""

    def change(draw, log, robot):
        j = int(draw.integers(robot.dofs))
        s = -np.ones(robot.dofs) if every else np.where(np.arange(robot.dofs) == j, -1.0, 1.0)

        def turned(raw: RawTrajectory) -> dict[str, Any]:
            names = [c for c in ("q", "qd", "qdd", "q_ref") if getattr(raw, c) is not None] if "q" in channel else []
            return {c: getattr(raw, c) * s for c in (*names, *(["tau"] if "tau" in channel else []))}

        def right(check: Check) -> bool:
            mine = every or check.joint == log.joints[j]
            unsure = check.severity == "skipped" and log.joints[j] in check.seen
            return unsure or (mine and (_about(check, channel) or check.severity == "warn"))

        return put(log, turned), right

    return change


def order(whole: bool, reverse: bool = False) -> Change:
    """Two joints exchanged, or all columns from the tip to the base."""

    def change(draw, log, robot):
        n = robot.dofs
        columns = np.arange(n)
        a, b = draw.choice(n, 2, replace=False)
        columns[[a, b]] = columns[[b, a]]
        columns = np.arange(n)[::-1] if reverse else columns

        bad, truth = arranged(log, columns, whole)

        def right(check: Check) -> bool:
            known = check.threshold or {}
            unjudged = set(check.seen.split(": ")[-1].split(", ")) if check.severity == "skipped" else set()
            unsure = {log.joints[a], log.joints[b]} <= unjudged
            stated = {k: known.get(k) for k in truth} == truth
            return bool(stated or truth in known.get("alike", ()) or (unsure and not reverse))

        return bad, right

    return change


def arranged(log: Log, columns: np.ndarray, whole: bool) -> tuple[Log, dict[str, list[int]]]:
    """The torque columns, or all columns, in another order; and what a check should say: for every joint of the robot
    the column that belongs to it, of positions and of torques."""
    names = ("q", "qd", "qdd", "q_ref", "tau") if whole else ("tau",)
    bad = put(log, lambda raw: {c: getattr(raw, c)[:, columns] for c in names if getattr(raw, c) is not None})
    back = np.argsort(columns).tolist()
    return bad, {"order": back if whole else list(range(len(columns))), "columns": back}


def time_offset(draw, log, robot):
    """All torques late or early by 15 to 100 ms."""
    late = float(draw.choice([-1, 1]) * draw.uniform(0.015, 0.1))
    before = [c for c in doctor.examine(log, robot).checks if c.check == "time_offset" and _about(c, "tau")]
    known = next((c.value for c in before if c.joint is None and isinstance(c.value, float)), 0.0)
    late = late if abs(late + known) > 0.015 else -late  # it shall not undo what the log has

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        return {"tau": np.stack([np.interp(raw.t - late, raw.t, x) for x in raw.tau.T], axis=1)}

    return put(log, moved), lambda c: _about(c, "tau") and abs((c.value or 0) - late - known) < 0.004


def lag_of_command(draw, log, robot):
    """q_ref in radians converted once too often, and some tens of milliseconds to two seconds early."""
    late = float(draw.uniform(0.05, 2.0))

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        return {"q_ref": np.stack([np.interp(raw.t + late, raw.t, x) for x in raw.q.T], axis=1) * np.pi / 180}

    return put(log, moved), lambda c: _about(c, "q_ref") and abs(c.value - np.pi / 180) < 1e-3


def stamps(draw, log, robot):
    """One to four stamps that are anything."""
    rows = draw.choice(len(log.trajectories[0].t), int(draw.integers(1, 5)), replace=False)

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        t = raw.t.copy()
        t[rows] = draw.choice([-1, 1], len(rows)) * 10 ** draw.uniform(2, 200, len(rows))
        return {"t": t}

    one = replace(log, trajectories=log.trajectories[:1])
    return put(one, moved), lambda c: isinstance(c.value, int) and abs(c.value - len(rows)) <= 1


def missing(draw, log, robot):
    """Rows of NaN."""
    share = draw.uniform(0.001, 0.02)

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        tau = raw.tau.copy()
        tau[draw.random(len(tau)) < share] = np.nan
        return {"tau": tau}

    return put(log, moved), lambda c: _about(c, "tau")


def outliers(draw, log, robot):
    """Ten wild samples of one joint's torque."""
    j = int(draw.integers(robot.dofs))

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        tau = raw.tau.copy()
        rows = draw.choice(np.arange(60, len(tau) - 60), 10, replace=False)
        tau[rows, j] += draw.choice([-1, 1], 10) * draw.uniform(2, 6) * np.ptp(tau[:, j])
        return {"tau": tau}

    return put(log, moved), lambda c: c.joint == log.joints[j] and _about(c, "tau")


def saturation(draw, log, robot):
    """One joint's torque ends at a quantile."""
    j, at = int(draw.integers(robot.dofs)), draw.uniform(0.85, 0.97)
    return put(log, lambda raw: {
        "tau": np.where(np.arange(robot.dofs) == j, np.minimum(raw.tau, np.quantile(raw.tau[:, j], at)), raw.tau)
    }), lambda c: c.joint == log.joints[j]  # fmt: skip


def power_off(draw, log, robot):
    """An emergency stop that ends the last tenth to third: drives without torque, brakes that stop the arm in 50 ms."""
    share, slip = draw.uniform(0.7, 0.9), 0.05

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        k = int(share * len(raw.t))
        since = (raw.t[k:] - raw.t[k])[:, None]
        speed = np.gradient(raw.q[: k + 1], raw.t[: k + 1], axis=0)[-20:].mean(axis=0)
        steps, hiss = (x - scipy.ndimage.median_filter(x, (9, 1)) for x in (raw.q, raw.tau))
        held = {
            "q": raw.q[k] + slip * speed * -np.expm1(-since / slip) + steps[k:],
            "qd": speed * np.exp(-since / slip),
            "qdd": -speed / slip * np.exp(-since / slip),
            "tau": hiss[k:],
        }
        there = {c: y for c in ("q_ref", *held) if (y := getattr(raw, c)) is not None}
        held["q_ref"] = held["q"]
        return {c: np.concatenate([y[:k], held[c]]) for c, y in there.items()}

    longest = max(float(np.ptp(raw.t)) for raw in log.trajectories)
    return put(log, moved), lambda c: 0 < c.value < (1 - share) * longest + 1


def other_velocities(draw, log, robot):
    """Velocities in the order of other joints."""
    return put(log, lambda raw: {} if raw.qd is None else {"qd": raw.qd[:, ::-1].copy()}), lambda c: _about(c, "qd")


def no_gravity(draw, log, robot):
    """Gravity taken out of the torque."""

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        still = np.zeros_like(raw.q, float)
        return {"tau": raw.tau - nominal_torque(robot, Motion(raw.q, still, still))[0] / _gain(log)}

    return put(log, moved), lambda c: True


def noise(draw, log, robot):
    """Noise in place of the torque."""
    bad = put(log, lambda raw: {"tau": draw.normal(size=raw.tau.shape) * raw.tau.std(0)})
    return bad, lambda c: c.severity == "fail"


def _gain(log: Log):
    return 1.0 if log.drive_gain is None else log.drive_gain


DEFECTS: dict[str, tuple[str, Change]] = {
    "units_q": ("unit_error", unit("q", [180 / np.pi, 0.5 / np.pi, 1e3, 4096 / np.pi])),
    "units_of_one_q": ("unit_error", unit_of_one_position),
    "units_qd": ("unit_error", unit("qd", [180 / np.pi, 30 / np.pi])),
    "units_t": ("unit_error", unit("t", [1e3, 1e6])),
    "units_torque": ("unit_error", unit("tau", [1e3, 1e-3])),
    "unit_of_one_torque": ("unit_error", unit_of_one),
    "q_ref": ("unit_error", lag_of_command),
    "sign_all": ("sign_error", sign("tau", every=True)),
    "sign_torque": ("sign_error", sign("tau")),
    "sign_position": ("sign_error", sign("q")),
    "sign_axis": ("sign_error", sign("q, tau")),
    "order_torque": ("joint_order", order(False)),
    "order_all": ("joint_order", order(True)),
    "order_reversed": ("joint_order", order(True, reverse=True)),
    "time_offset": ("time_offset", time_offset),
    "stamps": ("duplicates", stamps),
    "not_finite": ("not_finite", missing),
    "outliers": ("outliers", outliers),
    "saturation": ("saturation", saturation),
    "power_off": ("power_off", power_off),
    "derivative": ("derivative_consistency", other_velocities),
    "gravity_removed": ("gravity_removed", no_gravity),
    "model_mismatch": ("model_mismatch", noise),
}
