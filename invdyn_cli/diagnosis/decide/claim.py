"""The figures that decide whether a candidate of a hypothesis may be claimed: what it explains of held-out data, and
what the other candidates leave without it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import kind_of
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, judged, shared_out, slow, slow_saved, slow_share
from invdyn_cli.diagnosis.decide.gain import gains_of
from invdyn_cli.diagnosis.decide.intervals import intervals
from invdyn_cli.diagnosis.search import naming
from invdyn_cli.diagnosis.search.composed import Refined
from invdyn_cli.diagnosis.search.exact import refine
from invdyn_cli.diagnosis.search.further import acting_of
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import Hypothesis, strain
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.maths.statistics import effective_number
from invdyn_cli.types import Gain

FELT = 0.1
"""Share of an effect's weighted squares that a joint must have to feel it."""

RARE = 0.1
"""Of its mean square, what an effect must have on the held-out rows to be judged there."""

FEW = 2.0
"""Number of blocks that share an effect's squares on the held-out rows evenly, below which these do not judge it: of a
gear's play they have one impact or two, and a model of the load that was not fitted there has it some ms off."""

MISSED = -np.log(0.025)
"""The same for the 95 % interval of a gain: of the draws of blocks behind it, 2.5 % take none of 3.7 blocks."""

AWAY, QUIET, LOUD = 1.0, 3.0, 10.0
"""[s] for which a joint that rests must have the torque that it would have without an effect, for this to have been
away: what is then left is at most QUIET times the noise, and the effect would make LOUD times."""

CLOSE = 0.97
"""Share of what an effect explains from which on a rival is compared beside usual links, too: the rest may be of links
that are believed to be nearer to their URDF than they are."""

DEVIATIONS = 3.0
"""How many standard deviations, between blocks, a gain may be larger than it seems."""


