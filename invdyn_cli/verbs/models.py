"""invdyn models [NAME]: the models and the ways to adapt them, with hyperparameters and source."""

import ast
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

from omegaconf import OmegaConf

from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.verbs import options
from invdyn_cli.verbs.usage import entry, look_up, setting, width

HELP = """invdyn models: the models, and the ways to adapt them while the robot works

usage: invdyn models             all of them, and those of the working folder
       invdyn models NAME        hyperparameters with unit and default, source
"""
GROUPS = {"model": "Models (model=NAME)", "adaptation": "Adaptations (adaptation=NAME)"}
PAPER = "paper: Hitzler, Meier, Schaal and Asfour, Humanoids 2019"


def main(argv: Sequence[str]) -> int:
    """Print the list, or one of them; the exit code."""
    return look_up(argv, HELP, "models", "model or adaptation", all_in_words, one_in_words)


def names() -> list[str]:
    """The names of all models and adaptations."""
    return list(dict.fromkeys(name for group in GROUPS for name in options.choices_of(group)))


def all_in_words() -> Iterator[str]:
    """Each with a line."""
    for group, title in GROUPS.items():
        yield f"{title}:"
        for name, path in options.choices_of(group).items():
            yield from entry(name, options.headline(path))
        yield ""
    yield f"({PAPER})"
    yield "One in full: invdyn models NAME. One of your own: docs/extending.md."


def one_in_words(name: str) -> Iterator[str]:
    """Its description, hyperparameters and source.

    Raises:
        UsageError: if there is none of that name.
    """
    groups = [group for group in GROUPS if name in options.choices_of(group)]
    if not groups:
        raise UsageError(f"unknown name {name}; allowed: {listed(names(), most=40)}{closest(name, names())}")
    for group in groups:
        path = options.choices_of(group)[name]
        yield from textwrap.wrap(f"{group}={name}: {options.headline(path)}", width())
        found = options.described("run", [f"{group}={name}"])
        target = str(OmegaConf.select(options.composed("run", [f"{group}={name}"]), f"{group}._target_"))
        for paragraph in _about(target):
            yield ""
            yield from textwrap.wrap(paragraph, width())
        yield ""
        own = [one for one in found.options if one.group == group]
        yield "Hyperparameters:" if own else "No hyperparameters."
        for one in own:
            yield from entry(setting(one), one.text)
        yield ""
        source = options.source_of(target.rpartition(".")[0])
        yield from entry("class", target)
        yield from entry("source", _relative(source) if source else "not found")
        yield from entry("config", _relative(path))
        yield f"  ({PAPER})"


def _about(target: str) -> list[str]:
    """The paragraphs of a docstring before its sections."""
    node = options.find(target)
    text = (ast.get_docstring(node) or "") if node else ""
    paragraphs = [" ".join(x.split()) for x in text.split("\n\n")]
    ends = [k for k, x in enumerate(paragraphs) if x.startswith(("Attributes:", "Args:", "Raises:", "Returns:"))]
    return paragraphs[: ends[0] if ends else None]


def _relative(path: Path) -> str:
    """As seen from the package's folder or the working directory, where it lies below one of them."""
    for root in (Path.cwd(), Path(__file__).parents[2]):
        if path.is_relative_to(root):
            return str(path.relative_to(root))
    return str(path)
