import math
from dataclasses import replace

import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.text import Text

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.report import laws
from invdyn_cli.report.diagnosis_figures import JOINTS as EACH
from invdyn_cli.report.diagnosis_figures import PANELS, draw, draw_all
from invdyn_cli.report.diagnosis_page import page
from invdyn_cli.report.exhibits import exhibits, recordings, telling_window
from invdyn_cli.report.overlay import opening
from invdyn_cli.report.wording import claims, picture
from invdyn_cli.types import EffectText, Quantity
from tests.commands import usually
from tests.diagnoses import (
    ARM,
    DELAY,
    EVERY_EFFECT,
    JOINTS,
    WINDOWS,
    diagnosis_of,
    log_unusable,
    make_diagnosis,
    nothing_found,
)

BROKEN = ("torque_ripple", "payload", "coulomb_friction", "torque_delay")


def one(effect, column=2, **changes):
    """A short diagnosis that found one cause."""
    return diagnosis_of([(effect, None if effect in ARM else column, {})], trajectories=2, seconds=24.0, **changes)


def with_signals(diagnosis, **changes):
    return replace(diagnosis, signals=replace(diagnosis.signals, **changes))


def lines(figure, label):
    """Points (x, y) of every curve with this label."""
    found = [line for axes in figure.axes for line in axes.lines if line.get_label() == label]
    return [np.array(line.get_data(), float) for line in found]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    diagnosis = make_diagnosis()
    return diagnosis, draw_all(diagnosis, tmp_path_factory.mktemp("figures"))


def test_every_cause_has_a_picture(drawn):
    """The opening, the overview, failed residual tests and one picture for every named or ambiguous finding are drawn,
    each of a legible size."""
    diagnosis, paths = drawn
    names = [picture(k + 1, x) for k, x in enumerate(claims(diagnosis))]
    assert [x.stem for x in paths] == ["torque", "overview", "torques", "residual_tests", *names] and len(names) == 5
    assert all(min(imread(x).shape[:2]) > 300 for x in paths)


@pytest.mark.parametrize("effect", ["torque_gain_change", "payload", "torque_ripple"])
def test_the_opening_shows_the_largest_anomaly(effect):
    """Its joint, in its window where it has one: friction that every arm has does not open the report."""
    found = diagnosis_of([("coulomb_friction", 0, {}), (effect, None if effect in ARM else 2, {})], trajectories=2)
    shown = next(x for x in exhibits(found) if x.finding.effect == effect)
    axes = opening(found).axes[0]
    assert axes.get_title().startswith(JOINTS[shown.column])
    if shown.finding.window is not None:
        (start, end), (low, high) = shown.finding.window, axes.get_xlim()
        assert low < start < end < high


def test_the_opening_without_an_anomaly():
    """The joint that the nominal model misses most, by the spread of its torque."""
    found = nothing_found()
    signals = found.signals
    signals.tau[:, 3] += 5 * np.std(signals.tau[:, 3]) * np.sign(signals.qd[:, 3])
    assert opening(found).axes[0].get_title().startswith(JOINTS[3])


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_a_law_has_the_exponent_that_was_found(exponent):
    """The dashed law of a Stribeck friction falls as its effect does."""
    found = one("stribeck_friction")
    sizes = {**found.findings[0].parameters, "exponent": Quantity(exponent, "-")}
    changed = replace(found, findings=(replace(found.findings[0], parameters=sizes), *found.findings[1:]))
    v, height = lines(draw(exhibits(changed)[0]), "the law, unfiltered")[-1]
    coulomb, static, velocity = (sizes[name].value for name in ("coulomb", "static", "velocity"))
    np.testing.assert_allclose(height, coulomb + (static - coulomb) * np.exp(-((v / velocity) ** exponent)))


@pytest.mark.parametrize("effect", EVERY_EFFECT)
def test_every_effect_can_be_drawn(effect):
    """The picture of any effect names it and its joint in the title, and has a unit on every axis that has a label."""
    exhibit = exhibits(one(effect))[0]
    figure = draw(exhibit)
    words = EFFECTS[effect].title if effect in EFFECTS else effect
    assert figure.get_suptitle().startswith(f"{'whole arm' if effect in ARM else 'joint3'}: {words}")
    labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert labels and all(label.endswith("]") or label == "samples" for label in labels)
    assert figure.legends


