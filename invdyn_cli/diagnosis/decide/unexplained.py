"""The unexplained part: how much of the residual a learner predicts on data that it has not seen, and which findings it
casts doubt on.

Training and test stretches alternate in time, so that both contain the same postures; a cause that the catalogue lacks
then shows, and noise does not.
"""

from collections.abc import Mapping, Sequence

import jax
import numpy as np

from invdyn_cli import training
from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.decide import doubt
from invdyn_cli.diagnosis.search.judge import RELEVANT
from invdyn_cli.diagnosis.search.naming import structure
from invdyn_cli.interfaces import AbstractEffect, AbstractModel
from invdyn_cli.maths.scaling import spread_rows
from invdyn_cli.types import Dataset, Finding, Motion, Trajectory

ROWS = 4096
"""Number of rows from which the built-in networks learn: one shape for all logs (one compilation)."""

FLOOR = 1e-3
"""Share of the torque's RMS below which a predictable residual is negligible."""

STRETCH = 0.5
"""[s] Length of the stretches that are training and test data in turn."""

LOUDER = 5.0
"""Multiple of the RMS that noise and clocks usually leave, above which a recurring residual is more than noise."""

MOSTLY_UNKNOWN, UNKNOWN = 30.0, 0.5
"""The factor (doubt.BEYOND) for a joint on which the learner predicts more than the share UNKNOWN of the residual: an
effect that the catalogue lacks acts there."""

LATE_UNKNOWN = 1e4
"""The factor for a delay, a lag or a link's error on such a joint: many other effects resemble one to some percent."""

NETS = training.Schedule(epochs=60, batch_size=64)


def shares(evidence: Evidence, residual: np.ndarray, learner: AbstractModel | None, seed: int) -> np.ndarray:
    """Share (n,) of the residual's variance (R, n) that a learner still predicts, any model (None: nets of one hidden
    layer of 64 units for each joint); 0 where nothing is."""
    rate = evidence.recording.filter.rate / evidence.recording.filter.keep
    order = np.arange(len(residual))
    turn = (order // max(2, round(STRETCH * rate))) % 2 == 0
    moved = evidence.valid.any(axis=1)
    learn, judge = turn & moved, ~turn & moved
    if min(learn.sum(), judge.sum()) < 20:
        return np.zeros(residual.shape[1])
    motion = [evidence.on_rows(name) for name in ("q", "qd", "qdd")]
    key = jax.random.key(seed)
    if learner is None:
        predicted = _nets(motion, residual, learn, judge, key)
    else:
        data = Dataset(
            (Trajectory("residual", order[learn] / rate, Motion(*(x[learn] for x in motion)), residual[learn]),),
            evidence.robot.joints,
            evidence.robot,
        )
        predicted = learner.predict(learner.fit(data, key), Motion(*(x[judge] for x in motion)))
    out = np.zeros(residual.shape[1])
    for j in range(len(out)):
        own = evidence.valid[judge, j]
        left = residual[judge][own, j]
        if own.sum() > 20 and np.var(left) > 0:
            nothing = (FLOOR * np.sqrt(np.mean(evidence.tau[judge][own, j] ** 2))) ** 2
            saved = np.var(left) - np.mean((left - predicted[own, j]) ** 2)
            out[j] = max(0.0, saved / (np.var(left) + nothing))
    return out


def beyond_noise(evidence: Evidence, residual: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Whether (n,) what is left of a joint's torque (R, n) on these rows comes back in time as no noise does, and is
    many times what the torque's own noise and an honest log of a right model leave, whatever a learner predicts of it:
    a torque that swings in time is no function of the motion."""
    recording = evidence.recording
    white = recording.torque_noise * np.sqrt(2 * np.array(recording.filter.cutoffs) * recording.period)
    usual = np.hypot(white, RELEVANT * np.sqrt(np.mean(evidence.tau[rows] ** 2, axis=0)))
    found = structure(evidence, residual, evidence.valid & rows[:, None])
    return np.sqrt(found) > LOUDER * usual


def in_doubt(
    found: Sequence[Finding], effects: Mapping[str, AbstractEffect], learned: Mapping[str, float]
) -> tuple[Finding, ...]:
    """The findings. One that saves too little, compared with what a learner still predicts on its joints, becomes
    ambiguous: another effect acts there and may be the whole cause. Savings and predictions are shares of the residual.

    Args:
        learned: {joint: share of the residual's variance that the learner predicts, or that is no noise}.
    """
    out = []
    for one in found:
        saved = sum((g.rmse_before / max(g.rmse_after, 1e-300)) ** 2 - 1 for g in one.gain.values())
        shares = {j: float(np.nan_to_num(learned[j])) for j in one.gain}
        unknown = sum(shares.values())
        effect = effects[one.effect]
        near = [x for j, x in shares.items() if j == one.joint or not effect.yields]
        mostly = one.joint is not None and max(near, default=0.0) > UNKNOWN
        resembled = effect.late_by or (effect.changes_inertials and not effect.load)
        least = (LATE_UNKNOWN if resembled else MOSTLY_UNKNOWN) if mostly else doubt.BEYOND
        if one.status == "named" and saved < least * unknown:
            advice = "look for another effect on the joint: most of what the model misses there is still unknown"
            one = doubt.or_else(one, doubt.UNKNOWN, advice=advice)
        out.append(one)
    return tuple(out)


def _nets(motion, residual: np.ndarray, learn: np.ndarray, judge: np.ndarray, key: jax.Array) -> np.ndarray:
    x = np.concatenate(motion, axis=1)
    x = (x - x[learn].mean(0)) / np.maximum(x[learn].std(0), 1e-9)
    middle, scale = residual[learn].mean(0), np.maximum(residual[learn].std(0), 1e-300)
    rows = np.flatnonzero(learn)
    rows = np.resize(rows, ROWS) if len(rows) <= ROWS else rows[spread_rows(len(rows), ROWS)]
    y = (residual - middle) / scale
    n = residual.shape[1]
    group = training.Group((64,), tuple(range(n)), (0.003,) * n)
    data = training.Data(np.asarray(x[rows], np.float32), np.asarray(y[rows], np.float32))
    (trained,) = training.train([group], NETS, data, None, jax.random.split(key, 1))
    nets = jax.tree.map(lambda leaf: np.asarray(leaf[0]), trained.params)
    hidden = np.maximum(
        np.einsum("ri,niu->nru", x[judge], nets["Dense_0"]["kernel"]) + nets["Dense_0"]["bias"][:, None], 0
    )
    out = np.einsum("nru,nuo->nr", hidden, nets["Dense_1"]["kernel"]) + nets["Dense_1"]["bias"]
    return middle + scale * out.T
