import io
import math
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from invdyn_cli.diagnosis.decide.wording import in_table, summary
from invdyn_cli.effects.catalogue import EFFECTS as CATALOGUE
from invdyn_cli.report.diagnosis_tables import (
    each_log_table,
    error_table,
    finding_table,
    standard_table,
    unclaimed_line,
    unseen_line,
    verdict_line,
)
from invdyn_cli.report.model_sections import standard_section, unclaimed_section
from invdyn_cli.report.quantities import best_gain, gain_text, in_degrees, quantity_text, unit_text
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import cause, claims, estimates, headline_of, joints_of, place, rivals_of, when
from invdyn_cli.types import Finding, Gain, Quantity
from tests.diagnoses import JOINTS, log_unusable, make_diagnosis, nothing_found


def printed(*things, width: int = 100) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    for x in things:
        console.print(x)
    return console.export_text()


def test_terminal_says_every_cause():
    """Every claim is in the table with its joint and its gain, in 100 columns, and no word is cut."""
    diagnosis = replace(make_diagnosis(), standard={})
    text = printed(finding_table(diagnosis))
    assert max(map(len, text.splitlines())) <= 100 and "…" not in text
    for x in claims(diagnosis):
        assert place(x) in text and gain_text(x.gain[best_gain(x.gain)]) in text
    assert "2.00 N m [1.98, 2.02]" in text and "joint2; 7 joints gain" in text


UNCLAIMED = (
    Finding("base_tilt", None, "unclaimed", parameters={"angle": Quantity(0.031, "rad", [0.02, 0.04])}),
    Finding(
        "presliding_hysteresis",
        "joint3",
        "unclaimed",
        parameters={"coulomb": Quantity(0.25, "N m", [0.2, 0.3])},
        evidence={"in_place_of": ("coulomb_friction",)},
    ),
)


def test_what_is_not_claimed_is_told():
    """Effects in the model that nobody claims are a line on the terminal, a table of their own on the page, and counted
    in the summary; they are no causes. Without them there is neither."""
    diagnosis = replace(make_diagnosis(), unclaimed=UNCLAIMED)
    assert "without being claimed" in printed(unclaimed_line(diagnosis))
    assert "base tilt; presliding hysteresis on joint3." in " ".join(
        printed(unclaimed_line(diagnosis), width=80).split()
    )
    said = unclaimed_section(diagnosis)
    assert all(x in said for x in ("Base tilt", "joint3", "[0.2", "in place of Coulomb friction", "No claims are made"))
    assert claims(diagnosis) == claims(make_diagnosis())
    assert "With these effects, and 2 less certain ones only in the written model, its" in summary(diagnosis, CATALOGUE)
    assert unclaimed_line(make_diagnosis()) is None and unclaimed_section(make_diagnosis()) == ""


def test_what_every_arm_has_is_one_table():
    """The standard terms of all joints stand in one table that fits 80 columns, with units; a named one among them is
    no row among the causes. Without them there is no table, and it is a row again."""
    diagnosis = make_diagnosis()
    text = printed(standard_table(diagnosis), width=80)
    assert "[N m]" in text and all(joint in text for joint in JOINTS) and max(map(len, text.splitlines())) <= 80
    (row,) = (line for line in text.splitlines() if "joint2" in line)
    assert row.split() == ["joint2", "-0.100", "1.50"]
    bare = replace(diagnosis, standard={})
    assert standard_table(bare) is None
    rows = [[str(x) for x in next(iter(finding_table(d).columns)).cells] for d in (diagnosis, bare)]
    assert set(rows[1]) - set(rows[0]) == {"Coulomb friction"}


def test_ambiguous_causes_say_or():
    """What the log leaves open is said as 'X or Y', and marked."""
    cause, joint, *_ = finding_table(make_diagnosis()).columns
    said = "Torque offset or asymmetric Coulomb friction or joint spring + Coulomb friction"
    assert str(list(cause.cells)[-1]) == said and str(list(joint.cells)[-1]) == "joint6\nambiguous"


