"""Files that were built to do harm run no code, show nothing outside of themselves, and cost little memory and time."""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape

import h5py
import numpy as np
import pytest

from invdyn_cli import hdf5, store
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.errors import LogError, RunFileError, UsageError
from invdyn_cli.logfile import read_log
from invdyn_cli.models import extended
from invdyn_cli.models.pest import Pest
from tests.commands import TINY, invdyn, usually
from tests.logs import make_log, motion
from tests.records import make_record

PEST, BATCH = {"class": "pest", "fields": {}}, {"class": "batch", "fields": {}}
TOUCH = {"class": "subprocess:Popen", "fields": {"args": ["touch", "PWNED"]}}
CANARY = {"class": "canary:Model", "fields": {}}

EXPLOITS = {
    "a command": {"model": TOUCH},
    "a command as adaptation": {"adaptation": TOUCH},
    "a folder deleted": {"model": {"class": "shutil:rmtree", "fields": {"path": "victim"}}},
    "a module that is only imported": {"model": CANARY},
    "a module as adaptation": {"adaptation": CANARY},
    "a field of a valid model": {"model": {"class": "pest", "fields": {"threshold": TOUCH}}},
    "a field that takes any object": {"model": {"class": "extended", "fields": {"text": TOUCH}}},
    "an unknown field of a valid model": {"model": {"class": "pest", "fields": {"more": TOUCH}}},
    "a member": {"model": {"class": "hybrid", "fields": {"base": PEST, "learner": TOUCH}}},
    "a member of a member": {
        "model": {
            "class": "hybrid",
            "fields": {"base": PEST, "learner": {"class": "hybrid", "fields": {"base": CANARY, "learner": PEST}}},
        }
    },
    "a list of members": {"model": {"class": "ffnn", "fields": {"joints": [[1, CANARY]]}}},
    "in an error model": {"adaptation": {"class": "error_model", "fields": {"learner": CANARY}}},
    "a function of Python": {"model": {"class": "builtins:eval", "fields": {"source": "open('PWNED', 'w')"}}},
    "a function of the package": {"model": {"class": "invdyn_cli.store:write_file", "fields": {"path": "PWNED"}}},
    "a class of the package that is no model": {"model": {"class": "invdyn_cli.types:Robot", "fields": {}}},
    "a source that writes files": {"model": {"class": "invdyn_cli.data.pick_place:PickPlace", "fields": {}}},
    "an adaptation in the place of the model": {"model": BATCH},
    "no class at all": {"model": {"class": None, "fields": {}}},
    "a list as class": {"model": {"class": ["pest"], "fields": {}}},
    "a path through a module": {"model": {"class": "invdyn_cli.registry:import_module", "fields": {"name": "canary"}}},
    "dots": {"model": {"class": "..canary:Model", "fields": {}}},
    "a name that is nested": {"model": {"class": "os:path.join", "fields": {}}},
    "fields that are no mapping": {"model": {"class": "canary:Model", "fields": [1]}},
    "a wrong type": {"model": {"class": "pest", "fields": {"friction": 3}}},
}


def hostile_run(path: Path, changes) -> Path:
    """A run.h5 whose objects were exchanged."""
    store.write_run(replace(make_record(3), model=Pest(), adaptation=Batch()), path)
    with h5py.File(path, "a") as file:
        for name, value in changes.items():
            del file[name]
            file[name] = value if isinstance(value, str) else json.dumps(value)
    return path


