"""Loads that were believed in, read from a trace: each recording's own, with the number that nothing spoke against."""

import numpy as np
import pytest

from invdyn_cli.maths import loads
from invdyn_cli.types import Dataset, Motion, Trajectory

T = 100


def recording(name: str, stage: list[str] | None = None) -> Trajectory:
    t = 5 + np.arange(T) / 10
    still = np.zeros((T, 1))
    return Trajectory(name, t, Motion(still, still, still), still, stage=None if stage is None else np.array(stage))


def trace(believed: np.ndarray) -> dict[str, np.ndarray]:
    """A mass that grows with the row, and evidence against it in the last ten rows of each stretch."""
    rows = np.arange(len(believed), dtype=float)
    left = believed & ~np.roll(believed, -10)
    mass = np.where(believed, rows, np.nan)
    com = np.repeat(mass[:, None], 3, axis=1)
    return {
        "loaded": 1.0 * believed,
        "evidence": 0.5 * left,
        "mass": mass,
        "mass_std": 0.1 * mass,
        "since": mass,
        "com": com,
        "com_std": com,
    }


def test_a_load_has_its_times_stages_and_the_last_mass_that_stood():
    """Believed in from row 30 to row 70 of the second recording, in whose stages b and c that is; its mass is that of
    row 59, the last one without evidence against it."""
    data = Dataset((recording("x"), recording("y", ["a"] * 20 + ["b"] * 40 + ["c"] * 40)), ("j",))
    believed = np.zeros(2 * T, bool)
    believed[T + 30 : T + 70] = True
    (found,) = loads.believed(data, trace(believed))
    assert (found.trajectory, found.came_in, found.went_in) == ("y", "b", "c")
    assert (found.came, found.came_after, found.went, found.went_after) == pytest.approx((8, 1, 12, 1))
    assert (found.mass, found.mass_std, *found.com) == pytest.approx((T + 59, 0.1 * (T + 59), *(T + 59,) * 3))


def test_what_is_left_on_the_way_out_is_not_the_load():
    """A light load that takes the place of another one shortly before the end of a stretch is not what was carried."""
    data = Dataset((recording("x"),), ("j",))
    made = trace((np.arange(T) >= 50) & (np.arange(T) < 99))
    made["evidence"][:] = 0
    made["mass"][90:], made["since"][90:] = 0.01, np.arange(10)
    assert loads.believed(data, made)[0].mass == 89


def test_what_lasts_into_the_next_recording_is_two_loads():
    """A load that is never put down is there until the first recording's end, as it is known then, and from the second
    one's beginning."""
    data = Dataset((recording("x"), recording("y")), ("j",))
    found = loads.believed(data, trace(np.arange(2 * T) >= 50))
    assert [(x.trajectory, x.came, x.went, x.came_in, x.went_after) for x in found] == [
        ("x", 10.0, None, "", None),
        ("y", 5.0, None, "", None),
    ]
    assert [x.mass for x in found] == [T - 1, 2 * T - 1]


def test_what_weighs_nothing_has_none():
    """The trace of an adaptation without loads, and one in which none was believed in."""
    data = Dataset((recording("x"),), ("j",))
    assert loads.believed(data, {}) == [] == loads.believed(data, trace(np.zeros(T, bool)))