@dataclass(frozen=True)
class Claim:
    """A candidate of a hypothesis that is to be claimed, and what decides whether it may be.

    Attributes:
        hypothesis: all candidates; this one is number `place`.
        whole, chosen: their exact parameters, refined on all rows, and on the data that chose.
        after: (R, n) what the hypothesis leaves.
        beside: candidates that were refused while nothing spoke against this one: what they explain, no rival is to.
    """

    inquiry: Inquiry
    hypothesis: Hypothesis
    place: int
    whole: Refined
    chosen: Refined
    after: np.ndarray
    beside: Hypothesis = ()

    @property
    def candidate(self) -> Candidate:
        return self.hypothesis[self.place]

    @property
    def key(self) -> tuple:
        """The candidate's."""
        return self.candidate.key

    @cached_property
    def before(self) -> np.ndarray:
        """(R, n) what the hypothesis leaves without it."""
        return without(self.inquiry, self.hypothesis, (self.place,), self.after)

    @cached_property
    def rows(self) -> np.ndarray:
        """(R,) bool on which it is judged."""
        return _judging(self.inquiry.evidence, self._squares)

    @cached_property
    def _squares(self) -> np.ndarray:
        """(R,) squares of what it makes, in noise variances."""
        made = (self.after - self.before) * self.inquiry.evidence.valid
        return made**2 @ self.inquiry.noise.weights

    @cached_property
    def saved(self) -> np.ndarray:
        """(n,) squares that it saves on its own joints; on a worn arm on all, because links that take its place are
        felt by others, too."""
        valid = self.inquiry.evidence.valid & self.rows[:, None]
        saved = np.sum((self.before**2 - self.after**2) * valid, axis=0)
        return saved if self.inquiry.wear else saved * self._own

    @property
    def gain(self) -> float:
        """The same in noise variances."""
        return float(np.sum(self.inquiry.noise.weights * self.saved))

    @property
    def gain_on_its_joint(self) -> float:
        """The same on the joint of the effect alone; infinite for one that is of no joint."""
        joint = self.candidate.joint
        return np.inf if joint is None else float(self.inquiry.noise.weights[joint] * self.saved[joint])

    @cached_property
    def gains(self) -> dict[str, Gain]:
        """What it is worth, as the report shows it."""
        return gains_of(self.inquiry.evidence, [self.candidate], self.before, self.after)

    @property
    def least_gain(self) -> float:
        """[N m; N] by how much it lowers the held-out error of a joint at least, by the 95 % interval of the report, on
        the joint where that is most; infinite where no joint's error is another, and for what acts for a time or in
        few blocks: the draws of blocks behind that interval often miss it."""
        if self.candidate.when is not None or _blocks(self.inquiry.evidence, self._squares) < MISSED:
            return np.inf
        return max((one.interval95[0] for one in self.gains.values()), default=np.inf)

    @cached_property
    def unknown(self) -> float:
        """What stays unexplained by the exact formulas on the joints that feel it, in noise variances."""
        evidence, weights = self.inquiry.evidence, self.inquiry.noise.weights
        valid, gains = evidence.valid & self.rows[:, None], weights * np.abs(self.saved)
        unknown = naming.structure(evidence, self.chosen.residual, valid)
        return float(np.sum(weights * unknown * valid.sum(0) * (gains > FELT * gains.max())))

    @cached_property
    def slow_gain(self) -> float:
        """Of what it makes where the arm moves (`slow`), the share that may be saved there, at most: an effect has one
        size at all frequencies. Above, a controller answers to the noise of encoders, and the logged motion has that
        noise, too: what goes with both looks like a delay or a spring (docs/decisions/046). The columns of a gear are
        far from its formula at an impact; there that counts."""
        evidence, joints = self.inquiry.evidence, np.flatnonzero(self._own)
        before, after = self._exactly if self.candidate.effect.yields else (self.before, self.after)
        after, change = (
            np.stack([slow(evidence, x[:, j], int(j), self.candidate.effect.yields) for j in joints], axis=1)
            for x in (after * evidence.valid, (before - after) * evidence.valid)
        )
        weights = self.inquiry.noise.weights[joints]
        saved, made = (2 * after + change) * change @ weights, change**2 @ weights
        each = np.bincount(evidence.block, saved)
        return float((saved.sum() + DEVIATIONS * np.sqrt(len(each)) * np.std(each)) / max(made.sum(), 1e-300))

    @cached_property
    def rivals(self) -> list[naming.Rival]:
        """The best trial of every other effect in its place, those among them that it looks like where its joint moves
        little."""
        inquiry, evidence, own = self.inquiry, self.inquiry.evidence, self.candidate
        alike = own.effect.looks_like(evidence.robot, own.joint)
        like = [kind_of(effect).candidate(evidence, effect, own.joint, at) for effect, at in alike]
        inquiry.judge.refresh()
        every = (*self.hypothesis, *self.beside)
        made = naming.rivals(inquiry.judge, inquiry.always, every, self.place, [*inquiry.pool, *like])
        close = [x.candidate for x in made if not x.equal and x.share > CLOSE and not _both_late(x.candidate, own)]
        if not (inquiry.wear and close):
            return made
        usual = inquiry.beside_usual_links()
        again = naming.rivals(usual.judge, usual.always, every, self.place, close)
        equal = {x.candidate.key: x for x in again if x.equal}
        return [equal.get(x.candidate.key, x) for x in made]

    @cached_property
    def beaten(self) -> float:
        """Held-out loss, beyond its own and by one standard error at most, of the best effect of an impossible size in
        its place: what that surely explains better has no name here."""
        return min((r.excess + r.error for r in self.rivals if r.impossible), default=np.inf)

    @cached_property
    def evidence(self) -> float:
        """Held-out loss of all else by itself, fitted anew, beyond that of the hypothesis, prices included."""
        return self._evidence(self.inquiry.always)

    @cached_property
    def evidence_beside_usual_links(self) -> float:
        """The same where links may be as far off as they usually are."""
        return self._evidence(self.inquiry.always_usual)

    @cached_property
    def slow_evidence(self) -> float:
        """Of its evidence, the share that it saves where the arm moves."""
        one, weights = self.candidate, self.inquiry.noise.weights
        saved = slow_saved(self.inquiry.evidence, one.columns, one.effect.yields, self.before, self.after, weights)
        return self.evidence * slow_share(saved)

    @cached_property
    def was_away(self) -> bool:
        """Whether it was not there while a joint rested that would have felt it: a drive that was weak only while its
        joint moved, which the rows that count do not tell from one that always is."""
        evidence, noise = self.inquiry.evidence, self.inquiry.noise.deviation
        term, filter = term_of(self.inquiry, self.hypothesis, self.place), evidence.recording.filter
        felt = ~evidence.valid & (np.abs(term) > LOUD * noise)
        alone = felt & (np.abs(self.after + term) < QUIET * noise)
        moments = felt.any(axis=1) & np.all(alone | ~felt, axis=1)
        runs = np.split(moments, 1 + np.flatnonzero(np.diff(moments) | (np.diff(evidence.piece) > 0)))
        return any(run[0] and len(run) > AWAY * filter.rate / filter.keep for run in runs)

    @cached_property
    def delay(self) -> float:
        """The least that its own delay [s], of either sign, may be, by its interval; infinite where it has none."""
        return max(self._ends(self.candidate.effect.late_by) * (1, -1))

    @cached_property
    def size(self) -> float:
        """The least that the parameter may be, of either sign and by its interval, that is zero, of a factor one, where
        there is no effect; infinite where it has none such, or a vector."""
        effect = self.candidate.effect
        alone = len(effect.parameters) == 1 and not effect.yields
        name = effect.sized_by or (next(iter(effect.parameters)) if alone else "")
        ends = self._ends(name)
        return max((ends - bool(effect.factor)) * (1, -1)) if ends.ndim == 1 else np.inf

    @cached_property
    def distance(self) -> float:
        """Noise variances by which the force or body that comes and goes differs from none, whatever else may be off;
        infinite for any other effect."""
        at = [k for k, (of, name, _) in enumerate(self.whole.labels) if of == self._number and not name]
        if self.candidate.when is None or not at:
            return np.inf
        theta, root = self.whole.theta[at], self.whole.unknown[:, at]
        return float(theta @ np.linalg.solve(root.T @ root, theta))

    @property
    def lasts(self) -> float:
        """[s] how long its shortest window is, as it was refined; infinite for what always acts."""
        place = self._number
        when = None if place is None else self.whole.acting[place].when
        return np.inf if when is None else min(one.end - one.start for one in when.each)

    @cached_property
    def impossible(self) -> str:
        """Why its exact parameters are physically impossible; "" if they are possible. The search judged those of the
        rows that it used, beside effects that were refused since."""
        place = self._number
        return "" if place is None else self.candidate.effect.refuse(self.whole.acting[place].parameters)

    def _evidence(self, always: Hypothesis) -> float:
        """`evidence` beside what is `always` there."""
        judge, others = self.inquiry.judge, self.hypothesis[: self.place] + self.hypothesis[self.place + 1 :]
        return judge.loss((*always, *others)) - judge.loss((*always, *self.hypothesis))

    def _ends(self, name: str) -> np.ndarray:
        """(2, …) the ends of a parameter's interval; infinite for none."""
        place = self._number
        if not name or place is None:
            return np.full(2, np.inf)
        return np.array(intervals(self.inquiry.evidence, self.whole)[place][name][1:], float)

    @cached_property
    def share_of_residual(self) -> float:
        """By how much its exact formula predicts the logged torque of held-out rows better, the others staying as they
        are, as a share of what is left on the joints that feel it. The linear columns of a drive's gain or delay also
        make the noise of the measured torque smaller; the exact formula does not."""
        evidence, weights = self.inquiry.evidence, self.inquiry.noise.weights
        before, after = (x * evidence.valid for x in self._exactly)
        change = before - after
        rows = _judging(evidence, change**2 @ weights)
        saved = ((2 * after + change) * change) @ weights
        of_joint = np.sum(change[rows] ** 2, axis=0) * weights
        felt = of_joint > FELT * of_joint.sum()
        remains = float(np.sum(after[rows] ** 2 @ (weights * felt)))
        return float(saved[rows].sum()) / max(remains, 1e-300)

    @cached_property
    def _exactly(self) -> tuple[np.ndarray, np.ndarray]:
        """What the exact formulas leave (R, n) without it, the others staying as they are, and with it."""
        others = [a for a in self.whole.acting if a.key != self.key]
        return self.inquiry.model.without(self.whole, others), self.whole.residual

    @property
    def _number(self) -> int | None:
        """Its number among the exact effects, None where the refinement dropped it."""
        return next((k for k, a in enumerate(self.whole.acting) if a.key == self.key), None)

    @property
    def _own(self) -> np.ndarray:
        return np.array([j in self.candidate.columns for j in range(self.inquiry.evidence.dofs)])


