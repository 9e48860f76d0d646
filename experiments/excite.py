"""Does one designed trajectory settle an ambiguous diagnosis?

    python experiments/excite.py [seed=1000] [cases=10] [duration=30] [most=2] [only=effect,effect]
        [folder=outputs/excite]

Effects of ordinary size are hidden in arms that then move slowly and little, until so many logs are diagnosed as
ambiguous with the right name among the others, and a motion can tell these apart. For each a trajectory is designed
from what the diagnosis says, played on the same arm with the same noise, and the new log is diagnosed by itself. The
design knows nothing of what is hidden. Of no effect are there more than `most` cases.
"""

import json
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from experiments.cases import SIZES, Case, draw_effect, draw_scene, inverse_dynamics
from experiments.confusion import claims, judge, matches
from experiments.options import only_of, options_of
from invdyn_cli.design.next_motion import FILE, after
from invdyn_cli.design.trajectory import Design
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.errors import UsageError
from invdyn_cli.logfile import Log
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.played import Played, write_csv
from invdyn_cli.simulation.references import AbstractReference, Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Diagnosis, Finding, Robot

SECONDS = 15.0
"""[s] of the poor log."""

OFTEN = (
    "actuator_lag",
    "viscous_friction",
    "link_inertia_error",
    "torque_delay",
    "quadratic_friction",
    "presliding_hysteresis",
    "backlash",
    "joint_elasticity",
    "stribeck_friction",
    "rotor_inertia",
)
"""Effects that a poor motion leaves open now and then, or that look much alike where a joint hardly moves."""

MOST_DRAWS = 60
"""Logs that are drawn for every case that is asked for, before the experiment gives up."""


@dataclass(frozen=True)
class Options:
    """What the command line may say."""

    seed: int = 1000
    cases: int = 10
    duration: float = 30.0
    only: Sequence[str] = OFTEN
    most: int = 2
    folder: str = "outputs/excite"


@dataclass(frozen=True)
class Plant:
    """An arm with something hidden in it, its noise, and the poor motion that it is first asked for."""

    robot: Robot
    hidden: tuple[Hidden, ...]
    noise: Noise
    poor: AbstractReference
    seed: int

    def play(self, reference: AbstractReference, duration: float, seed: int) -> Log:
        """The log of a reference."""
        how = {"noise": self.noise, "duration": duration, "seed": seed, "position_side": "motor"}
        return plant.record(self.robot, [reference], self.hidden, **how)


def draw_plant(seed: int, name: str) -> Plant:
    """An effect of the size that an ordinary motion calls for, on an arm that then moves slowly and little."""
    draw = np.random.default_rng([seed, zlib.crc32(name.encode()), 77])
    scene = draw_scene(draw)
    hidden = (draw_effect(draw, scene, name),)
    poor = Multisine(speed=float(draw.uniform(0.03, 0.12)), amplitude=float(draw.uniform(0.05, 0.25)))
    motion = poor.motion(scene.robot, SECONDS, 100.0, scene.seed)
    torque = inverse_dynamics(scene.robot, *(np.asarray(x) for x in (motion.q, motion.qd, motion.qdd)))
    rms = np.sqrt(np.mean(torque**2, axis=0))
    level = np.maximum(rms, 0.02 * rms.max()) * np.exp(draw.uniform(np.log(0.003), np.log(0.03)))
    noise = Noise(position=float(np.exp(draw.uniform(np.log(1e-6), np.log(1.5e-5)))), torque=tuple(level))
    return Plant(scene.robot, hidden, noise, poor, scene.seed)


@dataclass(frozen=True)
class Settled:
    """One case: what was hidden, said of the poor log, predicted, said of the designed one; "named" is right."""

    seed: int
    hidden: str
    poor: tuple[str, ...]
    distance: float
    designed: tuple[str, ...]
    result: str
    seconds: float


def open_finding(hidden: Hidden, diagnosis: Diagnosis) -> int | None:
    """Number of the ambiguous finding that has the hidden effect among its names."""
    for number, finding in enumerate(diagnosis.findings):
        if finding.status == "ambiguous" and matches(hidden, finding) == "ambiguous":
            return number
    return None


def least_distance(hidden: Hidden, finding: Finding) -> float | None:
    """The smallest predicted distance, in standard errors, of the hidden effect from a rival; None where no motion
    tells it from one of them, or no rival is in the catalogue."""
    own = [x for x in finding.evidence.get("distances", ()) if hidden.effect in x["true"].split(" + ")]
    own += [
        x
        for x in finding.evidence.get("distances", ())
        if hidden.effect in x["rival"].split(" + ") and not own  # a special case of its rivals
    ]
    if not own or not all(x["possible"] for x in own):
        return None
    return min(x["standard_errors"] for x in own)


