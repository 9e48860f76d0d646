"""Models fitted to a log in memory score as those that the command line fits to its file."""

import json
from pathlib import Path

import numpy as np
import pytest

import invdyn_cli as invdyn
from invdyn_cli.errors import UsageError
from invdyn_cli.store import write_run


def test_scores_are_those_of_the_verb(case, command):
    """NMSE and RMSE of every joint and set, by the same split and filter."""
    model = invdyn.make_model("pest", friction="coulomb_viscous", offset=True)
    result = invdyn.fit(model, case.log, case.robot, decimate=5)
    options = ("model=pest", "model.friction=coulomb_viscous", "model.offset=true", "data.decimate=5")
    said = command("run", "data=real_log", f"data.path={case.folder / 'log.h5'}", *options, "hydra.run.dir=by_verb")
    assert said.code == 0, said.err
    tree = json.loads(Path("by_verb/metrics.json").read_text())
    sets = ("train", "validation", "test")
    assert {name: x.as_dict() for name, x in result.scores.items()} == {name: tree[name] for name in sets}
    assert result.scores["test"].rmse[1] < 0.1 * case.coulomb
    [one] = case.log.trajectories
    assert result.predict(one.q[:5], 0 * one.q[:5], 0 * one.q[:5]).shape == (5, 2)
    assert "axis2" in str(result) and "<table" in result._repr_html_()
    write_run(result.record, Path("run.h5"))
    part = one.q[:5]
    np.testing.assert_array_equal(
        invdyn.load_model("run.h5").predict(part, part, part), result.predict(part, part, part)
    )


def test_refuses_models_and_options_that_there_are_not(case):
    """A sentence with what is allowed, and the nearest name."""
    for word, call in (
        ("model='pset', did you mean 'pest'.*allowed: pest, ffnn", lambda: invdyn.fit("pset", case.log)),
        ("the model is a int", lambda: invdyn.make_model(3)),  # pyright: ignore
        ("no option frction, did you mean 'friction'", lambda: invdyn.make_model("pest", frction="none")),
        ("the model pest: offset=3; allowed: true or false", lambda: invdyn.make_model("pest", offset=3)),
        ("the model hybrid needs the option base", lambda: invdyn.make_model("hybrid")),
        ("no option decimat, did you mean 'decimate'", lambda: invdyn.fit("dbm", case.log, decimat=2)),
        ("data.decimate=0", lambda: invdyn.fit("dbm", case.log, decimate=0)),
        ("needs the robot's kinematics", lambda: invdyn.fit("pest", case.log)),
        ("the simulated arm has no option effect, did you mean 'effects'", lambda: invdyn.simulate(effect=[])),
    ):
        with pytest.raises(UsageError, match=word):
            call()


def test_a_model_object_is_changed_by_name():
    """Hyperparameters of numpy's types are taken, the others stay as they are."""
    model = invdyn.make_model(invdyn.make_model("pest", offset=True), threshold=np.float64(0.1))
    assert model == invdyn.make_model("pest", offset=True, threshold=0.1)
