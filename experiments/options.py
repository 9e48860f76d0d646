"""Options of an experiment as they stand on its command line: name=value, lists with commas."""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from typing import Any, NoReturn, TypeVar

T = TypeVar("T")


def options_of(argv: Sequence[str], defaults: T, usage: str | None) -> T:
    """The defaults (a dataclass of numbers, text and tuples of text) with what argv says.

    Ends the program, with one line, for what is no option or no value of one, and after --help.
    """
    if {"-h", "--help"} & set(argv):
        print(usage)
        sys.exit(0)
    known = {f.name: getattr(defaults, f.name) for f in fields(defaults)}  # type: ignore[arg-type]
    said: dict[str, Any] = {}
    for argument in argv:
        name, equals, text = argument.partition("=")
        if not equals or name not in known:
            refuse(f"there is no option {argument!r}; allowed: {', '.join(f'{x}=…' for x in known)}")
        try:
            said[name] = _as(text, known[name])
        except ValueError:
            refuse(f"{argument}; allowed: a value like {name}={_text(known[name])}")
    return replace(defaults, **said)  # type: ignore[type-var]


def only_of(option: str, names: Sequence[str], allowed: Iterable[str]) -> Sequence[str]:
    """The names, all of which must be among the allowed ones; ends the program with one line if not."""
    allowed = list(allowed)
    for name in names:
        if name not in allowed:
            refuse(f"{option}={name}; allowed: {', '.join(allowed)}")
    return names


def refuse(line: str) -> NoReturn:
    """Wrong use: one line, exit code 2."""
    print(f"{line}. Try: --help", file=sys.stderr)
    sys.exit(2)


def _as(text: str, like: Any) -> Any:
    if isinstance(like, bool):
        if text not in ("true", "false"):
            raise ValueError
        return text == "true"
    if isinstance(like, tuple):
        return tuple(type(like[0])(x) for x in text.split(",") if x)
    return type(like)(text)


def _text(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value).lower()
