"""A run made of random numbers: what reports and the store are tested with."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.maths.metrics import nmse, rmse
from invdyn_cli.models.pest import Pest
from invdyn_cli.types import Dataset, Fit, Motion, Prediction, Robot, RunRecord, Score, Trajectory

CONFIG = "model:\n  rate: 0.001\n  layers: [64, 64]\nseed: 0\n"


def make_robot(joints: tuple[str, ...], prismatic: tuple[bool, ...] = ()) -> Robot:
    """A straight chain of the named joints; they turn unless said otherwise."""
    n = len(joints)
    zero, far = np.zeros(n), np.full(n, np.inf)
    return Robot(
        name="chain",
        joints=joints,
        parents=tuple(range(-1, n - 1)),
        prismatic=prismatic or (False,) * n,
        rotation=np.tile(np.eye(3), (n, 1, 1)),
        translation=np.tile([0.0, 0.0, 0.3], (n, 1)),
        axis=np.tile([0.0, 1.0, 0.0], (n, 1)),
        inertial=np.tile([1.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.02, 0.0, 0.0, 0.01], (n, 1)),
        gravity=np.array([0.0, 0.0, -9.81]),
        lower=-far,
        upper=far,
        velocity_limit=far,
        effort_limit=far,
        damping=zero,
        friction=zero,
        notes=("gripper_joint is locked at 0.",),
    )


def make_dataset(robot: Robot, rng: np.random.Generator, *, samples: int = 400, trajectories: int = 2) -> Dataset:
    """Slow sines with a torque of gravity, inertia and Coulomb friction, 100 Hz."""
    n, made = robot.dofs, []
    for k in range(trajectories):
        t = 0.01 * np.arange(samples)
        rate, phase = rng.uniform(1.0, 3.0, n), rng.uniform(0.0, 6.0, n)
        angle = t[:, None] * rate + phase
        motion = Motion(np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle))
        tau = (
            12.0 * np.cos(motion.q) + 0.8 * motion.qdd + 1.5 * np.sign(motion.qd) + 0.2 * rng.normal(size=(samples, n))
        )
        made.append(Trajectory(f"move_{k}", t, motion, tau))
    return Dataset(tuple(made), robot.joints, robot)


def make_record(
    n: int = 4,
    members: int = 1,
    *,
    joints: tuple[str, ...] = (),
    prismatic: tuple[bool, ...] = (),
    samples: int = 400,
    epochs: int = 30,
    pest: bool = True,
    error: float = 1.0,
    warnings: tuple[str, ...] = (),
    choices: Mapping[str, Any] | None = None,
    seed: int = 0,
) -> RunRecord:
    """A run of n joints whose model misses friction, and is wrong by `error` N m beside it.

    Args:
        members: seeds that one fit holds.
        samples: of each trajectory.
        epochs: length of the loss curves; 0 leaves out the history.
        pest: whether the fit has singular values and base parameters.
    """
    rng = np.random.default_rng(seed)
    joints = joints or tuple(f"joint{i + 1}" for i in range(n))
    robot = make_robot(joints, prismatic)
    sets = {name: make_dataset(robot, rng, samples=samples) for name in ("train", "validation", "test", "test_clean")}
    predictions, scores, member_scores = {}, {}, {}
    for name, data in sets.items():
        clean = data.tau - 1.5 * np.sign(data.motion.qd)
        said = [clean + 0.3 * error * rng.normal(size=clean.shape) for _ in range(members)]
        each = tuple(Score(joints, nmse(data.tau, tau), rmse(data.tau, tau)) for tau in said)
        member_scores[name] = each
        tau = np.mean(said, axis=0)
        scores[name] = Score(joints, nmse(data.tau, tau), rmse(data.tau, tau))
        if name.startswith("test"):
            predictions[name] = Prediction(data, tau)
    decay = np.exp(-np.arange(epochs) / 8)[:, None, None]
    spread = 1 + 0.3 * rng.random((1, members, n))
    values = np.logspace(3, -1, 8 * n)
    names = [f"m{i} + m{i + 1}" for i in range(3 * n)]
    expressions = [f"{x} + 0.3 mc_z" for x in names]
    estimates = {
        "names": names,
        "expressions": expressions,
        "values": rng.normal(size=3 * n),
        "std": 10 ** rng.uniform(-4, -1, 3 * n),
    }
    spectrum = {
        "rank": 8 * n,
        "singular_values": np.append(values, np.geomspace(1e-9, 1e-12, 2 * n)),
        "threshold": 1e-3,
        "effective_samples": rng.uniform(10, 200, n),
    }
    return RunRecord(
        choices=choices or {"model": "pest", "data": "sim_noisy", "adaptation": "batch", "seed": 0},
        model=Pest(),
        adaptation=Batch(),
        fit=Fit(
            params={"weights": rng.normal(size=(members, n))},
            robot=robot,
            joints=joints,
            parameters=10 * n,
            history={"train_loss": decay * spread + 0.01, "validation_loss": decay * spread + 0.03} if epochs else {},
            details={**spectrum, "base_parameters": estimates} if pest else {},
            warnings=warnings,
        ),
        predictions=predictions,
        scores=scores,
        member_scores=member_scores if members > 1 else {},
        samples={name: data.samples for name, data in sets.items()},
        seconds={"fit": 1.234, "predict": 0.056, "total": 1.5},
        split={"split": "interpolation", "train": ["amplitude 0.1", "amplitude 0.2"], "rate_Hz": 100.0},
        digest="3f2a" * 16,
        config=CONFIG,
        overrides=("model=pest", "data=sim_noisy"),
        provenance={"versions": {"jax": "0.10.2", "numpy": "2.4.6"}, "git": "abc1234", "device": "cpu"},
    )
