"""The uncertainty of the sizes: intervals of the refined parameters from the scatter between blocks of the log."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.coordinates import EDGES, with_parameters
from invdyn_cli.diagnosis.search.edges import possible
from invdyn_cli.effects.composition import EffectInstance

BOUNDLESS = 1e100
"""Beyond this value a parameter is unknown (the centre of a body without mass), and squares overflow."""

SYSTEMATIC, OWN_TIME = 1e-3, 0.1
"""Share of a parameter, and of a log's sample, by which interpolation and holding mislead on honest logs of the
simulated arm (`make confusion`)."""
GEARED = 0.1
"""Share of a gear's play or stiffness that its bounce, its damping, and time taken for the log's own hide: on a plant
of another author three sizes were 5 to 34 % off, on worn arms of our own 1 to 13 %."""

HIDDEN_BY_STICKING = 0.04
"""Share of a static friction, and of the speed at which it falls, that is hidden by the milliseconds in which a joint
that turns back sticks."""


def intervals(evidence: Evidence, refined: Refined) -> list[dict[str, tuple]]:
    """Every effect's refined parameters, and the edges of its window, with the ends of their intervals, {name: (value,
    lower, upper)}: jackknife over blocks, and over recordings, each replica turned into parameters, and no less than
    what the noise alone leaves unknown; angles do not jump."""
    moved = [refined.theta + row for row in refined.unknown]
    ways = [
        [with_parameters(evidence, refined.acting, refined.labels, row) for row in rows]
        for rows in (moved, *refined.replicas)
    ]
    out = []
    for number, a in enumerate(refined.acting):
        row = {}
        for name, value in _told(a).items():
            away = [np.array([np.asarray(_told(r[number])[name], float) - value for r in rows]) for rows in ways]
            if name in ("azimuth", "phase"):
                away = [(x + np.pi) % (2 * np.pi) - np.pi for x in away]
            error = np.hypot(reach(away[1:], away[0]), 2 * _systematic(evidence, a, name, value))
            row[name] = (value, np.asarray(value) - error, np.asarray(value) + error)
        out.append(row)
    return out


def with_edges(evidence: Evidence, model: Model, refined: Refined, weights: np.ndarray) -> list[dict[str, tuple]]:
    """`intervals`; no edge of a window lies where the rows in between exclude it (`edges.possible`)."""
    out = intervals(evidence, refined)
    for row, a, limits in zip(out, refined.acting, possible(evidence, model, refined, weights), strict=True):
        for name, (earliest, latest) in limits.items():
            value, low, high = row[name]
            least = 2 * _systematic(evidence, a, name, value)
            row[name] = value, max(low, earliest - least), min(high, latest + least)
    return out


def _told(acting: EffectInstance) -> dict[str, Any]:
    """Parameters of an effect, and the edges of its window."""
    edges = {} if acting.when is None else {name: getattr(acting.when, name) for name in EDGES}
    refined = {name: x for name, x in acting.parameters.items() if name not in acting.effect.chosen}
    return {**refined, **edges}


def reach(replicas: Sequence[np.ndarray], unknown: np.ndarray) -> np.ndarray:
    """Half of the widest 95 % interval of replicas (B, …) of some kinds: jackknife, Student's t (Tukey 1958); at least
    that of the moves (m, …) that the noise leaves unknown."""
    unknown = np.clip(unknown, -BOUNDLESS, BOUNDLESS)
    widest = scipy.stats.norm.ppf(0.975) * np.sqrt(np.sum(unknown**2, axis=0))
    for one in replicas:
        one, count = np.clip(one, -BOUNDLESS, BOUNDLESS), len(one)
        spread = np.sqrt((count - 1) / count * np.sum((one - one.mean(0)) ** 2, axis=0))
        widest = np.maximum(widest, scipy.stats.t.ppf(0.975, max(count - 1, 1)) * spread)
    return widest


def _systematic(evidence: Evidence, acting: EffectInstance, name: str, value) -> np.ndarray | float:
    """Standard error that no spread of blocks shows: what clocks, holding and filters leave of every column."""
    if name == acting.effect.late_by:
        return OWN_TIME * evidence.recording.period
    if name in ("static", "velocity"):
        return HIDDEN_BY_STICKING * np.abs(value)
    if name in EDGES:
        return 1 / evidence.recording.filter.rate
    if acting.effect.yields:
        return GEARED * np.abs(value)
    if name in ("phase", "azimuth", "rest", "cycles"):
        return 0.0
    return SYSTEMATIC * np.abs(np.asarray(value, float) - (1.0 if name == "gain" else 0.0))
