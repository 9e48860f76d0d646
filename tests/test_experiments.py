"""The experiments: their contract and files, how they are run and resumed, and what each counts as found."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

import experiments
from experiments import detection, latency, structures
from experiments.bench import PARTS
from experiments.cases import inverse_dynamics
from experiments.detection import ENOUGH, HIGHEST, STEP, climb, is_found
from experiments.excite import Excite, Settled, least_distance, open_finding
from experiments.latency import WARM
from experiments.multiple import Counted, f1, loud
from experiments.real_diagnosis import JOBS
from experiments.replay import NOT_HELD, Replay, Replayed, names_of
from experiments.worn import spoken
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.adaptation.local_error_model import LocalErrorModel
from invdyn_cli.errors import UsageError
from invdyn_cli.log import RawTrajectory
from invdyn_cli.models.pest import Pest
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.types import Dataset, Diagnosis, Examination, Finding, Motion, Trajectory
from invdyn_cli.verbs import listing
from invdyn_cli.verbs.experiment import SHARED, _value, put
from invdyn_cli.verbs.launch import config_folder
from invdyn_cli.verbs.objects import instantiate
from tests.commands import ENVIRONMENT, ROOT, invdyn, script, tree, usually
from tests.verbs.test_together import children, wait

SPECS = {name: listing.read(name) for name in sorted(path.stem for path in (ROOT / "experiments").glob("*.yaml"))}
CLASSES = [name for name, spec in SPECS.items() if "_target_" in spec]
SUM = """
import time
from dataclasses import dataclass
from invdyn_cli.abstract_experiment import AbstractExperiment

@dataclass(frozen=True)
class Row:
    number: int
    square: float

@dataclass(frozen=True)
class Sum(AbstractExperiment):
    row = Row
    numbers: int = 3
    broken: int = -1
    seconds: float = 0.0

    def plan(self, rows):
        return [(k, self.broken, self.seconds) for k in range(self.numbers)]

    def run(self, folder, k, broken, seconds):
        if k == broken:
            raise ValueError("this one is broken")
        time.sleep(seconds)
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "calls.csv").open("a") as file:
            file.write(f"{k}\\n")
        yield Row(k, float(k) ** 2)

    def table(self, rows):
        return f"sum {sum(x.square for x in rows):g} of {[x.number for x in rows]}"
"""
SUM_YAML = """# one of a user's own
title: Squares
_target_: experiments.squares.Sum
numbers: 3    # how many
broken: -1    # which one fails
seconds: 0.0  # that each takes
"""


@pytest.fixture
def fresh(monkeypatch, command):
    """The command line, to which no experiment of a user's own is known from before."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(experiments, "__path__", list(experiments.__path__))

    def call(*argv):
        for name in ("squares", "units"):
            sys.modules.pop(f"experiments.{name}", None)
            vars(experiments).pop(name, None)
        return command("experiment", *argv)

    return call


@pytest.fixture
def own(tmp_path, fresh):
    """A working folder with an experiment of a user's own; gives a function that runs it."""
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "squares.py").write_text(SUM)
    (tmp_path / "experiments" / "squares.yaml").write_text(SUM_YAML)
    return lambda *argv: fresh("squares", "folder=out", *argv)


def class_of(name):
    """The class of an experiment."""
    module, _, found = SPECS[name]["_target_"].rpartition(".")
    return getattr(__import__(module, fromlist=[found]), found)


def calls(folder):
    """The jobs that were run, in their order."""
    return [int(row[0]) for row in csv.reader((folder / "out" / "calls.csv").read_text().splitlines())]


@pytest.mark.parametrize("name", CLASSES)
def test_yaml_and_class_agree(name, monkeypatch):
    """The YAML of an experiment names each option of its class with its default, and beside them only shared ones."""
    monkeypatch.delenv("INVDYN_REAL_DATA", raising=False)
    shared = yaml.safe_load(SHARED)
    said = {key: value for key, value in SPECS[name].items() if key not in ("title", *shared)}
    kind = class_of(name)
    assert set(said) == {"_target_", *(field.name for field in fields(kind))}
    made = instantiate(OmegaConf.create(said))
    assert all(_plain(getattr(made, f.name)) == _plain(getattr(kind(), f.name)) for f in fields(kind))


