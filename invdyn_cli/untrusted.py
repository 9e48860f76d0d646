"""Values from any file become the package's data types here, after their types and shapes were checked.

Every function raises a ValueError with a sentence for what does not fit, or what it is told to raise.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.errors import InvdynError, shortened
from invdyn_cli.types import Dataset, Fit, Motion, Prediction, Robot, Score, Trajectory

LARGEST = 100_000_000
"""[bytes] Largest text file that is read: a diagnosis of a hundred joints has a hundredth of it."""


def parsed(text: str, what: str, raises: type[InvdynError], advice: str = "") -> Any:
    """The values of a JSON text.

    Raises:
        `raises`: if it is no JSON, or nested deeper than Python goes.
    """
    try:
        return json.loads(text)
    except ValueError as error:
        raise raises(f"{what} is not JSON ({error})", advice=advice) from error
    except RecursionError as error:
        raise raises(f"{what} is nested too deep to be read as JSON", advice=advice) from error


def read_json(path: Path, raises: type[InvdynError], advice: str = "") -> Any:
    """The values of a JSON file.

    Raises:
        `raises`: if it is no file, larger than LARGEST, no text, or no JSON.
    """
    return parsed(read_text(path, raises, advice), str(path), raises, advice)


def read_text(path: Path, raises: type[InvdynError], advice: str = "") -> str:
    """The text of a file.

    Raises:
        `raises`: if it is no file (a folder, a pipe, a device), larger than LARGEST, or no UTF-8.
    """
    try:
        if not path.is_file():
            what = "is not a file" if path.exists() else "does not exist"
            raise raises(f"{path} {what}", advice=advice)
        if (size := path.stat().st_size) > LARGEST:
            raise raises(f"{path} holds {size / 1e6:.0f} MB; allowed: {LARGEST / 1e6:.0f} MB of text", advice=advice)
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise raises(f"{path}: {error.strerror or error}", advice=advice) from error
    except UnicodeDecodeError as error:
        raise raises(f"{path} is not a text file", advice=advice) from error


def robot(tree: Mapping[str, Any]) -> Robot:
    """A robot from its fields: arrays, numbers and texts."""
    joints = names(tree["joints"], "joints")
    n = len(joints)
    if not n:
        raise ValueError("a robot without joints")
    parents = tuple(int(x) for x in array(tree["parents"], "parents", (n,)))
    if any(not -1 <= parent < i for i, parent in enumerate(parents)):
        raise ValueError(
            f"parents {shortened(parents)}; allowed: for each joint the index of an earlier joint, or -1 for the base"
        )
    shapes = {"rotation": (n, 3, 3), "translation": (n, 3), "axis": (n, 3), "inertial": (n, 10), "gravity": (3,)}
    shapes |= dict.fromkeys(("damping", "friction"), (n,))
    limits = dict.fromkeys(("lower", "upper", "velocity_limit", "effort_limit"), (n,))
    columns = names(tree.get("columns", ()), "columns")
    if columns and sorted(columns) != sorted(joints):
        raise ValueError(f"columns {shortened(columns)}; allowed: the names of the joints, in any order")
    return Robot(
        name=text(tree["name"], "name"),
        joints=joints,
        parents=parents,
        prismatic=tuple(bool(x) for x in array(tree["prismatic"], "prismatic", (n,))),
        **{key: array(tree[key], key, shape) for key, shape in shapes.items()},
        **{key: array(tree[key], key, shape, finite=False) for key, shape in limits.items()},
        urdf=text(tree.get("urdf", ""), "urdf"),
        notes=names(tree.get("notes", ()), "notes"),
        columns=columns,
    )


def fit(tree: Mapping[str, Any], learned_on: Robot | None) -> Fit:
    """A fit from its fields, and the robot that it was learned on."""
    return Fit(
        params=tree["params"],
        robot=learned_on,
        joints=names(tree["joints"], "joints"),
        parameters=int(number(tree["parameters"], "parameters")),
        history={k: np.asarray(x, float) for k, x in mapping(tree["history"], "history").items()},
        details=mapping(tree["details"], "details"),
        warnings=names(tree["warnings"], "warnings"),
    )


def score(tree: Mapping[str, Any], joints: tuple[str, ...]) -> Score:
    """NMSE and RMSE of these joints."""
    return Score(joints, *(array(tree[kind], kind, (len(joints),), finite=False) for kind in ("nmse", "rmse")))


def prediction(tree: Mapping[str, Any], joints: tuple[str, ...], learned_on: Robot | None) -> Prediction:
    """A scored set: rows of all its trajectories one below the other, and the number of rows of each."""
    labels = names(tree["trajectories"], "trajectories")
    lengths = [int(x) for x in array(tree["lengths"], "lengths", (len(labels),))]
    rows = len(np.atleast_1d(tree["t"]))
    if min(lengths, default=0) < 0 or sum(lengths) != rows:
        raise ValueError(f"lengths {shortened(lengths)} of {rows} rows")
    columns = {k: array(tree[k], k, (rows, len(joints)), finite=False) for k in ("q", "qd", "qdd", "tau", "prediction")}
    t = array(tree["t"], "t", (rows,), finite=False)
    stage = None if tree["stage"] is None else np.array(names(tree["stage"], "stage"))
    if stage is not None and len(stage) != rows:
        raise ValueError(f"{len(stage)} stages of {rows} rows")
    ends = np.cumsum(lengths)
    trajectories = tuple(
        Trajectory(
            label,
            t[end - length : end],
            Motion(*(columns[k][end - length : end] for k in ("q", "qd", "qdd"))),
            columns["tau"][end - length : end],
            None if stage is None else stage[end - length : end],
        )
        for label, length, end in zip(labels, lengths, ends, strict=True)
    )
    return Prediction(Dataset(trajectories, joints, learned_on), columns["prediction"])


def mapping(value: Any, what: str) -> dict[str, Any]:
    """A mapping by texts."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{what} is a {type(value).__name__}; allowed: a mapping")
    return {str(k): v for k, v in value.items()}


def names(values: Any, what: str) -> tuple[str, ...]:
    """A tuple of texts."""
    if isinstance(values, np.ndarray) and not values.size:
        return ()
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise ValueError(f"{what} is a {type(values).__name__}; allowed: texts")
    return tuple(text(x, what) for x in values)


def text(value: Any, what: str) -> str:
    """A text."""
    if not isinstance(value, str):
        raise ValueError(f"{what} is {shortened(value)}; allowed: a text")
    return value


def number(value: Any, what: str) -> float:
    """A number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{what} is {shortened(value)}; allowed: a number")
    return float(value)


def array(value: Any, what: str, shape: tuple[int, ...], *, finite: bool = True) -> np.ndarray:
    """An array of this shape, as it was stored."""
    made = np.asarray(value)
    if made.dtype.kind not in "biuf" or made.shape != shape:
        raise ValueError(f"{what} is {made.dtype} of shape {made.shape}; allowed: numbers of shape {shape}")
    if finite and not np.isfinite(made).all():
        raise ValueError(f"{what} has numbers that are not finite")
    return made
