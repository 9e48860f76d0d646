"""What comes and goes several times is one effect: a load that an arm takes up again and again."""

import numpy as np
import pytest

from experiments.arms import random_robot
from experiments.confusion import claims
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.effects.composition import Span, TimeWindow, weight
from invdyn_cli.effects.description import as_dict, from_dict
from invdyn_cli.report.wording import when, windows
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from tests.commands import usually


def test_a_weight_has_all_windows():
    """One in each window, zero between, nothing in another trajectory."""
    both = TimeWindow("a", 1.0, 2.0, 0, (TimeWindow("a", 4.0, 5.0, 1),))
    t = np.arange(0, 6, 0.5)
    assert list(t[np.asarray(weight(both, Span("a", t, 2.0))) == 1]) == [1.5, 4.5]
    assert not np.any(weight(both, Span("b", t, 2.0)))


@pytest.fixture(scope="module", params=usually([[0, 4]], [[0, 2], [1, 3], [0, 4]]))
def carried(request):
    """An arm with friction takes up a load several times, drawn at random: load, windows, diagnosis."""
    seed, count = request.param
    draw = np.random.default_rng([seed, 77])
    robot = random_robot(np.random.default_rng(seed), 3)
    load = {"mass": float(draw.uniform(0.3, 0.8)), "com": draw.uniform(-0.05, 0.05, 3).tolist()}
    turn = 32.0 / count
    starts = turn * (np.arange(count) + draw.uniform(0.1, 0.3, count))
    ends = starts + turn * draw.uniform(0.3, 0.6, count)
    hidden = [Hidden("coulomb_friction", joint, {"coulomb": 0.8}) for joint in robot.joints]
    hidden += [Hidden("viscous_friction", joint, {"damping": 0.5}) for joint in robot.joints]
    spans = [[float(a), float(b)] for a, b in zip(starts, ends, strict=True)]
    hidden += [Hidden("payload_change", None, {**load, "window": span}) for span in spans]
    log = record(robot, [Multisine(base=0.1)], hidden, noise=Noise(position=1e-5, torque=0.02), duration=32.0, seed=3)
    return load, spans, diagnose(log, robot)


def test_a_load_that_is_taken_up_again_and_again_is_one(carried):
    """One finding with all windows, edges within 50 ms, mass within 5 %; friction besides, and nothing else."""
    load, spans, diagnosis = carried
    (found,) = [x for x in claims(diagnosis) if x.group != "standard"]
    assert (found.effect, found.status) == ("payload_change", "named")
    assert np.allclose(windows(found), spans, atol=0.05)
    assert when(found).count(" to ") == len(spans)
    assert found.parameters["mass"].value == pytest.approx(load["mass"], rel=0.05)


def test_the_written_model_has_all_windows(carried):
    """As it is written and read back."""
    _, spans, diagnosis = carried
    model = from_dict(as_dict(diagnosis.model))
    (one,) = [a for a in model.acting if a.when is not None]
    assert np.allclose(sorted([w.start, w.end] for w in one.when.each), spans, atol=0.05)
