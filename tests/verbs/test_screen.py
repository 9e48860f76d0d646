"""Progress where stderr is no terminal: lines with the step and the time left, and none of work that is soon done."""

import re
import time

import pytest

from invdyn_cli.verbs import screen
from tests.commands import TINY


@pytest.fixture(autouse=True)
def hurried(monkeypatch):
    """Two tenths of a second stand for two seconds."""
    monkeypatch.setattr(screen, "QUIET", 0.2)
    monkeypatch.setattr(screen, "INTERVAL", 0.5)
    monkeypatch.delenv(screen.SWITCH, raising=False)


def test_soon_done_is_silent(capfd):
    """Nothing is written of work that ends before."""
    with screen.stages() as stage:
        stage("learn")(0.5, "half")
    assert capfd.readouterr() == ("", "")


def test_every_step_and_the_time_left(capfd):
    """A line for each step that lasts, on stderr alone, with the time left where a share is known; no control
    characters, and none after the end."""
    with screen.stages() as stage:
        stage("read")
        time.sleep(0.8)
        report = stage("learn")
        time.sleep(0.4)
        report(0.2, "loss 0.1\x1b[2J")
        time.sleep(1.3)
    time.sleep(0.5)
    out, err = capfd.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert lines[0].startswith("invdyn: read, ") and lines[0].endswith(" s so far")
    assert re.search(r"invdyn: learn 20 %, about [12] s left \(loss 0.1\?\[2J\)", err)
    assert 3 <= len(lines) <= 7 and "\x1b" not in err and "\r" not in err


def test_time_left(monkeypatch):
    """In proportion to the share when that changes, in minutes where it is long; none of a step that is done."""
    now = [0.0]
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])

    def line(share: float, after: float, note: str = "") -> str:
        now[0] = 0.0
        clock = screen.Clock()
        now[0] = after
        clock.report(share)
        return screen.progress_line("fit", clock, note)

    assert line(0.25, 10) == "fit 25 %, about 30 s left"
    assert line(0.01, 60, "x") == "fit 1 %, about 99 min left (x)"
    assert line(1.0, 60) == "fit 100 %"
    assert line(0.0, 7) == "fit, 7 s so far"


def test_the_time_left_falls_while_the_share_stays(monkeypatch):
    """A search that reports 50 % once and works on: the time left falls with the clock, and where it is over, the time
    so far is told; it never climbs."""
    now = [0.0]
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])
    clock = screen.Clock()
    now[0] = 20.0
    lines = []
    for seconds in (20.0, 30.0, 39.0, 41.0, 200.0):
        now[0] = seconds
        clock.report(0.5)
        lines.append(screen.progress_line("search", clock, ""))
    assert lines == [
        "search 50 %, about 20 s left",
        "search 50 %, about 10 s left",
        "search 50 %, about 1 s left",
        "search 50 %, 41 s so far",
        "search 50 %, 3 min so far",
    ]


def test_it_can_be_turned_off(capfd, monkeypatch):
    """INVDYN_PROGRESS=off writes nothing."""
    monkeypatch.setenv(screen.SWITCH, "off")
    with screen.stages() as stage:
        stage("learn")
        time.sleep(0.5)
    assert capfd.readouterr().err == ""


def test_a_long_run_says_where_it_is(command, monkeypatch):
    """A run of some steps tells each on a stderr that is no terminal, and nothing of them on stdout."""
    monkeypatch.setenv(screen.SWITCH, "auto")
    said = command("run", "model=ffnn", "model.epochs=100", *TINY)
    assert said.code == 0 and "invdyn: " not in "\n".join(said.out)
    lines = [line for line in said.err if line.startswith("invdyn: learn")]
    assert lines and any(" left" in line or " so far" in line for line in lines)
