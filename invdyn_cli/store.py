"""RunRecord <-> run.h5 (schema invdyn-run/1), metrics.json (schema invdyn-metrics/1), diagnosis.json and
extended_model.json. No pickle.

A tree of mappings becomes HDF5 groups, arrays and numbers become datasets, strings become string datasets. Objects
(models, adaptations) are stored by name and fields; `registry` has the names. Reading a file runs no code except the
package's own and that of modules which the reader trusts by name.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli import hdf5, untrusted
from invdyn_cli.effects.description import ExtendedModel, as_dict
from invdyn_cli.errors import RunFileError
from invdyn_cli.files import write_file
from invdyn_cli.hdf5 import Group
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.maths import loads, stages
from invdyn_cli.models import extended
from invdyn_cli.registry import decode, encode
from invdyn_cli.types import Array, Diagnosis, Examination, Finding, Fit, Motion, Prediction, ResidualTest, RunRecord

RUN_SCHEMA = "invdyn-run/1"
METRICS_SCHEMA = "invdyn-metrics/1"
CHECK_SCHEMA = "invdyn-check/1"
DIAGNOSIS_SCHEMA = "invdyn-diagnosis/1"
RUN, METRICS = "run.h5", "metrics.json"
"""Names of the two files of a run. metrics.json is written last, so that a run with it is complete."""


def write_run(record: RunRecord, path: Path) -> None:
    """Write run.h5, completely or not at all."""
    tree = {
        "choices": json.dumps(dict(record.choices)),
        "model": json.dumps(encode(record.model)),
        "adaptation": json.dumps(encode(record.adaptation)),
        "config": record.config,
        "overrides": list(record.overrides),
        "provenance": json.dumps(dict(record.provenance)),
        "split": json.dumps(dict(record.split)),
        "digest": record.digest,
        "samples": dict(record.samples),
        "seconds": dict(record.seconds),
        "robot": None if record.fit.robot is None else vars(record.fit.robot),
        "fit": {name: value for name, value in vars(record.fit).items() if name != "robot"},
        "scores": {name: {"nmse": s.nmse, "rmse": s.rmse} for name, s in record.scores.items()},
        "member_scores": {
            name: {"nmse": np.array([s.nmse for s in members]), "rmse": np.array([s.rmse for s in members])}
            for name, members in record.member_scores.items()
        },
        "predictions": {name: _prediction_tree(p) for name, p in record.predictions.items()},
        "trace": dict(record.trace),
    }

    hdf5.write(path, Group({"schema": RUN_SCHEMA}, tree))


def load_run(path: str | Path, trust: Sequence[str] = (), *, limit: float = hdf5.LIMIT) -> RunRecord:
    """Read a run.h5 back.

    Args:
        path: the file.
        trust: modules of your own whose models and adaptations the run may name; their code is run.
        limit: [bytes] what may be read.

    Raises:
        RunFileError: if there is no such file, it is not a whole run.h5 of this schema, is larger than allowed, or
            names a class that is neither the package's nor of a module in `trust`.
    """
    path = Path(path)
    tree = _read(path, None, limit)
    try:
        return _record(tree, trust)
    except RunFileError as error:
        raise RunFileError(f"{path}: {error.got}", advice=error.advice) from None
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        got = f"{path} is not a complete run ({type(error).__name__}: {error})"
        raise RunFileError(got, advice="running it again") from error


def load_origin(path: str | Path) -> tuple[str, dict[str, Any]]:
    """The resolved config of a run.h5, and its provenance: plain values, no object is built.

    Raises:
        RunFileError: as `load_run`.
    """
    path = Path(path)
    tree = _read(path, ("config", "provenance"), hdf5.LIMIT)
    provenance = untrusted.parsed(str(tree["provenance"]), f"{path}: provenance", RunFileError)
    return str(tree["config"]), provenance if isinstance(provenance, dict) else {}


def load_asked(path: str | Path) -> tuple[str, tuple[str, ...]]:
    """The resolved config of a run.h5, and the overrides of its command: plain values, no object is built.

    Raises:
        RunFileError: as `load_run`.
        ValueError: if the overrides are no texts.
    """
    tree = _read(Path(path), ("config", "overrides"), hdf5.LIMIT)
    return str(tree["config"]), untrusted.names(tree["overrides"], "overrides")


def _read(path: Path, members: Sequence[str] | None, limit: float) -> dict[str, Any]:
    """The tree of a run.h5, or some of its members, with all values."""
    if not path.is_file():
        advice = "the run.h5 in the folder that `invdyn run` prints in its last line"
        raise RunFileError(f"no run at {path}", advice=advice)
    root = hdf5.outline(path, RunFileError)
    schema = root.attributes.get("schema")
    told = schema.values[0] if schema is not None and schema.values else None
    if told != RUN_SCHEMA:
        raise RunFileError(f"{path} has schema {told!r}; allowed: {RUN_SCHEMA!r}")
    if missing := [name for name in members or () if name not in root.members]:
        raise RunFileError(f"{path} is not a complete run (it lacks {missing[0]})", advice="running it again")
    wanted = root.members if members is None else {name: root.members[name] for name in members}
    values = hdf5.read(path, list(_leaves(wanted)), RunFileError, limit)
    return _filled(wanted, values)


def _leaves(members: Mapping[str, Any], above: str = "") -> list[str]:
    out: list[str] = []
    for name, node in members.items():
        out += _leaves(node.members, f"{above}{name}/") if isinstance(node, Group) else [above + name]
    return out


def _filled(members: Mapping[str, Any], values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """The tree with its values; numbers of shape () as Python's."""
    out = {}
    for name, node in members.items():
        if isinstance(node, Group):
            out[name] = _filled(node.members, values, f"{above}{name}/")
        else:
            value = values[above + name]
            out[name] = value.item() if isinstance(value, np.ndarray) and value.shape == () else value
    return out


