"""invdyn excite: a reference trajectory that distinguishes rivals, as a csv for a controller."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig
from rich.table import Table

from invdyn_cli import store, untrusted
from invdyn_cli.compiled import use_compilation_cache
from invdyn_cli.design.causes import Cause
from invdyn_cli.design.contest import Side
from invdyn_cli.design.next_motion import all_open, cause_of, words
from invdyn_cli.design.sizes import left_out, refused, unplayable
from invdyn_cli.design.trajectory import APART, Design, Told, design
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.files import relative
from invdyn_cli.report import excitation
from invdyn_cli.report.wording import CAUTION
from invdyn_cli.simulation.played import write_csv
from invdyn_cli.types import Finding, Quantity, Robot
from invdyn_cli.verbs import screen
from invdyn_cli.verbs.launch import job, launch
from invdyn_cli.verbs.objects import plain
from invdyn_cli.verbs.run import make_robot, refuse_seed
from invdyn_cli.verbs.screen import Screen

TRAJECTORY, DESIGN, FIGURE = "trajectory.csv", "design.json", "trajectory.png"
"""Names of the files; design.json is written last."""

SCHEMA = "invdyn-design/1"

LONGEST, FASTEST = 600.0, 2000.0
"""[s] and [Hz] Largest values of a trajectory: a search holds it in memory."""


def main(argv: Sequence[str]) -> int:
    """Design with the overrides in argv; the exit code."""
    return launch("excite", argv, task)


def task(config: DictConfig) -> None:
    """One trajectory."""
    execute(config, Path(job().runtime.output_dir), Screen())


def execute(config: DictConfig, folder: Path, console: Screen) -> Design | None:
    """Config -> questions -> trajectory.csv, trajectory.png and design.json in `folder`; prints on `console` what the
    trajectory distinguishes. Returns None, and writes no trajectory, if no motion can be designed for the question."""
    use_compilation_cache()
    for name, low, high in (("duration", 5.0, LONGEST), ("rate", 20.0, FASTEST)):
        _refuse_number(config, name, low, high)
    refuse_seed(config.seed)
    robot = make_robot(config, None, optional=False, console=console)
    assert robot is not None  # make_robot refuses a config without a robot
    questions, said = questions_of(config, robot)
    known = [_cause(x, robot, "known") for x in _listed(config, "known")]
    noise = noise_of(config, robot)
    for line in said:
        console.warn(line)
    if not questions:
        console.print("No motion was designed.")
        return None
    with screen.stages(quiet=console.quiet) as stage:
        made = design(
            robot,
            questions,
            duration=float(config.duration),
            rate=float(config.rate),
            noise=noise,
            seed=config.seed,
            known=[x for x in known if isinstance(x, Cause)],
            progress=stage("design"),
        )
    write(made, folder)
    console.print(shown(made))
    console.print(CAUTION)
    for line in advice(made):
        console.warn(line)
    console.whole(relative(folder))
    return made


def questions_of(config: DictConfig, robot: Robot) -> tuple[list[tuple[Side, ...]], list[str]]:
    """The causes to distinguish, from `effects` or from a diagnosis, and a line for each for which no motion can be
    designed."""
    effects = _listed(config, "effects")
    if effects and config.diagnosis is not None:
        raise UsageError("both effects and diagnosis are given; allowed: one of them")
    if config.diagnosis is not None:
        return _of_diagnosis(config, robot)
    if config.finding is not None:
        raise UsageError(f"finding={config.finding} without a diagnosis", advice="diagnosis=FOLDER/diagnosis.json")
    if len(effects) < 2:
        got = f"effects: {len(effects)} to distinguish; allowed: two or more"
        raise UsageError(got, advice="'effects=[{effect: viscous_friction, joint: …}, {effect: torque_delay, …}]'")
    made = [_cause(x, robot, "effects") for x in effects]
    sides = tuple((x,) for x in made if isinstance(x, Cause))
    return [sides] if len(sides) > 1 else [], [x for x in made if isinstance(x, str)]


def _of_diagnosis(config: DictConfig, robot: Robot) -> tuple[list[tuple[Side, ...]], list[str]]:
    findings = findings_of(Path(str(config.diagnosis)))
    number = config.finding
    if number is not None and (type(number) is not int or not 1 <= number <= len(findings)):
        raise UsageError(f"finding={number}; allowed: 1 to {len(findings)}")
    for one in findings:
        if one.joint is not None and one.joint not in robot.joints:
            got = f"{config.diagnosis} has a joint {one.joint!r}; allowed: {listed(robot.joints)}"
            raise UsageError(got, advice="robot=urdf robot.path=…, the URDF of the diagnosed arm")
    asked = [x for x in all_open(findings, robot) if number in (None, x.finding + 1)]
    asked = [x for x in asked if x.playable or x.said or x.notes]
    if not asked:
        told = [f"{k + 1} {f.effect} ({f.status})" for k, f in enumerate(findings)]
        got = f"{config.diagnosis}: nothing to distinguish among the findings {listed(told)}"
        raise UsageError(f"{got}; allowed: an ambiguous finding")
    return [x.sides for x in asked if x.playable], [line for x in asked for line in (*x.said, *x.notes)]


def findings_of(path: Path) -> list[Finding]:
    """The claims of a diagnosis.json, as far as a design needs them.

    Raises:
        UsageError: for a file that is none.
    """
    tree = untrusted.read_json(path, UsageError, "the diagnosis.json of `invdyn diagnose`")
    try:
        if tree.get("schema") != store.DIAGNOSIS_SCHEMA:
            raise ValueError(f"schema {tree.get('schema')!r}")
        return [_finding(one) for one in tree["findings"] if one["status"] in ("named", "ambiguous")]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"{path}: {error}; allowed: a file of schema {store.DIAGNOSIS_SCHEMA}") from error


def _finding(one: Mapping[str, Any]) -> Finding:
    """A claim as in diagnosis.json; ValueError, TypeError, KeyError or AttributeError if it is not one."""
    alternatives = tuple(map(tuple, one["alternatives"]))
    for name in (one["effect"], *(x for names in alternatives for x in names)):
        if not isinstance(name, str):
            raise ValueError(f"a finding names {name!r}")
    return Finding(
        effect=one["effect"],
        joint=one["joint"],
        status=one["status"],
        alternatives=alternatives,
        parameters={k: Quantity(v["value"], v["unit"]) for k, v in one["parameters"].items()},
        evidence=dict(one.get("evidence", {})),
        advice=str(one.get("advice", "")),
    )


def noise_of(config: DictConfig, robot: Robot) -> np.ndarray | float | None:
    """The noise of the torques, one number or one for each joint."""
    value = plain(config.noise)
    if value is None:
        return None
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.shape not in ((), (robot.dofs,)) or not np.all(np.isfinite(numbers)) or np.any(numbers < 0):
        raise UsageError(f"noise={value}; allowed: a number >= 0, a list of {robot.dofs} such numbers, or null")
    return numbers


def write(made: Design, folder: Path) -> None:
    """The three files."""
    write_csv(folder / TRAJECTORY, made.t, np.asarray(made.motion.q), made.robot.joints)
    excitation.draw(made, folder / FIGURE)
    store.write_json(as_dict(made), folder / DESIGN)


def as_dict(made: Design) -> dict[str, Any]:
    """design.json: the distances between causes, their sizes, and how much of its limits each joint uses."""
    names, q, qd = made.robot.joints, np.asarray(made.motion.q), np.asarray(made.motion.qd)
    used = {
        name: {
            "position": [float(q[:, i].min()), float(q[:, i].max())],
            "speed": float(np.abs(qd[:, i]).max()),
            "torque": float(np.abs(made.torque[:, i]).max()),
        }
        for i, name in enumerate(names)
    }
    return {
        "schema": SCHEMA,
        "robot": made.robot.name,
        "joints": list(names),
        "seconds": float(made.t[-1]),
        "questions": [[[_plain(c, made.robot) for c in side] for side in sides] for sides in made.questions],
        "pairs": [
            {
                "question": p.question + 1,
                "true": words(p.true),
                "rival": words(p.rival),
                "standard_errors": p.distance,
                "share_left": p.share,
                "possible": p.possible,
                "apart": p.apart,
            }
            for p in made.pairs
        ],
        "used": used,
        "files": {"trajectory": TRAJECTORY, "figure": FIGURE},
    }


def shown(made: Design) -> Table:
    """A row for every pair."""
    title = f"{made.robot.name}, {made.t[-1]:.4g} s; causes are distinguishable at {APART:g} standard errors or more"
    table = Table("true cause", "assumed cause", title=title, title_justify="left")
    table.add_column("distance [standard errors]", justify="right")
    for p in made.pairs:
        distance = f"{p.distance:.3g}" if p.possible else "not distinguishable"
        table.add_row(*(_said(side, made.robot) for side in (p.true, p.rival)), distance)
    return table


def advice(made: Design) -> list[str]:
    """A line for every two causes that no motion distinguishes, or not this one."""
    lines = []
    for p in made.pairs:
        what = f"{words(p.true)} (true) and {words(p.rival)} (assumed)"
        if not p.possible:
            lines.append(f"{what}: no motion distinguishes them. Try: {_else(p)}")
        elif not p.apart:
            lines.append(f"{what}: a distance of {p.distance:.2g} standard errors is too small. Try: a longer duration")
    return lines


def _else(pair: Told) -> str:
    return next((c.effect.advice for c in (*pair.true, *pair.rival) if c.effect.advice), "another measurement")


def _said(side: Side, robot: Robot) -> str:
    return " + ".join(c.effect.title + (f" on {robot.joints[c.joint]}" if c.joint is not None else "") for c in side)


def _plain(cause: Cause, robot: Robot) -> dict[str, Any]:
    joint = None if cause.joint is None else robot.joints[cause.joint]
    return {"effect": cause.effect.name, "joint": joint, "parameters": dict(cause.parameters or {})}


def _listed(config: DictConfig, name: str) -> list[Any]:
    value = plain(config[name])
    if isinstance(value, Mapping):
        value = [value]
    if not isinstance(value, list):
        raise UsageError(f"{name}={value}; allowed: a list of {{effect: name, joint: name, parameter: value, …}}")
    return value


def _cause(one: Any, robot: Robot, option: str) -> Cause | str:
    """A cause from the command line; a line if no motion can be designed for it."""
    if not isinstance(one, Mapping) or not isinstance(one.get("effect"), str):
        raise UsageError(f"{option} has {one!r}; allowed: {{effect: name, joint: name, parameter: value, …}}")
    name, joint = one["effect"], one.get("joint")
    if name not in EFFECTS:
        got = f"{option}: there is no effect {name!r}{closest(name, EFFECTS)}"
        raise UsageError(f"{got}; allowed: {listed(EFFECTS, most=30)}")
    effect = EFFECTS[name]
    if joint is not None and joint not in robot.joints:
        got = f"{option}: there is no joint {joint!r}{closest(str(joint), robot.joints)}"
        raise UsageError(f"{got}; allowed: {listed(robot.joints)}")
    parameters = {k: v for k, v in one.items() if k not in ("effect", "joint")}
    for key, value in parameters.items():
        if key not in effect.parameters:
            got = f"{option}: {name} has no {key!r}; allowed: {listed(effect.parameters)}"
            raise UsageError(f"{got}{closest(str(key), effect.parameters)}")
        if not all(isinstance(x, int | float) for x in (value if isinstance(value, list) else [value])):
            raise UsageError(f"{option}: {name} {key}={value}; allowed: numbers")
    parameters = effect.whole(parameters) if parameters else {}
    missing = [k for k in effect.parameters if k not in parameters]
    if parameters and missing:
        raise UsageError(f"{option}: {name} lacks {listed(missing)}; allowed: all of its parameters, or none")
    wrong = refused(effect, parameters) if parameters else ""
    if wrong:
        raise UsageError(f"{option}: {name}: {wrong}")
    why = unplayable(effect, robot, parameters or None, joint)
    if why:
        return left_out(effect, why)
    made = cause_of(name, joint, parameters or None, robot)
    if made.joint is not None and joint is None:
        raise UsageError(f"{option}: {name} without a joint; allowed: {listed(robot.joints)}")
    return made


def _refuse_number(config: DictConfig, name: str, low: float, high: float) -> None:
    value = config[name]
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise UsageError(f"{name}={value}; allowed: a number from {low:g} to {high:g}")