def said(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The claims of a diagnosis in short."""
    return tuple(
        f.effect + "".join("|" + "+".join(a) for a in f.alternatives) + f"@{f.joint}" for f in claims(diagnosis)
    )


def play_designed(arm: Plant, design: Design, folder: Path, seed: int) -> Log:
    """The log of a design, by way of its file."""
    path = folder / f"{seed}_{arm.hidden[0].effect}_{FILE}"
    write_csv(path, design.t, np.asarray(design.motion.q), arm.robot.joints)
    return arm.play(Played(str(path)), float(design.t[-1]), arm.seed + 1)


def settle(seed: int, name: str, options: Options) -> Settled | str:
    """One drawn case: how it ends, or why it is none."""
    arm = draw_plant(seed, name)
    started = time.perf_counter()
    try:
        poor = diagnose(arm.play(arm.poor, SECONDS, arm.seed), arm.robot)
    except UsageError:
        return "out of control"
    place = open_finding(arm.hidden[0], poor)
    if place is None:
        return "not ambiguous"
    advised, design = after(poor, arm.robot, duration=options.duration)
    distance = least_distance(arm.hidden[0], advised.findings[place])
    if design is None or distance is None:
        return f"no motion tells: {said(poor)}"
    try:
        log = play_designed(arm, design, Path(options.folder), seed)
    except UsageError as error:
        return Settled(seed, _name(arm), said(poor), distance, (str(error),), "out of control", 0.0)
    fresh = diagnose(log, arm.robot)
    outcome = judge(Case(arm.robot, log, arm.hidden, 0.0, ""), fresh, seed, 0.0)
    seconds = time.perf_counter() - started
    return Settled(seed, _name(arm), said(poor), distance, said(fresh), outcome.result, seconds)


def drawn(options: Options) -> Iterator[tuple[int, str]]:
    """Seeds and effects, every effect in turn with seeds of its own."""
    for k in range(MOST_DRAWS * options.cases):
        yield options.seed + k // len(options.only), options.only[k % len(options.only)]


def table(settled: Sequence[Settled], left_out: Sequence[str], looked_at: int) -> str:
    """A row for every case, and the count, as Markdown."""
    lines = ["| hidden | seed | poor log | predicted distance | designed log | |", "|---|---:|---|---:|---|---|"]
    for x in settled:
        what = " · ".join(x.poor), " · ".join(x.designed) or "nothing"
        cells = (_escaped(what[0]), f"{x.distance:.0f}", _escaped(what[1]), x.result)
        lines.append(f"| {x.hidden} | {x.seed} | " + " | ".join(cells) + " |")
    right = sum(x.result == "named" for x in settled)
    return "\n".join(
        [
            *lines,
            "",
            f"- {right} of {len(settled)} ambiguous cases are named rightly from one designed recording alone.",
            f"- {looked_at} logs were drawn for them; {len(left_out)} more were ambiguous between names that no motion "
            "tells apart.",
        ]
    )


def main(argv: Sequence[str]) -> int:
    """Run as the docstring says."""
    options = options_of(argv, Options(), __doc__)
    only_of("only", options.only, SIZES)
    folder = Path(options.folder)
    folder.mkdir(parents=True, exist_ok=True)
    settled: list[Settled] = []
    left_out: list[str] = []
    looked_at = 0
    for seed, name in drawn(options):
        if sum(x.hidden.startswith(name + "@") for x in settled) >= options.most:
            continue
        looked_at += 1
        one = settle(seed, name, options)
        if isinstance(one, Settled):
            settled.append(one)
            print(f"{one.result}: {one}", flush=True)
        elif one.startswith("no motion"):
            left_out.append(one)
            print(f"{seed} {name}: {one}", flush=True)
        text = table(settled, left_out, looked_at)
        (folder / "excite.md").write_text(f"seeds from {options.seed}\n\n{text}\n")
        (folder / "excite.json").write_text(json.dumps([asdict(x) for x in settled], indent=1) + "\n")
        if len(settled) == options.cases:
            break
    print(table(settled, left_out, looked_at))
    return 0


def _name(arm: Plant) -> str:
    return f"{arm.hidden[0].effect}@{arm.hidden[0].joint}"


def _escaped(text: str) -> str:
    return text.replace("|", " or ")


if __name__ == "__main__":
    from invdyn_cli.verbs.screen import use_compilation_cache

    use_compilation_cache()
    sys.exit(main(sys.argv[1:]))
