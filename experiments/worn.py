"""Worn arms: friction on every joint, links some percent off, and one anomaly or none (worn.md)."""

import time
import zlib
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from experiments.cases import ATTEMPTS, SIZES, Case, Scene, draw_effect, draw_scene, excess, felt, scene_of
from experiments.confusion import claims, name_of, said_of
from experiments.told import by_kind, jobs, told
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.errors import UsageError
from invdyn_cli.log import Log
from invdyn_cli.report.wording import UNSEEN
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.control import Control
from invdyn_cli.simulation.gear import RESOLVED
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import AbstractReference, minimum_jerk, room
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Diagnosis, Finding, Motion, Robot

STANDARD = ("torque_offset", "coulomb_friction", "viscous_friction", "rotor_inertia", "link_inertia_error")
"""What every arm has: a claim of these is no anomaly."""

ANOMALIES = (
    "backlash",
    "joint_elasticity",
    "stribeck_friction",
    "torque_delay",
    "torque_gain_error",
    "encoder_offset",
    "payload",
    "load_dependent_friction",
    "joint_spring",
    "torque_ripple",
    "presliding_hysteresis",
    "torque_gain_change",
)
GRADUAL = 1 / 3
"""Share of the arms whose friction changes its side gradually, as it does on bristles and in most simulations."""

IDENTIFIED = 1 / 4
"""Share of the arms whose links are as their URDF says, because it was identified."""

LOUD = 3.0
"""Times the noise of a joint's torque, above which an anomaly is to be found. Noise is what the same arm without the
anomaly leaves over its true model below 20 Hz (an encoder of 14 bit makes torque on a heavy joint), or the torque
sensor's if that is more."""

COUNTS, RIGHT = 0.03, 0.1
"""Share of a joint's torque above which a standard term counts, and its largest relative error."""


@dataclass(frozen=True)
class RandomWalk(AbstractReference):
    """Every joint follows noise that was filtered by a low-pass, as when somebody leads the arm by hand."""

    cutoff: float = 0.3
    speed: float = 0.5

    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        """A posture from noise of 50 Hz behind three low-passes, faded in from rest and out again."""
        draw, coarse = np.random.default_rng([7, seed]), 50.0
        count = round(duration * coarse) + 1
        sections = butter(3, self.cutoff, fs=coarse, output="sos")
        walk = sosfiltfilt(sections, draw.normal(size=(count, robot.dofs)), axis=0)
        t = np.arange(count) / coarse
        walk *= minimum_jerk(np.minimum(t, duration - t) / 2.0)[0][:, None]
        middle, half, fastest = room(robot)
        speeds = np.abs(np.gradient(walk, 1 / coarse, axis=0)).max(0)
        walk *= np.minimum(0.8 * half / np.abs(walk).max(0), self.speed * fastest / speeds)
        path, at = make_interp_spline(t, walk, k=5), np.arange(round(duration * rate)) / rate
        return Motion(middle + path(at), path.derivative(1)(at), path.derivative(2)(at))


@dataclass(frozen=True)
class Counted:
    """One log: what was hidden beside the wear, how many times the noise it makes on the joint that feels it most
    (`beyond`: what that joint's other friction, offset and rotor do not take up of it), how it was spoken of, anomalies
    that were claimed beside it, and the relative error of each standard term that counts: on joints whose torque is
    more than the sensor's noise, and on the others (`faint`); whether the 95 % interval of each of them has its true
    value; whether what was missed is listed as what the log cannot show (`unseen`)."""

    seed: int
    said: str
    hidden: str
    times: float
    beyond: float
    result: str
    named: tuple[str, ...]
    false: tuple[str, ...]
    errors: tuple[float, ...]
    faint: tuple[float, ...]
    covered: tuple[bool, ...]
    verdict: str
    seconds: float
    unseen: bool


def wear(draw: np.random.Generator, scene: Scene) -> list[Hidden]:
    """Friction on every joint, 2 to 20 % of its torque each, and links up to 8 % off; some arms have friction that
    changes its side gradually, within 2 to 12 mrad/s (of a slow joint a share of its speed)."""
    made, gradual = [], np.random.default_rng([13, scene.seed])
    creeps = gradual.random() < GRADUAL
    for j, joint in enumerate(scene.robot.joints):
        coulomb, viscous = scene.torque[j] * np.exp(draw.uniform(np.log(0.02), np.log(0.2), 2))
        mass = scene.robot.inertial[j, 0]
        reach = np.linalg.norm(scene.robot.inertial[j, 1:4]) / max(mass, 1e-6)
        transition = {"transition": min(1.0, float(scene.speed[j])) * _drawn(gradual, 2e-3, 1.2e-2)}
        off = {
            "mass": float(mass * draw.uniform(-0.08, 0.08)),
            "com": [float(x) for x in 0.08 * reach * draw.uniform(-1, 1, 3) / np.sqrt(3)],
            "inertia": float(draw.uniform(-0.08, 0.08)),
        }
        made += [
            Hidden("coulomb_friction", joint, {"coulomb": float(coulomb)} | (transition if creeps else {})),
            Hidden("viscous_friction", joint, {"damping": float(viscous / scene.speed[j])}),
            Hidden("link_inertia_error", joint, off),
        ]
    return made


