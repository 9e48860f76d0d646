"""The figure of an experiment: what its bars, marks and boxes stand for."""

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from invdyn_cli.report import bars

SPEC = {
    "title": "Errors in $ and N m",
    "panels": "plan",
    "groups": ["data"],
    "bars": {"PEST": {"name": "PEST"}, "other": {"name": ["NN", "hybrid"]}},
}


def job(name, plan, data, test, *, clean=None, seeds=()):
    def scored(x):
        return {"nmse": {"mean": x, "joint": {"a": x / 2, "b": 2 * x}}}

    metrics = {"test": scored(test)} | ({"test_clean": scored(clean)} if clean else {})
    if seeds:
        metrics["members"] = {"test": [scored(x) for x in seeds]}
    return {"name": name, "plan": plan, "data": data}, metrics


JOBS = [
    job("PEST", "rich", "clean", 1e-28),
    job("PEST", "rich", "noisy", 1e-3, clean=1e-5),
    job("NN", "rich", "noisy", 0.9, seeds=(0.05, 0.2, 0.9)),
    job("hybrid", "poor", "clean", 0.3),
]
STATEMENTS = [
    {"each": {"name": "PEST", "data": "noisy"}, "band": [0, 0.1]},
    {"each": {"name": "PEST"}, "band": [1e-4, 1.0]},
    {"each": {"name": "NN"}, "over": {"name": "PEST"}, "band": [5, 6]},
]


def drawn(**more):
    rich, poor = bars.draw({**SPEC, **more}, STATEMENTS, JOBS).axes
    return rich, poor


def shown(axes):
    """Heights of the bars with a label, {label: [(left, bottom, top)]}."""
    found = {}
    for container in axes.containers:
        for bar in container:
            assert isinstance(bar, Rectangle)
            where = bar.get_x() + bar.get_width() / 2, bar.get_y(), bar.get_y() + bar.get_height()
            found.setdefault(container.get_label(), []).append(where)
    return found


def test_a_bar_is_the_median_of_the_seeds():
    """Every job has one bar, as high as its mean NMSE or the median of its seeds, in the panel of its label; where no
    job is, there is none."""
    rich, poor = map(shown, drawn())
    assert [top for *_, top in rich["PEST"]] == pytest.approx([1e-28, 1e-3])
    assert [top for *_, top in rich["other"]] == pytest.approx([0.2])
    assert "PEST" not in poor and [top for *_, top in poor["other"]] == pytest.approx([0.3])


def test_boxes_are_what_all_statements_allow():
    """Behind a bar stands what every statement that picks it allows; a ratio to others is no height of its own."""
    rich, _ = drawn()
    low, high = 1e-4, 0.1
    boxes = {round(left, 6): (bottom, top) for left, bottom, top in shown(rich)["expected"]}
    (first, second), bottom = [left for left, *_ in shown(rich)["PEST"]], rich.get_ylim()[0]
    assert boxes[round(second, 6)] == pytest.approx((low, high))
    assert boxes[round(first, 6)] == pytest.approx((max(low, bottom), 1.0))
    assert len(boxes) == 2


def test_marks_are_clean_inputs_and_joints():
    """A diamond stands at the error on clean test inputs, and dots at every joint's where they are asked for."""
    rich, _ = drawn(joints=True)
    heights = {line.get_label(): sorted(line.get_ydata()) for line in rich.lines}
    assert heights["on clean test inputs"] == [1e-5]
    dots = np.concatenate([line.get_ydata() for line in rich.lines if line.get_label() == "single joints"])
    np.testing.assert_allclose(sorted(dots), sorted(f * x for x in (1e-28, 1e-3, 0.9) for f in (0.5, 2)))
    assert not [line for line in drawn()[0].lines if line.get_label() == "single joints"]


def test_panels_are_comparable():
    """All panels have the same limits, and hold everything that is drawn."""
    rich, poor = drawn()
    assert rich.get_ylim() == poor.get_ylim()
    low, high = rich.get_ylim()
    assert low < 1e-28 and high > 0.9


def test_seeds_share_a_bar_and_a_bar_may_show_another_set():
    """Jobs that differ in their seed have one bar, their median, and `set` says which errors it shows."""
    jobs = []
    for seed, x in enumerate((0.1, 0.2, 0.9)):
        labels, metrics = job("NN", "rich", "noisy", x)
        jobs.append(({**labels, "seed": str(seed)}, {**metrics, "train": {"nmse": {"mean": x / 10, "joint": {}}}}))
    several = {"learned": {"name": "NN", "set": "train", "colour": "sky"}, "tested": {"name": "NN"}}
    (axes,) = bars.draw({"title": "", "groups": ["name"], "bars": several}, [], jobs).axes
    tops = {label: [top for *_, top in found] for label, found in shown(axes).items()}
    assert tops == {"learned": [pytest.approx(0.02)], "tested": [pytest.approx(0.2)]}
