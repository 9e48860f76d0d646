import csv
import io
import math

import numpy as np
import pytest
from rich.console import Console

from invdyn_cli.report.tables import (
    SWEEP_FIELDS,
    round_by_error,
    score_table,
    significant,
    sweep_csv,
    sweep_table,
    units,
)
from tests.records import make_record

SWEEP = [
    dict(zip(SWEEP_FIELDS, job, strict=True))
    for job in (
        (0, "model=pest x=[1,2]", "ran", 0.1, 1 / 3, 12.5, "pest-12", ""),
        (1, "model=dbm", "failed", None, None, None, "", 'no "x", y'),
        (2, "model=ffnn", "kept", 1e-27, math.nan, 3.0, "ffnn", ""),
    )
]


def printed(table, width: int = 120) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


def test_score_table_has_every_number():
    """The score table shows NMSE and RMSE of every joint in every scored set, and their mean, with three digits."""
    record = make_record(5)
    text = printed(score_table(record, most=4))
    for score in record.scores.values():
        for value in (*score.nmse, *score.rmse, np.mean(score.nmse), np.mean(score.rmse)):
            assert significant(value) in text
    assert "mean" in text and all(joint in text for joint in record.fit.joints)


def test_validation_gives_way():
    """Where more sets were scored than the table may show, it leaves out validation, and no other."""
    record = make_record(2)
    for i, score in enumerate(record.scores.values()):
        score.rmse[0] = 111.0 * (i + 1)
    shown, whole = printed(score_table(record)), printed(score_table(record, most=4))
    assert significant(record.scores["validation"].rmse[0]) not in shown
    assert significant(record.scores["validation"].rmse[0]) in whole
    assert all(significant(record.scores[x].rmse[0]) in shown for x in ("train", "test", "test_clean"))


def test_score_table_fits_a_terminal():
    """Four scored sets fit into 80 columns without cutting a number."""
    record = make_record(3, joints=("right_shoulder_pitch", "j2", "j3"))
    record.scores["test"].nmse[:] = 1.234e-27
    text = printed(score_table(record, most=4), width=80)
    assert "…" not in text and text.count("1.23e-27") == 4


def test_score_table_counts_members():
    """A fit of several seeds says how far they lie apart; a fit of one does not."""
    assert "3 members" in printed(score_table(make_record(2, members=3)))
    assert "members" not in printed(score_table(make_record(2)))


def test_joint_without_variance():
    """A joint without an NMSE shows a dash, and the mean is taken over the others."""
    record = make_record(3)
    record.scores["test"].nmse[1] = np.nan
    text = printed(score_table(record, most=4))
    row = next(line for line in text.splitlines() if line.split()[:1] == ["joint2"])
    assert row.split()[5] == "-"
    assert significant((record.scores["test"].nmse[0] + record.scores["test"].nmse[2]) / 2) in text


def test_units_follow_the_joints():
    """A sliding joint is measured in N, the others in N m."""
    record = make_record(2, prismatic=(False, True))
    assert units(record) == ("N m", "N")
    assert "N for joint2" in " ".join(printed(score_table(record)).split())


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.12345, "0.123"),
        (9.999, "10.0"),
        (1234.5, "1230"),
        (0.001, "0.00100"),
        (0.00099949, "9.99e-04"),
        (1e-27, "1.00e-27"),
        (0.0, "0"),
        (math.inf, "inf"),
        (math.nan, "-"),
        (None, "-"),
        (-2.5, "-2.50"),
    ],
)
def test_significant(value, text):
    """Three significant digits; scientific below 1e-3; a dash for what is missing."""
    if value == 1234.5:
        assert float(significant(value)) == pytest.approx(value, rel=5e-3)
    else:
        assert significant(value) == text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.23456, 0.0123, "1.235 ± 0.012"),
        (123456.0, 4321.0, "123500 ± 4300"),
        (0.5, 0.0996, "0.50 ± 0.10"),
        (0.1, 2.34, "0.1 ± 2.3"),
        (-0.001, 0.5, "0.00 ± 0.50"),
        (-1.234e-5, 1.2e-7, "(-1.234 ± 0.012)e-05"),
        (0.0, 0.1, "0.00 ± 0.10"),
        (3.0, 0.0, "3"),
        (3.14159265, math.nan, "3.14159"),
        (math.nan, 0.1, "nan"),
    ],
)
def test_round_by_error(value, std, text):
    """A value ends where the second digit of its standard error does; without an error it keeps six digits."""
    assert round_by_error(value, std) == text


def test_sweep_table_shows_every_job():
    """Every job has a line, brackets in overrides are text and no markup, a failed job gives its reason."""
    text = printed(sweep_table(SWEEP))
    assert all(row["overrides"] in text for row in SWEEP)
    assert 'no "x", y' in text and "1.00e-27" in text


def test_drawn_numbers_are_shown_short():
    """What a search draws has four digits on the terminal; what somebody has typed stays as it is."""
    drawn = {**SWEEP[0], "overrides": "a.b=0.00020305160176882923 c=1.3520123456789e-05 d=0.000123 e=12.5"}
    assert "a.b=0.0002031 c=1.352e-05 d=0.000123 e=12.5" in printed(sweep_table([drawn]))


def test_sweep_table_without_messages():
    """Without a message there is no column for one; an empty sweep is an empty table."""
    assert "message" not in printed(sweep_table(SWEEP[:1]))
    assert "overrides" in printed(sweep_table([]))


def test_sweep_csv_round_trips():
    """What is written to CSV is read back to the same rows, to the last digit."""
    back = list(csv.DictReader(io.StringIO(sweep_csv(SWEEP))))
    assert len(back) == len(SWEEP)
    for got, row in zip(back, SWEEP, strict=True):
        assert tuple(got) == SWEEP_FIELDS
        for name, text in got.items():
            if row[name] is None:
                assert text == ""
            elif isinstance(row[name], float):
                assert float(text) == row[name] or (math.isnan(row[name]) and math.isnan(float(text)))
            else:
                assert text == str(row[name])