def _plain(value):
    return tuple(value) if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("name", sorted(set(CLASSES) - {"transfer", "real_diagnosis"}))
def test_plans_are_plain_and_refuse_names(name):
    """A plan has jobs that JSON can hold, no two alike; a name that is not allowed is refused before the first."""
    kind = class_of(name)
    jobs = [json.dumps(job) for job in kind().plan(())]
    assert jobs and len(set(jobs)) == len(jobs)
    for option in {"only", "effects"} & {field.name for field in fields(kind)}:
        with pytest.raises(UsageError, match=f"{option}=nothing"):
            list(kind(**{option: ["nothing"]}).plan(()))


def test_experiments_are_listed_with_their_options(own, fresh, tmp_path):
    """`invdyn experiment` lists every experiment, also a user's own, and --help says what an option is."""
    lines = fresh().out
    listed = " ".join(" ".join(lines).split())
    assert max(map(len, lines)) <= 80
    assert all(f" {name} {spec['title']}" in listed for name, spec in SPECS.items())
    assert " squares Squares" in listed
    said = own("--help")
    text = "\n".join(said.out)
    assert said.code == 0 and "numbers: 3    # how many" in text and "workers: 1" in text
    assert not (tmp_path / "out").exists()


def test_an_own_experiment_is_resumed(own, tmp_path):
    """A user's own YAML and class: table, rows and page are written; what has finished is not run again, but with
    fresh=true; more jobs run only those; changed code runs all."""
    done = own("numbers=3")
    assert done.code == 0, done.err
    assert "sum 5 of [0, 1, 2]" in done.out and "sum 5 of [0, 1, 2]" in (tmp_path / "out/squares.md").read_text()
    assert json.loads((tmp_path / "out/squares.json").read_text())[2] == {"number": 2, "square": 4.0}
    assert "sum 14 of [0, 1, 2, 3]" in own("numbers=4").out
    assert calls(tmp_path) == [0, 1, 2, 3]
    own("numbers=1", "fresh=true")
    assert calls(tmp_path) == [0, 1, 2, 3, 0]
    code = tmp_path / "experiments" / "squares.py"
    code.write_text(code.read_text().replace("** 2", "** 3"))
    assert "sum 1 of [0, 1]" in own("numbers=2").out and calls(tmp_path)[-2:] == [0, 1]


def test_the_page_of_own_experiments_is_true(fresh, tmp_path):
    """The example of docs/own_experiments.md runs as it stands, and reports torques in N mm, not those in N m."""
    blocks = re.findall(r"```(?:yaml|python)\n# (\S+)\n(.*?)```", (ROOT / "docs/own_experiments.md").read_text(), re.S)
    (tmp_path / "experiments").mkdir()
    for name, text in blocks:
        (tmp_path / name).write_text(text)
    done = fresh("units", "seed=3", "factors=1,1000")
    assert done.code == 0, done.err
    rows = json.loads((tmp_path / "outputs/units/units.json").read_text())
    assert [row["reported"] for row in rows] == [False, True]


def test_processes_change_nothing_but_time(own, tmp_path):
    """Two processes give the same table, in the order of the plan."""
    done = own("numbers=5", "workers=2", "seconds=0.05")
    assert done.code == 0, done.err
    assert "sum 30 of [0, 1, 2, 3, 4]" in done.out and sorted(calls(tmp_path)) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("workers", usually([2], [1, 2]))
def test_a_plan_waits_for_the_rows_before(own, tmp_path, workers):
    """What follows WAIT knows the rows of all jobs before, however long one of several processes takes for them."""
    code = tmp_path / "experiments" / "squares.py"
    text = code.read_text().replace("import AbstractExperiment", "import WAIT, AbstractExperiment")
    plan = "yield from [(k, self.broken, self.seconds * k) for k in range(self.numbers)]"
    text = text.replace(
        "return [(k, self.broken, self.seconds) for k in range(self.numbers)]",
        f"""{plan}
        yield WAIT
        yield (int(sum(x.square for x in rows)), self.broken, 0.0)""",
    )
    code.write_text(text)
    done = own("numbers=3", f"workers={workers}", "seconds=0.2")
    assert done.code == 0, done.err
    assert "sum 30 of [0, 1, 2, 5]" in done.out and calls(tmp_path)[-1] == 5


