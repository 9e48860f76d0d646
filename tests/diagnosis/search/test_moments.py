"""What is of a few moments of a log is told as such, noise and what comes back never."""

import numpy as np
import pytest

from invdyn_cli.diagnosis.search.moments import FEWEST, moments, on_one_side
from tests.diagnosis.analytic import evidence_of, log_of, moved, raw


def noise(evidence, seed: int) -> np.ndarray:
    """(R, n) white, 1 % of each joint's torque, a third as large where it moves slowly."""
    draw = np.random.default_rng([seed, 5])
    fast = np.abs(evidence.on_rows("qd")) > np.median(np.abs(evidence.on_rows("qd")), axis=0)
    size = 0.01 * np.sqrt(np.mean(evidence.tau**2, axis=0))
    return size * np.where(fast, 1.0, 1 / 3) * draw.normal(size=evidence.tau.shape)


@pytest.mark.parametrize("seed", range(5))
def test_a_moment_is_told(evidence, seed):
    """A pulse of 0.3 to 1 s, twenty times the noise, on one joint: its time to half a second, and its torque; of the
    other joints nothing."""
    draw = np.random.default_rng([seed, 6])
    t, joint, start = evidence.on_rows("t"), int(draw.integers(evidence.dofs)), float(draw.uniform(2.0, 37.0))
    residual, inside = noise(evidence, seed), (t >= start) & (t < start + draw.uniform(0.3, 1.0))
    pulse = 0.2 * np.sqrt(np.mean(evidence.tau[:, joint] ** 2))
    residual[inside, joint] += pulse
    (found,) = moments(evidence, residual).items()
    assert found[0] == joint
    assert found[1].start <= t[inside][0] and t[inside][0] - found[1].start < 0.5
    assert found[1].end >= t[inside][-1] and found[1].end - t[inside][-1] < 0.5
    assert found[1].torque == pytest.approx(pulse * np.sqrt(np.mean(inside)), rel=0.1)


@pytest.mark.parametrize(("start", "end", "alone"), [(10.0, 10.6, True), (26.5, 29.0, False), (34.0, 34.6, True)])
def test_a_moment_on_one_side_of_the_split(evidence, start, end, alone):
    """At 10 s it is among what chooses, at 34 s it is held out; about 28 s, where the log is parted, it is in both."""
    t, residual = evidence.on_rows("t"), noise(evidence, 0)
    residual[(t >= start) & (t < end), 1] += 0.2 * np.sqrt(np.mean(evidence.tau[:, 1] ** 2))
    assert len(on_one_side(evidence, residual)) == alone


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_moment(evidence, seed):
    """Neither noise that grows with the speed, nor a torque that comes back at every reversal."""
    residual = noise(evidence, seed)
    assert not moments(evidence, residual)
    slow = np.abs(evidence.on_rows("qd")) < 0.05 * np.abs(evidence.on_rows("qd")).max(axis=0)
    assert not moments(evidence, residual + 0.05 * np.sqrt(np.mean(evidence.tau**2, axis=0)) * slow)


def test_a_short_log_has_none(evidence):
    """Of fewer stretches than FEWEST nothing is said."""
    t = evidence.on_rows("t")
    short = evidence_of(log_of(raw(*moved(0.5 * FEWEST - 0.6))), ["viscous_friction"], cutoffs=(10.0,))
    residual = np.zeros_like(short.tau)
    residual[:10] = 1.0
    assert len(t) > len(residual) and not moments(short, residual)
