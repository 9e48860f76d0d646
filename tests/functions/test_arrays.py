"""Arrays as a log: what is given is kept, and what does not match is refused in one sentence."""

import numpy as np
import pytest

from invdyn_cli import from_arrays
from invdyn_cli.errors import InvdynError

ROWS, JOINTS = 1000, 7
T = np.arange(ROWS) / 250
Q = np.sin(T[:, None] * np.linspace(1, 2, JOINTS))
TAU = 3 * Q


def test_keeps_what_is_given():
    """The log has the arrays' values, the joints' names, and the clock's rate."""
    names = [f"axis{i}" for i in range(JOINTS)]
    log = from_arrays(q=Q, tau=TAU.tolist(), t=T, qd=Q, joints=names, torque_side="link")
    [one] = log.trajectories
    assert all(np.array_equal(a, b) for a, b in ((one.q, Q), (one.tau, TAU), (one.t, T), (one.qd, Q)))
    assert (log.joints, log.torque_side, one.qdd) == (tuple(names), "link", None)
    assert log.rate == pytest.approx(250) and "7000" not in repr(log) and "1000 rows at 250 Hz" in repr(log)


def test_a_rate_is_a_clock():
    """Without times, samples are as far apart as the rate says."""
    log = from_arrays(q=Q, tau=TAU, rate=500.0)
    np.testing.assert_allclose(log.trajectories[0].t, np.arange(ROWS) / 500)


def test_defects_are_left_to_the_checks():
    """NaN and repeated times are kept: `check` describes them."""
    t = np.repeat(T[::2], 2)
    q = np.where(Q > 0.9, np.nan, Q)
    one = from_arrays(q=q, tau=TAU, t=t).trajectories[0]
    assert np.isnan(one.q).any() and np.array_equal(one.t, t)


BAD = {
    "transposed": ({"q": Q.T, "tau": TAU.T}, r"q has shape \(7, 1000\), with 1000 samples.*Try: q\.T and tau\.T$"),
    "transposed torque": ({"tau": TAU.T}, r"tau has shape \(7, 1000\).*Try: tau\.T$"),
    "transposed at a rate": ({"q": Q.T, "tau": TAU.T, "t": None, "rate": 250.0}, r"time first\. Try: q\.T and tau\.T$"),
    "other length": ({"tau": TAU[:-1]}, r"tau has shape \(999, 7\), q has \(1000, 7\); allowed: the same shape"),
    "clock of other length": ({"t": T[:-1]}, r"q has shape \(1000, 7\), t has 999 samples"),
    "one joint as a vector": ({"q": Q[:, 0], "tau": TAU[:, 0]}, r"q has shape \(1000,\).*Try: q\[:, None\]"),
    "no clock": ({"t": None}, r"t is missing.*Try: t=t.*or rate="),
    "two clocks": ({"rate": 250.0}, "both given"),
    "descending": ({"t": T[::-1]}, r"t descends in row 1, from 3\.996 s to 3\.992 s, and in 999 rows.*argsort"),
    "clock as a column": ({"t": T[:, None]}, r"t has shape \(1000, 1\).*Try: t\.ravel\(\)$"),
    "no torque": ({"tau": None}, "tau is missing"),
    "words": ({"q": [["a"] * JOINTS] * ROWS}, "q cannot be read as an array of numbers"),
    "names": ({"joints": ["a", "b"]}, r"joints names 2 joints \(a, b\), q has 7 columns"),
    "side": ({"torque_side": "gear"}, "torque_side='gear'; allowed: link, motor, command, unknown"),
    "few": ({"q": Q[:2], "tau": TAU[:2], "t": T[:2]}, "q has 2 rows; allowed: at least 3"),
    "gains": ({"drive_gain": [1.0]}, r"drive_gain has shape \(1,\); allowed: \(7,\)"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_refuses(name):
    """One sentence says what was got, what is allowed and, where there is one way out, what to try."""
    given, sentence = BAD[name]
    with pytest.raises(InvdynError, match=sentence) as caught:
        from_arrays(**{"q": Q, "tau": TAU, "t": T} | given)
    assert "\n" not in str(caught.value)


def test_a_square_array_is_no_transposed_one():
    """As many samples as joints are no reason to doubt the order of the axes."""
    assert from_arrays(q=Q[:7], tau=TAU[:7], t=T[:7]).trajectories[0].q.shape == (7, 7)
