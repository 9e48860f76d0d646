from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from invdyn_cli.report import canvas, figures
from invdyn_cli.report.figures import draw_all
from invdyn_cli.types import Dataset, Prediction, RunRecord, Score
from tests.records import make_record

ALL = {"torques", "errors", "loss", "residual_velocity", "singular_values"}
ROLES = {
    "torques": (canvas.MEASURED, canvas.PREDICTED, canvas.RESIDUAL),
    "errors": tuple(canvas.SET_COLOURS.values()),
    "loss": (canvas.SET_COLOURS["train"], canvas.SET_COLOURS["validation"]),
    "residual_velocity": (canvas.RESIDUAL, canvas.SAMPLES),
    "singular_values": (canvas.KEPT, canvas.DROPPED, canvas.BLACK),
}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The figures of one run of four joints, by name."""
    return {path.stem: path for path in draw_all(make_record(4), tmp_path_factory.mktemp("figures"))}


def ink(path, colour: str, near: float = 0.12) -> int:
    """How many pixels of the picture are about that colour."""
    picture = imread(path)[..., :3]
    return int((np.abs(picture - to_rgb(colour)).max(axis=-1) < near).sum())


def with_scores(record: RunRecord, nmse, rmse) -> RunRecord:
    joints = record.fit.joints
    return replace(record, scores={name: Score(joints, np.array(nmse), np.array(rmse)) for name in record.scores})


def test_every_figure_is_drawn(drawn):
    """A run with history and singular values gives all five figures, each a PNG."""
    assert set(drawn) == ALL
    assert all(path.read_bytes().startswith(b"\x89PNG\r\n") for path in drawn.values())


@pytest.mark.parametrize("name", sorted(ALL))
def test_every_role_leaves_ink(drawn, name):
    """Each picture holds pixels in the colour of every role that it speaks of."""
    assert all(ink(drawn[name], colour) >= 10 for colour in ROLES[name])


def test_formats(tmp_path):
    """Each figure is written once per format, and nothing else is."""
    written = draw_all(make_record(1, epochs=0, pest=False), tmp_path / "new", formats=("png", "svg", "pdf"))
    assert {x.name for x in written} == {
        f"{n}.{s}" for n in ALL - {"loss", "singular_values"} for s in ("png", "svg", "pdf")
    }
    assert set((tmp_path / "new").iterdir()) == set(written)


def test_nothing_to_show_is_no_figure(tmp_path):
    """Without history there is no loss figure, without singular values none of them, without a test set no torques."""
    record = make_record(2, epochs=0, pest=False)
    assert figures.loss(record) is None and figures.singular_values(record) is None
    assert draw_all(replace(record, predictions={}, scores={}), tmp_path) == []
    empty = Prediction(Dataset((), record.fit.joints), np.empty((0, 2)))
    assert figures.torques(replace(record, predictions={"test": empty})) is None
    assert figures.residual_velocity(replace(record, predictions={"test": empty})) is None


@pytest.mark.parametrize("n", [1, 2, 3, 8, 9, 12])
def test_any_number_of_joints(n):
    """Every joint has its panel, from one joint to twelve, and no empty panel is left."""
    record = make_record(n, samples=120, epochs=5)
    for drawing, panels in ((figures.torques, 2 * n), (figures.loss, n), (figures.residual_velocity, n)):
        assert len(drawing(record).axes) == panels


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("nmse", "rmse"),
    [
        ([1e-27, 3e-28, 2e-26], [1e-13, 1e-13, 1e-13]),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
        ([np.nan, 0.2, 0.0], [0.1, 0.2, 0.0]),
        ([np.nan] * 3, [np.nan] * 3),
        ([np.inf, 1e12, 1e-3], [np.inf, 1e6, 1e-2]),
    ],
    ids=["rounding", "zero", "some NaN", "all NaN", "diverged"],
)
def test_log_axes_survive(tmp_path, nmse, rmse):
    """Zero, NaN, infinite and vanishing errors give a figure, and no warning."""
    written = draw_all(with_scores(make_record(3, samples=60, epochs=3), nmse, rmse), tmp_path)
    assert {path.stem for path in written} == ALL


def test_no_variance_is_not_said_of_what_diverged():
    """Without an NMSE is a torque that never changes, and a prediction that is not finite: each has its word."""
    record = with_scores(make_record(3, samples=60, epochs=3), [np.nan, np.nan, 0.1], [np.nan, 1.0, 1.0])
    upper, lower = figures.errors(record).axes
    words = [[text.get_text() for text in axes.texts] for axes in (upper, lower)]
    assert words == [["NaN", "no variance"] * len(record.scores), ["NaN"] * len(record.scores)]


@pytest.mark.filterwarnings("error")
def test_degenerate_curves_survive(tmp_path):
    """Losses of zero and NaN, a joint at rest, a constant torque, a prediction of NaN: drawn without a warning."""
    record = make_record(3, members=2, samples=60, epochs=4)
    history = {"train_loss": np.zeros((4, 2, 3)), "validation_loss": np.full((4, 2, 3), np.nan)}
    judged = record.predictions["test"]
    for x in judged.data.trajectories:
        x.motion.qd[:, 0] = 0.0
        x.tau[:, 1] = 5.0
    judged.tau[:, 2] = np.nan
    spectrum = {"singular_values": np.array([1.0, 0.0, 0.0]), "threshold": 0.0}
    fit = replace(record.fit, history=history, details=spectrum)
    assert len(draw_all(replace(record, fit=fit), tmp_path)) == len(ALL)


def test_prediction_that_runs_away():
    """A prediction that diverges does not crush the measured torque: it keeps a third of the panel's height."""
    record = make_record(1, samples=100)
    record.predictions["test"].tau[50:] = 1e6
    low, high = figures.torques(record).axes[0].get_ylim()
    assert high - low < 4 * np.ptp(record.predictions["test"].data.tau)


