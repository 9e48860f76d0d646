"""adaptation=payload: detects a load that comes and goes in the residual of a rigid-body model, estimates its mass, and
predicts with it.

The torque is linear in the ten inertial parameters phi of a body on the last link, tau = model(q, qd, qdd) + Y phi. All
information of a stretch about a load is therefore in two sums over its samples, L = sum Y'WY and b = sum Y'W r, where r
is the residual of the unloaded arm's model; the log-likelihood ratio of phi to no load is b'phi - phi'L phi / 2. W
weights samples: less where a joint is near rest, because its friction is then indeterminate, and less by the
correlation time of the residuals. Each sample answers three questions:

- Has a load come? Beyond a threshold some load explains the last stretch better than none (likelihood ratio; Willsky
  and Jones 1976), or the last one that was released does (cumulative sum; Page 1954).
- How much is it? Recursive least squares since it came (Ljung 1999, 11.2), forgetting in proportion to that time.
- Is it released, or replaced? A cumulative sum of no load against it; the likelihood ratio of any other against it.
  A load that disappears gradually counts as another one, until it is smaller than in motions without a load.

The threshold is a multiple of the largest evidence in motions without a load. Friction that no function of the motion
can describe is a disturbance: an observer tracks it (Ohnishi 1996), so that predictions do not wait for a decision.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, Progress, silent
from invdyn_cli.maths import rigid_body, statistics
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot, Trajectory

PARAMETERS = len(rigid_body.PARAMETERS)

MOVING = 0.02
"""A joint counts as moving at speeds at which friction hides less than this share of what it hides at rest."""

STATES = 64
"""Number of states of a motion from which the friction of a joint is computed."""


@dataclass(frozen=True)
class Payload(AbstractAdapter):
    """Three hypotheses: no load, the estimated load, and the last load that was released.

    Attributes:
        mass: [kg] mass of a heavy load, roughly.
        size: [m] distance from the last joint's frame to the far end of a load, roughly.
        window: [samples] length of the window in which a load is detected.
        rest_speed: [rad/s; m/s] speed at which the unknown part of friction, which can be mistaken for a load, is a
            third of that at rest.
        surety: [nats] smallest log-likelihood ratio at which a change is accepted.
        margin: [-] smallest log-likelihood ratio at which a change is accepted, as a multiple of the largest one in
            motions without a load; the larger of surety and this counts.
        observer: [samples] time constant of the disturbance observer on the residual; None: no observer.
        rate: [samples] number of samples after which predictions use a new state.
    """

    mass: float = 3.0
    size: float = 0.15
    window: int = 100
    rest_speed: float = 0.03
    surety: float = 12.0
    margin: float = 3.0
    observer: int | None = 10
    rate: int = 1

    def __post_init__(self) -> None:
        for name in ("mass", "size", "rest_speed", "surety"):
            if not getattr(self, name) > 0:
                raise UsageError(f"adaptation.{name}={getattr(self, name)}; allowed: a number above 0")
        for name, least in (("window", 2), ("rate", 1), ("observer", 1)):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= least) and not (name == "observer" and value is None):
                allowed = f"a whole number of samples from {least}{', or null' * (name == 'observer')}"
                raise UsageError(f"adaptation.{name}={value}; allowed: {allowed}")
        if not self.margin >= 1:
            raise UsageError(f"adaptation.margin={self.margin}; allowed: a number >= 1")

    @property
    def block(self) -> int:
        """The rate."""
        return self.rate

    def fit(
        self,
        model: AbstractModel,
        dataset: Dataset,
        key: jax.Array,
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """The model's own fit; then motions without a load are watched that were not learned from: the validation's
        where these are recordings of their own, else every recording (of few: parts of each), by a fit without it.

        details: load_variance (n,) [(N m)^2] of residuals in motion and load_samples (n,), how many of them are worth
        one; load_hidden (n,) [N m; N], friction at rest; load_threshold [nats].

        Raises:
            UsageError: without a robot, whose kinematics say where a load acts.
        """
        if dataset.robot is None:
            got = "adaptation=payload needs the robot's kinematics, but these data have no URDF"
            raise UsageError(got, advice="robot=urdf robot.path=arm.urdf, or adaptation=error_model")
        fit = model.fit(dataset, key, validation=validation, progress=lambda done, note: progress(0.5 * done, note))
        if validation is not None and _apart(validation, dataset):
            watched = [(fit, x) for x in validation.trajectories]
        else:
            watched = _left_out(model, dataset, key)
        variance, samples = self._noise(model, watched)
        known = {
            "load_variance": variance,
            "load_samples": samples,
            "load_hidden": self._hidden(model, fit, dataset.motion),
            "load_threshold": np.inf,
        }
        details = {**fit.details, **known}
        states = (self.init(model, replace(own, robot=dataset.robot, details=details)) for own, _ in watched)
        highest = max(
            float(self._highest(model, state, x.motion, x.tau)) for state, (_, x) in zip(states, watched, strict=True)
        )
        threshold = max(self.surety, self.margin * highest)
        return replace(fit, robot=dataset.robot, details={**details, "load_threshold": threshold})

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """No load, and no sample seen yet."""
        nothing = {"L": jnp.zeros((PARAMETERS, PARAMETERS)), "b": jnp.zeros(PARAMETERS)}
        return {
            "params": jax.tree.map(jnp.asarray, fit.params),
            "robot": fit.robot,
            **{name: jnp.asarray(fit.details[f"load_{name}"], float) for name in WATCHED},
            **dict.fromkeys(("window", "load", "before", "doubt"), nothing),
            "phi": jnp.zeros(PARAMETERS),
            "loaded": jnp.array(False),
            "disturbance": jnp.zeros(len(fit.joints)),
            **dict.fromkeys(("since", "came", "back", "gone"), jnp.array(0.0)),
        }

    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of one sample, with the load that is currently assumed and the last disturbance."""
        said = model.apply(state["params"], motion, state["robot"])
        return said + columns(state["robot"], motion) @ _believed(state) + state["disturbance"]

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after one more sample."""
        left = tau - model.apply(state["params"], motion, state["robot"])
        y = columns(state["robot"], motion)
        turned = self._weighed(state, motion, left, y)
        if self.observer is None:
            return turned
        # A load that is believed in from now on no longer disturbs.
        disturbance = state["disturbance"] + _turned(state, turned) * (y @ (_believed(state) - _believed(turned)))
        disturbance += (left - y @ _believed(turned) - disturbance) / self.observer
        return {**turned, "disturbance": disturbance}

    def trace(self, state: PyTree) -> dict[str, Array]:
        """loaded (0 or 1), mass [kg] and com (3,) [m, last joint's frame] of the load and their standard deviations
        (NaN: none); since, from how many samples in motion these are; and evidence, over the threshold, of the next
        change."""
        loaded, phi = state["loaded"], jnp.where(state["loaded"], state["phi"], jnp.nan)
        covariance, com = jnp.linalg.inv(state["load"]["L"] + self._prior())[:4, :4], phi[1:4] / phi[0]
        slope = jnp.concatenate([-com[:, None], jnp.eye(3)], axis=1) / phi[0]  # of com over mass and mass times com
        evidence = jnp.where(loaded, state["gone"], jnp.maximum(state["came"], state["back"]))
        return {
            "loaded": 1.0 * loaded,
            "mass": phi[0],
            "mass_std": jnp.where(loaded, covariance[0, 0] ** 0.5, jnp.nan),
            "com": com,
            "com_std": jnp.sqrt(jnp.diag(slope @ covariance @ slope.T)),
            "since": jnp.where(loaded, state["since"], jnp.nan),
            "evidence": evidence / state["threshold"],
        }

    def _weighed(self, state: PyTree, motion: Motion, left: Array, y: Array) -> PyTree:
        """The state with the evidence of one sample for and against loads."""
        prior, threshold, loaded = self._prior(), state["threshold"], state["loaded"]
        share = 1 / (1 + state["hidden"] ** 2 * _resting(motion.qd, self.rest_speed) / state["variance"])
        w = share / (state["variance"] * state["samples"])
        here = {"L": y.T @ (w[:, None] * y), "b": y.T @ (w * left)}

        # Time passes as far as a sample says anything: what was seen is not forgotten while the arm rests.
        passed = share.mean()
        since = state["since"] + passed
        window = _faded(state["window"], passed / self.window, here)
        load = _faded(state["load"], passed / (self.window + since), here)
        phi, before, any_load = (_solved(x, prior) for x in (load, state["before"], window))

        came = jnp.where(any_load[0] > 0, window["b"] @ any_load / 2, 0.0)
        back = jnp.maximum(0.0, state["back"] + _gain(here, before))
        known = (came > threshold) & (_gain(window, before) > came - self.surety) | (back > threshold)
        takes = ~loaded & ((came > threshold) | known)

        gone = jnp.maximum(0.0, state["gone"] - _gain(here, phi))
        doubt = _if(gone > 0, _faded(state["doubt"], 0.0, here), _none(here))
        instead = _solved(doubt, prior)
        empty = (doubt["b"] @ instead / 2 < self.surety) | (instead[0] <= 0)
        usual = phi @ load["L"] @ phi / 2 * self.window / (self.window + since)  # its evidence in a stretch like any
        faint = loaded & (usual < threshold / self.margin) & (since > self.window / 2)
        leaves = loaded & (gone > threshold) & empty | faint
        wrong = loaded & (gone > threshold) & ~empty
        other = loaded & (came - _gain(window, phi) > threshold) & (since > self.window)

        turns = takes | leaves | wrong | other
        load = _if(turns, _if(takes & known, state["before"], _if(wrong, doubt, window)), load)
        return {
            **state,
            "window": _if(turns, _none(window), window),
            "load": load,
            "before": _if(loaded & turns & ~faint & (since > self.window), state["load"], state["before"]),
            "doubt": _if(turns, _none(doubt), doubt),
            "phi": _solved(load, prior),
            "loaded": takes | loaded & ~leaves,
            "since": jnp.where(turns, 0.0, since),
            "came": came,
            "back": jnp.where(turns | loaded, 0.0, back),
            "gone": jnp.where(turns | ~loaded, 0.0, gone),
        }

    def _prior(self) -> Array:
        """(10, 10) prior on the parameters of a load: inverse variances on the diagonal."""
        squares = [1.0, *[self.size**2] * 3, *[self.size**4 / 4] * 6]
        return jnp.diag(1 / (self.mass**2 * jnp.array(squares)))

    def _noise(self, model: AbstractModel, watched: Sequence[tuple[Fit, Trajectory]]) -> tuple[np.ndarray, np.ndarray]:
        """(n,) variance of residuals of joints that move, from their median, and their correlation time [samples]."""
        moving = [np.asarray(_resting(x.motion.qd, self.rest_speed)) < MOVING for _, x in watched]
        left = [x.tau - model.predict(fit, x.motion) for fit, x in watched]
        sizes = np.where(np.concatenate(moving), np.abs(np.concatenate(left)), np.nan)
        still = np.isnan(sizes).all(axis=0)
        spread = 1.4826 * np.nanmedian(np.where(still, np.abs(np.concatenate(left)), sizes), axis=0)
        spread = np.maximum(spread, 1e-6 * max(np.abs(x.tau).max() for _, x in watched))
        kept = [np.clip(r * m, -3 * spread, 3 * spread) for r, m in zip(left, moving, strict=True)]
        times = np.mean([[statistics.autocorrelation_time(x) for x in r.T] for r in kept], axis=0)
        return spread**2, times

    def _hidden(self, model: AbstractModel, fit: Fit, motion: Motion) -> np.ndarray:
        """(n,) friction: half the difference between the torques of slow motion in both directions, in states of this
        motion."""
        rows, n = np.linspace(0, len(motion) - 1, STATES).astype(int), len(fit.joints)
        q = np.repeat(np.asarray(motion.q)[rows], n, axis=0)
        qd = self.rest_speed * np.tile(np.eye(n), (STATES, 1))
        forth, back = (model.predict(fit, Motion(q, sign * qd, np.zeros_like(q))) for sign in (1, -1))
        own = ((forth - back) / 2).reshape(STATES, n, n)[:, np.arange(n), np.arange(n)]
        return np.abs(np.median(own, axis=0))

    @partial(jax.jit, static_argnums=(0, 1))
    def _highest(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> Array:
        """The highest evidence for a load along a motion without one."""

        def step(state: PyTree, sample: tuple[Motion, Array]) -> tuple[PyTree, Array]:
            state = self.update(model, state, *sample)
            return state, state["came"]

        return jax.lax.scan(step, state, (motion, tau))[1].max()


FOLDS = 4
"""Number of fits, each without a part of the training data, where there are no recordings for validation."""

WATCHED = ("variance", "samples", "hidden", "threshold")
"""Prefix of those details of a fit that concern motions without a load."""


@jax.jit
def columns(robot: Robot, motion: Motion) -> Array:
    """Y (n, 10): torques of one sample per inertial parameter of a body on the last link."""
    nothing = jnp.zeros((robot.dofs, PARAMETERS))

    def torque(row: Array) -> Array:
        return rigid_body.inverse_dynamics(robot, nothing.at[-1].set(row), motion.q, motion.qd, motion.qdd)

    return jax.vmap(torque, out_axes=1)(jnp.eye(PARAMETERS))


def _apart(validation: Dataset, dataset: Dataset) -> bool:
    """Whether the two sets have no recording in common, not even parts of one (name[t0:t1])."""
    watched, learned = ({x.name.split("[")[0] for x in data.trajectories} for data in (validation, dataset))
    return watched.isdisjoint(learned)


def _left_out(model: AbstractModel, dataset: Dataset, key: jax.Array) -> list[tuple[Fit, Trajectory]]:
    """Every recording with a fit that did not see it; if there are few recordings, every part of each."""
    parts = [part for x in dataset.trajectories for part in _cut(x, -(-FOLDS // len(dataset.trajectories)))]
    every, found = np.arange(len(parts)), []
    for out in np.array_split(every, FOLDS):
        kept = tuple(parts[k] for k in np.setdiff1d(every, out))
        fit = model.fit(replace(dataset, trajectories=kept), key)
        found += [(fit, parts[k]) for k in out]
    return found


def _cut(x: Trajectory, count: int) -> list[Trajectory]:
    """A recording divided in time into that many parts."""
    edges = np.linspace(0, len(x.t), count + 1).astype(int).tolist()
    return [x[a:b] for a, b in pairwise(edges) if b > a]


def _believed(state: PyTree) -> Array:
    return jnp.where(state["loaded"], state["phi"], 0.0)


def _turned(before: PyTree, after: PyTree) -> Array:
    """Whether one load replaced another, or was picked up or released."""
    return (before["loaded"] != after["loaded"]) | (after["since"] == 0)


def _resting(qd: Array, speed: float) -> Array:
    """The friction that is indeterminate at a speed, as a share of that at rest."""
    return jnp.exp(-((qd / speed) ** 2))


def _solved(sums: PyTree, prior: Array) -> Array:
    return jnp.linalg.solve(sums["L"] + prior, sums["b"])


def _gain(sums: PyTree, phi: Array) -> Array:
    """Log-likelihood ratio [nats] of a load against no load."""
    return sums["b"] @ phi - phi @ sums["L"] @ phi / 2


def _faded(sums: PyTree, share: Array | float, here: PyTree) -> PyTree:
    """Sums after a share of them is forgotten and a new term is added."""
    return jax.tree.map(lambda old, new: (1 - share) * old + new, sums, here)


def _none(sums: PyTree) -> PyTree:
    return jax.tree.map(jnp.zeros_like, sums)


def _if(condition: Array, yes: PyTree, no: PyTree) -> PyTree:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
