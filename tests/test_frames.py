"""A log as a table of pandas."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli import from_arrays, read
from invdyn_cli.errors import LogError, UsageError
from tests.logs import make_log, motion, positions


def test_every_value_is_in_the_table(tmp_path):
    """Rows lie under trajectory and time, a column for each channel and joint; what a trajectory lacks is NaN."""
    pytest.importorskip("pandas")
    log = read(make_log(tmp_path / "log.h5", {"a": motion(seconds=2.0), "b": positions(seconds=1.0)}))
    table = log.to_pandas()
    assert table.index.names == ["trajectory", "t"] and len(table) == 300
    assert set(table.columns) == {f"{c}_{j}" for c in ("q", "tau", "qd", "qdd") for j in ("shoulder", "elbow")}
    for one in log.trajectories:
        part = table.loc[one.name]
        np.testing.assert_array_equal(part.index, one.t)
        np.testing.assert_array_equal(part[["tau_shoulder", "tau_elbow"]], one.tau)
    assert table.loc["b", "qd_elbow"].isna().all() and table.loc["a", "qd_elbow"].notna().all()


def test_a_broken_channel_is_named():
    """Channels of different lengths make no table, and the sentence says which one it is."""
    pytest.importorskip("pandas")
    log = from_arrays(q=np.zeros((9, 2)), tau=np.ones((9, 2)), rate=10.0)
    broken = replace(log.trajectories[0], tau=np.ones((8, 2)))
    with pytest.raises(LogError, match=r"tau has shape \(8, 2\); allowed in a table: \(9, 2\)"):
        replace(log, trajectories=(broken,)).to_pandas()


def test_without_pandas(monkeypatch):
    """Where pandas is missing, one line says how to install it."""
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match=r"to_pandas needs the library pandas.*invdyn\[pandas\]"):
        from_arrays(q=np.zeros((9, 2)), tau=np.ones((9, 2)), rate=10.0).to_pandas()