def test_a_window_is_told():
    """What comes and goes is told with its trajectory and its window, in the table and in the headline; what lasts with
    none."""
    gain = {"gain": Quantity(0.8, "-", (0.79, 0.81))}
    finding = Finding("torque_gain_change", "joint2", "named", parameters=gain)
    timed = replace(finding, trajectory="trajectory_1", window=(8.0, 14.0))
    again = replace(timed, evidence={"again": [[20.0, 25.0]]})
    assert (when(finding), when(timed)) == ("", "8.00 to 14.0 s of trajectory_1")
    assert when(again) == "8.00 to 14.0 s, 20.0 to 25.0 s of trajectory_1"
    text = printed(finding_table(replace(make_diagnosis(), findings=(timed,))))
    assert "8.00 to 14.0 s of trajectory_1" in " ".join(text.split())
    said = headline_of(timed).replace("\N{NO-BREAK SPACE}", " ")
    assert said == "torque gain change, gain 0.800 [0.790, 0.810], 8.00 to 14.0 s of trajectory_1"
    assert " s of " not in headline_of(finding).replace("\N{NO-BREAK SPACE}", " ")


def test_many_rivals_are_counted():
    """A headline names two rivals and counts the others; each comes once, its own name is another joint's."""
    names = ("stribeck_friction", "coulomb_friction", "payload", "base_tilt", "stribeck_friction")
    finding = Finding("coulomb_friction", "joint1", "ambiguous", alternatives=tuple((x,) for x in names))
    assert rivals_of(finding) == ["Stribeck friction", "the same on another joint", "payload", "base tilt"]
    assert cause(finding) == "Coulomb friction or Stribeck friction or the same on another joint or 2 others"


def test_what_cannot_be_known_is_no_estimate():
    """A parameter without a value is left out of the estimates, and the others keep their names."""
    parameters = {"mass": Quantity(1.0, "kg", (0.9, 1.1)), "inertia": Quantity(None, "kg m²", None)}
    finding = Finding("link_inertia_error", "joint1", "named", parameters=parameters)
    assert estimates(finding) == ["mass 1.00 kg [0.90, 1.10]"]


def test_a_single_block_has_no_interval():
    """A gain of one held-out block is shown without an interval, not with one of no width."""
    assert gain_text(Gain(1.0, 0.5, 0.0, 0.0, (0.5, 0.5))) == "0.500"


def test_blind_spots_are_below_the_table():
    """What the log could not have shown is named below the table, all joints in two words."""
    text = " ".join(printed(finding_table(make_diagnosis())).split())
    assert "This log cannot show: Stribeck friction (joint3" in text and "rotor inertia (all joints)" in text


def test_a_blind_joint_is_named_once():
    """An effect that a joint may have twice, as an offset of either of its encoders, names the joint once."""
    made = make_diagnosis()
    twice = [Finding("encoder_offset", joint, "not_excited") for joint in ("joint3", "joint1", "joint3")]
    text = unseen_line(replace(made, findings=tuple(twice)))
    assert text == "This log cannot show: encoder offset (joint3, joint1)."


def test_error_table_has_every_number():
    """Errors before, after and of the baselines, noise floor and unexplained share of every joint are there."""
    diagnosis = make_diagnosis()
    lines = [diagnosis.baselines[name] for name in ("friction", "standard")]
    text = printed(error_table(diagnosis))
    for joint in joints_of(diagnosis):
        row = next(line for line in text.splitlines() if line.split()[:1] == [joint])
        tables = (diagnosis.baseline, *lines, diagnosis.extended, diagnosis.noise_floor)
        shown = [significant(table[joint]["rmse"]) for table in tables]
        assert row.split()[1:] == [*shown, f"{100 * diagnosis.unexplained[joint]:.0f}", "%"]


def test_the_error_table_fits_80_characters():
    """No number is cut, and no name of eleven characters is folded, in the width that a pipe has."""
    diagnosis = make_diagnosis(joints=tuple(f"arm_joint_{k}" for k in range(7)))
    lines = printed(error_table(diagnosis), width=80).splitlines()
    assert max(map(len, lines)) <= 80 and "…" not in "".join(lines)
    assert {line.split()[0] for line in lines if line.startswith(" arm")} == set(joints_of(diagnosis))


def test_names_are_no_markup():
    """Joints and effects that look like rich's markup are shown as they are, and odd ones still fit."""
    joints = ("[red]", "[/]", "right_shoulder_pitch_joint_of_the_left_arm", "d", "e", "f", "g")
    text = printed(finding_table(make_diagnosis(joints=joints)), error_table(make_diagnosis(joints=joints)))
    assert "[red]" in text and "[/]" in text and max(map(len, text.splitlines())) <= 100


