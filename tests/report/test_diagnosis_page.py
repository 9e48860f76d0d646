import math
import re
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.wording import SINCE
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.report.diagnosis_figures import draw_all
from invdyn_cli.report.diagnosis_page import page, write_report
from invdyn_cli.report.overlay import CAPTION, RESTING
from invdyn_cli.report.quantities import gain_text, quantity_text
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import claims, joints_of, law, picture, words
from invdyn_cli.types import Check, Gain, Quantity
from invdyn_cli.verbs.sweep import writers
from tests.diagnoses import EVERY_EFFECT, log_unusable, make_diagnosis, nothing_found, quantities
from tests.report.reader import Reader


def placeholders(diagnosis, folder):
    """Files named as the figures of a diagnosis."""
    names = ["torque", "overview", *(picture(k + 1, x) for k, x in enumerate(claims(diagnosis)))]
    for name in names:
        (folder / f"{name}.png").write_bytes(b"PNG")
    return [folder / f"{name}.png" for name in names]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    diagnosis = make_diagnosis()
    return diagnosis, write_report(diagnosis, "lbr", placeholders(diagnosis, folder), folder / "report.html")


def test_report_is_one_file(written):
    """The page parses, holds the opening, the overview and a picture per cause, and needs nothing outside of itself."""
    _, path = written
    text = path.read_text("utf-8")
    reader = Reader(text)
    assert reader.tags.count("img") == 7 and not {"script", "link", "iframe"} & set(reader.tags)
    assert all(x.startswith("data:image/png;base64,") for name, x in reader.attributes if name == "src")
    assert not re.search(r"https?:|//[a-z]|url\(|@import", re.sub(r"base64,[^\"]*", "", text))


def test_what_is_left_is_told(written):
    """Every test of every joint has its cell; the one that failed says how much goes with what, and what looks so."""
    _, path = written
    text = path.read_text("utf-8")
    said = text.partition("<h2>Residual</h2>")[2].partition("<h2>")[0]
    assert said.count("<b>") == 1 and "<b>0.210</b>" in said
    (row,) = re.findall(r"<tr><td class=.whole.>(.*?)</tr>", said)
    assert "joint7" in row and "angle" in row and "joint spring" in row
    passing = replace(make_diagnosis(), tests=tuple(replace(x, passed=True) for x in make_diagnosis().tests))
    assert "All tests passed." in page(passing, "lbr", [])


def test_the_first_screen_says_what_to_do(written):
    """After the verdict and one picture of the torques come what to do next, the causes, the standard terms and the
    residual. The trajectory to record is a link. Each ambiguity, each joint whose residual is not noise, and each
    defect of the log has a line."""
    diagnosis, path = written
    text = path.read_text("utf-8")
    heads = re.findall(r"<h2>(.*?)</h2>", text)
    assert text.partition("<h2>")[0].count("<img") == 1 and CAPTION in text.partition("<h2>")[0]
    assert heads[:4] == ["What to do next", "Causes", "Standard terms", "Residual"]
    text = page(diagnosis, "lbr", [], {}, "record_next.csv")
    said = text.partition("<h2>What to do next</h2>")[2].partition("<h2>")[0]
    assert '<a href="record_next.csv">' in said and "ten postures" in said
    assert "The residual is not noise on joint7 (it may be joint spring)" in said


def test_a_term_that_every_arm_has_stands_in_its_table(written):
    """A named Coulomb friction is bold in the table of standard terms, with a link to its evidence, and is no row
    among the causes."""
    text = written[1].read_text("utf-8")
    causes, _, rest = text.partition("<h2>Standard terms</h2>")
    assert "coulomb_friction" not in causes.partition("<h2>Causes</h2>")[2]
    assert re.search(r'<a href="#finding-\d"><b>1\.5\d* N m</b></a><small>\[', rest.partition("<h2>")[0])


def test_links_lead_somewhere(written):
    """Every cause in the table leads to its evidence on the page."""
    attributes = Reader(written[1].read_text("utf-8")).attributes
    targets = {f"#{x}" for name, x in attributes if name == "id"}
    assert {x for name, x in attributes if name == "href"} == targets and len(targets) == 5


