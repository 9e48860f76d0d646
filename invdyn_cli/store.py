"""RunRecord <-> run.h5 (schema invdyn-run/1), metrics.json (schema invdyn-metrics/1), diagnosis.json and
extended_model.json. No pickle.

A tree of mappings becomes HDF5 groups, arrays and numbers become datasets, strings become string datasets. Objects
(models, adaptations) are stored as the import path of their class and their fields, and built again by calling it.
"""

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invdyn_cli.effects.description import ExtendedModel, as_dict
from invdyn_cli.errors import RunFileError
from invdyn_cli.interfaces import FittedModel
from invdyn_cli.maths import loads, stages
from invdyn_cli.models import extended
from invdyn_cli.types import (
    Dataset,
    Diagnosis,
    Examination,
    Finding,
    Fit,
    Motion,
    Prediction,
    Robot,
    RunRecord,
    Score,
    Trajectory,
)

RUN_SCHEMA = "invdyn-run/1"
METRICS_SCHEMA = "invdyn-metrics/1"
CHECK_SCHEMA = "invdyn-check/1"
DIAGNOSIS_SCHEMA = "invdyn-diagnosis/1"
RUN, METRICS = "run.h5", "metrics.json"
"""What the two files of a run are called; metrics.json is written last: where it is, the run is complete."""


def write_run(record: RunRecord, path: Path) -> None:
    """Write run.h5: aside first, then renamed, so that the file is whole or not there."""
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

    def write(part: Path) -> None:
        with h5py.File(part, "w") as file:
            file.attrs["schema"] = RUN_SCHEMA
            for name, value in tree.items():
                _put(file, name, value)

    write_aside(path, write)


def load_run(path: str | Path) -> RunRecord:
    """Read a run.h5 back.

    Raises:
        RunFileError: if there is no such file, or it is not a whole run.h5 of this schema.
    """
    path = Path(path)
    if not path.is_file():
        raise RunFileError(f"no run at {path}", advice="the run.h5 in the folder that `invdyn run` printed last")
    try:
        with h5py.File(path) as file:
            schema = file.attrs.get("schema")
            if schema != RUN_SCHEMA:
                raise RunFileError(f"{path} has schema {schema!r}; allowed: {RUN_SCHEMA!r}")
            tree = _get(file)
    except RunFileError:
        raise
    except Exception as error:  # h5py raises nearly anything on a damaged file
        raise RunFileError(f"{path} cannot be read as HDF5 ({error})", advice="running it again") from error
    try:
        return _record(tree)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        got = f"{path} is no whole run ({type(error).__name__}: {error})"
        raise RunFileError(got, advice="running it again") from error


def _record(tree: dict[str, Any]) -> RunRecord:
    robot = None if tree["robot"] is None else _build(Robot, tree["robot"])
    joints = tuple(tree["fit"]["joints"])
    members = tree["member_scores"]
    return RunRecord(
        choices=json.loads(tree["choices"]),
        model=decode(json.loads(tree["model"])),
        adaptation=decode(json.loads(tree["adaptation"])),
        fit=_build(Fit, {**tree["fit"], "robot": robot}),
        predictions={name: _prediction(p, joints, robot) for name, p in tree["predictions"].items()},
        scores={name: Score(joints, **s) for name, s in tree["scores"].items()},
        member_scores={
            name: tuple(Score(joints, *x) for x in zip(s["nmse"], s["rmse"], strict=True))
            for name, s in members.items()
        },
        samples={name: int(x) for name, x in tree["samples"].items()},
        seconds={name: float(x) for name, x in tree["seconds"].items()},
        split=json.loads(tree["split"]),
        digest=tree["digest"],
        trace=tree["trace"],
        config=tree["config"],
        overrides=tuple(tree["overrides"]),
        provenance=json.loads(tree["provenance"]),
    )


