"""`invdyn VERB --help`: usage, groups with their choices, and a line for every option, 80 columns wide."""

import os
import shutil
import textwrap
from collections.abc import Callable, Iterator, Sequence

from omegaconf import OmegaConf

from invdyn_cli.errors import InvdynError, UsageError
from invdyn_cli.verbs import options
from invdyn_cli.verbs.launch import complain, config_folder, told
from invdyn_cli.verbs.options import Described, Option

WIDTH, COLUMN = 80, 30
"""Columns of the whole text, and where the meaning of an option begins."""


def show(verb: str, argv: Sequence[str]) -> int:
    """Print the help of a verb, with the values that the overrides in argv give; the exit code."""
    try:
        overrides = [a for a in argv if "=" in a and not a.startswith("-")]
        print("\n".join(lines(verb, options.described(verb, overrides))))
        return 0
    except Exception as error:
        line = told(verb, error, argv)
        if not line:
            raise
        return complain(line)


def look_up(
    argv: Sequence[str],
    text: str,
    verb: str,
    what: str,
    every: Callable[[], Iterator[str]],
    one: Callable[[str], Iterator[str]],
) -> int:
    """A verb that looks things up: prints its help `text`, the lines of `every` thing, or those of `one` that argv
    names, `what` it is called in a message; the exit code."""
    if {"-h", "--help"} & set(argv):
        print(text, end="")
        return 0
    try:
        if len(argv) > 1:
            raise UsageError(f"{verb} {' '.join(argv)}; allowed: the name of one {what}")
        print("\n".join(one(argv[0]) if argv else every()), flush=True)
    except BrokenPipeError:  # head has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python flushes stdout once more at its end
    except Exception as error:
        line = str(error) if isinstance(error, InvdynError) else told("run", error, ())
        if not line:
            raise
        return complain(line)
    return 0


def lines(verb: str, found: Described) -> Iterator[str]:
    """The lines of the text."""
    node = OmegaConf.load(config_folder() / f"{verb}.yaml").hydra
    words = OmegaConf.to_container(node.help, resolve=False)
    assert isinstance(words, dict)  # every verb's YAML has header and template
    for line in words["template"].replace("${hydra:help.header}", words["header"]).rstrip().splitlines():
        if line == "$OPTIONS":
            yield from _groups(found)
            yield from _options(found)
        else:
            indent = " " * (len(line) - len(line.lstrip()) + 2 * line.startswith("usage"))
            yield from textwrap.wrap(line, width(), subsequent_indent=indent, break_on_hyphens=False) or [""]


def _groups(found: Described) -> Iterator[str]:
    if found.chosen:
        yield "Groups and their choices (* is chosen):"
    for name, choice in found.chosen.items():
        yield f"  {name}="
        for one, path in options.choices_of(name.partition("@")[0]).items():
            yield from entry(f"{'*' if one == choice else ' '} {one}", options.headline(path))
    if found.chosen:
        yield ""


def _options(found: Described) -> Iterator[str]:
    yield "Options, their values, and what they mean:"
    group = ""
    for one in found.options:
        if one.group != group:
            group = one.group
            yield from ("", f"  with {group}={found.chosen[group]}")
        yield from entry(setting(one), options.first_sentence(one.text))
    yield ""


def setting(one: Option) -> str:
    """An option as the command line takes it."""
    return f"{one.name}={one.value or '(required)'}"


def entry(left: str, text: str) -> Iterator[str]:
    """`left` and its text in two columns; the text begins on the next line where `left` is too long."""
    folded = textwrap.wrap(left, width(), initial_indent=" " * 2, subsequent_indent=" " * 6)
    body = textwrap.wrap(text, max(width() - COLUMN, 20), break_on_hyphens=False)
    if body and len(folded) == 1 and len(folded[0]) < COLUMN - 1:
        folded = [folded[0].ljust(COLUMN) + body.pop(0)]
    yield from folded
    yield from (" " * COLUMN + line for line in body)


def width() -> int:
    """Columns of the text: those of the terminal, at most WIDTH."""
    return max(min(shutil.get_terminal_size((WIDTH, 24)).columns, WIDTH), COLUMN + 20)
