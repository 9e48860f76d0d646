"""What a newcomer types first and gets wrong: one line names the option that was wanted."""

from pathlib import Path

import pytest

MISTAKES = {
    "a file without an option": (["check", "run.csv"], "Try: data.path=run.csv"),
    "a URDF without an option": (["diagnose", "data.path=run.csv", "arm.urdf"], "Try: robot.path=arm.urdf"),
    "a URDF as a robot": (["check", "data.path=run.csv", "robot=arm.urdf"], "Try: robot=urdf robot.path=arm.urdf"),
    "a log for simulated data": (["run", "data.path=run.csv"], "Try: data=real_log data.path=…"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_the_wanted_option_is_named(case, command):
    """Exit code 2, one line, and in it what to type."""
    argv, advice = MISTAKES[case]
    Path("run.csv").touch()
    Path("arm.urdf").touch()
    said = command(*argv)
    assert said.code == 2 and len(said.err) == 1 and said.err[0].endswith(advice)
