"""Random files and options: sound ones, with a few things changed as damage, slips and malice change them."""
# ruff: noqa: E501

import json
import re
from typing import Any

import h5py
import numpy as np
from hypothesis import strategies as st

from tests.logs import HEADER, motion

NUMBERS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, 1e-320, 1e-200, 2.7e154, 1e300, -1e300, float("nan"), float("inf"), -1.0, 1e9]),
)
TEXTS = st.one_of(
    st.text(max_size=30),
    st.sampled_from(
        ["", " ", "nan", "[/]", "[bold]", "<script>", "</robot>", "../..", "x" * 3000, "\x1b[31m", "\x00", "‮", "N m", "A",
         "$\\frac{", "%s", "{}", "null", "1e400", "0x10", "j1", "base"]
    ),
)  # fmt: skip

# --- URDF ---

ATTRIBUTE = re.compile(r'="([^"]*)"')


def arm_text(joints: int, kind: str) -> str:
    """A sound arm."""
    parts = ['<robot name="arm"><link name="base"/>']
    for i in range(1, joints + 1):
        parts.append(
            f'<link name="l{i}"><inertial><mass value="1.5"/><origin xyz="0.1 0 0.05" rpy="0 0 0"/><inertia ixx="0.1" '
            f'iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j{i}" type="{kind}"><parent '
            f'link="{f"l{i - 1}" if i > 1 else "base"}"/><child link="l{i}"/><origin xyz="0 0 0.3" rpy="0.1 0 0"/><axis '
            f'xyz="0 {i % 2} {(i + 1) % 2}"/><limit lower="-2" upper="2" effort="50" velocity="3"/><dynamics '
            f'damping="0.5" friction="0.2"/></joint>'
        )
    return "".join(parts) + "</robot>"


@st.composite
def urdf_texts(draw: Any) -> str:
    """A URDF with up to four things changed."""
    kinds = st.sampled_from(["revolute", "prismatic", "continuous", "fixed", "planar", "floating", "ball"])
    text = arm_text(draw(st.integers(0, 6)), draw(kinds))
    for _ in range(draw(st.integers(0, 4))):
        change = draw(
            st.sampled_from(["value", "value", "value", "value", "drop tag", "double tag", "cut", "insert", "name"])
        )
        places = [m.span(1) for m in ATTRIBUTE.finditer(text)]
        tags = [m.span() for m in re.finditer(r"<[^<>]*>", text)]
        if change == "value" and places:
            start, end = draw(st.sampled_from(places))
            value = draw(st.one_of(NUMBERS.map(repr), TEXTS, st.just("0 0 0"), st.just("1e-200 0 0"), st.just("1 2")))
            text = text[:start] + value + text[end:]
        elif change == "drop tag" and tags:
            start, end = draw(st.sampled_from(tags))
            text = text[:start] + text[end:]
        elif change == "double tag" and tags:
            start, end = draw(st.sampled_from(tags))
            text = text[:end] + text[start:end] + text[end:]
        elif change == "cut":
            text = text[: draw(st.integers(0, len(text)))]
        elif change == "insert":
            at = draw(st.integers(0, len(text)))
            text = text[:at] + draw(TEXTS) + text[at:]
        elif change == "name":
            old = draw(st.sampled_from(["l1", "l2", "j1", "j2", "base"]))
            text = text.replace(f'"{old}"', f'"{draw(st.sampled_from(["l1", "j1", "base", "", "é", "[/]"]))}"')
    return text


# --- logs ---

ARRAYS = st.one_of(
    st.tuples(st.sampled_from([(), (0,), (1,), (50,), (50, 2), (49, 2), (50, 1), (50, 3), (2, 50), (50, 2, 1)]), NUMBERS).map(
        lambda x: np.full(*x)
    ),
    st.sampled_from([np.zeros((50, 2), "i8"), np.zeros((50, 2), "f2"), np.zeros((50, 2), bool), np.zeros((50, 2), "c16"),
                     np.full((50, 2), b"n/a"), np.zeros(3, [("a", "f8")]), np.zeros((50, 2), ">f4"),
                     np.zeros((50, 2), "u1")]),
)  # fmt: skip


