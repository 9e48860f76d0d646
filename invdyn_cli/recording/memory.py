"""Results that several checks need of the same log are computed once: the last result is kept, by identity."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])


def once_for_a_log(function: F) -> F:
    """The function of a log and further objects, its last value kept for as long as the very same objects ask and the
    log is alive. Nothing may change them in between."""
    kept: list[Any] = []

    @wraps(function)
    def asked(*objects: Any) -> Any:
        if kept and all(x is y for x, y in zip(objects, (kept[0](), *kept[1]), strict=True)):
            return kept[2]
        value = function(*objects)
        kept[:] = [weakref.ref(objects[0]), objects[1:], value]
        return value

    return asked  # type: ignore[return-value]
