"""The process that reads HDF5 files, and the files that it has read."""

import h5py
import numpy as np

from invdyn_cli import hdf5
from invdyn_cli.errors import LogError


def test_a_file_may_be_rewritten_as_soon_as_it_was_read(tmp_path):
    """When a read returns, the reading process holds no lock on the file any more: it can be written at once, and the
    next read gets what was written. Two hundred turns, since a lock would be held for less than a millisecond."""
    path = tmp_path / "log.h5"
    for turn in range(200):
        with h5py.File(path, "w") as file:
            file["x"] = np.full(3, turn)
        if turn % 2:
            assert list(hdf5.outline(path, LogError).members) == ["x"]
        else:
            np.testing.assert_array_equal(hdf5.read(path, ["x"], LogError)["x"], np.full(3, turn))