def _both_late(one: Candidate, other: Candidate) -> bool:
    """Whether both make a torque late; their exact formulas are compared in the search (`delay_or_lag`)."""
    return bool(one.effect.late_by and other.effect.late_by)


def _judging(evidence: Evidence, squares: np.ndarray) -> np.ndarray:
    """Rows (R,) bool on which an effect with these squares (R,) is judged: the held-out ones, or all if it hardly acts
    on those, or in FEW blocks."""
    rows = judged(evidence)
    often = _blocks(evidence, squares) >= FEW
    return rows if often and np.mean(squares[rows]) >= RARE * np.mean(squares) else np.ones_like(rows)


def _blocks(evidence: Evidence, squares: np.ndarray) -> float:
    """In how many blocks of the held-out rows an effect with these squares (R,) acts."""
    rows = judged(evidence)
    return effective_number(np.bincount(evidence.block[rows], squares[rows]))


def refitted(inquiry: Inquiry, acting: Sequence[EffectInstance], rows: np.ndarray) -> Refined:
    return refine(inquiry.evidence, inquiry.model, acting, rows, inquiry.noise.weights, inquiry.beside(acting))


def exactly(inquiry: Inquiry, hypothesis: Hypothesis, before: Refined, rows: np.ndarray) -> Refined:
    """The exact parameters of a hypothesis on some rows (R,) bool, from where they were `before` if they were; that
    itself if it has them all."""
    if {a.key for a in before.acting} == {c.key for c in hypothesis}:
        return before
    known = {a.key: a for a in before.acting}
    start = acting_of(inquiry.judge, inquiry.beside(hypothesis), hypothesis)
    return refitted(inquiry, [known.get(a.key, a) for a in start], rows)