def load_model(path: str | Path) -> FittedModel | ExtendedModel:
    """The fitted model of a run.h5, or the extended model of an extended_model.json, ready to `predict(q, qd, qdd)`.

    Raises:
        RunFileError: as `load_run`; also if the model's class cannot be imported.
        UsageError: for a .json that is no extended model.
    """
    if Path(path).suffix == ".json":
        return extended.load_model(path)
    record = load_run(path)
    return FittedModel(record.model, record.fit)


def metrics(record: RunRecord) -> dict[str, Any]:
    """What metrics.json holds; `members` lists the scores of each seed where a fit has several."""
    out = {
        "schema": METRICS_SCHEMA,
        **{name: record.choices.get(name) for name in ("model", "data", "adaptation", "seed")},
        "joints": list(record.fit.joints),
        **{name: score.as_dict() for name, score in record.scores.items()},
        "seconds": {name: record.seconds[name] for name in ("fit", "predict", "total")},
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
    """Write metrics.json, aside and renamed; numbers that do not exist (NaN, infinity) as null."""
    text = json.dumps(plain(metrics(record)), indent=1)
    write_aside(path, lambda part: part.write_text(text + "\n"))


def write_diagnosis(diagnosis: Diagnosis, path: Path, files: Mapping[str, str]) -> None:
    """Write diagnosis.json, aside and renamed; `files` names what lies beside it (model, urdf, mjcf, report).

    "summary", "replay", "notes" and "details" are additions to the schema of the design.
    """
    tree = {
        "schema": DIAGNOSIS_SCHEMA,
        "verdict": diagnosis.verdict,
        "summary": diagnosis.summary,
        "log_checks": examination_as_dict(diagnosis.examination),
        "findings": [_finding_tree(x) for x in diagnosis.findings],
        "baseline": diagnosis.baseline,
        "extended": diagnosis.extended,
        "noise_floor": diagnosis.noise_floor,
        "unexplained": diagnosis.unexplained,
        "files": files,
        "replay": None if diagnosis.replay is None else diagnosis.replay.as_dict(),
        "notes": diagnosis.notes,
        "details": diagnosis.details,
    }
    text = json.dumps(plain(tree), indent=1, ensure_ascii=False, allow_nan=False)
    write_aside(path, lambda part: part.write_text(text + "\n", encoding="utf-8"))


def write_model(model: ExtendedModel, path: Path) -> None:
    """Write extended_model.json (schema invdyn-model/1), aside and renamed."""
    text = json.dumps(plain(as_dict(model)), indent=1, ensure_ascii=False, allow_nan=False)
    write_aside(path, lambda part: part.write_text(text + "\n", encoding="utf-8"))


def write_text(text: str, path: Path) -> None:
    """Write a text, aside and renamed, its line ends as they are."""
    write_aside(path, lambda part: part.write_bytes(text.encode()))


def examination_as_dict(examination: Examination) -> dict[str, Any]:
    """{"usable", "checks", "excitation"} as in check.json, numbers that do not exist as None."""
    checks = [vars(x) for x in examination.checks]
    return plain({"usable": examination.usable, "checks": checks, "excitation": examination.excitation})


def plain(value: Any) -> Any:
    """A tree that JSON can hold: arrays and tuples as lists, numpy's numbers as Python's, NaN and infinity as None,
    what is none of these as text."""
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
        **vars(finding),
        "parameters": {name: vars(x) for name, x in finding.parameters.items()},
        "gain": {joint: vars(x) for joint, x in finding.gain.items()},
        "rejected": [{"effect": effect, "why": why} for effect, why in finding.rejected],
    }


def write_check(examination: Examination, path: Path) -> None:
    """Write check.json (schema invdyn-check/1), aside and renamed; numbers that do not exist as null."""
    tree = {"schema": CHECK_SCHEMA, **examination_as_dict(examination)}
    text = json.dumps(tree, indent=1, ensure_ascii=False, allow_nan=False)
    write_aside(path, lambda part: part.write_text(text + "\n", encoding="utf-8"))


