"""What can go wrong in use, and how it is said: what was got, what is allowed, what to try.

Failures of use are exceptions of this family; the command line prints them as one line and exits with 2.
Failures of numerics are not exceptions but sentences in a result (`Fit.warnings`).
"""

import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches
from functools import partial

LONGEST = 700
"""Largest number of characters of the input and of the advice in a message: names may come from any file."""


class InvdynError(Exception):
    """A wrong use: one line `got` (and what is allowed), and `advice`, a hint what to try."""

    def __init__(self, got: str, *, advice: str = "") -> None:
        super().__init__(got)
        self.got = got
        self.advice = advice

    def __str__(self) -> str:
        got = shortened(" ".join(self.got.split()), LONGEST)
        return f"{got}. Try: {shortened(' '.join(self.advice.split()), LONGEST)}" if self.advice else got

    def __reduce__(self):
        return partial(type(self), advice=self.advice), (self.got,)


class UsageError(InvdynError):
    """An option, an override or a combination of them that makes no sense."""


class RobotError(InvdynError):
    """A robot description that cannot be read, or does not belong to the data."""


class LogError(InvdynError):
    """A measured log that cannot be read, is broken, or lacks what was asked of it."""


class RunFileError(InvdynError):
    """A run.h5 that cannot be read or written."""


def shortened(text: object, most: int = 80) -> str:
    """A text from a file as a message may contain it: unprintable characters become "?", and it is cut to `most`
    characters."""
    shown = "".join("?" if unicodedata.category(c).startswith("C") else c for c in str(text)[: most + 1])
    return shown if len(shown) <= most else shown[: most - 1] + "…"


def listed(names: Iterable[str], *, most: int = 12) -> str:
    """The names, separated by commas; of a long list only the first, and the number of the others."""
    names = list(names)
    shown = ", ".join(names[:most]) if names else "(none)"
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def closest(name: str, allowed: Iterable[str]) -> str:
    """', did you mean X?' for the nearest allowed name, or nothing."""
    match = get_close_matches(name, list(allowed), n=1)
    return f", did you mean {match[0]!r}?" if match else ""
