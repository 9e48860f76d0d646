"""Blows of flanks that bounce, written into the torque of a log: play, if they follow changes of the load."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis.case import Options
from invdyn_cli.diagnosis.decide.findings import Made
from invdyn_cli.diagnosis.pipeline import diagnose
from invdyn_cli.diagnosis.rattling import blows, told
from invdyn_cli.diagnosis.standard import Beside
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Finding, Motion
from tests.commands import usually
from tests.diagnosis.analytic import arm, evidence_of, log_of, moved, raw

SIZE = 0.3
"""Of the blows, in RMS torques of the joint."""


def struck(t: np.ndarray, when: np.ndarray, seed: int) -> np.ndarray:
    """(T,) ringing of 15 to 25 Hz for 0.15 s from each of these times, of either sign and random size."""
    draw, out = np.random.default_rng(seed), np.zeros(len(t))
    for start in when:
        lag = t - start
        ring = np.sin(2 * np.pi * draw.uniform(15, 25) * lag + draw.uniform(0, 2 * np.pi)) * np.exp(
            -np.maximum(lag, 0) / 0.04
        )
        out += draw.choice([-1, 1]) * draw.uniform(0.5, 1.5) * np.where((lag >= 0) & (lag < 0.15), ring, 0.0)
    return out


def hidden(joint: int, moments: str, seed: int):
    """A term of a joint: blows after its load changed its sign, after its velocity did, or at as many other times."""

    def term(t: np.ndarray, m: Motion) -> np.ndarray:
        load = inverse_dynamics(arm(), m.q, m.qd, m.qdd)[:, joint]
        size, turned = SIZE * np.sqrt(np.mean(load**2)), {"load": load, "velocity": m.qd[:, joint]}
        when = t[1:][np.diff(np.sign(turned.get(moments, load))) != 0]
        if moments == "random":
            when = np.random.default_rng(seed).uniform(t[0], t[-1], len(when))
        out = np.zeros_like(m.q)
        out[:, joint] = size * struck(t, when, seed)
        return out

    return term


def changes_most() -> int:
    """The joint whose load changes its sign most often in the motion of these tests."""
    _, m = moved()
    load = inverse_dynamics(arm(), m.q, m.qd, m.qdd)
    return int(np.argmax(np.sum(np.diff(np.sign(load), axis=0) != 0, axis=0)))


@pytest.mark.parametrize("moments", ["load", "velocity", "random"])
def test_blows_are_those_after_changes_of_load(moments):
    """Blows after such changes are told, with most of the squared residual; after reversals of velocity, or at random
    times, they are not."""
    j = changes_most()
    t, m = moved()
    term = hidden(j, moments, 1)
    evidence = evidence_of(log_of(raw(t, m, term, torque=0.005)), ["viscous_friction"], cutoffs=(40.0,))
    left = evidence.residual((), np.zeros(0))
    found = blows(evidence, left[:, j], evidence.nominal[:, j], j)
    if moments == "load":
        assert found is not None and found.blows_over_rest > 20 and found.share_of_residual > 0.7
    else:
        assert found is None


def test_load_that_changes_its_sign_for_a_moment_is_one_change():
    """A load that is negative for 0.1 s, several times: a blow after its return shows play, although none falls while
    it is negative."""
    t, m = moved()
    evidence = evidence_of(log_of(raw(t, m, torque=0.005)), ["viscous_friction"], cutoffs=(40.0,))
    rows, j = evidence.on_rows("t"), changes_most()
    turned = np.flatnonzero(np.diff(np.sign(evidence.on_rows("qd")[:, j])) != 0)
    starts = np.arange(rows[0] + 1, rows[-1] - 1, 1.5)
    starts = starts[[np.abs(rows[turned] - x).min() > 0.5 for x in starts]]
    negative = np.any([(rows >= x) & (rows < x + 0.1) for x in starts], axis=0)
    left = 0.01 * np.random.default_rng(4).standard_normal(len(rows)) + struck(rows, starts + 0.1, 4)
    found = blows(evidence, left, np.where(negative, -1.0, 1.0), j)
    assert found is not None and found.changes_of_load == len(starts) >= 5


@pytest.mark.parametrize("moments", usually(["load"], ["load", "velocity", "random"]))
def test_play_that_no_formula_predicts_is_told(moments):
    """A diagnosis tells play of unknown size, or an effect that the catalogue lacks, on the joint with blows after
    changes of load, and no other anomaly; with other blows it tells no play."""
    j = changes_most()
    t, m = moved()
    log = log_of(raw(t, m, hidden(j, moments, 2), torque=0.005, position=1e-6))
    diagnosis = diagnose(log, arm(), options=Options(replay=False))
    claims = [f for f in diagnosis.findings if f.status in ("named", "ambiguous") and f.group == "anomaly"]
    if moments != "load":
        assert not any(f.effect == "backlash" for f in claims)
        return
    (play,) = claims
    assert (play.effect, play.joint, play.status) == ("backlash", arm().joints[j], "ambiguous")
    assert play.alternatives == (("unknown",),) and play.parameters["gap"].value is None
    assert play.text is not None and "after the load of the joint changed its sign" in play.text.meaning
    assert diagnosis.verdict == "partly_explained"


def test_a_spring_that_was_named_there_may_be_play():
    """A claimed spring on the joint with blows gets play as its alternative; one on another joint does not."""
    j = changes_most()
    t, m = moved()
    evidence = evidence_of(log_of(raw(t, m, hidden(j, "load", 3), torque=0.005)), ["backlash"], cutoffs=(40.0,))
    left, names = evidence.residual((), np.zeros(0)), evidence.robot.joints
    springs = tuple(Finding("joint_elasticity", name, "named") for name in names)
    terms = (np.zeros_like(left),) * len(springs)
    made = Made(springs, (), (), ({},), terms, left, left, left, left, (), ())
    nothing = SimpleNamespace(inertial=np.zeros(1, bool), of=lambda _: np.zeros_like(left))
    more = cast(Beside, SimpleNamespace(columns=nothing, found=SimpleNamespace(theta=np.zeros(1)), residual=left))
    found = told(evidence, made, more, EFFECTS).findings
    assert [f.alternatives for f in found] == [(("backlash",),) if name == names[j] else () for name in names]
