import re
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.report.figures import draw_all
from invdyn_cli.report.page import page, remarks, summary, write_page
from invdyn_cli.report.tables import round_by_error, significant
from invdyn_cli.types import Score
from tests.records import CONFIG, make_record
from tests.report.reader import Reader


def without_data(text: str) -> str:
    """A page without its pictures and the numbers of its plots."""
    return re.sub(r"base64,[^\"]*|\"b\":\"[^\"]*\"", "", text)


def scored(record, **sets):
    """The record with other errors: one NMSE for all joints of a set, RMSE 1."""
    joints = record.fit.joints
    return replace(
        record, scores={k: Score(joints, np.full(len(joints), v), np.ones(len(joints))) for k, v in sets.items()}
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A run with every part that a page can have, and its page."""
    folder = tmp_path_factory.mktemp("page")
    record = make_record(4, members=2, warnings=("The fit is shaky.",))
    path = write_page(record, draw_all(record, folder), folder / "report.html")
    return record, path


def test_page_is_whole(written):
    """The page parses, every tag closes in order, its one script stands last, and nothing but the page is left in the
    folder."""
    _, path = written
    tags = Reader(path.read_text("utf-8")).tags
    assert tags.count("html") == 1 and tags.count("img") == 5
    assert tags.count("script") == 2 and tags[-1] == "script"  # the plots' data, and what draws them
    assert {x.suffix for x in path.parent.iterdir()} == {".png", ".html"}


def test_page_needs_nothing_else(written):
    """No address, no file: every src holds its data, no style is fetched."""
    _, path = written
    text = path.read_text("utf-8")
    assert all(value.startswith("data:image/png;base64,") for name, value in Reader(text).attributes if name == "src")
    assert not re.search(r"https?:|//[a-z]|url\(|@import|<link", without_data(text))


def test_page_has_every_number(written):
    """Every joint's NMSE and RMSE in every set, every base parameter, warnings, notes, split, provenance, config."""
    record, path = written
    text = "\n".join(Reader(path.read_text("utf-8")).pieces)
    for score in record.scores.values():
        assert all(significant(x) in text for x in (*score.nmse, *score.rmse, score.nmse.mean()))
    base = record.fit.details["base_parameters"]
    assert all(round_by_error(v, s) in text for v, s in zip(base["values"], base["std"], strict=True))
    said = (
        *record.fit.joints,
        *base["names"],
        *base["expressions"],
        *record.fit.warnings,
        *record.fit.robot.notes,
        record.digest,
        CONFIG,
    )
    assert all(x in text for x in (*said, "amplitude 0.1, amplitude 0.2", "versions.jax", "abc1234", "32 of 40"))


def test_everything_is_escaped(tmp_path):
    """Names, warnings, notes and configs that look like HTML are shown and not obeyed."""
    bad = "<b>x</b>&\"'"
    record = make_record(
        2, joints=("<b>", "j2"), warnings=(bad,), choices={"model": bad, "data": bad, "adaptation": bad, "seed": bad}
    )
    details = {**record.fit.details, bad: bad, "base_parameters": {"names": [bad], "values": [1.0], "std": [0.1]}}
    robot = replace(record.fit.robot, name=bad, notes=(bad,))
    fit = replace(record.fit, details=details, robot=robot)
    record = replace(
        record, fit=fit, split={bad: [bad]}, provenance={bad: {bad: bad}}, config=bad, overrides=(bad,), digest=bad
    )
    text = write_page(record, draw_all(record, tmp_path), tmp_path / "report.html").read_text("utf-8")
    reader = Reader(text)
    assert "<b>x" not in text and "<td><b></td>" not in text and "<td>&lt;b&gt;</td>" in text
    assert any(bad in x for x in reader.pieces)


def test_page_without_extras():
    """No figures, no robot, no config, no validation, empty details: still a page that parses."""
    record = make_record(1, epochs=0, pest=False)
    bare = replace(
        record, fit=replace(record.fit, robot=None), predictions={}, config="", split={}, provenance={}, overrides=()
    )
    assert "No robot description was used." in Reader(page(bare, [])).text
    Reader(page(replace(bare, scores={}), []))


def test_write_is_all_or_nothing(tmp_path):
    """A page that cannot be made leaves the old one as it was, and no half of a new one."""
    path = tmp_path / "report.html"
    path.write_text("old")
    with pytest.raises(FileNotFoundError):
        write_page(make_record(1), [tmp_path / "missing.png"], path)
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("train", "test", "said"),
    [
        (0.01, 0.05, "5.00 times the training error (0.0100)"),
        (0.05, 0.06, "about the same"),
        (0.3, 0.1, "less than the training error"),
        (1e-27, 3e-26, "exact here"),
        (0.0, 0.2, "inf times"),
        (0.1, 1.5, "no better than a constant torque"),
        (0.1, np.nan, "no NMSE can be given"),
        (np.nan, 0.1, "no training error"),
    ],
)
def test_summary_reads_the_numbers(train, test, said):
    """The summary says how the test error compares with the training error, and survives zeros and NaN."""
    assert said in summary(scored(make_record(3), train=train, test=test))


def test_summary_names_the_worst_joint():
    """The worst joint is named with its NMSE and its RMSE in its own unit; joints without NMSE are passed over."""
    record = make_record(3, prismatic=(False, False, True))
    score = Score(record.fit.joints, np.array([0.1, np.nan, 0.4]), np.array([1.0, 9.0, 2.5]))
    text = summary(replace(record, scores={"test": score}))
    assert "worst joint is joint3 (NMSE 0.400, RMSE 2.50 N)" in text and "NMSE on the test set is 0.250" in text


def test_remarks_tell_what_is_missing():
    """A joint without variance and a prediction that is not finite are said in words."""
    record = make_record(3)
    score = Score(record.fit.joints, np.array([0.1, np.nan, np.nan]), np.array([1.0, 0.0, np.nan]))
    first, second = remarks(replace(record, scores={"test": score}))
    assert "joint2 never changes" in first and "joint3 is not finite" in second


def test_predictions_that_are_no_numbers_are_told():
    """A joint that diverged on the test set: no mean over the others, no worst among them, and not as if its torque
    never changed; a joint whose torque never changes still leaves a mean."""
    made = make_record(2)
    for nmse, rmse, words in (
        ([np.nan, 0.25], [np.nan, 1.0], "not finite, so no"),
        ([np.nan, 0.25], [1.0, 1.0], "mean NMSE on the test set is 0.250"),
    ):
        scores = {"test": Score(made.fit.joints, np.array(nmse), np.array(rmse))}
        text = page(replace(made, scores=scores, member_scores={}), [])
        assert words in summary(replace(made, scores=scores))
        assert ('<tr class="mean"><td>mean</td><td>-</td><td>-</td>' in text) == np.isnan(rmse[0])
        assert ('class="worst">0.250' in text) == np.isfinite(rmse[0])
