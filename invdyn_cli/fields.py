"""Checks whether plain values of configs and run files match the annotations of the dataclass that receives them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from invdyn_cli.errors import UsageError, closest, listed

T = TypeVar("T")

WORDS = {int: "a whole number", float: "a number", str: "text", bool: "true or false", NoneType: "null"}
"""Plain types, and what they are called in a message."""


def suits(value: Any, hint: Any, is_a: Callable[[Any, type], bool] | None = None) -> bool:
    """Whether a value suits an annotation.

    Args:
        value: None, a number, a text, or a list or mapping of such.
        hint: an annotation of a field.
        is_a: whether a value stands for an object of a class. Without it annotations other than plain types, and lists
            of them, suit everything: what takes them decides.
    """
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return value in inner
    if origin in (Union, UnionType):
        return any(suits(value, one, is_a) for one in inner)
    if origin is tuple and inner[-1:] != (...,):
        return is_a is None or (
            isinstance(value, list | tuple)
            and len(value) == len(inner)
            and all(suits(x, one, is_a) for x, one in zip(value, inner, strict=True))
        )
    if origin in (tuple, Sequence) and (is_a or inner[0] in WORDS):
        return isinstance(value, list | tuple) and all(suits(x, inner[0], is_a) for x in value)
    if hint is float:
        return type(value) in (int, float)
    if hint in WORDS:
        return type(value) is hint
    if is_a is None or hint in (Any, object):
        return True
    if origin is Mapping or hint is Mapping:
        return isinstance(value, Mapping) and all(suits(x, (*inner, Any, Any)[1], is_a) for x in value.values())
    return isinstance(hint, type) and is_a(value, hint)


def in_words(hint: Any) -> str:
    """An annotation in words for a message."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return listed(map(str, inner))
    if origin in (Union, UnionType):
        return " or ".join(map(in_words, inner))
    if origin in (tuple, Sequence) and (origin is Sequence or inner[-1:] == (...,)):
        return f"a list, each {in_words(inner[0])}"
    return WORDS.get(hint) or getattr(hint, "__name__", str(hint))


def counts(owner: Any, group: str, *names: str) -> None:
    """Refuse options of an object that are no whole numbers >= 1; they are called `group.name`, or by their name alone
    for a `group` "", where they may stand in several places.

    Raises:
        UsageError: naming the first of them.
    """
    for name in names:
        value = getattr(owner, name)
        if not (isinstance(value, int) and value >= 1):
            raise UsageError(f"{_called(group, name)}={value}; allowed: a whole number >= 1")


def positive(owner: Any, group: str, *names: str) -> None:
    """The same of options that are no numbers > 0."""
    for name in names:
        value = getattr(owner, name)
        if not value > 0:
            raise UsageError(f"{_called(group, name)}={value}; allowed: a number > 0")


def _called(group: str, name: str) -> str:
    return f"{group}.{name}" if group else name


def made(kind: type[T], options: Mapping[str, Any], what: str) -> T:
    """An object of a dataclass from options by name; numbers of numpy count as Python's.

    Raises:
        UsageError: for an option that `what` does not have, a value that does not suit, or one that lacks.
    """
    own, hints = {f.name: f for f in fields(kind) if f.init}, get_type_hints(kind)  # pyright: ignore[reportArgumentType]
    plain = {name: x.item() if hasattr(x, "item") and not getattr(x, "shape", ()) else x for name, x in options.items()}
    for name, value in plain.items():
        if name not in own:
            got = f"{what} has no option {name}{closest(name, own)}"
            raise UsageError(f"{got}; allowed: {listed(own, most=30) if own else 'none'}")
        if not suits(value, hints[name]):
            raise UsageError(f"{what}: {name}={value!r}; allowed: {in_words(hints[name])}")
    for name, one in own.items():
        if name not in plain and one.default is MISSING and one.default_factory is MISSING:
            raise UsageError(f"{what} needs the option {name}; allowed: {in_words(hints[name])}")
    return kind(**plain)
