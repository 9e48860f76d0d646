"""Every kind of page in headless Chromium: three widths, light and dark, no error, nothing wider than the window.

Chromium is no dependency; where there is none, these tests are skipped with a word.
"""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from invdyn_cli import store
from invdyn_cli.report import (
    check_figures,
    check_page,
    check_plots,
    compared,
    control_page,
    controlled,
    diagnosis_figures,
    diagnosis_page,
    figures,
    page,
)
from invdyn_cli.report.checked_log import CheckedLog
from invdyn_cli.types import Prediction
from tests.diagnoses import make_diagnosis
from tests.diagnosis.sick import sound
from tests.records import make_record, make_robot
from tests.report.test_check_page import drawn_of, spoiled
from tests.report.test_controlled import record as control_record

WIDTHS = (1400, 800, 390)
KINDS = ("run", "adaptation", "check", "diagnosis", "comparison", "control")
PLOTTED = {"run": 1, "adaptation": 1, "check": 2, "diagnosis": 1, "comparison": 1, "control": 0}
"""Figures of each that zoom."""

MOST_BYTES = 3e6

PROBE = """<script>
const told = [];
window.addEventListener("error", e => told.push(e.message));
window.addEventListener("load", () => setTimeout(() => {
  const place = document.querySelector(".plots"), at = () => place.querySelector(".when").textContent;
  const root = document.documentElement;
  const found = { kind: KIND, width: innerWidth, errors: told, wide: root.scrollWidth - root.clientWidth,
    live: document.querySelectorAll("figure.live").length, ground: getComputedStyle(document.body).backgroundColor };
  if (place) {
    found.value = place.querySelector("output:not(.when)").textContent;
    found.drawn = [...place.querySelectorAll(".area")].every(x => x.offsetWidth > 100 && x.offsetHeight > 50);
    const canvas = place.querySelector(".body canvas + canvas"), before = at();
    canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
    found.moved = [before, at()];
  }
  parent.postMessage(JSON.stringify(found), "*");
}, 300));
</script>"""

HOST = """<!DOCTYPE html><html><body><script>
const got = [];
window.addEventListener("message", e => {
  got.push(e.data);
  document.getElementById("got").textContent = got.join("\\n");
});
</script><pre id="got"></pre>FRAMES</body></html>"""


def adapting():
    """A run that adapts, its test set in stages."""
    record = make_record(3)
    test = record.predictions["test"]
    stage = np.array(["approach"] * 200 + ["grasp"] * 200)
    data = replace(test.data, trajectories=tuple(replace(x, stage=stage) for x in test.data.trajectories))
    predictions = {"test": Prediction(data, test.tau), "test_adapted": Prediction(data, 0.5 * (test.tau + data.tau))}
    scores = {**record.scores, "test_adapted": record.scores["test"]}
    return replace(record, predictions=predictions, scores=scores)


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    """A page of every kind."""
    folder = tmp_path_factory.mktemp("pages")
    made = {kind: folder / kind / "report.html" for kind in KINDS}
    records = {"run": make_record(4), "adaptation": adapting()}
    for kind, record in records.items():
        page.write_page(record, figures.draw_all(record, folder / kind), made[kind])
    robot = make_robot(("a", "b", "c", "d"))
    log = spoiled(sound(robot, seconds=15, channels=("qd", "q_ref")))
    examination, drawn = drawn_of(log, robot)
    assert isinstance(drawn, CheckedLog)
    pictures, _ = check_figures.draw_all(drawn, folder / "check")
    made["check"].write_text(check_page.page(examination, log, robot, pictures, live=check_plots.all_plots(drawn)))
    diagnosis = make_diagnosis()
    pictures = diagnosis_figures.draw_all(diagnosis, folder / "diagnosis")
    diagnosis_page.write_report(diagnosis, "lbr", pictures, made["diagnosis"])
    runs = [
        compared.Compared(f"run {i}", store.plain(store.metrics(x)), x)
        for i, x in enumerate((records["run"], make_record(4, error=2.0)))
    ]
    compared.write_page(runs, folder / "comparison", "2 runs compared")
    control = control_record(1.0, 0.5)
    picture = folder / "control" / "control.png"
    controlled.draw(control, "m, a", [picture])
    made["control"].write_text(control_page.page(control, {"model": "m", "adaptation": "a"}, picture))
    return made


def seen(pages: dict[str, Path], folder: Path, *flags: str) -> tuple[dict[tuple[str, int], dict], list[str]]:
    """What the pages, each in frames of all widths, say of themselves, and the lines of the console."""
    chromium = next((x for x in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if x), None)
    if chromium is None:
        pytest.skip("there is no Chromium here: pages were not looked at (apt-get install chromium)")
    frames = ""
    for kind, path in pages.items():
        probed = folder / f"{kind}.html"
        probe = PROBE.replace("KIND", json.dumps(kind))
        probed.write_text(path.read_text("utf-8").replace("<head>", f"<head>{probe}", 1), "utf-8")
        frames += "".join(f'<iframe src="{probed.name}" width="{w}" height="900"></iframe>' for w in WIDTHS)
    host = folder / "host.html"
    host.write_text(HOST.replace("FRAMES", frames), "utf-8")
    told = subprocess.run(
        [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
         f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=30000", *flags, "--dump-dom", host.as_uri()],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    found = re.search(r'<pre id="got">(.*?)</pre>', told.stdout, re.DOTALL)
    assert found, told.stderr
    lines = [json.loads(x) for x in unescape(found[1]).splitlines() if x]
    return {(x["kind"], x["width"]): x for x in lines}, [x for x in told.stderr.splitlines() if "CONSOLE" in x]


@pytest.fixture(scope="module", params=["light", "dark"])
def looked(request, pages, tmp_path_factory):
    """What was seen of all pages, in light and in dark."""
    flags = ("--force-dark-mode", "--blink-settings=preferredColorScheme=0") if request.param == "dark" else ()
    return request.param, *seen(pages, tmp_path_factory.mktemp(request.param), *flags)


def test_no_error_and_nothing_is_too_wide(looked):
    """Every kind of page, at every width, in light and dark: its script runs to the end without an error, the console
    stays empty, all its plots are drawn, and no part is wider than the window."""
    theme, found, console = looked
    assert set(found) == {(kind, width) for kind in KINDS for width in WIDTHS}
    assert console == []
    for (kind, width), one in found.items():
        assert one["errors"] == [], (kind, width)
        assert one["wide"] == 0, (kind, width)
        assert one["live"] == PLOTTED[kind], (kind, width)
        assert one.get("drawn", True), (kind, width)
        assert one["ground"] == {"light": "rgb(255, 255, 255)", "dark": "rgb(21, 25, 29)"}[theme]


def test_the_cursor_tells_the_value(looked):
    """Beside the key stands the measured torque at the cursor, at first of the first sample; an arrow key moves it."""
    _, found, _ = looked
    one = found["run", 800]
    data = make_record(4).predictions["test"].data
    said = float(one["value"].replace("\N{MINUS SIGN}", "-"))
    assert said == pytest.approx(data.tau[0, 0], abs=2e-3)  # 65535 steps of a range of some 30 N m, four digits
    assert one["moved"][0] == "0.000 s in move_0" and one["moved"][1] == "0.040 s in move_0"  # 1/200 of two times 4 s


def test_pages_stay_small(pages):
    """No page is larger than MOST_BYTES."""
    assert {kind: path.stat().st_size for kind, path in pages.items() if path.stat().st_size > MOST_BYTES} == {}
