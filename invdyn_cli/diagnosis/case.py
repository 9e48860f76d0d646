"""What a diagnosis works on: the corrected log in rows, what is known taken out, and the columns of every effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis import band, doctor, gains, known, transition, yielding
from invdyn_cli.diagnosis.columns import hold
from invdyn_cli.diagnosis.columns.candidates import gather, shown_by
from invdyn_cli.diagnosis.columns.evidence import Evidence, started
from invdyn_cli.diagnosis.standard_columns import Columns, columns_of
from invdyn_cli.effects.actuator import TorqueGainError
from invdyn_cli.effects.composition import EffectInstance, inertia_column
from invdyn_cli.errors import LogError, listed
from invdyn_cli.interfaces import AbstractCheck, AbstractEffect, Progress, silent
from invdyn_cli.log import Log, Window
from invdyn_cli.recording.channels import in_newton_metres
from invdyn_cli.recording.pieces import Preparation, Recording, prepare
from invdyn_cli.types import Diagnosis, Examination, Robot

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


@dataclass(frozen=True)
class Case:
    """One question to a log.

    Attributes:
        log: corrected, with a reference's trajectories beside its own where there is one.
        robot: the nominal model.
        examination: what the doctor said of the log.
        recording: the log in rows, before what is known was taken out.
        evidence: rows and columns without it.
        columns: those of the standard model on its rows.
        effects: the causes to look for, by name.
        facts: effects that are known, with their sizes.
        allowed: (effect, joint) that may be there and are not reported.
        gear: that beside which the standard model is fitted at first, if any.
        most: effects that are named at most.
        lead: [s] the delay that all joints share, which was taken out.
        split: whether a user said which windows choose and which judge.
        gained: drive gains that the log's masses tell, if it says none.
        notes, corrected: sentences for the report, and for the model's provenance.
    """

    log: Log
    robot: Robot
    examination: Examination
    recording: Recording
    evidence: Evidence
    columns: Columns
    effects: Mapping[str, AbstractEffect]
    facts: Sequence[EffectInstance]
    allowed: Sequence[tuple[str, int | None]]
    gear: EffectInstance | None
    most: int
    lead: float
    split: bool
    gained: gains.Gains | None
    notes: tuple[str, ...]
    corrected: tuple[str, ...]

    @property
    def compares(self) -> bool:
        """Whether only what has changed since a reference is looked for."""
        return any("reference" in p.role for p in self.recording.pieces)

    def with_transition(self, speeds: tuple[float, ...]) -> "Case":
        """The same with friction that changes its side so gradually."""
        recording = replace(self.evidence.recording, transition=speeds)
        evidence = _gathered(self.evidence.robot, recording, self.log, self.effects, self.facts, self.gear)
        return replace(
            self,
            recording=replace(self.recording, transition=speeds),
            evidence=evidence,
            columns=columns_of(evidence, self.log.torque_side),
        )


def prepared(
    log: Log,
    robot: Robot,
    windows: Mapping[str, Sequence[Window]] | None,
    reference: Log | None,
    options: Options,
    effects: Mapping[str, AbstractEffect],
    progress: Progress = silent,
    checks: Sequence[AbstractCheck] = doctor.CHECKS,
) -> Case | Diagnosis:
    """The case of a log, or why it cannot be diagnosed. Arguments and errors as `pipeline.diagnose`'s; `checks` correct
    the log."""
    gained, log, reference = _gained(log, reference, robot, windows, options, checks)
    log, examination = doctor.correct(log, robot, checks, change=options.correct)
    if not examination.usable:
        return _unusable(examination, () if options.correct else (AS_RECORDED,))
    notes = doctor.done(examination)
    corrected = (*log.history, *notes)
    notes = (*_of_gains(log, gained), *doctor.doubts(examination), *(notes if options.correct else (AS_RECORDED,)))
    progress(0.1, "checked")
    split = windows is not None
    if reference is not None:
        log, windows, more = _beside(log, reference, robot, windows, options, checks)
        notes += more
    pool = {name: e for name, e in effects.items() if name not in log.compensated}
    if "reference" in (windows or {}):
        pool = {name: e.as_change() for name, e in pool.items()}
    facts, allowed = known.read(options.known, effects, robot)
    gravity, inertia = "gravity" in log.compensated, _typical_inertia(robot)

    def rows(highest: Sequence[float] | None = None) -> Recording:
        """The log in rows."""
        return prepare(in_newton_metres(log), inertia, windows, options.conditioning, highest)

    def asked(measured: Recording) -> tuple[Robot, Recording, float]:
        """The robot and the rows without what is known, and without their common delay; and that."""
        without, changed = known.taken_out(measured, robot, facts, gravity=gravity)
        return changed, *hold.remove_common_delay(changed, without, log.torque_side)

    try:
        measured = rows()
        changed, recording, lead = asked(measured)
        columns = columns_of(started(changed, recording), log.torque_side)
        gear = yielding.gear(columns, shown_by(pool.values(), log.torque_side, log.position_side))
        gradual = transition.speeds(columns, yielding.left(columns, gear))
        if any(gradual):
            measured = replace(measured, transition=gradual)
            changed, recording, lead = asked(measured)
            columns = columns_of(started(changed, recording), log.torque_side)
        heard = band.heard(columns, yielding.left(columns, gear), options.conditioning.cutoffs)
        if heard != recording.filter.cutoffs:
            measured = replace(rows(heard), transition=gradual)
            changed, recording, lead = asked(measured)
            columns = None
    except LogError as error:
        return _unusable(examination, (*notes, str(error)))
    progress(0.25, "columns")
    evidence = _gathered(changed, recording, log, pool, facts, gear)
    columns = columns_of(evidence, log.torque_side) if columns is None else replace(columns, evidence=evidence)
    return Case(
        log=log,
        robot=robot,
        examination=examination,
        recording=measured,
        evidence=evidence,
        columns=columns,
        effects=pool,
        facts=facts,
        allowed=allowed,
        gear=gear,
        most=3 * robot.dofs if options.most is None else options.most,
        lead=lead,
        split=split,
        gained=gained,
        notes=(*notes, *recording.notes),
        corrected=corrected,
    )


def _gathered(
    robot: Robot,
    recording: Recording,
    log: Log,
    effects: Mapping[str, AbstractEffect],
    facts: Sequence[EffectInstance],
    gear: EffectInstance | None,
) -> Evidence:
    """The columns of effects on the rows of a log, with what corrects the timing of declared ones, and trials of gears
    like the one beside which the standard model is fitted."""
    evidence = gather(robot, recording, list(effects.values()), log.torque_side, log.position_side)
    evidence.given = known.timed(evidence, facts)
    if gear is not None and gear.joint is not None:
        evidence.dragged = {gear.joint: {k: x for k, x in gear.parameters.items() if k in gear.effect.chosen}}
    return evidence


def _gained(
    log: Log, reference: Log | None, robot: Robot, windows, options: Options, checks: Sequence[AbstractCheck]
) -> tuple[gains.Gains | None, Log, Log | None]:
    """The log and its reference with drive gains that the log's masses tell, where it has currents and says none. A
    wrong gain is not looked for then: all of them are fitted."""
    if not gains.lacks(log):
        return None, log, reference
    corrected, _ = doctor.correct(log, robot, checks, change=options.correct)
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


def _typical_inertia(robot: Robot) -> np.ndarray:
    """Inertia (n,) that each joint carries in a typical posture [kg m^2; kg]: its torque for unit acceleration."""
    draw = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.lower), robot.lower, -1.0)
    high = np.where(np.isfinite(robot.upper), robot.upper, 1.0)
    q = draw.uniform(low[:, None], high[:, None], (robot.dofs, 32))
    return np.array([np.median(inertia_column(robot, q, j)[j]) for j in range(robot.dofs)])


def _beside(log: Log, reference: Log, robot: Robot, windows, options: Options, checks: Sequence[AbstractCheck]):
    """The log with the reference's trajectories beside its own, in a role of their own."""
    reference, examination = doctor.correct(reference, robot, checks, change=options.correct)
    if not examination.usable:
        failed = [c.seen for c in examination.checks if c.severity == "fail"]
        raise LogError(f"the reference log fails its checks: {listed(failed)}", advice="another data.reference")
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


def _of_gains(log: Log, gained: gains.Gains | None) -> tuple[str, ...]:
    """By which drive gains currents became torques."""
    if gained is not None:
        return (gained.note(),)
    if log.torque_unit != "A" or log.drive_gain is None:
        return ()
    each = ", ".join(f"{x:.3g}" for x in np.ravel(log.drive_gain))
    return (f"Torques are the log's currents times its drive gains: {each} N m/A.",)


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
