"""PEST against numpy's SVD of the whole stacked regressor, made by Pinocchio; and whether its intervals are honest."""
# pyright: reportAttributeAccessIssue=false

import itertools
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pinocchio as pin
import pytest
from scipy import signal

from invdyn_cli.errors import UsageError
from invdyn_cli.maths import pseudo_inertia
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.maths.regression import Design, solve
from invdyn_cli.models.pest import Pest
from invdyn_cli.robots import pinocchio_model
from invdyn_cli.types import Dataset, Motion, Trajectory

KEY = jax.random.key(0)
NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def random_motion(n: int, samples: int, seed: int = 0) -> Motion:
    """States all around (samples, n), no joint slower than 0.2 rad/s: what is taken for standstill plays no role."""
    rng = np.random.default_rng(seed)
    qd = rng.choice([-1, 1], (samples, n)) * rng.uniform(0.2, 2, (samples, n))
    return Motion(rng.uniform(-2, 2, (samples, n)), qd, rng.normal(0, 3, (samples, n)))


def sines(n: int, samples: int, rate: float = 500.0) -> Motion:
    """Three sines for each joint (samples, n), of frequencies that no two share: all that an arm can show, smoothly."""
    t = np.arange(samples)[:, None] / rate
    q, qd, qdd = np.zeros((3, samples, n))
    for k in range(3):
        w = 2 * np.pi * (0.13 + 0.07 * np.arange(n) + 0.31 * k)
        angle, size = w * t + 1.7 * np.arange(n) + k, 0.6 / (1 + k)
        q, qd, qdd = q + size * np.sin(angle), qd + size * w * np.cos(angle), qdd - size * w**2 * np.sin(angle)
    return Motion(q, qd, qdd)


def oracle_rows(robot, motion: Motion, extras: tuple[str, ...] = ()) -> np.ndarray:
    """K (samples, n, columns) by Pinocchio, with the extra columns behind it, name by name, joint by joint."""
    model = pinocchio_model(robot)
    data, n = model.createData(), robot.dofs
    samples = zip(motion.q, motion.qd, motion.qdd, strict=True)
    rows = np.array([np.array(pin.computeJointTorqueRegressor(model, data, *x)) for x in samples])
    column = {
        "coulomb": np.sign(motion.qd),
        "viscous": motion.qd,
        "offset": np.ones_like(motion.qd),
        "armature": motion.qdd,
        "stribeck_0": np.sign(motion.qd) * np.exp(-((motion.qd / 0.06) ** 2)),
        "stribeck_1": np.sign(motion.qd) * np.exp(-((motion.qd / 0.2) ** 2)),
    }
    return np.concatenate([rows, *(column[name][:, :, None] * np.eye(n) for name in extras)], axis=2)


def dataset(robot, motion: Motion, tau: np.ndarray, rate: float = 500.0) -> Dataset:
    """The motion as two trajectories of unequal length."""
    cut, t = len(motion) // 3, np.arange(len(motion)) / rate
    parts = slice(0, cut), slice(cut, None)
    return Dataset(tuple(Trajectory(f"x{p.start}", t[p], motion[p], tau[p]) for p in parts), robot.joints, robot)


def columns(robot) -> list[str]:
    """Names of K's columns."""
    return [f"{name}[{joint}]" for joint in robot.joints for name in NAMES]


def rigid_torque(robot, motion: Motion) -> np.ndarray:
    model = pinocchio_model(robot)
    data = model.createData()
    return np.array([pin.rnea(model, data, *x) for x in zip(motion.q, motion.qd, motion.qdd, strict=True)])


CASES = {
    "plain": Pest(),
    "relative": Pest(threshold=2e-3, relative=True),
    "joints that move": Pest(1e-2, friction="stribeck", least_speed=0.05),
    "all columns, weighted": Pest(1e-2, False, "torque_spread", "coulomb_viscous", True, True),
}


