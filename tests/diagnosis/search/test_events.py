"""Windows of what comes and goes: found to a row where there is something, nowhere else, and parted so that some rows
of each choose and others judge."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search import events
from invdyn_cli.diagnosis.search.judge import HypothesisScorer
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import TimeWindow
from invdyn_cli.recording.pieces import ROLES
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import Term, arm, beyond, evidence_of, log_of, moved, nothing, raw

NOISE = 0.02
PASSING = {name: effect for name, effect in EFFECTS.items() if effect.passing}
WINDOW = 3.1, 5.3


def payload(t, m) -> np.ndarray:
    """A body of 0.8 kg, 0.1 m beyond the last frame, by Pinocchio."""
    inertial = np.array(arm().inertial)
    inertial[-1, 0] += 0.8
    inertial[-1, 3] += 0.08
    inertial[-1, 4] += 0.008
    inertial[-1, 6] += 0.008
    return beyond(arm(), replace(arm(), inertial=inertial), m)


def gain(t, m) -> np.ndarray:
    """A drive of the second joint that gives 0.8 of what is logged."""
    return (1 / 0.8 - 1) * inverse_dynamics(arm(), m.q, m.qd, m.qdd) * (np.arange(3) == 1)


def contact(t, m) -> np.ndarray:
    """A body of 0.5 kg that hangs at the origin of the last frame, at rest: a force."""
    inertial = np.array(arm().inertial)
    inertial[-1, 0] += 0.5
    return beyond(arm(), replace(arm(), inertial=inertial), Motion(m.q, 0 * m.qd, 0 * m.qdd))


HIDDEN = {"payload_change": payload, "torque_gain_change": gain, "external_contact": contact}


def within(term: Term, window: tuple[float, float] = WINDOW) -> Term:
    """The term in a window alone."""
    return lambda t, m: term(t, m) * ((t > window[0]) & (t < window[1]))[:, None]


def seen(term: Term = nothing, seed: int = 0, seconds: float = 10.0, names: Sequence[str] = ()) -> Evidence:
    """A log of the arm in white noise, at its own 100 Hz, with columns of these effects."""
    return evidence_of(log_of(raw(*moved(seconds, 100.0, seed), term, torque=NOISE, seed=seed)), names)


def looked_for(evidence: Evidence, lasting: Sequence[str] = (), passing=PASSING) -> events.Windows:
    """The windows that are proposed for all that the nominal model leaves, with these effects on every joint."""
    beside = tuple(c for c in evidence.candidates if c.effect.name in lasting)
    scorer = HypothesisScorer(evidence, np.ones(len(evidence.role), bool), np.ones(3) / NOISE**2, np.full(3, NOISE))
    scorer.refresh()
    left = evidence.residual(beside, scorer.quick(beside)[1])
    measured = Noise(np.full(3, NOISE), np.ones(3), left)
    return events.proposed(evidence, events.places(evidence, passing, "unknown"), [left], measured, lasting=beside)


@pytest.mark.parametrize("name", HIDDEN)
def test_a_window_is_found_to_a_row(name):
    """The first window that is proposed begins and ends where the event does, to a row; the effect that was hidden is
    among the candidates, and no other window explains more."""
    evidence = seen(within(HIDDEN[name]))
    t = np.unique(evidence.on_rows("t"))
    row = 1.01 * np.diff(t).max()
    found = looked_for(evidence)
    when = next(iter(found))
    assert when.trajectory == "run" and when.number == 0
    assert (when.start, when.end) == pytest.approx(WINDOW, abs=row)
    assert name in {c.effect.name for c in found[when]} and all(c.when == when for c in found[when])
    assert [window.number for window in found] == list(range(len(found)))


def test_a_load_is_found_in_all_windows():
    """A load that is carried four times is one effect in four windows, to a row each: the first that is proposed."""
    spans = [(1.2, 2.9), (4.0, 6.1), (7.5, 9.6), (11.0, 13.2)]
    evidence = seen(lambda t, m: sum(within(payload, span)(t, m) for span in spans), seconds=15.0)
    first = next(iter(looked_for(evidence)))
    assert np.allclose([(one.start, one.end) for one in first.each], spans, atol=1.5 / evidence.recording.filter.rate)
    assert {one.number for one in first.each} == {0}


@pytest.mark.parametrize("name", HIDDEN)
def test_a_window_is_found_to_a_row_beside_what_lasts(name):
    """So it is in nearly half of the log, where every joint has friction, springs and links of unknown size: fitted
    without the event, these are a compromise in which another window explains more."""
    lasting, window = (
        ("viscous_friction", "joint_spring", "torque_offset", "link_inertia_error", "rotor_inertia"),
        (4.1, 8.7),
    )

    def worn(t, m):
        return within(HIDDEN[name], window)(t, m) + m.qd * [2.0, 3.0, 0.5] + m.q * [1.0, -2.0, 0.5]

    evidence = seen(worn, names=lasting)
    when = next(iter(looked_for(evidence, lasting)))
    row = 1.01 * np.diff(np.unique(evidence.on_rows("t"))).max()
    assert (when.start, when.end) == pytest.approx(window, abs=row)


@pytest.mark.parametrize("seed", range(6))
def test_nothing_comes_and_goes_in_white_noise(seed):
    """No window is proposed where there is nothing but noise."""
    assert not looked_for(seen(seed=seed))


@pytest.mark.parametrize("sign", [1, -1])
def test_no_body_of_negative_mass_comes_and_goes(sign):
    """Ten coefficients of a body explain in part whatever comes and goes: a window in which its mass would be negative
    is not proposed, or it would take the place of the window of another effect."""
    evidence = seen(within(lambda t, m: sign * payload(t, m)))
    found = looked_for(evidence, passing={"payload_change": EFFECTS["payload_change"]})
    assert bool(found) == (sign > 0)


def test_a_blow_is_no_window():
    """What is over after a tenth of a second gets no window: it fills none that is long enough to know an event by."""

    def blow(t, m):
        return 3.0 * np.outer((t > 4.0) & (t < 4.1), [0, 1, 0])

    assert not looked_for(seen(blow))


def test_a_rest_is_no_part_of_a_window():
    """A drive is weak for six seconds, in the first and the last of which alone its joint moves."""
    evidence = seen(within(gain, (2.0, 8.0)))
    t = evidence.on_rows("t")
    evidence.valid[:, 1] = (t < 3.0) | (t > 7.0)
    found = looked_for(evidence, passing={"torque_gain_change": EFFECTS["torque_gain_change"]})
    assert any((when.start, when.end) == pytest.approx((2.0, 8.0), abs=0.05) for when in found)


def test_a_contact_stands_where_it_differs():
    """Every joint at which a force would be felt differently from those behind it is a place, and a payload and a gain
    of each joint; a torque that was taken behind the gear knows no gain of the drive, if the effect says so."""
    evidence = seen()
    told = [(p.effect.name, p.joint) for p in events.places(evidence, PASSING, "unknown")]
    assert ("payload_change", None) in told
    assert [j for name, j in told if name == "torque_gain_change"] == [2, 1, 0]
    forces = [p.columns for p in events.places(evidence, PASSING, "unknown") if p.effect.name == "external_contact"]
    assert 1 <= len(forces) <= 2  # the first frame does not move
    deaf = {name: effect for name, effect in PASSING.items() if "link" not in effect.sides}
    assert not events.places(evidence, deaf, "link")


WINDOWS = {
    "one": [(3.1, 5.3)],
    "as short as may be": [(3.1, 3.31)],
    "to the end": [(12.0, 20.0)],
    "many": [(x, x + 0.3) for x in (0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5)],
    "overlapping": [(2.0, 5.0), (4.0, 7.0)],
}


@pytest.mark.parametrize("name", WINDOWS)
def test_some_rows_of_a_window_judge(name):
    """In every window, and outside of all, some rows choose and others judge; no block of rows does both, or lies on
    both sides of an edge, and the last row before an edge and the first behind it choose, but where windows leave no
    room for three blocks."""
    windows = [TimeWindow("run", *edges, number) for number, edges in enumerate(WINDOWS[name])]
    evidence = events.interleaved(seen(seconds=20.0), windows)
    t, train, test = evidence.on_rows("t"), ROLES.index("train"), ROLES.index("test")
    inside = np.zeros(len(t), bool)
    for w in windows:
        at = (t >= w.start) & (t < w.end)
        inside |= at
        assert set(evidence.role[at]) == {train, test}
        for edge in (w.start, w.end):
            beside = np.searchsorted(t, edge) + np.array([-1, 0])
            roomy = len(windows) == 1 and beside[1] < len(t)
            assert not roomy or set(evidence.role[beside]) == {train}
    assert set(evidence.role[~inside]) == {train, test}
    for block in np.unique(evidence.block):
        rows = evidence.block == block
        assert len(set(evidence.role[rows])) == 1
        for w in windows:
            assert len(set(((t >= w.start) & (t < w.end))[rows])) == 1


def test_other_trajectories_keep_to_their_blocks():
    """A window of another trajectory parts nothing here: blocks of two seconds take turns."""
    evidence = events.interleaved(seen(), [TimeWindow("another", 1.0, 2.0)])
    assert {np.ptp(evidence.on_rows("t")[evidence.block == b]) > 1.9 for b in np.unique(evidence.block)} == {True}