def test_a_job_that_fails_leaves_the_others(own):
    """The failure is told, the other rows are in the table, the exit code is 2."""
    done = own("broken=1")
    errors = "\n".join(done.err)
    assert done.code == 2 and "this one is broken" in errors and "1 job failed" in errors
    assert "sum 4 of [0, 2]" in done.out


@pytest.mark.parametrize("workers", usually([2], [1, 2]))
def test_ctrl_c_keeps_what_has_finished(own, tmp_path, workers):
    """Ctrl-C ends with exit code 130 and one line; no file is half written, and the finished jobs are not run again."""
    entry = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "  # as a terminal starts it
    entry += "from invdyn_cli.cli import entry; entry()"
    argv = [sys.executable, "-c", entry, "experiment", "squares", "folder=out", "numbers=6", "seconds=0.4"]
    process = subprocess.Popen(
        [*argv, f"workers={workers}"],
        cwd=tmp_path,
        env={**os.environ, **ENVIRONMENT},
        stderr=subprocess.PIPE,
        text=True,
    )
    kept = tmp_path / "out" / "jobs"
    while process.poll() is None and (not kept.is_dir() or not list(kept.glob("*.json"))):
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130 and errors.splitlines() == ["invdyn: stopped"]
    finished = {json.loads(path.read_text())["rows"][0]["number"] for path in kept.iterdir()}
    assert finished and not (tmp_path / "out/squares.md").exists()
    before = tree(kept)
    assert any("sum 55 of" in line for line in own("numbers=6", "seconds=0.4").out)
    assert before.items() <= tree(kept).items()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("how", usually([signal.SIGTERM], [signal.SIGTERM, signal.SIGKILL]))
def test_processes_end_with_the_command(own, tmp_path, how):
    """However it is killed: none goes on alone with its job, or waits for another."""
    argv = (script(), "experiment", "squares", "folder=out", "numbers=50", "seconds=0.5", "workers=2")
    process = subprocess.Popen(argv, cwd=tmp_path, env={**os.environ, **ENVIRONMENT}, stdout=subprocess.DEVNULL)
    wait(lambda: bool(list(tmp_path.glob("out/jobs/*.json"))), 120)
    started = children(process.pid)
    assert len(started) > 1
    process.send_signal(how)
    process.wait()
    wait(lambda: not any(Path(f"/proc/{pid}").is_dir() for pid in started), 20)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["confusio"], "did you mean 'confusion'?"),
        (["confusion", "sed=3"], "did you mean 'seed'?"),
        (["confusion", "logs=x"], "logs=x; allowed: a whole number"),
        (["confusion", "logs=-1"], "logs=-1; allowed: a number of 0 or more"),
        (["confusion", "only=payload+payloaf"], "did you mean 'payload'?"),
        (["worn", "docs=true"], "worn has no table or figure in the docs"),
        (["worn", "workers=0"], "workers=0; allowed: 1 and more"),
        (["seed=3"], "seed=3 is no experiment"),
        (["transfer", "data=nowhere"], "data=nowhere holds none of"),
        (["batch_simulatd"], "did you mean 'batch_simulated'?"),
    ],
)
def test_wrong_use_is_one_line(argv, said, command, tmp_path):
    """An unknown experiment, option or value is one line with exit code 2, and nothing is written."""
    done = command("experiment", *argv)
    assert done.code == 2 and len(done.err) == 1 and said in done.err[0]
    assert not list(tmp_path.rglob("*"))


def test_lists_and_text_are_read_as_their_defaults_are(command, tmp_path):
    """noises=0.1,2 are numbers, and a text stays text: what the plan of an experiment gets."""
    assert _value("0.1,2", [0.003]) == [0.1, 2] and _value("[a,b+c]", []) == ["a", "b+c"]
    assert _value("3", "../data") == "3" and _value("1e-3", 1.0) == 0.001 and _value("true", False) is True


def test_make_passes_options_on():
    """make confusion seed=3 logs=2, and names with a dash, are the command with these options."""
    if not shutil.which("make"):
        pytest.skip("make is not installed")
    for target, said in (("confusion", "confusion"), ("taken-up", "taken-up"), ("real-diagnosis", "real-diagnosis")):
        argv = ["make", "--no-print-directory", "-n", "INSTALLED=", target, "seed=3", "only=a,b"]
        done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=True)
        (line,) = done.stdout.splitlines()
        assert f"invdyn experiment {said} " in line and {"seed=3", "only=a,b"} == set(line.split()[3:])


