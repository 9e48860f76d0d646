"""A prepared log: uninterrupted pieces on one clock, with derivatives, and the filter that all columns share.

Pieces are cut by their role (training, held-out, reference) before anything is filtered, so that no data pass from one
role to another.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from invdyn_cli.effects.composition import Span
from invdyn_cli.errors import LogError
from invdyn_cli.log import Log, RawTrajectory, Window
from invdyn_cli.maths.signals import lattice, lowpass, resample
from invdyn_cli.recording import noise
from invdyn_cli.recording.filter import Filter, needed
from invdyn_cli.recording.rows import without_gaps
from invdyn_cli.recording.selection import divided
from invdyn_cli.recording.thinning import thinned
from invdyn_cli.types import Motion

ROLES = ("train", "test", "reference")

LONGER = 1.05
"""A part of a trajectory is longer than the filters need by this factor: it has some samples fewer than its time."""


@dataclass(frozen=True)
class Preparation:
    """How a log is made ready.

    Attributes:
        rate: [Hz] working sampling rate; slower logs keep their own. Columns are computed at this rate and only then
            filtered, so that a reversal is placed within 2 ms.
        cutoffs: [Hz] candidates for the cut-off of a joint's low-pass filter; the highest one is chosen at which the
            noise of the twice differentiated positions is small compared with that of the torque. `SMALL` and
            `NEGLIGIBLE` (`noise.py`) say how small.
        smoothing: [-] bandwidth of a joint's positions, speeds and accelerations, as a multiple of that cut-off.
        sharpness: [Hz] smallest bandwidth of the motion signals: friction near a reversal takes 20 ms. A joint whose
            speed the noise of its positions would hide (`noise.CLEAR`) has less, `smoothing` times its cut-off or more.
        max_gap: [s] a longer step splits a trajectory.
        train_share: [-] first share of each trajectory's time for training; the rest is held out. A trajectory in
            which this leaves a joint without motion to learn from is first divided into parts (`selection.divided`).
        longest: [s] length of log that is used; of a longer log, evenly spread stretches.
        stretch: [s] length of such a stretch, about; less where joints move one after the other (`thinning`).
        shortest: [s] length of the shortest part into which a trajectory is divided; longer where the filters need it.
    """

    rate: float = 250.0
    cutoffs: tuple[float, ...] = (40.0, 30.0, 22.0, 16.0, 12.0, 9.0, 7.0, 5.5, 4.0, 3.0)
    smoothing: float = 4.0
    sharpness: float = 60.0
    max_gap: float = 0.1
    train_share: float = 0.7
    longest: float = 270.0
    stretch: float = 20.0
    shortest: float = 6.0


REAL, PLAIN, HIGHEST, SPECTRUM = 100.0, 10.0, 55.0, 2.0
"""A motion that the noise of positions does not make is REAL times as dense, and PLAIN times as dense as just below
HIGHEST [Hz], since an encoder that is quiet at rest may have more noise in motion; and the length [s] of the stretches
whose spectra are averaged. A controller's answer to that noise moves a joint about as much as the noise."""

ENDS = 2
"""Samples that are cut off each end of a stretch, beside a period of the low-pass of its positions: accelerations there
are those of the spline's and the filter's ends. What has a state, as a link on a spring, would start with a blow."""


@dataclass(frozen=True)
class Piece:
    """An uninterrupted stretch on the working clock: t (T,) [s] from the start of its trajectory, the others (n, T)
    [rad, N m; m, N]; `motion_noise` (n,) is the standard deviation of the speed [rad/s; m/s] that the noise of the
    positions causes."""

    trajectory: str
    role: str
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    motion_noise: np.ndarray

    @property
    def motion(self) -> Motion:
        """q, qd and qdd, (n, T) each."""
        return Motion(self.q, self.qd, self.qdd)


