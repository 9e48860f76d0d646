"""The benchmark for causes: logs with a hidden cause, given to any tool, and its answers scored (causes.md).

A tool is a command, `COMMAND log.h5 robot.urdf answer.json`. Its answer is a list of findings as in diagnosis.json, of
which `effect` and `joint` are needed, `parameters`, `status`, `alternatives` and `window` are read.
"""

import json
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from itertools import cycle, islice
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from experiments.cases import SIZES, WHOLE_ARM, draw_case
from experiments.confusion import LOUD, MAIN, matches, name_of, relative_error, said_of, told_by
from experiments.worn import ANOMALIES, drawn
from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.errors import UsageError, closest, listed, shortened
from invdyn_cli.files import write_file
from invdyn_cli.log import Log
from invdyn_cli.logfile import write_log
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.store import plain
from invdyn_cli.types import Finding, Quantity, Robot

TOOLS = {
    "ours": (),
    "least_squares": (),
    "pest": (),
    "mujoco_sysid": ("mujoco.sysid", "colorama", "plotly", "tabulate"),
    "figaroh": ("figaroh",),
}
"""The tools that have an adapter in causes_tools.py, and what each of them needs."""

EVENTS = ("payload_change", "external_contact", "torque_gain_change")
KINDS = ("worn", "perfect", "worn", "event", "worn", "clean", "perfect", "worn", "perfect", "clean worn")
"""Kinds of arms and causes, in turn."""

NAMES = {"worn": ANOMALIES, "perfect": tuple(x for x in SIZES if x not in EVENTS), "event": EVENTS}
"""What may be hidden in a log of each kind; nothing in the others."""

SPLIT = {"asymmetric_coulomb_friction": {"coulomb_friction", "torque_offset"}}
"""Effects that are the same as others together."""


class Made(NamedTuple):
    """A log, the robot that everybody believes it is of, the cause in it, what the arm has beside it, and how many
    times the noise of a joint's torque the cause makes."""

    log: Log
    robot: Robot
    hidden: Hidden | None
    beside: tuple[Hidden, ...]
    times: float


class Score(NamedTuple):
    """How an answer speaks of the cause ("named", "ambiguous", "missed", or "none" where there is none), what it names
    where the cause is, apart from wear, its false claims, and the relative errors of the cause's sizes."""

    result: str
    here: tuple[str, ...]
    false: tuple[str, ...]
    errors: tuple[float, ...]


@dataclass(frozen=True)
class Answered:
    """What a tool made of one log; `result` is "failed" where it gave no answer, and `note` says why."""

    tool: str
    number: int
    kind: str
    hidden: str
    times: float
    result: str
    here: tuple[str, ...]
    false: tuple[str, ...]
    errors: tuple[float, ...]
    seconds: float
    note: str


def make(seed: int, kind: str, name: str) -> Made:
    """A log with an effect hidden in it that makes over LOUD times the noise, or with none for "". Its arm stands
    upright: a URDF does not say how it stands."""
    for attempt in range(50):
        one = _made(seed + 100_000 * attempt, kind, name)
        if np.allclose(one.robot.gravity[:2], 0.0) and (one.times > LOUD or not name):
            return one
    raise RuntimeError(f"no upright arm from seed {seed} that shows {name}")


def _made(seed: int, kind: str, name: str) -> Made:
    if "worn" in kind:
        one = drawn(seed, name)
        return Made(one.log, one.scene.robot, one.anomaly, tuple(one.worn), one.times)
    case = draw_case(seed, [name] if name else [])
    return Made(case.log, case.robot, next(iter(case.hidden), None), (), case.share)


def command_of(tool: str) -> list[str]:
    """The words of a tool's command; files in them are found from any folder.

    Raises:
        UsageError: if it is neither the name of an adapter nor a command.
    """
    if tool in TOOLS:
        return [sys.executable, "-P", str(Path(__file__).with_name("causes_tools.py")), tool]
    words = shlex.split(tool)
    if not words or not shutil.which(words[0]):
        got = f"tool={tool}; allowed: {listed(TOOLS)}, or a command"
        raise UsageError(
            f"{got}{closest(tool, TOOLS)}", advice="tool='mytool --fast'; it gets log.h5 robot.urdf answer.json"
        )
    return [str(Path(x).resolve()) if Path(x).is_file() else x for x in words]


def lacks(tool: str) -> str:
    """What is not installed for an adapter, "" if nothing."""
    missing = [x for x in TOOLS.get(tool, ()) if not find_spec(x)]
    return f"{tool} was left out: it needs {listed(missing)} (pip install 'invdyn[causes]')" if missing else ""


