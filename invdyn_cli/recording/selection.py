"""Which stretches of which trajectories are training, validation and test data: selections as text -> blocks in time;
and how a diagnosis divides a trajectory of which nothing was selected.

A selection is "name" or "name[t0:t1]": t0 <= t < t1 in seconds of the log's clock; ends may stay open.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from invdyn_cli.errors import LogError, UsageError, closest, listed
from invdyn_cli.log import Log, RawTrajectory, Window
from invdyn_cli.recording.rows import taken

SETS = ("train", "validation", "test")

LEARNED, JUDGED, STILL, STEP = 0.4, 0.1, 0.01, 0.25
"""Shares of a joint's distance that should be in the training and in the held-out data; share of the largest distance
of all joints, below which a joint rests; and the time [s] between the positions from which distances are computed:
noise adds little to them."""

_SECONDS = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)?\s*"
_WINDOWED = re.compile(rf"\s*([^\[\]]+?)\s*\[{_SECONDS}:{_SECONDS}\]\s*")


@dataclass(frozen=True)
class Block:
    """A stretch start <= t < end [s] of the trajectory `key`; what the user `asked` for is never left out quietly."""

    key: str
    start: float = -np.inf
    end: float = np.inf
    asked: bool = True

    def __str__(self) -> str:
        start, end = ("" if np.isinf(x) else f"{round(x, 3):.10g}" for x in (self.start, self.end))
        return f"{self.key}[{start}:{end}]" if start or end else self.key

    def rows(self, t: np.ndarray) -> np.ndarray:
        """Which samples of the clock t (T,) [s] it covers, (T,) bool."""
        return (t >= self.start) & (t < self.end)


def _parsed(option: str, text: str, keys: Sequence[str]) -> Block:
    """The block for the selection `text` of `data.<option>`, among trajectories called `keys`.

    Keys are "name", or "log/name" where there are several logs; then "name" alone will do if only one log has it.

    Raises:
        UsageError: if it is not written as a selection.
        LogError: if no trajectory, or more than one, has that name.
    """
    windowed = None if text in keys else _WINDOWED.fullmatch(text)
    if windowed is None and text not in keys and set("[]") & set(text):
        got = f"data.{option}: {text!r} is not a selection"
        raise UsageError(f"{got}; allowed: name, name[t0:t1], name[t0:], name[:t1], in seconds")
    name, first, last = windowed.groups() if windowed else (text.strip(), None, None)
    start, end = float(first or -np.inf), float(last or np.inf)
    if start >= end:
        got = f"data.{option}: the window of {text!r} is empty"
        raise UsageError(f"{got}; allowed: name[t0:t1] with t0 < t1, in seconds")
    meant = [key for key in keys if key == name] or [key for key in keys if key.rpartition("/")[2] == name]
    if not meant:
        raise LogError(f"data.{option}: no trajectory {name!r}{closest(name, keys)}; there are {listed(keys)}")
    if len(meant) > 1:
        raise LogError(f"data.{option}: {name!r} is in several logs; allowed: {listed(meant)}")
    return Block(meant[0], start, end)


def asked(options: Mapping[str, Iterable[object] | None], keys: Iterable[str]) -> dict[str, list[Block] | None]:
    """The blocks for the selections of each option among trajectories called `keys`; None for an option that is not
    set.

    Raises:
        LogError, UsageError: as `_parsed`, and for blocks that overlap.
    """
    keys = list(keys)
    blocks = {k: None if v is None else [_parsed(k, str(text), keys) for text in v] for k, v in options.items()}
    _refuse_overlap(blocks)
    return blocks


def _refuse_overlap(sets: Mapping[str, Iterable[Block] | None]) -> None:
    """Raise a UsageError if a stretch is selected twice: test data must not have been learned from."""
    for (one, a), (two, b) in combinations(
        [(name, block) for name, blocks in sets.items() for block in blocks or ()], 2
    ):
        start, end = max(a.start, b.start), min(a.end, b.end)
        if a.key == b.key and start < end:
            raise UsageError(
                f"data.{one} {str(a)!r} and data.{two} {str(b)!r} overlap in {str(Block(a.key, start, end))!r}",
                advice="windows that end where the next begins, name[:t] and name[t:]",
            )


def complete(
    asked: Mapping[str, Sequence[Block] | None],
    clocks: Mapping[str, np.ndarray],
    train_share: float,
    validation_share: float,
) -> dict[str, list[Block]]:
    """The blocks of all SETS: the selected ones, and for sets without a selection (None) the trajectories that no
    selection names.

    With neither train nor test, each of these gives its first `train_share` in time to learn from and the rest to test
    on; with one of the two, the other takes them whole. Validation is the last `validation_share` in time of each block
    to learn from. `clocks` holds the t (T,) [s] of all trajectories that may be used.
    """
    train, validation, test = (list(asked[name] or ()) for name in SETS)
    named = {block.key for block in (*train, *validation, *test)}
    for key, t in clocks.items():
        cut = t[0] + train_share * (t[-1] - t[0])
        if key not in named and asked["train"] is None:
            train.append(Block(key, end=np.inf if asked["test"] is not None else cut, asked=False))
        if key not in named and asked["test"] is None:
            test.append(Block(key, start=-np.inf if asked["train"] is not None else cut, asked=False))
    if asked["validation"] is None:
        for i, block in enumerate(train):
            first, last = max(block.start, clocks[block.key][0]), min(block.end, clocks[block.key][-1])
            cut = last - validation_share * (last - first)
            if first < cut < last:
                train[i] = replace(block, end=cut)
                validation.append(replace(block, start=cut, asked=False))
    return {"train": train, "validation": validation, "test": test}


def windows(
    blocks: Mapping[str, Sequence[Block] | None], log: Log, train_share: float
) -> dict[str, list[Window]] | None:
    """role -> stretches that choose and that judge a diagnosis: validation joins what chooses, and trajectories that
    nobody named do what was not asked for. None where nothing was asked for: then shares of time decide.

    Raises:
        LogError: for a selection without samples, or a role without any.
    """
    given = {name: blocks[name] for name in SETS}
    if all(some is None for some in given.values()):
        return None
    clocks = {x.name: _clock(x.t) for x in log.trajectories}
    made = complete(given | {"validation": given["validation"] or []}, clocks, train_share, 0.0)
    roles = {"train": [*made["train"], *made["validation"]], "test": made["test"]}
    for block in (x for parts in roles.values() for x in parts if x.asked):
        if not block.rows(t := clocks[block.key]).any():
            raise without_samples(block, t)
    for role in roles:
        if not roles[role]:
            got = f"data.{role} is empty: other sets name all trajectories"
            raise LogError(got, advice=f"data.{role}=[…] of {listed(clocks)}")
    return {role: [(x.key, x.start, x.end) for x in parts] for role, parts in roles.items()}


def divided(raw: RawTrajectory, train_share: float, shortest: float) -> list[tuple[str, float, float]]:
    """(role, start, end) [s] of a trajectory of which nothing was selected, in the order of time: the first share for
    training, the rest held out. Where a joint would cover less than LEARNED of its distance in training, or less than
    JUDGED in what is held out, because joints move one after the other, this is done in each of the fewest equal parts
    for which it is enough, or most; none is shorter than `shortest` [s]."""
    length = raw.t[-1] - raw.t[0]
    t = np.arange(0, length, STEP)
    distance = np.abs(np.diff(raw.q[np.searchsorted(raw.t, raw.t[0] + t)], axis=0))
    total = distance.sum(axis=0)
    moves = total > STILL * total.max(initial=0.0)

    def enough(parts: int) -> float:
        """The least share, in units of what it should be, of a joint's distance in either."""
        training = t[1:] % (length / parts) < train_share * length / parts
        shares = [distance[x].sum(axis=0)[moves] / total[moves] for x in (training, ~training)]
        return float(np.min([np.min(x / y, initial=1.0) for x, y in zip(shares, (LEARNED, JUDGED), strict=True)]))

    tried = range(1, 1 + max(1, int(length / max(shortest, STEP))))
    parts = next((k for k in tried if enough(k) >= 1), None) or max(tried, key=enough)
    ends = np.linspace(raw.t[0], raw.t[-1], 1 + parts)
    cuts = ends[:-1] + train_share * np.diff(ends)
    ends[[0, -1]] = -np.inf, np.inf
    edges = zip(ends[:-1].tolist(), cuts.tolist(), ends[1:].tolist(), strict=True)
    return [part for start, cut, end in edges for part in (("train", start, cut), ("test", cut, end))]


def cut(log: Log, blocks: Iterable[Block]) -> Log:
    """The log with only these stretches; LogError for one without samples."""
    found, parts = {x.name: x for x in log.trajectories}, []
    for block in blocks:
        one = found[block.key]
        rows = np.flatnonzero(block.rows(np.ravel(one.t)))
        if not len(rows):
            raise without_samples(block, _clock(one.t))
        whole = np.isinf(block.start) and np.isinf(block.end)
        parts.append(one if whole else taken(one, rows, str(block)))
    return replace(log, trajectories=tuple(parts))


def _clock(t: np.ndarray) -> np.ndarray:
    """Readable values of t [s], at least one: the log was not checked yet."""
    t = np.ravel(t)
    t = t[np.isfinite(t)]
    return t if len(t) else np.zeros(1)


def without_samples(block: Block, t: np.ndarray) -> LogError:
    """The failure for a block in which a clock t (T,) [s] has no samples."""
    return LogError(f"no samples in {block}; {block.key!r} runs from {t[0]:g} s to {t[-1]:g} s")