def test_names_are_no_formulas(tmp_path):
    """Names with dollars, underscores and backslashes are shown as they are."""
    assert draw_all(make_record(2, joints=("$a_1$", r"b\frac_{"), choices={"model": "$x^{$"}), tmp_path)


def test_torques_show_the_beginning():
    """A long test set is cut to its first 20 s, and the title says so; two short trajectories are shown whole."""
    long, short = figures.torques(make_record(1, samples=5000)), figures.torques(make_record(1))
    assert long.axes[0].lines[0].get_xdata()[-1] == pytest.approx(20.0, abs=0.03)
    assert "move_0 (1 of 2 trajectories), first 20 s" in long.get_suptitle()
    assert short.get_suptitle().endswith("move_0 and move_1")


def test_thinned_keeps_the_peaks():
    """A thinned curve has at most 2000 points, its extremes among them, and its time does not run back."""
    t = np.arange(100_003) / 100
    y = np.sin(t)
    y[54321], y[777] = 9.0, -7.0
    few_t, few_y = canvas.thinned(t, y)
    assert len(few_t) <= 2000 and few_y.max() == 9.0 and few_y.min() == -7.0 and np.all(np.diff(few_t) >= 0)


def test_bins_do_not_mix_directions():
    """A residual of sign(qd) has a median of -1 in all bins below zero and of +1 in all above."""
    x = np.random.default_rng(0).uniform(-1.0, 2.0, 5000)
    centre, low, middle, high = canvas.binned(x, np.sign(x))
    full = np.isfinite(middle)
    assert full.sum() > 30 and np.array_equal(middle[full], np.sign(centre[full]))
    assert np.array_equal(low, high, equal_nan=True)


def test_global_state_is_left_alone(tmp_path):
    """Drawing changes none of matplotlib's settings and opens no window: pyplot is not even imported."""
    before = dict(matplotlib.rcParams)
    draw_all(make_record(1, samples=50), tmp_path)
    assert dict(matplotlib.rcParams) == before
