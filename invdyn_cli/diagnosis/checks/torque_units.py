"""The unit of the torque columns, of all joints and of each by itself, by likelihood."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy

from invdyn_cli.diagnosis.checks.arrangement import ALIKE, FLAW, FOUND
from invdyn_cli.diagnosis.checks.fitness import GAINS, fitness, rows_of
from invdyn_cli.diagnosis.checks.samples import NO_MOTION, Samples, gather_changing
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.memory import once_for_a_log
from invdyn_cli.recording.rows import each
from invdyn_cli.types import Check, Robot

UNITS = {
    "N m": 1.0,
    "N mm or mN m": 1e3,
    "kN m": 1e-3,
    "N m times 1000 twice": 1e6,
    "N m over 1000 twice": 1e-6,
    "N cm": 100.0,
    "kgf cm": 10.1972,
    "kgf m": 0.101972,
    "lbf in": 8.85075,
    "ozf in": 141.612,
}
"""Logged number for a newton metre."""

RATED = {"percent of rated torque": 100.0, "per mille of rated torque": 1000.0}
"""The same, over the URDF's effort limit, which stands for the rated torque."""

CERTAIN = ("N mm or mN m", "kN m", "N m times 1000 twice", "N m over 1000 twice")
"""Far from any physical cause: corrected. The others are told, and left for the user to decide."""

WITHOUT_GAINS = (
    "data.drive_gain=[…] in N m/A, from the drives' data sheets; without them, invdyn diagnose estimates gains from "
    "the URDF's masses"
)
"""Advice for a log of currents."""

GAIN, LARGE, SELDOM = 0.25, 0.7, 0.03
"""Standard deviation of the log of logged over expected torque that gains, payloads and inertials make (ours: E4 of the
effects); of the few joints, with this chance, on which they make more."""

RANGE, DRIVES = 18.0, 0.8
"""Width of the log of a factor that belongs to no unit: currents and counts, 1e-4 to 1e4 for a newton metre; and by how
much the drives of one arm differ (ours: wrists have a half to a tenth of a shoulder's gain)."""


