"""What each joint's own standard terms show beside the nominal model: friction above all, which a weak drive scales."""

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence

FITS = 4
"""Number of fits of a change of gain; each scales friction by the gain of the last one, and they converge in three."""


def by_terms(evidence: Evidence, rows: np.ndarray, joint: int) -> np.ndarray:
    """(R,) torque of a joint's own standard terms, fitted to some `rows`."""
    own = _columns(evidence, joint)
    return own @ _fitted(evidence, rows, joint, own)


def beside_gain(evidence: Evidence, joint: int, inside: np.ndarray | None = None) -> np.ndarray:
    """(R,) the same beside a gain of the joint's drive, on training data: the torque that a weak drive lacks is no
    friction. `inside` (R,) is 1 in a window of time in which that gain may be another one: what it lacks there is no
    offset, and it gives less of its friction there, too."""
    own, rows = _columns(evidence, joint), evidence.of_role("train")
    model = evidence.tau[:, joint] - evidence.tables[joint][:, 0]
    if inside is None:
        return own @ _fitted(evidence, rows, joint, np.column_stack([own, model]))[: own.shape[1]]
    theta, more = np.zeros(own.shape[1]), np.zeros(len(inside))
    for _ in range(FITS):
        columns = np.column_stack([own * (1 + more)[:, None], model, model * inside])
        *theta, _, change = _fitted(evidence, rows, joint, columns)
        more = change * inside
    return own @ theta


def _columns(evidence: Evidence, joint: int) -> np.ndarray:
    terms = [c for c in evidence.candidates if c.effect.group == "standard" and not c.effect.changes_inertials]
    columns = sorted({i for c in terms if c.joint == joint and not c.shape for i in c.columns[joint][1]})
    return evidence.tables[joint][:, columns]


def _fitted(evidence: Evidence, rows: np.ndarray, joint: int, columns: np.ndarray) -> np.ndarray:
    """Coefficients of columns beside the nominal torque; 0 if the joint does not move on these rows."""
    used = rows & evidence.valid[:, joint]
    return np.linalg.lstsq(columns[used], evidence.tables[joint][used, 0])[0]