@pytest.mark.parametrize("case", CASES)
def test_the_solution_is_the_svds(apollo4, case):
    """Singular values, rank and parameters are those of numpy's SVD of the whole K, truncated, on noisy torques."""
    model, robot = CASES[case], apollo4
    motion = random_motion(4, 1100)
    rng = np.random.default_rng(1)
    tau = rigid_torque(robot, motion) + rng.normal(0, [3.0, 1.0, 0.3, 0.1], (1100, 4)) + 0.5 * motion.qd
    weights = 1 / tau.std(0) if model.weighting == "torque_spread" else np.ones(4)
    weights = weights * (np.abs(motion.qd) >= model.least_speed)
    rows = (oracle_rows(robot, motion, model.extras) * weights[..., None]).reshape(4400, -1)
    u, s, vt = np.linalg.svd(rows, full_matrices=False)
    limit = model.threshold * (s[0] if model.relative else 1.0)
    rank = int(np.sum(s > limit))
    psi = vt[:rank].T @ (u[:, :rank].T @ (tau * weights).ravel() / s[:rank])

    fit = model.fit(dataset(robot, motion, tau), KEY)
    found = fit.details["singular_values"]
    real = s[s > 1e-9 * s[0]]  # below, they are rounding errors of K itself
    assert fit.details["rank"] == fit.parameters == rank and fit.details["threshold"] == pytest.approx(limit, rel=1e-6)
    np.testing.assert_allclose(found[: len(real)], real, rtol=1e-7)
    learned = np.concatenate([np.ravel(fit.params["psi"]), np.ravel(fit.params["extras"])])
    np.testing.assert_allclose(learned, psi, atol=1e-7 * np.abs(psi).max())


def test_truncation_drops_what_lies_below(apollo4):
    """A relative threshold between two singular values drops the lower ones: the rank is the number above it."""
    motion = random_motion(4, 1100)
    data = dataset(apollo4, motion, rigid_torque(apollo4, motion))
    values = Pest().fit(data, KEY).details["singular_values"]
    for kept in (3, 7, 12):
        between = np.sqrt(values[kept - 1] * values[kept])
        assert Pest(threshold=float(between)).fit(data, KEY).details["rank"] == kept
        assert Pest(threshold=float(between / values[0]), relative=True).fit(data, KEY).details["rank"] == kept


def test_a_motion_that_shows_little_gives_a_small_rank(apollo4):
    """With one joint moving and three at rest, the rank is that of the oracle, and that joint's motion is predicted."""
    motion = random_motion(4, 1100)
    moves = np.array([False, False, True, False])
    motion = Motion(np.where(moves, motion.q, [0.3, -0.4, 0.0, 0.5]), motion.qd * moves, motion.qdd * moves)
    tau = rigid_torque(apollo4, motion)
    train, test = slice(0, 1050), slice(1050, None)
    fit = Pest().fit(dataset(apollo4, motion[train], tau[train]), KEY)
    s = np.linalg.svd(oracle_rows(apollo4, motion[train]).reshape(4200, -1), compute_uv=False)
    assert fit.details["rank"] == np.sum(s > 1e-3) < 15
    assert np.abs(Pest().predict(fit, motion[test]) - tau[test]).max() < 1e-9 * np.abs(tau).max()


def test_clean_torques_are_learned_to_rounding(apollo4):
    """On the paper's four joints without noise, NMSE on other states is below 1e-20, as float64 allows."""
    train, test = random_motion(4, 1500), random_motion(4, 60, seed=1)
    fit = Pest().fit(dataset(apollo4, train, rigid_torque(apollo4, train)), KEY)
    assert nmse(rigid_torque(apollo4, test), Pest().predict(fit, test)).max() < 1e-20


def are_bodies(psi) -> bool:
    """Whether every link's pseudo inertia has a Cholesky factor."""
    return all(np.linalg.eigvalsh(pseudo_inertia.pseudo_inertia(row))[0] > 0 for row in np.asarray(psi))


def test_consistent_links_predict_alike(apollo4):
    """Of an arm of bodies, with a sensor's noise and friction in the model, the smallest psi has links that are none;
    the consistent ones are bodies and predict other states alike, to a twentieth of the noise, without a warning."""
    train, test = random_motion(4, 3000), random_motion(4, 60, seed=1)
    noise = np.array([0.5, 0.5, 0.2, 0.1])
    tau = friction_and_more(apollo4, train) + noise * np.random.default_rng(2).normal(size=(3000, 4))
    options = {"friction": "coulomb_viscous", "offset": True, "rotor_inertia": True}
    free, bound = (Pest(consistent=c, **options) for c in (False, True))
    fits = [model.fit(dataset(apollo4, train, tau), KEY) for model in (free, bound)]
    assert not are_bodies(fits[0].params["psi"]) and are_bodies(fits[1].params["psi"])
    assert fits[1].warnings == fits[0].warnings
    change = free.predict(fits[0], test) - bound.predict(fits[1], test)
    assert np.all(np.sqrt(np.mean(change**2, axis=0)) < 0.05 * noise)