@pytest.fixture
def canary(tmp_path, monkeypatch):
    """A folder to work in, on the path, with a module that leaves a file when it is imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "canary.py").write_text(
        "from dataclasses import dataclass\nfrom pathlib import Path\n"
        "Path('PWNED').touch()\n"
        "@dataclass(frozen=True)\nclass Model:\n    def __post_init__(self): Path('PWNED').touch()\n"
    )
    (tmp_path / "victim").mkdir()
    sys.modules.pop("canary", None)
    return tmp_path


@pytest.mark.parametrize("name", EXPLOITS)
def test_no_code_from_a_run_file(name, canary):
    """Whatever a run.h5 names, reading it imports no module, calls nothing, and is refused in one line."""
    before = set(sys.modules)
    path = hostile_run(canary / "run.h5", EXPLOITS[name])
    with pytest.raises(RunFileError) as caught:
        store.load_run(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    assert not (canary / "PWNED").exists() and (canary / "victim").is_dir()
    assert "canary" not in sys.modules and not set(sys.modules) - before


def test_every_exploit_through_report(canary, command):
    """`invdyn report` on a hostile run ends with exit code 2 and one line, and leaves nothing."""
    for number, name in enumerate(("a command", "a field of a valid model", "a module that is only imported")):
        hostile_run(canary / f"{number}.h5", EXPLOITS[name])
        said = command("report", f"{number}.h5")
        assert (said.code, said.out, len(said.err)) == (2, [], 1), said.err
    assert "canary" not in sys.modules
    assert not (canary / "PWNED").exists()


def test_trust_is_given_by_name(canary):
    """A class of a module that the reader trusts is built, one that it only imports is not."""
    path = hostile_run(canary / "run.h5", {"model": {"class": "canary:Path", "fields": {}}})
    with pytest.raises(RunFileError, match="trusted module canary has no dataclass 'Path' of its own"):
        store.load_run(path, trust=["canary"])
    path = hostile_run(canary / "run.h5", {"model": CANARY})
    with pytest.raises(RunFileError, match=r"a Model stands where a AbstractModel belongs"):
        store.load_run(path, trust=["canary"])
    path = hostile_run(canary / "run.h5", {"model": TOUCH})
    with pytest.raises(RunFileError, match="not one of invdyn's own"):
        store.load_run(path, trust=["canary"])


def test_a_sweep_folder_of_somebody_else(canary, command):
    """A sweep that starts where a hostile run.h5 lies runs its own job, and nothing of that file."""
    (canary / "sweep" / "0").mkdir(parents=True)
    hostile_run(canary / "sweep" / "0" / "run.h5", {"model": CANARY})
    (canary / "sweep" / "0" / "metrics.json").write_text("{}")
    said = command("run", "-m", "model=pest", *TINY, "hydra.sweep.dir=sweep")
    assert said.code == 0, said.err
    assert "canary" not in sys.modules
    assert not (canary / "PWNED").exists()
    assert type(store.load_run(canary / "sweep" / "0" / "run.h5").model) is Pest


def test_a_folder_of_somebody_else(canary):
    """A verb that is called in a folder with modules and plugins imports none of them, however they are called."""
    evil = "from pathlib import Path\nPath('PWNED').touch()\n"
    (canary / "hydra_plugins").mkdir()
    (canary / "hydra_plugins" / "evil.py").write_text(evil)
    for name in ("xacro", "yaml", "scipy", "sitecustomize", "IPython", "matplotlibrc_", "invdyn_cli", "jax"):
        (canary / f"{name}.py").write_text(evil)
    (canary / "matplotlibrc").write_text("backend: module://canary\ntext.usetex: True\n")
    for folder in (canary / "data", canary / "conf" / "data", canary / "robot"):
        folder.mkdir(parents=True)
        (folder / "real_log.yaml").write_text("_target_: canary.Model\n")
        (folder / "from_log.yaml").write_text("_target_: canary.Model\n")
    (canary / "check.yaml").write_text("defaults: [data: real_log]\n")
    make_log(canary / "log.h5", {"run": motion(seconds=2)}, urdf=None)
    said = invdyn("check", "data.path=log.h5", cwd=canary)
    assert said.returncode == 0, said.stderr
    assert not (canary / "PWNED").exists()


DEEP = "[" * 100_000 + "]" * 100_000


def test_json_nested_too_deep(canary):
    """JSON nested 100,000 deep is refused in one line, in a run and in an extended model."""
    path = hostile_run(canary / "run.h5", {"model": DEEP})
    with pytest.raises(RunFileError, match="nested"):
        store.load_run(path)
    nested = json.dumps({"class": "pest", "fields": {"threshold": "X"}}).replace('"X"', "[" * 400 + "]" * 400)
    with pytest.raises(RunFileError):
        store.load_run(hostile_run(canary / "run.h5", {"model": nested}))
    (canary / "model.json").write_text(DEEP)
    with pytest.raises(UsageError, match="nested"):
        extended.read(str(canary / "model.json"))


def reaching_out(file: h5py.File, kind: str, other: Path) -> None:
    """Put something into a log that reaches outside of it."""
    group = file["trajectories/run"]
    if kind == "soft link":
        group["qd"] = h5py.SoftLink("/trajectories/run/q")
    elif kind == "external link":
        group["qd"] = h5py.ExternalLink(str(other), "/secret")
    elif kind == "external data":
        group.create_dataset("qd", (100, 2), "f8", external=[(str(other), 0, h5py.h5f.UNLIMITED)])
    elif kind == "virtual data":
        layout = h5py.VirtualLayout((100, 2), "f8")
        layout[:] = h5py.VirtualSource(str(other), "secret", (100, 2))
        group.create_virtual_dataset("qd", layout)
    elif kind == "a group within itself":
        group["again"] = group
    elif kind == "references":
        group.create_dataset("qd", (1,), h5py.ref_dtype)[0] = group.ref
    elif kind == "records":
        group["qd"] = np.zeros(10, [("a", "f8"), ("b", "i4")])
    elif kind == "lists of any length":
        group.create_dataset("qd", (3,), h5py.vlen_dtype(np.dtype("f8")))


@pytest.mark.parametrize(
    "kind",
    ["soft link", "external link", "external data", "virtual data", "a group within itself", "references", "records",
     "lists of any length"],
)  # fmt: skip
def test_nothing_outside_of_a_file_is_read(kind, tmp_path):
    """Links, external and virtual datasets, references and odd types are refused before anything of them is read."""
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.ones((100, 2))
    path = make_log(tmp_path / "a.h5", {"run": {k: v for k, v in motion(seconds=1).items() if k != "qd"}})
    with h5py.File(path, "a") as file:
        reaching_out(file, kind, tmp_path / "other.h5")
    with pytest.raises(LogError) as caught:
        read_log(path)
    assert "\n" not in str(caught.value)


def test_what_a_file_claims_is_bounded(tmp_path):
    """A dataset that claims 3 GB and stores nothing is refused at once, and so is one that is squeezed beyond reason or
    larger than the reader allows."""
    started = time.perf_counter()
    path = make_log(tmp_path / "a.h5", {"run": {k: v for k, v in motion(seconds=1).items() if k != "qdd"}})
    with h5py.File(path, "a") as file:
        file["trajectories/run"].create_dataset("qdd", (2**27, 3), "f8", chunks=(2**16, 3), compression="gzip")
    with pytest.raises(LogError, match=r"claims 3.22 GB at /trajectories/run/qdd and stores 0 bytes"):
        read_log(path)
    assert time.perf_counter() - started < 5
    with pytest.raises(LogError, match=r"holds .* GB; allowed: 1e-06 GB"):
        read_log(make_log(tmp_path / "b.h5"), limit=1000)


HANGS = """
import sys, time
for line in sys.stdin.buffer:
    time.sleep(60)
