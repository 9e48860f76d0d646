"""Effects of a user's own, one of each kind, from the columns to the files: nothing else knows their names."""

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from invdyn_cli.diagnosis.extension import exported
from invdyn_cli.diagnosis.search.events import places
from invdyn_cli.diagnosis.search.judge import parameters_of
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from invdyn_cli.effects.description import ExtendedModel, as_dict
from invdyn_cli.effects.gear import JointElasticity
from invdyn_cli.effects.load import EncoderOffset, Payload
from invdyn_cli.effects.passing import ExternalContact
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractChannelEffect, AbstractTorqueEffect, JointState, Parameter, Parameters
from invdyn_cli.joints import SimulatorTerms
from invdyn_cli.models.extended import Extended
from invdyn_cli.report.wording import law
from invdyn_cli.types import Array
from tests.diagnosis.analytic import arm, gather, log_of, moved, raw, recording_of


@dataclass(frozen=True)
class CableDrag(AbstractTorqueEffect):
    """A torque with the cube of the speed."""

    name = "cable_drag"
    title = "cable drag"
    meaning = "A cable that drags."
    equation = "cubic qd³"
    reference = "ours, 2026"
    parameters = {"cubic": Parameter("N m s³/rad³", 0.0)}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"damping": parameters["cubic"]}, lost="is held as damping")

    def term(self, parameters: Parameters, state: JointState) -> Array:
        return parameters["cubic"] * state.qd**3

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (state.qd**3,)

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        return {"cubic": coefficients[0]}


@dataclass(frozen=True)
class SoftGain(AbstractChannelEffect):
    """A drive that gives less where more is asked of it."""

    name = "soft_gain"
    title = "soft gain"
    equation = "delivered = logged − bend · logged³"
    reference = "ours, 2026"
    parameters = {"bend": Parameter("1/(N m)²", 0.0, 1e-3)}

    def shapes(self, tau: Array, rate: float) -> Sequence[Parameters]:
        return ({"bend": 1e-5},)

    def delivered(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return tau - parameters["bend"] * tau**3

    def logged(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return tau + parameters["bend"] * tau**3


@dataclass(frozen=True)
class Camera(Payload):
    """A payload by another name."""

    name = "camera"
    title = "camera"


@dataclass(frozen=True)
class SlippedBelt(EncoderOffset):
    """An encoder offset by another name."""

    name = "slipped_belt"
    title = "slipped belt"
    parameters = {"slip": Parameter("rad", -0.8, 0.8)}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"encoder": parameters["slip"]})

    def true(self, parameters: Parameters, motion: Any, joint: int) -> Any:
        return super().true({"offset": parameters["slip"]}, motion, joint)


@dataclass(frozen=True)
class SoftBelt(JointElasticity):
    """An elastic gear by another name."""

    name = "soft_belt"
    title = "soft belt"


@dataclass(frozen=True)
class Push(ExternalContact):
    """A contact by another name."""

    name = "push"
    title = "push"


@dataclass(frozen=True)
class Hose(ExternalContact):
    """A force that is always there."""

    name = "hose"
    title = "hose"
    passing = False


@dataclass(frozen=True)
class Jerk(CableDrag):
    """A torque effect that would come and go."""

    name = "jerk"
    passing = True


OWN = (CableDrag(), SoftGain(), Camera(), SlippedBelt(), SoftBelt(), Push(), Hose())
SIZES = {
    "cable_drag": {"cubic": 0.3},
    "soft_gain": {"bend": 1e-5},
    "camera": {"mass": 0.4, "com": np.array([0.0, 0.01, 0.05]), "inertia": np.full(6, 1e-4) * [1, 0, 1, 0, 0, 1]},
    "slipped_belt": {"slip": 0.02},
    "soft_belt": {"stiffness": 900.0},
    "push": {"force": np.array([1.0, -2.0, 3.0])},
    "hose": {"force": np.array([-2.0, 1.0, 0.5])},
}


def model(*names: str) -> ExtendedModel:
    """An arm with these of the user's effects, on its second joint."""
    when = TimeWindow("one", 1.0, 2.0, 0)
    acting = [EffectInstance(x, 1 if x.of_joint else None, SIZES[x.name], when if x.passing else None) for x in OWN]
    return ExtendedModel(arm(), tuple(a for a in acting if a.effect.name in names))


def test_every_kind_has_candidates():
    """A user's effect of any kind is tried on a log: in columns where it lasts, in windows where it comes and goes."""
    evidence = gather(arm(), recording_of(log_of(raw(*moved(8.0, 200.0)))), OWN, "unknown")
    assert {c.effect.name for c in evidence.candidates} == {x.name for x in OWN if not x.passing}
    assert {x.effect.name for x in places(evidence, {x.name: x for x in OWN}, "unknown")} == {"push"}


def test_what_cannot_come_and_go_is_refused():
    """A torque effect in a window has no columns: the message says which kinds may be passing."""
    evidence = gather(arm(), recording_of(log_of(raw(*moved(8.0, 200.0)))), [Jerk()], "unknown")
    with pytest.raises(
        UsageError, match=r"jerk acts on torque, and .* cannot act in a time window .*; allowed .* bodies, forces"
    ):
        places(evidence, {"jerk": Jerk()}, "unknown")