def _record(tree: dict[str, Any], trust: Sequence[str]) -> RunRecord:
    def values(name: str) -> Any:
        return untrusted.parsed(untrusted.text(tree[name], name), name, RunFileError)

    robot = None if tree["robot"] is None else untrusted.robot(tree["robot"])
    fit = untrusted.fit(tree["fit"], robot)
    joints = fit.joints
    split = untrusted.mapping(values("split"), "split")
    if "notes" in split:
        split["notes"] = list(untrusted.names(split["notes"], "notes"))
    return RunRecord(
        choices=untrusted.mapping(values("choices"), "choices"),
        model=decode(values("model"), AbstractModel, trust),
        adaptation=decode(values("adaptation"), AbstractAdapter, trust),
        fit=fit,
        predictions={name: untrusted.prediction(p, joints, robot) for name, p in tree["predictions"].items()},
        scores={name: untrusted.score(s, joints) for name, s in tree["scores"].items()},
        member_scores={
            name: tuple(
                untrusted.score({"nmse": nmse, "rmse": rmse}, joints)
                for nmse, rmse in zip(s["nmse"], s["rmse"], strict=True)
            )
            for name, s in tree["member_scores"].items()
        },
        samples={name: int(untrusted.number(x, name)) for name, x in tree["samples"].items()},
        seconds={name: untrusted.number(x, name) for name, x in tree["seconds"].items()},
        split=split,
        digest=untrusted.text(tree["digest"], "digest"),
        trace=untrusted.mapping(tree["trace"], "trace"),
        config=untrusted.text(tree["config"], "config"),
        overrides=untrusted.names(tree["overrides"], "overrides"),
        provenance=untrusted.mapping(values("provenance"), "provenance"),
    )


@dataclass(frozen=True)
class FittedModel:
    """A model with its learned parameters: three lines of code from run.h5 to torques."""

    model: AbstractModel
    fit: Fit

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return self.fit.joints

    def predict(self, q: Array, qd: Array, qdd: Array) -> np.ndarray:
        """Torques (T, n) [N m; N] of a motion given as (T, n), or (n,) for one sample.

        Raises:
            ValueError: if the arrays are not of one shape with n columns.
        """
        arrays = [np.asarray(x, float) for x in (q, qd, qdd)]
        shapes = [x.shape for x in arrays]
        if len(set(shapes)) > 1 or not shapes[0] or shapes[0][-1] != len(self.joints) or len(shapes[0]) > 2:
            raise ValueError(
                f"q, qd, qdd have shapes {shapes}; allowed: one shape, (T, {len(self.joints)}) or ({len(self.joints)},)"
            )
        tau = self.model.predict(self.fit, Motion(*(np.atleast_2d(x) for x in arrays)))
        return tau.reshape(shapes[0])


def load_model(path: str | Path, trust: Sequence[str] = ()) -> FittedModel | ExtendedModel:
    """The fitted model of a run.h5, or the extended model of an extended_model.json, ready to `predict(q, qd, qdd)`.

    Raises:
        RunFileError: as `load_run`, which says what `trust` is.
        UsageError: for a .json that is no extended model.
    """
    if Path(path).suffix == ".json":
        return extended.read(str(path)).model
    record = load_run(path, trust)
    return FittedModel(record.model, record.fit)


def metrics(record: RunRecord) -> dict[str, Any]:
    """The contents of metrics.json; `members` lists the scores of each seed if a fit has several."""
    out = {
        "schema": METRICS_SCHEMA,
        **{name: record.choices.get(name) for name in ("model", "data", "adaptation", "seed")},
        "joints": list(record.fit.joints),
        **{name: score.as_dict() for name, score in record.scores.items()},
        "seconds": {name: record.seconds.get(name) for name in ("fit", "predict", "total")},
        "samples": dict(record.samples),
        "parameters": record.fit.parameters,
    }
    if found := _adaptation_scores(record):
        out["adaptation_scores"] = found
    if record.member_scores:
        out["members"] = {name: [s.as_dict() for s in scores] for name, scores in record.member_scores.items()}
    return out