def test_verdicts():
    """The verdict comes in words, then the summary; tables of diagnoses without causes or joints can be printed."""
    assert printed(verdict_line(make_diagnosis())).startswith("Partly explained. Five causes explain")
    for diagnosis in (nothing_found(), log_unusable()):
        text = printed(verdict_line(diagnosis), finding_table(diagnosis), error_table(diagnosis))
        assert text.startswith(("Nothing found. ", "Log unusable. ")) and "none" in text
    assert printed(verdict_line(replace(log_unusable(), summary=""))).strip() == "Log unusable."
    left = replace(nothing_found(), unexplained={"joint1": 0.4})
    assert printed(verdict_line(left)).startswith("Nothing found that is in the catalogue. ")


@pytest.mark.parametrize(
    ("quantity", "text"),
    [
        (Quantity(2.0034, "N m", (1.981, 2.021)), "2.00 N m [1.98, 2.02]"),
        (Quantity(2.0034, "N m", (1.991, 2.015)), "2.003 N m [1.991, 2.015]"),
        (Quantity(2.0034, "N m", (1.0, 3.0)), "2.0 N m [1.0, 3.0]"),
        (Quantity(1234.5, "N m/rad", (1100.0, 1400.0)), "1234 N m/rad [1100, 1400]"),
        (Quantity(2.0034, "N m"), "2.00 N m"),
        (Quantity(2.0034, "N m", (None, None)), "2.00 N m"),
        (Quantity(0.006, "s", (0.0057, 0.0063)), "6.0 ms [5.7, 6.3]"),
        (Quantity(0.3, "kg m^2", (0.25, 0.35)), "0.30 kg m² [0.25, 0.35]"),
        (Quantity(-0.4, "-", (-0.5, -0.3)), "−0.40 [−0.50, −0.30]"),
        (Quantity(np.array([0.1, 0.02]), "m", ((0.08, 0.12), (-0.01, 0.05))), "(0.10 ± 0.02, 0.02 ± 0.03) m"),
        (
            Quantity([0.1, 0.02, 0.3], "m", ((0, -0.01, 0.2), (0.2, 0.05, 0.4))),
            "(0.10 ± 0.10, 0.02 ± 0.03, 0.30 ± 0.10) m",
        ),
        (Quantity([0.1, 2.0], "m"), "(0.10, 2.00) m"),
        (Quantity("link4", "-"), "link4"),
        (Quantity(None, "-"), "-"),
        (Quantity(math.nan, "N m", (math.nan, math.nan)), "- N m"),
        (Quantity(1.0, "N m", (0.5, math.inf)), "1.00 N m [0.500, ∞]"),
        (Quantity(3e-7, "N m", (2e-7, 4e-7)), "3.00e−07 N m [2.00e−07, 4.00e−07]"),
        (Quantity(0.0, "N m", (-0.1, 0.1)), "0.00 N m [−0.10, 0.10]"),
    ],
)
def test_quantities_are_rounded_by_their_interval(quantity, text):
    """A value ends where half of its interval has its first digit, or its second after a one; lists likewise."""
    assert quantity_text(quantity) == text


def test_angles_in_degrees():
    """Angles are said in degrees too, other quantities are not."""
    assert in_degrees(Quantity(math.pi / 180, "rad", (0.5 * math.pi / 180, 1.5 * math.pi / 180))) == "1.0° [0.5, 1.5]"
    assert (
        in_degrees(Quantity(1.0, "N m")) == in_degrees(Quantity([1.0], "rad")) == in_degrees(Quantity("x", "rad")) == ""
    )


def test_units_in_type():
    """Powers are set high, a pure number has no unit."""
    assert unit_text("N m s^2/rad^2") == "N m s²/rad²" and unit_text("-") == "" and unit_text("s^-1") == "s⁻¹"


def test_best_gain_passes_over_nan():
    """The joint that gains most is found among those with a number."""
    some = Gain(1.0, 0.5, 0.0, 0.0, (0.4, 0.6))
    gains = {JOINTS[0]: replace(some, rmse_before=math.nan), JOINTS[1]: some, JOINTS[2]: replace(some, rmse_after=0.9)}
    assert best_gain(gains) == JOINTS[1] and best_gain({}) is None


