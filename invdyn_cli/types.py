"""The data types: Robot, Motion, Trajectory, Dataset, Splits, Fit, Score, RunRecord, Check, Finding, Diagnosis.

Arrays are numpy or jax arrays, float64 unless a net needs float32; time comes first (T, n), joints in the robot's
order.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np

Array = jax.Array | np.ndarray
PyTree = Any


@dataclass(frozen=True)
class Robot:
    """Kinematics, inertials and limits of a chain or tree of n moving joints; fixed and locked joints are merged away.

    Joint frames as in Pinocchio and URDF: frame i moves with joint i, and at q_i = 0 lies at `rotation[i]`,
    `translation[i]` in the frame of joint `parents[i]` (-1: the base).

    Attributes:
        joints: names of the n moving joints, parents before children.
        parents: index of each joint's parent joint, -1 for the base.
        prismatic: whether the joint slides (else it turns).
        rotation: (n, 3, 3), columns are the joint frame's axes in the parent frame at q = 0.
        translation: (n, 3) [m], origin of the joint frame in the parent frame at q = 0.
        axis: (n, 3), unit joint axis in the joint frame.
        inertial: (n, 10) per link [m, m c_x, m c_y, m c_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz], first moments and
            rotational inertia about the joint frame's origin [kg, kg m, kg m^2] (Pinocchio's order).
        gravity: (3,) [m/s^2] in the base frame.
        lower, upper: (n,) [rad; m], infinite where the joint has none.
        velocity_limit, effort_limit: (n,) [rad/s; m/s] and [N m; N], infinite where none.
        damping, friction: (n,) the URDF's <dynamics> tags [N m s/rad], [N m]; zero unless `dynamics_tags=use`.
        urdf: the whole URDF text it was made from.
        notes: what the reader should know: locked joints, ignored parts.
        columns: the joints in the order in which the user named them, that of columns without names; (): as `joints`.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    prismatic: tuple[bool, ...]
    rotation: Array
    translation: Array
    axis: Array
    inertial: Array
    gravity: Array
    lower: Array
    upper: Array
    velocity_limit: Array
    effort_limit: Array
    damping: Array
    friction: Array
    urdf: str = ""
    notes: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()

    @property
    def dofs(self) -> int:
        """Number n of moving joints."""
        return len(self.joints)


_ROBOT_STATIC = ("name", "joints", "parents", "prismatic", "urdf", "notes", "columns")
jax.tree_util.register_dataclass(
    Robot, [f for f in Robot.__dataclass_fields__ if f not in _ROBOT_STATIC], list(_ROBOT_STATIC)
)


@dataclass(frozen=True)
class Motion:
    """Positions, velocities and accelerations, (T, n) each, or (n,) for one sample [rad, rad/s, rad/s^2; m, ...]."""

    q: Array
    qd: Array
    qdd: Array

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, rows: slice | np.ndarray) -> "Motion":
        return Motion(self.q[rows], self.qd[rows], self.qdd[rows])


jax.tree_util.register_dataclass(Motion, data_fields=["q", "qd", "qdd"], meta_fields=[])


@dataclass(frozen=True)
class Trajectory:
    """One uninterrupted recording: a motion, the torque tau (T, n) [N m; N] that goes with it, its t (T,) [s], and
    names of its stages (T,) where it has any."""

    name: str
    t: Array
    motion: Motion
    tau: Array
    stage: Array | None = None

    def __getitem__(self, rows: slice | np.ndarray) -> "Trajectory":
        stage = None if self.stage is None else self.stage[rows]
        return Trajectory(self.name, self.t[rows], self.motion[rows], self.tau[rows], stage)


@dataclass(frozen=True)
class Dataset:
    """Trajectories of one robot (None when its kinematics are unknown), with the joints' names in column order."""

    trajectories: tuple[Trajectory, ...]
    joints: tuple[str, ...]
    robot: Robot | None = None

    @property
    def samples(self) -> int:
        """Number of samples over all trajectories."""
        return sum(len(x.t) for x in self.trajectories)

    @property
    def stage(self) -> Array | None:
        """All trajectories' stages (T,), one after the other; None unless each has them."""
        parts = [x.stage for x in self.trajectories if x.stage is not None]
        return np.concatenate(parts) if parts and len(parts) == len(self.trajectories) else None

    @property
    def motion(self) -> Motion:
        """All trajectories' motions, one below the other (a copy)."""
        parts = [x.motion for x in self.trajectories]
        return Motion(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("q", "qd", "qdd")))

    @property
    def tau(self) -> np.ndarray:
        """All trajectories' torques (samples, n), one below the other (a copy)."""
        return np.concatenate([x.tau for x in self.trajectories])


@dataclass(frozen=True)
class Splits:
    """The data of a source: sets for training, validation (None: no set) and test. `tests` holds at least "test";
    others are scored and stored likewise ("test_clean": clean inputs for noisy ones). `description` says what was made
    or read, for the record."""

    train: Dataset
    validation: Dataset | None
    tests: Mapping[str, Dataset]
    description: Mapping[str, Any] = field(default_factory=dict)

    @property
    def sets(self) -> dict[str, Dataset]:
        """All sets that there are, by name."""
        found = {"train": self.train, "validation": self.validation, **self.tests}
        return {name: data for name, data in found.items() if data is not None}