def test_report_says_everything(written):
    """Summary, notes, every cause in words and by name, estimates, gains, alternatives, advice, rivals, what could not
    be seen, errors, shares, checks that were not in order, excitation and details are on the page."""
    diagnosis, path = written
    text = Reader(path.read_text("utf-8")).text
    said = [
        diagnosis.summary,
        *diagnosis.notes,
        "3 causes named, 1 ambiguous, 1 standard term named",
        "all joints",
        "71 %",
        "joint spring",
    ]
    for x in diagnosis.findings:
        said += [x.effect, x.advice, words(x.effect)[1:], *(why for _, why in x.rejected)]
        said += [quantity_text(q) for q in x.parameters.values()] + [gain_text(g) for g in x.gain.values()]
    for joint in joints_of(diagnosis):
        said += [significant(diagnosis.baseline[joint]["rmse"]), significant(diagnosis.noise_floor[joint]["rmse"])]
    said += ["clock jitter", "Stamp the samples", "qdd max rad s2", "Butterworth", "extended_model.json"]
    assert [x for x in said if x not in text] == []
    assert "unit error" not in text


def test_long_lists_of_rivals_are_folded(written):
    """Five rivals are folded, two are shown."""
    text = written[1].read_text("utf-8")
    assert "<details><summary>5 alternatives" in text and "<details open><summary>2 alternatives" in text


@pytest.mark.parametrize("effect", EVERY_EFFECT)
def test_every_effect_has_its_law(effect):
    """The page of any effect of the vocabulary shows its equation, with its own parameters, and parses."""
    diagnosis = make_diagnosis()
    finding = replace(claims(diagnosis)[1], effect=effect, parameters=quantities(effect))
    text = page(replace(diagnosis, findings=(finding,)), "lbr", [])
    Reader(text)
    timed = page(replace(diagnosis, findings=(replace(finding, trajectory="run_3", window=(8.0, 14.0)),)), "lbr", [])
    assert timed.count("8.00 to 14.0 s of run_3") == 2 and " s of run_3" not in text
    if effect in EFFECTS:
        assert f'<p class="law">{law(EFFECTS[effect].text)}</p>' in text
        assert all(f"<i>{x}</i>" in text for x in EFFECTS[effect].parameters if x in EFFECTS[effect].equation)


def test_everything_is_escaped(tmp_path):
    """Names, reasons, notes and numbers' names that look like HTML are shown and not obeyed."""
    bad = "<b>x</b>&\"'"
    diagnosis = make_diagnosis(joints=(bad, "j2", "j3", "j4", "j5", "<i>", "j7"))
    finding = replace(
        diagnosis.findings[0],
        effect=bad,
        joint=bad,
        status="ambiguous",
        alternatives=((bad,),),
        parameters={bad: Quantity(bad, bad, None)},
        gain={bad: Gain(1.0, 0.5, 0.1, 0.05, (0.4, 0.6))},
        trajectory=bad,
        window=(1.0, 2.0),
        evidence={bad: bad},
        rejected=((bad, bad),),
        advice=bad,
    )
    hidden = replace(finding, status="not_excited")
    checks = (Check(bad, "warn", bad, bad, bad, bad, bad, bad, bad, bad),)
    examination = replace(diagnosis.examination, checks=checks, excitation={bad: {bad: bad}})
    diagnosis = replace(
        diagnosis,
        findings=(finding, *diagnosis.findings[1:], hidden),
        summary=bad,
        notes=(bad,),
        details={bad: bad},
        examination=examination,
    )
    figures = placeholders(diagnosis, tmp_path)
    text = write_report(diagnosis, bad, figures, tmp_path / "report.html").read_text("utf-8")
    reader = Reader(text)
    assert len(figures) == 7 and "<b>x" not in text and "<td><i></td>" not in text
    assert reader.tags.count("img") == 7 and reader.text.count(bad) > 15


