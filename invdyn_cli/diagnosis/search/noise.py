"""The noise: the residual of a model with all columns, joint by joint; and ripples in it, which no list of trials can
contain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import kind_of
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.columns.shown import by_terms
from invdyn_cli.effects.transmission import TorqueRipple
from invdyn_cli.maths import ripple
from invdyn_cli.maths.statistics import autocorrelation_time

FLOOR, FAINT = 5e-4, 0.02
"""Share of a joint's RMS torque (or of a fifth of the strongest joint's, up to the share FAINT of its own) below which
nothing is known: errors of interpolation, clocks and rounding."""

MOVES = 0.05
"""Share of the rows on which a joint must move to be judged: one that is held still shows only its noise."""

RIDGES = np.logspace(-10, 0, 21)
"""Ridge parameters to choose from, as shares of the mean square of all columns; the smallest only separates equal
columns."""

STRETCHES, PLAINLY = 4, 0.5
"""Number of stretches of time, one of which is quiet if an effect acts for a time; and the share of the whole noise
below which the noise of a stretch is plainly smaller."""

HEARD = 0.05
"""Least share of the noise that a trial of a channel must leave to say how large it is: a limit that is far below the
logged torque leaves nothing of it, neither noise nor cause."""

PEAKS = 3
PEAK = 20.0
"""Ripples that are taken up as candidates: so many of the highest lines, at least so many noise variances high: of a
thousand lines in white noise one in twenty logs has one."""


@dataclass(frozen=True)
class Noise:
    """Per joint: standard deviation of the residual's noise on filtered rows [N m; N], its autocorrelation time in
    rows, and the residual (R, n) of the model that may use everything."""

    deviation: np.ndarray
    time: np.ndarray
    residual: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        """1 / (variance x autocorrelation time), (n,); 0 for a joint that never moves."""
        return np.where(self.deviation > 0, 1 / np.maximum(self.deviation**2 * self.time, 1e-300), 0.0)

    def plainly_below(self, other: "Noise") -> np.ndarray:
        """(n,) whether this is known and plainly smaller."""
        return (self.deviation > 0) & (self.deviation < PLAINLY * other.deviation)


def measure(evidence: Evidence, rows: np.ndarray) -> Noise:
    """The noise of the chosen rows (R,) bool."""
    n, floor = evidence.dofs, _floor(evidence, rows)
    deviation, time, residual = np.zeros(n), np.ones(n), np.zeros(evidence.tau.shape)
    for j in range(n):
        used = rows & evidence.valid[:, j]
        if used.sum() < max(50, MOVES * rows.sum()):
            continue
        columns = sorted({i for c in evidence.candidates if _plain(c, j) for i in _free(c, j)})
        x, y = evidence.tables[j][:, columns], evidence.tables[j][:, 0]
        scale = np.sqrt(np.mean(x[used] ** 2, axis=0))
        x = x[:, scale > 0] / scale[scale > 0]
        # the channel may be at fault as well: the trial that leaves least counts
        trials = [c for c in evidence.candidates if c.effect.point == "channel" and j in c.columns and c.columns[j][0]]
        trials = [c for c in trials if 1 - c.noise_reduction >= HEARD]
        targets = np.column_stack([y, *(y - evidence.tables[j][:, c.columns[j][0][0]] for c in trials)])
        theta, spread = _fitted(x[used], targets[used], used.sum() * evidence.recording.filter.independent(j))
        loud = np.array([1.0, *(1 - c.noise_reduction for c in trials)])
        best = int(np.argmin(np.where(np.arange(len(loud)) > 0, 1.1, 1.0) * spread / loud))
        residual[:, j] = targets[:, best] - x @ theta[:, best]
        variance = spread[best] / loud[best]
        deviation[j] = np.sqrt(variance + floor[j] ** 2)
        time[j] = autocorrelation_time(np.where(used, residual[:, j], 0.0)[rows])
    return Noise(deviation, time, residual)


def _floor(evidence: Evidence, rows: np.ndarray) -> np.ndarray:
    """(n,) torque below which nothing is known on the chosen rows (FLOOR)."""
    own = np.sqrt(np.mean(evidence.tau[rows] ** 2, axis=0))
    return np.maximum(FLOOR * own, np.minimum(FLOOR * own.max() / 5, FAINT * own))


def beside(evidence: Evidence, residual: np.ndarray, rows: np.ndarray, least: Noise) -> Noise:
    """The noise beside a hypothesis that leaves this residual (R, n) on the chosen rows: structure and all, but no less
    than `least` measured, and nothing where that knows nothing."""
    deviation, time = least.deviation.copy(), least.time.copy()
    for j in np.flatnonzero(least.deviation > 0):
        used = rows & evidence.valid[:, j]
        deviation[j] = max(deviation[j], np.sqrt(np.mean(residual[used, j] ** 2)))
        time[j] = max(time[j], autocorrelation_time(np.where(used, residual[:, j], 0.0)[rows]))
    return Noise(deviation, time, residual)


def no_more(measured: Noise, heard: Noise) -> Noise:
    """What was measured, but what was heard on the joints where that is plainly smaller."""
    less = heard.plainly_below(measured)
    deviation = np.where(less, heard.deviation, measured.deviation)
    return replace(measured, deviation=deviation, time=np.where(less, heard.time, measured.time))


def quieter(evidence: Evidence, residual: np.ndarray, rows: np.ndarray, than: Noise) -> Noise | None:
    """The noise that a model's residual (R, n) has on the chosen rows, for joints on which it is plainly smaller `than`
    what was measured without that model, as beside a drive that gives less for a time; None if it is on no joint."""
    floor = _floor(evidence, rows)
    deviation, time = than.deviation.copy(), than.time.copy()
    for j in np.flatnonzero(than.deviation > 0):
        used = rows & evidence.valid[:, j]
        own = float(np.sqrt(np.mean(residual[used, j] ** 2) + floor[j] ** 2))
        if own < PLAINLY * than.deviation[j]:
            deviation[j], time[j] = own, autocorrelation_time(np.where(used, residual[:, j], 0.0)[rows])
    return Noise(deviation, time, residual) if np.any(deviation < than.deviation) else None


def _fitted(x: np.ndarray, y: np.ndarray, independent: float) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (k, m) of columns x (N, k) of unit mean square for each of the targets y (N, m), and the variance
    (m,) of what they leave. Rows behind a low filter are as many `independent` samples, and may be no more than the
    columns: a ridge is chosen that predicts best (generalised cross-validation; Golub, Heath and Wahba 1979)."""
    values, vectors = np.linalg.eigh(x.T @ x)  # SciPy's default driver takes four times as long where values lie close
    values = np.maximum(values, 0.0)
    moments = vectors.T @ (x.T @ y)
    best = np.full(y.shape[1], np.inf)
    theta, variance = np.zeros((x.shape[1], y.shape[1])), np.mean(y**2, axis=0)
    for ridge in RIDGES * max(values.mean() if len(values) else 0.0, 1e-300):
        free = 1 - np.sum(values / (values + ridge)) / independent
        if free <= 0:
            continue
        own = moments / (values + ridge)[:, None]
        mean = np.maximum(
            np.mean(y**2, axis=0) - np.sum(own * (2 * moments - values[:, None] * own), axis=0) / len(y), 0.0
        )
        better = mean / free**2 < best
        best, variance = np.where(better, mean / free**2, best), np.where(better, mean / free, variance)
        theta = np.where(better, vectors @ own, theta)
    return theta, variance


