"""Link errors and anomalies, grown together until the evidence grows no more."""

import numpy as np

from invdyn_cli.diagnosis import standard, wear
from invdyn_cli.diagnosis.search import believed, noise
from tests.diagnosis.analytic import evidence_of, log_of, moved, on, raw


def test_growing_ends_where_it_was_before(monkeypatch):
    """Where two hypotheses each beat the other, as the noise that one leaves may have it, none is grown twice."""
    names = ("coulomb_friction", "torque_delay", "joint_spring", "link_inertia_error")
    friction = on(0, lambda t, q, qd, qdd: 2.0 * np.tanh(qd / 0.01))
    evidence = evidence_of(log_of(raw(*moved(10.0), friction, torque=0.02, position=1e-5)), names)
    rows = np.ones(len(evidence.tau), bool)
    least = noise.measure(evidence, rows)
    (links,) = wear.worn_links(standard.columns_of(evidence, "unknown"), least.weights, 0.1)
    pool = [c for c in evidence.candidates if c.effect.name in ("torque_delay", "joint_spring")]
    grown, more = [], believed._more
    monkeypatch.setattr(believed.Belief, "beats", lambda self, other, rows: len(self.found) != len(other.found))
    monkeypatch.setattr(believed, "_more", lambda *x: (grown.append((x[1].links, frozenset(x[1].found))), more(*x))[1])
    believed.believed(evidence, rows, least, (), links, pool, [()], 6)
    assert len(grown) > len(believed.SMALLER)
    assert len({(id(x), found) for x, found in grown}) == len(grown)
