"""How the process ends if it cannot finish: by Ctrl-C, or because nobody reads its output any more.

Ctrl-C stops it within GRACE seconds, wherever it is: in Python, in compiled code, in an import.

Python handles Ctrl-C in its main thread, and only between two instructions: a compiled program of minutes delays it,
and an import may lose it. Therefore a thread of ours receives the signal, too, and ends the process if the main thread
has not done so. Files are written completely or not at all (`files`), so that nothing is damaged.
"""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

GRACE = 1.5
"""[s] Time that the main thread has to finish."""

STOPPED = 130
"""Exit code of a process that Ctrl-C stopped: 128 + SIGINT, as shells have it."""

SHOW_CURSOR = "\x1b[?25h"

_telling = threading.Lock()
_asked = threading.Event()


def watch() -> None:
    """Make Ctrl-C end this process; if the shell made it ignore Ctrl-C (nohup, &), it continues to ignore it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN or threading.current_thread() is not threading.main_thread():
        return
    signal.signal(signal.SIGINT, _interrupt)
    _report_others(sys.unraisablehook)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_wait, args=(reading,), daemon=True).start()


def ignore() -> None:
    """From here on Ctrl-C does nothing, because the work is done."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def end_with_parent() -> None:
    """From here on this process ends when the one that started it does, however that ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def was_asked() -> bool:
    """Whether Ctrl-C was pressed; then it is the reason for the end of the command, whatever else was raised."""
    return _asked.is_set()


def end() -> None:
    """Say that the process was stopped, and end it immediately: threads of XLA do not survive Python's own shutdown."""
    _telling.acquire()  # for good: who comes second waits until the process is gone
    with suppress(OSError, ValueError, AttributeError):
        sys.stdout.flush()
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.write((SHOW_CURSOR if sys.stderr.isatty() else "") + "invdyn: stopped\n")
        sys.stderr.flush()
    os._exit(STOPPED)


def closed_pipe() -> int:
    """Say that the reader of stdout (head, less) has gone; the exit code."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python flushes stdout once more at its end
    with suppress(OSError):
        print("invdyn: the output pipe was closed; files already written are kept", file=sys.stderr)
    return 2


def _interrupt(number: int, frame: object) -> None:
    _asked.set()
    raise KeyboardInterrupt


def _report_others(report: Callable[..., object]) -> None:
    """Suppress the message of a Ctrl-C at a point where nothing can be raised (in a callback of the garbage
    collector)."""

    def hook(unraisable: "sys.UnraisableHookArgs") -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            report(unraisable)

    sys.unraisablehook = hook


def _wait(reading: int) -> None:
    while os.read(reading, 1) != bytes([signal.SIGINT]):
        pass
    threading.Event().wait(GRACE)
    end()