@st.composite
def log_changes(draw: Any) -> list[tuple]:
    """Up to four changes of a sound log: (what, where, value)."""
    channels = st.sampled_from(["t", "q", "tau", "qd", "qdd", "q_ref", "q_link", "stage"])
    attributes = st.sampled_from([*HEADER, "position_side", "compensated", "drive_gain_N_m_per_A"])
    rows = st.integers(0, 49)
    values = st.one_of(NUMBERS, TEXTS.filter(lambda x: "\0" not in x), ARRAYS, st.just("empty"))
    change = st.one_of(
        st.tuples(st.just("value"), st.tuples(channels, rows), NUMBERS),
        st.tuples(st.just("value"), st.tuples(channels, rows), NUMBERS),
        st.tuples(st.just("channel"), channels, ARRAYS),
        st.tuples(st.just("group"), channels, st.none()),
        st.tuples(st.just("empty"), channels, st.none()),
        st.tuples(st.just("drop"), channels, st.none()),
        st.tuples(st.just("attribute"), attributes, values),
        st.tuples(st.just("drop attribute"), attributes, st.none()),
        st.tuples(st.just("mass"), st.none(), values),
        st.tuples(
            st.just("rename"), st.none(), TEXTS.filter(lambda x: x and "\0" not in x and "/" not in x and x != ".")
        ),
        st.tuples(st.just("bytes"), st.floats(0, 1), st.binary(min_size=1, max_size=40)),
        st.tuples(st.just("cut"), st.floats(0, 1), st.none()),
    )
    return draw(st.lists(change, min_size=1, max_size=4))


def log_bytes(changes: list[tuple]) -> bytes:
    """The log with these changes; bytes are changed last."""
    with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
        file.attrs.update(HEADER)
        group = file.create_group("trajectories/run")
        for name, x in motion(seconds=0.5).items():
            group[name] = x
        for what, where, value in changes:
            _change_log(file, group, what, where, value)
        file.flush()
        image = file.id.get_file_image()
    return _damaged(image, changes)


def _change_log(file: Any, group: Any, what: str, where: Any, value: Any) -> None:
    if what == "value":
        channel, row = where
        stored = group.get(channel)
        if isinstance(stored, h5py.Dataset) and stored.dtype.kind == "f" and stored.ndim and row < len(stored):
            group[channel][row] = value
    elif what in ("channel", "group", "empty", "drop"):
        if where in group:
            del group[where]
        if what == "channel":
            group[where] = value
        elif what == "group":
            group.create_group(where)
        elif what == "empty":
            group[where] = h5py.Empty("f8")
    elif what in ("attribute", "mass"):
        place, name = (file, where) if what == "attribute" else (group, "payload_mass")
        place.attrs[name] = h5py.Empty("f8") if isinstance(value, str) and value == "empty" else value
    elif what == "drop attribute":
        file.attrs.pop(where, None)
    elif what == "rename" and "run" in file["trajectories"] and value not in file["trajectories"]:
        file["trajectories"].move("run", value)


def _damaged(image: bytes, changes: list[tuple]) -> bytes:
    for what, where, value in changes:
        if what == "bytes":
            start = int(where * (len(image) - 1))
            image = image[:start] + value + image[start + len(value) :]
        elif what == "cut":
            image = image[: int(where * len(image))]
    return image


# --- run files ---

JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, st.integers(), TEXTS),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(TEXTS, inner, max_size=3)),
    max_leaves=6,
)
CLASSES = st.sampled_from(
    ["pest", "ffnn", "hybrid", "extended", "dbm", "batch", "payload", "os:system", "subprocess:Popen"]
)
OBJECTS = st.recursive(
    st.fixed_dictionaries({"class": CLASSES, "fields": st.just({})}),
    lambda inner: st.fixed_dictionaries(
        {
            "class": CLASSES,
            "fields": st.dictionaries(
                st.sampled_from(
                    ["base", "learner", "threshold", "text", "hidden", "joints", "friction", "mass", "seeds"]
                ),
                st.one_of(inner, JSON),
                max_size=3,
            ),
        }
    ),
    max_leaves=4,
)