def test_pictures_are_known():
    """Every effect asks for panels that there are, two at most, or for all joints; every panel is asked for."""
    asked = {name: effect.panels for name, effect in EFFECTS.items()}
    assert {x for panels in asked.values() for x in panels} == {*PANELS, EACH}
    assert all(len(panels) <= 2 for panels in asked.values()) and set(EFFECTS) <= set(EVERY_EFFECT)


def test_an_effect_of_the_users_is_drawn_and_told():
    """A finding whose effect is not in the catalogue brings its text: its panels are drawn, its meaning stands in the
    picture and on the page, and its equation has its parameters in italics."""
    text = EffectText("cable drag", "A cable that drags.", "drag qd |qd|", ("drag",), True, ("velocity",))
    diagnosis = one("viscous_friction")
    (finding,) = claims(diagnosis)
    diagnosis = replace(diagnosis, findings=(replace(finding, effect="cable_drag", text=text),))
    figure = draw(exhibits(diagnosis)[0])
    assert len(figure.axes) == 2 and any("A cable that drags." in str(x) for x in figure.findobj(Text))
    html = page(diagnosis, "lbr", [])
    assert "A cable that drags." in html and "τ += <i>drag</i> q̇ |q̇|" in html


def test_medians_show_the_law():
    """What the other effects leave for a Coulomb friction of 2 N m has its medians at +-2 N m, as the fitted term."""
    figure = draw(exhibits(one("coulomb_friction"))[0])
    ((v, medians),) = lines(figure, laws.MEDIAN)
    assert len(v) > 10 and np.allclose(medians, 2.0 * np.sign(v), atol=0.15)
    for v, term in lines(figure, laws.TERM)[:2]:
        assert np.allclose(term, 1.98 * np.sign(v))


def test_rows_at_rest_are_left_out():
    """A joint at rest, whose friction can be anything, is not in the picture of its friction."""
    diagnosis = one("coulomb_friction")
    still = ~diagnosis.signals.valid[:, 2]
    diagnosis.signals.tau[still, 2] = 77.0
    figure = draw(exhibits(diagnosis)[0])
    assert still.any() and all(points[1].max() < 10 for points in lines(figure, laws.CLOUD))


def test_spectrum_has_its_line():
    """The highest line of the spectrum over the angle is where the ripple was planted."""
    figure = draw(exhibits(one("torque_ripple"))[0])
    cycles, amplitude = max((line.get_data() for line in figure.axes[1].lines), key=lambda x: len(x[0]))
    assert cycles[np.argmax(amplitude)] == pytest.approx(12.0, abs=0.3)
    assert amplitude.max() == pytest.approx(0.45, abs=0.1)


@pytest.mark.parametrize("effect", ["presliding_hysteresis", "backlash", "joint_elasticity"])
def test_memory_goes_round(effect):
    """What has a memory is drawn as it goes on in time, term over position or load: not in bins, in which it has no
    one value."""
    exhibit = exhibits(one(effect))[0]
    figure = draw(exhibit)
    x, term = lines(figure, laws.TERM)[0]
    source = exhibit.signals.q if effect == "presliding_hysteresis" else exhibit.signals.nominal
    start = int(np.flatnonzero(source[:, 2] == x[0])[0])
    assert np.array_equal(source[start : start + len(x), 2], x)
    assert np.array_equal(exhibit.term[start : start + len(x), 2], term)
    assert not lines(figure, laws.MEDIAN)


@pytest.mark.parametrize("effect", WINDOWS)
def test_windows_are_shaded(effect):
    """The window of what comes and goes is shaded where time is the abscissa, and stands in the title."""
    figure = draw(exhibits(one(effect))[0])
    shaded = [p for axes in figure.axes for p in axes.patches if p.get_label() == "window of the finding"]
    assert shaded and all((p.get_x(), p.get_x() + p.get_width()) == WINDOWS[effect] for p in shaded)
    assert "s of sweep_1" in " ".join(figure.get_suptitle().split())


def test_misfit_is_least_at_the_delay():
    """Shifting the logged torque by the delay leaves least."""
    figure = draw(exhibits(one("torque_delay", column=1))[0])
    ((shift, _),) = lines(figure, "smallest misfit")
    assert shift[0] == pytest.approx(1000 * DELAY, abs=3.0)


