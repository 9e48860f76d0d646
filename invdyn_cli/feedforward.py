"""What a model says before the feedback corrects it: as it was learned, or adapted to what has been measured by then.

Adapting in a loop sees no future: measured angles and applied torques come through one and the same low-pass, one way,
and derivatives are backward differences of the filtered angles, as `data.causal=true` has them on a whole log. All of
it lags alike, and the pair of motion and torque that is learned from is a true one, if a late one.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy import signal

from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.maths.signals import butterworth
from invdyn_cli.types import Array, Fit, Motion, PyTree


class Adapting:
    """A fitted model and its adapter, sample by sample; one compiled call for filter, learning and prediction.

    Args:
        adapter, model, fit: as `adapter.fit` gave them.
        rate: [Hz] of the samples.
        cutoff: [Hz] of the low-pass; None: none.
        order: of that Butterworth filter.
    """

    def __init__(
        self, adapter: AbstractAdapter, model: AbstractModel, fit: Fit, rate: float, cutoff: float | None, order: int
    ) -> None:
        self._adapter, self._model, self._fit, self._rate = adapter, model, fit, rate
        self._sections = np.empty((0, 6)) if cutoff is None else butterworth(rate, cutoff, order)
        self.step = jax.jit(self._step)

    def init(self, q: np.ndarray, tau: np.ndarray) -> PyTree:
        """The state of an arm that has always been at rest at q (n,) under tau (n,)."""
        rest = jnp.zeros(len(q))
        return {
            "adapter": self._adapter.init(self._model, self._fit),
            "filter": resting(self._sections, jnp.concatenate([q, tau])),
            "last": (jnp.asarray(q, float), rest),
        }

    def _step(self, state: PyTree, q: Array, tau: Array, desired: Motion) -> tuple[PyTree, Array]:
        """One sample (n,) each is learned from; then the torque (n,) of a desired motion (n,)."""
        memory, smooth = filtered(self._sections, state["filter"], jnp.concatenate([q, tau]))
        smooth_q, smooth_tau = jnp.split(smooth, 2)
        last_q, last_qd = state["last"]
        qd = (smooth_q - last_q) * self._rate
        motion = Motion(smooth_q, qd, (qd - last_qd) * self._rate)
        adapted = self._adapter.update(self._model, state["adapter"], motion, smooth_tau)
        said = self._adapter.predict(self._model, adapted, desired)
        return {"adapter": adapted, "filter": memory, "last": (smooth_q, qd)}, said


def resting(sections: np.ndarray, x: Array) -> Array:
    """(S, 2, n) memory of second-order sections (S, 6) to which x (n,) has always come."""
    return jnp.asarray(signal.sosfilt_zi(sections) if len(sections) else np.empty((0, 2)))[..., None] * x


@jax.jit
def filtered(sections: Array, memory: Array, x: Array) -> tuple[Array, Array]:
    """Memory (S, 2, n) and output (n,) after one more sample x (n,): direct form II, transposed."""
    after = []
    for (b0, b1, b2, _, a1, a2), (first, second) in zip(sections, memory, strict=True):
        y = b0 * x + first
        after.append(jnp.stack([b1 * x - a1 * y + second, b2 * x - a2 * y]))
        x = y
    return (jnp.stack(after) if after else memory), x
