"""Currents without drive gains: masses tell gains where gravity or inertia shows, else only ratios are known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from experiments.cases import Scene, draw_effect, draw_scene, scene_of
from invdyn_cli.diagnosis import diagnose, gains
from invdyn_cli.diagnosis.case import Options
from invdyn_cli.diagnosis.decide.wording import SINCE
from invdyn_cli.log import Log
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Diagnosis, Quantity
from tests.commands import usually
from tests.diagnoses import diagnosis_of

UPRIGHT = 1
"""Seed of an arm whose first axis is vertical, so that gravity does not load it."""


def currents(
    seed: int, speed: float = 0.3, noise: Sequence[float] = (0.003,) * 3, known: bool = False
) -> tuple[Log, np.ndarray, list[Hidden], Scene]:
    """A log of a three-joint MuJoCo arm with friction on every joint, as currents of drives with gains (n,) drawn from
    2 to 60 N m/A."""
    draw = np.random.default_rng([seed, 99])
    reference = Multisine(speed=speed)
    scene = scene_of(draw_scene(draw, 3).robot, reference, 24.0, seed)
    robot, torque = scene.robot, np.maximum(scene.torque, 0.03 * scene.torque.max())
    usual = replace(scene, torque=torque)
    names = ("coulomb_friction", "viscous_friction")
    hidden = [draw_effect(draw, usual, name, j) for j in range(robot.dofs) for name in names]
    sensors = Noise(torque=tuple(np.array(noise) * torque), position=3e-6)
    log = record(robot, [reference], hidden, noise=sensors, duration=24.0, seed=seed, position_side="motor")
    gain = np.exp(draw.uniform(np.log(2), np.log(60), robot.dofs))
    trajectories = tuple(replace(x, tau=x.tau / gain) for x in log.trajectories)
    made = replace(log, torque_unit="A", torque_side="motor", trajectories=trajectories)
    return replace(made, drive_gain=gain) if known else made, gain, hidden, scene


def sizes(diagnosis: Diagnosis) -> dict[tuple[str, str | None], Quantity]:
    """The size of each claim that has one alone."""
    claims = [f for f in diagnosis.findings if f.status in ("named", "ambiguous") and len(f.parameters) == 1]
    return {(f.effect, f.joint): next(iter(f.parameters.values())) for f in claims}


@pytest.mark.parametrize("seed", usually([1], [1, 2]))
def test_masses_tell_the_gains(seed):
    """Gains are within 5 % and within three standard errors, friction of joints that gravity loads is within 5 % of the
    truth in N m; the report says so in one sentence, and the written model records the gains."""
    log, gain, hidden, scene = currents(seed)
    diagnosis = diagnose(log, scene.robot, options=Options(replay=False))
    assert diagnosis.model is not None
    told = diagnosis.model.provenance["drive_gains"]
    value, error = (np.array([x[k] for x in told.values()]) for k in ("value", "standard_error"))
    assert list(told) == list(log.joints) and all(x["known"] for x in told.values())
    np.testing.assert_allclose(value, gain, rtol=0.05)
    assert np.all(np.abs(value - gain) < 3 * error)
    said = [x for x in diagnosis.notes if "drive gains" in x]
    assert len(said) == 1 and "only ratios" not in said[0]
    found = sizes(diagnosis)
    for one in hidden:
        (true,) = one.parameters.values()
        if (one.effect, one.joint) in found:
            assert found[one.effect, one.joint].value == pytest.approx(true, rel=0.05)
            assert found[one.effect, one.joint].unit.startswith("N m")
    assert len(found) >= 4


def test_without_gravity_and_inertia_only_ratios_are_known():
    """A vertical joint that hardly accelerates shows friction alone: its gain is not known, the report says that only
    ratios are, and its friction is right in A and said so; other joints are in N m."""
    log, gain, hidden, scene = currents(UPRIGHT, speed=0.03, noise=(0.3, 0.003, 0.003))
    first = log.joints[0]
    diagnosis = diagnose(log, scene.robot, options=Options(replay=False))
    assert diagnosis.model is not None
    told = diagnosis.model.provenance["drive_gains"]
    assert [x["known"] for x in told.values()] == [False, True, True]
    np.testing.assert_allclose([x["value"] for x in told.values()][1:], gain[1:], rtol=0.05)
    assert sum(f"Gravity and inertia hardly act on {first}: only ratios" in x for x in diagnosis.notes) == 1
    assert diagnosis.details["torque_in_A"] == [first]
    size = diagnosis.standard[first]["coulomb"]
    assert size["unit"] == "A" and diagnosis.standard[first]["viscous"]["unit"] == "A s/rad"
    assert size["value"] == pytest.approx(hidden[0].parameters["coulomb"] / gain[0], rel=0.1)
    assert sizes(diagnosis)["coulomb_friction", first].unit == "A"
    assert sizes(diagnosis)["coulomb_friction", log.joints[1]].unit == "N m"


def test_gains_that_are_said_are_taken():
    """A log that says its gains is diagnosed with them, and nothing is estimated."""
    log, _, _, scene = currents(UPRIGHT, known=True)
    assert not gains.lacks(log)
    diagnosis = diagnose(log, scene.robot, options=Options(most=0))  # what is wrong beside the gains is not asked
    assert diagnosis.model is not None and "drive_gains" not in diagnosis.model.provenance


def test_noise_tells_no_gain():
    """Currents that are noise tell no joint's gain, and the doctor says what is missing."""
    log, _, _, scene = currents(UPRIGHT)
    draw = np.random.default_rng(0)
    noise = tuple(replace(x, tau=draw.normal(size=x.tau.shape)) for x in log.trajectories)
    diagnosis = diagnose(replace(log, trajectories=noise), scene.robot)
    assert diagnosis.verdict == "log_unusable" and "no drive gains" in diagnosis.summary


