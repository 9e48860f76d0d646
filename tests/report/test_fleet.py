"""The page of a fleet: order in time, what has changed and since when, and what is no change."""

from dataclasses import replace

import pytest

from invdyn_cli.report import fleet
from invdyn_cli.report.fleet import Diagnosed
from invdyn_cli.types import Finding, Quantity


def friction(size: float, half: float = 0.1) -> Finding:
    """A standard term of joint2."""
    quantity = Quantity(size, "N m", [size - half, size + half])
    return Finding("coulomb_friction", "joint2", "named", parameters={"coulomb": quantity}, group="standard")


def payload(**more) -> Finding:
    return Finding("payload", None, "named", **more)


def log(number: int, name: str, *findings: Finding, robot: str = "arm", verdict: str = "explained") -> Diagnosed:
    return Diagnosed(number, robot, name, f"{number}-{name}", verdict, findings=findings)


def test_logs_stand_in_time():
    """By the dates in their names where all of a robot's logs have one, with the time; else as they were given."""
    dated = [log(0, "arm_20260301.h5"), log(1, "arm-2026-01-10_0905.h5"), log(2, "arm-2026-01-10_0730.h5")]
    assert [x.number for x in fleet.by_robot(dated)["arm"]] == [2, 1, 0]
    assert dated[1].date == "2026-01-10 09:05"
    mixed = [log(0, "b.h5"), log(1, "arm-2026-01-10.h5")]
    assert [x.number for x in fleet.by_robot(mixed)["arm"]] == [0, 1]
    assert log(0, "run123456789.h5").date == ""


def test_what_has_changed_and_since_when():
    """A cause that comes, one that goes, and a size whose intervals do not meet are each dated by the first log that
    has it so; robots are kept apart, and failed logs between are passed over."""
    logs = [
        log(0, "a.h5", friction(1.0), Finding("backlash", "joint1", "named")),
        log(1, "b.h5", friction(1.05), Finding("backlash", "joint1", "named")),
        Diagnosed(2, "arm", "c.h5", "2", "failed", "not a log"),
        log(3, "d.h5", friction(2.0), payload()),
        log(4, "other.h5", robot="other"),
    ]
    assert fleet.change_lines(logs) == [
        "arm, since d.h5 (b.h5 before): new: payload",
        "arm, since d.h5 (b.h5 before): no longer found: backlash on joint1",
        "arm, since d.h5 (b.h5 before): Coulomb friction of joint2: coulomb from 1.05 N m to 2.00 N m",
    ]


def test_what_is_no_change():
    """Friction that only one log proves, the errors of the other being unknown; intervals that meet; a cause that the
    later log cannot show; one that was ambiguous with it before."""
    hidden = Finding("backlash", "joint1", "not_excited")
    either = Finding("base_tilt", None, "ambiguous", alternatives=(("payload",),))
    logs = [
        log(0, "a.h5", Finding("backlash", "joint1", "named"), either),
        log(1, "b.h5", friction(1.0), hidden, payload()),
        log(2, "c.h5", friction(1.15), hidden, payload()),
    ]
    assert fleet.change_lines(logs) == []
    [told] = fleet.change_lines([logs[2], log(3, "d.h5", Finding("backlash", "joint1", "named"), payload())])
    assert told.endswith("new: backlash on joint1 (not detectable in the log before, c.h5)")


@pytest.mark.parametrize(
    ("sizes", "error", "line"),
    [
        (None, 0.1, "new: Coulomb friction on joint2, 2.00 N m"),
        (None, 3.0, None),
        ((0.3, 0.2, 0.4), 3.0, "Coulomb friction of joint2 from 0.30 N m to 2.00 N m"),
        ((1.0, -0.5, 2.5), 0.1, None),
    ],
)
def test_friction_that_one_log_proves(sizes, error, line):
    """It is a change beside a log with another size of it, or with less error than it makes (1.9 N m); no change beside
    a log that hides it in its noise, or that leaves its size open. Backwards in time as forwards."""
    value, *ends = sizes or (0.0, 0.0, 0.0)
    terms = {("coulomb_friction", "joint2"): Quantity(value, "N m", ends)} if sizes else {}
    without = replace(log(0, "a.h5"), terms=terms, errors={"joint2": error})
    proved = log(1, "b.h5", replace(friction(2.0), evidence={fleet.TORQUE: {"joint2": 1.9}}))
    assert [x.text for x in fleet.changes([without, proved])] == ([line] if line else [])
    assert len(fleet.changes([proved, without])) == bool(line)


@pytest.mark.parametrize("names", [("mass",), ("mass", "moment")])
def test_a_link_that_one_log_proves(names):
    """It is told beside a log with less error than it makes, with its size where that is one number."""
    sizes = {name: Quantity(2.0, "kg", [1.5, 2.5]) for name in names}
    link = Finding("link_inertia_error", "joint2", "named", parameters=sizes, group="standard")
    proved = log(1, "b.h5", replace(link, evidence={fleet.TORQUE: {"joint2": 1.9}}))
    (told,) = fleet.changes([replace(log(0, "a.h5"), errors={"joint2": 0.1}), proved])
    assert told.text == "new: link inertia error on joint2" + ", 2.0 kg" * (len(names) == 1)


def test_the_page_links_and_escapes():
    """Each report is linked, a failed log has its sentence, and names from files stand as text."""
    logs = [log(0, "<b>.h5", payload(), robot="<i>"), Diagnosed(1, "", "x.h5", "1-x", "failed", "not <a> log")]
    page = fleet.page(logs)
    assert "<b>.h5" not in page and "<i>" not in page and "not <a> log" not in page
    assert "0-&lt;b&gt;.h5/report.html" in page and "1-x/report.html" not in page and "not &lt;a&gt; log" in page
    assert "2 logs of 1 robot, 1 of them not diagnosed" in page