def sized(draw: np.random.Generator, scene: Scene, name: str, taken: Collection[str | None] = ()) -> Hidden:
    """An anomaly on a joint that none of `taken` has; what gears have is drawn wider than elsewhere."""
    free = [j for j in felt(scene, name) if scene.robot.joints[j] not in taken]
    j = int(draw.choice(free))
    one = draw_effect(draw, scene, name, j)
    wider: dict[str, Any] = {
        "backlash": lambda: {"gap": _drawn(draw, 1e-3, 2e-2)} | _teeth(draw),
        "joint_elasticity": lambda: {"damping": _damping(draw, one, scene, j)},
        "stribeck_friction": lambda: {"velocity": _drawn(draw, 0.01, 0.4), "exponent": float(draw.choice([1.0, 2.0]))},
    }
    return replace(one, parameters={**one.parameters, **wider.get(name, dict)()})


def _drawn(draw: np.random.Generator, least: float, most: float) -> float:
    """A size, its logarithm even."""
    return float(np.exp(draw.uniform(np.log(least), np.log(most))))


def _teeth(draw: np.random.Generator) -> dict[str, float]:
    """Stiffness [N m/rad] and damping ratio of teeth; those of every gear bounce otherwise."""
    return {"stiffness": _drawn(draw, 1e4, 1e6), "damping_ratio": _drawn(draw, 0.02, 0.5)}


def substeps_for(anomaly: Hidden, rate: float) -> int:
    """Steps of the physics per tick, short enough for teeth against the rotor."""
    if "damping_ratio" not in anomaly.parameters:
        return 4
    swing = float(np.sqrt(anomaly.parameters["stiffness"] / anomaly.parameters["rotor"]))
    return max(4, int(np.ceil(swing / (RESOLVED * rate))))


def _damping(draw: np.random.Generator, one: Hidden, scene: Scene, j: int) -> float:
    """Of a ratio of 0.02 to 0.3, for a rotor that swings on the spring."""
    ratio = _drawn(draw, 0.02, 0.3)
    return float(2 * ratio * np.sqrt(one.parameters["stiffness"] * one.parameters["rotor"]))


class Drawn(NamedTuple):
    """A log that a controller survived, with its scene, its wear, its anomaly, what is to be said of its plant, how
    many times the noise of a joint's torque the anomaly makes there at most, alone and beyond that joint's standard
    terms, the torque sensors' noise (n,), and what records an earlier log, before the anomaly, of another motion."""

    scene: Scene
    log: Log
    worn: list[Hidden]
    anomaly: Hidden | None
    said: str
    times: float
    beyond: float
    noise: np.ndarray
    before: Callable[[], Log]


def drawn(seed: int, name: str) -> Drawn:
    """The log of a seed with an anomaly, or none for ""."""
    for attempt in range(ATTEMPTS):
        draw = np.random.default_rng([seed, attempt, zlib.crc32(name.encode()), 9])
        scene, worn = _scene(draw)
        anomaly = sized(draw, scene, name) if name else None
        record, hiss, said = _recorder(draw, scene, [anomaly] if anomaly else [])
        try:
            log, *twin = (record(hidden) for hidden in ([[*worn, anomaly], worn] if anomaly else [worn]))
        except UsageError:
            continue
        times, beyond = _loudness(scene, log, twin[0], anomaly, worn, hiss) if anomaly else (0.0, 0.0)
        before = partial(record, worn, seed=scene.seed + 1)
        return Drawn(scene, log, worn, anomaly, said, times, beyond, hiss, before)
    raise RuntimeError(f"no stable case from seed {seed} for {name}")


def several(seed: int, names: Sequence[str]) -> Case:
    """A log with these anomalies at once, each on a joint of its own and by itself above LOUD times the noise; `faint`
    are those that are not, beyond their joint's standard terms."""
    for attempt in range(ATTEMPTS):
        draw = np.random.default_rng([seed, attempt, zlib.crc32("+".join(names).encode()), 9])
        scene, worn = _scene(draw)
        anomalies: list[Hidden] = []
        try:
            for name in names:
                anomalies.append(sized(draw, scene, name, [x.joint for x in anomalies]))
            record, hiss, said = _recorder(draw, scene, anomalies)
            twin = record(worn)
            times, beyond = np.transpose([_loudness(scene, record([*worn, x]), twin, x, worn, hiss) for x in anomalies])
            if times.min() > LOUD:
                faint = tuple(x for x, own in zip(anomalies, beyond, strict=True) if own <= LOUD)
                log = record([*worn, *anomalies])
                return Case(scene.robot, log, tuple(anomalies), float(times.min()), said, faint)
        except (UsageError, ValueError):  # no joint is free, or an arm that loses control
            continue
    raise RuntimeError(f"no loud, stable case from seed {seed} for {names}")


