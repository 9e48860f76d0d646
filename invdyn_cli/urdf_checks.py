"""Whether a URDF from any source describes a robot: names, tree, numbers. Unusual but usable values are reported."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from invdyn_cli.errors import RobotError, listed, shortened
from invdyn_cli.urdf import MOVING, number, triple

MOST_JOINTS, MOST_ELEMENTS = 100, 2000
"""Largest number of moving joints, and of joints of all kinds: loading 100 takes a quarter of a second, and the time
grows with the third power."""

LONGEST_NAME = 200
"""Characters of a name."""

LARGEST = {"mass": 1e6, "origin": 1e4, "inertia": 1e9, "limit": 1e9, "dynamics": 1e9}
"""[kg], [m; rad], [kg m^2], [SI], [SI] Largest values: a hundred times those of the largest machines; their products
stay finite."""

SHORTEST_AXIS, LONGEST_AXIS = 1e-6, 1e6
"""Least length of an axis, which should be 1: the direction of a shorter one is rounding."""

ROUNDED = 0.01
"""Share of an inertia by which rounded digits may violate the laws of inertias."""

INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def refuse(root: ET.Element, path: str | Path | None) -> None:
    """Raise a RobotError for names, a tree or numbers that no robot can have."""
    links, joints = root.findall("link"), root.findall("joint")
    moving = [x for x in joints if x.get("type") in MOVING]
    for what, count, most in (
        ("moving joints", len(moving), MOST_JOINTS),
        ("joints", len(joints), MOST_ELEMENTS),
        ("links", len(links), MOST_ELEMENTS),
    ):
        if count > most:
            raise RobotError(f"{path} has {count} {what}; allowed: {most}", advice="the URDF of the arm alone")
    for kind, elements in (("link", links), ("joint", joints)):
        _refuse_names(kind, [x.get("name", "") for x in elements], path)
    _refuse_tree([x.get("name", "") for x in links], joints, path)
    for link in links:
        if link.find("inertial") is not None:
            _bounded(link, "inertial/mass", ("value",), LARGEST["mass"])
            _bounded(link, "inertial/inertia", INERTIA, LARGEST["inertia"])
            _bounded_triples(link, "inertial/origin")
    for joint in joints:
        _bounded_triples(joint, "origin")
        _bounded(joint, "limit", ("lower", "upper", "velocity", "effort"), LARGEST["limit"])
        _bounded(joint, "dynamics", ("damping", "friction"), LARGEST["dynamics"])
        if joint.get("type") in (*MOVING, "planar"):
            _refuse_axis(joint)


def _refuse_names(kind: str, names: Sequence[str], path: str | Path | None) -> None:
    for name in names:
        if not name or name != shortened(name, LONGEST_NAME):
            got = f"{path} has a {kind} called {shortened(name)!r}"
            raise RobotError(f"{got}; allowed: 1 to {LONGEST_NAME} printable characters")
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise RobotError(f"{path} has several {kind}s called {listed(sorted(twice), most=3)}; allowed: each name once")


def _refuse_tree(links: Sequence[str], joints: Sequence[ET.Element], path: str | Path | None) -> None:
    known, parent_of = set(links), {}
    for joint in joints:
        ends = {}
        for end in ("parent", "child"):
            tag = joint.find(end)
            ends[end] = "" if tag is None else tag.get("link", "")
            if ends[end] not in known:
                got = f"joint {joint.get('name')!r} of {path} has the {end} {shortened(ends[end])!r}"
                raise RobotError(f"{got}; allowed: a link of the URDF")
        if ends["child"] in parent_of:
            raise RobotError(f"link {ends['child']!r} of {path} has several parent joints; allowed: one")
        parent_of[ends["child"]] = ends["parent"]
    roots = [name for name in links if name not in parent_of]
    if len(roots) != 1:
        got = f"{path} has {len(roots)} links without a parent joint: {listed(roots, most=3)}"
        raise RobotError(f"{got}; allowed: one, the base", advice="a joint for each of the other links")
    reached, ahead = set(roots), list(roots)
    children: dict[str, list[str]] = {}
    for child, parent in parent_of.items():
        children.setdefault(parent, []).append(child)
    while ahead:
        for child in children.get(ahead.pop(), ()):
            reached.add(child)
            ahead.append(child)
    if loop := sorted(known - reached):
        raise RobotError(f"links of {path} form a loop: {listed(loop, most=5)}; allowed: a tree")


def _bounded(element: ET.Element, tag: str, keys: Iterable[str], largest: float) -> None:
    if (child := element.find(tag)) is None:
        return
    for key in keys:
        if child.get(key) is not None and abs(value := number(element, tag, key)) > largest:
            where = f"{element.tag} {element.get('name')!r}: <{tag} {key}>"
            raise RobotError(f"{where} is {value:g}; allowed: up to {largest:g} in SI units", advice="SI units")


def _bounded_triples(element: ET.Element, tag: str) -> None:
    for key in ("xyz", "rpy"):
        if np.abs(values := triple(element, tag, key)).max() > LARGEST["origin"]:
            where = f"{element.tag} {element.get('name')!r}: <{tag} {key}>"
            raise RobotError(f"{where} is {values.tolist()}; allowed: up to {LARGEST['origin']:g} m or rad")


def _refuse_axis(joint: ET.Element) -> None:
    axis = triple(joint, "axis", "xyz", "1 0 0")
    if not SHORTEST_AXIS <= np.abs(axis).max() <= LONGEST_AXIS:
        got = f"joint {joint.get('name')!r} has the axis {axis.tolist()}"
        raise RobotError(f"{got}; allowed: a vector of length 1")


def doubts(root: ET.Element) -> list[str]:
    """A sentence about inertias that can be computed with but belong to no body: those that are not positive definite
    or violate the triangle inequality (the largest principal moment is at most the sum of the others)."""
    impossible = []
    for link in root.findall("link"):
        if link.find("inertial") is None:
            continue
        value = {key: number(link, "inertial/inertia", key, 0.0) for key in INERTIA}
        matrix = [[value["".join(("i", *sorted(a + b)))] for b in "xyz"] for a in "xyz"]
        small, middle, large = np.linalg.eigvalsh(matrix)
        allowed = ROUNDED * max(abs(small), abs(large))
        if small < -allowed or small + middle < large - allowed:
            impossible.append(link.get("name", ""))
    if not impossible:
        return []
    names = listed(impossible, most=5)
    return [f"the inertia of {names} is not physically consistent: check its <inertia>, about the centre of mass"]


def inertialess(inertias: Mapping[str, float]) -> list[str]:
    """A sentence about joints [name -> kg m^2; kg about the axis, of everything that they move] that move almost no
    inertia."""
    without = [name for name, inertia in inertias.items() if not inertia > 0]
    return [f"{listed(without, most=5)} moves no inertia: its <inertial> is missing or zero"] if without else []


def renamed(root: ET.Element) -> None:
    """Give links that are called like a joint another name: Pinocchio keeps both in one list."""
    joints = {x.get("name") for x in root.findall("joint")}
    taken = joints | {x.get("name") for x in root.findall("link")}
    new: dict[str, str] = {}
    for link in root.findall("link"):
        name = link.get("name", "")
        if name in joints:
            new[name] = next(x for k in range(len(taken) + 1) if (x := f"{name} (link{k or ''})") not in taken)
            link.set("name", new[name])
    for joint in root.findall("joint"):
        for end in joint.findall("parent") + joint.findall("child"):
            end.set("link", new.get(end.get("link", ""), end.get("link", "")))
