"""adaptation=local_error_model: a model, a local regression of its recent error, and an offset that follows the error.

Meier, Kappler, Ratliff and Schaal 2016, "Towards robust online inverse dynamics learning" (IROS): an offset that
follows the gradient of the squared error reacts to any change at once, and a local regression of the error then
replaces it. The regression is a Gaussian process on a moving window of samples (Meier and Schaal 2016, "Drifting
Gaussian processes with varying neighborhood sizes for online model learning").
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve

from invdyn_cli.adaptation.own_fit import AbstractOwnFit
from invdyn_cli.errors import UsageError
from invdyn_cli.fields import counts, positive
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.maths.scaling import standardisation, standardised_state
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree


@dataclass(frozen=True)
class LocalErrorModel(AbstractOwnFit):
    """tau = model + k(x, window) coefficients + offset; the model stays as it was fitted.

    k is a squared exponential over the standardised state. Far from the states of the window the regression is zero,
    and only model and offset remain.

    Attributes:
        window: [samples] number of samples that the regression holds; the cost of an update grows with the third power.
        interval: [samples] every so many samples, the newest one enters the window, and the oldest one leaves it.
        width: [-] width of the kernel in units of the training data's spread times the root of the number of inputs.
        noise: [-] standard deviation of the noise as a share of that of the error to be learned.
        offset_rate: [-] share of the error that a sample corrects in the offset; 0 for no offset.
    """

    window: int = 50
    interval: int = 10
    width: float = 0.5
    noise: float = 0.1
    offset_rate: float = 0.02

    if_diverged = "a lower adaptation.offset_rate may help"

    def __post_init__(self) -> None:
        counts(self, "adaptation", "window", "interval")
        positive(self, "adaptation", "width", "noise")
        if not 0 <= self.offset_rate <= 1:
            raise UsageError(f"adaptation.offset_rate={self.offset_rate}; allowed: a number from 0 to 1")

    def details(self, model: AbstractModel, fit: Fit, dataset: Dataset) -> dict[str, Any]:
        """local_mean and local_scale (3 n,), of the training data's states."""
        scales = standardisation(dataset.motion, dataset.tau)
        return {"local_mean": scales["input_mean"], "local_scale": scales["input_scale"]}

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """Parameters, robot, standardisation, an empty window, its coefficients, the offset, the number of samples so
        far."""
        n = len(fit.joints)
        scale = jnp.asarray(fit.details["local_scale"]) * self.width * jnp.sqrt(3 * n)
        return {
            **super().init(model, fit),
            "input_mean": jnp.asarray(fit.details["local_mean"]),
            "input_scale": scale,
            "inputs": jnp.zeros((self.window, 3 * n)),
            "errors": jnp.zeros((self.window, n)),
            "coefficients": jnp.zeros((self.window, n)),
            "offset": jnp.zeros(n),
            "samples": jnp.array(0),
        }

    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of one sample."""
        local = _local(state, standardised_state(state, motion))
        return super().predict(model, state, motion) + local + state["offset"]

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """Update the offset; every `interval`-th sample also enters the window."""
        x = standardised_state(state, motion)
        error = tau - super().predict(model, state, motion)
        offset = state["offset"] + self.offset_rate * (error - _local(state, x) - state["offset"])
        enters = state["samples"] % self.interval == 0
        learned = jax.lax.cond(enters, lambda: self._entered(state, x, error), lambda: _window(state))
        return {**state, **learned, "offset": offset, "samples": state["samples"] + 1}

    def trace(self, state: PyTree) -> dict[str, Array]:
        """offset: RMS over the joints [N m]."""
        return {"offset": jnp.sqrt(jnp.mean(state["offset"] ** 2))}

    def _entered(self, state: PyTree, x: Array, error: Array) -> PyTree:
        """The window in which a sample replaces the oldest one, and its coefficients."""
        number = state["samples"] // self.interval
        inputs = state["inputs"].at[number % self.window].set(x)
        errors = state["errors"].at[number % self.window].set(error)
        filled = jnp.arange(self.window) <= number
        k = _kernel(inputs, inputs) * (filled[:, None] & filled) + jnp.diag(jnp.where(filled, self.noise**2, 1.0))
        return {
            "inputs": inputs,
            "errors": errors,
            "coefficients": cho_solve((jnp.linalg.cholesky(k), True), errors * filled[:, None]),
        }


def _window(state: PyTree) -> PyTree:
    return {name: state[name] for name in ("inputs", "errors", "coefficients")}


def _local(state: PyTree, x: Array) -> Array:
    """The regression's torque (n,) at an input (3 n,)."""
    return _kernel(x[None], state["inputs"])[0] @ state["coefficients"]


def _kernel(a: Array, b: Array) -> Array:
    """exp(-|a - b|² / 2) of inputs (N, d) and (M, d)."""
    return jnp.exp(-0.5 * jnp.sum((a[:, None] - b[None]) ** 2, -1))
