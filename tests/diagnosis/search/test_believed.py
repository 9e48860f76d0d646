"""Link errors and anomalies, grown together until the evidence grows no more."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.diagnosis import wear
from invdyn_cli.diagnosis.search import believed, noise
from invdyn_cli.diagnosis.standard_columns import columns_of
from invdyn_cli.maths.standard import Standard
from tests.diagnosis.analytic import arm, evidence_of, log_of, moved, on, raw


def test_a_step_back_is_not_the_end(monkeypatch):
    """Where nothing and a delay each beat the other, as the noise that one leaves may have it, the spring that beats
    nothing as well is found, and no hypothesis is grown to twice."""
    names = ("coulomb_friction", "torque_delay", "joint_spring", "link_inertia_error")
    torque = on(0, lambda t, q, qd, qdd: 2.0 * np.tanh(qd / 0.01) + 3.0 * q)
    evidence = evidence_of(log_of(raw(*moved(10.0), torque, torque=0.02, position=1e-5)), names)
    rows = np.ones(len(evidence.tau), bool)
    least = noise.measure(evidence, rows)
    (links,) = wear.worn_links(columns_of(evidence, "unknown"), least.weights, 0.1)
    pool = [c for c in evidence.candidates if c.joint == 0 and c.effect.name in ("torque_delay", "joint_spring")]
    wins = {("torque_delay", ""), ("torque_delay", "joint_spring"), ("", "torque_delay"), ("joint_spring", "")}
    visited, more = [], believed._more

    def name(belief):
        return "+".join(sorted(c.effect.name for c in belief.found))

    monkeypatch.setattr(believed.Belief, "beats", lambda self, other, rows: (name(self), name(other)) in wins)
    monkeypatch.setattr(believed, "_more", lambda *x: (visited.append(name(x[1])), more(*x))[1])
    found, _ = believed.believed(evidence, rows, least, (), links, pool, [()], 6)
    assert name(found) == "joint_spring"
    assert visited[:: len(believed.SIZES)] == ["", "torque_delay", "", "joint_spring"]


def test_hypotheses_are_compared_in_one_noise(monkeypatch):
    """Whatever is told of a hypothesis with an anomaly more, in some noise, is told of the one without it, too: link
    errors cost more in less noise, and a drive that had become weaker was not worth that to the other."""
    term = on(0, lambda t, q, qd, qdd: 2.0 * np.tanh(qd / 0.01) + 3.0 * q)
    evidence = evidence_of(log_of(raw(*moved(10.0), term, torque=0.02, position=1e-5)), ("joint_spring",))
    rows, last, told = np.ones(len(evidence.tau), bool), [], {}
    least = noise.measure(evidence, rows)
    (links,) = wear.worn_links(columns_of(evidence, "unknown"), least.weights, 0.1)
    pool = [c for c in evidence.candidates if c.effect.name == "joint_spring"]
    asked, left = believed.HypothesisScorer.quick, believed.beside

    def quick(self, hypothesis):
        last[:] = [(self, frozenset(c.key for c in hypothesis if c in pool))]
        return asked(self, hypothesis)

    def beside(*of):
        told.setdefault(last[0][0], set()).add(last[0][1])
        return left(*of)

    monkeypatch.setattr(believed.HypothesisScorer, "quick", quick)
    monkeypatch.setattr(believed, "beside", beside)
    believed.believed(evidence, rows, least, (), links, pool, [()], 2)
    larger = [seen for seen in told.values() if any(seen)]
    assert larger and all(frozenset() in seen for seen in larger)


def test_no_anomaly_is_allowed():
    """With no anomaly at most, the links alone are believed."""
    evidence = evidence_of(log_of(raw(*moved(10.0), torque=0.02, position=1e-5)), ("joint_spring",))
    rows = np.ones(len(evidence.tau), bool)
    least = noise.measure(evidence, rows)
    (links,) = wear.worn_links(columns_of(evidence, "unknown"), least.weights, 0.1)
    assert believed.believed(evidence, rows, least, (), links, list(evidence.candidates), [()], 0)[0].found == ()


@pytest.mark.parametrize("seed", range(4))
def test_a_payload_is_paid_for_as_links_are(seed):
    """Links that are all some percent off are no payload beside smaller link errors, however little noise there is:
    both are paid for by the volume that the log leaves of what was believed of them."""
    draw, model = np.random.default_rng(seed), pin.buildModelFromXML(arm().urdf)
    off = model.copy()
    for link in off.inertias:
        mass, inertia = np.exp(draw.uniform(-0.08, 0.08, 2))
        lever = link.lever + 0.05 * np.linalg.norm(link.lever) * draw.uniform(-1, 1, 3)
        link.mass, link.lever, link.inertia = link.mass * mass, lever, link.inertia * inertia

    def more(t, m):
        """What these links need beyond the nominal torque, by Pinocchio."""
        each = [[pin.rnea(x, x.createData(), *row) for row in zip(m.q, m.qd, m.qdd, strict=True)] for x in (off, model)]
        return np.subtract(*each)

    evidence = evidence_of(log_of(raw(*moved(15.0), more, torque=1e-3, position=1e-7)), ("payload",))
    rows = np.ones(len(evidence.tau), bool)
    least = noise.measure(evidence, rows)
    for share in (0.01, 0.1):
        (links,) = wear.worn_links(columns_of(evidence, "unknown"), least.weights, share)
        assert believed.believed(evidence, rows, least, (), links, list(evidence.candidates), [()], 3)[0].found == ()


@pytest.mark.parametrize(("fitted", "believed_in"), [(0.03, 0.03), (0.9, 0.1)])
def test_links_are_not_believed_far_beyond_the_usual(fitted, believed_in):
    """A fit with links that are off by 90 % is no reason to believe in 90 %: the search begins at the usual 10 %."""
    evidence = evidence_of(log_of(raw(*moved(10.0), torque=0.02, position=1e-5)), ())
    columns, weights = columns_of(evidence, "unknown"), np.ones(3)
    fit = cast(Standard, SimpleNamespace(theta=np.zeros(len(columns.links)), share=fitted))
    _, (links,), _ = wear.beside(columns, fit, weights)
    (asked,) = wear.worn_links(columns, weights, believed_in)
    made, wanted = (np.linalg.norm(evidence.tables[2][:, list(x.columns[2][1])]) for x in (links, asked))
    assert made == pytest.approx(wanted, rel=1e-9)
    assert links.precision == pytest.approx(asked.precision)