@dataclass(frozen=True)
class Recording:
    """All pieces of a log, their common filter, and what was learned on the way.

    Attributes:
        period: [s] between samples of the log, before anything was resampled.
        position_noise, torque_noise: (n,) standard deviation of white noise at the log's own rate [rad], [N m].
        transition: (n,) [rad/s; m/s] how gradually each joint's friction changes its side, if at all; 0: it jumps.
    """

    joints: tuple[str, ...]
    pieces: tuple[Piece, ...]
    filter: Filter
    period: float
    position_noise: np.ndarray
    torque_noise: np.ndarray
    transition: tuple[float, ...]
    notes: tuple[str, ...] = ()
    details: Mapping[str, object] = field(default_factory=dict)

    @cached_property
    def real(self) -> np.ndarray:
        """(n,) [Hz] up to which each joint's motion is REAL: much denser than the noise of its positions; 0 where its
        pieces are too short to tell. Second differences of both are compared: they leak less."""
        rate = self.filter.rate
        length = round(SPECTRUM * rate)
        parts = [np.diff(p.q, 2, axis=1) for p in self.pieces if len(p.t) > length + 2]
        if not parts:
            return np.zeros(len(self.joints))
        f = np.fft.rfftfreq(length, 1 / rate)
        spectra = [scipy.signal.welch(x, rate, nperseg=length, axis=1)[1] for x in parts]
        motion = np.average(spectra, axis=0, weights=[x.shape[1] for x in parts])
        noise = 2 * self.period * np.outer(self.position_noise**2, (2 * np.sin(np.pi * f / rate)) ** 4)
        times = motion[:, 1:] / np.maximum(noise[:, 1:], 1e-300)
        low, high = np.searchsorted(f[1:], np.multiply((0.75, 1.0), min(HIGHEST, 0.45 * rate)))
        floor = np.median(times[:, low : max(low + 1, high)], axis=1)
        real = times > np.maximum(REAL, PLAIN * floor)[:, None]
        return f[np.where(real.all(1), -1, np.argmin(real, axis=1))]

    @cached_property
    def ends(self) -> dict[str, tuple[float, float]]:
        """First and last time [s] of every trajectory."""
        times: dict[str, list[float]] = {}
        for p in self.pieces:
            times.setdefault(p.trajectory, []).extend(map(float, p.t[[0, -1]]))
        return {name: (min(own), max(own)) for name, own in times.items()}

    def stretch(self, piece: Piece) -> Span:
        """Where and when a piece was."""
        return Span(piece.trajectory, piece.t, self.filter.rate)


