"""The arm of an MJCF file beside the measured motion: unconstrained under the logged torques for short windows, and
held by a weak spring for a whole stretch.

Unconstrained: every window begins with the measured positions and velocities, and the logged torques move the arm from
there. Nothing pulls it back, so that the error at the end shows the error of the model. Held: a spring and a damper,
the same for every model, pull each joint to the measured motion; with a correct model they exert no torque.
"""
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from invdyn_cli.errors import LogError, UsageError
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.maths.metrics import rms
from invdyn_cli.simulation.arm import mass_matrix, quiet
from invdyn_cli.simulation.driven import STEP, Driven, Segment

LENGTH = 0.2
"""[s] of a window: long enough for friction and masses to show, short enough for a start that is not quite known."""

MEMORY = 0.1
"""[s] of torque before the first window, because a late or lagging motor still delivers it."""

LONGEST = 20.0
"""[s] that the arm is held, in all."""

PICTURES = 4
"""Windows of which traces are kept."""

LOST = np.pi
"""[rad; m] Largest error that counts: when an arm is half a turn away, the exact error has no meaning."""

FREQUENCY, DAMPING = 3.0, 1.0
"""[Hz], [-] Frequency and damping ratio of the spring and damper that hold the arm, for the least inertia that a joint
of the nominal arm has."""

REACH = 0.2
"""[rad; m] Deflection of that spring under a joint's typical torque, at most: a spring for a wrist's inertia alone
would let a load fall."""

POSTURES = 64
"""Number of postures of the log in which that inertia is searched."""


@dataclass(frozen=True)
class Traces:
    """One joint of a few windows, for a picture: `name` of the trajectory, t and the three positions, (K,) each."""

    name: str
    joint: str
    t: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class Replay:
    """Deviation of the simulated arm from the measured motion, with the nominal and the better model; (n,) each.

    Attributes:
        joints: names.
        length: [s] of a window.
        windows: how many there were.
        before, after: RMS over all samples of all windows [rad; m].
        end_before, end_after: RMS at the windows' ends.
        held: [s] that the arm was held.
        held_before, held_after: RMS while it was held [rad; m].
        torque_before, torque_after: RMS of the torque that holding it took [N m; N].
        traces: of the joint that gains most.
        not_held: what the better model's file lacks, in sentences.
    """

    joints: tuple[str, ...]
    length: float
    windows: int
    before: np.ndarray
    after: np.ndarray
    end_before: np.ndarray
    end_after: np.ndarray
    held: float
    held_before: np.ndarray
    held_after: np.ndarray
    torque_before: np.ndarray
    torque_after: np.ndarray
    traces: tuple[Traces, ...] = ()
    not_held: tuple[str, ...] = ()

    @property
    def gain(self) -> float:
        """Share by which the mean error of the joints falls; negative where it grows."""
        before = float(self.before.mean())
        return 1 - float(self.after.mean()) / before if before > 0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """What diagnosis.json holds under "replay"."""

        def named(values: np.ndarray) -> dict[str, float]:
            return dict(zip(self.joints, map(float, values), strict=True))

        return {
            "windows": {
                "length_s": self.length,
                "count": self.windows,
                "before": named(self.before),
                "after": named(self.after),
                "end_before": named(self.end_before),
                "end_after": named(self.end_after),
                "gain": self.gain,
            },
            "closed_loop": {
                "seconds": self.held,
                "frequency_Hz": FREQUENCY,
                "damping_ratio": DAMPING,
                "before": named(self.held_before),
                "after": named(self.held_after),
                "torque_before": named(self.torque_before),
                "torque_after": named(self.torque_after),
            },
            "not_held": list(self.not_held),
        }


