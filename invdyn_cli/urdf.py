"""A URDF's text and tags, before Pinocchio makes a model of it. Meshes are never opened."""

import math
import os
import re
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
import scipy

from invdyn_cli.errors import RobotError, closest, listed, shortened

BUILT_IN: Mapping[str, Path] = {"apollo_arm": Path(__file__).with_name("apollo_arm.urdf")}
"""Robots that ship with the package, by the name that stands for their path."""

MOVING = ("revolute", "continuous", "prismatic")
"""Joint types that can move; "fixed" ones are merged, "floating" and "planar" ones can be locked."""


LARGEST_FILE = 20_000_000
"""[bytes] Largest size of a URDF; the largest published ones have one megabyte."""


def read(path: str | Path | None) -> str:
    """The URDF text of a built-in robot, a URDF or a xacro file (which may run Python of its own)."""
    built_in = f"a .urdf or .xacro file, or a built-in robot: {listed(BUILT_IN)}"
    if path is None:
        raise RobotError(
            f"no robot description is given, neither by an option nor by the data; allowed: {built_in}",
            advice="robot.path=arm.urdf",
        )
    file = BUILT_IN.get(str(path), Path(path).expanduser())
    if not file.is_file():
        raise RobotError(f"no robot description at {str(path)!r}{closest(str(path), BUILT_IN)}; allowed: {built_in}")
    if (size := file.stat().st_size) > LARGEST_FILE:
        raise RobotError(f"{path} holds {size / 1e6:.0f} MB; allowed: {LARGEST_FILE / 1e6:.0f} MB of URDF")
    if file.suffix == ".xacro":
        return _expanded(file)
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RobotError(f"{path} cannot be read as text: {error}; allowed: {built_in}") from error


def _expanded(file: Path) -> str:
    """A xacro file as URDF text."""
    try:
        import xacro  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise RobotError(f"{file} needs the package xacro", advice='pip install "invdyn[xacro]"') from error
    try:
        with overheard():
            return xacro.process_file(str(file)).toxml()
    except Exception as error:  # xacro evaluates Python: anything can come out
        raise RobotError(
            f"{file} cannot be expanded by xacro: {error}",
            advice=f"xacro {file.name} > {file.stem} on a computer with its packages, then give invdyn {file.stem}",
        ) from error


