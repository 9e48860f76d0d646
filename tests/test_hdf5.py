"""The process that reads HDF5 files, and the files that it has read."""

import io
import json

import h5py
import numpy as np
import pytest

from invdyn_cli import hdf5, hdf5_reader
from invdyn_cli.errors import LogError


@pytest.mark.parametrize("what", [{"do": "outline"}, {"do": "read", "names": ["x"], "limit": 10**9}])
def test_an_answer_ends_when_the_file_is_closed_again(tmp_path, monkeypatch, what):
    """Who has read the last line of an answer may write the file: it is closed by then, and no lock is held."""
    monkeypatch.setattr(hdf5_reader, "_limit_memory", lambda size: None)  # it would bind the test's own process
    path, opened = tmp_path / "log.h5", []
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(100.0)

    class Answers(io.BytesIO):
        def write(self, data) -> int:
            if bytes(data).startswith(b'{"done"'):
                with h5py.File(path, "r+") as file:  # refused by HDF5 where it is open for reading
                    opened.append(file["x"].shape)
            return super().write(data)

    hdf5_reader.serve(io.BytesIO(json.dumps({**what, "path": str(path)}).encode() + b"\n"), Answers())
    assert opened == [(100,)]


def test_a_file_may_be_rewritten_as_soon_as_it_was_read(tmp_path):
    """Read and write in turn: no write is refused, and each read gets what was written last."""
    path, many = tmp_path / "log.h5", np.arange(200_000.0)
    for turn in range(10):
        with h5py.File(path, "w") as file:
            file["x"] = many + turn
        np.testing.assert_array_equal(hdf5.read(path, ["x"], LogError)["x"], many + turn)
