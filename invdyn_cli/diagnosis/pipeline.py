"""From a log to a diagnosis: doctor, evidence, search, names, gains, and what is left."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from invdyn_cli import compiled
from invdyn_cli.diagnosis import doctor, extension, gains, known, repeats, standard
from invdyn_cli.diagnosis.columns import hold
from invdyn_cli.diagnosis.columns.candidates import gather
from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.decide import findings, unexplained, wording
from invdyn_cli.diagnosis.decide.support import judged
from invdyn_cli.diagnosis.residual_tests import residual_tests, structured
from invdyn_cli.diagnosis.search.inquiry import Inquiry, inquire
from invdyn_cli.diagnosis.search.judge import Hypothesis
from invdyn_cli.effects.actuator import TorqueGainError
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import rigid_torque
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import LogError, listed
from invdyn_cli.interfaces import AbstractEffect, AbstractModel, Progress, silent
from invdyn_cli.log import Log, Window
from invdyn_cli.maths import metrics
from invdyn_cli.recording.channels import in_newton_metres
from invdyn_cli.recording.pieces import ROLES, Preparation, Recording, prepare
from invdyn_cli.types import Diagnosis, Examination, Motion, Robot, Signals

AS_RECORDED = "correct=false: the log was diagnosed as recorded, nothing in it was corrected"


@dataclass(frozen=True)
class Options:
    """What a user may choose.

    Attributes:
        known: causes that are known already: {"effect", "joint", parameters …}, taken as they are; without parameters,
            "effect" or "effect@joint", allowed for and not reported.
        most: effects that a diagnosis names at most; null: three for each joint.
        conditioning: rates and filters.
        replay: whether the simulated arm is played beside the log, before and after.
        correct: False: the log is diagnosed as recorded; nothing in it is corrected, and what fails a check makes it
            unusable.
    """

    known: Sequence[Any] = ()
    most: int | None = None
    conditioning: Preparation = field(default_factory=Preparation)
    replay: bool = False
    correct: bool = True


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
    compiled.drop_many()
    options = options or Options()
    gained, log, reference = _gained(log, reference, robot, windows, options)
    log, examination = doctor.correct(log, robot, change=options.correct)
    if not examination.usable:
        return _unusable(examination, () if options.correct else (AS_RECORDED,))
    notes = doctor.done(examination)
    corrected = (*log.history, *notes)
    notes = notes if options.correct else (AS_RECORDED,)
    notes = notes if gained is None else (gained.note(), *notes)
    progress(0.1, "checked")
    if reference is not None:
        log, windows, more = _beside(log, reference, robot, windows, options)
        notes += more
    side = log.torque_side
    try:
        pool = {name: e for name, e in effects.items() if name not in log.compensated}
        inertia = _typical_inertia(robot)
        recording = prepare(in_newton_metres(log), inertia, windows, options.conditioning)
    except LogError as error:
        return _unusable(examination, (*notes, str(error)))
    facts, allowed = known.read(options.known, effects, robot)
    nominal, measured = robot, recording
    recording, robot = known.taken_out(recording, nominal, facts, gravity="gravity" in log.compensated)
    recording, common = hold.remove_common_delay(robot, recording, side)
    progress(0.25, "columns")
    evidence = gather(robot, recording, list(pool.values()), side, log.position_side)
    evidence.given = known.timed(evidence, facts)
    progress(0.5, "search")
    most = 3 * robot.dofs if options.most is None else options.most
    compares = any("reference" in p.role for p in recording.pieces)

    def asked(evidence: Evidence, wear: Hypothesis = (), start: Hypothesis = ()) -> Inquiry:
        return inquire(evidence, pool, allowed, most, compares, side, windows is not None, wear, start)

    columns = standard.columns_of(evidence, side)
    wear = None if compares else standard.plain_wear(columns)
    if wear is not None:
        inquiry = asked(*standard.beside_wear(columns, wear, standard.weights_of(evidence)))
    else:
        inquiry = asked(evidence)
        wear = None if compares else standard.wear_of(columns, inquiry)
        if wear is not None:
            progress(0.65, "search with link errors")
            found = inquiry.chosen.acting
            again = asked(*standard.beside_wear(columns, wear, inquiry.noise.weights, found))
            inquiry = again if standard.is_worn(again, inquiry.hypothesis) else inquiry
    evidence = inquiry.evidence
    progress(0.75, "names")
    unsure = () if compares else standard.unsure_links(columns, inquiry)
    made = findings.report(inquiry, pool, examination, side, log.position_side, unsure)
    more = standard.beside(columns, evidence, made)
    if inquiry.wear:  # then standard terms are in every hypothesis, and not among its findings
        there = {(f.effect, f.joint) for f in made.findings[: len(made.terms)]}
        made = findings.joined(made, *standard.claims(evidence, more, there))
    left = more.residual if inquiry.wear else made.residual
    learned = unexplained.shares(evidence, left, learner, seed)
    learned = np.where(inquiry.noise.deviation > 0, learned, np.nan)  # what hardly moves was not judged
    structured_joints = unexplained.beyond_noise(evidence, left, judged(evidence))
    shares = {j: float(x) for j, x in zip(robot.joints, learned, strict=True)}
    made = replace(made, findings=findings.in_doubt(made.findings, effects, shares))
    progress(0.9, "model")
    named = {(f.effect, f.joint) for f in made.findings if f.status == "named" and not compares}  # a change is no term
    model = ExtendedModel(
        robot=nominal,
        acting=(*facts, *more.acting),
        intervals=({},) * len(facts) + more.intervals,
        filter={"kind": "zero-phase Butterworth", "order": 4, "cutoff_Hz": list(recording.filter.cutoffs)},
        provenance={
            "log": log.source,
            "robot": log.robot,
            "trajectories": [x.name for x in log.trajectories],
            "corrections": list(corrected),
            "as_recorded": not options.correct,
            **({} if gained is None else {"drive_gains": gained.told()}),
        },
    )
    apart = gained is not None and not gained.known.all()
    again, why = _replay(model, log, measured, common, progress, apart) if options.replay else (None, ())
    rest = made.residual if compares else more.residual  # of a change, beside what both logs show
    tests = residual_tests(evidence, rest, pool.values(), more.acting)
    floor = repeats.floor_of_repeats(recording)
    diagnosis = Diagnosis(
        verdict=wording.verdict(
            made, learned, structured_joints, structured(tests, robot.joints), floor, _scores(evidence, rest)
        ),
        examination=examination,
        findings=made.findings,
        baseline=_scores(evidence, more.before),
        extended=_scores(evidence, more.residual),
        baselines={name: _scores(evidence, x) for name, x in more.baselines.items()},
        standard=standard.told(evidence, more, named),
        tests=tests,
        noise_floor=None
        if floor is None
        else {j: {"rmse": float(x)} for j, x in zip(robot.joints, floor, strict=True)},
        unexplained=shares,
        model=model,
        signals=_signals(evidence, made, more),
        replay=again,
        notes=(*notes, *recording.notes, *made.notes, *why),
        details={
            **recording.details,
            "time_taken_out_s": common,
            "samples": len(evidence.role),
            "blocks": int(evidence.block.max() + 1),
            "hypotheses_tried": inquiry.judge.tried,
            "beyond_noise": [j for j, x in zip(robot.joints, structured_joints, strict=True) if x],
            "noise_N_m": dict(zip(robot.joints, inquiry.noise.deviation.round(9).tolist(), strict=True)),
        },
    )
    diagnosis = diagnosis if gained is None else gains.beside(diagnosis, gained)
    return replace(diagnosis, summary=wording.summary(diagnosis, {name: e.title for name, e in effects.items()}))


def _gained(
    log: Log, reference: Log | None, robot: Robot, windows, options: Options
) -> tuple[gains.Gains | None, Log, Log | None]:
    """The log and its reference with drive gains that the log's masses tell, where it has currents and says none. A
    wrong gain is not looked for then: all of them are fitted."""
    if not gains.lacks(log):
        return None, log, reference
    corrected, _ = doctor.correct(log, robot, change=options.correct)
    try:
        found = gains.estimated(corrected, robot, _typical_inertia(robot), windows, options.conditioning)
    except (LogError, ValueError):
        return None, log, reference  # the doctor says why
    if not found.known.any():
        return None, log, reference
    log = replace(log, drive_gain=found.value, compensated=(*log.compensated, TorqueGainError.name))
    if reference is not None and gains.lacks(reference):
        reference = replace(reference, drive_gain=found.value)
    return found, log, reference


def _replay(
    model: ExtendedModel, log: Log, recording: Recording, lead: float, progress: Progress, apart: bool
) -> tuple[Any, tuple[str, ...]]:
    """The simulated arm beside the log; or None, and why."""
    why = extension.why_not(log if apart else in_newton_metres(log))
    if not why:
        try:
            stretches = extension.stretches_of(log, model.robot, recording, lead)
            return extension.replayed(model, stretches, lambda done, note: progress(0.9 + 0.1 * done, note)), ()
        except LogError as error:
            why = str(error)
    return None, (f"The log was not replayed in the simulation: {why}.",)


def _scores(evidence: Evidence, residual: np.ndarray) -> dict[str, dict[str, float]]:
    """Held-out error of every joint of a model that leaves this `residual` (R, n)."""
    rows, scores = judged(evidence), {}
    for j, name in enumerate(evidence.robot.joints):
        tau, left = evidence.tau[rows, j], residual[rows, j]
        scores[name] = {
            "rmse": float(metrics.rmse(tau[:, None], (tau - left)[:, None])[0]),
            "nmse": float(metrics.nmse(tau[:, None], (tau - left)[:, None])[0]),
        }
    return scores


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
        held_out=evidence.role == ROLES.index("test"),
    )


def _typical_inertia(robot: Robot) -> np.ndarray:
    """Inertia (n,) that each joint carries in a typical posture [kg m^2; kg]: its torque for unit acceleration."""
    draw = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.lower), robot.lower, -1.0)
    high = np.where(np.isfinite(robot.upper), robot.upper, 1.0)
    q = draw.uniform(low[:, None], high[:, None], (robot.dofs, 32))
    weightless = replace(robot, gravity=np.zeros(3))
    inertia = np.zeros(robot.dofs)
    for j in range(robot.dofs):
        unit = np.zeros_like(q)
        unit[j] = 1.0
        inertia[j] = np.median(rigid_torque(weightless, Motion(q, 0 * q, unit))[j])
    return inertia


def _beside(log: Log, reference: Log, robot: Robot, windows, options: Options):
    """The log with the reference's trajectories beside its own, in a role of their own."""
    reference, examination = doctor.correct(reference, robot, change=options.correct)
    if not examination.usable:
        failed = [c.seen for c in examination.checks if c.severity == "fail"]
        raise LogError(f"the reference cannot be used: {listed(failed)}", advice="another data.reference")
    reference, log = in_newton_metres(reference), in_newton_metres(log)
    if windows is None:
        share = options.conditioning.train_share
        cuts = {x.name: x.t[0] + share * (x.t[-1] - x.t[0]) for x in log.trajectories}
        windows = {
            "train": [(name, -np.inf, cut) for name, cut in cuts.items()],
            "test": [(name, cut, np.inf) for name, cut in cuts.items()],
        }
    renamed = tuple(replace(x, name=f"reference/{x.name}") for x in reference.trajectories)
    windows = {**windows, "reference": [(x.name, -np.inf, np.inf) for x in renamed]}
    return replace(log, trajectories=(*log.trajectories, *renamed)), windows, doctor.done(examination)


def _unusable(examination: Examination, notes: Sequence[str]) -> Diagnosis:
    failed = [c for c in examination.checks if c.severity == "fail"]
    advice = [failed[0].advice, *["correct=true"] * examination.as_recorded] if failed else []
    why = failed[0].seen if failed else (notes[-1] if notes else "no trajectory is left")
    return Diagnosis(
        verdict="log_unusable",
        examination=examination,
        findings=(),
        baseline={},
        extended={},
        noise_floor=None,
        unexplained={},
        summary=f"This log cannot be diagnosed: {why.rstrip('.')}."
        + (f" Try: {'; or '.join(advice)}." if advice else ""),
        notes=tuple(notes),
    )
