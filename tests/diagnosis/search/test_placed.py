"""A force is found on its link and at its point; where the log does not ask for a point, there is none."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.columns.candidates import passing_candidate
from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.search.placed import at_best_point
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import TimeWindow
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import Term, arm, beyond, evidence_of, log_of, moved, raw

NOISE = 0.02
WINDOW = TimeWindow("run", 3.1, 5.3)
CONTACT = EFFECTS["external_contact"]
LAST = arm().dofs - 1


def weight_at(point: np.ndarray) -> Term:
    """The weight of 0.8 kg at a point of the last link, at rest: a force, from Pinocchio's bodies."""
    inertial = np.array(arm().inertial)
    inertial[LAST, :4] += 0.8 * np.append(1.0, point)

    def term(t, m: Motion) -> np.ndarray:
        still = Motion(m.q, 0 * m.qd, 0 * m.qdd)
        there = (t > WINDOW.start) & (t < WINDOW.end)
        return beyond(arm(), replace(arm(), inertial=inertial), still) * there[:, None]

    return term


def found(point: np.ndarray, tried: int, seed: int) -> Candidate | None:
    """Where a force is placed that is tried at the origin of the frame of `tried`."""
    log = log_of(raw(*moved(10.0, 100.0, seed), weight_at(point), torque=NOISE, seed=seed))
    evidence = evidence_of(log, ("torque_offset", "viscous_friction"))
    c = passing_candidate(evidence, CONTACT, tried, WINDOW)
    lasting = tuple(evidence.candidates)
    return at_best_point(evidence, c, WINDOW, lasting, evidence.valid / NOISE**2, evidence.residual((), np.zeros(0)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("tried", range(arm().dofs))
def test_the_link_and_the_point_are_found(tried, seed):
    """To 5 mm, from the origin of any frame."""
    point = np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
    c = found(point, tried, seed)
    assert c is not None and c.joint == LAST
    assert c.shape["point"] == pytest.approx(point, abs=5e-3)


@pytest.mark.parametrize("seed", range(8))
def test_a_force_at_the_origin_stays_there(seed):
    """Three coordinates that fit noise are no point."""
    assert found(np.zeros(3), LAST, seed) is None
