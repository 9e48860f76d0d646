"""Times beside what one would write by hand, both sides taking turns in one run (bench.md)."""

import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from invdyn_cli.abstract_experiment import AbstractExperiment

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
PART = "INVDYN_BENCH_PART"
"""Set in the subprocess that measures one part: threads must be counted before numpy and jax start."""

TINY = "INVDYN_BENCH_TINY"
"""Set beside it where a hundredth of the samples will do."""


@dataclass(frozen=True)
class Part:
    """Times [s] of one comparison, their ratio, and where it was measured; `what` alone where it was left out."""

    part: str
    what: str
    invdyn: tuple[float, ...] = ()
    by_hand: tuple[float, ...] = ()
    ratio: float | None = None
    machine: str = ""


@dataclass(frozen=True)
class Bench(AbstractExperiment):
    """Each part in a process of its own."""

    row: ClassVar[type] = Part

    tiny: bool = False

    def plan(self, rows: Sequence[Part]) -> Iterable[tuple]:
        """A job per part."""
        return [(part, self.tiny) for part in PARTS]

    def run(self, folder: Path, part: str, tiny: bool) -> Iterable[Part]:
        """Measure one part: threads are counted before numpy and jax start."""
        threads = {} if part == "train" else ONE_THREAD
        environment = os.environ | threads | {PART: part, "JAX_PLATFORMS": "cpu"} | ({TINY: "1"} if tiny else {})
        command = [sys.executable, str(Path(__file__).resolve())]
        found = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout
        yield Part(part, **json.loads(found.splitlines()[-1]), machine=machine(tiny))

    def line(self, row: Part) -> str:
        """The ratio."""
        return row.what if row.ratio is None else f"{row.part}: {row.ratio:.1f} times as fast"

    def table(self, rows: Sequence[Part]) -> str:
        """A row per part, as Markdown."""
        lines = ["| part | invdyn [s] | by hand [s] | times as fast | what |", "|---|---:|---:|---:|---|"]
        for x in rows:
            cells = ("-", "-", "-") if x.ratio is None else (spread(x.invdyn), spread(x.by_hand), f"{x.ratio:.1f}")
            lines.append(f"| {x.part} | {' | '.join(cells)} | {x.what} |")
        return "\n".join([*lines, "", rows[-1].machine])


def machine(tiny: bool) -> str:
    """Cores and load, so that a reader can judge the numbers."""
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    tiny = "a hundredth of the samples: these ratios mean nothing; " if tiny else ""
    return f"{tiny}median (min .. max); {len(os.sched_getaffinity(0))} cores, load {load} over 1, 5, 15 minutes"


def samples(usual: int) -> int:
    """How many samples a part takes."""
    return usual // 100 if TINY in os.environ else usual


def spread(seconds: Sequence[float]) -> str:
    return f"{statistics.median(seconds):.3g} ({min(seconds):.3g} .. {max(seconds):.3g})"


def measure(
    what: str,
    invdyn: Callable[[], object],
    by_hand: Callable[[], object],
    repetitions: int,
    per: int = 1,
) -> dict:
    """Times of both, taking turns after one warm-up each; `per` divides invdyn's (epochs or jobs in one call)."""
    sides = {"invdyn": (invdyn, per), "by_hand": (by_hand, 1)}
    times: dict[str, list[float]] = {name: [] for name in sides}
    for repetition in range((1 if TINY in os.environ else repetitions) + 1):
        for name, (call, share) in sides.items():
            started = time.perf_counter()
            call()
            if repetition:
                times[name].append((time.perf_counter() - started) / share)
    ratio = statistics.median(times["by_hand"]) / statistics.median(times["invdyn"])
    return {"what": what, **times, "ratio": ratio}


def torch_net(inputs: int, hidden: Sequence[int]):
    """Layers with ReLU between them and one output."""
    import torch

    widths, layers = [inputs, *hidden], []
    for before, after in itertools.pairwise(widths):
        layers += [torch.nn.Linear(before, after), torch.nn.ReLU()]
    return torch.nn.Sequential(*layers, torch.nn.Linear(widths[-1], 1))