def test_consistent_links_are_the_urdfs_where_they_fit(apollo4):
    """Without noise, of the URDF's own torques, the consistent links are the URDF's, unseen parameters and all."""
    train = random_motion(4, 1500)
    fit = Pest(consistent=True).fit(dataset(apollo4, train, rigid_torque(apollo4, train)), KEY)
    size = np.abs(np.asarray(apollo4.inertial)).max(axis=1, keepdims=True)
    np.testing.assert_allclose(fit.params["psi"] / size, np.asarray(apollo4.inertial) / size, atol=1e-4)


def test_it_is_said_where_the_data_want_no_bodies(apollo4):
    """Half of the arm's torques with the sign turned round, as a wrong drive constant might: links that can be predict
    otherwise, and a warning says by how much."""
    train = random_motion(4, 3000)
    tau = -0.5 * rigid_torque(apollo4, train) + 0.1 * np.random.default_rng(3).normal(size=(3000, 4))
    fit = Pest(consistent=True).fit(dataset(apollo4, train, tau), KEY)
    assert are_bodies(fit.params["psi"])
    assert any("not physically consistent" in x for x in fit.warnings)
    assert fit.details["consistent"]["cost"] > 100 * fit.details["consistent"]["chance"]


def friction_and_more(robot, motion: Motion) -> np.ndarray:
    """Torque of the rigid body, with friction, offset and rotor inertia that differ from joint to joint."""
    own = np.arange(1, robot.dofs + 1)
    extra = 0.7 * own * np.sign(motion.qd) + 0.4 * own * motion.qd - 0.3 * own + 0.05 * own * motion.qdd
    return rigid_torque(robot, motion) + extra


def test_friction_offset_and_rotor_inertia_come_out_as_planted(apollo4):
    """Coulomb 0.7 j, viscous 0.4 j and an offset of -0.3 j in joint j are found to 1e-6. Rotor inertia is found only in
    the torque: in the joints near the base the links' own inertia takes its place."""
    motion = random_motion(4, 3000)
    model = Pest(friction="coulomb_viscous", offset=True, rotor_inertia=True)
    fit = model.fit(dataset(apollo4, motion, friction_and_more(apollo4, motion)), KEY)
    own = np.arange(1, 5)
    np.testing.assert_allclose(fit.params["extras"][:3], [0.7 * own, 0.4 * own, -0.3 * own], atol=1e-6)
    other = random_motion(4, 60, seed=1)
    assert nmse(friction_and_more(apollo4, other), model.predict(fit, other)).max() < 1e-18


def test_ripples_come_out_as_planted(apollo4):
    """Two lines over the angle of joints 1 and 2 and one of joint 3, of drawn cycles, are found to half of the
    resolution 2 pi / reach, other motions are predicted to a tenth of them, and joint 4, with none, is given none."""
    rng = np.random.default_rng(3)
    cycles = np.array([rng.uniform(15, 25, 4), rng.uniform(40, 80, 4)])
    size = np.array([[1.0, 2.0, 0.5, 0.0], [0.5, 1.0, 0.0, 0.0]])
    phase = rng.uniform(-np.pi, np.pi, (2, 4))

    def torque(motion: Motion) -> np.ndarray:
        wave = size[:, None] * np.sin(cycles[:, None] * motion.q + phase[:, None])
        return rigid_torque(apollo4, motion) + wave.sum(0) + rng.normal(0, 0.02, motion.q.shape)

    motion, other = random_motion(4, 3000), random_motion(4, 500, seed=1)
    model = Pest(ripples=2)
    fit = model.fit(dataset(apollo4, motion, torque(motion)), KEY)
    found = fit.params["cycles"]
    np.testing.assert_array_equal(found > 0, size > 0)
    assert np.all(np.abs(found - cycles)[size > 0] < (np.pi / np.ptp(motion.q, axis=0) * np.ones((2, 1)))[size > 0])
    left = torque(other) - model.predict(fit, other)
    assert np.all(np.sqrt(np.mean(left**2, axis=0)) < 0.1 * np.maximum(size.sum(0), 0.3))


