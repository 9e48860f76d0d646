"""What stops a command (a kill, Ctrl-C, a full disk, a reader that goes away) leaves no half file and ends in no crash.

A few moments by default, the same each time, of the verbs that differ most; `make test marked=benchmark` stops all of
them, and INVDYN_STOPS=50 tries so many moments of each, drawn anew.
"""

import csv
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py
import pytest
import yaml

from tests.commands import ENVIRONMENT, ROOT, TINY, in_process, usually

STOPS = int(os.environ.get("INVDYN_STOPS", "0"))
DRAWN = random.Random(None if STOPS else 0)
LONGEST = 3.0
"""[s] from Ctrl-C to the end of the process."""

ENTRY = (
    "import resource, signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "size = int(sys.argv.pop(1)); size and resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)); "
    "from invdyn_cli.cli import entry; entry()"
)
"""The installed command, with a limit [bytes] on the files that it writes, and Ctrl-C as a terminal sends it."""

EXPERIMENT = {
    "title": "Small",
    "source": "a test",
    "columns": "sets",
    "common": [*TINY, "data=sim_clean", "model=ffnn", "model.epochs=1"],
    "jobs": [{"name": "NN", "overrides": [], "sweep": {"data.split": ["interpolation", "extrapolation"]}}],
    "figure": {"title": "Bars", "groups": ["data.split"], "bars": {"NN": {"name": "NN"}}},
}
ARM = ("robot=urdf", "robot.path=sim/robot.urdf", "robot.dofs=2")
RIVALS = "effects=[{effect: coulomb_friction, joint: arm_joint_1}, {effect: viscous_friction, joint: arm_joint_1}]"
CONTROLLED = ("robot.dofs=2", "data.repetitions=1", "data.watched=0", "gains=[20]", "settle=0.2", "model=pest")
COMMANDS = {
    "run": ("run", "model=ffnn", "model.epochs=3", *TINY, "hydra.run.dir=out"),
    "sweep": ("run", "-m", "model=pest,ffnn", *TINY, "hydra.sweep.dir=out"),
    "simulate": ("simulate", "robot.dofs=2", "data.duration=4", "hydra.run.dir=out"),
    "check": ("check", "data.path=sim/log.h5", *ARM, "hydra.run.dir=out"),
    "diagnose": ("diagnose", "data.path=sim/log.h5", *ARM, "hydra.run.dir=out"),
    "excite": ("excite", "robot.dofs=2", "duration=8", RIVALS, "hydra.run.dir=out"),
    "control": ("control", *CONTROLLED, "hydra.run.dir=out"),
    "tables": ("tables", "experiment=small", "folder=out"),
    "figures": ("figures", "shown=[small]", "folder=out", "tables=out/tables", "page=out/index.html"),
    "report": ("report", "ran"),
    "compare": ("compare", "ran", "again", "hydra.run.dir=out"),
}
WRITING = ("run", "sweep", "diagnose", "simulate", "tables")


@pytest.fixture(scope="module")
def workplace(tmp_path_factory) -> Path:
    """A folder with a log, a URDF, a run and an experiment."""
    folder = tmp_path_factory.mktemp("workplace")
    (folder / "experiments").mkdir()
    (folder / "experiments" / "small.yaml").write_text(yaml.safe_dump(EXPERIMENT))
    for argv in (
        ("simulate", "robot.dofs=2", "data.trajectories=1", "data.duration=12", "hydra.run.dir=sim"),
        ("run", "model=pest", *TINY, "hydra.run.dir=ran"),
    ):
        assert in_process(*argv, cwd=folder) == 0
    shutil.copytree(folder / "ran", folder / "again")
    return folder


@pytest.fixture
def folder(workplace, tmp_path) -> Path:
    """A copy of it."""
    return shutil.copytree(workplace, tmp_path / "place")


def start(argv: Sequence[str], cwd: Path, size: int = 0, **environment: str) -> subprocess.Popen[str]:
    """Start a command in a folder."""
    env = {**os.environ, **ENVIRONMENT, "PYTHONPATH": str(ROOT), **environment}
    call = [sys.executable, "-P", "-c", ENTRY, str(size), *argv]
    return subprocess.Popen(call, cwd=cwd, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def broken(folder: Path) -> Iterator[str]:
    """The files below a folder that are not whole."""
    for path in folder.rglob("*"):
        hidden = ".hydra" in path.parts or path.name == "multirun.yaml"  # what Hydra writes for itself
        if not path.is_file() or hidden:
            continue
        try:
            _read(path)
        except Exception as error:
            yield f"{path.name}: {error!r}"


def _read(path: Path) -> None:
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            file.visititems(lambda _, one: one[()] if isinstance(one, h5py.Dataset) else None)
    elif path.suffix == ".json":
        json.loads(path.read_text())
    elif path.suffix in (".yaml", ".yml"):
        assert yaml.safe_load(path.read_text()) is not None
    elif path.suffix == ".csv":
        rows = list(csv.reader(x for x in path.read_text().splitlines() if not x.startswith("#")))
        assert rows and all(len(row) == len(rows[0]) for row in rows) and path.read_bytes().endswith(b"\n")
    elif path.suffix == ".png":
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
    elif path.suffix == ".html":
        assert path.read_text().rstrip().endswith("</html>")
    elif path.suffix in (".urdf", ".xml"):
        assert path.read_text().rstrip().endswith(("</robot>", "</mujoco>"))
    else:
        assert path.suffix in (".md", ".svg", ".txt", ".part"), "what is this?"


def moments(usual: int, longest: float) -> list[float]:
    """[s] after the start, at which something happens."""
    return [DRAWN.uniform(0.3, longest) for _ in range(STOPS or usual)]


def wait_until(process: subprocess.Popen, moment: float) -> None:
    """Sleep so long, or until the process has ended."""
    try:
        process.wait(moment)
    except subprocess.TimeoutExpired:
        return


@contextmanager
def paused(process: subprocess.Popen) -> Iterator[None]:
    """The process, where it has not ended, stands still meanwhile and writes nothing into what is removed."""
    process.send_signal(signal.SIGSTOP)
    if process.returncode is None:
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)