def _scene(draw: np.random.Generator) -> tuple[Scene, list[Hidden]]:
    """An arm with its motion, and its wear."""
    scene = draw_scene(draw)
    if draw.random() < 0.25:
        scene = scene_of(scene.robot, RandomWalk(), scene.duration, scene.seed)
    worn = wear(draw, scene)
    identified = np.random.default_rng([17, scene.seed]).random() < IDENTIFIED
    return scene, [x for x in worn if not (identified and x.effect == "link_inertia_error")]


def _recorder(
    draw: np.random.Generator, scene: Scene, anomalies: Sequence[Hidden]
) -> tuple[Callable[[Sequence[Hidden]], Log], np.ndarray, str]:
    """What records the log of an arm with hidden effects; the torque sensors' noise (n,); what is to be said of it."""
    rate, bits = float(draw.choice([200.0, 500.0, 1000.0, 2000.0])), int(draw.integers(14, 21))
    control = Control(
        frequency=float(draw.uniform(1.5, 4.0)),
        damping_ratio=float(draw.uniform(0.6, 1.2)),
        velocity_cutoff=float(draw.uniform(15, 60)),
        knows="arm" if draw.random() < 0.7 else "nominal",
    )
    hiss = np.maximum(scene.torque, 0.02 * scene.torque.max()) * np.exp(draw.uniform(np.log(0.002), np.log(0.02)))
    noise = Noise(position=1e-6, position_quantum=2 * np.pi / 2**bits, torque=tuple(hiss))
    if scene.duration * rate > 60_000:
        rate = 1000.0
    options: dict[str, Any] = {"duration": scene.duration, "rate": rate, "seed": scene.seed, "control": control}
    substeps = max([substeps_for(one, rate) for one in anomalies], default=4)
    options |= {"noise": noise, "position_side": "motor", "substeps": substeps}
    kind = type(scene.reference).__name__
    said = f"{scene.robot.dofs} joints, {kind} {scene.duration:g} s, {rate:g} Hz, {bits} bit, {control.knows}"
    return partial(plant.record, scene.robot, [scene.reference], **options), hiss, said


def _loudness(
    scene: Scene, log: Log, twin: Log, anomaly: Hidden, worn: Sequence[Hidden], hiss: np.ndarray
) -> tuple[float, float]:
    """How many times the noise of a joint's torque an anomaly makes there at most, alone and beyond standard terms."""
    both, without = excess(scene.robot, log, [anomaly], worn), excess(scene.robot, twin, [], worn)
    alone = np.sqrt(np.maximum(both**2 - without**2, 0.0))
    times, beyond = np.max(alone / np.maximum(hiss, without), axis=1).tolist()
    return times, beyond


class Term(NamedTuple):
    """A friction term of the written model: its relative error, whether its 95 % interval has the true value, and
    whether its joint's torque is less than the sensor's noise."""

    error: float
    covered: bool
    faint: bool


def terms_of(one: Drawn, diagnosis: Diagnosis) -> list[Term]:
    """The friction terms that count, but where bristles stand beside them."""
    terms = {"coulomb_friction": ("coulomb", "coulomb"), "viscous_friction": ("viscous", "damping")}
    scene, model, found = one.scene, diagnosis.model, []
    for friction in one.worn:
        beside = one.anomaly if one.anomaly and one.anomaly.joint == friction.joint else None
        if friction.effect not in terms or (beside and "hysteresis" in beside.effect):
            continue
        j = scene.robot.joints.index(str(friction.joint))
        term, name = terms[friction.effect]
        true = friction.parameters[name]
        if beside and beside.effect == "stribeck_friction" and term == "coulomb":
            true += beside.parameters["coulomb"]
        if true * (scene.speed[j] if term == "viscous" else 1.0) < COUNTS * scene.torque[j]:
            continue
        got = list(zip(model.acting, model.intervals, strict=True)) if model else []
        own = [x.get(name, (a.parameters[name],) * 3) for a, x in got if a.joint == j and name in a.parameters]
        value, low, high = np.sum([(0.0,) * 3, *own], axis=0)
        found.append(Term(abs(value - true) / true, low <= true <= high, scene.torque[j] <= one.noise[j]))
    return found


