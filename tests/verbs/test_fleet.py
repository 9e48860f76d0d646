"""invdyn diagnose -m: a fleet, one page of all its logs."""

import csv
from pathlib import Path

from tests.logs import make_log, motion


def test_a_failing_log_is_a_row(command):
    """Of three logs one can be read (and is too short), one is not there and one is no log: each has a row with its
    verdict or its sentence, the page links the report that there is, and the exit code is 2."""
    joints = ["arm_joint_1", "arm_joint_2"]
    make_log(Path("arm-2026-01-10.h5"), {"run": motion(seconds=0.3)}, joint_names=joints, urdf=None, robot="arm 7")
    Path("broken.h5").write_text("nothing")
    logs = "data.path=arm-2026-01-10.h5,gone.h5,broken.h5"
    said = command("diagnose", "-m", "robot=apollo_arm", "robot.dofs=2", logs, "hydra.sweep.dir=fleet")
    assert said.code == 2
    assert said.out[-2:] == ["page: fleet/report.html", "fleet"]
    rows = list(csv.DictReader(Path("fleet/fleet.csv").read_text().splitlines()))
    assert [row["verdict"] for row in rows] == ["log_unusable", "failed", "failed"]
    assert [row["robot"] for row in rows] == ["arm 7", "", ""] and rows[0]["date"] == "2026-01-10"
    assert rows[1]["message"].startswith("no log gone.h5") and "broken.h5 is not an HDF5 file" in rows[2]["message"]
    page = Path("fleet/report.html").read_text()
    assert 'href="0-arm-2026-01-10/report.html"' in page and "broken.h5 is not an HDF5 file" in page
    assert Path("fleet/0-arm-2026-01-10/report.html").is_file()
