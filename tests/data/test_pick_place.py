"""data=pick_place: stages, a load that comes and goes, one log for ever, and what is learned and judged."""

import numpy as np
import pytest

from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.errors import UsageError
from invdyn_cli.logfile import read_log
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.references import STAGES, Manipulation
from invdyn_cli.testing import check_source

PLAIN = {"repetitions": 1, "watched": 0, "friction": 0.0, "elastic": False, "ripple": 0.0, "torque_noise": 0.0}


@pytest.fixture(scope="module")
def arm():
    return load_urdf("apollo_arm", dofs=3)


def test_contract(arm, tmp_path):
    """It keeps the contract of a source."""
    check_source(PickPlace(**PLAIN, cache=str(tmp_path)), arm)


def test_the_object_is_held_between_grasp_and_place(arm):
    """Without friction the torques of a loaded repetition are, by Pinocchio, those of the arm and a ball while the hand
    holds it, and those of the arm alone before and after."""
    import pinocchio as pin

    from invdyn_cli.robots import pinocchio_model

    source = PickPlace(**PLAIN, position_noise=0.0, cache=None, filter_cutoff=None, torque_lag=0)
    splits = source.load(arm)
    (x,) = splits.tests["test"].trajectories
    assert list(dict.fromkeys(x.stage)) == list(STAGES) and splits.train.samples == splits.tests["test"].samples
    model, loaded = pinocchio_model(arm), pinocchio_model(arm)
    loaded.inertias[loaded.njoints - 1] += pin.Inertia(0.851, np.array(source.com), 0.4 * 0.851 * 0.02**2 * np.eye(3))

    def left(which, rows):
        m = x.motion
        said = [pin.rnea(which, which.createData(), m.q[k], m.qd[k], m.qdd[k]) for k in rows]
        return np.abs(x.tau[rows] - said).max() / x.tau.std()

    at = {name: np.flatnonzero(x.stage == name) for name in STAGES}
    free, held = np.r_[at["approach"][500:-50:50], at["retract"][200:-50:50]], at["place"][100:-500:50]
    assert left(model, free) < 0.02 < left(model, held)  # half a sample of hold, and differences of positions
    assert left(loaded, held) < 0.02


def test_its_log_is_written_once(arm, tmp_path):
    """The first load writes an invdyn log with stages and masses; the next reads it; another seed is another file."""
    source = PickPlace(**PLAIN, cache=str(tmp_path))
    first = source.load(arm)
    (path,) = tmp_path.iterdir()
    log = read_log(path)
    assert [(t.name, t.payload_mass) for t in log.trajectories] == [("loaded_1", 0.851), ("unloaded_1", 0.0)]
    assert set(log.trajectories[0].stage) == set(STAGES)
    before = path.stat().st_mtime_ns
    np.testing.assert_array_equal(source.load(arm).train.tau, first.train.tau)
    assert path.stat().st_mtime_ns == before
    PickPlace(**PLAIN, cache=str(tmp_path), seed=1).load(arm)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_task_is_what_the_log_has(arm):
    """A repetition before it is played asks for the motion of the log's, has its stages, and holds the object where it
    is loaded; one beyond the log's is another motion."""
    source = PickPlace(**PLAIN, cache=None)
    unloaded, loaded = sorted(source.log(arm).trajectories, key=lambda x: x.payload_mass)
    for raw in (unloaded, loaded):
        task = source.task(arm, 0, loaded=raw is loaded)
        assert task.name == raw.name
        np.testing.assert_array_equal(task.motion(arm, source.rate).q, raw.q_ref)
        np.testing.assert_array_equal(task.stages(raw.t), raw.stage)
        assert [x.effect for x in task.hidden] == ["payload_change"] * (raw is loaded)
    later = source.trial(arm, 0, loaded=True)
    assert np.abs(later.motion(arm, source.rate).q - loaded.q_ref).max() > 1e-3


def test_friction_and_ripple_are_scaled_by_themselves(arm):
    """Half of friction or of ripple is half of each of their torques, and changes no other effect."""

    def torques(**options):
        return [(x.effect, x.joint, x.parameters) for x in PickPlace(**options).hidden(arm)]

    whole, less = torques(friction=1.0, ripple=1.0), torques(friction=0.5, ripple=0.25)
    shares = {"coulomb": 0.5, "static": 0.5, "damping": 0.5, "amplitude": 0.25}
    for (effect, joint, now), (same, at, before) in zip(less, whole, strict=True):
        assert (effect, joint) == (same, at)
        assert now == pytest.approx({name: value * shares.get(name, 1.0) for name, value in before.items()})
    assert {e for e, _, _ in torques(friction=0.0, ripple=0.0)} == {"joint_elasticity"}


def test_repetitions_differ_a_little(arm):
    """Every repetition has its own postures and times, within some hundredths of a radian and tenths of a second."""
    task = Manipulation()
    one, other = (task.motion(arm, 9.6, 1000.0, seed) for seed in (0, 1))
    for posture in (0, -1):
        assert 0 < np.abs(one.q[posture] - other.q[posture]).max() < 0.08
    ends = [task.times(seed)["retract"][1] for seed in range(20)]
    assert 8.0 < min(ends) < max(ends) < 9.6 and np.std(ends) > 0.01
    begin, end = task.times(3)["holds"]
    assert task.times(3)["grasp"][0] < begin < task.times(3)["grasp"][1] < end < task.times(3)["place"][1]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("repetitions", 0), ("mass", 0.0), ("com", [0.0]), ("ramp", [0.3, 0.1]), ("torque_noise", -1.0)],
        *[("seed", -1), ("friction", -0.1), ("ripple", float("nan"))],
    ],
)
def test_wrong_options(name, value):
    """What is out of range is named with what is allowed."""
    with pytest.raises(UsageError, match=f"data.{name}="):
        PickPlace(**{name: value})
