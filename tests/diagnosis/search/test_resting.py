"""When something came while the arm rested: as sharply as friction betrays it, and no sharper."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.resting import edges
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import arm, evidence_of, log_of, raw

MOVE, REST, RATE = 2.0, 2.0, 500.0
BODY = {"mass": 1.5, "com": np.array([0.05, 0.0, 0.15]), "inertia": np.zeros(6)}


def stepping(draw: np.random.Generator, moves: int = 6) -> tuple[np.ndarray, Motion]:
    """t (T,) and an arm that goes from posture to posture, resting in each."""
    t = np.arange(round(moves * (MOVE + REST) * RATE)) / RATE
    at = np.concatenate([[k * (MOVE + REST), k * (MOVE + REST) + MOVE] for k in range(moves)])
    stays = draw.uniform(-1.2, 1.2, (moves + 1, 3))
    path = np.repeat(stays, 2, axis=0)[1:-1]
    part = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 1)
    s = np.where(part % 2 == 0, np.clip((t - at[part]) / MOVE, 0, 1), 1.0)[:, None]
    low, high = path[part - part % 2], path[np.minimum(part - part % 2 + 1, len(path) - 1)]
    blend = CubicSpline(np.linspace(0, 1, 101), [x**3 * (10 - 15 * x + 6 * x * x) for x in np.linspace(0, 1, 101)])
    q, rates = low + (high - low) * blend(s), [(high - low) * blend(s, k) / MOVE**k for k in (1, 2)]
    moving = (part % 2 == 0)[:, None]
    return t, Motion(q, rates[0] * moving, rates[1] * moving)


def taken(seed: int, level: float, stays: bool, gap: float = 0.0) -> tuple[float, dict, float]:
    """A load that comes in the middle of the third rest, friction being `level` times its torque on each joint: bears
    it where it `stays`, and gives way where not; `gap` [s] of the log around it is lost. When it came, what is said of
    it, and when it comes then."""
    draw = np.random.default_rng(seed)
    t, m = stepping(draw)
    came, over = 2 * (MOVE + REST) + MOVE + draw.uniform(0.5, 1.5), 4 * (MOVE + REST) + 1.0
    there = ((t >= came) & (t < over))[:, None]
    heavier = EFFECTS["payload"].changed(BODY, arm(), None)
    load = inverse_dynamics(heavier, m.q, m.qd, m.qdd) - inverse_dynamics(arm(), m.q, m.qd, m.qdd)
    resting = (t > 2 * (MOVE + REST) + MOVE) & (t < 3 * (MOVE + REST))
    friction = level * np.abs(load[resting][0])
    moves = np.abs(m.qd) > 1e-3
    held = draw.uniform(-0.5, 0.5, 3) * friction
    borne = np.where(moves, friction * np.sign(m.qd), held)
    torque = load * there + borne
    if stays:  # the friction bears the load as long as the arm rests: nothing changes in the motors
        torque[resting] = np.where(moves, torque, held)[resting]
    whole, kept = raw(t, m, lambda *_: torque, torque=0.02, seed=seed), np.abs(t - came) >= gap / 2
    log = log_of(replace(whole, t=t[kept], q=whole.q[kept], tau=whole.tau[kept]))
    evidence = evidence_of(log, ["coulomb_friction"], cutoffs=(20.0,))
    when = TimeWindow(evidence.recording.pieces[0].trajectory, 2 * (MOVE + REST) + MOVE + 0.1, over, 0)
    acting = (
        *(EffectInstance(EFFECTS["coulomb_friction"], j, {"coulomb": float(x)}) for j, x in enumerate(friction)),
        EffectInstance(EFFECTS["payload_change"], None, BODY, when),
    )
    none = np.zeros((2, 0))
    refined = Refined(acting, none[0], (), (), none, Model(evidence).residual(acting))
    after, known = edges(evidence, Model(evidence), refined)
    assert after.acting[:3] == refined.acting[:3] and after.acting[3].when is not None
    return came, known[3], after.acting[3].when.start


@pytest.mark.parametrize("seed", range(4))
def test_a_load_that_friction_cannot_bear_is_timed(seed):
    """Friction of a fifth of the load: the time it came is in an interval of less than 0.1 s, most of which is what a
    controller may take to answer."""
    came, known, start = taken(seed, 0.2, stays=False)
    value, low, high = known["start"]
    assert low <= came <= high and high - low < 0.1
    assert start == value and abs(value - came) < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_a_load_that_friction_bears_came_at_any_time_of_the_rest(seed):
    """Friction of three times the load, and motors that feel nothing: all of the rest is possible, and is said."""
    came, known, _ = taken(seed, 3.0, stays=True)
    _, low, high = known["start"]
    assert low <= came <= high and high - low > 0.9 * REST


@pytest.mark.parametrize("seed", range(2))
def test_what_came_while_nothing_was_recorded(seed):
    """Half a second of the log is lost around the time: the interval holds it, and the edge does not leave the rest."""
    came, known, start = taken(seed, 0.2, stays=False, gap=0.5)
    _, low, high = known["start"]
    assert low <= came <= high and 0.4 < high - low < REST
    assert low <= start <= high


def test_an_edge_in_motion_is_left_alone():
    """The end of the window is in the middle of a move, and is not known from a rest."""
    _, known, _ = taken(0, 0.2, stays=False)
    assert "end" not in known


@pytest.mark.parametrize("seed", range(4))
def test_a_drive_that_gets_weak_at_rest_is_timed(seed):
    """A drive that must hold its link against gravity logs more torque from the moment at which it gives less."""
    draw = np.random.default_rng(seed)
    t, m = stepping(draw)
    came, gain = 2 * (MOVE + REST) + MOVE + draw.uniform(0.5, 1.5), draw.uniform(0.6, 0.85)
    log = raw(t, m, torque=0.02, seed=seed)
    log.tau[t >= came, 1] /= gain
    evidence = evidence_of(log_of(log), ["torque_gain_change"], cutoffs=(20.0,))
    when = TimeWindow(evidence.recording.pieces[0].trajectory, 2 * (MOVE + REST) + MOVE + 0.1, float(t[-1]), 0)
    acting = (EffectInstance(EFFECTS["torque_gain_change"], 1, {"gain": gain}, when),)
    none = np.zeros((2, 0))
    _, known = edges(
        evidence, Model(evidence), Refined(acting, none[0], (), (), none, Model(evidence).residual(acting))
    )
    value, low, high = known[0]["start"]
    assert low <= came <= high and high - low < 0.1 and low <= value <= high
