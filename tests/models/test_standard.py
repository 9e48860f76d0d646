"""The standard model on arms whose links are off by some percent, with Pinocchio as the true arm."""

from dataclasses import replace

import jax
import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.maths.metrics import rmse
from invdyn_cli.models.pest import Pest
from invdyn_cli.models.standard import Standard
from invdyn_cli.robots import pinocchio_model
from invdyn_cli.testing import check_model
from invdyn_cli.types import Dataset, Motion, Trajectory
from tests.commands import usually

KEY = jax.random.key(0)
COULOMB, VISCOUS = np.array([2.0, 3.0, 1.0, 0.5]), np.array([1.0, 2.0, 0.5, 0.3])
OFFSET, ROTOR = np.array([0.5, 0.0, -0.2, 0.0]), np.array([0.3, 0.2, 0.1, 0.05])


def sines(n: int, seconds: float, seed: int, rate: float = 100.0) -> tuple[np.ndarray, Motion]:
    """Three sines for each joint, drawn."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * rate)) / rate
    q, qd, qdd = np.zeros((3, len(t), n))
    for k in range(3):
        w, size = 2 * np.pi * rng.uniform(0.1, 0.6, n), rng.uniform(0.2, 0.7, n) / (1 + k)
        angle = w * t[:, None] + rng.uniform(0, 6, n)
        q, qd, qdd = q + size * np.sin(angle), qd + size * w * np.cos(angle), qdd - size * w**2 * np.sin(angle)
    return t, Motion(q, qd, qdd)


@pytest.fixture(scope="module")
def worn(apollo4):
    """The arm as it is: masses, first moments and inertias 8 % off, each link by itself."""
    factor = 1 + 0.08 * np.random.default_rng(7).normal(size=(apollo4.dofs, 1))
    return replace(apollo4, inertial=apollo4.inertial * factor)


def recorded(robot, real, seconds, *seeds) -> Dataset:
    """What the real arm does, as a dataset that knows the URDF's arm only."""
    model, parts = pinocchio_model(real), []
    data, draw = model.createData(), np.random.default_rng(seeds)
    for seed in seeds:
        t, m = sines(robot.dofs, seconds, seed)
        rigid = np.array([pin.rnea(model, data, *x) for x in zip(m.q, m.qd, m.qdd, strict=True)])
        beside = COULOMB * np.sign(m.qd) + VISCOUS * m.qd + OFFSET + ROTOR * m.qdd
        tau = rigid + beside + 0.05 * draw.normal(size=m.q.shape)
        parts.append(Trajectory(f"run_{seed}", t, m, tau))
    return Dataset(tuple(parts), robot.joints, robot)


def test_friction_of_a_worn_arm(apollo4, worn):
    """Coulomb and viscous friction of ten seconds beside wrong links, each within 5 % (or 0.05 of its unit)."""
    fit = Standard().fit(recorded(apollo4, worn, 10.0, 1), KEY)
    np.testing.assert_allclose(fit.params["coulomb"], COULOMB, rtol=0.05, atol=0.05)
    np.testing.assert_allclose(fit.params["viscous"], VISCOUS, rtol=0.05, atol=0.05)
    assert fit.details["chosen"] == "evidence" and 0.01 < fit.details["share"] < 1


def test_little_data_hold_on_another_motion(apollo4, worn):
    """Learned from five seconds, it predicts another motion better than a free fit (PEST), and than the URDF's links
    with friction alone."""
    train, test = recorded(apollo4, worn, 5.0, 2), recorded(apollo4, worn, 10.0, 3)

    def error(model):
        return rmse(test.tau, model.predict(model.fit(train, KEY), test.motion))

    ours = error(Standard())
    free = error(Pest(friction="coulomb_viscous", offset=True, rotor_inertia=True, weighting="torque_spread"))
    stiff = error(Standard(share=1e-6))
    assert np.mean(ours) < 0.8 * np.mean(free) and np.mean(ours) < 0.8 * np.mean(stiff)


@pytest.mark.parametrize("off", [False, True])
def test_a_log_without_noise(apollo4, worn, off):
    """Exact torques of the nominal arm, and of one with other links, are predicted to a millionth of the largest, with
    no error: beside no noise, what was believed does not drown in rounding."""
    real = worn if off else apollo4
    model, (t, m) = pinocchio_model(real), sines(4, 10.0, 3)
    tau = np.array([pin.rnea(model, model.createData(), *x) for x in zip(m.q, m.qd, m.qdd, strict=True)])
    fit = Standard().fit(Dataset((Trajectory("run", t, m, tau),), apollo4.joints, apollo4), KEY)
    assert rmse(tau, Standard().predict(fit, m)).max() < 1e-6 * np.abs(tau).max()


def test_repeats_do_not_choose(apollo4, worn):
    """A motion that was driven twice is one motion: the share then comes from the evidence, none is left out."""
    once, again = recorded(apollo4, worn, 8.0, 4), recorded(apollo4, worn, 8.0, 4, 4)
    other = recorded(apollo4, worn, 8.0, 4, 5)
    chosen = [Standard().fit(data, KEY).details["chosen"] for data in (once, again, other)]
    assert chosen == ["evidence", "evidence", "left out"]


@pytest.mark.parametrize("model", usually([Standard()], [Standard(), Standard(share=0.1, rotor_inertia=False)]))
def test_contract(model, apollo4):
    """The contract of a model holds."""
    check_model(model, recorded(apollo4, apollo4, 3.0, 6))


def test_misuse_is_refused(apollo4):
    """Senseless options and data without a URDF are refused in a sentence."""
    for options, words in (({"share": 0.0}, "model.share=0.0"), ({"rest_speed": -1.0}, "model.rest_speed=-1.0")):
        with pytest.raises(UsageError, match=words):
            Standard(**options)
    data = replace(recorded(apollo4, apollo4, 3.0, 6), robot=None)
    with pytest.raises(UsageError, match="needs the robot's URDF"):
        Standard().fit(data, KEY)
