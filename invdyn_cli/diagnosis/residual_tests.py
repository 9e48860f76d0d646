"""Tests of every joint's residual: whether it depends on speed, angle, load, time and so on.

A test is a few columns of the motion. If a residual depends on them, every stretch of the log shows it with the same
sign (`statistics.coherence`); stretches are longer than the correlation time of the noise.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.judge import RELEVANT
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.joints import units
from invdyn_cli.maths import ripple
from invdyn_cli.maths.statistics import autocorrelation_time, coherence
from invdyn_cli.types import ResidualTest

LEVEL = 0.01
"""Probability that a log of pure noise fails any test, divided equally among all tests of all joints (Bonferroni)."""

MEMORY, SHORTEST, MOST, FEWEST = 4.0, 0.5, 200, 12
"""A stretch is so many autocorrelation times long, of what a test's columns leave, and so many seconds at least; there
are no more and no fewer of them: of less nothing is said."""

KNOTS = 8
"""Number of hat functions over a quantity, at its quantiles."""

LAGS = (-0.15, -0.05, 0.0, 0.05, 0.1, 0.2, 0.4)
"""[s] around an event: before it late torques show, after it compliance and the closing of play."""

SWING = 0.05
"""Share of a quantity's usual size (its 90 % quantile) that it must exceed on both sides for a change of sign."""

BINS = 24
"""Number of bins of a test's curve."""


class Basis(NamedTuple):
    """Columns (R, k) of a test; what it is drawn over: (R,), NaN where it is not, and in words; and the sign (R,) with
    which the residual is drawn."""

    columns: np.ndarray
    over: np.ndarray
    quantity: str
    way: np.ndarray | float = 1.0


def residual_tests(
    evidence: Evidence,
    residual: np.ndarray,
    effects: Iterable[AbstractEffect] = (),
    acting: Sequence[EffectInstance] = (),
) -> tuple[ResidualTest, ...]:
    """Every test of every moving joint's residual (R, n).

    Args:
        effects: the causes that a test may point at.
        acting: what is in the model already.
    """
    effects, there = list(effects), {a.key[:2] for a in acting}
    motion = {name: evidence.on_rows(name) for name in ("t", "q", "qd", "qdd")}
    made, matters = [], RELEVANT * np.sqrt(np.mean(evidence.tau**2, axis=0))
    for j, joint in enumerate(evidence.robot.joints):
        used, left = evidence.valid[:, j], residual[:, j]
        for against, basis in _bases(evidence, motion, j, used).items() if used.any() else ():
            tries = 1
            if against == "ripple":
                basis, tries = _line(basis, left, used)
            found = _tested(evidence, basis, left, used, against == "level")
            if found is None:
                continue
            value, freedom, p, torque, share, memory = found
            shown = tuple(e.name for e in effects if against in e.shows and not {(e.name, j), (e.name, None)} & there)
            curve = _curve(basis.over, left * basis.way, used, memory)
            told = value, freedom, min(1.0, p * tries), torque, share, False, shown, basis.quantity, curve
            made.append((j, ResidualTest(joint, against, *told)))
    level = LEVEL / max(1, len(made))
    return tuple(replace(x, passed=bool(x.p > level or x.torque < matters[j])) for j, x in made)


def structured(tests: Sequence[ResidualTest], joints: Sequence[str]) -> np.ndarray:
    """(n,) RMS torque of the structured part of each joint's residual, 0 if all tests passed."""
    return np.array([max((x.torque for x in tests if x.joint == j and not x.passed), default=0.0) for j in joints])


