"""A third party's model, adaptation and data source: the code of docs/extending.md and own_data.md, in a folder."""

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments.arms import random_arm
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from tests.commands import ROOT, TINY, invdyn, python

PAGE = "".join((ROOT / "docs" / name).read_text() for name in ("extending.md", "own_data.md"))
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
FILES = {code.split("\n")[0].removeprefix("# "): code for _, code in BLOCKS if re.match(r"# \S+\.(py|yaml)\n", code)}
COMMANDS = [line.removeprefix("$ ") for kind, code in BLOCKS if kind == "console" for line in code.splitlines()]
SNIPPETS = [code for kind, code in BLOCKS if kind == "python" and code not in FILES.values()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with the page's files and nothing else."""
    made = tmp_path_factory.mktemp("mine")
    for name, code in FILES.items():
        (made / name).parent.mkdir(exist_ok=True)
        (made / name).write_text(code)
    return made


@pytest.fixture
def typed(command):
    """The command line, which forgets the page's modules afterwards."""
    before = set(sys.modules)
    yield command
    for name in {Path(x).stem for x in FILES} & (set(sys.modules) - before):
        del sys.modules[name]


@pytest.fixture
def told(folder, typed, monkeypatch):
    """told(line, name): what that command, typed in the folder, writes into the file called name."""
    monkeypatch.chdir(folder)

    def call(line: str, name: str) -> dict:
        said = typed(*line.split()[1:])
        assert said.code == 0, said.err
        return json.loads((folder / said.out[-1] / name).read_text())

    return call


def test_the_page_has_what_it_promises():
    """One file and one YAML for each of the four, four commands, one snippet of Python."""
    assert sorted(FILES) == [
        "adaptation/offset.yaml", "data/pendulum.yaml", "data/telemetry.yaml", "mine.py", "model/mine.yaml",
        "offset.py", "pendulum.py", "telemetry.py",
    ]  # fmt: skip
    assert (len(COMMANDS), len(SNIPPETS)) == (4, 1)


@pytest.fixture(scope="module")
def finished(folder) -> Path:
    """The folder of the run with a model of one's own, made by the installed command on data that are quickly made."""
    done = invdyn(*COMMANDS[0].split()[1:], *TINY, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / done.stdout.splitlines()[-1]


def test_a_model_of_ones_own(folder, finished):
    """`invdyn run model=mine` finds mine.py and model/mine.yaml in its working directory; the run loads again."""
    metrics = json.loads((finished / "metrics.json").read_text())
    assert metrics["model"] == "mine"
    assert metrics["parameters"] == 2 * 7
    code = (
        "import numpy as np\n"
        "from invdyn_cli import load_run\n"
        f"stored = load_run({str(finished / 'run.h5')!r}, trust=['mine']).predictions['test']\n"
        "q, qd, qdd = (getattr(stored.data.motion, name) for name in ('q', 'qd', 'qdd'))\n"
        + SNIPPETS[0].replace("run.h5", str(finished / "run.h5"))
        + "print(type(model.model).__name__, np.abs(tau - stored.tau).max() < 1e-9)\n"
    )
    said = python("-c", code, cwd=folder)
    assert said.stdout == "Ridge True\n", said.stderr


def test_its_config_in_a_conf_folder(folder, tmp_path, typed):
    """The YAML is found in conf/ too, beside mine.py."""
    shutil.copy(folder / "mine.py", tmp_path)
    shutil.copytree(folder / "model", tmp_path / "conf" / "model")
    said = typed("run", "model=mine", "--cfg", "job")
    assert any("_target_: mine.Ridge" in line for line in said.out), said.err


def test_a_run_of_a_model_that_is_not_here(finished, tmp_path):
    """Elsewhere the run of a third party's model cannot be loaded, and one line says which module is missing."""
    code = f"from invdyn_cli import load_model; load_model({str(finished / 'run.h5')!r}, trust=['mine'])"
    said = python("-c", code, cwd=tmp_path)
    assert "the trusted module mine cannot be imported" in said.stderr


def test_a_third_partys_run_is_drawn_anew(folder, finished, typed, monkeypatch):
    """`invdyn report` draws the run of a trusted module anew; without that trust one line says what to say."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    said = typed("report", str(finished))
    assert said.code == 2 and "trust=[mine], if you know that module" in said.err[0]
    assert typed("report", str(finished), "trust=[mine]").code == 0


def test_all_three_together(told):
    """Model, data source and adaptation of one's own make a run together: a pendulum's joint, learned nearly."""
    metrics = told(COMMANDS[1], "metrics.json")
    assert [metrics[k] for k in ("model", "data", "adaptation")] == ["mine", "pendulum", "offset"]
    assert metrics["joints"] == ["hinge"]
    assert metrics["train"]["nmse"]["mean"] < 0.1


def test_a_log_of_a_third_party_is_checked_and_diagnosed(folder, told):
    """A source that has a log is checked, diagnosed and learned from: the Coulomb friction hidden in it is named."""
    (folder / "arm.urdf").write_text(random_arm(np.random.default_rng(0), 2))
    hidden = Hidden("coulomb_friction", "axis2", {"coulomb": (size := 2.0)})
    log = record(load_urdf(folder / "arm.urdf"), [Multisine()], [hidden], duration=12, noise=Noise(torque=0.02))
    one = log.trajectories[0]
    np.save(folder / "telemetry.npy", np.column_stack([one.t, one.q, one.tau])[::2])
    checked = told(COMMANDS[2], "check.json")
    assert checked["usable"] and checked["corrections"] == []
    said = told(COMMANDS[3] + " diagnosis.design=false diagnosis.replay=false", "diagnosis.json")["findings"]
    (found,) = (one for one in said if one["status"] == "named")
    assert (found["effect"], found["joint"]) == ("coulomb_friction", "axis2")
    assert found["parameters"]["coulomb"]["value"] == pytest.approx(size, rel=0.03)  # three intervals
    assert told("invdyn run data=telemetry model=pest", "metrics.json")["joints"] == ["axis1", "axis2"]


def test_they_keep_their_contracts(folder):
    """The page's model, adaptation and data source pass the checks that the package's own pass."""
    code = (
        "from dataclasses import replace\n"
        "from invdyn_cli import testing\n"
        "from mine import Ridge; from offset import Offset; from pendulum import Pendulum\n"
        "data = Pendulum().load(None).train\n"
        "testing.check_model(Ridge(), data)\n"
        "testing.check_adapter(Offset(), Ridge(), data)\n"
        "testing.check_source(Pendulum(), None)\n"
        "print('kept')\n"
    )
    said = python("-c", code, cwd=folder)
    assert said.stdout == "kept\n", said.stderr