@st.composite
def run_changes(draw: Any) -> list[tuple]:
    """Up to three changes of a sound run.h5: (what, dataset, value)."""
    texts = st.sampled_from(["model", "adaptation", "choices", "provenance", "split", "config", "digest"])
    places = st.sampled_from(
        ["model", "adaptation", "choices", "provenance", "split", "digest", "config", "overrides", "robot/joints",
         "robot/parents", "robot/inertial", "robot/gravity", "robot/name", "fit/joints", "fit/parameters", "fit/history",
         "fit/details", "fit/params", "fit/warnings", "scores/test/nmse", "scores/test/rmse", "scores/test",
         "predictions/test/q", "predictions/test/t", "predictions/test/lengths", "predictions/test/trajectories",
         "predictions/test/stage", "predictions/test/prediction", "samples/train", "seconds/fit", "trace", "member_scores"]
    )  # fmt: skip
    change = st.one_of(
        st.tuples(st.just("json"), texts, st.one_of(JSON, OBJECTS)),
        st.tuples(st.just("json"), st.sampled_from(["model", "adaptation"]), OBJECTS),
        st.tuples(st.just("drop"), places, st.none()),
        st.tuples(st.just("put"), places, st.one_of(ARRAYS, TEXTS.filter(lambda x: "\0" not in x), NUMBERS)),
        st.tuples(st.just("group"), places, st.none()),
        st.tuples(st.just("bytes"), st.floats(0, 1), st.binary(min_size=1, max_size=40)),
        st.tuples(st.just("cut"), st.floats(0, 1), st.none()),
    )
    return draw(st.lists(change, min_size=1, max_size=3))


def run_bytes(sound: bytes, changes: list[tuple]) -> bytes:
    """A run.h5 with these changes."""
    with h5py.File.in_memory(sound) as file:
        for what, where, value in changes:
            if what in ("json", "drop", "put", "group"):
                parent, _, name = where.rpartition("/")
                place = file.get(parent) if parent else file
                if not isinstance(place, h5py.Group):
                    continue
                if name in place:
                    del place[name]
                if what == "group":
                    place.create_group(name)
                elif what == "json":
                    place[name] = json.dumps(value).replace("\\u0000", "")
                elif what == "put":
                    place[name] = value
        file.flush()
        image = file.id.get_file_image()
    return _damaged(image, changes)


# --- overrides ---

KEYS = {
    "run": ["seed", "model", "data", "robot", "adaptation", "model.hidden", "model.epochs", "model.learning_rate",
            "model.joints", "model.seeds", "data.duration", "data.rate", "data.trim", "data.decimals", "data.jitter",
            "data.filter", "data.savgol_window", "robot.dofs", "robot.joints", "robot.tip", "robot.gravity",
            "robot.payload", "robot.path", "figures", "figures.formats", "model._target_", "robot._target_"],
    "simulate": ["seed", "data", "data.effects", "data.reference", "data.duration", "data.rate", "data.substeps",
                 "data.torque_noise", "data.torque_side", "data.control_frequency", "data.seed", "robot.dofs"],
    "check": ["data.path", "strict", "robot", "robot.path", "data.train", "data.drive_gain", "data.max_gap", "data"],
    "excite": ["effects", "known", "noise", "duration", "rate", "diagnosis", "finding", "seed"],
    "control": ["gains", "data.mass", "data.com", "model", "adaptation", "data.repetitions"],
}  # fmt: skip
VALUES = st.one_of(
    st.sampled_from(
        ["null", "", "-1", "0", "1e20", "1e400", "nan", "inf", "true", "[]", "{}", "[1,2]", "[null]", "{a: 1}", "5", "x",
         "'x y'", "builtins.dict", "os.getcwd", "nope.Nope", "[[1]]", "100000000", "0.5", "pest", "[nan]", "-0", "é", "[/]",
         "{_target_: os.getcwd}", "[{effect: backlash}]", "[{effect: nope, joint: 3}]", "/dev/null", "/dev/zero", "~"]
    ),
    st.integers().map(str),
    st.floats().map(repr),
)  # fmt: skip


@st.composite
def commands(draw: Any) -> tuple[str, list[str]]:
    """A verb, and one to three overrides of it."""
    verb = draw(st.sampled_from(list(KEYS)))
    names = draw(st.lists(st.sampled_from(KEYS[verb]), min_size=1, max_size=3, unique=True))
    return verb, [f"{name}={draw(VALUES)}" for name in names]