@dataclass(frozen=True)
class Header:
    """What data say about their robot: joint names in column order, and the URDF's path ("" for none)."""

    robot: str
    joints: tuple[str, ...]
    urdf: str = ""


@dataclass(frozen=True)
class Fit:
    """The result of learning.

    Attributes:
        params: nested dict of arrays, all that `apply` needs beside the robot.
        robot: the robot whose kinematics `apply` uses, None for models that need none.
        joints: names of the columns.
        parameters: how many numbers were learned.
        history: per-epoch curves, each (epochs, members, n).
        details: named arrays and numbers worth keeping: rank, singular values, standard deviations.
        warnings: sentences on numerical trouble; empty when there was none.
    """

    params: PyTree
    robot: Robot | None
    joints: tuple[str, ...]
    parameters: int
    history: Mapping[str, np.ndarray] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Score:
    """NMSE = MSE / Var(target) and RMSE [N m; N] of every joint, (n,) each (paper, section V-B)."""

    joints: tuple[str, ...]
    nmse: np.ndarray
    rmse: np.ndarray

    def mean(self, kind: str) -> float:
        """Mean of "nmse" or "rmse" over the joints that have one: a torque that never changes has no NMSE. NaN as soon
        as a joint has no RMSE: its prediction is not finite."""
        values = getattr(self, kind)
        counted = values[~np.isnan(values) | np.isnan(self.rmse)]
        return float(np.mean(counted)) if len(counted) else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """{"nmse": {"mean", "joint": {name: x}}, "rmse": …} as in metrics.json."""
        return {
            kind: {"mean": self.mean(kind), "joint": {j: float(v) for j, v in zip(self.joints, x, strict=True)}}
            for kind, x in (("nmse", self.nmse), ("rmse", self.rmse))
        }


@dataclass(frozen=True)
class Prediction:
    """A scored set: measurement and prediction, trajectory by trajectory in the order of `data`."""

    data: Dataset
    tau: np.ndarray


@dataclass(frozen=True)
class RunRecord:
    """One experiment, whole: enough to write run.h5, the figures and the page, and to use the fitted model again.

    `model` and `adaptation` are the objects (their hyperparameters), `fit` what they learned; `predictions` and
    `scores` by set name ("train", "validation", "test", …; predictions of the judged sets alone); `member_scores` where
    a fit holds several seeds: set -> a score per seed; `trace` what the adaptation knew after each sample of
    "test_adapted", (samples, …) by name; `choices` the names under which the command line knows them
    (model, data, adaptation, seed).
    """

    choices: Mapping[str, Any]
    model: Any
    adaptation: Any
    fit: Fit
    predictions: Mapping[str, Prediction]
    scores: Mapping[str, Score]
    member_scores: Mapping[str, tuple[Score, ...]]
    samples: Mapping[str, int]
    seconds: Mapping[str, float]
    split: Mapping[str, Any]
    digest: str
    trace: Mapping[str, np.ndarray] = field(default_factory=dict)
    config: str = ""
    overrides: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Check:
    """One check of a log, an entry of check.json.

    Attributes:
        check: its name (unit_error, gaps, …).
        severity: "ok", "skipped" (not examined; `seen` says why), "note", "warn" or "fail" (to be corrected before a
            diagnosis).
        trajectory, joint: where; None for all.
        value: what was measured (a factor, seconds, a permutation, …), None where there is no number.
        threshold: what it was compared with.
        seen, meaning, advice, source: sentences: what was seen, what it means, what to do, where the threshold is from.
    """

    check: str
    severity: str
    trajectory: str | None = None
    joint: str | None = None
    value: Any = None
    threshold: Any = None
    seen: str = ""
    meaning: str = ""
    advice: str = ""
    source: str = ""


