"""MATLAB files (.mat): version 5 to 7 by scipy, version 7.3 as the HDF5 that it is."""

import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy

from invdyn_cli import hdf5
from invdyn_cli.errors import LogError
from invdyn_cli.formats.table import Table, from_arrays, refuse_size

COMPRESSED, HEADER, PIECE = 15, 128, 1 << 20
DEEPEST = 5
"""Depth of nested structures whose fields are read."""


def read(path: Path, limit: float) -> tuple[Table, ...]:
    """The table of a file's arrays; a field x of a structure s is called s.x, or x where s is all that there is.

    Raises:
        LogError: if it is no such file, or holds more than `limit` [bytes].
    """
    with path.open("rb") as file:
        start = file.read(HEADER)
    if b"MATLAB 7.3" in start or start[:8] == b"\x89HDF\r\n\x1a\n":
        return (from_arrays(path, _from_hdf5(path, limit)),)
    try:
        with path.open("rb") as file:
            refuse_size(path, _inflated(file, limit), limit)
        claimed = sum(8 * int(np.prod(shape, dtype=object)) for _, shape, _ in scipy.io.whosmat(path))
        refuse_size(path, claimed, limit)
        found = scipy.io.loadmat(path, simplify_cells=True)
    except LogError:
        raise
    except Exception as error:  # scipy raises nearly anything on a damaged file
        raise LogError(f"{path} is no MATLAB file that can be read: {error}", advice="save -v7 in MATLAB") from error
    values = {name: x for name, x in found.items() if not name.startswith("__")}
    if len(values) == 1 and isinstance(only := next(iter(values.values())), dict):
        values = only
    return (from_arrays(path, _flat(values)),)


def _flat(values: Mapping[str, Any], depth: int = 0) -> dict[str, np.ndarray]:
    out: dict[str, np.ndarray] = {}
    for name, value in values.items():
        if isinstance(value, dict) and depth < DEEPEST:
            out |= {f"{name}.{k}": x for k, x in _flat(value, depth + 1).items()}
        elif isinstance(value, np.ndarray):
            out[name] = value
    return out


def _from_hdf5(path: Path, limit: float) -> dict[str, np.ndarray]:
    """The numeric datasets of a version 7.3 file; MATLAB's first axis is HDF5's last."""
    names = list(_datasets(hdf5.outline(path, LogError)))
    arrays = hdf5.read(path, names, LogError, limit)
    return {name.replace("/", "."): np.asarray(x).T for name, x in arrays.items() if isinstance(x, np.ndarray)}


def _datasets(group: hdf5.Group, place: str = "") -> list[str]:
    out: list[str] = []
    for name, member in group.members.items():
        if name.startswith("#"):
            continue
        if isinstance(member, hdf5.Group):
            out += _datasets(member, f"{place}{name}/")
        elif member.kind == "number":
            out.append(f"{place}{name}")
    return out


def _inflated(file: BinaryIO, limit: float) -> float:
    """[bytes] that a version 5 file holds once inflated, counted no further than `limit`."""
    header = file.read(HEADER)
    order = "<" if header[126:128] == b"IM" else ">"
    total = 0
    while total <= limit and len(tag := file.read(8)) == 8:
        kind, size = np.frombuffer(tag, f"{order}u4")
        total += int(size)
        if kind != COMPRESSED:
            file.seek(int(size), 1)
            continue
        inflate, left = zlib.decompressobj(), int(size)
        while left > 0 and total <= limit:
            piece = file.read(min(left, PIECE))
            if not piece:
                return total
            left -= len(piece)
            while piece and total <= limit:
                total += len(inflate.decompress(piece, PIECE))
                piece = inflate.unconsumed_tail
        file.seek(max(left, 0), 1)
    return total
