"""HDF5 files from anyone, read in a separate process and written completely; no other file of the package uses h5py
except `hdf5_reader`.

A malicious file may crash libhdf5 or keep it busy for ever. `hdf5_reader` opens it in a separate process, which is
ended after a time limit. Links to other files and data above the size limit are refused before anything is read.
"""

import atexit
import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invdyn_cli.errors import InvdynError
from invdyn_cli.files import write_file

LIMIT = 2e9
"""[bytes] What may be read of one file, unless its reader says otherwise: an hour of eight joints at 1 kHz."""

PATIENCE, SLOWEST = 8.0, 20e6
"""Time limit [s] for reading a file, and slowest rate [bytes/s], by which a larger file gets more time."""

SCRIPT = Path(__file__).with_name("hdf5_reader.py")

SQUEEZED = 512
"""Number of values from which an array is compressed."""


@dataclass(frozen=True)
class Stored:
    """A dataset or an attribute as a file declares it: `kind` is "number", "text", "empty" or what else it is; `values`
    are those of an attribute, in a flat list."""

    kind: str
    shape: tuple[int, ...] | None
    values: Sequence[Any] | None = None


@dataclass(frozen=True)
class Group:
    """A group: its attributes and its members, by name."""

    attributes: Mapping[str, Any] = field(default_factory=dict)
    members: Mapping[str, Any] = field(default_factory=dict)


def outline(path: Path, raises: type[InvdynError]) -> Group:
    """The tree of a file: groups and `Stored`, no data.

    Raises:
        `raises`: if it is no HDF5 file, is damaged, or holds what is not allowed.
    """
    with _READER.lock:
        [head] = _READER.ask({"do": "outline", "path": str(path.absolute())}, path, raises)
    return _tree(head["tree"])


def read(
    path: Path, names: Sequence[str], raises: type[InvdynError], limit: float = LIMIT
) -> dict[str, np.ndarray | list[str] | str | None]:
    """The datasets of these names: arrays, lists of texts (a text where the shape is ()), None for empty ones.

    Raises:
        `raises`: as `outline`; also for a dataset that is neither numbers nor text, and beyond `limit` [bytes].
    """
    asked = {"do": "read", "path": str(path.absolute()), "names": list(names), "limit": int(limit)}
    with _READER.lock:
        heads = _READER.ask(asked, path, raises)
    return {name: _value(name, head, path, raises) for name, head in zip(names, heads, strict=True)}


def write(path: Path, root: Group) -> None:
    """Write a tree of groups (mappings will do), arrays, texts, lists of texts and None, whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
        _put_members(file, root)
        file.flush()
        image = file.id.get_file_image()
    write_file(path, image)


def _put_members(place: h5py.Group, group: Group | Mapping[str, Any]) -> None:
    attributes, members = (group.attributes, group.members) if isinstance(group, Group) else ({}, group)
    for name, value in attributes.items():
        place.attrs[name] = np.array(value, h5py.string_dtype()) if _is_texts(value) else value
    for name, value in members.items():
        if value is None:
            place[name] = h5py.Empty("f8")
        elif isinstance(value, Group | Mapping):
            _put_members(place.create_group(name), value)
        elif isinstance(value, str):
            place.create_dataset(name, data=value, dtype=h5py.string_dtype())
        elif _is_texts(value):
            place.create_dataset(name, data=list(value), shape=(len(value),), dtype=h5py.string_dtype())
        else:
            array = np.asarray(value)
            squeeze = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if array.size > SQUEEZED else {}
            place.create_dataset(name, data=array, **squeeze)


def _is_texts(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(x, str) for x in value)


def _tree(node: Mapping[str, Any]) -> Any:
    if node["kind"] != "group":
        return _stored(node)
    return Group(
        {name: _stored(x) for name, x in node["attributes"].items()},
        {name: _tree(x) for name, x in node["members"].items()},
    )


def _stored(node: Mapping[str, Any]) -> Stored:
    return Stored(node["kind"], None if node["shape"] is None else tuple(node["shape"]), node.get("values"))


def _value(name: str, head: Mapping[str, Any], path: Path, raises: type[InvdynError]) -> Any:
    if head["kind"] == "number":
        return head["array"]
    if head["kind"] == "text":
        return head["values"] if head["shape"] else head["values"][0]
    if head["kind"] == "empty":
        return None
    raise raises(f"{path}: {name} holds {head['kind']}; allowed: numbers or text")


class _Reader:
    """The process that reads, started when it is first needed, and again when one was lost."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def ask(self, request: Mapping[str, Any], path: Path, raises: type[InvdynError]) -> list[dict[str, Any]]:
        """All answers to a request about a file; the file is closed afterwards."""
        patience = PATIENCE + (path.stat().st_size if path.is_file() else 0) / SLOWEST
        process = self._running()
        assert process.stdin and process.stdout
        late = threading.Event()

        def end() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(patience, end)
        timer.start()
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
            heads = []
            while True:
                head = json.loads(process.stdout.readline() or b"null")
                if head is None:
                    raise EOFError
                if "done" in head:
                    return heads
                if "error" in head:
                    raise _refusal(path, head, raises)
                if "type" in head:
                    head["array"] = np.empty(head["shape"], head["type"])
                    _fill(process.stdout, head["array"])
                heads.append(head)
        except (EOFError, OSError, ValueError) as error:
            self.close()
            if late.is_set():
                got = f"is damaged, or slow to read: it took over {patience:.0f} s"
                advice = "again, where nothing else keeps the machine busy; or a new copy of it"
            else:
                got, advice = "is damaged: the HDF5 library crashed on it", "a new copy of it"
            raise raises(f"{path} {got}", advice=advice) from error
        except MemoryError as error:
            self.close()
            raise raises(f"{path} needs more memory than there is", advice="fewer trajectories") from error
        except InvdynError:
            raise
        except BaseException:  # stopped in the middle of an answer
            self.close()
            raise
        finally:
            timer.cancel()

    def _running(self) -> "subprocess.Popen[bytes]":
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            self.close()
            self._process = subprocess.Popen(
                [sys.executable, "-I", str(SCRIPT)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
            self._owner = os.getpid()
        return self._process

    def close(self) -> None:
        """End the process, if it belongs to this one."""
        if self._process is not None and self._owner == os.getpid():
            self._process.kill()
            self._process.communicate()
        self._process = None


def _refusal(path: Path, head: Mapping[str, Any], raises: type[InvdynError]) -> InvdynError:
    if head["refused"]:
        return raises(f"{path} {head['error']}")
    return raises(f"{path} is cut off or corrupt, HDF5 says: {head['error']}", advice="a new copy of it")


def _fill(stream: Any, array: np.ndarray) -> None:
    rest = array.reshape(-1).view(np.uint8).data
    while rest:
        count = stream.readinto(rest)
        if not count:
            raise EOFError
        rest = rest[count:]


_READER = _Reader()
atexit.register(_READER.close)
