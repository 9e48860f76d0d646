"""What a search is asked, and what it comes to: a hypothesis, its exact parameters, and all that it is judged with."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.interfaces import AbstractEffect


@dataclass(frozen=True)
class Question:
    """What a search is asked.

    Attributes:
        effects: the causes to look for.
        most: effects at most.
        allowed: (effect, joint or None for all) that are allowed for and not reported.
        compares: whether the recording has a reference beside it.
        side: the torque's.
        parted: whether a user said what chooses and what judges; it then stays so.
        wear: links that are some percent off. They are then part of every hypothesis, and so are friction, offset and
            rotor of every joint; none of these is looked for.
        heard: noise that another hypothesis leaves: a model of all columns may leave far more on a short log.
        told: is called with the number of effects of every hypothesis that is refined.
    """

    effects: Mapping[str, AbstractEffect]
    most: int
    allowed: Sequence[tuple[str, int | None]] = ()
    compares: bool = False
    side: str = "unknown"
    parted: bool = True
    wear: Hypothesis = ()
    heard: Noise | None = None
    told: Callable[[int], None] = lambda number: None


@dataclass(frozen=True)
class Inquiry:
    """What the search came to: the hypothesis with its trials, its exact parameters on the data that chose (`chosen`)
    and on all data (`whole`), and all that rivals are judged with. `close` says of a delay or lag whether the other
    does as well; `wear` are the last of `always`: the standard model, friction, offsets, rotors and links that are some
    percent off, if it is part of every hypothesis."""

    evidence: Evidence
    judge: HypothesisScorer
    model: Model
    noise: Noise
    always: Hypothesis
    hypothesis: Hypothesis
    pool: Sequence[Candidate]
    chosen: Refined
    whole: Refined
    close: Mapping[tuple[str, int | None], bool]
    wear: Hypothesis

    def beside(self, found: Sequence[Candidate | EffectInstance]) -> Hypothesis:
        """`always` as it is refined beside these."""
        return beside(self.always, self.wear, found)

    @cached_property
    def always_usual(self) -> Hypothesis:
        """`always` with links that may be as far off as those of URDFs usually are, or as the search believed where
        that is more. Its belief was chosen with its hypothesis: beside a payload that is none it is less than is true.
        """
        of_links = [c for c in self.wear if c.joint is None]
        return tuple(replace(c, precision=np.minimum(c.precision, 1)) if c in of_links else c for c in self.always)

    def beside_usual_links(self) -> "Inquiry":
        """The same inquiry with `always_usual`: where such links refuse one effect, they judge the others, too."""
        always, noise = self.always_usual, self.noise
        judge = HypothesisScorer(self.evidence, self.judge.rows, noise.weights, noise.deviation, always, True)
        return replace(self, always=always, judge=judge, wear=always[len(always) - len(self.wear) :])

    def worn(self, refined: Refined) -> np.ndarray:
        """(R, n) logged torque of the standard model beside these effects, which is not in their residual."""
        wear = apart(self.wear, refined.acting)
        return self.model.allowed(refined, refined.acting, sum(len(c.precision) for c in wear))


def beside(always: Hypothesis, wear: Hypothesis, found: Sequence[Candidate | EffectInstance]) -> Hypothesis:
    """What is always there, the standard model (the last of it) only as far as it is no part of what was found."""
    return (*always[: len(always) - len(wear)], *apart(wear, found))


def apart(wear: Hypothesis, found: Sequence[Candidate | EffectInstance]) -> Hypothesis:
    """What is worn beside what was found, which may have a standard term as its special case: a Stribeck friction has
    its own Coulomb level. Bristles may stand beside rigid friction."""
    general = [x for x in found if not x.effect.contains_as_limit]
    return tuple(c for c in wear if not any(x.joint == c.joint and c.effect.name in x.effect.contains for x in general))
