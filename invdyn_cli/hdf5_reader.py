"""The process that opens HDF5 files for `hdf5`: it answers requests on stdin until that is closed.

It stands alone (no other file of the package, no JAX), so that it starts in a fifth of a second, and a file on which
libhdf5 crashes or hangs takes down this process and nothing else. Requests and answers are a line of JSON each; what
was read of a dataset follows its answer as bytes.

A file is refused, before any of its data are read, for whatever reaches outside of it (soft and external links,
external and virtual datasets), for filters that are not HDF5's own, for types that are neither numbers nor text, for
datasets that claim far more than they store, and for more nodes than a log or a run has.
"""

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, BinaryIO

import h5py
import numpy as np

MOST_NODES, DEEPEST = 50_000, 32
"""Largest number of groups and datasets of a file, and largest depth: an hour of a run has some hundreds, five deep."""

LONGEST_ATTRIBUTE = 65_536
"""[bytes] Largest size of one attribute; libhdf5's own limit unless the writer of the file changes it."""

FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 5: "nbit", 6: "scaleoffset", 32000: "lzf"}
"""Filters that come with h5py; others are libraries that libhdf5 would load."""

MOST_SQUEEZED, SLACK = 1_100, 1 << 20
"""How many bytes a stored one may stand for (deflate's own limit is 1,032), beside so many for whatever is small."""

MEMORY = 1 << 30
"""[bytes] Memory that this process may use in addition to what a request may read."""


class Refused(Exception):
    """A sentence on what is not allowed in a file."""


def outline(path: str) -> Iterator[tuple[dict[str, Any], None]]:
    """The tree of a file: attributes with their values, datasets with shape and kind, none of their data."""
    _limit_memory(MEMORY)
    with h5py.File(path, "r") as file:
        yield {"tree": _group(file, "/", [MOST_NODES], 0)}, None


def read(path: str, names: list[str], limit: int) -> Iterator[tuple[dict[str, Any], memoryview | None]]:
    """The values of these datasets, one after the other; numbers as bytes behind the answer, text in it."""
    _limit_memory(MEMORY)
    with h5py.File(path, "r") as file:
        found: list[Any] = [file[name] for name in names]
        told = [_dataset(node, name) for node, name in zip(found, names, strict=True)]
        asked = sum(one["bytes"] for one in told)
        if asked > limit:
            raise Refused(f"holds {asked / 1e9:.3g} GB; allowed: {limit / 1e9:.3g} GB, or a larger max_size")
        _limit_memory(MEMORY + 3 * asked)
        for node, one in zip(found, told, strict=True):
            if one["kind"] == "text":
                values = node.asstr(errors="replace")[()]
                yield {"kind": "text", "values": _texts(values), "shape": one["shape"]}, None
            elif one["kind"] == "number":
                array = np.ascontiguousarray(node[()])
                data = array.reshape(-1).view(np.uint8).data
                yield {"kind": "number", "type": array.dtype.str, "shape": one["shape"]}, data
            else:
                yield one, None


def _group(group: h5py.Group, where: str, left: list[int], depth: int) -> dict[str, Any]:
    if depth > DEEPEST:
        raise Refused(f"has groups more than {DEEPEST} deep")
    members = {}
    for name in group:
        left[0] -= 1
        if left[0] < 0:
            raise Refused(f"has more than {MOST_NODES} groups and datasets")
        inner = f"{where}{name}"
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise Refused(f"has a link at {inner}; allowed: data in the file itself")
        node = group[name]
        if isinstance(node, h5py.Group):
            members[name] = _group(node, inner + "/", left, depth + 1)
        else:
            members[name] = _dataset(node, inner)
    return {"kind": "group", "attributes": _attributes(group, where), "members": members}