@dataclass(frozen=True)
class TorqueUnits(AbstractCheck):
    """Finds torques in N mm, kgf cm, percent, currents or counts. It compares the likelihoods of the ratio of logged to
    expected torque if all joints have one unit, if each joint has a factor of its own, and if single joints have
    another unit."""

    name: ClassVar[str] = "unit_error"

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """For all joints, else for single ones; the value is logged over expected torque."""
        missing = log.torque_unit == "A" and log.drive_gain is None
        samples = gather_changing(log, robot) if robot is not None else None
        if samples is None or robot is None:
            why = "no robot" if robot is None else NO_MOTION
            return [self._without_gains({})] if missing else [self.skipped(why, "tau")]
        names, factors = _candidates(robot, samples)
        fit = fitness(rows_of(samples, without_gravity="gravity" in log.compensated), robot, factors)
        at = np.arange(robot.dofs)
        beside = fit.likelihood[at, at, 0, :-1] - fit.likelihood[at, at, 0, :1]  # with tools, friction and wrong links
        judged = np.flatnonzero((fit.plain[at, at, 0, -1] > FOUND) & (fit.factor[at, at] > 0))
        ratios = {log.joints[j]: float(fit.factor[j, j]) for j in judged}
        if missing:
            return [self._without_gains(ratios)]
        if len(judged) < min(2, robot.dofs):
            return [self.skipped("fewer than two joints whose torque follows the one computed from the URDF", "tau")]
        found = self._judged(log, names, factors, ratios, judged, beside)
        left = [name for name in log.joints if name not in ratios]
        if left:
            why = "the unit was not judged, because the torque does not follow the URDF's: "
            found.append(self.skipped(why + ", ".join(left), "tau"))
        if any(c.severity != "skipped" for c in found):
            return found
        odd = {name: x for name, x in ratios.items() if not GAINS[0] < x < GAINS[1]}
        if odd:
            said = ", ".join(f"{name} {x:.3g}" for name, x in odd.items())
            why = f"logged torque over nominal torque: {said}; wrong masses, a tool or another unit may be the cause"
            found.append(self.skipped(why, "tau"))
        middle = float(np.median(list(ratios.values())))
        if not GAINS[0] < middle < GAINS[1]:
            return found
        return [*found, Check(self.name, "ok", value=middle, threshold={"channel": "tau"}, seen="tau is in N m")]

    def _judged(
        self,
        log: Log,
        names: Sequence[str],
        factors: np.ndarray,
        ratios: dict[str, float],
        judged: np.ndarray,
        beside: np.ndarray,
    ) -> list[Check]:
        """What the ratios say; a single joint's unit must also fit better `beside` (n, units) tools and friction than
        N m does. Else its torque has a factor of its own, which a tool may make as well as a unit."""
        ratio = np.array(list(ratios.values()))
        likelihood = _log_density(np.log(ratio[:, None] / factors[judged]))  # (joints, units)
        middle = float(np.exp(np.median(np.log(ratio))))
        common = likelihood.sum(0) - FLAW * (np.arange(len(names)) > 0)
        own = scipy.stats.norm.logpdf(np.log(ratio / middle), scale=DRIVES).sum() - np.log(RANGE) - FLAW
        one = FLAW + np.log(len(log.joints))
        single = np.where(beside[judged] > FOUND, likelihood - one, -np.inf)
        single[:, 0] = likelihood[:, 0]
        single = np.column_stack([single, np.full(len(ratio), -np.log(RANGE) - one)])
        singles = single.max(1).sum()
        best = int(np.argmax(common))
        if max(common[best], own, singles) - common[0] < FOUND:
            return []
        said = ", ".join(f"{joint} {x:.3g}" for joint, x in ratios.items())
        if singles > max(common[best] if best else -np.inf, own):
            return self._single(log, names, factors, single, judged, ratio)
        if own > common[best]:
            gains = ", ".join(f"{joint} {1 / x:.3g}" for joint, x in ratios.items())
            seen = f"logged torque over nominal torque: {said}; N m per logged unit: {gains}"
            return [self._seen("warn", None, middle, None, seen, f"tau looks like {_foreign(middle)}")]
        alike = [names[k] for k in range(len(names)) if k != best and common[k] > common[best] - ALIKE]
        sure = names[best] in CERTAIN and not alike
        if not sure and own + FLAW > common[best] - ALIKE:  # currents are no flaw but a habit
            alike.append(_foreign(middle))
        seen = f"logged torque over nominal torque: {said}; log odds of {common[best] - common[0]:.3g} against N m"
        what = f"tau is in {' or '.join([names[best], *alike])}"
        factor = float(np.ravel(factors[:, best])[0])
        return [self._seen("fail" if sure else "warn", None, middle, factor, seen, what)]

    def _single(self, log, names, factors, likelihood, judged, ratio) -> list[Check]:
        """Joints whose torque has another unit than the others'."""
        found = []
        for row, j in enumerate(judged.tolist()):
            best = int(np.argmax(likelihood[row]))
            gain = likelihood[row, best] - likelihood[row, 0]
            if best == 0 or gain < FOUND:
                continue
            if best == len(names):
                found.append(self._odd(log.joints[j], names, factors[j], row, ratio))
                continue
            near = np.flatnonzero(likelihood[row, :-1] > likelihood[row, best] - ALIKE)
            alike = [names[k] for k in near if k not in (0, best)]
            seen = f"logged torque over nominal torque {ratio[row]:.4g}; log odds of {gain:.3g} against N m"
            sure = names[best] in CERTAIN and not alike
            what, factor = f"tau of {log.joints[j]} is in {' or '.join([names[best], *alike])}", float(factors[j, best])
            found.append(self._seen("fail" if sure else "warn", log.joints[j], float(ratio[row]), factor, seen, what))
        return found

    def _odd(self, joint: str, names: Sequence[str], factors: np.ndarray, row: int, ratio: np.ndarray) -> Check:
        """A joint whose torque has another size than the others'; a tool would make it, too."""
        own, others = float(ratio[row]), float(np.median(np.delete(ratio, row)))
        near = [name for name, x in zip(names, factors, strict=True) if abs(np.log(own / x)) < 2 * GAIN]
        seen = f"ambiguous: logged torque over nominal torque {own:.4g}, of the other joints {others:.3g} (median)"
        what = f"tau of {joint} is in {' or '.join(near or ['another unit'])}, or the URDF lacks a tool"
        return self._seen("warn", joint, own, None, seen, what)

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Divide by the exact factor."""
        by, notes = np.ones(len(log.joints)), []
        for check in found:
            factor = check.threshold["factor"] if check.severity == "fail" else None
            if factor is None:
                continue
            by[slice(None) if check.joint is None else log.joints.index(check.joint)] = factor
            of = f" of {check.joint}" if check.joint else ""
            notes.append(f"torques{of} divided by {factor:g}: {check.meaning.split(':')[0]}")
        return (each(log, lambda raw: replace(raw, tau=raw.tau / by)), notes) if notes else (log, [])

    def _without_gains(self, ratios: dict[str, float]) -> Check:
        said = ", ".join(f"{joint} {1 / x:.3g}" for joint, x in ratios.items() if x > 0)
        seen = "torque_unit is A and there are no drive gains"
        seen += f"; the nominal torques suggest [N m/A] {said}" if said else ""
        made = self._seen("fail", None, None, None, seen, "currents cannot be compared with torques")
        return replace(made, advice=WITHOUT_GAINS)

    def _seen(self, severity, joint, value, factor, seen: str, what: str) -> Check:
        return Check(
            self.name,
            severity,
            joint=joint,
            value=value,
            threshold={"channel": "tau", "factor": factor, "log_odds": FOUND},
            seen=seen,
            meaning=f"{what}: gains, payloads and friction would all be wrong by this factor",
            advice="torques in N m, or torque_unit=A with data.drive_gain=[…] in N m/A",
            source="likelihood of exact unit ratios with gains and payloads wrong by 25 % (own choice)",
        )


@once_for_a_log
def doubted(log: Log, robot: Robot) -> np.ndarray:
    """(n,) bool: joints whose torque may be in another unit than N m."""
    found = [one for one in TorqueUnits().examine(log, robot) if one.severity != "skipped"]
    single = {one.joint for one in found if one.severity != "ok"}
    every = not found or None in single
    return np.array([every or name in single for name in log.joints])


def _log_density(x: np.ndarray) -> np.ndarray:
    """Of the log of a ratio over a unit's."""
    density = scipy.stats.norm.logpdf
    return np.logaddexp(np.log(1 - SELDOM) + density(x, scale=GAIN), np.log(SELDOM) + density(x, scale=LARGE))


def _candidates(robot: Robot, samples: Samples) -> tuple[list[str], np.ndarray]:
    """Names of units, N m first, and logged number per N m (n, units); those of rated torque where the URDF's limits
    may be that: a drive gives it for long, so that the RMS of what this motion asks stays below."""
    limits = np.asarray(robot.effort_limit, float)
    names = list(UNITS)
    factors = [np.full(robot.dofs, x) for x in UNITS.values()]
    if np.all(np.isfinite(limits)) and np.all(limits > rms(samples.nominal)):
        names += list(RATED)
        factors += [x / limits for x in RATED.values()]
    return names, np.stack(factors, axis=1)


def _foreign(ratio: float) -> str:
    """What a factor of each joint's own may be: a drive gives 1 to 300 N m at the joint for an ampere."""
    large = "currents in mA or counts" if ratio > 3 else "currents or counts"
    kind = "currents in A" if 1 / 300 < ratio < 1 else large
    return f"{kind}, one factor for each joint"