def parse(text: str, path: str | Path | None) -> ET.Element:
    """The tree of links and joints without shapes, if the file is a URDF with known joint types and possible masses."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # text that may multiply when it is read
        raise RobotError(f"{path} declares a DOCTYPE or an ENTITY; allowed: plain XML", advice="the URDF without them")
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise RobotError(f"{path} is not XML: {error}", advice="a complete, uncompressed .urdf file") from error
    if root.tag != "robot":
        raise RobotError(f"{path} has <{root.tag}> at its root; allowed: <robot>, a URDF", advice="convert it to URDF")
    refuse_types(root.findall("joint"), (*MOVING, "fixed", "floating", "planar"))
    for other in [x for x in root if x.tag not in ("link", "joint")]:
        root.remove(other)
    for link in root.findall("link"):
        for shape in [x for x in link if x.tag in ("visual", "collision")]:
            link.remove(shape)
        if link.find("inertial") is not None:
            if number(link, "inertial/mass", "value") < 0:
                raise RobotError(f"link {link.get('name')!r} has a negative mass; allowed: zero and above")
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
                number(link, "inertial/inertia", key)
            for key in ("xyz", "rpy"):
                triple(link, "inertial/origin", key)
    return root


def refuse_types(joints: Sequence[ET.Element], allowed: Sequence[str]) -> None:
    """Raises RobotError for joints of types that are not allowed."""
    wrong = [f"{x.get('name')} ({x.get('type')})" for x in joints if x.get("type") not in allowed]
    if wrong:
        raise RobotError(
            f"joints of types that are not supported: {listed(wrong)}; allowed: {listed(MOVING)}, fixed",
            advice="leave them out by robot.tip=… or robot.joints=[…] (this locks them), or set their type to fixed",
        )


def number(element: ET.Element, tag: str, key: str, default: float = math.nan) -> float:
    """Attribute `key` of the child `tag`: a finite number."""
    child = element.find(tag)
    text = None if child is None else child.get(key)
    try:
        value = default if text is None else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        where = f"{element.tag} {element.get('name')!r}"
        raise RobotError(f"{where}: <{tag} {key}> is {shortened(text or 'missing')}; allowed: a finite number")
    return value


def triple(element: ET.Element, tag: str, key: str, default: str = "0 0 0") -> np.ndarray:
    """(3,) attribute `key` of the child `tag`."""
    child = element.find(tag)
    text = default if child is None else child.get(key, default)
    return finite(text.split(), f"{element.tag} {element.get('name')!r}: <{tag} {key}>", (3,))


def finite(values: Any, what: str, *shapes: tuple[int, ...]) -> np.ndarray:
    """Finite numbers of one of these shapes."""
    try:
        array = np.asarray(values, float)
    except (TypeError, ValueError):
        array = np.array(math.nan)
    if array.shape not in shapes or not np.isfinite(array).all():
        raise RobotError(f"{what} is {values!r}; allowed: finite numbers of shape {' or '.join(map(str, shapes))}")
    return array


def limits(joint: ET.Element) -> tuple[float, float, float, float]:
    """Lower, upper, velocity and effort limit; infinite where there is none (zero in many URDFs, or an empty range)."""
    lower, upper, velocity, effort = (number(joint, "limit", x, 0.0) for x in ("lower", "upper", "velocity", "effort"))
    if joint.get("type") not in ("revolute", "prismatic") or lower >= upper:
        lower, upper = -math.inf, math.inf
    return lower, upper, velocity or math.inf, effort or math.inf


def axis(joint: ET.Element) -> np.ndarray:
    """(3,) unit axis in the joint frame; x where the URDF names none."""
    axis = triple(joint, "axis", "xyz", "1 0 0")
    if not axis.any():
        raise RobotError(f"joint {joint.get('name')!r} has an axis of length zero; allowed: a direction")
    return axis / np.linalg.norm(axis)


def moving_links(text: str, joints: Sequence[str]) -> list[str]:
    """The links that these joints move; each one's frame is the joint's."""
    children = {x.get("name"): x.find("child") for x in ET.fromstring(text).findall("joint")}
    found = [children[joint] for joint in joints]
    return ["" if x is None else x.get("link", "") for x in found]


def dynamics(text: str, joints: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Joint -> damping [N m s/rad; N s/m] and friction [N m; N] of its <dynamics>; 0 where it has none."""
    return {x.get("name", ""): dynamics_of(x) for x in ET.fromstring(text).findall("joint") if x.get("name") in joints}


def dynamics_of(joint: ET.Element) -> tuple[float, float]:
    """The same of one <joint>."""
    return number(joint, "dynamics", "damping", 0.0), number(joint, "dynamics", "friction", 0.0)


def without(text: str, joints: Sequence[str]) -> str:
    """A URDF's text without these joints and all links and joints behind them; unchanged if there are none."""
    if not joints:
        return text
    root = ET.fromstring(text)
    gone, links = [x for x in root.findall("joint") if x.get("name") in joints], set()
    for joint in gone:  # grows while it is gone through
        child = joint.find("child")
        link = "" if child is None else child.get("link", "")
        links.add(link)
        gone += [x for x in root.findall("joint") if (up := x.find("parent")) is not None and up.get("link") == link]
    for x in [*gone, *(x for x in root.findall("link") if x.get("name") in links)]:
        if x in root:
            root.remove(x)
    return ET.tostring(root, encoding="unicode")


def with_changes(
    text: str, inertials: Mapping[str, np.ndarray], dynamics: Mapping[str, tuple[float, float]]
) -> tuple[str, tuple[str, ...]]:
    """A URDF's text with other numbers, all else byte for byte, and a sentence for what cannot be written.

    Args:
        text: the URDF.
        inertials: link -> what is added to its own ten parameters (10,), about its frame's origin, in the order of
            `types.Robot.inertial`; a link without <inertial> gets one.
        dynamics: joint -> damping [N m s/rad] and friction [N m]; written where the file says otherwise.
    """
    raw, said, edits = text.encode(), [], []
    places, root = _places(raw), ET.fromstring(text)
    for link in root.findall("link"):
        name = link.get("name", "")
        if name not in inertials:
            continue
        row = _inertial_of(link) + inertials[name]
        if not row[0] > 0:
            said.append(f"link {name}: its own mass would be {row[0]:.3g} kg, and is left as it is")
            continue
        edits.append(_edit(raw, places, ("link", name), "inertial", _inertial_text(row)))
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if name in dynamics and dynamics[name] != dynamics_of(joint):
            damping, friction = dynamics[name]
            tag = f'<dynamics damping="{damping!r}" friction="{friction!r}"/>'
            edits.append(_edit(raw, places, ("joint", name), "dynamics", tag))
    for start, end, new in sorted(edits, reverse=True):
        raw = raw[:start] + new.encode() + raw[end:]
    return raw.decode(), tuple(said)


