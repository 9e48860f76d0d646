"""The robot description by itself, and beside the log: placeholders, a tool that is not there, how the base stands."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli import urdf
from invdyn_cli.diagnosis.checks.arrangement import AFTER_ORDER, FOUND, SOURCE, arrangement
from invdyn_cli.diagnosis.checks.fits import left
from invdyn_cli.diagnosis.checks.placeholders import EQUAL, SAME, ZERO, kinds_of
from invdyn_cli.diagnosis.checks.samples import EXCITED, Samples, gather, gravity_torque, regressor_rows
from invdyn_cli.diagnosis.checks.torque_units import doubted
from invdyn_cli.diagnosis.checks.torques import matched
from invdyn_cli.errors import listed
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log
from invdyn_cli.types import Check, Robot
from invdyn_cli.urdf_checks import INERTIA

NOT_COMPARED = "tool and base are not compared"

OTHERWISE_MOUNTED = "the base is not mounted as the URDF says: it hangs, or stands at a wall"
"""What a check means beside which a diagnosis is of little use."""


@dataclass(frozen=True)
class Description(AbstractCheck):
    """The URDF: inertias that are zero or placeholders, centres of mass at link origins, no `<dynamics>`; and from the
    torques, the mass at the arm's end and the direction of gravity.

    Attributes:
        tool: [kg] by which the mass at the end has to be off, and `share` of the arm's mass (ours: cables and screws).
        sure: standard deviations, of blocks of the log, that it takes (ours).
        tilt: [degrees] of fitted gravity from the URDF's (ours: mounting errors, and what inertials that are off look
            like, stay below); `better`: ratio of what stays of the torque before and after.
        gone: of the URDF's gravity, below which there is hardly any, and no direction (ours).
    """

    name: ClassVar[str] = "urdf"
    tool: float = 0.2
    share: float = 0.01
    sure: float = 5.0
    tilt: float = 8.0
    better: float = 1.5
    gone: float = 0.3

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """What the log says of the file, then what its numbers say."""
        if robot is None:
            return [self.skipped("no robot")]
        found = list(self._written(robot))
        verdict = arrangement(log, robot)
        if verdict is not None and not verdict.in_order:
            return [*found, self.skipped(f"{AFTER_ORDER}: {NOT_COMPARED}")]
        if verdict is not None and verdict.gravity is not None:
            return [*found, self._mounting(robot, verdict.gravity)]
        samples = gather(log, robot, 1024) if log.trajectories and "gravity" not in log.compensated else None
        judged = self._joints(samples, doubted(log, robot))
        if samples is None or len(judged) < 2:
            why = f"too few joints whose torque is in N m and follows the torque computed from the URDF: {NOT_COMPARED}"
            return [*found, self.skipped(why)]
        gravity = self._gravity(samples, robot, judged)
        gone = any(NOT_COMPARED in one.seen for one in gravity)
        return [*gravity, *([] if gone else self._tool(samples, robot, judged)), *found]

    def _written(self, robot: Robot) -> Iterator[Check]:
        """What the file's numbers say without a log."""
        try:
            root = ET.fromstring(robot.urdf)
        except ET.ParseError:
            return
        links = {x.get("name", ""): x for x in root.findall("link")}
        moving = [x for x in root.findall("joint") if x.get("name") in robot.joints]
        carried = {x.find("child").get("link"): x.get("name") for x in moving}  # type: ignore[union-attr]
        masses = {name: urdf.number(links[name], "inertial/mass", "value", 0.0) for name in carried if name in links}
        none = [name for name, mass in masses.items() if mass <= 0]
        solid = [name for name in masses if name not in none]
        found = kinds_of([_inertia(links[x]) for x in solid], [masses[x] for x in solid])
        kinds = dict(zip(solid, found, strict=True))
        zero, equal, alike = ([name for name in solid if kinds[name] == kind] for kind in (ZERO, EQUAL, SAME))
        origins = [x for x in solid if x not in zero and not urdf.triple(links[x], "inertial/origin", "xyz").any()]
        yield from self._line("warn", none, "no mass", "its weight and inertia are missing in every torque", carried)
        yield from self._line("warn", zero, "zero inertia", "a body with a mass has an inertia", carried)
        why = "a placeholder, not the inertia of a body: acceleration torques are wrong"
        yield from self._line("note", equal, "equal moments of inertia on all axes", why, carried)
        why = "the same part twice, or a placeholder: then acceleration torques are wrong"
        yield from self._line("note", alike, "the same inertia as another link", why, carried)
        why = "with the centre of mass on the joint's axis gravity makes no torque: this is rare"
        yield from self._line("note", origins, "the centre of mass at the link's origin", why, carried)
        if moving and not any(x.find("dynamics") is not None for x in moving):
            yield Check(
                self.name,
                "note",
                seen="no joint has a <dynamics> element",
                meaning="the simulation has no friction; the diagnosis will find some on every joint",
                source="URDF",
            )

    def _line(self, severity: str, names: list[str], what: str, why: str, carried: dict) -> Iterator[Check]:
        if not names:
            return
        yield Check(
            self.name,
            severity,
            joint=carried[names[0]] if len(names) == 1 else None,
            value=names,
            seen=f"{what}: {listed(names, most=8)}",
            meaning=why,
            advice="the manufacturer's inertials, or those of the CAD model",
            source="URDF",
        )

    def _joints(self, samples: Samples | None, doubted: np.ndarray) -> list[int]:
        """Joints whose torque follows the URDF's, and is in its unit."""
        if samples is None:
            return []
        explained, _, excited = matched(samples)
        return np.flatnonzero((excited > EXCITED) & (np.diag(explained) > 0.5) & ~doubted).tolist()

    def _mounting(self, robot: Robot, gravity: np.ndarray) -> Check:
        """Another mounting of the base, by the likelihoods of the arrangement."""
        known = np.asarray(robot.gravity, float)
        return Check(
            self.name,
            "warn",
            value=_degrees(gravity, known),
            threshold={"log_odds": FOUND},
            seen=f"the torques fit an arm with gravity along {np.round(gravity, 2).tolist()} m/s^2 in the base frame, "
            f"and not along {np.round(known, 2).tolist()}",
            meaning=OTHERWISE_MOUNTED,
            advice=f"robot.gravity=[{','.join(f'{x:.4g}' for x in gravity)}], or robot.base_rpy",
            source=SOURCE,
        )

    def _gravity(self, samples: Samples, robot: Robot, judged: list[int]) -> list[Check]:
        """The direction of gravity in the base frame, by least squares beside friction."""
        axes = [gravity_torque(replace(robot, gravity=np.eye(3)[k]), samples.motion.q) for k in range(3)]
        inertial = samples.nominal - samples.gravity
        rows, target, before = [], [], 0.0
        for j in judged:
            own = samples.columns(j)
            y = left(samples.tau[:, j] - inertial[:, j], own)
            scale = max(float(np.std(left(samples.tau[:, j] - samples.nominal[:, j], own))), 1e-9)
            rows.append(left(np.stack([x[:, j] for x in axes], axis=1), own) / scale)
            target.append(y / scale)
            before += len(y)
        columns, wanted = np.concatenate(rows), np.concatenate(target)
        known = np.asarray(robot.gravity, float)
        if np.linalg.norm(known) == 0 or np.linalg.matrix_rank(columns, tol=1e-3 * np.linalg.norm(columns, 2)) < 3:
            return [self.skipped("the direction of gravity cannot be determined: the load changes on too few joints")]
        fitted, *_ = np.linalg.lstsq(columns, wanted, rcond=None)
        after = float(np.sum((wanted - columns @ fitted) ** 2))
        angle = _degrees(fitted, known)
        if before < self.better * after:
            return []
        share = float(np.linalg.norm(fitted) / np.linalg.norm(known))
        if share < self.gone:
            return [self.skipped(f"the gravity that fits best is {share:.2g} times the URDF's: {NOT_COMPARED}")]
        if angle < self.tilt:
            return []
        return [
            Check(
                self.name,
                "warn",
                value=angle,
                threshold={"degrees": self.tilt, "ratio": self.better},
                seen=f"gravity fits best along {np.round(fitted, 2).tolist()} m/s^2 in the base frame, {angle:.3g} "
                f"degrees from {np.round(known, 2).tolist()}; the unexplained torque falls by a factor of "
                f"{before / after:.3g}",
                meaning="the base may not be mounted as the URDF says",
                advice="if the base is tilted, set robot.gravity or robot.base_rpy",
                source="own choice: wrong inertials cause a smaller angle",
            )
        ]

    def _tool(self, samples: Samples, robot: Robot, judged: list[int]) -> list[Check]:
        """Mass and first moments at the end of the arm, beside friction and the links' own errors, by blocks."""
        rows, columns = regressor_rows(robot, samples.motion)
        end = columns[:, :, -10:-6]
        every = np.arange(len(rows))
        kept = [np.setdiff1d(every, block) for block in np.array_split(every, 6)]
        values = np.array([self._end(samples, rows, end, judged, x) for x in kept])
        mass = float(values.mean())
        deviation = float(np.sqrt(5 / 6 * np.sum((values - mass) ** 2)))
        total = float(np.asarray(robot.inertial)[:, 0].sum())
        if abs(mass) < max(self.tool, self.share * total, self.sure * deviation):
            return []
        word = "less" if mass < 0 else "more"
        why = "the URDF has a tool that the robot does not have" if mass < 0 else "the robot has a tool or a payload"
        return [
            Check(
                self.name,
                "note",
                joint=robot.joints[-1],
                value=mass,
                threshold={"kg": self.tool, "deviations": self.sure},
                seen=f"the arm's end weighs {abs(mass):.3g} kg {word} than the URDF says (standard deviation "
                f"{deviation:.2g} kg)",
                meaning=f"{why}, or the mass of another link is wrong by as much in the URDF",
                advice="the URDF with the tool that was mounted, or robot.payload",
                source="own choice: cables and screws weigh less",
            )
        ]

    def _end(self, samples, rows, end, judged, kept) -> float:
        """Mass [kg] at the end by ridge, beside friction and a tenth of every joint's nominal torque."""
        parts, wanted = [], []
        for j in judged:
            own = samples.columns(j)[rows][kept]
            rest = left((samples.tau - samples.nominal)[rows][kept, j], own)
            scale = max(float(rest.std()), 1e-9)
            gain = left(samples.nominal[rows][kept, j], own)
            block = np.zeros((len(kept), len(judged)))
            block[:, judged.index(j)] = 0.1 * gain
            parts.append(np.column_stack([left(end[j][kept], own) * [2.0, 0.2, 0.2, 0.2], block]) / scale)
            wanted.append(rest / scale)
        x, y = np.concatenate(parts), np.concatenate(wanted)
        p = x.shape[1]
        weight = 50.0 / len(kept)  # independent rows
        theta = np.linalg.solve(weight * x.T @ x + np.eye(p), weight * x.T @ y)
        return float(2.0 * theta[0])


def _inertia(link: ET.Element) -> np.ndarray:
    """(3, 3) about the centre of mass, axes of the inertial frame."""
    xx, xy, xz, yy, yz, zz = (urdf.number(link, "inertial/inertia", name) for name in INERTIA)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    """The angle between two directions (3,) [degrees]."""
    cosine = one @ other / max(np.linalg.norm(one) * np.linalg.norm(other), 1e-300)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
