"""invdyn effects [NAME]: the physical effects that a diagnosis looks for, and all details of one of them."""

import ast
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.verbs.objects import admit_modules
from invdyn_cli.verbs.options import find
from invdyn_cli.verbs.usage import entry, look_up, width

HELP = """invdyn effects: the physical effects that a diagnosis looks for

usage: invdyn effects            all of them, and those of the Python files here
       invdyn effects NAME       equation, parameters, typical sizes, confounders,
                                 and what files for simulators contain of it
"""
ROBOT = "apollo_arm"
"""The arm of the typical sizes."""


class Place(NamedTuple):
    """The name of an effect on the command line, and its class, `module.Class`."""

    name: str
    target: str


def main(argv: Sequence[str]) -> int:
    """Print the list, or one effect; the exit code."""
    return look_up(argv, HELP, "effects", "effect", all_in_words, one_in_words)


def names() -> list[str]:
    """The names of all effects, without importing their classes."""
    return [place.name for place in (*_catalogue(), *own())]


def own() -> list[Place]:
    """The effects of the Python files in the working directory; none of these files is run."""
    return [place for path in sorted(Path.cwd().glob("*.py")) for place in _in_file(path, path.stem)]


def _catalogue() -> list[Place]:
    folder = Path(__file__).parents[1] / "effects"
    return [x for path in sorted(folder.glob("*.py")) for x in _in_file(path, f"invdyn_cli.effects.{path.stem}")]


def _in_file(path: Path, module: str) -> list[Place]:
    """The effects of a file: classes with a `name` whose base is called …Effect, or is an effect."""
    try:
        body = ast.parse(path.read_text(encoding="utf-8")).body
    except (OSError, SyntaxError, ValueError):
        return []
    classes = [x for x in body if isinstance(x, ast.ClassDef) and any("Effect" in ast.unparse(b) for b in x.bases)]
    named = [(_written(one).get("name"), one.name) for one in classes]
    return [Place(name, f"{module}.{kind}") for name, kind in named if isinstance(name, str)]


def _written(node: ast.ClassDef) -> dict[str, Any]:
    """The class attributes with plain values, as written in the source."""
    found = {}
    for one in node.body:
        if isinstance(one, ast.Assign) and isinstance(one.targets[0], ast.Name):
            try:
                found[one.targets[0].id] = ast.literal_eval(one.value)
            except ValueError:
                continue
    return found


def all_in_words() -> Iterator[str]:
    """The table."""
    from invdyn_cli import interfaces
    from invdyn_cli.diagnosis.checks.excitation import NEEDS
    from invdyn_cli.effects.catalogue import EFFECTS

    rows = [(x.name, x.title, x.group, x.point, [NEEDS[n] for n in x.needs]) for x in EFFECTS.values()]
    for place in own():
        node = find(place.target)
        assert isinstance(node, ast.ClassDef)  # own() has just found it
        written = _written(node)
        bases = [getattr(interfaces, ast.unparse(b).rpartition(".")[2], None) for b in node.bases]
        point = next((b.point for b in bases if b is not None and hasattr(b, "point")), "?")
        needs = [NEEDS.get(n, n) for n in written.get("needs", ())]
        title = f"{written.get('title', place.name)} ({place.target})"
        rows.append((place.name, title, written.get("group", "anomaly"), point, needs))
    columns = (29, 10, 9)
    yield "effect".ljust(29) + "group".ljust(10) + "acts at".ljust(9) + "shown by a motion where"
    for name, title, group, point, needs in rows:
        left = [name, *(f"  {x}" for x in textwrap.wrap(title, columns[0] - 3))]
        right = textwrap.wrap("; ".join(needs) or "any motion", width() - sum(columns))
        for k in range(max(len(left), len(right))):
            cells = (left[k] if k < len(left) else "", *((group, point) if k == 0 else ("", "")))
            line = "".join(x.ljust(n) for x, n in zip(cells, columns, strict=True))
            yield (line + (right[k] if k < len(right) else "")).rstrip()
    yield ""
    yield "An effect in full: invdyn effects NAME. One of your own: docs/own_effects.md."


def made(name: str) -> Any:
    """The effect of that name; a class of the working directory is imported for it.

    Raises:
        UsageError: if there is none, or it cannot be imported.
    """
    from invdyn_cli.effects.catalogue import EFFECTS
    from invdyn_cli.interfaces import AbstractEffect

    target = next((place.target for place in own() if name in (place.name, place.target)), "")
    if not target and name in EFFECTS:
        return EFFECTS[name]
    if not target:
        raise UsageError(f"effect {name!r}; allowed: {listed(names(), most=40)}{closest(name, names())}")
    module, _, kind = target.rpartition(".")
    admit_modules([module])
    try:
        effect = getattr(import_module(module), kind)()
    except Exception as error:
        raise UsageError(f"{target} cannot be made: {type(error).__name__}: {error}") from error
    if not isinstance(effect, AbstractEffect):
        raise UsageError(f"{target} is no effect; allowed: a class of invdyn_cli.interfaces")
    return effect


