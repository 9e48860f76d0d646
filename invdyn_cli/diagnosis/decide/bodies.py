"""Sentences about bodies: whether a change of the last link is a payload or a link error, and which of its parameters
are identifiable."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.decide.doubt import or_else
from invdyn_cli.effects.actuator import RotorInertia, TorqueGainError
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.load import LinkInertiaError
from invdyn_cli.types import Finding, Quantity, Robot

LINK = LinkInertiaError.name

LIGHTER = 0.5
"""Share of the last link's nominal mass up to which an added mass may as well be an error of its inertials."""

FARTHEST_TOOL = 1.0
"""[m] Largest distance of a payload's centre of mass from the last link's frame."""

HEAVIER = 1.0
"""Largest relative error of a link's mass that is reported as one."""

MANY_LINKS = 3
"""Number of links with wrong inertials from which on the whole model is in doubt."""


def as_link(robot: Robot, acting: EffectInstance, compares: bool = False) -> EffectInstance:
    """A payload that is physically impossible, or farther away than any tool, becomes an error of the last link's
    inertials. Since a reference (`compares`) one may have been taken off: its mass is then negative."""
    if not acting.effect.load or acting.effect.passing:  # links are not wrong for a time
        return acting
    mass, com = acting.parameters["mass"], acting.parameters["com"]
    if (mass > 0 or compares) and np.linalg.norm(com) <= FARTHEST_TOOL:
        return acting
    link, last = EFFECTS[LINK], robot.dofs - 1
    change = acting.effect.coordinates(acting.parameters, robot, None)
    assert change is not None  # a body's torque is linear in its inertials
    return EffectInstance(link, last, link.found(change, {}, robot, last))


def may_be_payload(ends: Mapping[str, tuple]) -> bool:
    """Whether some mass within its interval gives a possible body with these first moments."""
    return float(np.linalg.norm(ends["moment"][0])) <= FARTHEST_TOOL * float(ends["mass"][2])


def told(finding: Finding, acting: EffectInstance, robot: Robot, ends: Mapping[str, tuple]) -> Finding:
    """Payloads and link errors: which of the two a change of the last link is, and which of its parameters are
    identifiable."""
    effect, joint = acting.effect, acting.joint
    if effect.load:
        finding = replace(finding, parameters={name: finding.parameters[name] for name in ("mass", "com")})
        nominal = float(robot.inertial[-1, 0])
        if not effect.passing and abs(float(ends["mass"][0])) < LIGHTER * nominal:
            return replace(
                finding,
                alternatives=(*finding.alternatives, (LINK,)),
                evidence={**finding.evidence, "mass_of_last_link_kg": nominal},
            )
    elif effect.changes_inertials and joint is not None:
        scales = {"mass": 1.0, "moment": 0.2, "inertia": 0.05}
        shown = {
            name: q if np.all(np.asarray(q.interval95[1]) - np.asarray(q.interval95[0]) < 2 * scales[name]) else None
            for name, q in finding.parameters.items()
        }
        known = {name: q or replace(finding.parameters[name], value=None, interval95=None) for name, q in shown.items()}
        finding = replace(finding, parameters={"link": Quantity(link_names(robot)[joint], ""), **known})
        if not -1 < float(ends["mass"][0]) / max(robot.inertial[joint, 0], 1e-9) < HEAVIER:
            finding = replace(
                finding,
                alternatives=(*finding.alternatives, (RotorInertia.name,), (TorqueGainError.name,)),
                advice="this mass is not plausible: look for other effects on this joint and the joints before it",
            )
    return finding


def other_robot(claims: list[Finding]) -> tuple[list[Finding], tuple[str, ...]]:
    """If many links seem wrong, none of them is named: the model may belong to another robot."""
    links = [f for f in claims if f.effect == LINK]
    if len(links) < MANY_LINKS:
        return claims, ()
    said = f"The inertials of {len(links)} links seem wrong: this URDF may describe another robot or another tool."
    return [or_else(f, (LINK,)) if f in links else f for f in claims], (said,)


def link_names(robot: Robot) -> tuple[str, ...]:
    """Names of the links that the joints move, from the URDF; the joints' own without one."""
    if not robot.urdf:
        return robot.joints
    children = {
        joint.get("name"): child.get("link", "")
        for joint in ET.fromstring(robot.urdf).findall("joint")
        if (child := joint.find("child")) is not None
    }
    return tuple(children.get(j) or j for j in robot.joints)