"""


def test_a_reader_that_hangs_or_dies(tmp_path, monkeypatch):
    """Where libhdf5 hangs or crashes on a file, one line says so within the time allowed, and the next file is read."""
    path = make_log(tmp_path / "a.h5")
    assert hdf5._READER._process is not None or read_log(path)
    real = Path(hdf5.__file__).with_name("hdf5_reader.py")
    for code, words in ((HANGS, "took over 1 s"), ("import os; os.kill(os.getpid(), 11)", "crashed")):
        hdf5._READER.close()
        (tmp_path / "reader.py").write_text(code)
        monkeypatch.setattr(hdf5, "SCRIPT", tmp_path / "reader.py")
        monkeypatch.setattr(hdf5, "PATIENCE", 1.0)
        started = time.perf_counter()
        with pytest.raises(LogError, match=words):
            read_log(path)
        assert time.perf_counter() - started < 5
    hdf5._READER.close()
    monkeypatch.setattr(hdf5, "SCRIPT", real)
    monkeypatch.setattr(hdf5, "PATIENCE", 20.0)
    assert read_log(path).trajectories


def changed_log(path: Path, change) -> Path:
    make_log(path)
    with h5py.File(path, "a") as file:
        change(file, file["trajectories/run"])
    return path


def odd_float(file, group):
    odd = h5py.h5t.IEEE_F64LE.copy()
    odd.set_fields(63, 40, 23, 0, 40)
    odd.set_ebias(2**20)
    h5py.h5d.create(group.id, b"qdd2", odd, h5py.h5s.create_simple((3,)))
    del group["qdd"]
    group.move("qdd2", "qdd")


def bad_text(file, group):
    kind = h5py.h5t.C_S1.copy()
    kind.set_size(4)
    kind.set_cset(h5py.h5t.CSET_UTF8)
    space = h5py.h5s.create_simple((1000,))
    dataset = h5py.h5d.create(group.id, b"stage", kind, space)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, np.full(1000, b"\xff\xfe\x80", "S4"), kind)


REPRODUCERS = {
    "stage is a group": (lambda f, g: g.create_group("stage"), "stage is a group"),
    "stage is no UTF-8": (bad_text, ""),
    "stage is empty": (lambda f, g: g.__setitem__("stage", h5py.Empty("f8")), ""),
    "qd is a group": (lambda f, g: (g.pop("qd"), g.create_group("qd")), "qd is a group; allowed: number"),
    "q_ref is a group": (lambda f, g: g.create_group("q_ref"), "q_ref is a group"),
    "rate is empty": (lambda f, g: f.attrs.__setitem__("rate", h5py.Empty("f8")), "rate is nan Hz"),
    "payload_mass is empty": (lambda f, g: g.attrs.__setitem__("payload_mass", h5py.Empty("f8")), ""),
    "rate has no numbers": (lambda f, g: f.attrs.__setitem__("rate", np.zeros(0)), "rate is nan Hz"),
    "an odd float type": (odd_float, "qdd"),
    "joint names are numbers": (lambda f, g: f.attrs.__setitem__("joint_names", [1.0, 2.0]), ""),
    "a name with control characters": (
        lambda f, g: f.move("trajectories/run", "trajectories/\x1b[31mrun"),
        "printable",
    ),
}


@pytest.mark.parametrize("name", REPRODUCERS)
def test_logs_that_ended_in_a_traceback(name, tmp_path):
    """Each is read, or refused in one line."""
    change, words = REPRODUCERS[name]
    path = changed_log(tmp_path / "a.h5", change)
    if not words:
        assert read_log(path).trajectories[0].q.shape == (1000, 2)
        return
    with pytest.raises(LogError) as caught:
        read_log(path)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_text_from_a_file_is_cut(tmp_path):
    """Names of a million letters, and escape sequences, reach neither a message nor the terminal."""
    path = make_log(tmp_path / "a.h5", torque_side="x" * 60_000, robot="\x1b[2J\x07evil")
    with pytest.raises(LogError) as caught:
        read_log(path)
    assert len(str(caught.value)) < 1000
    assert read_log(path, check=False).robot == "?[2J?evil"


NAMES = ("[/]", "<script>alert(1)</script>", "$\\frac{", "[bold red]x", "%s{}\\n", "'\"&;")
"""Names that mean something to rich, to a browser, to matplotlib, to Python and to a shell."""
PAIRS = [list(NAMES[i : i + 2]) for i in (0, 2, 4)]


@pytest.mark.parametrize("names", usually(PAIRS[:1], PAIRS))
def test_names_are_text_wherever_they_are_shown(names, tmp_path, command):
    """A robot and joints with such names are checked, learned from and reported; no page takes them for HTML."""
    first, second = map(escape, names, 2 * ({'"': "&quot;"},))
    links = "".join(
        f'<link name="l{i}"><inertial><mass value="1"/><origin xyz="0.1 0 0"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
        f'ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="{name}" type="revolute"><parent link="l{i - 1}"/>'
        f'<child link="l{i}"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        for i, name in ((1, first), (2, second))
    )
    (tmp_path / "arm.urdf").write_text(f'<robot name="{first}"><link name="l0"/>{links}</robot>')
    make_log(tmp_path / "log.h5", {names[0].replace("/", "_"): motion(20.0)}, robot=names[0], joint_names=names)
    for verb, *more in (("check",), ("run", "model=pest"), ("report", "ran")):
        data = () if verb == "report" else ("data=real_log", "data.path=log.h5", "robot=urdf", "robot.path=arm.urdf")
        said = command(verb, *more, *data, *(["hydra.run.dir=ran"] if verb == "run" else []))
        assert said.code == 0 and not said.err, said.err
        assert verb == "report" or names[0][:5] in "".join(said.out)
    assert "<script>alert" not in (tmp_path / "ran" / "report.html").read_text()


def test_other_kinds_of_files(tmp_path):
    """A pipe and a device in the place of a file are refused, not waited for."""
    import os

    os.mkfifo(tmp_path / "pipe.h5")
    for path in (tmp_path / "pipe.h5", Path("/dev/zero")):
        with pytest.raises(LogError, match="not an HDF5 file"):
            read_log(path)
        with pytest.raises(RunFileError, match="no run at"):
            store.load_run(path)
        with pytest.raises(UsageError, match="is not a file"):
            extended.read(str(path))
