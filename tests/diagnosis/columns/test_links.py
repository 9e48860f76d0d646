"""What joints transmit is that of links as a log has them; what is logged beside the nominal torque stays."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.columns import candidates
from invdyn_cli.diagnosis.columns.links import with_links
from invdyn_cli.diagnosis.search.composed import Model
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.maths.standard import link_scales
from tests.diagnosis.analytic import arm, candidate, evidence_of, gather, log_of, moved, raw

NAMES = ("load_dependent_friction", "torque_gain_error", "backlash", "coulomb_friction")


@pytest.fixture(scope="module")
def both():
    """The evidence with links as a log has them, up to a third of their scales off; and that of a robot that has them
    from the start."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02)), NAMES, cutoffs=(20.0,))
    draw = np.random.default_rng(0)
    inertial = np.asarray(arm().inertial) + 0.3 * link_scales(arm()) * draw.uniform(-1, 1, (arm().dofs, 10))
    other = replace(arm(), inertial=inertial)
    return with_links(evidence, inertial), gather(
        other, evidence.recording, [EFFECTS[name] for name in (*NAMES, "base_tilt")], "unknown"
    )


def compare(made, truth, trials):
    """The trials of one evidence have the same columns in another, on every joint."""
    for c in trials:
        same = candidate(made, c.effect.name, c.joint, **c.shape)
        for j, (fixed, free) in c.columns.items():
            own = [x.tables[j][:, [*at[0], *at[1]]] for x, at in ((made, same.columns[j]), (truth, (fixed, free)))]
            np.testing.assert_allclose(*own, atol=1e-9 * np.abs(own[1]).max())


@pytest.mark.parametrize("name", NAMES)
def test_columns_are_those_of_the_other_links(both, name):
    """Every trial of every effect has the columns of a robot that has these links, on every joint."""
    made, truth = both
    trials = [[c for c in x.candidates if c.effect.name == name] for x in both]
    assert len(trials[0]) == len(trials[1]) > 0
    compare(made, truth, trials[1])


def test_loaded_candidates_wait_for_the_links(both):
    """Without what depends on the links' weight the evidence has only the others; with these links it then has the same
    trials and columns as one that had them from the start, and nothing is added twice."""
    truth = both[1]
    effects = [EFFECTS[name] for name in (*NAMES, "base_tilt")]
    evidence = candidates.gather(arm(), truth.recording, effects, "unknown", "unknown")
    assert {c.effect.name for c in evidence.candidates} == {"coulomb_friction", "base_tilt"}
    made = with_links(evidence, np.asarray(truth.robot.inertial))
    count = len(made.candidates)
    candidates.add_loaded(made)
    assert len(made.candidates) == count == len(truth.candidates)
    compare(made, truth, [c for c in truth.candidates if c.effect.loaded])


def test_what_is_logged_beside_the_nominal_torque_stays(both):
    """Without effects the residual is that of the nominal model; an effect changes it as it does with these links."""
    made, truth = both
    acting = (
        EffectInstance(EFFECTS["backlash"], 1, {"gap": 0.004}),
        EffectInstance(EFFECTS["load_dependent_friction"], 0, {"mu": 0.1}),
    )
    models = Model(made), Model(truth)
    np.testing.assert_allclose(models[0].residual(()), made.residual((), np.zeros(0)), atol=1e-9)
    change = [m.residual(acting) - m.residual(()) for m in models]
    assert np.abs(change[1]).max() > 0.01
    np.testing.assert_allclose(*change, atol=1e-9)