def prepare(
    log: Log,
    inertia: np.ndarray,
    windows: Mapping[str, Sequence[Window]] | None,
    options: Preparation,
    highest: Sequence[float] | None = None,
) -> Recording:
    """Cut, resample, smooth and differentiate.

    Args:
        log: torques in N m, no defects.
        inertia: (n,) typical inertia that each joint carries [kg m^2]: it turns noise of positions into torque.
        windows: role -> stretches; None: the first `train_share` of every trajectory is training data,
            the rest is held out.
        highest: (n,) [Hz] of each joint's cut-off; None: as `options` say.

    Raises:
        LogError: if no piece is long enough.
    """
    cut, period, notes = _cut(log, windows, options)
    positions, torques = [q for *_, q, _ in cut], [tau for *_, tau in cut]
    farthest = [max((raw.q[:, j] for raw in log.trajectories), key=np.ptp) for j in range(len(log.joints))]
    position_noise = np.maximum(  # a joint that rests shows less noise than a step of its encoder makes
        noise.of_positions(positions), np.array([lattice(q) for q in farthest]) / np.sqrt(12)
    )
    moving_noise = np.maximum(position_noise, noise.of_positions_in_motion(positions))
    torque_noise = noise.of_torques(positions, torques)
    step = max(1, round(1 / (period * options.rate)))
    rate = 1 / (period * step)
    strongest = np.sqrt(np.mean(np.concatenate(torques, axis=1) ** 2, axis=1))
    cutoffs = [
        noise.cutoff(*numbers, period, rate, options.cutoffs)
        for numbers in zip(moving_noise, torque_noise, strongest, inertia, strict=True)
    ]
    widest = tuple(cutoffs)
    if highest is not None:
        cutoffs = np.minimum(cutoffs, highest).tolist()
    common = Filter(rate, tuple(cutoffs), max(1, int(rate / (2.5 * max(cutoffs)))), widest)
    least = options.smoothing * np.array(cutoffs)
    smooth = noise.bandwidths(positions, position_noise, period, least, options.sharpness)
    fewest = needed(rate, min(cutoffs))
    length = fewest / rate
    pieces = [_piece(x, position_noise, period, step, smooth) for x in cut if len(x[2]) // step > fewest]
    if windows is None and not any(piece.role == "test" for piece in pieces):
        if len(log.trajectories) > 1:
            return prepare(log, inertia, _by_trajectory(log, options), options, highest)
        shortest = LONGER * length / (1 - options.train_share)
        if options.shortest < shortest < max(np.ptp(raw.t) for raw in log.trajectories):
            return prepare(log, inertia, None, replace(options, shortest=shortest), highest)
    if not any(piece.role == "train" for piece in pieces):
        raise LogError(f"no uninterrupted stretch of the log is long enough; {length:.2g} s are needed")
    if len(pieces) < len(cut):
        notes.append(f"{len(cut) - len(pieces)} stretches of the log are too short and were left out.")
    details = {
        "working_rate_Hz": rate,
        "filter_cutoff_Hz": dict(zip(log.joints, cutoffs, strict=True)),
        "filter_order": 4,
        "motion_cutoff_Hz": dict(zip(log.joints, smooth.tolist(), strict=True)),
    }
    jumps = (0.0,) * len(log.joints)
    noises = position_noise, torque_noise
    return Recording(log.joints, tuple(pieces), common, period, *noises, jumps, tuple(notes), details)


def _cut(
    log: Log, windows: Mapping[str, Sequence[Window]] | None, options: Preparation
) -> tuple[list[tuple], float, list[str]]:
    """Stretches without a gap (trajectory, role, t (T,) [s] from the trajectory's start, q and tau (n, T)) on a uniform
    clock, its period [s], and what is to be said of them."""
    notes: list[str] = []
    cut = [
        (raw.name, role, raw.t[rows] - raw.t[0], raw.q[rows].T, raw.tau[rows].T)
        for raw in log.trajectories
        for role, start, end in _roles(raw, windows, options)
        for rows in without_gaps(raw.t, np.flatnonzero((raw.t >= start) & (raw.t < end)), options.max_gap)
    ]
    periods = [np.median(np.diff(t)) for _, _, t, _, _ in cut if len(t) > 3]
    if not periods:
        raise LogError("no part of the log has four consecutive samples without a gap")
    period = float(np.median(periods))
    total = sum(t[-1] - t[0] for _, _, t, _, _ in cut)
    if total > options.longest:
        length, cut = thinned(cut, options.longest, options.train_share, options.stretch)
        notes.append(
            f"The log is {total:.0f} s long. Only stretches of some {length:g} s, spread evenly, are used: "
            f"{options.longest:g} s in total (diagnosis.conditioning.longest)."
        )
    cut = [(name, role, *_uniform(t, q, tau, period)) for name, role, t, q, tau in cut if len(t) > noise.FEWEST]
    if not cut:
        raise LogError(f"no stretch of the log has more than {noise.FEWEST} samples without a gap")
    return cut, period, notes


def _by_trajectory(log: Log, options: Preparation) -> dict[str, list[Window]]:
    """Windows for trajectories that are too short to be divided: a whole trajectory is training or held-out data."""
    names = [x.name for x in log.trajectories]
    first = min(max(1, round(options.train_share * len(names))), len(names) - 1)
    roles = {"train": names[:first], "test": names[first:]}
    return {role: [(name, -np.inf, np.inf) for name in own] for role, own in roles.items()}


def _roles(
    raw: RawTrajectory, windows: Mapping[str, Sequence[Window]] | None, options: Preparation
) -> list[tuple[str, float, float]]:
    """Roles and stretches of a trajectory [s], in the order of time."""
    if windows is None:
        return divided(raw, options.train_share, options.shortest)
    asked = [(role, a, b) for role in ROLES for name, a, b in windows.get(role, ()) if name == raw.name]
    return sorted(asked, key=lambda stretch: stretch[1])


def _uniform(t: np.ndarray, q: np.ndarray, tau: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t (T,), q and tau (n, T) resampled to a uniform clock with this period [s]; cubic for positions, because they are
    differentiated."""
    ticks, q = resample(t, np.asarray(q, float).T, 1 / period, degree=3, tolerance=1e-3)
    return ticks, q.T, resample(t, np.asarray(tau, float).T, 1 / period, tolerance=1e-3)[1].T


def _piece(
    cut: tuple[str, str, np.ndarray, np.ndarray, np.ndarray],
    position_noise: np.ndarray,
    period: float,
    step: int,
    smooth: np.ndarray,
) -> Piece:
    """A stretch (trajectory, role, t (T,), q (n, T), tau (n, T)) at every `step`-th sample, positions low-passed at
    `smooth` (n,) [Hz] and differentiated, the ends cut off."""
    name, role, t, q, tau = cut
    rate = 1 / period
    bandwidth = np.minimum(smooth, 0.35 * rate / step)
    q = np.array([lowpass(x, rate, f) if f < 0.35 * rate else x for x, f in zip(q, bandwidth, strict=True)])
    if step > 1:
        tau = lowpass(tau.T, rate, 0.35 * rate / step)[::step].T
        q, t, rate = q[:, ::step], t[::step], rate / step
    ticks = np.arange(len(t)) / rate
    spline = scipy.interpolate.make_interp_spline(ticks, q, k=5, axis=1)
    motion_noise = noise.of_speeds(position_noise, bandwidth, period)
    edge = ENDS + int(np.ceil(rate / bandwidth.min()))
    sure = slice(edge, len(t) - edge)
    q, qd, qdd = (x[:, sure] for x in (q, spline.derivative(1)(ticks), spline.derivative(2)(ticks)))
    return Piece(name, role, t[sure], q, qd, qdd, tau[:, sure], motion_noise)
