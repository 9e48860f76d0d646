"""The page that compares our results with the paper: Tables I and II, then one experiment after another."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.report.comparison import Grid
from invdyn_cli.report.html import document, folded, picture, row, section, table
from invdyn_cli.types import RunRecord

PAPER = (
    "Hitzler, Meier, Schaal, Asfour, Learning and Adaptation of Inverse Dynamics Models: A Comparison, Humanoids 2019"
)

NETS = {
    1: ((100,), 0.001),
    2: ((100, 100), 0.001),
    3: ((100,), 0.0007),
    4: ((100,), 0.005),
    5: ((100,), 0.001),
    6: ((100,), 0.001),
    7: ((100,), 0.001),
}
"""Table I: hidden layers and learning rate of every joint's net; batches of 32 and 100 epochs for all."""

BATCH, EPOCHS = 32, 100

INTERPOLATION = (0.1, 0.2, 0.3, 0.4, 0.7, 0.8), (0.5, 0.6)
EXTRAPOLATION = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), (0.7, 0.8)
SETS = {
    ("sim_clean", "interpolation"): ("simulated, without noise, interpolation", *INTERPOLATION),
    ("sim_clean", "extrapolation"): ("simulated, without noise, extrapolation", *EXTRAPOLATION),
    ("sim_noisy", "interpolation"): ("simulated, with noise, interpolation", *INTERPOLATION),
    ("sim_noisy", "extrapolation"): ("simulated, with noise, extrapolation", *EXTRAPOLATION),
}
"""Table II by (data, split): the sets' name, and the tasks [Hz] that are learned and tested."""

SAMPLES = 4500
"""Samples of a task, in the paper."""

CAPTION = (
    "Bars: mean NMSE over joints, the median of several seeds; low is good. Boxes: the range that a statement below "
    "allows; the paper's words are translated into powers of ten."
)

STYLE = """
td { white-space: normal; vertical-align: top; } .verdicts td { min-width: 7rem; }
.verdicts td, .verdicts th, .plain td, .plain th { text-align: left; }
.holds { color: #00795a; font-weight: 600; } .partly { color: #a86f00; font-weight: 600; }
.differs { color: var(--worst); font-weight: 600; } code { font-size: .9em; }
@media (prefers-color-scheme: dark) { .holds { color: #35c79a; } .partly { color: #f0b440; } }
"""


@dataclass(frozen=True)
class Exhibit:
    """An experiment on the page: its title, source and command, its PNGs with a caption each, its table and verdicts;
    `absent` says in its place why it was left out."""

    title: str
    source: str
    command: str
    figures: Sequence[tuple[Path, str]] = ()
    table: Grid | None = None
    verdicts: Grid | None = None
    absent: str = ""


def page(exhibits: Sequence[Exhibit], nets: Grid | None, sets: Grid | None) -> str:
    """The page as HTML text."""
    lead = summary([x.verdicts for x in exhibits if x.verdicts])
    tables = [
        ("Table I: the nets of every joint", _table(nets, "plain") if nets else ""),
        ("Table II: what is learned and what is tested", _table(sets, "plain") if sets else ""),
    ]
    return document(
        "The paper, and what was found",
        f'<p class="sub">{escape(PAPER)}</p>\n<p class="lead">{escape(lead)}</p>\n'
        + "".join(section(title, content) for title, content in tables)
        + "".join(section(x.title, _exhibit(x)) for x in exhibits),
        STYLE,
    )


def summary(verdicts: Iterable[Grid]) -> str:
    """How many of all statements hold, hold in part, differ."""
    kinds = [kind_of(row[-1]) for grid in verdicts for row in grid.rows]
    parts = [f"{kinds.count(kind)} {said}" for kind, said in SAID.items() if kind in kinds]
    judged = (
        "Each is judged for every seed and every interpretation of what the paper leaves open. Only orders of "
        "magnitude count."
    )
    return f"Of {len(kinds)} statements (of the paper, or marked as ours), {', '.join(parts)}. {judged}"


SAID = {"holds": "hold", "partly": "hold in part", "differs": "do not hold", "not": "were not run"}


def kind_of(verdict: str) -> str:
    """holds, partly, differs, or not (run)."""
    return "partly" if verdict.startswith("holds for") else verdict.partition(":")[0].split()[0]


def table_one(model: Ffnn) -> Grid:
    """Table I beside the nets of this model."""
    groups = model.groups(len(NETS))
    own = {
        column + 1: (group.hidden, rate)
        for group in groups
        for column, rate in zip(group.columns, group.learning_rates, strict=True)
    }
    rows = []
    for joint, (hidden, rate) in NETS.items():
        paper, ours = _net(hidden, rate, BATCH, EPOCHS), _net(*own[joint], model.batch_size, model.epochs)
        rows.append((str(joint), paper, ours, "the same" if paper == ours else "differs"))
    return Grid(("joint", "the paper: structure; rate; batch; epochs", "here", ""), tuple(rows))


def table_two(runs: Mapping[tuple[str, str], RunRecord]) -> Grid:
    """Table II beside the sets of these runs, by (data, split)."""
    rows = []
    for key, (name, learned, tested) in SETS.items():
        if key not in runs:
            continue
        run = runs[key]
        paper, ours = _tasks(learned, tested), _tasks(run.split["train_Hz"], run.split["test_Hz"])
        samples = ", ".join(f"{run.samples.get(x, 0):,}" for x in ("train", "validation", "test"))
        said = f"{SAMPLES * len(learned):,}, {SAMPLES * len(tested):,}"
        rows.append((name, *paper, said, samples, "the same tasks" if paper == ours else f"differs: {'; '.join(ours)}"))
    heads = ("data", "learned [Hz]", "tested [Hz]", "samples in the paper", "here: training, validation, test", "")
    return Grid(heads, tuple(rows))


def _net(hidden: Sequence[int], rate: float, batch: int, epochs: int) -> str:
    return f"{', '.join(map(str, ('3n', *hidden, 1)))}; {rate:g}; {batch}; {epochs}"


def _tasks(*sets: Sequence[float]) -> tuple[str, ...]:
    return tuple(", ".join(f"{x:g}" for x in tasks) for tasks in sets)


def _exhibit(x: Exhibit) -> str:
    under = f'<p class="sub">{escape(x.source)}. <code>{escape(x.command)}</code></p>'
    if x.absent:
        return f'{under}<p class="warning">Left out: {escape(x.absent)}</p>'
    drawn = "".join(picture(path, caption, x.title) for path, caption in x.figures)
    said = _table(x.verdicts, "verdicts") if x.verdicts else ""
    return (
        under
        + drawn
        + said
        + (folded("all numbers", _table(x.table, "scores"), shown=not x.figures) if x.table else "")
    )


def _table(grid: Grid, kind: str) -> str:
    body = ""
    for *texts, last in grid.rows:
        verdict, _, why = last.partition("; ")
        judged = f'<span class="{kind_of(verdict)}">{escape(verdict)}</span><small>{escape(why)}</small>'
        body += row(*map(escape, texts), judged if kind == "verdicts" else escape(last))
    return table(grid.heads, body, kind)