def left(inquiry: Inquiry, hypothesis: Hypothesis) -> np.ndarray:
    """Residual (R, n) of a hypothesis fitted on the data that chose."""
    every = (*inquiry.always, *hypothesis)
    return inquiry.evidence.residual(every, inquiry.judge.verdict(every).theta)


def without(inquiry: Inquiry, hypothesis: Hypothesis, places: Collection[int], after: np.ndarray) -> np.ndarray:
    """Residual (R, n) of a hypothesis, which leaves `after`, without the candidates at these places: all else is fitted
    anew. Where that is mostly links that would be off by more than is believed of them, all else stays as it is: the
    data do not tell them from a load."""
    others = tuple(c for k, c in enumerate(hypothesis) if k not in places)
    fitted = left(inquiry, others)
    strained = _strain(inquiry, others) - _strain(inquiry, hypothesis)
    missed = (fitted**2 - after**2) * (inquiry.evidence.valid & judged(inquiry.evidence)[:, None])
    if strained <= np.sum(missed @ inquiry.noise.weights):
        return fitted
    return after + np.sum([term_of(inquiry, hypothesis, k) for k in places], axis=0)


def term_of(inquiry: Inquiry, hypothesis: Hypothesis, place: int) -> np.ndarray:
    """(R, n) what one candidate of a hypothesis adds to the logged torque."""
    evidence, every = inquiry.evidence, (*inquiry.always, *hypothesis)
    own = [theta for _, theta in shared_out(every, inquiry.judge.verdict(every).theta)][len(inquiry.always) + place]
    return evidence.residual((), own) - evidence.residual((hypothesis[place],), own)


def _strain(inquiry: Inquiry, hypothesis: Hypothesis) -> float:
    """`judge.strain` beside a hypothesis."""
    return strain(inquiry.always, inquiry.judge.verdict((*inquiry.always, *hypothesis)).theta)
