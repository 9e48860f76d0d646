"""Friction that changes its side gradually where a joint turns back."""

import json
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis import diagnose, transition
from invdyn_cli.diagnosis.standard_columns import columns_of
from invdyn_cli.effects.composition import sign_of
from invdyn_cli.effects.description import as_dict, from_dict
from invdyn_cli.errors import UsageError
from invdyn_cli.recording.pieces import ROLES
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import PickPlace
from invdyn_cli.simulation.sensors import Noise
from tests.diagnosis.analytic import arm, evidence_of, log_of, moved, on, raw

LEVELS = (5.0, 3.0, 1.0)
"""[N m] of an arm's joints."""


def found(*terms):
    """The transitions that a log of 30 s with these terms and noise tells."""
    evidence = evidence_of(log_of(raw(*moved(30.0), *terms, torque=0.02, position=1e-7)), ("coulomb_friction",))
    return transition.speeds(columns_of(evidence, "unknown"), evidence.residual((), np.zeros(0)))


@pytest.mark.parametrize("speed", np.random.default_rng(5).uniform(0.01, 0.04, 2))
def test_the_speed_of_a_gradual_change_is_found(speed):
    """2 N m tanh(qd / v) on the first joint: v to 2 %, at which its search ends; the other joints' friction jumps."""
    first, *others = found(on(0, lambda t, q, qd, *_: 2.0 * np.tanh(qd / speed)))
    assert abs(first / speed - 1) < 0.02
    assert not any(others)


@pytest.mark.parametrize("term", [np.sign, lambda qd: 0 * qd, lambda qd: qd], ids=["jumps", "none", "viscous"])
def test_friction_that_jumps_does_so(term):
    """Coulomb friction of the same size, none, and viscous friction alone: no joint creeps."""
    assert not any(found(on(0, lambda t, q, qd, *_: 2.0 * term(qd))))


def test_of_two_logs_the_reference_tells():
    """Friction that jumps in a reference, and whose torque comes 10 ms late since, jumps; that of the later log alone
    would seem to be gradual."""
    late = on(0, lambda t, q, qd, qdd: 2.0 * np.sign(np.where(t < 15, qd, np.interp(t - 0.01, t, qd))))
    evidence = evidence_of(log_of(raw(*moved(30.0), late, torque=0.02, position=1e-7)), ("coulomb_friction",))
    told = []
    for before in ("reference", "test"):
        role = np.where(evidence.on_rows("t") < 15, ROLES.index(before), ROLES.index("train"))
        own = replace(evidence, role=role)
        told.append(transition.speeds(columns_of(own, "unknown"), own.residual((), np.zeros(0)))[0])
    assert told[0] == 0 < told[1]


def test_a_slow_joint_creeps_as_others_do():
    """A joint that moves a twenty-fifth as far as usual has the transition that a fast one tells, which is a third of
    its largest speed, to 10 %; friction that jumps still does."""
    t, m = moved(30.0)
    share = np.array([1.0, 0.04, 0.04])
    slow = type(m)(m.q[0] + share * (m.q - m.q[0]), share * m.qd, share * m.qdd)
    speed = np.abs(slow.qd[:, 1]).max() / 3

    def term(t, m):
        sides = [np.tanh(m.qd[:, 0] / speed), np.tanh(m.qd[:, 1] / speed), np.tanh(m.qd[:, 2] / 1e-5)]
        return 2.0 * np.stack(sides, axis=1)

    evidence = evidence_of(log_of(raw(t, slow, term, torque=0.02, position=1e-7)), ("coulomb_friction",))
    told = transition.speeds(columns_of(evidence, "unknown"), evidence.residual((), np.zeros(0)))
    np.testing.assert_allclose(told[:2], speed, rtol=0.1)
    assert told[2] == 0


@pytest.fixture(scope="module")
def crept():
    """The diagnosis of an arm that picks and places with friction of LEVELS, gradual within 8 mrad/s; the simulated arm
    shares no code with what looks for it."""
    given = [{"coulomb": level, "transition": 0.008} for level in LEVELS]
    hidden = [Hidden("coulomb_friction", joint, x) for joint, x in zip(arm().joints, given, strict=True)]
    noise = Noise(position=1e-6, torque=(0.02,) * arm().dofs)
    log = plant.record(arm(), [PickPlace()], hidden, duration=25.0, rate=500.0, seed=3, noise=noise)
    return diagnose(log, arm())


def test_an_arm_that_creeps_is_told(crept):
    """Nothing but Coulomb friction is claimed, right to 2 % (a jump in its place makes 5 to 40 % on other terms), the
    model is as good as the sensor, and a sentence names the joints."""
    assert {f.effect for f in crept.findings if f.status == "named"} == {"coulomb_friction"}
    sizes = [crept.standard[joint]["coulomb"]["value"] for joint in arm().joints]
    np.testing.assert_allclose(sizes, LEVELS, rtol=0.02)
    assert max(x["rmse"] for x in crept.extended.values()) < 0.05
    assert any("tanh(qd / v)" in note for note in crept.notes)


def test_a_model_keeps_its_transition(crept):
    """The model predicts the same after it was written and read; a transition that is none is refused."""
    model = crept.model
    stored = json.loads(json.dumps(as_dict(model)))
    t = np.linspace(0, 4, 400)[:, None] + np.arange(model.robot.dofs)
    motion = 0.02 * np.sin(t), 0.02 * np.cos(t), -0.02 * np.sin(t)
    before, after = model.predict(*motion), from_dict(stored).predict(*motion)
    np.testing.assert_allclose(after, before, atol=1e-12)
    jumping = from_dict({k: v for k, v in stored.items() if k != "friction_transition"})
    assert np.abs(jumping.predict(*motion) - before).max() > 0.5
    with pytest.raises(UsageError, match="friction_transition"):
        from_dict({**stored, "friction_transition": [-1.0] * model.robot.dofs})


def test_no_transition_is_sharper_than_the_noise():
    """Within the noise of the speed a transition changes the sign by no more than tanh differs from a straight line of
    the same area: less than an eighth."""
    qd = np.linspace(-0.05, 0.05, 501)
    assert np.abs(sign_of(qd, 0.01, 1e-5) - sign_of(qd, 0.01)).max() < 0.125
    assert np.abs(sign_of(qd, 0.01, 0.03) - np.tanh(qd / 0.03)).max() < 1e-12
