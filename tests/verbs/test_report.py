"""invdyn report: figures and page drawn anew from a run.h5."""

from pathlib import Path

from tests.commands import TINY


def test_a_run_is_drawn_anew(command):
    """The page and the pictures come again from run.h5 alone, for a run with a robot, in a folder with an odd name."""
    folder = Path("model=pest,it's one")
    assert command("run", "model=pest", *TINY, r"hydra.run.dir='model=pest,it\'s one'").code == 0
    page = (folder / "report.html").read_text()
    for path in (*(folder / "figures").iterdir(), folder / "report.html"):
        path.unlink()
    said = command("report", str(folder))
    assert said.code == 0, said.err
    assert (folder / "report.html").read_text().count("<figure>") == page.count("<figure>") >= 3
    assert "arm_joint_1" in page and said.out[-1] == str(folder / "report.html")


def test_no_run(command):
    """A folder without a run is told in one line."""
    said = command("report", "nothing")
    assert said.code == 2 and len(said.err) == 1 and "no run at" in said.err[0]