def test_sizes_go_over_into_amperes():
    """A size and its interval are divided by the gain, its unit by N m/A; a gain's error widens what stays in N m; what
    has no torque in its unit stays."""
    unknown, known = gains.Scale(20.0, 0.0), gains.Scale(1.0, 0.03)
    assert unknown.quantity(Quantity(2.0, "N m s/rad", [1.0, 4.0])) == Quantity(0.1, "A s/rad", [0.05, 0.2])
    assert unknown.quantity(Quantity(2.0, "kg m²", [1.0, 4.0])).unit == "A s²/rad"
    assert unknown.quantity(Quantity(2.0, "N", [1.0, 4.0])).unit == "A"
    assert unknown.quantity(Quantity(0.004, "rad", [0.003, 0.005])) == Quantity(0.004, "rad", [0.003, 0.005])
    told = known.quantity(Quantity(1.0, "N m", [0.96, 1.04]))
    assert told.unit == "N m" and told.interval95 == pytest.approx([0.95, 1.05])


def test_what_each_log_has_goes_over_into_amperes():
    """The row of a standard term is in one unit, what each log of a comparison has by itself among it."""
    row = {"value": 2.0, "unit": "N m", "interval95": [1.0, 3.0], "now": (4.0, 3.0, 5.0), "differ": True}
    told = gains.Scale(20.0, 0.0).row(row)
    assert (told["unit"], told["value"], told["differ"]) == ("A", 0.1, True)
    assert told["now"] == pytest.approx((0.2, 0.15, 0.25)) and "reference" not in told


def test_all_that_is_told_of_a_joint_goes_over_into_amperes():
    """Claims, what is not claimed, and the errors of a comparison, of the joint whose gain is not known; all else
    stays."""
    diagnosis = diagnosis_of([("coulomb_friction", 0, {}), ("coulomb_friction", 1, {})])
    errors = {joint: {"rmse": 10.0, "nmse": 0.5} for joint in diagnosis.baseline}
    diagnosis = replace(diagnosis, unclaimed=diagnosis.findings[:2], details={SINCE: [errors]})
    known = np.arange(len(errors)) > 0
    found = gains.Gains(tuple(errors), ("N m/A",) * 7, np.full(7, 5.0), np.where(known, 0.01, 5.0))
    told = gains.beside(diagnosis, found)
    size = diagnosis.findings[0].parameters["coulomb"].value
    for one in (told.findings, told.unclaimed):
        assert [f.parameters["coulomb"].unit for f in one[:2]] == ["A", "N m"]
        assert [f.parameters["coulomb"].value for f in one[:2]] == pytest.approx([size / 5, size])
    assert [x["rmse"] for x in told.details[SINCE][0].values()] == pytest.approx([2.0, *[10.0] * 6])