def spoken(anomaly: Hidden | None, found: Sequence[Finding]) -> tuple[str, list[Finding]]:
    """How an anomaly was spoken of, and the anomalies that were claimed beside it."""
    result, rest = told(anomaly, found)
    return result, beyond_wear(rest)


def beyond_wear(found: Iterable[Finding]) -> list[Finding]:
    """The findings that claim more than what every arm has."""
    return [f for f in found if f.effect not in STANDARD and not _usual(f)]


def _usual(finding: Finding) -> bool:
    """Whether a finding may be one of what every arm has after all."""
    return finding.status == "ambiguous" and any(set(one) <= set(STANDARD) for one in finding.alternatives)


def count(seed: int, name: str) -> Counted:
    """What a diagnosis says of one log."""
    one = drawn(seed, name)
    anomaly = one.anomaly
    started = time.perf_counter()
    diagnosis = diagnose(one.log, one.scene.robot)
    seconds = time.perf_counter() - started
    found = claims(diagnosis)
    result, false = spoken(anomaly, found)
    names = tuple(said_of(f) for f in found if f.effect not in STANDARD)
    terms = terms_of(one, diagnosis)
    loud, faint = (tuple(float(x.error) for x in terms if x.faint == faint) for faint in (False, True))
    covered = tuple(bool(x.covered) for x in terms)
    false = tuple(map(said_of, false))
    hidden = (anomaly.effect, anomaly.joint) if anomaly else None
    unseen = any((f.effect, f.joint) == hidden for f in diagnosis.findings if f.status in UNSEEN)
    return Counted(
        seed,
        one.said,
        name_of(anomaly),
        one.times,
        one.beyond,
        result,
        names,
        false,
        loud,
        faint,
        covered,
        diagnosis.verdict,
        seconds,
        result == "missed" and unseen,
    )


@dataclass(frozen=True)
class Worn(AbstractExperiment):
    """Anomalies on worn arms, in turn, and worn arms without one."""

    row: ClassVar[type] = Counted

    seed: int = 0
    logs: int = 30
    clean: int = 10
    only: Sequence[str] = ANOMALIES

    def plan(self, rows: Sequence[Counted]) -> Iterable[tuple]:
        """A job per log: its seed and its anomaly."""
        return jobs(self.seed, chosen("only", self.only, SIZES), self.logs, self.clean)

    def run(self, folder: Path, seed: int, name: str) -> Iterable[Counted]:
        """Draw, diagnose, judge one log."""
        yield count(seed, name)

    def line(self, row: Counted) -> str:
        """What was hidden and what was named."""
        return (
            f"{row.result}: {row.seed} {row.hidden} ({row.times:.1f} times the noise, {row.beyond:.1f} beyond terms) "
            f"-> {row.named} "
            f"({row.said}; {row.seconds:.0f} s, {row.verdict}, terms {100 * max(row.errors, default=0):.0f} %)"
        )

    def table(self, rows: Sequence[Counted]) -> str:
        """A row per anomaly, as Markdown, and what holds for all logs."""
        errors, faint = np.array([e for c in rows for e in c.errors]), np.array([e for c in rows for e in c.faint])
        covered = [x for c in rows for x in c.covered]
        worn = [c for c in rows if c.hidden != "none"]
        loud = [c for c in worn if c.times > LOUD]
        beyond = [c for c in loud if c.beyond > LOUD]
        right, plain, far = (sum(c.result in ("named", "ambiguous") for c in some) for some in (worn, loud, beyond))
        told = sum(c.unseen for c in beyond)
        seconds = sorted(c.seconds for c in rows)
        return "\n".join(
            [
                *by_kind(rows, "anomaly", loud, f"right, over {LOUD:g} times the noise"),
                "",
                f"Anomalies: {right} of {len(worn)} right or rightly ambiguous, "
                f"{plain} of {len(loud)} of those that make over {LOUD:g} times the noise, "
                f"{far} of {len(beyond)} of those that do so beyond their joint's standard terms"
                f"{f' ({told} more are listed as what this log cannot show)' if told else ''}; "
                f"{sum(bool(c.false) for c in rows)} of {len(rows)} logs with a false one beside it.",
                f"Standard terms: {np.sum(errors < RIGHT)} of {len(errors)} within 10 %, median error "
                f"{100 * np.median(errors) if len(errors) else 0:.2g} %; on joints whose torque is less than the "
                f"sensor's noise {np.sum(faint < RIGHT)} of {len(faint)}. The 95 % intervals of {sum(covered)} of "
                f"{len(covered)} have the true value.",
                f"Seconds a log: median {seconds[len(seconds) // 2]:.0f}, longest {seconds[-1]:.0f}.",
            ]
        )