def replay(
    before: str,
    after: str,
    stretches: Sequence[Segment],
    joints: Sequence[str],
    *,
    length: float = LENGTH,
    most: int = 150,
    not_held: Sequence[str] = (),
    progress: Progress = silent,
) -> Replay:
    """Both models on the same stretches.

    Args:
        before, after: MJCF texts as `mjcf.written` gives them.
        stretches: of the log.
        joints: names of the columns.
        length: [s] of a window.
        most: windows, spread evenly over all stretches.
        not_held: handed on.

    Raises:
        LogError: if no stretch is long enough for a window.
    """
    total = sum(max(0.0, float(x.t[-1] - length - x.t[0] - MEMORY)) for x in stretches)
    if not total > 0:
        got = f"no stretch is longer than {length + MEMORY:g} s without a gap"
        raise LogError(f"{got}; a replay needs {length:g} s, and {MEMORY:g} s before, because motors may be delayed")
    every = max(total / most, length)
    texts = {"before": before, "after": after}
    found: dict[str, list[np.ndarray]] = {name: [] for name in texts}
    where: list[tuple[Segment, int]] = []
    for k, stretch in enumerate(stretches):
        starts = window_starts(stretch, length, every)
        where += [(stretch, int(row)) for row in starts]
        for name, text in texts.items():
            found[name] += list(free(text, stretch, starts, length))
        progress(0.7 * (k + 1) / len(stretches), "unconstrained replay")
    off = {name: np.concatenate([x[1:] for x in parts]) for name, parts in found.items()}
    ends = {name: np.array([x[-1] for x in parts]) for name, parts in found.items()}
    used = list(_shortened(stretches))
    gains = feedback(before, used)
    holds = {name: [held(text, x, *gains) for x in used] for name, text in texts.items()}
    moved = {name: np.concatenate([x[0] for x in parts]) for name, parts in holds.items()}
    pulled = {name: np.concatenate([x[1] for x in parts]) for name, parts in holds.items()}
    worst = int(np.argmax(rms(off["before"]) - rms(off["after"])))
    return Replay(
        joints=tuple(joints),
        length=length,
        windows=len(where),
        before=rms(off["before"]),
        after=rms(off["after"]),
        end_before=rms(ends["before"]),
        end_after=rms(ends["after"]),
        held=sum(float(x.t[-1] - x.t[0]) for x in used),
        held_before=rms(moved["before"]),
        held_after=rms(moved["after"]),
        torque_before=rms(pulled["before"]),
        torque_after=rms(pulled["after"]),
        traces=_traces(found, where, joints[worst], worst),
        not_held=tuple(not_held),
    )


def window_starts(stretch: Segment, length: float = LENGTH, every: float = LENGTH) -> np.ndarray:
    """First rows of windows of `length` [s], one `every` [s], after the memory of a motor."""
    first, last = round(MEMORY / stretch.period), len(stretch.t) - 1 - round(length / stretch.period)
    return np.arange(first, last + 1, max(1, round(every / stretch.period)))


def free(mjcf: str, stretch: Segment, starts: Sequence[int] | np.ndarray, length: float = LENGTH) -> np.ndarray:
    """Simulated less measured positions (windows, K + 1, n) [rad; m] of an arm left free under the logged torques.

    Args:
        mjcf: the arm, as `mjcf.written` gives it.
        stretch: what was measured.
        starts: first rows of the windows.
        length: [s] of a window, K samples.

    Raises:
        UsageError: if the file's motors are not as many as the log's joints, or a window reaches beyond the log.
    """
    samples = round(length / stretch.period)
    if len(starts) and not (min(starts) >= 0 and max(starts) + samples < len(stretch.t) and samples >= 1):
        got = f"a window of {length:g} s from row {max(starts)} of {stretch.name}"
        raise UsageError(f"{got}; allowed: within its {len(stretch.t)} rows")
    arm = Driven(mjcf, stretch)
    out = np.empty((len(starts), samples + 1, stretch.q.shape[1]))
    with quiet():
        for window, row in enumerate(starts):
            arm.start(row)
            out[window, 0] = arm.q() - stretch.q[row]
            for k in range(samples):
                arm.advance(row + k)
                out[window, k + 1] = arm.q() - stretch.q[row + k + 1]
    return _bounded(out)