def test_base_parameters_are_the_combinations_that_they_say(apollo4):
    """On clean data each value is the combination of the true parameters that its expression spells (four digits)."""
    motion = sines(4, 3000)
    table = Pest().fit(dataset(apollo4, motion, rigid_torque(apollo4, motion)), KEY).details["base_parameters"]
    truth = dict(zip(columns(apollo4), np.ravel(apollo4.inertial), strict=True))
    for name, expression, value in zip(table["names"], table["expressions"], table["values"], strict=True):
        terms = re.findall(r"(?:([+-]) ([\d.e+-]+) )?(\w+\[\w+\])", expression)
        assert terms[0] == ("", "", name)
        parts = [truth[x] * float(f"{sign}{factor}" if sign else "1") for sign, factor, x in terms]
        assert value == pytest.approx(sum(parts), abs=1e-3 * sum(map(abs, parts)) + 1e-9), expression


def test_intervals_hold_the_truth_and_white_noise_intervals_do_not(apollo4):
    """With AR(1) torque noise (autocorrelation time 39 samples) 95 % intervals of the base parameters, pooled over 8
    draws, hold the truth in 85 to 100 %; the usual formula for white residuals, too narrow by up to sqrt(39), in under
    60 %. About 100 independent stretches for 20 parameters leave the sandwich a few per cent below its nominal 95 %."""
    samples, a, size = 30_000, 0.95, 0.5
    motion = sines(4, samples)
    clean = rigid_torque(apollo4, motion)
    true = Pest().fit(dataset(apollo4, motion, clean), KEY).details["base_parameters"]
    chosen = [columns(apollo4).index(name) for name in true["names"]]
    base = oracle_rows(apollo4, motion)[:, :, chosen].reshape(4 * samples, -1)
    white = size * np.sqrt(np.diag(np.linalg.inv(base.T @ base)))
    held, held_white = [], []
    for draw in range(8):
        e = np.random.default_rng(draw).normal(0, size * np.sqrt(1 - a**2), (samples, 4))
        noise = signal.lfilter([1], [1, -a], e, axis=0)
        found = Pest().fit(dataset(apollo4, motion, clean + noise), KEY).details["base_parameters"]
        assert found["names"] == true["names"]
        off = np.abs(found["values"] - true["values"])
        held.append(off <= 1.96 * found["std"])
        held_white.append(off <= 1.96 * white)
    assert 0.85 <= np.mean(held) <= 1.0
    assert np.mean(held_white) < 0.6
    assert min(np.mean(held, axis=0)) > 0.5  # no single parameter is hopeless


def test_intervals_of_a_short_log_are_not_too_narrow(apollo4):
    """With so few independent stretches (4,000 samples, worth 100) that they are warned of, pooled 95 % intervals still
    hold the truth in 85 to 100 % of 12 draws."""
    motion = sines(4, 4000)
    clean = rigid_torque(apollo4, motion)
    true = Pest().fit(dataset(apollo4, motion, clean), KEY).details["base_parameters"]
    held = []
    for draw in range(12):
        e = np.random.default_rng(draw).normal(0, 0.5 * np.sqrt(1 - 0.95**2), (4000, 4))
        fit = Pest().fit(dataset(apollo4, motion, clean + signal.lfilter([1], [1, -0.95], e, axis=0)), KEY)
        found = fit.details["base_parameters"]
        assert found["names"] == true["names"] and fit.warnings
        held.append(np.abs(found["values"] - true["values"]) <= 1.96 * found["std"])
    assert 0.85 <= np.mean(held) <= 1.0


def test_effective_samples_of_correlated_residuals(apollo4):
    """AR(1) residuals with autocorrelation time 39 make 60,000 samples worth 60,000 / 39, within a third (the
    estimate's own spread over 40,000 samples is 14 %)."""
    motion = sines(4, 60_000)
    e = np.random.default_rng(0).normal(0, 0.2, (60_000, 4))
    tau = rigid_torque(apollo4, motion) + signal.lfilter([1], [1, -0.95], e, axis=0)
    details = Pest().fit(dataset(apollo4, motion, tau), KEY).details
    np.testing.assert_allclose(details["effective_samples"], 60_000 / 39, rtol=1 / 3)


def test_few_independent_stretches_are_warned_of(apollo4):
    """A short log says in a sentence that its standard deviations are rough; a long one says nothing."""
    motion = sines(4, 20_000)
    tau = rigid_torque(apollo4, motion) + np.random.default_rng(0).normal(size=(20_000, 4))
    short, long = (Pest().fit(dataset(apollo4, motion[slice(0, n)], tau[:n]), KEY) for n in (1500, 20_000))
    assert "independent stretches:" in short.warnings[0] and not long.warnings


