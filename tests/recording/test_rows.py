"""Whether rows follow each other as in a motion."""

import numpy as np
import pytest

from invdyn_cli.log import RawTrajectory
from invdyn_cli.recording.rows import is_series


def logged(q: np.ndarray, rate: float = 400.0) -> RawTrajectory:
    """A trajectory of one joint."""
    return RawTrajectory("one", t=np.arange(len(q)) / rate, q=q[:, None], tau=np.zeros((len(q), 1)))


def slow(step: float) -> np.ndarray:
    """0.17 rad back and forth at 0.05 rad/s at most, 400 times a second, in steps of an encoder."""
    t = np.arange(20_000) / 400
    return step * np.round(0.17 * np.sin(0.3 * t) / step)


@pytest.mark.parametrize("bits", [10, 12, 14, 20])
def test_steps_of_an_encoder_are_a_motion(bits):
    """A joint that needs several rows from one step to the next moves all the same; with its rows shuffled it does not.
    Row by row the second differences of 14 bits are as rough as those of poses."""
    q = slow(2 * np.pi / 2**bits)
    assert is_series(logged(q)) and is_series(logged(q), roughness=0.5)
    assert not is_series(logged(np.random.default_rng(0).permutation(q)))


def test_poses_on_a_grid_are_no_motion():
    """Poses at random that are multiples of 0.1 rad, as a teach pendant has them; and the same at 0.01 rad."""
    draw = np.random.default_rng(1)
    for step in (0.1, 0.01):
        assert not is_series(logged(step * draw.integers(0, round(2 / step), 500)))
