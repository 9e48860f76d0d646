"""Logs of a motion that is known exactly, with torques written down by the test: no simulator, no controller."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import numpy as np

from experiments.arms import random_robot
from experiments.cases import inverse_dynamics
from experiments.confusion import claims
from invdyn_cli.diagnosis.columns import candidates
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search import noise
from invdyn_cli.diagnosis.search.judge import HypothesisScorer
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.pieces import Preparation, Recording, prepare
from invdyn_cli.types import Diagnosis, Motion, Robot
from tests.diagnosis.sick import motion

FRICTIONS = ["viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_friction", "torque_offset"]

Term = Callable[[np.ndarray, Motion], np.ndarray]
"""(t (T,), motion (T, n)) -> torque (T, n) beside the nominal one."""


@lru_cache
def arm() -> Robot:
    """A three-joint arm."""
    return random_robot(np.random.default_rng(0), 3)


def on(joint: int, term: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> Term:
    """A term of one joint's t, q, qd, qdd (T,)."""

    def whole(t: np.ndarray, m: Motion) -> np.ndarray:
        out = np.zeros_like(m.q)
        out[:, joint] = term(t, m.q[:, joint], m.qd[:, joint], m.qdd[:, joint])
        return out

    return whole


def nothing(t: np.ndarray, m: Motion) -> np.ndarray:
    """No term."""
    return np.zeros_like(m.q)


def beyond(robot: Robot, other: Robot, m: Motion) -> np.ndarray:
    """(T, n) torque that another robot needs for a motion beyond this one's."""
    needed, nominal = (inverse_dynamics(x, m.q, m.qd, m.qdd) for x in (other, robot))
    return needed - nominal


def moved(seconds: float = 40.0, rate: float = 500.0, seed: int = 0, late: float = 0.0) -> tuple[np.ndarray, Motion]:
    """t (T,) and sums of sines at t + `late`."""
    t = np.arange(round(seconds * rate)) / rate
    return t, motion(arm(), t + late, seed)


def in_turn(seconds: float) -> tuple[np.ndarray, Motion]:
    """t and sums of sines of one joint after the other, each in its share of the time; the others rest."""
    t, m = moved(seconds)
    dofs = m.q.shape[1]
    turn = np.clip(dofs * t[:, None] / seconds - np.arange(dofs), 0.0, 1.0)
    q = m.q * np.sin(np.pi * turn) ** 4
    qd = np.gradient(q, t, axis=0)
    return t, Motion(q, qd, np.gradient(qd, t, axis=0))


def raw(
    t: np.ndarray, m: Motion, term: Term = nothing, *, torque: float = 0.0, position: float = 0.0, seed: int = 0
) -> RawTrajectory:
    """A trajectory with white noise of these standard deviations [N m], [rad]."""
    draw = np.random.default_rng([seed, 7])
    tau = inverse_dynamics(arm(), m.q, m.qd, m.qdd) + term(t, m) + torque * draw.normal(size=m.q.shape)
    return RawTrajectory("run", t, m.q + position * draw.normal(size=m.q.shape), tau)


def log_of(*trajectories: RawTrajectory) -> Log:
    """A log of the arm."""
    rate = 1 / np.median(np.diff(trajectories[0].t))
    return Log(arm().name, arm().joints, "unknown", "N m", rate, trajectories)


def recording_of(log: Log, windows: Mapping | None = None, **options) -> Recording:
    """Made ready, each joint as if it carried a kg m^2."""
    return prepare(log, np.ones(arm().dofs), windows, Preparation(**options))


def gather(*recorded) -> Evidence:
    """The evidence of `candidates.gather` with all its candidates, as a robot with these links has them."""
    evidence = candidates.gather(*recorded)
    candidates.add_loaded(evidence)
    return evidence


def evidence_of(log: Log, names: Sequence[str], windows: Mapping | None = None, **options) -> Evidence:
    """Columns of these effects; a tilted base is always among them."""
    effects = [EFFECTS[name] for name in dict.fromkeys((*names, "base_tilt"))]
    return gather(arm(), recording_of(log, windows, **options), effects, "unknown")


def candidate(evidence: Evidence, name: str, joint: int | None, **shape: float) -> Candidate:
    """The first trial of an effect, or the one with this shape."""
    return next(
        c for c in evidence.candidates if c.key == (name, joint) and all(c.shape[k] == v for k, v in shape.items())
    )


def column(evidence: Evidence, name: str, joint: int) -> np.ndarray:
    """(R,) first free column of a joint's effect."""
    return evidence.tables[joint][:, candidate(evidence, name, joint).columns[joint][1][0]]


def said(diagnosis: Diagnosis) -> set[tuple[str, str | None]]:
    """(effect, joint) of all claims."""
    return {(f.effect, f.joint) for f in claims(diagnosis)}


def judged(term, speed: float = 1.0, torque: float = 0.05):
    """Evidence and judge of a log with a term on the second joint, of a motion so many times as fast."""
    t, _ = moved()
    slow = motion(arm(), speed * t, 0)
    m = type(slow)(slow.q, speed * slow.qd, speed**2 * slow.qdd)
    evidence = evidence_of(log_of(raw(t, m, on(1, term), torque=torque)), FRICTIONS, cutoffs=(20.0,))
    return evidence, scorer_of(evidence)


def scorer_of(evidence: Evidence) -> HypothesisScorer:
    """The scorer of the rows that choose, in their noise."""
    rows = evidence.role == 0
    measured = noise.measure(evidence, rows)
    judge = HypothesisScorer(evidence, rows, measured.weights, measured.deviation)
    judge.refresh()
    return judge
