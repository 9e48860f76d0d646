"""Files from strangers: they run no code, and what they claim is checked before it is believed."""

import io
import pickle
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from invdyn_cli.errors import LogError
from invdyn_cli.formats import mat, npz, parquet, reading
from tests.formats.recordings import WRITERS, recording


class Marker:
    """Unpickled, it leaves a file behind."""

    def __reduce__(self):
        return Path.touch, (Path("ran"),)


def test_pickles_are_not_read(tmp_path, monkeypatch):
    """An archive with Python objects is refused, and they are not made."""
    monkeypatch.chdir(tmp_path)
    np.savez("objects.npz", q=np.array([Marker(), Marker()], object))
    with pytest.raises(LogError, match="q holds Python objects"):
        npz.read(Path("objects.npz"), 1e9)
    with zipfile.ZipFile("plain.npz", "w") as archive:
        archive.writestr("q.npy", pickle.dumps(Marker()))
    with pytest.raises(LogError, match="no archive of arrays"):
        npz.read(Path("plain.npz"), 1e9)
    assert not Path("ran").exists()


def test_claims_of_an_archive(tmp_path):
    """A header that claims a terabyte is refused before anything is reserved for it."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**11,)})
    with zipfile.ZipFile(tmp_path / "claims.npz", "w") as archive:
        archive.writestr("q.npy", header.getvalue() + b"1234")
    with pytest.raises(LogError, match="claims the shape"):
        npz.read(tmp_path / "claims.npz", 1e9)


def test_a_small_file_that_inflates(tmp_path):
    """A MATLAB file of some kilobytes that inflates beyond the limit is refused, and so is such an archive."""
    squeezed = zlib.compress(b"\0" * 50_000_000, 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    tag = np.array([15, len(squeezed)], "<u4").tobytes()
    (tmp_path / "bomb.mat").write_bytes(head + tag + squeezed)
    with pytest.raises(LogError, match=r"allowed: 0\.01 GB"):
        mat.read(tmp_path / "bomb.mat", 1e7)
    np.savez_compressed(tmp_path / "bomb.npz", q=np.zeros(6_000_000))
    with pytest.raises(LogError, match=r"allowed: 0\.01 GB"):
        npz.read(tmp_path / "bomb.npz", 1e7)


def test_parquet_of_many_equal_values(tmp_path):
    """A hundred million equal values take some kilobytes on disk: they are counted before they are read."""
    import pyarrow
    from pyarrow import parquet as writer

    writer.write_table(pyarrow.table({"q": np.zeros(2_000_000)}), tmp_path / "equal.parquet")
    assert (tmp_path / "equal.parquet").stat().st_size < 1e6
    with pytest.raises(LogError, match=r"allowed: 0\.01 GB"):
        parquet.read(tmp_path / "equal.parquet", 1e7)


@pytest.mark.parametrize("kind", ["csv", "npz", "mat", "mat73", "parquet", "bag1", "mcap"])
def test_damaged_files(kind, tmp_path):
    """Files that are cut off or have bytes changed are read or refused in a line, and nothing else."""
    path = WRITERS[kind](tmp_path, {name: x[:60] for name, x in recording().items()})
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for trial in range(30):
        broken = bytearray(whole[: int(rng.integers(len(whole)))] if trial % 2 else whole)
        for place in rng.integers(0, max(len(broken), 1), 5 if broken else 0):
            broken[place] = int(rng.integers(256))
        path.write_bytes(broken)
        try:
            reading.read_tables(path, 1e8)
        except LogError as error:
            assert len(str(error).splitlines()) == 1


@pytest.mark.parametrize(("kind", "library"), [("parquet", "pyarrow"), ("bag1", "rosbags")])
def test_a_missing_library(kind, library, tmp_path, monkeypatch):
    """Where a format's library is not installed, a line names it and how it is installed."""
    path = WRITERS[kind](tmp_path, {name: x[:60] for name, x in recording().items()})
    monkeypatch.setitem(__import__("sys").modules, library, None)
    with pytest.raises(LogError, match=rf"needs the library {library}.*pip install \"invdyn\[formats\]\""):
        reading.read_tables(path, 1e8)