def train() -> dict:
    """FFNN training against PyTorch, seconds an epoch of all four joints."""
    try:
        import torch
    except ImportError:
        return {"what": "torch is not installed: pip install torch"}
    import jax
    import jax.numpy as jnp
    import numpy as np

    from invdyn_cli import training
    from invdyn_cli.models.ffnn import Ffnn

    rng = np.random.default_rng(0)
    rows = samples(24_300)
    x, y = rng.normal(size=(rows, 12)).astype("f4"), rng.normal(size=(rows, 4)).astype("f4")
    groups, keys = Ffnn().groups(4), jax.random.split(jax.random.key(0), 1)
    data, schedule = training.Data(jnp.asarray(x), jnp.asarray(y)), training.Schedule(epochs=10)

    torch.set_num_threads(1)
    torch.manual_seed(0)
    inputs, targets = torch.from_numpy(x), torch.from_numpy(y)

    nets = [
        (column, net, torch.optim.Adam(net.parameters(), lr=rate))
        for group in groups
        for column, rate in zip(group.columns, group.learning_rates, strict=True)
        for net in [torch_net(12, group.hidden)]
    ]

    def epoch():
        for column, net, optimiser in nets:
            order = torch.randperm(len(inputs))
            for start in range(0, len(inputs) - 31, 32):
                rows = order[start : start + 32]
                loss = torch.nn.functional.mse_loss(net(inputs[rows])[:, 0], targets[rows, column])
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()

    what = "FFNN, an epoch of four joints' nets, 24,300 samples, batches of 32; against a PyTorch loop per joint"
    return measure(what, lambda: training.train(groups, schedule, data, None, keys), epoch, 3, per=10)


def arm():
    """The seven-joint arm, Pinocchio's model of it, and 100,000 states as a dataset."""
    import numpy as np

    from invdyn_cli.robots import load_urdf, pinocchio_model
    from invdyn_cli.types import Dataset, Motion, Trajectory

    robot, rows = load_urdf("apollo_arm"), samples(100_000)
    rng = np.random.default_rng(0)
    motion = Motion(*rng.normal(size=(3, rows, 7)))
    trajectory = Trajectory("random", np.arange(rows) / 500, motion, rng.normal(size=(rows, 7)))
    return robot, pinocchio_model(robot), Dataset((trajectory,), robot.joints, robot)


def pest() -> dict:
    """Regressor and solve against normal equations from Pinocchio's regressor."""
    import numpy as np
    import pinocchio as pin

    from invdyn_cli.maths.regression import Design, solve

    robot, model, dataset = arm()
    workspace = model.createData()
    motion, tau = dataset.motion, dataset.tau
    design = Design(robot, (), np.ones(7))

    def by_hand():
        gram, moment = np.zeros((70, 70)), np.zeros(70)
        for q, qd, qdd, torque in zip(motion.q, motion.qd, motion.qdd, tau, strict=True):
            rows = pin.computeJointTorqueRegressor(model, workspace, q, qd, qdd)
            gram += rows.T @ rows
            moment += rows.T @ torque
        return np.linalg.lstsq(gram, moment, rcond=1e-10)[0]

    what = "PEST, regressor and solve, 100,000 x 7; against a Pinocchio loop with normal equations; one thread"
    return measure(what, lambda: solve(design, dataset, 1e-3), by_hand, 5)


def rnea() -> dict:
    """Torques as a fitted PEST predicts them, against a loop of Pinocchio's rnea."""
    import jax
    import numpy as np
    import pinocchio as pin

    from invdyn_cli.models.pest import Pest
    from invdyn_cli.types import Fit

    robot, model, dataset = arm()
    workspace, motion = model.createData(), dataset.motion
    params = Pest().init(dataset, jax.random.key(0)) | {"psi": robot.inertial}
    fit = Fit(params, robot, robot.joints, 70)

    def by_hand():
        samples = zip(motion.q, motion.qd, motion.qdd, strict=True)
        return np.array([pin.rnea(model, workspace, *sample) for sample in samples])

    np.testing.assert_allclose(Pest().predict(fit, motion), by_hand(), atol=1e-9)
    what = "torques of 100,000 x 7 by inverse dynamics; against a loop of Pinocchio's rnea; one thread"
    return measure(what, lambda: Pest().predict(fit, motion), by_hand, 7)