def _tested(
    evidence: Evidence, basis: Basis, left: np.ndarray, used: np.ndarray, level: bool
) -> tuple[float, ...] | None:
    """Statistic, degrees of freedom, p, RMS torque and share of the squares of what goes with some columns beside a
    constant, or with the constant; and the memory [rows] of what does not. None where the log is too short for that."""
    x, y = basis.columns[used], left[used]
    if not level:
        x, y = x - x.mean(0), y - y.mean()
    size = np.sqrt(np.mean(x**2, axis=0))
    x = x[:, size > 0] / size[size > 0]
    across, values, _ = np.linalg.svd(x, full_matrices=False)
    across = across[:, values > 1e-6 * values[:1].max(initial=0.0)]
    piece = evidence.piece[used]
    memory = _memory(y - across @ (across.T @ y), piece)
    rate = evidence.recording.filter.rate / evidence.recording.filter.keep
    stretch = _stretches(piece, max(MEMORY * memory, SHORTEST * rate, len(y) / MOST))
    if not across.size or stretch.max() + 1 < FEWEST:
        return None
    scores = np.zeros((stretch.max() + 1, across.shape[1]))
    np.add.at(scores, stretch, across * y[:, None])
    squares = max(0.0, float(np.sum(scores.sum(0) ** 2) - np.sum(scores**2)))
    return *coherence(scores), float(np.sqrt(squares / len(y))), squares / max(float(y @ y), 1e-300), memory


def _memory(left: np.ndarray, piece: np.ndarray) -> float:
    """Autocorrelation time [rows] of a residual (R,), the longest of all pieces (R,)."""
    own = (left[piece == number] for number in np.unique(piece))
    return max((autocorrelation_time(x) for x in own if len(x) > 1), default=1.0)


def _stretches(piece: np.ndarray, rows: float) -> np.ndarray:
    """(R,) number of each row's stretch of so many rows at least, those of a piece (R,) alike in length."""
    out, count = np.zeros(len(piece), int), 0
    for number in np.unique(piece):
        own = np.flatnonzero(piece == number)
        parts = max(1, int(len(own) / rows))
        out[own] = count + np.arange(len(own)) * parts // len(own)
        count += parts
    return out


def _line(basis: Basis, left: np.ndarray, used: np.ndarray) -> tuple[Basis, int]:
    """The columns of the strongest line over the angle, drawn over its phase; and of how many it is."""
    q = basis.over
    grid = ripple.grid(q[used])
    if not len(grid):
        return basis._replace(columns=basis.columns[:, :0]), 1
    cycles = grid[np.argmax(ripple.power(left[used] - np.mean(left[used]), q[used], grid))]
    phase = np.mod(cycles * q, 2 * np.pi)
    said = f"phase of {cycles:.4g} cycles per revolution [rad]"
    return Basis(np.stack([np.cos(phase), np.sin(phase)], axis=1), phase, said), len(grid)


def _bases(evidence: Evidence, motion: Mapping[str, np.ndarray], j: int, used: np.ndarray) -> dict[str, Basis]:
    """The columns of all tests of a joint."""
    q, qd, qdd, load = (*(motion[name][:, j] for name in ("q", "qd", "qdd")), evidence.nominal[:, j])
    sliding = evidence.robot.prismatic[j]
    angle = "position" if sliding else "angle"
    unit, torque = units(sliding)
    slope, parts = np.zeros_like(load), evidence.piece
    for number in range(len(evidence.recording.pieces)):
        own = np.flatnonzero(parts == number)
        if len(own) > 2:
            slope[own] = np.gradient(load[own], motion["t"][own])
    rows = np.arange(len(q), dtype=float)
    way = np.sign(qd)
    loaded = _hats(load, used)
    return {
        "level": Basis(np.ones((len(q), 1)), rows / len(rows), "time, share of the log"),
        "velocity": Basis(np.hstack([_hats(qd, used), way[:, None]]), qd, f"velocity [{unit}/s]"),
        "angle": Basis(_hats(q, used), q, f"{angle} [{unit}]"),
        "ripple": Basis(q[:, None], q, f"{angle} [{unit}]"),
        "load": Basis(np.hstack([loaded, loaded * way[:, None]]), load, f"torque of the nominal model [{torque}]"),
        "load_zeros": around(load, parts, motion["t"], used, "time since the load changed sign [s]"),
        "acceleration": Basis(_hats(qdd, used), qdd, f"acceleration [{unit}/s²]"),
        "torque_slope": Basis(slope[:, None], slope, f"rate of the torque [{torque}/s]"),
        "reversals": around(qd, parts, motion["t"], used, "time since the joint reversed [s]"),
        "neighbours": _neighbours(evidence, motion, j, used),
        "time": Basis(_hats(rows, used, 5), rows / len(rows), "time, share of the log"),
    }