def one_in_words(name: str) -> Iterator[str]:
    """All details of an effect."""
    from invdyn_cli.diagnosis.checks.excitation import NEEDS
    from invdyn_cli.robots import load_urdf

    effect = made(name)
    robot = load_urdf(ROBOT)
    usual = _parameters(effect, robot)
    sizes = _typical(effect, [parameters for _, parameters in usual])
    yield f"{effect.title} ({effect.name})"
    yield from textwrap.wrap(effect.meaning, width())
    yield ""
    yield from entry("equation", effect.equation)
    yield from entry("acts at", f"{effect.point}, of {'a joint' if effect.of_joint else 'the whole arm'}")
    window = ", for a time only (a window of the log)" if effect.passing else ""
    yield from entry("group", effect.group + window)
    for key, bound in effect.parameters.items():
        unit = f"[{bound.unit}] {_bounds(bound.lower, bound.upper)}"
        yield from entry(f"parameter {key}", unit + (f"; typical {sizes[key]}" if key in sizes else ""))
    if sizes:
        yield from entry("typical on", f"the joints of {ROBOT}, from the smallest to the largest")
    yield from entry("torque sides", ", ".join(effect.sides))
    yield from entry("position sides", ", ".join(effect.position_sides))
    yield from entry("motion that shows it", "; ".join(NEEDS.get(x, x) for x in effect.needs) or "any motion")
    rivals = "; ".join(" + ".join(x) for x in effect.confounders)
    yield from entry("may be mistaken for", rivals or "no other effect of the catalogue")
    yield from entry("to distinguish it", effect.advice or "nothing is known")
    for format_name, text in _in_files(effect, robot, usual):
        yield from entry(f"in {format_name}", text)
    yield from entry("source", effect.reference)
    yield from entry("code", f"{type(effect).__qualname__} in {type(effect).__module__}")


def _bounds(lower: float, upper: float) -> str:
    ends = [f"{x:.4g}" for x in (lower, upper)]
    if upper == float("inf"):
        return "any number" if lower == -upper else f"at least {ends[0]}"
    return f"at most {ends[1]}" if lower == -float("inf") else f"{ends[0]} to {ends[1]}"


def _parameters(effect: Any, robot: Any) -> list[tuple[int | None, dict[str, Any]]]:
    """(joint, typical parameters) of every joint that the effect may act on; [] where no size is typical."""
    from invdyn_cli.design.sizes import typical
    from invdyn_cli.design.trajectory import usual_of

    usual = usual_of(robot)
    first = 1 if effect.coupled else 0
    joints = range(first, robot.dofs) if effect.of_joint else [None]
    try:
        return [(joint, typical(effect, joint, robot, usual, 30.0)) for joint in joints]
    except UsageError:
        return []


def _typical(effect: Any, every: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Each parameter's sizes on all joints in words."""
    import numpy as np

    found: dict[str, str] = {}
    for name in effect.parameters if every else ():
        values = np.array([np.asarray(x[name], float) for x in every])
        low, high = ([f"{v:.3g}" for v in np.atleast_1d(end)] for end in (values.min(axis=0), values.max(axis=0)))
        ends = [f"[{', '.join(x)}]" if values.ndim > 1 else x[0] for x in (low, high)]
        found[name] = ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"
    return found


def _in_files(effect: Any, robot: Any, usual: Sequence[tuple[int | None, dict]]) -> Iterator[tuple[str, str]]:
    """(format, what it contains of the effect and what it lacks), from an export of the arm with it in the last of its
    usual sizes."""
    from invdyn_cli.diagnosis.extension import exported
    from invdyn_cli.effects.composition import EffectInstance
    from invdyn_cli.effects.description import ExtendedModel
    from invdyn_cli.joints import JOINT_TERMS

    if not usual:
        lost = effect.in_simulator({name: 0.0 for name in effect.parameters}).lost
        yield "MJCF and URDF", lost or "depends on its parameters"
        return
    joint, parameters = usual[-1]
    terms = effect.in_simulator(parameters)
    held = {name: f"{name.replace('_', ' ')} [{JOINT_TERMS[name]}]" for name in terms.joint}
    lasting = effect.point == "body" and not effect.passing
    inertials = "inertials" if lasting and not effect.turns_gravity else ""
    drive = "a drive of two joints (tendon)" if terms.drive else ""
    body = "a body on the last link" if terms.body is not None else inertials
    in_mjcf = [*held.values(), drive, body, "gravity" if effect.turns_gravity else ""]
    in_urdf = [*(text for x, text in held.items() if x in ("damping", "friction")), inertials]
    export = exported(ExtendedModel(robot, (EffectInstance(effect, joint, parameters),)))
    for name, parts, lacks in (("MJCF", in_mjcf, export.mjcf_lacks), ("URDF", in_urdf, export.urdf_lacks)):
        yield name, "; ".join([*filter(None, parts), *(x.partition(": ")[2] for x in lacks)]) or "nothing"
