"""Gears that yield: how far the link is from the motor, against equations of motion that SciPy integrates.

Loads and inertias are drawn at random, as splines: the load is that of a link which keeps to the motor's motion, so
that inertia times the link's acceleration against the motor is what passes through the gear, less the load.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractGearEffect
from tests.effects.drawn import named, parameters

RATE, SECONDS = 500.0, 3.0
T = np.arange(round(RATE * SECONDS)) / RATE


def drawn(seed: int) -> tuple[CubicSpline, CubicSpline]:
    """A load [N m] that goes through zero, 1.5 Hz and slower, and an inertia [kg m^2]."""
    draw = np.random.default_rng([1, seed])
    knots = np.linspace(0, SECONDS, 10)
    size = float(np.exp(draw.uniform(np.log(0.02), np.log(2))))
    load = 20 * size * draw.normal(size=len(knots))
    load[[0, 3, 6]], load[[1, 4]] = np.abs(load[[0, 3, 6]]), -np.abs(load[[1, 4]])
    return CubicSpline(knots, load), CubicSpline(knots, size * draw.uniform(0.7, 1.3, len(knots)))


def through_play(load: CubicSpline, inertia: CubicSpline, gap: float) -> np.ndarray:
    """(T,) deflection of a link that leaves a flank when the load pulls it off, falls, and stays on the flank on which
    it lands as long as the load presses it there; it starts where the load presses it."""
    half, out, now = gap / 2, np.full(len(T), np.nan), 0.0
    side = -np.sign(load(0.0))

    def fall(t, y):
        return [y[1], -load(t) / inertia(t)]

    while now < SECONDS:
        pressed = load(now + 1e-6) * side < 0
        leaves = min([x for x in load.roots(extrapolate=False) if x > now + 1e-6], default=SECONDS) if pressed else now
        out[(now <= T) & (leaves >= T)] = side * half
        if leaves >= SECONDS:
            break

        def lands(t, y, begun=leaves):
            return abs(y[0]) - half if t > begun + 1e-6 else -half

        lands.terminal, lands.direction = True, 1.0  # type: ignore[attr-defined]
        start = [side * half * (1 - 1e-6), 0.0]
        how = {"events": lands, "dense_output": True, "rtol": 1e-9, "atol": 1e-13, "max_step": 0.02}
        flown = solve_ivp(fall, (leaves, SECONDS), start, **how)
        now, side = flown.t[-1], np.sign(flown.y[0, -1])
        here = (leaves < T) & (now >= T)
        out[here] = flown.sol(T[here])[0]
    return out


@pytest.mark.parametrize("seed", range(4))
def test_play(seed):
    """The link is where SciPy has it, to 2 % of the gap: it leaves its flank and lands at a sample, up to 2 ms late,
    and rests for three samples before it leaves again; it never leaves the gap, and touches both flanks."""
    load, inertia = drawn(seed)
    given = parameters("backlash", np.random.default_rng(seed))
    b, _ = EFFECTS["backlash"].deflection(given, load(T), inertia(T), RATE)
    off = np.abs(b - through_play(load, inertia, given["gap"])) / given["gap"]
    assert b.max() == given["gap"] / 2 and b.min() == -given["gap"] / 2
    assert off.max() < 0.02


def test_a_blow_has_its_momentum():
    """Second derivatives of the deflection leave a link at rest on its flank: on its way from flank to flank it has
    been given as much momentum as was taken from it again."""
    load, inertia = drawn(0)
    b, b2 = EFFECTS["backlash"].deflection({"gap": 0.004}, load(T), inertia(T), RATE)
    speed = np.cumsum(b2) / RATE
    lies = np.convolve(np.abs(b) == 0.002, np.ones(9), mode="valid") == 9
    assert 0.2 < np.mean(lies) < 0.98
    np.testing.assert_allclose(speed[4:-4][lies], 0, atol=1e-9)
    assert np.ptp(speed) > 0.01


@pytest.mark.parametrize("ratio", [0.2, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_a_spring(seed, ratio):
    """inertia b'' + damping b' + stiffness b = -load as SciPy integrates it from the same start, with this damping
    ratio, to 0.1 % of the largest bending and to 2 % of its second derivative: between samples the load runs
    straight and the inertia stays."""
    load, inertia = drawn(seed)
    effect, hz = EFFECTS["joint_elasticity"], 8.0 + 6 * seed
    stiffness = float(inertia(T).mean() * (2 * np.pi * hz) ** 2)

    def move(t, y):
        damping = 2 * ratio * np.sqrt(stiffness * inertia(t))
        return [y[1], (-load(t) - damping * y[1] - stiffness * y[0]) / inertia(t)]

    b, b2 = effect.deflection({"stiffness": stiffness, "damping_ratio": ratio}, load(T), inertia(T), RATE)
    start = [b[0], (b[1] - b[0]) * RATE - b2[0] / RATE / 2]
    wanted = solve_ivp(move, (0, SECONDS), start, t_eval=T, rtol=1e-6, atol=1e-9).y
    np.testing.assert_allclose(b, wanted[0], atol=1e-3 * np.abs(wanted[0]).max())
    acceleration = np.array([move(t, y)[1] for t, y in zip(T, wanted.T, strict=True)])
    np.testing.assert_allclose(b2, acceleration, atol=2e-2 * np.abs(acceleration).max())


@pytest.mark.parametrize("seed", range(3))
def test_a_spring_starts_in_motion(seed):
    """Of a stretch that begins in a motion, after its first period of resonance, the deflection is that of
    the whole motion to 2 % of the largest, and its second derivative to 15 %: the load is no parabola for as long."""
    load, inertia = drawn(seed)
    effect = EFFECTS["joint_elasticity"]
    stiffness = {"stiffness": float(inertia(T).mean() * (2 * np.pi * 6.0) ** 2)}
    whole = effect.deflection(stiffness, load(T), inertia(T), RATE)
    first = int(RATE * np.random.default_rng([2, seed]).uniform(1.0, 2.0))
    later = effect.deflection(stiffness, load(T[first:]), inertia(T[first:]), RATE)
    for own, one, limit in zip(later, whole, (0.02, 0.15), strict=True):
        off = np.abs(own - one[first:])[round(RATE / 6) :]
        assert off.max() < limit * np.abs(one[first:]).max()


def test_what_does_not_yield():
    """No play is no deflection; a spring hundred times as stiff bends a hundredth."""
    load, inertia = (x(T) for x in drawn(1))
    for one in EFFECTS["backlash"].deflection({"gap": 0.0}, load, inertia, RATE):
        assert not one.any()
    soft, stiff = (EFFECTS["joint_elasticity"].deflection({"stiffness": x}, load, inertia, RATE)[0] for x in (1e4, 1e6))
    assert np.std(stiff) == pytest.approx(np.std(soft) / 100, rel=0.2)


@pytest.mark.parametrize("name", named(AbstractGearEffect))
def test_softness_is_one_number(name):
    """Parameters come back from their compliance, and twice as soft yields more."""
    effect = EFFECTS[name]
    load, inertia = (x(T) for x in drawn(2))
    for seed in range(3):
        given = parameters(name, np.random.default_rng(seed))
        assert effect.as_soft(given, effect.compliance(given)) == pytest.approx(given)
        softer = effect.as_soft(given, 2 * effect.compliance(given))
        a, b = (np.ptp(effect.deflection(x, load, inertia, RATE)[0]) for x in (given, softer))
        assert b > 1.5 * a
    for shape in effect.shapes(load, inertia, RATE):
        assert set(effect.whole(shape)) == set(effect.parameters) and effect.refuse(shape) == ""