def measure_beside(evidence: Evidence, rows: np.ndarray) -> Noise:
    """The noise of the chosen rows (R,) bool if an effect may act for a time: for each joint that of the quietest
    stretch of time, if it is plainly smaller than that of all stretches; the residual is that of all."""
    quietest = measure(evidence, rows)
    for own in np.array_split(np.flatnonzero(rows), STRETCHES):
        stretch = np.zeros_like(rows)
        stretch[own] = True
        quietest = no_more(quietest, measure(evidence, stretch))
    return quietest


def _plain(candidate: Candidate, joint: int) -> bool:
    """Whether a candidate belongs to the model that may use everything: all but the many trials of one effect, and
    drives that two joints share: free factors of another joint's motion take up slow ripples and loads."""
    if joint not in candidate.columns or candidate.effect.coupled:
        return False
    if candidate.effect.yields:
        return candidate.joint == joint
    return candidate.effect.is_ordinary(candidate.shape)


def _free(candidate: Candidate, joint: int) -> tuple[int, ...]:
    """Columns of a candidate that may have any factor here: for a gear, the torque change of its trials."""
    fixed, free = candidate.columns[joint]
    return fixed if candidate.effect.yields else free


def ripples(
    evidence: Evidence, noise: Noise, residuals: Sequence[np.ndarray], rows: np.ndarray, effect: TorqueRipple
) -> list[Candidate]:
    """Candidates for every line over a joint's angle that exceeds the noise in one of these residuals (R, n)."""
    made = []
    angle, speed = evidence.on_rows("q"), evidence.on_rows("qd")
    for j in range(evidence.dofs):
        used = rows & evidence.valid[:, j]
        if used.sum() < 50 or not noise.deviation[j]:
            continue
        q, qd = angle[used, j], speed[used, j]
        if not np.ptp(q) > 0.05:
            continue
        passed = {"qd": qd, "cutoff": evidence.recording.filter.cutoffs[j]}
        grid = ripple.grid(q, effect.most)
        if not len(grid):
            continue
        near = np.zeros(len(grid), bool)
        for residual in residuals:
            power = ripple.power(residual[used, j], q, grid, **passed) / noise.deviation[j] ** 2
            for _ in range(PEAKS):
                best = int(np.argmax(np.where(near, 0.0, power)))
                if near[best] or power[best] < PEAK:
                    break
                cycles, _ = ripple.sharpened(residual[used, j], q, float(grid[best]), **passed)
                made.append(kind_of(effect).candidate(evidence, effect, j, {"cycles": cycles}))
                near |= np.abs(grid - grid[best]) < 2 * np.pi / np.ptp(q)
    return made


def left_by_terms(evidence: Evidence, rows: np.ndarray) -> np.ndarray:
    """(R, n) what each joint's own standard terms leave of the torque: a model of all columns may take up a ripple."""
    terms = [by_terms(evidence, rows, j) for j in range(evidence.dofs)]
    return evidence.residual((), np.zeros(0)) - np.column_stack(terms)