def test_one_independent_stretch_is_singular(apollo4):
    """A log of a hundred samples is one stretch, and the sentence is in the singular."""
    motion = sines(4, 100)
    tau = rigid_torque(apollo4, motion) + np.random.default_rng(0).normal(size=(100, 4))
    data = dataset(apollo4, motion, tau)
    warnings = Pest().fit(replace(data, trajectories=data.trajectories[:1]), KEY).warnings
    assert warnings[0].startswith("The residuals hold only 1 independent stretch: ")


def test_trajectories_may_come_in_any_pieces(apollo4):
    """Cutting a trajectory in pieces of odd lengths, one of a single sample, changes the solution by rounding alone."""
    motion = random_motion(4, 5000)
    tau = rigid_torque(apollo4, motion) + np.random.default_rng(0).normal(size=(5000, 4))
    cuts = [0, 1, 300, 4500, 5000]
    parts = [slice(a, b) for a, b in itertools.pairwise(cuts)]
    t = np.arange(5000) / 500
    pieces = Dataset(tuple(Trajectory("x", t[p], motion[p], tau[p]) for p in parts), apollo4.joints, apollo4)
    design = Design(apollo4, (), np.ones(4))
    one, many = (solve(design, x, 1e-3) for x in (dataset(apollo4, motion, tau), pieces))
    assert one.rank == many.rank
    np.testing.assert_allclose(one.psi, many.psi, atol=1e-9 * np.abs(one.psi).max())


MEMORY = """
from pathlib import Path
import jax, numpy as np
from invdyn_cli.models.pest import Pest
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Dataset, Motion, Trajectory

def megabytes(field):
    return int(Path("/proc/self/status").read_text().split(field)[1].split()[0]) / 1024

robot = load_urdf("apollo_arm", dofs=3)
t = np.arange(1_000_000) / 500
wave = [np.sin(t[:, None] * f) for f in ((1.0, 1.3, 0.7), (1.1, 0.6, 0.9), (0.8, 1.7, 1.2))]
tau = sum(wave)
model = Pest(weighting="torque_spread")
for samples in (20_000, 200_000, 1_000_000):
    one = Trajectory("x", t[:samples], Motion(*(x[:samples] for x in wave)), tau[:samples])
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    before = megabytes("VmRSS:")
    model.fit(Dataset((one,), robot.joints, robot), jax.random.key(0))
    print(megabytes("VmHWM:") - before)
"""


@pytest.mark.benchmark  # half a minute of fits on a million samples
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="needs the peak memory that Linux counts")
def test_memory_does_not_grow_with_the_samples():
    """A fit on a million samples takes under 12 MB more than one on 200,000. A copy of one channel, or the residuals,
    would take 19 MB, K 580 MB; the block scores, 1 / 256 of K, take 2 MB, and the allocator gets the rest."""
    script = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, timeout=120)
    assert script.returncode == 0, script.stderr
    _, middle, large = map(float, script.stdout.split())
    assert large - middle < 12, script.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"weighting": "spread"}, "model.weighting='spread'; allowed: none, torque_spread"),
        ({"least_speed": -1.0}, "model.least_speed=-1.0; allowed: a number >= 0"),
        ({"rest_speed": 0.0}, "model.rest_speed=0.0; allowed: a number > 0"),
        ({"friction": "striebeck"}, "model.friction='striebeck'; allowed: none, coulomb_viscous"),
        ({"threshold": -1.0}, "model.threshold=-1.0; allowed: a number >= 0"),
        ({"threshold": float("nan")}, "model.threshold=nan"),
        ({"ripples": -1}, "model.ripples=-1; allowed: a whole number from 0 to 50"),
    ],
)
def test_misuse_is_refused(options, words):
    """Options that make no sense are refused by name, with what is allowed."""
    with pytest.raises(UsageError, match=re.escape(words)):
        Pest(**options)


def test_without_a_robot_it_is_refused(apollo4):
    """Data without kinematics are refused, and the sentence names a way out."""
    motion = random_motion(4, 10)
    data = replace(dataset(apollo4, motion, motion.q), robot=None)
    with pytest.raises(UsageError, match=r"needs the robot's kinematics.*robot\.path=.*model=ffnn"):
        Pest().fit(data, KEY)