def test_a_motion_effect_is_read_by_its_own_parameter():
    """The coefficient of a user's motion effect is its parameter, whatever that is called."""
    evidence = gather(arm(), recording_of(log_of(raw(*moved(8.0, 200.0)))), [SlippedBelt()], "unknown")
    trials = [c for c in evidence.candidates if c.joint == 1]
    read = [parameters_of(evidence, c, np.array([0.01])) for c in trials]
    assert [set(p) for p in read] == [{"slip"}] * 3
    assert [p["slip"] - c.shape.get("slip", 0.0) for p, c in zip(read, trials, strict=True)] == pytest.approx(
        [0.01] * 3
    )


def test_all_of_them_are_written_and_read_back():
    """extended_model.json holds every kind, and model=extended reads it with the classes that the user names: the same
    torques; without them the message says which option names them."""
    found = model(*SIZES)
    text = json.dumps(as_dict(found))
    t, m = moved(3.0, 200.0)
    again = Extended(text, effects=OWN).model
    assert [a.effect.name for a in again.acting] == list(SIZES)
    assert again.predict(m.q, m.qd, m.qdd, t) == pytest.approx(found.predict(m.q, m.qd, m.qdd, t), rel=1e-12)
    with pytest.raises(UsageError, match=r"no effect 'cable_drag'.*model\.effects="):
        Extended(text)


def test_all_of_them_are_exported_or_said():
    """MuJoCo loads the arm; what an effect says of itself stands in the file, and what is left out has a sentence."""
    out = exported(model(*SIZES))
    loaded = mujoco.MjModel.from_xml_string(out.mjcf)
    assert loaded.dof_damping[1] == 0.3 and loaded.body("payload").mass[0] == pytest.approx(0.4)
    assert any("cable drag is held as damping" in x for x in out.mjcf_lacks)
    assert all(any(title in x for x in out.mjcf_lacks) for title in ("soft gain", "push"))
    assert "cable drag" in " ".join(out.urdf_lacks) and "slipped belt is written without its encoder" in " ".join(
        out.urdf_lacks
    )


def test_the_report_has_their_law():
    """The equation of a user's effect is shown with its parameters in italics."""
    assert law(CableDrag().text) == "τ += <i>cubic</i> q̇³"


PAGE = (Path(__file__).parents[2] / "docs" / "own_effects.md").read_text(encoding="utf-8")
SEARCHED = "[{_target_: drag.CableDrag}]"


@pytest.fixture
def dragged(tmp_path, monkeypatch) -> float:
    """The files of docs/own_effects.md in the working directory, one of Python and one YAML, with another size [N m
    s³/rad³] of what is hidden."""
    monkeypatch.delitem(sys.modules, "drag", raising=False)  # of another test's folder
    size = round(float(np.random.default_rng(2611).uniform(0.4, 0.9)), 3)
    blocks = re.findall(r"^```(python|yaml)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    (tmp_path / "drag.py").write_text("".join(code for kind, code in blocks if kind == "python"))
    (code,) = [code for kind, code in blocks if kind == "yaml"]
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "dragged.yaml").write_text(code.replace("cubic: 0.6", f"cubic: {size}"))
    return size


def test_an_effect_of_the_users_own_all_the_way(dragged, tmp_path, command):
    """What a class of the user's hides in the simulated arm, and the catalogue lacks, is found by the class that looks
    for it: named, on the right joint and within 3 %, reported in its own words, exported as it says, and read back as a
    model that predicts the log."""
    options = ("data=dragged", "robot.dofs=3")
    less = ("diagnosis.design=false", "diagnosis.replay=false")
    said = command("diagnose", *options, f"diagnosis.effects={SEARCHED}", *less, "hydra.run.dir=found")
    assert said.code == 0, said.err
    told = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    (found,) = [x for x in told["findings"] if x["status"] in ("named", "ambiguous")]
    assert (found["effect"], found["joint"], found["status"]) == ("cable_drag", "arm_joint_2", "named")
    assert found["parameters"]["cubic"]["value"] == pytest.approx(dragged, rel=0.03)
    assert "A cable that drags." in (tmp_path / "found" / "report.html").read_text()
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "found" / told["files"]["mjcf"]))
    assert loaded.dof_damping[1] == pytest.approx(found["parameters"]["cubic"]["value"], rel=1e-3)
    read = ("model=extended", "model.path=found/extended_model.json", f"model.effects={SEARCHED}")
    said = command("run", *options, *read, "hydra.run.dir=again")
    assert said.code == 0, said.err
    metrics = json.loads((tmp_path / "again" / "metrics.json").read_text())
    assert metrics["test"]["rmse"]["joint"]["arm_joint_2"] < 0.02  # [N m] the noise of the log


def test_the_truth_holds_what_is_hidden_in_the_users_words(dragged, tmp_path, command):
    """truth.json and the table of `invdyn simulate` have the name and sizes of a hidden effect of the user's own."""
    said = command("simulate", "data=dragged", "data.duration=2", "robot.dofs=3", "hydra.run.dir=log")
    assert said.code == 0, said.err
    truth = json.loads((tmp_path / "log" / "truth.json").read_text())
    assert truth["effects"] == [{"effect": "dragging cable", "joint": "arm_joint_2", "parameters": {"cubic": dragged}}]
    assert any("dragging cable" in line and f"cubic {dragged}" in line for line in said.out)
