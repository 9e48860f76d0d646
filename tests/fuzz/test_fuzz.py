"""Whatever a file or an option holds, the answer is a result or one line that can be printed: never another exception.

A few hundred examples by default, the same ones each time; `make fuzz examples=100000` takes that many fresh ones.
"""

import os
import time
import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from invdyn_cli import store
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.diagnosis import doctor
from invdyn_cli.errors import InvdynError
from invdyn_cli.logfile import read_log, refuse_defects
from invdyn_cli.models.pest import Pest
from invdyn_cli.report import page
from invdyn_cli.robots import load_urdf, pinocchio_model
from tests.commands import python, script
from tests.fuzz import strategies
from tests.records import make_record

ASKED = int(os.environ.get("INVDYN_FUZZ_EXAMPLES", "0"))
SLOWEST = 10.0
"""[s] that any answer may take."""

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers beyond reason overflow on their way out


def examples(usual: int, part: float = 1.0) -> settings:
    """So many examples, the same ones each time; or a part of as many fresh ones as were asked for."""
    return settings(
        max_examples=int(part * ASKED) or usual,
        derandomize=not ASKED,
        database=None,
        deadline=None,
        print_blob=True,
        suppress_health_check=list(HealthCheck),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def answers(call):
    """What a call gives, or None where it is refused in one line that can be printed, in time."""
    started = time.perf_counter()
    try:
        return call()
    except InvdynError as error:
        line = str(error)
        assert len(line) < 1500 and not any(unicodedata.category(c).startswith("C") for c in line), repr(line)
        return None
    finally:
        assert time.perf_counter() - started < SLOWEST


@examples(100, 0.25)
@given(text=strategies.urdf_texts())
def test_urdfs(text, folder):
    """A URDF is refused, or gives a robot whose torques are finite."""
    import pinocchio as pin

    (folder / "arm.urdf").write_text(text, errors="replace")
    robot = answers(lambda: load_urdf(folder / "arm.urdf"))
    if robot is None:
        return
    model = pinocchio_model(robot)
    still = np.zeros(robot.dofs)
    tau = pin.rnea(model, model.createData(), still, still + 0.1, still + 0.1)
    assert np.isfinite(tau).all() and np.isfinite(robot.inertial).all() and np.isfinite(robot.axis).all()


@examples(100)
@given(changes=strategies.log_changes())
def test_logs(changes, folder):
    """A log is refused, or read, examined, corrected and learned from."""
    path = folder / "log.h5"
    path.write_bytes(strategies.log_bytes(changes))
    if answers(lambda: read_log(path)) is not None:
        answers(lambda: RealLog(str(path), filter_cutoff=None, derivatives="logged").load(None))
    log = answers(lambda: read_log(path, check=False))
    if log is None:
        return
    answer = answers(lambda: doctor.correct(log, None))
    assert answer is not None
    corrected, examination = answer
    if examination.usable:
        answers(lambda: refuse_defects(corrected))


@pytest.fixture(scope="module")
def sound(folder) -> Path:
    store.write_run(replace(make_record(3), model=Pest(), adaptation=Batch()), folder / "sound.h5")
    return folder / "sound.h5"


@examples(75, 0.1)
@given(changes=strategies.run_changes())
def test_runs(changes, folder, sound):
    """A run file is refused, or read, scored and shown on a page, with no code of its own."""
    path = folder / "run.h5"
    path.write_bytes(strategies.run_bytes(sound.read_bytes(), changes))
    record = answers(lambda: store.load_run(path))
    if record is not None:
        answers(lambda: store.metrics(record))
        answers(lambda: page.page(record, []))


@examples(8, 0.005)
@given(asked=strategies.commands())
def test_overrides(asked, command):
    """Options of any value are taken or refused in one line: exit code 0 to 2, no error of ours."""
    verb, overrides = asked
    said = command(verb, *overrides)
    assert said.code in (0, 1, 2), (said.err, overrides)
    assert said.code != 2 or len(said.err) == 1, said.err


MEASURED = """
import resource, subprocess, sys
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, timeout=60).returncode
print(code, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
"""Runs a command from a small process: the peak that the kernel counts for a child begins with its parent's memory."""


@examples(1, 0.01)
@given(changes=strategies.log_changes())
def test_the_command_line(changes, folder):
    """`invdyn check` on a damaged log ends with exit code 0, 1 or 2, below 2 GB, without a traceback."""
    (folder / "log.h5").write_bytes(strategies.log_bytes(changes))
    done = python("-c", MEASURED, script(), "check", "data.path=log.h5", cwd=folder)
    lines = done.stderr.splitlines()
    code, kilobytes = map(int, done.stdout.split())
    assert code in (0, 1, 2) and "Traceback" not in done.stderr, lines
    assert len(lines) <= 1, lines
    assert kilobytes < 2_000_000