def feedback(mjcf: str, stretches: Sequence[Segment]) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping (n,) [N m/rad, N m s/rad] of what holds an arm to the measured motion.

    FREQUENCY for the least inertia that each joint has in the log's postures, others being free, or stiffer where that
    would not hold the joint's typical torque within REACH.
    """
    model: Any = mujoco.MjModel.from_xml_string(mjcf)
    data: Any = mujoco.MjData(model)
    columns = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    q = np.concatenate([x.q for x in stretches])
    posture, inertia = model.qpos0.copy(), np.full(model.nu, np.inf)
    for row in q[np.linspace(0, len(q) - 1, POSTURES).astype(int)]:
        posture[columns] = row
        own = 1 / np.diag(np.linalg.inv(mass_matrix(model, data, posture)))[columns]
        inertia = np.minimum(inertia, own)
    torque = rms(np.concatenate([x.tau for x in stretches]))
    omega = np.maximum(2 * np.pi * FREQUENCY, np.sqrt(torque / REACH / inertia))
    omega = np.minimum(omega, 0.5 / STEP)  # beyond, a step is too long for it
    return omega**2 * inertia, 2 * DAMPING * omega * inertia


def held(mjcf: str, stretch: Segment, stiffness: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Simulated less measured positions (K, n) [rad; m] of an arm under the logged torques that is held to the measured
    motion, and the torques (K, n) [N m; N] that it takes: stiffness (q - q_arm) + damping (qd - qd_arm), (n,) each.

    They act on the joints themselves, as a hand would: not through the motors, which may be late or limited.
    """
    arm = Driven(mjcf, stretch)
    first = min(round(MEMORY / stretch.period), len(stretch.t) - 2)
    moved, pulled = np.empty((2, len(stretch.t) - 1 - first, stretch.q.shape[1]))
    with quiet():
        arm.hold(stiffness, damping)
        arm.start(first)
        for k in range(len(moved)):
            arm.advance(first + k)
            moved[k] = arm.q() - stretch.q[first + k + 1]
            pulled[k] = -stiffness * moved[k] - damping * (arm.qd() - stretch.qd[first + k + 1])
            if not np.isfinite(moved[k]).all():
                moved[k:], pulled[k:] = LOST, pulled[k - 1] if k else 0.0
                break
    return _bounded(moved), pulled


def _shortened(stretches: Sequence[Segment]) -> Iterator[Segment]:
    """The stretches, each cut to its share of LONGEST."""
    whole = [x for x in stretches if x.t[-1] - x.t[0] > 2 * MEMORY]
    share = min(1.0, LONGEST / sum(float(x.t[-1] - x.t[0]) for x in whole))
    for x in whole:
        rows = slice(0, max(round(2 * MEMORY / x.period), round(share * len(x.t))))
        yield replace(x, t=x.t[rows], q=x.q[rows], qd=x.qd[rows], tau=x.tau[rows])


def _traces(found, where, joint: str, column: int) -> tuple[Traces, ...]:
    """Windows spread evenly, with the positions of one joint."""
    chosen = np.unique(np.linspace(0, len(where) - 1, PICTURES + 2).round().astype(int)[1:-1])
    out = []
    for k in chosen:
        stretch, row = where[k]
        rows = slice(row, row + len(found["before"][k]))
        measured = stretch.q[rows, column]
        moved = [measured + found[name][k][:, column] for name in ("before", "after")]
        out.append(Traces(stretch.name, joint, stretch.t[rows], measured, *moved))
    return tuple(out)


def _bounded(x: np.ndarray) -> np.ndarray:
    return np.clip(np.nan_to_num(x, nan=LOST, posinf=LOST, neginf=-LOST), -LOST, LOST)