def _adaptation_scores(record: RunRecord) -> dict[str, Any]:
    """Errors of the followed test set, by joint and by stage; the same as it was learned; how often was learned, how
    long it took. Of a run that does not adapt the second alone, where the test set has stages."""
    learned, followed = record.predictions.get("test"), record.predictions.get("test_adapted")
    as_learned = {"as_learned": stages.scores(learned)} if learned else {}
    if followed is None:
        return as_learned if learned and learned.data.stage is not None else {}
    return {
        **stages.scores(followed),
        **as_learned,
        **({"loads": [vars(x) for x in loads.believed(followed.data, record.trace)]} if record.trace else {}),
        "updates": followed.data.samples // record.adaptation.block,
        "seconds_per_update": {name: record.seconds.get(f"update_{name}") for name in ("p50", "p99")},
    }


def write_metrics(record: RunRecord, path: Path) -> None:
    """Write metrics.json, whole or not at all; numbers that do not exist (NaN, infinity) as null."""
    text = json.dumps(plain(metrics(record)), indent=1)
    write_file(path, text + "\n")


def write_diagnosis(diagnosis: Diagnosis, path: Path, files: Mapping[str, str]) -> None:
    """Write diagnosis.json, whole or not at all; `files` names what lies beside it (model, urdf, mjcf, report).

    "summary", "unclaimed", "replay", "notes" and "details" stand beside what the schema requires.
    """
    tree = {
        "schema": DIAGNOSIS_SCHEMA,
        "verdict": diagnosis.verdict,
        "summary": diagnosis.summary,
        "log_checks": examination_as_dict(diagnosis.examination),
        "findings": [_finding_tree(x) for x in diagnosis.findings],
        "standard": diagnosis.standard,
        "unclaimed": [_finding_tree(x) for x in diagnosis.unclaimed],
        "residual_tests": _tests_tree(diagnosis.tests),
        "baseline": diagnosis.baseline,
        "baselines": {"urdf": diagnosis.baseline, **diagnosis.baselines} if diagnosis.baselines else {},
        "extended": diagnosis.extended,
        "noise_floor": diagnosis.noise_floor,
        "unexplained": diagnosis.unexplained,
        "files": files,
        "replay": None if diagnosis.replay is None else diagnosis.replay.as_dict(),
        "notes": diagnosis.notes,
        "details": diagnosis.details,
    }
    write_json(tree, path)


def write_model(model: ExtendedModel, path: Path) -> None:
    """Write extended_model.json (schema invdyn-model/1), whole or not at all."""
    write_json(as_dict(model), path)


def examination_as_dict(examination: Examination) -> dict[str, Any]:
    """{"usable", "checks", "corrections", "excitation"} as in check.json, numbers that do not exist as None."""
    tree = {
        "usable": examination.usable,
        "as_recorded": examination.as_recorded,
        "checks": [vars(x) for x in examination.checks],
        "corrections": [dict(x) for x in examination.corrections],
        "excitation": examination.excitation,
    }
    return plain(tree)


def plain(value: Any) -> Any:
    """A tree as JSON values: arrays and tuples become lists, numpy's numbers become Python's, NaN and infinity None,
    other objects text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | bool | int) else str(value)


def _finding_tree(finding: Finding) -> dict[str, Any]:
    return {
        **{name: x for name, x in vars(finding).items() if name != "text"},
        "parameters": {name: vars(x) for name, x in finding.parameters.items()},
        "gain": {joint: vars(x) for joint, x in finding.gain.items()},
        "rejected": [{"effect": effect, "why": why} for effect, why in finding.rejected],
    }


def _tests_tree(tests: Sequence[ResidualTest]) -> dict[str, list[dict[str, Any]]]:
    """{joint: a row per test}, without the pictures' curves."""
    tree: dict[str, list[dict[str, Any]]] = {}
    for x in tests:
        row = {k: v for k, v in vars(x).items() if k not in ("joint", "curve", "quantity")}
        tree.setdefault(x.joint, []).append(row)
    return tree


def write_check(examination: Examination, path: Path) -> None:
    """Write check.json (schema invdyn-check/1), whole or not at all; numbers that do not exist as null."""
    tree = {"schema": CHECK_SCHEMA, **examination_as_dict(examination)}
    write_json(tree, path)


def write_json(tree: Mapping[str, Any], path: Path) -> None:
    """Write a tree of values that `plain` knows as JSON, whole or not at all."""
    write_file(path, json.dumps(plain(tree), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def _prediction_tree(prediction: Prediction) -> dict[str, Any]:
    trajectories = prediction.data.trajectories
    motion = prediction.data.motion
    return {
        "trajectories": [x.name for x in trajectories],
        "lengths": [len(x.t) for x in trajectories],
        "t": np.concatenate([x.t for x in trajectories]),
        "q": motion.q,
        "qd": motion.qd,
        "qdd": motion.qdd,
        "tau": prediction.data.tau,
        "prediction": prediction.tau,
        "stage": None if (stage := prediction.data.stage) is None else list(map(str, stage)),
    }