def write_aside(path: Path, write: Callable[[Path], Any]) -> None:
    """Let `write` fill a file beside `path`, then rename it: readers see the old or the new one, nothing between."""
    part = path.with_name(f".{path.name}.part")
    try:
        write(part)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def encode(value: Any) -> Any:
    """A frozen dataclass as {"class": "module:Name", "fields": {...}}, its fields likewise; plain values stay."""
    if is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        entries = {f.name: encode(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"class": f"{kind.__module__}:{kind.__qualname__}", "fields": entries}
    if isinstance(value, Mapping):
        return {str(k): encode(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [encode(v) for v in value]
    return value


def decode(value: Any) -> Any:
    """What `encode` stored, built again.

    Raises:
        RunFileError: if a class cannot be imported (a third party's model whose file is not on the path).
    """
    if isinstance(value, Mapping) and set(value) == {"class", "fields"}:
        module, _, name = value["class"].partition(":")
        try:
            kind = getattr(import_module(module), name)
        except (ImportError, AttributeError):
            raise RunFileError(
                f"the run's {value['class']} cannot be imported",
                advice="the folder that holds its file as working directory, or on PYTHONPATH",
            ) from None
        return kind(**{k: decode(v) for k, v in value["fields"].items()})
    if isinstance(value, Mapping):
        return {k: decode(v) for k, v in value.items()}
    if isinstance(value, list):
        return tuple(decode(v) for v in value)
    return value


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


def _prediction(tree: dict[str, Any], joints: tuple[str, ...], robot: Robot | None) -> Prediction:
    ends = np.cumsum(tree["lengths"])
    parts = [slice(end - length, end) for end, length in zip(ends, tree["lengths"], strict=True)]
    stage = None if tree["stage"] is None else np.array(tree["stage"])
    trajectories = tuple(
        Trajectory(
            name,
            tree["t"][rows],
            Motion(*(tree[k][rows] for k in ("q", "qd", "qdd"))),
            tree["tau"][rows],
            None if stage is None else stage[rows],
        )
        for name, rows in zip(tree["trajectories"], parts, strict=True)
    )
    return Prediction(Dataset(trajectories, joints, robot), tree["prediction"])


def _put(group: h5py.Group, name: str, value: Any) -> None:
    if value is None:
        group[name] = h5py.Empty("f8")
    elif isinstance(value, Mapping):
        child = group.create_group(name)
        for key, entry in value.items():
            _put(child, str(key), entry)
    elif isinstance(value, str):
        group.create_dataset(name, data=value, dtype=h5py.string_dtype())
    elif isinstance(value, list | tuple) and all(isinstance(x, str) for x in value):
        group.create_dataset(name, data=list(value), shape=(len(value),), dtype=h5py.string_dtype())
    else:
        array = np.asarray(value)
        squeeze = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if array.size > 4096 else {}
        group.create_dataset(name, data=array, **squeeze)


def _get(node: Any) -> Any:
    if isinstance(node, h5py.Group):
        return {name: _get(node[name]) for name in node}
    if node.shape is None:
        return None
    if h5py.check_string_dtype(node.dtype):
        return node.asstr()[()] if node.shape == () else [str(x) for x in node.asstr()[()]]
    value = node[()]
    return value.item() if node.shape == () else value


def _build(kind: type, tree: Mapping[str, Any]) -> Any:
    """A Robot or Fit from its tree: lists become the tuples that they were."""
    plain = {
        name: x.tolist() if isinstance(x, np.ndarray) and _was_tuple(kind, name) else x for name, x in tree.items()
    }
    return kind(**{name: tuple(x) if _was_tuple(kind, name) else x for name, x in plain.items()})


def _was_tuple(kind: type, name: str) -> bool:
    return str(kind.__annotations__[name]).startswith("tuple")
