"""What a verb shows while it works: progress on stderr."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from invdyn_cli.errors import shortened
from invdyn_cli.interfaces import silent

QUIET, INTERVAL = 2.0, 5.0
"""[s] that work may take before a line is written where stderr is no terminal, and between lines of one step."""

SWITCH = "INVDYN_PROGRESS"
"""The environment variable that turns progress off (off)."""


class Screen(Console):
    """A terminal that shows text literally: names from a file are never interpreted as markup."""

    def __init__(self, *, stderr: bool = False, quiet: bool = False, width: int | None = None) -> None:
        super().__init__(stderr=stderr, quiet=quiet, width=width, markup=False, emoji=False, highlight=False)

    def note(self, line: str) -> None:
        """What a reader may pass over."""
        self.print(line, style="dim")

    def warn(self, line: str) -> None:
        """Print a line that the reader should notice."""
        self.print(line, style="yellow")

    def whole(self, line: object) -> None:
        """Print a line that is not wrapped at the terminal's width, for example a path."""
        self.print(str(line), soft_wrap=True)

    def on_broken_pipe(self) -> None:
        """rich would end the process with exit code 1; `cli.entry` ends it with a word."""
        raise BrokenPipeError


@contextmanager
def stages(*, quiet: bool = False) -> Iterator[Callable]:
    """Gives a function that opens a stage by name and returns what to report its share and note to."""
    console = Screen(stderr=True)
    if quiet or os.environ.get(SWITCH) == "off":
        yield lambda name: silent
        return
    if not console.is_terminal:
        with Lines() as lines:
            yield lines.stage
        return
    columns = (
        TextColumn("{task.description:>8}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[clock]}"),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console, transient=True) as progress:

        def stage(name: str):
            clock = Clock()
            task = progress.add_task(name, total=1.0, note="", clock=clock)

            def report(done: float, note: str) -> None:
                clock.report(done)
                progress.update(task, completed=done, note=note)

            return report

        yield stage


class Clock:
    """The time that a step has taken, and an estimate of the time left: estimated when the share changes, counted down
    until it changes again, and not shown any more after that time is over."""

    def __init__(self) -> None:
        self.began = self.told = time.monotonic()
        self.done = 0.0

    def report(self, done: float) -> None:
        """The share that is done."""
        if done != self.done:
            self.done, self.told = done, time.monotonic()

    def elapsed(self) -> float:
        """[s] since the step began."""
        return time.monotonic() - self.began

    def left(self) -> float | None:
        """[s] that it will take yet; None where that is not known."""
        if not 0 < self.done < 1:
            return None
        left = (self.told - self.began) / self.done - self.elapsed()
        return left if left > 0 else None

    def __str__(self) -> str:
        left = self.left()
        return "" if left is None else f"about {_duration(left)} left"


class Lines:
    """Progress as lines on stderr, for pipes and files: the step, its share, the time; no control characters.

    A separate thread writes them, so that there are lines even while a compiled program reports nothing for minutes.
    """

    def __init__(self) -> None:
        self._began, self._step, self._over = time.monotonic(), ("", Clock(), ""), threading.Event()
        self._thread = threading.Thread(target=self._write, daemon=True)

    def __enter__(self) -> "Lines":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def stage(self, name: str) -> Callable[[float, str], None]:
        """Begin a step; gives what to report its share and note to."""
        clock = Clock()
        self._step = (name, clock, "")

        def report(done: float, note: str) -> None:
            clock.report(done)
            self._step = (name, clock, note)

        return report

    def _write(self) -> None:
        told, last = self._step[1], 0.0
        while not self._over.wait(0.2):
            name, clock, note = self._step
            now = time.monotonic()
            due = now - last >= (INTERVAL if clock is told else 0.5)
            if name and due and now - self._began >= QUIET:
                told, last = clock, now
                with suppress(OSError, ValueError, AttributeError):
                    sys.stderr.write(f"invdyn: {progress_line(name, clock, note)}\n")
                    sys.stderr.flush()


def progress_line(name: str, clock: Clock, note: str) -> str:
    """A step in words: its share if it reports one, the time left if that is known, else the time so far."""
    if clock.done >= 1:
        text = f"{name} 100 %"
    else:
        share = f"{name} {100 * clock.done:.0f} %" if clock.done > 0 else name
        text = f"{share}, {str(clock) or f'{_duration(clock.elapsed())} so far'}"
    return text + (f" ({shortened(note)})" if note else "")


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def tell(line: str) -> None:
    """One line on stderr, as it stands."""
    Screen(stderr=True).whole(line)
