"""The experiment grand_comparison: its rows, its table and the Pareto front, on fits that take no time."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from experiments.grand_comparison import MODELS, GrandComparison, Measured, composed, measured, part, whole
from experiments.grand_comparison_figures import FAMILIES, pareto
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel, silent
from invdyn_cli.models.pest import Pest
from invdyn_cli.types import Fit


def test_part_has_so_many_rows(data):
    """Evenly spread over all trajectories, each row once; asked for more, it has all."""
    some = part(data, 37)
    assert some.samples == 37
    rows = {row.tobytes() for row in data.motion.q}
    assert len({row.tobytes() for row in some.motion.q} & rows) == 37
    assert part(data, 10**6).samples == data.samples


def test_a_model_that_cannot_is_a_row(data):
    """Without a URDF, or where learning raises, there is a row with the reason and no number."""
    bare = replace(data, robot=None)
    assert "URDF" in measured("x", "pest", Pest(), bare, bare).reason

    class Broken(Pest):
        def fit(self, *arguments, **options):
            raise ValueError("this one is broken")

    row = measured("x", "broken", Broken(), data, data)
    assert row.nmse is None and row.reason == "this one is broken"
    with pytest.raises(UsageError, match="diagnosis"):
        composed("extended")


@dataclass(frozen=True)
class Mean(AbstractModel):
    """The mean torque of the rows that it learned from."""

    needs_robot = False

    def init(self, dataset, key):
        return {"mean": np.zeros(len(dataset.joints))}

    def apply(self, params, motion, robot):
        return params["mean"] + 0.0 * motion.q

    def fit(self, dataset, key, *, validation=None, progress=silent):
        return Fit({"mean": dataset.tau.mean(0)}, None, dataset.joints, parameters=2)


def test_a_fit_is_judged_on_other_rows(data):
    """The mean of other rows has an NMSE of one plus the squared distance of the means over the variance; all other
    numbers are there."""
    train, test = part(data, 50), data
    row = measured("x", "mean", Mean(), train, test)
    away = (train.tau.mean(0) - test.tau.mean(0)) ** 2 / test.tau.var(0)
    np.testing.assert_allclose(row.joints, 1 + away, rtol=1e-6)
    assert row.nmse == pytest.approx(np.mean(row.joints))
    assert row.fit_s > 0 and row.predict_us > 0 and row.memory_mb == pytest.approx(16e-6) and row.parameters == 2


def test_table_and_verdict(tmp_path):
    """Seeds are averaged, small sizes stand in their columns, the best of every real robot is told, and a log that is
    not there too."""
    rows = [
        Measured("panda", "standard", 100, nmse=0.3, rmse=1.0),
        Measured("panda", "standard", 4000, nmse=0.1, rmse=0.5),
        Measured("panda", "ffnn", 4000, 0, nmse=0.2, rmse=0.5),
        Measured("panda", "ffnn", 4000, 1, nmse=0.4, rmse=0.5),
        Measured("panda", "extended", 4000, reason="of a diagnosis"),
    ]
    means = {row.model: row.nmse for row in whole(rows)}
    assert means["ffnn"] == pytest.approx(0.3) and means["standard"] == 0.1
    text = GrandComparison(data=str(tmp_path)).table(rows)
    assert "| standard | 0.100 | 0.300 |" in text and "0.200 to 0.400" in text
    assert "- `extended`: of a diagnosis." in text
    assert "| standard | **0.100** | 1 of 1 | 1.00 |" in text
    assert "there is no sarcos.h5" in text and "there is no panda.h5" not in text


def test_a_robot_on_which_every_model_failed_stays_in_the_table(tmp_path):
    """It is no model's best, and has an empty cell."""
    rows = [
        Measured("panda", "standard", 4000, nmse=0.1, rmse=0.5),
        Measured("sarcos", "standard", 4000, reason="needs a URDF"),
    ]
    text = GrandComparison(data=str(tmp_path)).table(rows)
    assert "| standard | **0.100** |  | 1 of 2 | 1.00 |" in text


def test_pareto_front_is_what_no_faster_model_beats():
    """A brute-force comparison of all pairs gives the same points."""
    points = [tuple(x) for x in np.random.default_rng(0).integers(0, 30, (40, 2)).tolist()]
    front = pareto(points)
    beaten = {p for p in points for q in points if q != p and q[0] <= p[0] and q[1] <= p[1]}
    assert set(front) == set(points) - beaten


def test_every_model_has_a_look():
    """No model is drawn without colour and marker, and no two of them alike."""
    drawn = [model for _, models in FAMILIES.values() for model in models]
    assert set(drawn) == set(MODELS) - {"extended"} and len(drawn) == len(set(drawn))