@pytest.mark.parametrize("first", [0.0005, 0.4])
def test_a_climb_ends_at_the_smallest_size_that_enough_logs_show(first):
    """From below or above, the share found is on the ladder, is shown by 9 of 10 logs, and the next below is not."""
    limits = [0.01 * (1 + 0.1 * k) for k in range(9)] + [1.0]

    def found(share: float, log: int) -> bool:
        return share >= limits[log]

    share, tried = climb(found, first, 10)
    assert share is not None and limits[8] <= share < limits[8] * STEP
    assert all(hits <= asked <= 10 for _, hits, asked in tried)
    assert not [size for size, hits, _ in tried if size < share and hits >= ENOUGH * 10]


def test_a_climb_gives_up_cheaply():
    """What no log shows costs two logs a size, and has no limit."""
    share, tried = climb(lambda share, log: False, 0.1, 10)
    assert share is None
    assert {asked for _, _, asked in tried} == {2} and tried[-1][0] <= HIGHEST


def test_a_large_friction_is_found(monkeypatch):
    """A friction of a fifth of the joint's torque is found by the experiment's own means; of a small arm, shortly."""
    monkeypatch.setattr(detection, "JOINTS", 2)
    monkeypatch.setattr(detection, "DURATION", 12.0)
    assert is_found("coulomb_friction", 0.2, 0.003, 0, 0)


def test_nets_are_chosen_joint_by_joint():
    """Batch and epochs, which all joints share, are those of the smallest mean of each joint's best net; a recurrent
    net is of all joints and no choice; before anything was tried it is Table I's batch and epochs."""

    def tried(hidden, rate, batch, *nmse, memory=0):
        return structures.Tried("search", "", hidden, rate, memory, batch, 100, 0, nmse)

    rows = [
        tried((50,), 0.001, 32, 0.2, 0.9),
        tried((100, 100), 0.01, 32, 0.8, 0.1),
        tried((50,), 0.001, 128, 0.3, 0.3),
        tried((), 0.001, 16, 0.01, 0.01, memory=32),
    ]
    assert structures.best(rows) == (32, 100, (((50,), 0.001), ((100, 100), 0.01)))
    assert structures.best([]) == (32, 100, ())


def test_a_tick_is_judged_before_it_learns(apollo4):
    """In the loop an exact model leaves next to nothing of the torque behind the same filter; beside 3 N m more than it
    knows the error is that offset's, and following it leaves less than a tenth."""
    t = np.arange(3000)[:, None] / 1000
    pace, phase = 2 * np.pi * np.array([0.3, 0.4, 0.5, 0.6]), np.arange(4)
    q, qd, qdd = (0.5 * pace**k * np.sin(pace * t + phase + k * np.pi / 2) for k in range(3))
    tau = inverse_dynamics(apollo4, q, qd, qdd)
    learned = Dataset((Trajectory("known", t[:, 0], Motion(q, qd, qdd), tau),), apollo4.joints, apollo4)
    raw = RawTrajectory("played", t[:, 0], q, np.roll(tau, -1, axis=0))  # a torque makes the next sample's motion
    assert latency.played(Batch(), Pest(), learned, raw, 2500)[1] < 1e-3
    pushed = replace(raw, tau=raw.tau + 3.0)
    still, followed = (latency.played(how, Pest(), learned, pushed, 2500)[1] for how in (Batch(), LocalErrorModel()))
    assert still == pytest.approx(np.mean(9 / np.var(tau[WARM:-300], axis=0)), rel=0.1)  # the played part of the motion
    assert followed < still / 10


def test_f1_counts_pairs():
    """Two of three found and one claim beside them: precision and recall 2/3."""
    one = Counted("three", 0, ("a@1", "b@2", "c@3"), ("a@1", "b@2", "d@3"), ("c@3",), ("d@3",), 1.0)
    assert f1([one]) == pytest.approx((2 / 3, 2 / 3, 2 / 3))
    without = loud(replace(one, faint=("b@2", "c@3")))  # one of them found
    assert f1([without]) == pytest.approx((2 / 3, 1 / 2, 1.0))