def ask(command: Sequence[str], log: Path, urdf: Path, limit: float) -> tuple[list[Finding] | str, float]:
    """A tool's findings, or in one line why there are none, and its seconds. It runs in a folder of its own, which
    holds copies of the log and the URDF alone."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(log, Path(folder) / "log.h5")
        shutil.copy(urdf, Path(folder) / "robot.urdf")
        started = time.perf_counter()
        try:
            argv = [*command, "log.h5", "robot.urdf", "answer.json"]
            done = subprocess.run(argv, cwd=folder, capture_output=True, text=True, errors="replace", timeout=limit)
            said = (done.stderr.strip() or done.stdout.strip()).splitlines()
            answer = _read(Path(folder) / "answer.json") if done.returncode == 0 else None
            why = f"exit code {done.returncode}: {shortened(said[-1], 200) if said else 'it says nothing'}"
        except subprocess.TimeoutExpired:
            answer, why = None, f"no answer within {limit:g} s"
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            answer, why = None, f"answer.json is no list of findings: {shortened(error, 200)}"
        return why if answer is None else answer, time.perf_counter() - started


def _read(path: Path) -> list[Finding]:
    trees = json.loads(path.read_text())
    if not isinstance(trees, list) or not all(isinstance(x, dict) and {"effect", "joint"} <= x.keys() for x in trees):
        raise ValueError("it must be a list of objects that have effect and joint")
    return list(map(_finding, trees))


def _finding(tree: Mapping[str, Any]) -> Finding:
    """A finding of an answer, with the main parameters of its effect; each is a number, a vector or {"value": …}."""
    given = tree.get("parameters", {})
    sizes = {x: given[x] for x in MAIN.get(tree["effect"], ()) if x in given}
    sizes = {k: x["value"] if isinstance(x, Mapping) else x for k, x in sizes.items()}
    start, end = map(float, tree.get("window") or (0.0, 0.0))
    return Finding(
        effect=str(tree["effect"]),
        joint=None if tree["joint"] is None else str(tree["joint"]),
        status=str(tree.get("status", "named")),
        alternatives=tuple(tuple(map(str, x)) for x in tree.get("alternatives", ())),
        parameters={k: Quantity(np.asarray(x, float), "") for k, x in sizes.items() if x is not None},
        window=(start, end) if tree.get("window") else None,
    )


def score(hidden: Hidden | None, beside: Sequence[Hidden], found: Iterable[Finding]) -> Score:
    """What an answer is worth."""
    claims = [f for f in found if f.status in ("named", "ambiguous")]
    if hidden is None:
        return Score("none", (), tuple(said_of(f) for f in claims if not _is_there(f, beside)), ())
    best = told_by(hidden, claims)
    result = "missed" if best is None else matches(hidden, best)
    parts = SPLIT.get(hidden.effect, set())
    split = [f for f in claims if f.joint == hidden.joint and f.effect in parts and f.status == "named"]
    if parts and {f.effect for f in split} == parts:
        result = "named"
    rest = [f for f in claims if f is not best and not (result == "named" and f in split)]
    false = [f for f in rest if not matches(hidden, f) and not _is_there(f, [*beside, *_rotor(hidden)])]
    here = [f for f in claims if hidden.effect in WHOLE_ARM or f.joint == hidden.joint]
    names = dict.fromkeys(said_of(f).split("@")[0] for f in here if not _is_there(f, beside))
    errors = size_errors(hidden, beside, best) if best and best.effect == hidden.effect else ()
    return Score(result, tuple(names), tuple(map(said_of, false)), errors)


def _is_there(claim: Finding, beside: Sequence[Hidden]) -> bool:
    """Whether a claim is true of what an arm has beside its cause, or says that it may be that."""
    here = {one.effect for one in beside if one.joint in (claim.joint, None)}
    may = claim.status == "ambiguous" and any(set(one) <= here for one in [(claim.effect,), *claim.alternatives])
    return may or any(matches(one, claim) for one in beside)


def _rotor(hidden: Hidden) -> list[Hidden]:
    """The rotor that a gear or a coupled drive brings with it: to name it is right, and not what is asked for."""
    return [Hidden("rotor_inertia", hidden.joint)] * bool({"rotor", "armature"} & set(hidden.parameters))


def size_errors(hidden: Hidden, beside: Sequence[Hidden], finding: Finding) -> tuple[float, ...]:
    """Relative errors of the main parameters that a finding has; none where wear on that joint adds to one of them."""
    names = MAIN[hidden.effect]
    if any(one.joint == hidden.joint and set(names) & set(one.parameters) for one in beside):
        return ()
    sizes = [(x, finding.parameters[x].value, hidden.parameters[x]) for x in names if x in finding.parameters]
    return tuple(relative_error(x, y, true) for x, y, true in sizes if np.shape(y) == np.shape(true))


@dataclass(frozen=True)
class Causes(AbstractExperiment):
    """Logs with hidden causes, answered by tools."""

    row: ClassVar[type] = Answered

    seed: int = 0
    logs: int = 60
    tool: Sequence[str] = tuple(TOOLS)
    limit: float = 1800

    def plan(self, rows: Sequence[Answered]) -> Iterable[tuple]:
        """A job per log: its number, what is drawn, and the tools."""
        tools = [x for x in self.tool if not lacks(x)]
        for tool in tools:
            command_of(tool)
        if not tools:
            raise UsageError("; ".join(map(lacks, self.tool)) or f"tool=[]; allowed: {listed(TOOLS)}, or a command")
        draw = np.random.default_rng([self.seed, 11])
        turns = {kind: cycle(map(str, draw.permutation(names))) for kind, names in NAMES.items()}
        for k, kind in enumerate(islice(cycle(KINDS), self.logs)):
            yield k, 1000 * self.seed + k, kind, next(turns[kind]) if kind in turns else "", *tools

    def run(self, folder: Path, number: int, seed: int, kind: str, name: str, *tools: str) -> Iterable[Answered]:
        """Make one log, ask the tools, and only then write the truth."""
        made, place = make(seed, kind, name), folder / "logs" / f"{number:03d}"
        urdf = write_file(place / "robot.urdf", made.robot.urdf)
        write_log(replace(made.log, urdf=str(urdf)), place / "log.h5")
        answers = []
        for tool in tools:
            found, seconds = ask(command_of(tool), place / "log.h5", urdf, self.limit)
            failed = isinstance(found, str)
            scored = Score("failed", (), (), ()) if failed else score(made.hidden, made.beside, found)
            note = found if failed else ""
            answers.append(Answered(tool, number, kind, name_of(made.hidden), made.times, *scored, seconds, note))
        truth = {"hidden": made.hidden and asdict(made.hidden), "beside": list(map(asdict, made.beside))}
        write_file(folder / "truth" / f"{number:03d}.json", json.dumps(plain(truth), indent=1))
        return answers

    def line(self, row: Answered) -> str:
        """What was hidden and what was named."""
        said = row.note or f"{row.here or 'nothing'} there, false {row.false}"
        return f"{row.number} {row.tool}: {row.result}, {row.hidden} at {row.times:.1f}: {said}; {row.seconds:.0f} s"

    def table(self, rows: Sequence[Answered]) -> str:
        """A row per tool, then hidden by named, as Markdown; and which tools are not installed."""
        by_tool = {tool: [x for x in rows if x.tool == tool] for tool in dict.fromkeys(x.tool for x in rows)}
        lines = [
            "| tool | logs with a cause | right | ambiguous | missed | failed | logs with a false claim "
            "| of those without a cause | size error, median | seconds, median |",
            "|---|" + "---:|" * 9,
        ]
        for tool, own in by_tool.items():
            counts = [sum(x.result == r for x in own) for r in ("named", "ambiguous", "missed", "failed")]
            clean = [x for x in own if x.hidden == "none"]
            errors = [e for x in own for e in x.errors]
            cells = [
                *(len(own) - len(clean), *counts),
                f"{sum(bool(x.false) for x in own)} of {len(own)}",
                f"{sum(bool(x.false) for x in clean)} of {len(clean)}",
                f"{100 * np.median(errors):.2g} %" if errors else "-",
                f"{np.median([x.seconds for x in own]):.2g}",
            ]
            lines.append(f"| {tool} | {' | '.join(map(str, cells))} |")
        lines += ["", "| hidden \\ named on its joint | logs | " + " | ".join(by_tool) + " |"]
        lines += ["|---|---:|" + "---|" * len(by_tool)]
        answered = [x for x in rows if x.result != "failed"]
        for name in (x for x in MAIN if any(row.hidden.startswith(x + "@") for row in answered)):
            own = [x for x in answered if x.hidden.startswith(name + "@")]
            cells = [_named(x for x in own if x.tool == tool) for tool in by_tool]
            lines.append(f"| {name} | {len({x.number for x in own})} | {' | '.join(cells)} |")
        return "\n".join([*lines, "", *filter(None, map(lacks, self.tool))]).strip()


def _named(rows: Iterable[Answered]) -> str:
    """What was named, the most frequent first, with its number of logs."""
    names = Counter(name.replace("|", " or ") for x in rows for name in x.here or ("nothing",))
    return ", ".join(f"{name} {count}" for name, count in names.most_common())