@dataclass(frozen=True)
class Examination:
    """The result of the checks of a log: whether it can be diagnosed, every check, the excitation of each joint, and
    the corrections: {"check": name, "done": sentence} in order. `as_recorded`: nothing was to be corrected, and a log
    that fails a check is not usable."""

    usable: bool
    checks: tuple[Check, ...]
    excitation: Mapping[str, Mapping[str, Any]]
    corrections: tuple[Mapping[str, str], ...] = ()
    as_recorded: bool = False


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect: a number, a list of them or a name, its unit, and its 95 % interval (None: none)."""

    value: Any
    unit: str
    interval95: Any = None


@dataclass(frozen=True)
class Gain:
    """Held-out error of one joint, where it moves, without and with one effect [N m; N], and the 95 % interval of
    rmse_before - rmse_after."""

    rmse_before: float
    rmse_after: float
    nmse_before: float
    nmse_after: float
    interval95: tuple[float, float]


class EffectText(NamedTuple):
    """How a report describes an effect: `equation` contains the names of `parameters`, and `adds` says whether it is a
    torque that is added to the nominal one; `panels` as in `AbstractEffect`."""

    title: str
    meaning: str
    equation: str
    parameters: tuple[str, ...]
    adds: bool
    panels: tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """One cause, an entry of diagnosis.json.

    Attributes:
        effect, joint: its name, as in the library of effects, and the joint it acts on, None for the whole arm.
        status: "named", "ambiguous", "not_excited", "not_observable" or "unclaimed" (the last three are no claims).
        alternatives: sets of effects, each of which would replace it on this data.
        parameters, gain: by name; by joint.
        trajectory, window: of an effect in a time window.
        evidence, rejected: numbers that led to it, and (effect, why not) of every rival.
        advice: what to record to be surer.
        group: "standard" for what every arm has beside its URDF, else "anomaly".
        text: how a report speaks of it; None: as the catalogue does.
    """

    effect: str
    joint: str | None
    status: str
    alternatives: tuple[tuple[str, ...], ...] = ()
    parameters: Mapping[str, Quantity] = field(default_factory=dict)
    gain: Mapping[str, Gain] = field(default_factory=dict)
    trajectory: str | None = None
    window: tuple[float, float] | None = None
    evidence: Mapping[str, Any] = field(default_factory=dict)
    rejected: tuple[tuple[str, str], ...] = ()
    advice: str = ""
    group: str = "anomaly"
    text: EffectText | None = None


@dataclass(frozen=True)
class Signals:
    """The data of a diagnosis' pictures: rows of all trajectories one below the other, filtered alike.

    Attributes:
        trajectory, t: (R,) name of each row's trajectory, and time [s].
        q, qd, qdd: (R, n).
        tau, nominal, extended: (R, n) torque as logged, of the nominal and of the extended model.
        terms: one (R, n) for every named or ambiguous finding, in their order: what it adds to the torque.
        valid: (R, n) bool, False where a joint rests and its friction can be anything.
        held_out: (R,) bool, rows that chose nothing.
    """

    trajectory: np.ndarray
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    nominal: np.ndarray
    extended: np.ndarray
    terms: tuple[np.ndarray, ...]
    valid: np.ndarray
    held_out: np.ndarray


@dataclass(frozen=True)
class ResidualTest:
    """Whether the extended model's residual of a joint depends on a quantity.

    Attributes:
        joint: whose torque.
        against: "level", "velocity", "angle", "ripple", "load", "load_zeros", "acceleration", "torque_slope",
            "reversals", "neighbours" or "time".
        statistic, freedom: a chi-square and its degrees of freedom.
        p: the chance that noise shows as much.
        torque: RMS of what goes with it [N m; N].
        share: of the residual's squares.
        passed: whether that is chance, or too little to matter.
        points_at: effects that show so where a model lacks them, and that are not in this one.
        quantity: what it goes with in words and its unit, for the picture's axis.
        curve: (3, bins) that quantity, the mean residual there and its standard error.
    """

    joint: str
    against: str
    statistic: float
    freedom: float
    p: float
    torque: float
    share: float
    passed: bool
    points_at: tuple[str, ...]
    quantity: str
    curve: Array


@dataclass(frozen=True)
class Diagnosis:
    """What a simulation gets wrong, as in diagnosis.json, with the data for its pictures.

    Attributes:
        verdict: "explained", "partly_explained", "nothing_found" or "log_unusable".
        examination: what the doctor said.
        findings: named and ambiguous ones first, anomalies before what every arm has, by gain; then what this log
            could not show.
        baseline, extended: held-out {joint: {"rmse", "nmse"}} of the nominal and the extended model.
        baselines: the same of what a user would try first: "friction", a line of offset, Coulomb and viscous friction
            (and rotor inertia, where torque is taken before the gear) per joint; "standard", the standard model.
        standard: terms beside the claims, {joint: {"coulomb": {"effect", "value", "unit", "interval95", "claimed"}, …},
            "inertials": {"worth": {joint: N m}, "share", "chosen"}}; "perhaps": others that have it as a special case;
            of a comparison's logs "reference", "now": (value, lower, upper), and if they "differ".
        unclaimed: effects in the written model that are not claimed, and there take the place of "in_place_of".
        tests: of what the claims and the standard terms leave, joint by joint.
        noise_floor: {joint: {"rmse"}} from repeated trajectories, None without.
        unexplained: {joint: share of the residual variance that the learner still predicts on held-out data}.
        summary: the verdict in two sentences.
        model, signals: the extended model, data of the pictures; None where the log is unusable.
        replay: the simulated arm beside the measured motion (`simulation.replay.Replay`), None where there is none.
        notes: what the user should know: what was corrected, declared, left out.
        details: filter, rates, tries and other numbers worth keeping.
    """

    verdict: str
    examination: Examination
    findings: tuple[Finding, ...]
    baseline: Mapping[str, Mapping[str, float]]
    extended: Mapping[str, Mapping[str, float]]
    noise_floor: Mapping[str, Mapping[str, float]] | None
    unexplained: Mapping[str, float]
    summary: str = ""
    model: Any = None
    signals: Signals | None = None
    replay: Any = None
    notes: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    baselines: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    standard: Mapping[str, Any] = field(default_factory=dict)
    unclaimed: tuple[Finding, ...] = ()
    tests: tuple[ResidualTest, ...] = ()