@pytest.mark.parametrize("verb", usually(["run"], WRITING))
def test_kills(verb, folder):
    """A process that is killed leaves whole files; the same command, called again, ends well and leaves no part."""
    for moment in moments(1, 12):
        process = start(COMMANDS[verb], folder)
        wait_until(process, moment)
        process.kill()
        process.communicate()
        assert process.returncode in (-signal.SIGKILL, 0)
        assert not list(broken(folder)), moment
    again = start(COMMANDS[verb], folder)
    _, errors = again.communicate()
    assert again.returncode == 0, errors
    assert not list(broken(folder)) and not list((folder / "out").rglob("*.part"))


@pytest.mark.parametrize("verb", usually(("run", "sweep", "diagnose", "tables"), COMMANDS))
def test_ctrl_c(verb, folder):
    """Ctrl-C ends any verb within 3 s with one word and exit code 130, and what is there is whole."""
    for moment in moments(1, 7):
        process = start(COMMANDS[verb], folder)
        wait_until(process, moment)
        started = time.perf_counter()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
        took = time.perf_counter() - started
        assert process.returncode in (130, 0), (moment, process.returncode, errors)
        if process.returncode:
            lines = [line for line in errors.splitlines() if not line.startswith("job ")]
            assert lines == ["invdyn: stopped"] and took < LONGEST, (moment, took, errors)
        assert not list(broken(folder)) and not list(folder.rglob("*.part")), moment


def refused(process: subprocess.Popen) -> None:
    """The process ends well, or with one line and exit code 2 (in a sweep, one for each job beside it)."""
    _, errors = process.communicate()
    lines = [line for line in errors.splitlines() if not line.startswith("job ")]
    assert process.returncode in (0, 2) and "Traceback" not in errors, errors
    assert len(lines) <= (process.returncode == 2) and bool(errors) == (process.returncode == 2), errors


@pytest.mark.parametrize("verb", usually(["run"], WRITING))
def test_files_that_cannot_grow(verb, folder, tmp_path):
    """Where a file may not grow as needed (quota, full disk): one line, exit code 2, nothing half written."""
    for _ in moments(1, 1):
        size = int(10 ** DRAWN.uniform(2, 5.5))
        refused(start(COMMANDS[verb], folder, size, XDG_CACHE_HOME=str(tmp_path / "cache")))
        assert not list(broken(folder)) and not list(folder.rglob("*.part")), size
        shutil.rmtree(folder / "out", ignore_errors=True)


@pytest.fixture
def full_disk(tmp_path) -> Iterator[Path]:
    """A disk of 2 MB."""
    place = tmp_path / "small"
    place.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)], capture_output=True)
    if done.returncode:
        pytest.skip("no small disk can be mounted here")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("verb", usually(["run"], WRITING))
def test_a_full_disk(verb, folder, full_disk):
    """The same on a disk that is as good as full."""
    for _ in moments(1, 1):
        left = int(10 ** DRAWN.uniform(3, 5.7))
        used = full_disk / "used"
        used.write_bytes(bytes(2_000_000 - left))
        out = [x.replace("=out", f"={full_disk}/out") for x in COMMANDS[verb]]
        refused(start(out, folder))
        used.unlink()
        assert not list(broken(full_disk)) and not list(full_disk.rglob("*.part")), left
        shutil.rmtree(full_disk / "out", ignore_errors=True)


@pytest.mark.parametrize("verb", usually(["simulate"], ["run", "check", "simulate"]))
def test_a_closed_pipe(verb, folder):
    """The reader of stdout (head) goes away: one line, exit code 2, and files that were written stay."""
    process = start(COMMANDS[verb], folder)
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    _, errors = process.communicate()
    assert process.returncode == 2 and errors.splitlines() == [
        "invdyn: the output pipe was closed; files already written are kept"
    ]
    assert not list(broken(folder))


@pytest.mark.parametrize("verb", usually(["check"], ["run", "check"]))
def test_a_terminal_that_knows_ascii(verb, folder):
    """Letters that it lacks are shown as ?; nothing fails for them."""
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
    process = start(COMMANDS[verb], folder, **ascii_only)
    out, errors = process.communicate()
    assert process.returncode == 0 and not errors and out.isascii() and "arm_joint_1" in out


@pytest.mark.parametrize("verb", usually(["run"], ["run", "diagnose"]))
def test_a_lost_folder(verb, folder):
    """The working directory is removed while a command works: it is made again, or one line says that it is gone."""
    for moment in moments(1, 6):
        place = shutil.copytree(folder, folder.parent / "lost")
        process = start(COMMANDS[verb], place)
        wait_until(process, moment)
        with paused(process):
            shutil.rmtree(place)
        refused(process)
        shutil.rmtree(place, ignore_errors=True)