def test_a_standard_term_is_no_anomaly():
    """Of a worn arm a friction's claim is no anomaly, nor is one that a friction explains as well; another is, and only
    the right one is right."""
    hidden = Hidden("joint_spring", "a", {"stiffness": 1.0, "rest": 0.0})
    friction = Finding("coulomb_friction", "b", "named")
    either = Finding("actuator_lag", "b", "ambiguous", (("viscous_friction",),))
    false, right = Finding("torque_delay", "b", "named"), Finding("joint_spring", "a", "named")
    assert spoken(hidden, [friction, either, right]) == ("named", [])
    assert spoken(hidden, [friction, false]) == ("missed", [false])
    assert spoken(None, [right]) == ("none", [right])


@pytest.mark.benchmark
def test_every_part_of_the_benchmark_runs(tmp_path):
    """With few samples: a part prints a ratio, or what has to be installed for it."""
    done = invdyn("experiment", "bench", "tiny=true", "folder=out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    parts = json.loads((tmp_path / "out" / "bench.json").read_text())
    assert [x["part"] for x in parts] == list(PARTS)
    assert all((x["ratio"] or 0) > 0 or "torch" in x["what"] for x in parts)


def test_replays_are_counted():
    """Two different effects that an MJCF holds are drawn for a log; a log counts from 80 % on."""
    for k in range(30):
        one, other = names_of(0, k)
        assert one != other and not {one, other} & set(NOT_HELD)
    logs = [Replayed(0, ("a@1", "b@2"), (), 1.0, after, 0.1, 1.0, 1.0, 1.0) for after in (0.1, 0.2, 0.3, 1.5)]
    assert "2 of 4 logs" in Replay().table(logs) and "| -50 % |" in Replay().table(logs)


def test_open_cases_are_those_that_hold_the_hidden_effect():
    """A case is an ambiguous finding with the hidden effect among its names; its distance is the smallest from a rival
    where that effect is the true one, and there is none where no motion tells one of them."""
    hidden = Hidden("actuator_lag", "j2", {"time_constant": 0.01})
    pairs = [
        {"true": "torque_delay", "rival": "actuator_lag", "standard_errors": 3.0, "possible": True},
        {"true": "actuator_lag", "rival": "torque_delay", "standard_errors": 20.0, "possible": True},
    ]
    late = Finding("torque_delay", "j2", "ambiguous", (("actuator_lag",),), evidence={"distances": pairs})
    elsewhere = Finding("torque_delay", "j1", "ambiguous", (("actuator_lag",),))
    said = Diagnosis("explained", Examination(True, (), {}), (elsewhere, late), {}, {}, None, {})
    assert open_finding(hidden, said) == 1
    assert open_finding(Hidden("joint_spring", "j2"), said) is None
    assert least_distance(hidden, late) == 20.0
    never = Finding("torque_delay", "j2", "ambiguous", evidence={"distances": [{**pairs[1], "possible": False}]})
    assert least_distance(hidden, never) is None


def test_the_count_is_of_right_names():
    """Of two cases one is named rightly."""
    rows = [Settled(k, "a@j", ("a|b@j",), 20.0, ("a@j",), how, 1.0) for k, how in ((0, "named"), (1, "ambiguous"))]
    assert "1 of 2 ambiguous cases are named rightly" in Excite().table(rows)


def test_results_are_put_between_markers(tmp_path):
    """Only what stands between the markers changes; a page without them is refused."""
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- x -->\nold\n<!-- /x -->\nb\n")
    put(page, "x", "new\n")
    assert page.read_text() == "a\n<!-- x -->\nnew\n<!-- /x -->\nb\n"
    with pytest.raises(UsageError):
        put(page, "y", "new")


@pytest.mark.parametrize("name", [name for name in CLASSES if class_of(name).page])
def test_pages_have_the_markers_that_are_written(name, tmp_path):
    """What docs=true writes in place has its place."""
    page = class_of(name).page
    copy = tmp_path / "page.md"
    copy.write_text((ROOT / page).read_text())
    put(copy, name, "new")


@pytest.mark.parametrize("name", JOBS)
def test_real_diagnoses_compose(name):
    """The overrides of every real diagnosis are options of invdyn diagnose."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        compose("diagnose", ["data=real_log", "data.path=x.h5", *JOBS[name].overrides])