def test_nan_is_a_dash():
    """Errors, gains, estimates and shares that do not exist leave dashes, and a page that parses."""
    diagnosis = make_diagnosis()
    nan = {"rmse": math.nan, "nmse": math.nan}
    finding = replace(
        diagnosis.findings[0],
        parameters={"mass": Quantity(math.nan, "kg", (math.nan, math.nan)), "com": Quantity([math.nan] * 3, "m")},
        gain={"joint1": Gain(math.nan, math.nan, math.nan, math.nan, (math.nan, math.nan))},
    )
    every = joints_of(diagnosis)
    diagnosis = replace(
        diagnosis,
        findings=(finding,),
        baseline=dict.fromkeys(every, nan),
        extended=dict.fromkeys(every, nan),
        unexplained=dict.fromkeys(every, math.nan),
    )
    text = Reader(page(diagnosis, "lbr", [])).text
    assert "nan" not in text.replace("named", "") and "(-, -, -) m" in text


def test_an_unusable_log_says_what_to_do(tmp_path):
    """A log that cannot be used has a page with what fails first, what to do about it, and no causes or usage."""
    diagnosis = log_unusable()
    path = write_report(diagnosis, "lbr", draw_all(diagnosis, tmp_path), tmp_path / "report.html")
    text = Reader(path.read_text("utf-8")).text
    assert "The log of lbr cannot be diagnosed" in text and "Divide qd by 57.2958" in text and "invdyn check" in text
    assert text.index("unit error") < text.index("clock jitter")
    assert not any(x in text for x in ("Causes", "Improvement", "extended_model.json"))


def test_nothing_found_is_said(tmp_path):
    """A diagnosis without causes says so, and that there is no noise floor; its model is used all the same."""
    diagnosis = nothing_found()
    text = Reader(page(diagnosis, "lbr", draw_all(diagnosis, tmp_path))).text
    assert "None was found." in text and "no noise floor" in text and "extended_model.json" in text


class Broken(Executor):
    """Another process that ends before it has drawn anything."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_exception(BrokenExecutor())
        return future


def test_a_comparison_says_what_has_changed():
    """Beside a reference the page is of changes, not of errors of a simulation."""
    diagnosis = make_diagnosis()
    errors = [diagnosis.baseline, diagnosis.extended]
    texts = [page(x, "arm", []) for x in (replace(diagnosis, details={SINCE: errors}), diagnosis)]
    assert ["What has changed on arm" in text and ">Changes</h2>" in text for text in texts] == [True, False]
    assert ["What the simulation of arm gets wrong" in text and ">Causes</h2>" in text for text in texts] == [
        False,
        True,
    ]


def test_another_process_draws_the_same(tmp_path):
    """The figures are those of one process, byte for byte, where another one draws some of them, or should have."""
    diagnosis = make_diagnosis()
    alone = {x.name: x.read_bytes() for x in draw_all(diagnosis, tmp_path / "alone")}
    assert len(alone) > 2
    with writers(1) as other:
        for name, helper in (("two", other), ("one", Broken())):
            drawn = {x.name: x.read_bytes() for x in draw_all(diagnosis, tmp_path / name, helper=helper)}
            assert drawn == alone


def test_write_is_all_or_nothing(tmp_path):
    """A page that cannot be made leaves the old one as it was."""
    path = tmp_path / "report.html"
    path.write_text("old")
    with pytest.raises(FileNotFoundError):
        write_report(nothing_found(), "lbr", [tmp_path / "overview.png"], path)
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("resting", [True, False])
def test_what_is_left_at_rest_is_said(resting, tmp_path):
    """If most of what the model leaves is there while joints rest, the page says that no model follows friction there:
    the RMSE of the opening picture counts these rows."""
    diagnosis = make_diagnosis()
    signals = diagnosis.signals
    left = np.where(signals.valid == resting, 0.0, 10.0 * np.std(signals.tau, axis=0))
    diagnosis = replace(diagnosis, signals=replace(signals, extended=signals.tau + left))
    text = Reader(page(diagnosis, "lbr", placeholders(diagnosis, tmp_path))).text
    assert CAPTION in text and (RESTING.strip() in text) == resting