def dbm() -> dict:
    """The shared DBM, regularised, against plain least squares on stacked columns."""
    import jax
    import numpy as np

    from invdyn_cli.maths.dynamic_map import Arc, DynamicMap
    from invdyn_cli.models.dbm import Dbm
    from invdyn_cli.types import Dataset, Motion, Trajectory

    rng, rows = np.random.default_rng(0), samples(4500)
    parts = tuple(
        Trajectory(
            f"task{k}", np.arange(rows) / 500, Motion(*rng.normal(size=(3, rows, 4))), rng.normal(size=(rows, 4))
        )
        for k in range(8)
    )
    dataset = Dataset(parts, ("a", "b", "c", "d"))
    functions, arc = DynamicMap("shared", "trig", 4), Arc(np.zeros(4), np.ones(4))
    columns = jax.jit(jax.vmap(lambda one: functions.columns(arc, one)[0]))

    def by_hand():
        stacked = np.concatenate([np.asarray(columns(x.motion)) for x in parts])
        return np.linalg.lstsq(stacked.reshape(-1, stacked.shape[-1]), dataset.tau.ravel(), rcond=None)[0]

    what = "DBM, shared, 36,000 x 4, with a ridge chosen by leaving tasks out; against numpy's plain lstsq; one thread"
    return measure(what, lambda: Dbm(form="shared").fit(dataset, jax.random.key(0)), by_hand, 3)


def adapt(deep: bool = False) -> dict:
    """The delta rule along a log against PyTorch's SGD."""
    try:
        import torch
    except ImportError:
        return {"what": "torch is not installed: pip install torch"}
    import jax
    import numpy as np

    from invdyn_cli import experiment
    from invdyn_cli.adaptation.incremental import Incremental
    from invdyn_cli.models.ffnn import Ffnn
    from invdyn_cli.types import Dataset, Motion, Trajectory

    rng, length = np.random.default_rng(0), samples(90_000)
    q, qd, qdd = rng.normal(size=(3, length, 7))
    tau = np.sin(q) + 0.1 * qdd
    data = Dataset((Trajectory("a", np.arange(length) / 1000, Motion(q, qd, qdd), tau),), tuple("abcdefg"))
    adapter, model = Incremental(), Ffnn((100, 100, 10), joints=(), epochs=1) if deep else Ffnn(epochs=1)
    fit = adapter.fit(model, data, jax.random.key(0))
    torch.set_num_threads(1)
    hidden = {column: group.hidden for group in model.groups(7) for column in group.columns}
    nets = []
    for column in range(7):
        net = torch_net(21, hidden[column])
        nets.append((column, net, torch.optim.SGD(net.parameters(), lr=adapter.learning_rate)))
    x = torch.from_numpy(np.concatenate([q, qd, qdd], axis=1).astype("f4"))
    y = torch.from_numpy(tau.astype("f4"))

    def by_hand():
        for start in range(0, length, 100):
            inputs, targets = x[start : start + 100], y[start : start + 100]
            for column, net, optimiser in nets:
                with torch.no_grad():
                    net(inputs)
                for _ in range(adapter.epochs):
                    order = torch.randperm(100)
                    for rows in (order[k : k + 32] for k in range(0, 96, 32)):
                        loss = torch.nn.functional.mse_loss(net(inputs[rows])[:, 0], targets[rows, column])
                        optimiser.zero_grad()
                        loss.backward()
                        optimiser.step()

    def ours():
        return experiment.follow(adapter, model, fit, data)

    nets_of = "V-C" if deep else "Table I"
    return measure(f"nets of {nets_of}, 7 joints, learn on along 90,000 samples; against PyTorch", ours, by_hand, 3)


def sweep() -> dict:
    """Time of a job of a sweep over seeds and learning rates, on all cores, against the same job as a command."""
    seeds, epochs = (1, 1) if TINY in os.environ else (12, 20)
    how = ["model=ffnn", "robot.dofs=4", "data.duration=2", f"model.epochs={epochs}"]

    def command(*options: str) -> None:
        with tempfile.TemporaryDirectory() as folder:
            place = f"hydra.{'sweep' if '-m' in options else 'run'}.dir={folder}"
            made = [sys.executable, "-c", "from invdyn_cli.cli import entry; entry()", "run", *options, *how, place]
            subprocess.run(made, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def together() -> None:
        command("-m", f"seed=range({seeds})", "model.learning_rate=0.001,0.002")

    what = f"a job of {epochs} epochs, four joints, in a sweep of {2 * seeds}, all cores; against a command of its own"
    return measure(what, together, lambda: command("seed=0"), 3, per=2 * seeds)


PARTS = {
    "train": train,
    "pest": pest,
    "rnea": rnea,
    "dbm": dbm,
    "adapt": adapt,
    "adapt_deep": lambda: adapt(deep=True),
    "sweep": sweep,
}

if __name__ == "__main__":  # started by `Bench.run`
    if os.environ[PART] not in ("train", "sweep") and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    print(json.dumps(PARTS[os.environ[PART]]()))
