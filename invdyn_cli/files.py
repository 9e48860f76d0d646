"""All files of the package are written by `write_file`: completely, or not at all.

The content is written into a file without a name (if the system supports this), flushed to the disk, and named last. A
killed process leaves nothing behind; where files need a name from the start, the next process that writes into this
folder removes the incomplete file.
"""

import itertools
import os
import socket
from contextlib import contextmanager, suppress
from pathlib import Path

_HOST = socket.gethostname().replace("/", "_")
_NUMBER = itertools.count()


def write_file(path: str | Path, content: bytes | str) -> Path:
    """Write a whole file, text as UTF-8; folders on the way are made. Readers see the old file or the new one.

    Raises:
        OSError: if it cannot be written (disk full, no permission); the old file, if any, is as it was.
    """
    path = Path(path)
    data = content.encode(errors="replace") if isinstance(content, str) else content
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_stale(path.parent)
    part = path.with_name(f".invdyn-{_HOST}-{os.getpid()}-{next(_NUMBER)}.part")
    try:
        _write_part(part, data)
        part.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error  # not the name of the part
    finally:
        part.unlink(missing_ok=True)
    return path


def relative(path: Path) -> Path:
    """A path as seen from the working directory, where it lies below it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def remove_stale(folder: Path) -> None:
    """Remove the incomplete files that killed processes of this machine left in a folder."""
    for part in folder.glob(f".invdyn-{_HOST}-*.part"):
        owner = part.name.removeprefix(f".invdyn-{_HOST}-").partition("-")[0]
        if owner.isdigit() and not _is_alive(int(owner)):
            with suppress(OSError):
                part.unlink()


def _write_part(part: Path, data: bytes) -> None:
    """A flushed file with this content; it has a name only when it is whole, where the system can do that."""
    with _nameless(part.parent) as file:
        if file is not None:
            _fill(file, data)
            with suppress(OSError):  # a system that knows such files and cannot name them
                # Only with a descriptor does `os.link` follow /proc's link to the file.
                os.link(f"/proc/self/fd/{file}", part, src_dir_fd=file, follow_symlinks=True)
                return
    file = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    try:
        _fill(file, data)
    finally:
        os.close(file)


@contextmanager
def _nameless(folder: Path):
    """The descriptor of a new file without a name in a folder; None where there are no such files."""
    file = None
    if hasattr(os, "O_TMPFILE") and Path("/proc/self/fd").is_dir():
        with suppress(OSError):
            file = os.open(folder, os.O_WRONLY | os.O_TMPFILE, 0o666)
    try:
        yield file
    finally:
        if file is not None:
            os.close(file)


def _fill(file: int, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]
    os.fsync(file)


def _is_alive(process: int) -> bool:
    if os.name != "posix":  # elsewhere there is no signal that asks only
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is somebody else's, or the system cannot tell
        return True
    return True