def _dataset(node: Any, where: str) -> dict[str, Any]:
    """Shape, kind and bytes of a dataset, if it may be read."""
    if not isinstance(node, h5py.Dataset):
        return {"kind": type(node).__name__, "shape": None, "bytes": 0}
    kind, item = _kind(node.id.get_type())
    if node.shape is None:
        return {"kind": "empty", "shape": None, "bytes": 0}
    layout = node.id.get_create_plist()
    if layout.get_external_count() or layout.get_layout() == h5py.h5d.VIRTUAL:
        raise Refused(f"has data of other files at {where}; allowed: data in the file itself")
    for i in range(layout.get_nfilters()):
        if (code := layout.get_filter(i)[0]) not in FILTERS:
            raise Refused(f"has data compressed by filter {code} at {where}; allowed: {', '.join(FILTERS.values())}")
    size, stored = item * int(np.prod(node.shape, dtype=object)), int(node.id.get_storage_size())
    if size > MOST_SQUEEZED * stored + SLACK:
        raise Refused(f"claims {size / 1e9:.3g} GB at {where} and stores {stored} bytes")
    return {"kind": kind, "shape": list(node.shape), "bytes": size}


def _attributes(node: Any, where: str) -> dict[str, Any]:
    out = {}
    for name in node.attrs:
        held = node.attrs.get_id(name)
        kind, item = _kind(held.get_type())
        shape = held.shape if held.get_space().get_simple_extent_type() != h5py.h5s.NULL else None
        if shape is None or kind not in ("number", "text"):
            out[name] = {"kind": "empty" if shape is None else kind, "values": None, "shape": None}
            continue
        if item * int(np.prod(shape, dtype=object)) > LONGEST_ATTRIBUTE:
            raise Refused(f"has an attribute {name} of more than {LONGEST_ATTRIBUTE} bytes at {where}")
        values = node.attrs[name]
        plain = _texts(values) if kind == "text" else np.asarray(values).ravel().tolist()
        out[name] = {"kind": kind, "values": plain, "shape": list(shape)}
    return out


def _kind(stored: Any) -> tuple[str, int]:
    """ "number", "text" or what else the type is called, and the bytes of a value."""
    try:
        dtype = stored.dtype
    except (TypeError, ValueError, NotImplementedError):
        return "a type that numpy does not have", stored.get_size()
    if h5py.check_string_dtype(dtype):
        return "text", dtype.itemsize
    if dtype.kind in "biuf" and dtype.itemsize <= 8 and dtype.subdtype is None:
        return "number", dtype.itemsize
    return str(dtype), dtype.itemsize


def _texts(values: Any) -> list[str]:
    return [x.decode(errors="replace") if isinstance(x, bytes) else str(x) for x in np.asarray(values).ravel().tolist()]


def _limit_memory(size: int) -> None:
    try:
        import resource
    except ImportError:  # not a POSIX system: the limit on bytes is all there is
        return
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    with suppress(OSError, ValueError):  # systems that know the limit and do not keep it
        resource.setrlimit(resource.RLIMIT_AS, (size if hard == resource.RLIM_INFINITY else min(size, hard), hard))


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests {"do": "outline", "path"} and {"do": "read", "path", "names", "limit"} until there are none. The
    last line of every answer, {"done": true} or {"error": …}, is written after the file was closed."""
    doing = {"outline": outline, "read": read}
    for line in requests:
        asked = json.loads(line)
        try:
            for head, data in doing[asked.pop("do")](**asked):
                answers.write(json.dumps(head).encode() + b"\n")
                if data is not None:
                    answers.write(data)
            answers.write(b'{"done": true}\n')  # the file is closed again: whoever asked may write it anew
        except Refused as error:
            answers.write(json.dumps({"error": str(error), "refused": True}).encode() + b"\n")
        except Exception as error:  # h5py raises nearly anything on a damaged file
            said = f"{type(error).__name__}: {error}"[:300]
            answers.write(json.dumps({"error": said, "refused": False}).encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks; its end closes our stdin
    own = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whatever a library prints is no answer
    serve(sys.stdin.buffer, own)
