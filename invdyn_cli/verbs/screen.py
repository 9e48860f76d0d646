"""What a verb shows while it works (progress on stderr), and the compilation cache that makes the second run quick."""

import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from invdyn_cli.interfaces import silent


class Screen(Console):
    """A terminal that shows text as it stands: names from a file are never read as markup."""

    def __init__(self, *, stderr: bool = False, quiet: bool = False, width: int | None = None) -> None:
        super().__init__(stderr=stderr, quiet=quiet, width=width, markup=False, emoji=False, highlight=False)

    def note(self, line: str) -> None:
        """What a reader may pass over."""
        self.print(line, style="dim")

    def warn(self, line: str) -> None:
        """What a reader should not pass over."""
        self.print(line, style="yellow")

    def whole(self, line: object) -> None:
        """A line that is not broken at the terminal's width: a path, say."""
        self.print(str(line), soft_wrap=True)

    def on_broken_pipe(self) -> None:
        """rich would end the process with exit code 1; `cli.entry` ends it with a word."""
        raise BrokenPipeError


@contextmanager
def stages(*, quiet: bool = False) -> Iterator[Callable]:
    """Gives a function that opens a stage by name and returns what to report its share and note to."""
    console = Screen(stderr=True)
    if quiet or not console.is_terminal:
        yield lambda name: silent
        return
    columns = (
        TextColumn("{task.description:>8}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console, transient=True) as progress:

        def stage(name: str):
            task = progress.add_task(name, total=1.0, note="")

            def report(done: float, note: str) -> None:
                progress.update(task, completed=done, note=note)

            return report

        yield stage


def tell(line: str) -> None:
    """One line on stderr, as it stands."""
    Screen(stderr=True).whole(line)


def use_compilation_cache() -> None:
    """Keep compiled programs between runs, in $JAX_COMPILATION_CACHE_DIR or the user's cache folder."""
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")  # it only costs time
    if jax.config.values["jax_compilation_cache_dir"] is None:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(home / "invdyn" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
