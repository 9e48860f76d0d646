"""Every model on the same rows of every data set: error, time, size and learning curves (grand_comparison.md)."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np
import yaml
from matplotlib.figure import Figure

from experiments.grand_comparison_figures import curves, error_against_time
from invdyn_cli import experiment, leftovers
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.errors import InvdynError, UsageError
from invdyn_cli.interfaces import AbstractModel, AbstractSource
from invdyn_cli.maths.scaling import spread_rows
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Dataset, Fit
from invdyn_cli.verbs import options, run
from invdyn_cli.verbs.screen import Screen

SIMULATED: Mapping[str, Sequence[str]] = {name: [f"data={name}"] for name in ("sim_clean", "sim_noisy", "pick_place")}

REAL: Mapping[str, str] = {
    "panda": "Panda",
    "kuka_lwr4": "LWR 4+",
    "iiwa14": "iiwa 14",
    "ur10e": "UR10e",
    "sarcos": "SARCOS",
}
"""Name of the log -> the job of real_logs.yaml that says how it is split and filtered."""

PARTS = "model=hybrid model@model.base={} model@model.learner={}"
MODELS: Mapping[str, Sequence[str]] = {
    **{name: [f"model={name}"] for name in ("pest", "pest_coulomb", "pest_friction", "standard")},
    "dbm": ["model=dbm", "model.friction=coulomb_viscous", "model.offset=true", "model.rotor_inertia=true"],
    **{name: [f"model={name}"] for name in ("gip", "lip", "gpr", "rff", "svr", "local_gp", "lwpr")},
    **{name: [f"model={name}"] for name in ("ffnn", "ffnn_deep", "lagrangian_net", "gru")},
    "pest_coulomb + ffnn": ["model=hybrid"],
    "standard + gpr": PARTS.format("standard", "gpr").split(),
    "standard + gpr sparse": [*PARTS.format("standard", "gpr").split(), "model.learner.hyperparameter_samples=100"],
    "pest_friction + gpr": PARTS.format("pest_friction", "gpr").split(),
    "lip + gpr": PARTS.format("lip", "gpr").split(),
    "extended": ["model=extended"],
}
NETS = ("ffnn", "ffnn_deep", "lagrangian_net", "gru", "pest_coulomb + ffnn")
"""Models whose fit depends on the seed enough for several to be asked."""

INNER, INNER_SHARE = 1000, 0.7
"""Number of rows at which a model is also judged inside its training rows: by it one model is chosen for all robots;
and the share of every training motion that it then learns from."""


@dataclass(frozen=True)
class Measured:
    """A fit, judged on the rows held out.

    Attributes:
        samples: rows that it learned from.
        nmse, rmse: mean over joints [-], [N m], and `joints` the NMSE of each; None where it gave no torques.
        fit_s: [s] to learn, compilation included.
        predict_us: [us] per sample of a whole test set, once compiled.
        memory_mb: [MB] what has to be kept to predict.
        inner: NMSE on the last 30 % of every training motion after learning from the first 70 %, at 1,000 rows.
        reason: why there is no number.
    """

    data: str
    model: str
    samples: int
    seed: int = 0
    nmse: float | None = None
    rmse: float | None = None
    joints: tuple[float, ...] = ()
    fit_s: float = 0.0
    predict_us: float = 0.0
    memory_mb: float = 0.0
    parameters: int = 0
    inner: float | None = None
    reason: str = ""


@dataclass(frozen=True)
class GrandComparison(AbstractExperiment):
    """A job per data set and model."""

    row: ClassVar[type] = Measured
    page: ClassVar[str] = "experiments/grand_comparison.md"

    only: Sequence[str] = ()
    models: Sequence[str] = ()
    samples: int = 4000
    sizes: Sequence[int] = (100, 300, 1000)
    seeds: int = 5
    data: str = "../shared/data"

    def plan(self, rows: Sequence[Measured]) -> Iterable[tuple]:
        """Data set after data set; a log that is not there is left out, which the table tells."""
        wanted = chosen("only", self.only, [*SIMULATED, *REAL])
        models = chosen("models", self.models, MODELS)
        for name, least in (("samples", 100), ("seeds", 1)):
            if getattr(self, name) < least:
                raise UsageError(f"{name}={getattr(self, name)}; allowed: {least} or more")
        there = [name for name in wanted if name in SIMULATED or self._log(name).is_file()]
        sizes = sorted(size for size in self.sizes if size < self.samples)
        return [
            (name, str(self.data) if name in REAL else "", model, self.samples, sizes, self.seeds)
            for name in there
            for model in models
        ]

    def run(
        self, folder: Path, name: str, data: str, model: str, samples: int, sizes: Sequence[int], seeds: int
    ) -> Iterable[Measured]:
        """The learning curve of a model, then all rows with several seeds; what fails is a row with its reason."""
        jax.config.update("jax_enable_x64", True)
        leftovers.clear()
        train, test = loaded(name, data, samples)
        try:
            made = composed(model)
        except (InvdynError, ImportError) as error:
            return [Measured(name, model, train.samples, reason=first_line(error))]
        rows = [measured(name, model, made, part(train, size), test) for size in sizes if size < train.samples]
        for seed in range(seeds if model in NETS else 1):
            rows.append(measured(name, model, made, train, test, seed))
        return rows

    def line(self, row: Measured) -> str:
        """Model, rows, error."""
        said = row.reason or f"NMSE {row.nmse:.3g}, {row.fit_s:.1f} s"
        return f"{row.data}, {row.model}, {row.samples} rows: {said}"

    def table(self, rows: Sequence[Measured]) -> str:
        """A table per data set, then which model is best where, as Markdown."""
        names = list(dict.fromkeys(row.data for row in rows))
        parts = [section(name, [row for row in rows if row.data == name]) for name in names]
        missing = [name for name in REAL if name not in names and not self._log(name).is_file()]
        parts += [f"Left out, as there is no {self._log(name).name} in data={self.data}: {name}." for name in missing]
        real = [name for name in REAL if name in names]
        if real:
            most = max(row.samples for row in rows if row.data in real)
            parts += [verdict(rows, real, size) for size in (INNER, None) if size is not None or most != INNER]
        return "\n\n".join(parts)

    def figures(self, rows: Sequence[Measured]) -> Mapping[str, Figure]:
        """Error against the time of a prediction and of the fit, with the Pareto front; learning curves."""
        good = [row for row in rows if row.nmse is not None]
        if not good:
            return {}
        return {
            "grand_comparison": error_against_time(whole(good), "predict_us"),
            "grand_comparison_fit": error_against_time(whole(good), "fit_s"),
            "grand_comparison_curves": curves([row for row in good if row.seed == 0]),
        }

    def _log(self, name: str) -> Path:
        return Path(self.data) / f"{name}.h5"


def composed(model: str) -> AbstractModel:
    """The model of the table.

    Raises:
        UsageError: if it cannot be made from a name alone.
    """
    if model == "extended":
        raise UsageError("it brings the fit of a diagnosis of its own log (experiments/transfer.md compares it)")
    return run.make_object(options.composed("run", MODELS[model]), "model", AbstractModel)


def split_of(name: str, data: str) -> Sequence[str]:
    """The options that say what the data are, and how they are split."""
    if name in SIMULATED:
        return SIMULATED[name]
    spec = yaml.safe_load(Path(__file__).with_name("real_logs.yaml").read_text(encoding="utf-8"))
    said = next(job["overrides"] for job in spec["jobs"] if job["name"] == REAL[name])
    return ["data=real_log", "robot=from_log", *(x.replace("${real_data}", data) for x in said)]


@cache
def loaded(name: str, data: str, samples: int) -> tuple[Dataset, Dataset]:
    """Rows to learn from, so many where there are as many, and rows that judge, thinned as much.

    Of pick_place an unloaded repetition judges that nobody learned from: its test set carries an object.
    """
    made = options.composed("run", split_of(name, data))
    source = run.make_object(made, "data", AbstractSource)
    splits = source.load(run.make_robot(made, source.header(), optional=True, console=Screen(quiet=True)))
    judge = splits.validation if name == "pick_place" else splits.tests["test"]
    assert judge is not None
    share = min(1.0, samples / splits.train.samples)
    return part(splits.train, samples), part(judge, round(share * judge.samples))


def part(data: Dataset, count: int) -> Dataset:
    """So many rows of the data, evenly spread."""
    rows, parts, start = spread_rows(data.samples, count), [], 0
    for one in data.trajectories:
        own = rows[(rows >= start) & (rows < start + len(one.t))] - start
        start += len(one.t)
        if len(own):
            parts.append(one[own])
    return replace(data, trajectories=tuple(parts))


def measured(name: str, label: str, model: AbstractModel, train: Dataset, test: Dataset, seed: int = 0) -> Measured:
    """Learn and judge once."""
    row = Measured(name, label, train.samples, seed)
    if model.needs_robot and train.robot is None:
        return replace(row, reason="needs a URDF, and this log has none")
    steps = [np.median(np.diff(x.trajectories[0].t)) for x in (train, test)]
    if model.has_memory and not np.isclose(*steps, rtol=0.2):
        return replace(row, reason="remembers samples, so that it needs the rate of the test")
    try:
        started = time.perf_counter()
        fit = model.fit(train, jax.random.key(seed))
        jax.block_until_ready(fit.params)
        took = time.perf_counter() - started
        experiment.predict(model, fit, test)  # compiles
        started = time.perf_counter()
        tau = experiment.predict(model, fit, test)
        asked = time.perf_counter() - started
        inner = inner_error(model, train) if train.samples == INNER else None
    except Exception as error:  # whatever a model cannot do is a row
        return replace(row, reason=first_line(error))
    score = experiment.score(test, tau)
    if not np.isfinite(tau).all():
        return replace(row, reason="its torques are not finite")
    return replace(
        row,
        nmse=score.mean("nmse"),
        rmse=score.mean("rmse"),
        joints=tuple(float(x) for x in np.nan_to_num(score.nmse, nan=-1.0)),
        fit_s=took,
        predict_us=1e6 * asked / test.samples,
        memory_mb=size_of(fit) / 1e6,
        parameters=fit.parameters,
        inner=inner,
    )


def inner_error(model: AbstractModel, train: Dataset) -> float | None:
    """NMSE on the last rows of every training motion, learned from its first ones; None where it is not finite."""

    cuts = [(x, int(INNER_SHARE * len(x.t))) for x in train.trajectories]
    first = replace(train, trajectories=tuple(x[:cut] for x, cut in cuts))
    last = replace(train, trajectories=tuple(x[cut:] for x, cut in cuts))
    fit = model.fit(first, jax.random.key(0))
    error = experiment.score(last, experiment.predict(model, fit, last)).mean("nmse")
    return error if math.isfinite(error) else None


def size_of(fit: Fit) -> int:
    """Bytes of the fitted parameters."""
    return sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(fit.params))


def first_line(error: BaseException) -> str:
    """What an error says, short."""
    said = str(error).strip().splitlines()
    return (said[0] if said else type(error).__name__).replace("|", "/")[:160]


def whole(rows: Sequence[Measured]) -> list[Measured]:
    """The rows with all samples, those of several seeds as their mean."""
    most = {name: max(row.samples for row in rows if row.data == name) for name in {row.data for row in rows}}
    groups: dict[tuple[str, str], list[Measured]] = {}
    for row in rows:
        if row.samples == most[row.data]:
            groups.setdefault((row.data, row.model), []).append(row)
    return [mean_of(group) for group in groups.values()]


def mean_of(rows: Sequence[Measured]) -> Measured:
    """The mean over seeds; a seed without a number is left out if another has one."""
    good = [row for row in rows if row.nmse is not None]
    if not good:
        return rows[0]
    means = {
        name: float(np.mean([getattr(row, name) for row in good])) for name in ("nmse", "rmse", "fit_s", "predict_us")
    }
    return replace(good[0], **means)


def section(name: str, rows: Sequence[Measured]) -> str:
    """The table of one data set, best model first, then those without a number."""
    full = {row.model: row for row in whole(rows)}
    most = max(row.samples for row in rows)
    sizes = sorted({row.samples for row in rows} - {most})
    spread = {
        model: [row.nmse for row in rows if row.model == model and row.samples == most and row.nmse is not None]
        for model in full
    }
    heads = ["model", f"NMSE, {most}", *(f"{size}" for size in sizes), "seeds", "RMSE [N m]", "fit [s]",
             "predict [us]", "memory [MB]", "parameters"]  # fmt: skip
    lines = [f"### {name}", "", f"| {' | '.join(heads)} |", "|---|" + "---:|" * (len(heads) - 1)]
    for row in sorted((x for x in full.values() if x.nmse is not None), key=lambda x: x.nmse or 0.0):
        small = {x.samples: x.nmse for x in rows if x.model == row.model and x.samples != most}
        values = spread[row.model]
        between = f"{significant(min(values))} to {significant(max(values))}" if len(values) > 1 else ""
        cells = [row.model, number(row.nmse), *(number(small.get(size)) for size in sizes), between]
        cells += [number(x) for x in (row.rmse, row.fit_s, row.predict_us, row.memory_mb)] + [str(row.parameters)]
        lines.append(f"| {' | '.join(cells)} |")
    without = [row for row in full.values() if row.nmse is None]
    return "\n".join([*lines, *([""] if without else []), *(f"- `{row.model}`: {row.reason}." for row in without)])


def number(value: float | None) -> str:
    """Three digits, or nothing."""
    return "" if value is None else significant(value)


def verdict(rows: Sequence[Measured], real: Sequence[str], size: int | None) -> str:
    """Where each model is best, at so many rows (None: all), and which one training data would choose."""
    found: dict[str, dict[str, float]] = {}
    for name in real:
        own = [row for row in rows if row.data == name]
        kept = whole(own) if size is None else [row for row in own if row.samples == size]
        for row in kept:
            if row.nmse is not None:
                found.setdefault(row.model, {})[name] = row.nmse
    best = {name: min((errors[name], model) for model, errors in found.items() if name in errors) for name in real
            if any(name in errors for errors in found.values())}  # fmt: skip
    ranked = sorted(found, key=lambda model: (-sum(best[n][1] == model for n in best), mean_log(found[model], best)))
    title = "all rows" if size is None else f"{size} rows"
    lines = [f"### Real robots, {title}: NMSE", "", f"| model | {' | '.join(real)} | best on | ratio to the best |",
             "|---|" + "---:|" * (len(real) + 2)]  # fmt: skip
    for model in ranked:
        won = [name for name in best if best[name][1] == model]
        bold = dict.fromkeys(won, "**")
        cells = [f"{bold.get(name, '')}{number(found[model].get(name))}{bold.get(name, '')}" for name in real]
        ratio = significant(math.exp(mean_log(found[model], best)))
        lines.append(f"| {model} | {' | '.join(cells)} | {len(won)} of {len(real)} | {ratio} |")
    if size == INNER:
        lines += ["", *choice(rows, real)]
    return "\n".join(lines)


def mean_log(errors: Mapping[str, float], best: Mapping[str, tuple[float, str]]) -> float:
    """Mean logarithm of the ratio to the best, over the data sets that the model has."""
    return float(np.mean([math.log(errors[name] / best[name][0]) for name in errors if name in best]))


def choice(rows: Sequence[Measured], real: Sequence[str]) -> list[str]:
    """What the training rows alone would choose: for every robot, and one for all that have a URDF."""
    inner = {(row.data, row.model): row.inner for row in rows if row.inner is not None and row.data in real}
    outer = {(row.data, row.model): row.nmse for row in rows if row.samples == INNER and row.nmse is not None}
    lines = []
    for name in real:
        own = {model: error for (data, model), error in inner.items() if data == name}
        if own:
            picked = min(own, key=lambda model: own[model])
            lines.append(f"- {name}: the training rows choose `{picked}`, NMSE {number(outer[name, picked])}.")
    everywhere = [m for m in MODELS if all((name, m) in inner for name in real if any(d == name for d, _ in inner)
                                           and name != "sarcos")]  # fmt: skip
    names = [name for name in real if name != "sarcos" and any(data == name for data, _ in inner)]
    if everywhere and names:
        least = {name: min(inner[name, model] for model in everywhere) for name in names}
        ratio = {m: np.mean([math.log(inner[name, m] / least[name]) for name in names]) for m in everywhere}
        one = min(ratio, key=lambda model: ratio[model])
        lines.append(f"- One for all robots with a URDF, by the mean logarithm of the inner error: `{one}`.")
    return lines