def _hats(x: np.ndarray, used: np.ndarray, knots: int = KNOTS) -> np.ndarray:
    """(R, k) hat functions over a quantity (R,), at its quantiles on the rows that are used."""
    at = np.unique(np.quantile(x[used], np.linspace(0, 1, knots)))
    return np.stack([np.interp(x, at, row) for row in np.eye(len(at))], axis=1)


def near_changes_of_sign(
    x: np.ndarray, piece: np.ndarray, t: np.ndarray, used: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """For every change of sign of a quantity (R,), but for small ones: the rows (k,) around it (LAGS), the time since
    then [s] (k,), and the new sign."""
    least = SWING * float(np.quantile(np.abs(x[used]), 0.9))
    ticks = np.round(1e6 * t)  # [us]: else a clock's last digit decides on which side of a limit a row is
    reach = 1e6 * np.array([LAGS[0], LAGS[-1]])
    for number in np.unique(piece):
        own = np.flatnonzero(piece == number)
        clock, far = ticks[own], own[np.abs(x[own]) > least]
        turns = np.flatnonzero(np.diff(np.sign(x[far])) != 0)
        for before, after in zip(far[turns], far[turns + 1], strict=True):
            event = before + int(np.argmax(np.sign(x[before : after + 1]) == np.sign(x[after])))
            start, end = np.searchsorted(clock, ticks[event] + reach)
            near = own[start:end]
            yield near, (ticks[near] - ticks[event]) / 1e6, float(np.sign(x[after]))


def around(x: np.ndarray, piece: np.ndarray, t: np.ndarray, used: np.ndarray, quantity: str) -> Basis:
    """Indicators of the time since a quantity (R,) changed its sign, as they are and with the new sign."""
    since, way = np.full(len(x), np.nan), np.zeros(len(x))
    for near, lag, sign in near_changes_of_sign(x, piece, t, used):
        closer = ~(np.abs(since[near]) <= np.abs(lag))
        since[near[closer]], way[near[closer]] = lag[closer], sign
    inside = np.stack([(since >= low) & (since < high) for low, high in pairwise(LAGS)], axis=1).astype(float)
    columns = np.hstack([inside, inside * way[:, None]])
    return Basis(columns if np.isfinite(since).any() else columns[:, :0], since, quantity, way)


def _neighbours(evidence: Evidence, motion: Mapping[str, np.ndarray], j: int, used: np.ndarray) -> Basis:
    """The motion of the joints before and after; drawn over the velocity of the first of them."""
    near = [k for k in (j - 1, j + 1) if 0 <= k < evidence.dofs and np.ptp(motion["q"][used, k]) > 0]
    if not near:
        return Basis(np.zeros((len(used), 0)), np.zeros(len(used)), "")
    q, qd, qdd = (motion[name][:, near] for name in ("q", "qd", "qdd"))
    unit = units(evidence.robot.prismatic[near[0]]).position
    said = f"velocity of {evidence.robot.joints[near[0]]} [{unit}/s]"
    return Basis(np.hstack([q, qd, np.sign(qd), qdd]), motion["qd"][:, near[0]], said)


def _curve(over: np.ndarray, left: np.ndarray, used: np.ndarray, memory: float) -> np.ndarray:
    """(3, bins) a quantity, the mean residual in bins of it, and its standard error."""
    rows = np.flatnonzero(used & np.isfinite(over))
    if len(rows) < 2 * BINS:
        return np.zeros((3, 0))
    parts = np.array_split(rows[np.argsort(over[rows], kind="stable")], BINS)
    means = [(np.mean(over[x]), np.mean(left[x]), np.std(left[x]) / np.sqrt(max(1.0, len(x) / memory))) for x in parts]
    return np.array(means).T
