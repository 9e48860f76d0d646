"""The data that the checks of a log use: windows of it on a uniform clock, all filtered alike, positions
differentiated.

Logged derivatives are not used; windows (`thinning.windows`) are cut before they are filtered.
"""

from dataclasses import dataclass

import numpy as np

from invdyn_cli.log import Log
from invdyn_cli.maths.signals import differentiate, lowpass, resample, settling
from invdyn_cli.recording.channels import newton_metres
from invdyn_cli.recording.memory import once_for_a_log
from invdyn_cli.recording.rows import is_series, median_step, taken
from invdyn_cli.recording.thinning import windows

CUTOFF = 6.0
"""[Hz] Zero-phase low-pass filter: the motion of a position-controlled arm is below, encoder noise in qdd mostly
above."""


@dataclass(frozen=True)
class Stretch:
    """An uninterrupted window on a uniform clock, filtered, its unsettled ends cut off.

    `extra` holds qd, qdd and q_ref as logged, filtered alike; `tau` is (T, n) [N m; N].
    """

    trajectory: str
    rate: float
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    extra: dict[str, np.ndarray]


@once_for_a_log
def stretches(log: Log) -> tuple[Stretch, ...]:
    """The windows of all trajectories that are time series, and long enough for the filter."""
    series = {raw.name for raw in log.trajectories if is_series(raw)}
    made = []
    for raw, rows in windows(log.trajectories):
        rate = 1 / median_step(raw.t[rows]) if len(rows) > 1 else 0.0
        at = min(CUTOFF, rate / 5)
        inset = settling(rate, at) if at > 0 else 0
        if raw.name not in series or len(rows) < 3 * inset + 8:
            continue
        window = taken(raw, rows)
        extra = {c: x for c in ("qd", "qdd", "q_ref") if (x := getattr(window, c)) is not None and np.isfinite(x).all()}
        x = np.concatenate([window.q, newton_metres(log, window), *extra.values()], axis=1, dtype=float)
        _, x = resample(window.t, x, rate)
        if len(x) < 3 * inset + 8:
            continue
        q, tau, *others = np.split(lowpass(x, rate, at), 2 + len(extra), axis=1)
        qd = differentiate(q, rate)
        settled = slice(inset, len(x) - inset)
        qdd = differentiate(qd, rate)
        logged = {c: y[settled] for c, y in zip(extra, others, strict=True)}
        made.append(Stretch(raw.name, rate, q[settled], qd[settled], qdd[settled], tau[settled], logged))
    return tuple(made)
