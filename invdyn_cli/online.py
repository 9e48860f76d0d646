"""A model that adapts inside a control loop, sample by sample; nothing uses future samples.

Each tick filters the measurement with the causal filter of `data.causal`, learns from it, and returns the torque of the
next desired motion, in one compiled call.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.maths.signals import at_rest, butterworth
from invdyn_cli.types import Array, Fit, Motion, PyTree


class Online(NamedTuple):
    """The two functions that a control loop calls.

    Attributes:
        init: (q, tau) -> state; the arm rests at q (n,) [rad; m] under the torque tau (n,) [N m; N].
        step: (state, q, tau, wanted) -> (state, feedforward): q as measured now, tau as applied since the last tick,
            wanted a `Motion` of (n,) arrays; the state that goes in is used up. The model predicts before it learns:
            compare `said` of the state with tau.
    """

    init: Callable[[Array, Array], PyTree]
    step: Callable[[PyTree, Array, Array, Motion], tuple[PyTree, Array]]


def online(
    adapter: AbstractAdapter,
    model: AbstractModel,
    fit: Fit,
    *,
    rate: float = 1000.0,
    cutoff: float | None = 10.0,
    order: int = 4,
) -> Online:
    """Make the functions of the loop for an adapter and the (extended) model that it fitted.

    The state has "adapter", the state of the adapter; "motion", the filtered state of the arm; and "said", the torque
    that was predicted for it before it was learned from.

    Args:
        rate: [Hz] of the loop.
        cutoff, order: of the Butterworth low-pass, as the data that were fitted had it; None: none.

    Raises:
        ValueError: if the cut-off is not between 0 and half the rate.
        UsageError: for a model that goes along a recording.
    """
    if model.has_memory:
        got = f"{type(model).__name__} needs the earlier samples of a recording"
        raise UsageError(f"{got}, but a control loop evaluates one sample at a time", advice="a model without memory")
    if cutoff is not None and not 0 < cutoff < rate / 2:
        raise ValueError(f"cutoff={cutoff} Hz; allowed: above 0 and below half the rate, {rate / 2:g} Hz")
    sections = np.empty((0, 6)) if cutoff is None else butterworth(rate, cutoff, order)
    rest = at_rest(rate, cutoff, order)[:, :, None] if cutoff is not None else np.empty((0, 2, 1))

    def init(q: Array, tau: Array) -> PyTree:
        q, tau = np.asarray(q, float), np.asarray(tau, float)
        state = {
            "filter": rest * np.concatenate([q, tau]),
            "motion": Motion(q, 0 * q, 0 * q),
            "said": 0 * tau,
            "adapter": adapter.init(model, fit),
        }
        return jax.tree.map(lambda x: jnp.array(x, copy=True), state)

    @jax.jit(donate_argnums=0)
    def step(state: PyTree, q: Array, tau: Array, wanted: Motion) -> tuple[PyTree, Array]:
        passed, memory = filtered(sections, state["filter"], jnp.concatenate([q, tau]))
        before, n = state["motion"], len(passed) // 2
        qd = (passed[:n] - before.q) * rate
        motion = Motion(passed[:n], qd, (qd - before.qd) * rate)
        said = adapter.predict(model, state["adapter"], motion)
        known = adapter.update(model, state["adapter"], motion, passed[n:])
        after = {"filter": memory, "motion": motion, "said": said, "adapter": known}
        return after, adapter.predict(model, known, wanted)

    return Online(init, step)


def filtered(sections: np.ndarray, memory: Array, x: Array) -> tuple[Array, Array]:
    """x (n,) one sample through second-order sections (S, 6), and the memory (S, 2, n) after it (direct form II
    transposed, as SciPy's `sosfilt`)."""
    after = []
    for (b0, b1, b2, _, a1, a2), (z1, z2) in zip(sections, memory, strict=True):
        y = b0 * x + z1
        after.append(jnp.stack([b1 * x - a1 * y + z2, b2 * x - a2 * y]))
        x = y
    return x, jnp.stack(after) if after else memory