def test_friction_that_may_fall_with_speed_is_a_term_with_a_star():
    """Beside an alternative that has it as a special case a standard term stays in the table by joint, marked on the
    terminal and the page; beside another it is a cause."""
    diagnosis = make_diagnosis()
    (friction,) = in_table(diagnosis)
    open_one = replace(friction, status="ambiguous", alternatives=(("stribeck_friction",),))
    others = tuple(open_one if x is friction else x for x in diagnosis.findings)
    row = diagnosis.standard[friction.joint]
    marked = row["coulomb"] | {"claimed": False, "perhaps": ["stribeck_friction"]}
    standard = diagnosis.standard | {friction.joint: row | {"coulomb": marked}}
    starred = replace(diagnosis, findings=others, standard=standard)
    assert in_table(starred) == (open_one,)
    text = " ".join(printed(standard_table(starred)).split())
    assert "1.50*" in text and "*: or Stribeck friction." in text
    assert "or Stribeck friction</small>" in standard_section(starred)
    assert "*" not in printed(standard_table(diagnosis))
    assert "Coulomb friction" in printed(finding_table(replace(starred, standard={})))


def compared(changes):
    """The diagnosis with Coulomb friction of each log: 1.5 N m in the reference, and as much more now."""
    diagnosis = make_diagnosis()
    rows = {
        joint: row
        | {
            "coulomb": row["coulomb"]
            | {"reference": (1.5, 1.4, 1.6), "now": (1.5 + x, 1.4 + x, 1.6 + x), "differ": abs(x) > 0.3}
        }
        for (joint, row), x in zip(((j, diagnosis.standard[j]) for j in JOINTS), changes, strict=True)
    }
    return replace(diagnosis, standard=diagnosis.standard | rows)


def test_what_each_log_of_a_comparison_has():
    """On the terminal a row for each size that differs, with its change; a line where none does; on the page all, those
    that differ bold. Without a reference neither."""
    diagnosis = compared([-0.6, 0.1, 0.0][: len(JOINTS)] + [0.0] * (len(JOINTS) - 3))
    text = printed(each_log_table(diagnosis), width=80)
    (row,) = (line for line in text.splitlines() if "joint1" in line)
    assert "1.50 ± 0.10" in row and "0.90 ± 0.10" in row and row.rstrip().endswith("\N{MINUS SIGN}40 %")
    assert "joint2" not in text and max(map(len, text.splitlines())) <= 80
    page = standard_section(diagnosis)
    assert f"1 of {len(JOINTS)} differ" in page and "<b>\N{MINUS SIGN}40 %</b>" in page and "+7 %" in page
    same = printed(each_log_table(compared([0.1] * len(JOINTS))))
    assert "no offset and no friction differs" in " ".join(same.split())
    assert each_log_table(make_diagnosis()) is None and "in the reference" not in standard_section(make_diagnosis())


def test_the_summary_names_every_cause_that_is_a_row():
    """What stands in the table by joint is summed up where it is more than two; a link that is wrong by itself is no
    term of it, and is told."""
    diagnosis = make_diagnosis()
    link = Finding("link_inertia_error", "joint3", "named", group="standard")
    said = summary(replace(diagnosis, findings=(link, *diagnosis.findings)), CATALOGUE)
    assert "link inertia error on joint3" in said and "Coulomb friction on " in said and "standard terms" not in said
    (friction,) = in_table(diagnosis)
    said = summary(replace(diagnosis, findings=(friction,) * 3), CATALOGUE)
    assert "lacks standard terms (friction and the like) on 1 joint." in said


def test_a_term_that_another_effect_has_a_share_of():
    """The table says whose share is in it."""
    diagnosis = make_diagnosis()
    joint = JOINTS[0]
    row = diagnosis.standard[joint]
    summed = row | {"coulomb": row["coulomb"] | {"with": ["presliding_hysteresis"]}}
    told = replace(diagnosis, standard=diagnosis.standard | {joint: summed})
    sentence = "Coulomb friction includes that of presliding hysteresis on the same joint."
    assert sentence in " ".join(printed(standard_table(told)).split()) and sentence in standard_section(told)
    assert "includes" not in printed(standard_table(diagnosis)) + standard_section(diagnosis)
