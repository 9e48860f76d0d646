"""The data of plots: what is kept of long recordings, where lines are interrupted, and where the arm's joints are."""

import base64
import json
import re

import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.report.interactive import MOST_VALUES, Line, Panel, Timeline, plots
from invdyn_cli.report.posture import posture
from invdyn_cli.robots import load_urdf
from tests.records import make_robot


def data_of(text: str) -> dict:
    """What the page's script reads."""
    return json.loads(re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)[0])


def numbers(packed: dict) -> np.ndarray:
    """As the page's script unpacks them."""
    raw = base64.b64decode(packed["b"])
    if not packed["step"]:
        return np.frombuffer(raw, "<f4").astype(float)
    steps = np.frombuffer(raw, "<u2")
    return np.where(steps == 65535, np.nan, packed["low"] + steps * packed["step"])


def drawn(t, *lines, names=((0, "a"),)):
    made = data_of(
        plots(Timeline(t, names), [Panel("p", "y [N m]", [Line(str(i), y, "ink") for i, y in enumerate(lines)])])
    )
    return made, numbers(made["t"]), [numbers(x["y"]) for x in made["panels"][0]["lines"]]


@pytest.mark.parametrize("spike", [5.0, 1e6])
def test_numbers_come_back(spike):
    """A short recording is kept whole, to a 65534th of its range, or, with a spike that is far out, to float32."""
    t = 0.01 * np.arange(500)
    y = np.sin(t)
    y[100], y[200] = spike, np.nan
    made, times, [found] = drawn(t, y)
    assert made["every"] == 1 and times == pytest.approx(t, abs=5 / 65534)
    assert np.isnan(found[200]) and found[100] == pytest.approx(spike, rel=1e-6)
    assert np.delete(found, 200) == pytest.approx(np.delete(y, 200), abs=(spike + 1) / 65534 if spike < 10 else 1e-7)


def test_no_peak_is_lost():
    """Of a recording that is far too long a single high and a single low sample are drawn, near their times, and the
    figure keeps within its room."""
    t = 0.001 * np.arange(600_000)
    y = np.sin(t)
    y[123_457], y[400_001] = 9.0, -7.0
    made, times, [found, _] = drawn(t, y, np.cos(t))
    assert made["every"] > 1 and 3 * len(times) <= MOST_VALUES
    for row, peak in ((123_457, 9.0), (400_001, -7.0)):
        at = int(np.nanargmin(np.abs(found - peak)))
        assert found[at] == pytest.approx(peak, abs=1e-3)
        assert times[at] == pytest.approx(t[row], abs=made["every"] * 0.001 + 600 / 65534)


def test_recordings_follow_each_other_and_gaps_break_lines():
    """A second recording goes on where the first ends, whatever its clock says; between both, and in a gap of the
    clock, a line is interrupted; the parts say how to come back to a recording's own time."""
    t = np.r_[10 + 0.1 * np.arange(20), 500 + 0.1 * np.arange(10), 505 + 0.1 * np.arange(10)]
    made, times, [found] = drawn(t, np.ones(40), names=((0, "a"), (20, "b")))
    assert [x[0] for x in made["parts"]] == ["a", "b"] and made["start"] == 10
    _, at, more = made["parts"][1]
    assert at == pytest.approx(2.0) and at + made["start"] + more == pytest.approx(500)
    assert np.isnan(found).sum() == 2 and len(found) == 42
    assert times[-1] == pytest.approx(2.0 + 5.9, abs=1e-3) and (np.diff(times) >= 0).all()


def test_names_cannot_end_the_script():
    """A recording called like an end tag stays a name."""
    text = plots(Timeline(np.arange(3.0), [(0, "</script><b>")]), [], label="</script>")
    assert text.count("</script>") == 1 and data_of(text)["parts"][0][0] == "</script><b>"


def test_the_arm_stands_where_its_joints_are():
    """Base and joints lie where Pinocchio puts the joint frames, for postures all over the ranges."""
    robot = load_urdf("apollo_arm")
    model = pin.buildReducedModel(*_locked(robot))
    data = model.createData()
    q = np.random.default_rng(3).uniform(-1, 1, (50, robot.dofs))
    found = posture(robot, Timeline(np.arange(50.0), [(0, "a")]), q)
    assert found is not None and found.parents[:3] == [-1, 0, 1]
    for k in (0, 17, 49):
        row = int(np.searchsorted(found.t, k))
        pin.forwardKinematics(model, data, q[k])
        expected = np.array([data.oMi[model.getJointId(x)].translation for x in robot.joints])
        assert found.points[row, 0] == pytest.approx(np.zeros(3))
        assert found.points[row, 1 : 1 + robot.dofs] == pytest.approx(expected, abs=1e-6)


def test_up_is_against_gravity():
    """An arm that hangs from a ceiling or a wall is drawn so: z is up."""
    for gravity in ([0, 0, 9.81], [9.81, 0, 0], [0, -9.81, 0]):
        robot = make_robot(("a", "b"))
        hung = type(robot)(**{**vars(robot), "gravity": np.array(gravity, float)})
        found = posture(hung, Timeline(np.arange(3.0), [(0, "a")]), np.zeros((3, 2)))
        assert found is not None
        down = np.array([0, 0, 0.6]) @ np.array(gravity) / 9.81  # the second joint is 0.6 m along the base's z
        assert found.points[0, 2, 2] == pytest.approx(-down) and np.linalg.norm(found.points[0, 2]) == pytest.approx(
            0.6
        )


def _locked(robot):
    model = pin.buildModelFromXML(robot.urdf)
    return model, [i for i in range(1, model.njoints) if model.names[i] not in robot.joints], pin.neutral(model)