def _inertial_of(link: ET.Element) -> np.ndarray:
    """(10,) of a link's own <inertial> about its frame's origin; zeros where it has none."""
    if link.find("inertial") is None:
        return np.zeros(10)
    mass = number(link, "inertial/mass", "value")
    com = triple(link, "inertial/origin", "xyz")
    turn = scipy.spatial.transform.Rotation.from_euler("xyz", triple(link, "inertial/origin", "rpy")).as_matrix()
    xx, xy, xz, yy, yz, zz = (number(link, "inertial/inertia", k) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    about = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    about += mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([mass, *(mass * com), *about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def _inertial_text(row: np.ndarray) -> str:
    mass, com = float(row[0]), row[1:4] / row[0]
    x, y, z = com
    own = row[4:] - mass * np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    inertia = " ".join(
        f'{k}="{float(v)!r}"' for k, v in zip(("ixx", "ixy", "iyy", "ixz", "iyz", "izz"), own, strict=True)
    )
    place = " ".join(repr(float(v)) for v in com)
    return f'<inertial><origin xyz="{place}" rpy="0 0 0"/><mass value="{mass!r}"/><inertia {inertia}/></inertial>'


def _places(raw: bytes) -> dict[tuple[str, ...], tuple[int, int]]:
    """First and last byte + 1 of links, joints and their children, by ("link", name) and ("link", name, child); of
    several equal ones the first."""
    parser = expat.ParserCreate("utf-8")
    places: dict[tuple[str, ...], tuple[int, int]] = {}
    path: list[tuple[str, ...]] = []
    starts: list[int] = []

    def open_tag(tag: str, attributes: dict[str, str]) -> None:
        above = path[-1] if path else ()
        path.append((tag, attributes.get("name", "")) if len(path) == 1 else (*above, tag))
        starts.append(parser.CurrentByteIndex)

    def close_tag(tag: str) -> None:
        key, start = path.pop(), starts.pop()
        last = start if _tag(raw, start).endswith(b"/>") else parser.CurrentByteIndex
        places.setdefault(key, (start, last + len(_tag(raw, last))))

    parser.StartElementHandler, parser.EndElementHandler = open_tag, close_tag
    parser.Parse(raw, True)
    return places


def _tag(raw: bytes, start: int) -> bytes:
    """The tag that begins at a byte; a ">" inside quotes does not end it."""
    found = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""").match(raw, start)
    return found.group() if found else b""


def _edit(raw: bytes, places: Mapping, owner: tuple[str, str], child: str, new: str) -> tuple[int, int, str]:
    """First and last byte + 1 of what is replaced by what, so that an owner has this child."""
    if (*owner, child) in places:
        return (*places[*owner, child], new)
    start, _ = places[owner]
    tag = _tag(raw, start).decode()
    if tag.endswith("/>"):
        return start, start + len(tag.encode()), f"{tag[:-2]}>{new}</{owner[0]}>"
    return start + len(tag.encode()), start + len(tag.encode()), new


@contextmanager
def overheard(said: list[str] | None = None) -> Iterator[None]:
    """Keeps from the terminal what libraries write to stderr meanwhile; errors and warnings of urdfdom go to `said`."""
    with tempfile.TemporaryFile() as heard:
        sys.stderr.flush()
        kept = os.dup(2)
        os.dup2(heard.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
            heard.seek(0)
            lines = heard.read().decode(errors="replace").splitlines()
            if said is not None:
                said += [x.split(":", 1)[1].strip() for x in lines if x.startswith(("Error:", "Warning:"))]