def test_one_body_is_shown_on_all_joints():
    """A payload's picture has a panel for every joint with residual and term."""
    figure = draw(exhibits(one("payload"))[0])
    assert [axes.get_title().split()[0] for axes in figure.axes] == list(JOINTS)
    assert len(lines(figure, laws.TERM)) == len(JOINTS)


def test_telling_window_is_held_out():
    """The stretch that is shown is eight seconds of one recording that chose nothing."""
    signals = exhibits(make_diagnosis())[0].signals
    rows = telling_window(signals, signals.terms[0], range(7))
    assert signals.t[rows][-1] - signals.t[rows][0] == pytest.approx(8.0, abs=0.1)
    assert signals.held_out[rows].all() and len(set(signals.trajectory[rows])) == 1


@pytest.mark.parametrize("effect", WINDOWS)
def test_what_comes_and_goes_is_shown_coming_and_going(effect):
    """The stretch of a finding with a window holds the window and some time before and after it."""
    exhibit = exhibits(one(effect))[0]
    low, high = WINDOWS[effect]
    rows = telling_window(exhibit.signals, exhibit.term, [1], where="sweep_1", around=(low, high))
    t = exhibit.signals.t[rows]
    assert t[0] < low < high < t[-1] and set(exhibit.signals.trajectory[rows]) == {"sweep_1"}


def test_recordings_end_at_gaps():
    """A new trajectory, a clock that jumps on and one that jumps back end a recording."""
    signals = exhibits(one("payload"))[0].signals
    t = signals.t.copy()
    t[100:] += 1.0
    t[200:] -= 0.5
    assert [x.start for x in recordings(replace(signals, t=t))] == [0, 100, 200, 2400]


def test_nothing_found_has_an_overview(tmp_path):
    """Without causes and without a noise floor overview and torques are drawn; a log without signals gives none."""
    assert [x.stem for x in draw_all(nothing_found(), tmp_path)] == ["torque", "overview", "torques"]
    assert draw_all(log_unusable(), tmp_path) == []


@pytest.mark.parametrize("effect", usually(BROKEN[:2], BROKEN))
def test_broken_signals_are_survived(effect, tmp_path):
    """NaN in signals and estimates, a joint that never moves and no held-out rows: every picture is still drawn."""
    diagnosis = one(effect)
    signals = diagnosis.signals
    signals.tau[50:90] = np.nan
    signals.terms[0][:, 5] = np.nan
    diagnosis = with_signals(diagnosis, valid=np.zeros_like(signals.valid), held_out=np.zeros(len(signals.t), bool))
    broken = {
        name: Quantity(math.nan, x.unit, [math.nan, math.nan]) for name, x in claims(diagnosis)[0].parameters.items()
    }
    diagnosis = replace(diagnosis, findings=(replace(diagnosis.findings[0], parameters=broken),))
    assert len(draw_all(diagnosis, tmp_path)) == 4


def test_few_samples_are_survived(tmp_path):
    """A log of half a second still gives pictures."""
    causes = [(x, None if x in ARM else 2, {}) for x in EVERY_EFFECT if x not in WINDOWS]
    diagnosis = diagnosis_of(causes, trajectories=1, seconds=0.5)
    assert all(draw(x).axes for x in exhibits(diagnosis))


def test_names_are_no_formulas(tmp_path):
    """Joints whose names look like formulas or paths are shown as they are."""
    joints = ("$a_1$", r"b\frac_{", "c/d", "../e", "<f>", "g h", "ü")
    paths = draw_all(one("coulomb_friction", joints=joints), tmp_path)
    paths += draw_all(one("payload", column=None, joints=joints), tmp_path / "arm")
    assert len(paths) == 8 and all(x.parent in (tmp_path, tmp_path / "arm") for x in paths)


def test_jax_arrays_will_do():
    """Signals may be jax arrays."""
    diagnosis = one("viscous_friction")
    arrays = {n: jnp.asarray(x) for n, x in vars(diagnosis.signals).items() if n not in ("trajectory", "terms")}
    assert draw(exhibits(with_signals(diagnosis, **arrays))[0]).axes


def test_global_state_is_left_alone(tmp_path):
    """Drawing changes none of matplotlib's settings."""
    before = dict(matplotlib.rcParams)
    draw_all(one("coulomb_friction"), tmp_path)
    assert dict(matplotlib.rcParams) == before
