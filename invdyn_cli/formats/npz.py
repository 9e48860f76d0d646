"""Arrays that numpy saved (.npz), without pickle: a file with Python objects in it is refused."""

import zipfile
from pathlib import Path

import numpy as np

from invdyn_cli.errors import LogError, listed
from invdyn_cli.formats.table import Table, from_arrays, refuse_size


def read(path: Path, limit: float) -> tuple[Table, ...]:
    """The table of an archive of arrays (T,), (T, n).

    Raises:
        LogError: if it is none, holds Python objects, or more than `limit` [bytes].
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
            refuse_size(path, sum(entry.file_size for entry in entries), limit)
            return (from_arrays(path, {e.filename[:-4]: _array(path, archive, e) for e in entries}),)
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, MemoryError, NotImplementedError, RuntimeError) as error:
        raise LogError(
            f"{path} is no archive of arrays: {error}", advice="numpy.savez(path, t=t, q=q, tau=tau)"
        ) from error


def _array(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """One array, if its header does not declare more data than the archive contains."""
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in header:
            raise ValueError(f"version {version} of {entry.filename}")
        shape, _, dtype = header[version](file)
    if dtype.hasobject:
        got = f"{path}: {entry.filename[:-4]} holds Python objects"
        raise LogError(f"{got}; allowed: numbers", advice="an archive without them, because reading them runs code")
    if int(np.prod(shape, dtype=object)) * dtype.itemsize > entry.file_size:
        raise ValueError(f"{entry.filename} claims the shape {listed(map(str, shape))}")
    with archive.open(entry) as file:
        return np.lib.format.read_array(file, allow_pickle=False)
