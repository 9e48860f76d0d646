"""From logs to training and test data: they are first cut into blocks, and only then resampled, filtered and
differentiated.

Blocks come first so that a zero-phase filter, which uses future samples, carries no test data into the training data.
Positions, logged derivatives and torques pass through the same filter, so that none leads or lags another.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from invdyn_cli.errors import LogError, UsageError, listed
from invdyn_cli.interfaces import Progress
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.maths.signals import differentiate, lowpass, resample, settling
from invdyn_cli.recording import selection
from invdyn_cli.recording.channels import newton_metres
from invdyn_cli.recording.rows import without_gaps
from invdyn_cli.recording.selection import SETS, Block, complete, without_samples
from invdyn_cli.types import Dataset, Motion, Robot, Splits, Trajectory

DERIVATIVES = ("auto", "logged", "positions")
RATE_TOLERANCE = 0.2
"""Largest relative difference between the nominal rate and that of the median step; beyond it the step is used, because
a wrong nominal rate differs more."""


MOST_ORDER = 20
"""Largest order of a Butterworth low-pass: order 20 needs 5 times as long to settle as order 4."""


@dataclass(frozen=True)
class Conditioning:
    """How trajectories are split and made ready; sources have its fields among their own (`Conditioning.of`).

    `data.recorded.RealLog` describes them. With logged derivatives and without filter, lag and rate the clock is not
    used, and samples are unchanged. Where `causal`, nothing looks ahead, as in a control loop: the filter goes forth
    alone, all channels come late by as much, and derivatives are backward differences (`online.Online` does the same
    sample by sample).
    """

    train: Sequence[str] | None = None
    validation: Sequence[str] | None = None
    test: Sequence[str] | None = None
    train_share: float = 0.7
    validation_share: float = 0.1
    derivatives: str = "auto"
    filter_cutoff: float | None = 10.0
    filter_order: int = 4
    causal: bool = False
    torque_lag: int = 0
    decimate: int = 1
    rate: float | None = None
    max_gap: float = 0.1

    @classmethod
    def of(cls, source: Any, **instead: Any) -> "Conditioning":
        """The conditioning from the fields of a source; `instead` are fields that have another name there."""
        return cls(**{f.name: instead[f.name] if f.name in instead else getattr(source, f.name) for f in fields(cls)})

    def refuse_options(self) -> None:
        """Raise a UsageError for an option out of range."""
        optional = ("filter_cutoff", "rate")
        for name in ("train_share", "validation_share", "filter_order", "torque_lag", "decimate", "max_gap", *optional):
            value = getattr(self, name)
            if not isinstance(value, int | float) and not (value is None and name in optional):
                raise UsageError(f"data.{name}={value}; allowed: a number")
        for name, good, allowed in (
            ("derivatives", self.derivatives in DERIVATIVES, ", ".join(DERIVATIVES)),
            ("train_share", 0 < self.train_share < 1, "between 0 and 1"),
            ("validation_share", 0 <= self.validation_share < 1, "0 to below 1"),
            ("filter_order", _whole(self.filter_order, 1) and self.filter_order <= MOST_ORDER, f"1 to {MOST_ORDER}"),
            ("causal", isinstance(self.causal, bool), "true or false"),
            ("torque_lag", _whole(self.torque_lag, 0), "a whole number of samples, 0 or more"),
            ("decimate", _whole(self.decimate, 1), "a whole number of samples, 1 or more"),
            ("rate", self.rate is None or self.rate > 0, "null, or above 0 Hz"),
            ("max_gap", self.max_gap > 0, "above 0 s"),
        ):
            if not good:
                raise UsageError(f"data.{name}={getattr(self, name)}; allowed: {allowed}")

    def asked(self, keys: Iterable[str]) -> dict[str, list[Block] | None]:
        """The blocks that were selected for each set among trajectories called `keys`; None where nothing was
        selected."""
        return selection.asked({name: getattr(self, name) for name in SETS}, keys)

    def splits(
        self,
        asked: Mapping[str, list[Block] | None],
        records: Mapping[str, tuple[Log, RawTrajectory]],
        robot: Robot | None,
        *,
        keys: Iterable[str],
        notes: list[str],
        description: Mapping[str, Any],
        progress: Progress,
    ) -> Splits:
        """Cut and condition the trajectories that may be used, each with its log.

        `keys` are all names that can be selected, `notes` gets what was left out, `description` says where it is from.

        Raises:
            LogError, UsageError: one line that names the trajectory or the option.
        """
        clocks = {key: raw.t for key, (_, raw) in records.items()}
        blocks = complete(asked, clocks, self.train_share, self.validation_share)
        sets: dict[str, list[Trajectory]] = {name: [] for name in SETS}
        described: dict[str, list[dict[str, Any]]] = {name: [] for name in SETS}
        todo = [(name, block) for name in SETS for block in blocks[name]]
        for done, (name, block) in enumerate(todo, start=1):
            log, raw = records[block.key]
            trajectories, what = self._conditioned(block, log, raw, notes)
            if trajectories:
                sets[name] += trajectories
                described[name].append(what)
            progress(done / len(todo), str(block))
        for name in ("train", "test"):
            if not sets[name]:
                why = "; ".join(notes) or "no trajectory is left for it"
                raise LogError(f"data.{name} is empty: {why}", advice=f"data.{name}=[…] of {listed(keys)}")
        joints = next(iter(records.values()))[0].joints
        data = {name: Dataset(tuple(sets[name]), joints, robot) for name in SETS}
        options = ("derivatives", "filter_cutoff", "filter_order", "causal", "torque_lag", "decimate", "max_gap")
        return Splits(
            train=data["train"],
            validation=data["validation"] if sets["validation"] else None,
            tests={"test": data["test"]},
            description=dict(description) | {x: getattr(self, x) for x in options} | described | {"notes": notes},
        )

    def splits_of_log(self, log: Log, robot: Robot | None, **how: Any) -> Splits:
        """`splits` of all trajectories of one log; `how`: its notes, description and progress."""
        records = {raw.name: (log, raw) for raw in log.trajectories}
        return self.splits(self.asked(records), records, robot, keys=records, **how)

    def _rate(self, key: str, log: Log, t: np.ndarray) -> float:
        """Rate [Hz] of the uniform clock for a trajectory logged at t (T,) [s]."""
        steps = np.diff(t)
        steps = steps[steps <= self.max_gap]
        measured = 1 / float(np.median(steps)) if len(steps) else log.rate
        nominal = abs(log.rate / measured - 1) <= RATE_TOLERANCE
        rate = self.rate or (log.rate if nominal else measured)
        if rate < (1 - RATE_TOLERANCE) * measured:
            got = f"data.rate={rate:g}, but trajectory {key!r} is logged at {measured:.4g} Hz"
            raise UsageError(
                f"{got}; allowed: at least the logged rate",
                advice="data.decimate, which drops samples after the filter",
            )
        if self.filter_cutoff is not None and not 0 < self.filter_cutoff < rate / 2:
            got = f"data.filter_cutoff={self.filter_cutoff:g} Hz for trajectory {key!r} at {rate:.4g} Hz"
            raise UsageError(f"{got}; allowed: above 0 and below half the rate, or null")
        return rate

    def _conditioned(
        self, block: Block, log: Log, raw: RawTrajectory, notes: list[str]
    ) -> tuple[list[Trajectory], dict[str, Any]]:
        """The block's uninterrupted pieces ready for learning, and how they were made."""
        rows = np.flatnonzero(block.rows(raw.t))
        if block.asked and not len(rows):
            raise without_samples(block, raw.t)
        logged = [c for c in ("qd", "qdd") if getattr(raw, c) is not None and self.derivatives != "positions"]
        if self.derivatives == "logged" and len(logged) < 2:
            lacks = " and ".join(c for c in ("qd", "qdd") if c not in logged)
            got = f"data.derivatives=logged, but trajectory {block.key!r} lacks {lacks}"
            raise LogError(got, advice="data.derivatives=auto")
        timeless = len(logged) == 2 and self.filter_cutoff is None and self.rate is None and self.torque_lag == 0
        rate = self._rate(block.key, log, raw.t)
        settled = settling(rate, self.filter_cutoff, self.filter_order) if self.filter_cutoff is not None else 0
        inset = 0 if len(logged) == 2 else max(settled, 2)
        needed = max(2 * inset, settled) + 1 + self.torque_lag
        channels = {"q": raw.q, "tau": newton_metres(log, raw), **{c: getattr(raw, c) for c in logged}}
        columns = np.concatenate(list(channels.values()), axis=1)
        pieces = [rows] if timeless else without_gaps(raw.t, rows, self.max_gap)
        trajectories, longest = [], 0
        for piece in pieces:
            t, x = raw.t[piece], columns[piece]
            if len(piece) and not timeless:
                t, x = resample(t, x, rate)
            longest = max(longest, len(t))
            if len(t) >= needed:
                part = Block(block.key, float(raw.t[piece[0]]), float(raw.t[piece[-1]]))
                name = block.key if len(piece) == len(raw.t) else str(part)
                signals = dict(zip(channels, np.split(x, len(channels), axis=1), strict=True))
                stage = None if raw.stage is None else raw.stage[np.searchsorted(raw.t, t + 1e-9, side="right") - 1]
                trajectories.append(self._trajectory(name, t, signals, stage, rate, inset))
        if len(trajectories) < len(pieces):
            short = f"{block}: {len(pieces) - len(trajectories)} of {len(pieces)} uninterrupted pieces are too short: "
            short += f"{needed} samples at {rate:.4g} Hz are needed for filter, derivatives and lag"
            short += "" if trajectories else f"; the longest has {longest}"
            if block.asked and not trajectories:
                advice = "a longer window, a higher data.filter_cutoff (null: no filter), or a larger data.max_gap"
                raise LogError(short, advice=advice)
            notes.append(f"{short}; left out")
        return trajectories, {
            "trajectory": block.key,
            "window": [float(raw.t[rows[0]]), float(raw.t[rows[-1]])] if len(rows) else None,
            "rate": None if timeless else rate,
            "logged_samples": len(rows),
            "samples": sum(len(x.t) for x in trajectories),
            "pieces": [x.name for x in trajectories],
            "logged_derivatives": logged,
        }

    def _trajectory(
        self,
        name: str,
        t: np.ndarray,
        signals: dict[str, np.ndarray],
        stage: np.ndarray | None,
        rate: float,
        inset: int,
    ) -> Trajectory:
        """One piece (T, n) on its clock: filtered, differentiated, `inset` samples off each end (where nothing looks
        ahead, off its beginning), lagged, thinned."""
        if (cutoff := self.filter_cutoff) is not None:
            signals = {c: lowpass(x, rate, cutoff, self.filter_order, self.causal) for c, x in signals.items()}
        for channel, of in (("qd", "q"), ("qdd", "qd")):
            if channel not in signals:
                signals[channel] = differentiate(signals[of], rate, method="backward" if self.causal else "central")
        lag, last = self.torque_lag, len(t) - (0 if self.causal else inset)
        now, before = slice(inset + lag, last, self.decimate), slice(inset, last - lag, self.decimate)
        motion = Motion(*(signals[c][now] for c in ("q", "qd", "qdd")))
        return Trajectory(name, t[now], motion, signals["tau"][before], None if stage is None else stage[now])


def _whole(x: float, least: int) -> bool:
    return isinstance(x, int) and x >= least
