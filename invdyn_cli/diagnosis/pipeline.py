"""From a log to a diagnosis: case, search, names, the written model, and what is left."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invdyn_cli import leftovers
from invdyn_cli.diagnosis import (
    extension,
    gains,
    one_link,
    rattling,
    repeats,
    since,
    standard,
    transition,
    wear,
    yielding,
)
from invdyn_cli.diagnosis.case import Case, Options, prepared
from invdyn_cli.diagnosis.checks.offset import TimeOffset
from invdyn_cli.diagnosis.columns.candidates import add_loaded
from invdyn_cli.diagnosis.columns.evidence import Evidence, held_out, judged
from invdyn_cli.diagnosis.decide import findings, lateness, sums, unclaimed, unexplained, wording
from invdyn_cli.diagnosis.decide.gain import lowers
from invdyn_cli.diagnosis.decide.refusals import REFUSALS, Refusal
from invdyn_cli.diagnosis.doctor import CHECKS
from invdyn_cli.diagnosis.residual_tests import residual_tests, structured
from invdyn_cli.diagnosis.search import moments
from invdyn_cli.diagnosis.search.composed import Model
from invdyn_cli.diagnosis.search.inquiry import Inquiry, Question
from invdyn_cli.diagnosis.search.judge import Hypothesis
from invdyn_cli.diagnosis.search.whole import inquire
from invdyn_cli.diagnosis.standard_columns import LINK, Columns
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import LogError
from invdyn_cli.interfaces import AbstractCheck, AbstractEffect, AbstractModel, Progress, silent
from invdyn_cli.log import Log, Window
from invdyn_cli.maths import metrics
from invdyn_cli.maths.threads import one_blas_thread
from invdyn_cli.recording.channels import in_newton_metres
from invdyn_cli.types import Diagnosis, Finding, Robot, Signals


def diagnose(
    log: Log,
    robot: Robot,
    *,
    windows: Mapping[str, Sequence[Window]] | None = None,
    reference: Log | None = None,
    options: Options | None = None,
    effects: Mapping[str, AbstractEffect] = EFFECTS,
    learner: AbstractModel | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> Diagnosis:
    """What the nominal model of a robot gets wrong on a log, why, and what correcting it is worth.

    Args:
        log: one robot's trajectories, as read (`logfile.read_log(path, check=False)`), defects and all.
        robot: its nominal model, from a URDF.
        windows: role -> stretches (trajectory, start, end [s]): "train" chooses, "test" judges, "reference" is compared
            with; None: the first 70 % of each trajectory's time chooses.
        reference: an earlier log of the same robot: what has changed since is looked for, and nothing else.
        options: what is known, how many causes, rates and filters.
        effects: the causes to look for.
        learner: a model that measures what is left unexplained; None: small nets.

    Raises:
        UsageError: for options that make no sense.
        RobotError: if the robot has other joints than the log.
    """
    leftovers.clear()
    options = options or Options()

    def asked(checks: Sequence[AbstractCheck], progress: Progress) -> Diagnosis:
        case = prepared(log, robot, windows, reference, options, effects, progress, checks)
        if isinstance(case, Diagnosis):
            return case
        return decided(*_found(case, progress), options, learner, seed, progress)

    with one_blas_thread():
        first = asked(CHECKS, progress)
        if not lateness.shifted_wrongly(first.findings, {**EFFECTS, **effects}, first.examination, robot.dofs):
            return first
        untimed = [check for check in CHECKS if not isinstance(check, TimeOffset)]
        again = asked(untimed, lambda done, note: progress(0.9, f"again, torques at the times of the log: {note}"))
        return replace(again, notes=(lateness.NOT_SHIFTED, *again.notes))


def _found(case: Case, progress: Progress) -> tuple[Case, Inquiry, Columns]:
    """What the search found, again where friction turns out to change its side more or less gradually."""
    found = searched(case, progress)
    gradual = _gradual(*found)
    if gradual != case.recording.transition:
        case = case.with_transition(gradual)
        earlier, why = (found[0] if found[0].wear else None), "friction that changes side gradually"
        found = searched(case, lambda done, note: progress(0.7, f"{note}, {why}"), earlier)
    return case, *found


def _gradual(inquiry: Inquiry, columns: Columns) -> tuple[float, ...]:
    """How gradually friction changes its side beside what was found, where that tells it."""
    acting = inquiry.chosen.acting
    jumping = [a for a in acting if a.effect.jumps and not a.effect.coupled and a.when is None]
    rest = [a for a in acting if a not in jumping and a.effect is not LINK]
    return transition.speeds(columns.behind(rest), inquiry.model.residual(rest), jumping)


def searched(case: Case, progress: Progress = silent, earlier: Inquiry | None = None) -> tuple[Inquiry, Columns]:
    """The search, beside the standard model where the arm is worn; and the standard model's columns. What an `earlier`
    search beside the standard model came to on the same log is where it starts: the arm is worn then."""
    progress(0.5, "search")
    plain = Question(
        case.effects, case.most, case.allowed, case.compares, case.log.torque_side, case.split,
        told=lambda number: progress(0.5, f"search, effects so far: {number}"),
    )  # fmt: skip

    def asked(evidence: Evidence, links: Hypothesis, start: Hypothesis = ()) -> Inquiry:
        return inquire(evidence, replace(plain, wear=links), start)

    columns = case.columns
    fitted = None if case.compares else wear.plain(columns, yielding.left(columns, case.gear))
    if fitted is not None:
        return asked(*wear.beside(columns, yielding.believable(columns, case.gear, fitted))), columns
    if earlier is not None and (fitted := wear.of(columns, replace(earlier, model=Model(case.evidence)))) is not None:
        return asked(*wear.beside(columns, fitted, earlier.noise.weights, earlier.chosen.acting)), columns
    add_loaded(case.evidence)
    if case.compares:
        case.evidence.candidates = since.candidates(case.evidence, columns)
    inquiry = inquire(case.evidence, plain)
    if case.compares:
        return inquiry, replace(columns, evidence=inquiry.evidence)  # which knows that channels changed since
    fitted = wear.of(columns, inquiry)
    if fitted is not None:
        again = asked(*wear.beside(columns, fitted, inquiry.noise.weights, inquiry.chosen.acting))
        worn = wear.is_worn(again, inquiry.hypothesis)
        if worn and np.any(again.noise.plainly_below(inquiry.noise)):
            inquiry = inquire(case.evidence, replace(plain, heard=again.noise))
            worn = wear.is_worn(again, inquiry.hypothesis)
        inquiry = again if worn else inquiry
    return inquiry, columns


def decided(
    case: Case,
    inquiry: Inquiry,
    columns: Columns,
    options: Options,
    learner: AbstractModel | None = None,
    seed: int = 0,
    progress: Progress = silent,
    refusals: Sequence[Refusal] = REFUSALS,
) -> Diagnosis:
    """What may be claimed of what the search found, the model that is written, and what is left."""
    evidence, effects, robot = inquiry.evidence, case.effects, inquiry.evidence.robot
    of_name = {**EFFECTS, **effects}  # standard terms may be claimed that `effects` lacks
    side, position_side = case.log.torque_side, case.log.position_side
    progress(0.75, "names")
    unsure = () if case.compares else wear.unsure_links(columns, inquiry)
    made = findings.report(inquiry, effects, case.examination, side, position_side, unsure, refusals)
    made = since.retold(inquiry, columns, made)
    more = standard.beside(columns, evidence, made)
    if inquiry.wear:  # then standard terms are in every hypothesis, and not among its findings
        there = {(f.effect, f.joint) for f in made.findings[: len(made.terms)]}
        terms, torques = standard.claims(evidence, more, there)
        told = [findings.perhaps_stribeck(inquiry, made.hypothesis, x) for x in sums.uneven(effects, terms)]
        every = [*zip(told, torques, strict=True), *one_link.claimed(evidence, more, made.whole, made.acting)]
        every.sort(key=lambda x: -lowers([x[0]]))
        made = findings.joined(made, [x for x, _ in every], [x for _, x in every])
    left = more.residual if inquiry.wear else made.residual
    learned = unexplained.shares(evidence, left, learner, seed)
    learned = np.where(inquiry.noise.deviation > 0, learned, np.nan)  # what hardly moves was not judged
    structured_joints = unexplained.beyond_noise(evidence, left, judged(evidence))
    few = moments.moments(evidence, left)
    rare = np.array([few[j].torque if j in few else 0.0 for j in range(robot.dofs)])
    shares = {j: float(x) for j, x in zip(robot.joints, learned, strict=True)}
    unknown = dict(zip(robot.joints, np.where(structured_joints, 1.0, learned), strict=True))
    made = replace(made, findings=unexplained.in_doubt(made.findings, of_name, unknown))
    made = replace(made, findings=lateness.taken_back(made.findings, of_name, case.examination))
    made = made if case.compares else rattling.told(evidence, made, more, effects)
    progress(0.9, "model")
    written, unnamed = (more, ()) if case.compares else _fuller(inquiry, columns, made, more, unsure)
    model = _written(case, written)
    again, why = _replay(model, case, progress) if options.replay else (None, ())
    rest = made.residual if case.compares else more.residual  # of a change, beside what both logs show
    tests = residual_tests(evidence, rest, effects.values(), more.acting)
    floor = repeats.floor_of_repeats(evidence.recording)
    claimed = () if case.compares else made.findings  # a change is no term
    named = {(f.effect, f.joint): f.alternatives for f in claimed if f.status in wording.CLAIMS and f.window is None}
    diagnosis = Diagnosis(
        verdict=wording.verdict(
            made,
            learned,
            structured_joints,
            np.maximum(structured(tests, robot.joints), rare),
            floor,
            _scores(evidence, rest),
        ),
        examination=case.examination,
        findings=made.findings,
        baseline=_scores(evidence, more.before),
        extended=_scores(evidence, written.residual),
        baselines={
            name: _scores(evidence, x) for name, x in standard.baselines(columns, evidence, more.before).items()
        },
        standard=standard.told(evidence, more, named, since.each_log(evidence, made, more)),
        unclaimed=unnamed,
        tests=tests,
        noise_floor=None
        if floor is None
        else {j: {"rmse": float(x)} for j, x in zip(robot.joints, floor, strict=True)},
        unexplained=shares,
        model=model,
        signals=_signals(evidence, made, written),
        replay=again,
        notes=(
            *case.notes,
            *(() if case.compares else extension.beside_dynamics(model)),  # a change is not all of its friction
            *transition.note_of(robot, case.recording.transition),
            *(x.told for x in made.refused if x.told),
            *made.notes,
            *lateness.note_of(made.findings, effects),
            *repeats.note_of(evidence.recording),
            *why,
        ),
        details=_details(case, inquiry, made, few, structured_joints),
    )
    diagnosis = diagnosis if case.gained is None else gains.beside(diagnosis, case.gained)
    return replace(diagnosis, summary=wording.summary(diagnosis, of_name))


def _details(
    case: Case, inquiry: Inquiry, made: findings.Made, few: Mapping[int, moments.Moment], beyond: np.ndarray
) -> dict[str, Any]:
    """Numbers worth keeping. `few`: when the residual of a joint is largest; `beyond` (n,): whether it is no noise."""
    evidence, robot = inquiry.evidence, inquiry.evidence.robot
    return {
        **evidence.recording.details,
        "torque_side": case.log.torque_side,
        "time_taken_out_s": case.lead,
        "friction_transition": dict(zip(robot.joints, case.recording.transition, strict=True)),
        "samples": len(evidence.role),
        "blocks": int(evidence.block.max() + 1),
        "hypotheses_tried": inquiry.judge.tried,
        "moments": {robot.joints[j]: x._asdict() for j, x in few.items()},
        "beyond_noise": [j for j, x in zip(robot.joints, beyond, strict=True) if x],
        "refused": [
            {
                "effect": x.candidate.effect.name,
                "joint": None if x.candidate.joint is None else robot.joints[x.candidate.joint],
                "criterion": x.criterion,
                "figure": x.figure,
                "required": x.required,
            }
            for x in made.refused
        ],
        "noise_N_m": dict(zip(robot.joints, inquiry.noise.deviation.round(9).tolist(), strict=True)),
        **({wording.SINCE: [_scores(evidence, x) for x in (made.before, made.residual)]} if case.compares else {}),
    }


def _fuller(
    inquiry: Inquiry, columns: Columns, made: findings.Made, more: standard.Beside, unsure: Hypothesis
) -> tuple[standard.Beside, tuple[Finding, ...]]:
    """The standard model beside all torques that were found, claimed or not, and the findings that are not, where
    held-out data are predicted better so: of each joint with what acts on it, and of all joints together; else beside
    the claims alone (docs/decisions/048)."""
    evidence, found = inquiry.evidence, unclaimed.unclaimed(inquiry, made)
    if not held_out(evidence):
        return more, ()
    before = standard.errors(evidence, more.residual)
    while found:
        every, told = unclaimed.together(inquiry, made, found, unsure)
        fuller = standard.beside(columns, evidence, every)
        gain = before - standard.errors(evidence, fuller.residual)
        kept = tuple(c for c in found if c.effect.reaches_others or c.joint is None or gain[c.joint] > 0)
        if len(kept) == len(found):
            return (fuller, told) if np.mean(gain) > 0 else (more, ())
        found = kept
    return more, ()


def _written(case: Case, more: standard.Beside) -> ExtendedModel:
    """The extended model: what is known, what was found, and every standard term."""
    filter = more.columns.evidence.recording.filter
    return ExtendedModel(
        robot=case.robot,
        acting=(*case.facts, *more.acting),
        intervals=({},) * len(case.facts) + more.intervals,
        filter={"kind": "zero-phase Butterworth", "order": 4, "cutoff_Hz": list(filter.cutoffs)},
        provenance={
            "log": case.log.source,
            "robot": case.log.robot,
            "trajectories": [x.name for x in case.log.trajectories],
            "corrections": list(case.corrected),
            "as_recorded": case.examination.as_recorded,
            **({} if case.gained is None else {"drive_gains": case.gained.told()}),
        },
        transition=case.recording.transition,
    )


def _replay(model: ExtendedModel, case: Case, progress: Progress) -> tuple[Any, tuple[str, ...]]:
    """The simulated arm beside the log; or None, and why."""
    apart = case.gained is not None and not case.gained.known.all()
    why = extension.why_not(case.log if apart else in_newton_metres(case.log))
    if not why:
        try:
            stretches = extension.stretches_of(case.log, model.robot, case.recording, case.lead)
            return extension.replayed(model, stretches, lambda done, note: progress(0.9 + 0.1 * done, note)), ()
        except LogError as error:
            why = str(error)
    return None, (f"The log was not replayed in the simulation: {why}.",)


def _scores(evidence: Evidence, residual: np.ndarray) -> dict[str, dict[str, float]]:
    """Held-out error of every joint of a model that leaves this `residual` (R, n)."""
    rows = judged(evidence)
    tau, made = evidence.tau[rows], (evidence.tau - residual)[rows]
    both = metrics.rmse(tau, made).tolist(), metrics.nmse(tau, made).tolist()
    return {joint: {"rmse": r, "nmse": n} for joint, r, n in zip(evidence.robot.joints, *both, strict=True)}


def _signals(evidence: Evidence, made: findings.Made, more: standard.Beside) -> Signals:
    return Signals(
        trajectory=evidence.trajectory,
        t=evidence.on_rows("t"),
        q=evidence.on_rows("q"),
        qd=evidence.on_rows("qd"),
        qdd=evidence.on_rows("qdd"),
        tau=evidence.tau,
        nominal=evidence.tau - more.before,
        extended=evidence.tau - more.residual,
        terms=made.terms,
        valid=evidence.valid,
        held_out=evidence.of_role("test"),
    )
