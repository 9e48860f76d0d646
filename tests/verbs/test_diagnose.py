"""invdyn diagnose: from a log to named causes, files and a better model."""

import json
import os
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

import invdyn_cli
from experiments.arms import random_arm
from invdyn_cli import load_model
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import UsageError
from invdyn_cli.log import Log
from invdyn_cli.logfile import read_log, write_log
from invdyn_cli.recording.pieces import Preparation
from invdyn_cli.report.better_simulation import MUJOCO
from invdyn_cli.report.diagnosis_page import CHECK, COMMAND, PYTHON
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.verbs.diagnose import effects_of, learner_of, options_of
from invdyn_cli.verbs.launch import config_folder
from tests.commands import ROOT, invdyn

JOINT, COULOMB = "axis2", 2.0
KEYS = {"schema", "verdict", "log_checks", "findings", "baseline", "baselines", "standard", "extended", "noise_floor"}
KEYS |= {"residual_tests", "unexplained", "files"}
CAUSES = ("diagnosis.design=false", "diagnosis.replay=false")
"""For tests of what is found alone: no motion is designed and no simulation is replayed."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """arm.urdf; log.h5 with a hidden Coulomb friction, 20 s of it; old.h5 of the same arm without it. On all joints
    there is friction and a rotor, which nobody declared."""
    folder = tmp_path_factory.mktemp("logs")
    (folder / "arm.urdf").write_text(random_arm(np.random.default_rng(0), 3))
    robot = load_urdf(folder / "arm.urdf")
    worn = [
        Hidden(name, joint, {parameter: value})
        for joint in robot.joints
        for name, parameter, value in (
            ("viscous_friction", "damping", 0.5),
            ("coulomb_friction", "coulomb", 0.5),
            ("quadratic_friction", "drag", 0.3),
            ("rotor_inertia", "armature", 0.05),
        )
    ]
    hidden = Hidden("coulomb_friction", JOINT, {"coulomb": COULOMB})
    logs = {"log": ((hidden,), 1), "old": (worn, 2), "now": ((*worn, hidden), 3)}
    for name, (effects, seed) in logs.items():
        noise = Noise(position=1e-6, torque=0.02)
        log = record(robot, [Multisine()], effects, noise=noise, duration=20.0, seed=seed)
        write_log(replace(log, urdf=str(folder / "arm.urdf")), folder / f"{name}.h5")
    return folder


@pytest.fixture(scope="module")
def diagnosed(folder) -> tuple[Path, str]:
    """The folder of a diagnosis of log.h5, and what the command printed."""
    said = invdyn("diagnose", "data=real_log", "data.path=log.h5", cwd=folder)
    assert (said.returncode, said.stderr) == (0, "")
    return folder / said.stdout.splitlines()[-1], said.stdout


def claims(folder: Path) -> list[tuple]:
    tree = json.loads((folder / "diagnosis.json").read_text())
    return [(x["effect"], x["joint"], x["status"]) for x in tree["findings"] if x["status"] in ("named", "ambiguous")]


def test_names_the_cause_and_the_joint(diagnosed):
    """diagnosis.json, with the keys of its schema, names the hidden effect, its joint and its size, nothing else."""
    tree = json.loads((diagnosed[0] / "diagnosis.json").read_text())
    assert set(tree) == KEYS | {"summary", "unclaimed", "replay", "notes", "details"}
    assert tree["schema"] == "invdyn-diagnosis/1" and tree["verdict"] == "explained"
    assert claims(diagnosed[0]) == [("coulomb_friction", JOINT, "named")]
    assert tree["findings"][0]["parameters"]["coulomb"]["value"] == pytest.approx(COULOMB, rel=0.02)
    assert tree["extended"][JOINT]["rmse"] < 0.2 * tree["baseline"][JOINT]["rmse"]


def test_leaves_its_files(diagnosed):
    """The last line is the folder, called after the log; what diagnosis.json says lies beside it does, and pictures."""
    folder, said = diagnosed
    assert folder.relative_to(folder.parents[3]).parts[:2] == ("outputs", "diagnoses") and folder.name.endswith("-log")
    names = {p.name for p in folder.iterdir() if not p.name.startswith(".")}
    files = json.loads((folder / "diagnosis.json").read_text())["files"]
    assert set(files) == {"model", "urdf", "mjcf", "report"} and names == {*files.values(), "diagnosis.json", "figures"}
    drawn = {p.name for p in (folder / "figures").iterdir()}
    assert drawn == {"torque.png", "overview.png", "torques.png", "replay.png", "finding_01_coulomb_friction.png"}
    assert all(
        word in said for word in ("Explained.", "Coulomb friction", JOINT, "unexplained", "This log cannot show")
    )


def test_the_simulation_is_better(diagnosed):
    """Replayed on held-out data, the arm with the friction is off by a tenth of the nominal one's error at most, and
    needs no torque to be held; the terminal and the report say so."""
    folder, said = diagnosed
    replay = json.loads((folder / "diagnosis.json").read_text())["replay"]
    free, closed = replay["windows"], replay["closed_loop"]
    assert free["gain"] > 0.9 and free["after"][JOINT] < 0.1 * free["before"][JOINT]
    assert closed["torque_before"][JOINT] == pytest.approx(COULOMB, rel=0.3)
    assert closed["torque_after"][JOINT] < 0.1 * COULOMB
    assert replay["not_held"] == [] and "Unconstrained replay in MuJoCo, 0.2 s" in said
    assert "The better simulation" in (folder / "report.html").read_text()


def test_simulators_load_the_files(diagnosed):
    """MuJoCo loads the MJCF, the robot's loader the URDF; both have the friction, and hardly any elsewhere."""
    folder, _ = diagnosed
    robot = load_urdf(folder / "extended_model.urdf", dynamics_tags="use")
    np.testing.assert_allclose(robot.friction, [0.0, COULOMB, 0.0], atol=0.02 * COULOMB)
    np.testing.assert_allclose(robot.damping, 0.0, atol=0.02 * COULOMB)
    model = mujoco.MjModel.from_xml_path(str(folder / "extended_model.mjcf.xml"))
    np.testing.assert_allclose(model.dof_frictionloss, robot.friction, rtol=1e-6)


def test_the_model_predicts_better(diagnosed, folder, command):
    """`invdyn run model=extended` has less than a third of the error of the same model without its effects."""
    made = diagnosed[0] / "extended_model.json"
    tree = json.loads(made.read_text())
    Path("nominal.json").write_text(json.dumps({**tree, "effects": []}))
    errors = {}
    for name, path in (("extended", made), ("nominal", "nominal.json")):
        options = ("data=real_log", f"data.path={folder / 'log.h5'}", "data.decimate=10")
        said = command("run", *options, "model=extended", f"model.path={path}", f"hydra.run.dir={name}")
        assert said.code == 0, said.err
        metrics = json.loads(Path(name, "metrics.json").read_text())
        assert metrics["model"] == "extended" and (metrics["parameters"] > 0) == (name == "extended")
        errors[name] = metrics["test"]["rmse"]["joint"][JOINT]
    assert errors["extended"] < 0.34 * errors["nominal"]
    q = read_log(folder / "log.h5").trajectories[0].q[:4000]
    assert load_model("extended/run.h5").predict(q, 0 * q, 0 * q).shape == q.shape


def test_the_report_promises_what_works(diagnosed, folder, command):
    """The commands and the lines of Python in the report run as they stand, beside the files that they name."""
    place = diagnosed[0]
    text = (place / "report.html").read_text()
    assert COMMAND in text and "load_model" in text
    for name in ("log.h5", "arm.urdf", "extended_model.json"):
        os.link((place if name.endswith("json") else folder) / name, name)
    os.link(place / "extended_model.mjcf.xml", "extended_model.mjcf.xml")
    exec(MUJOCO, {})
    for line in (COMMAND, CHECK):
        said = command(*line.split()[1:], "hydra.run.dir=tried")
        assert said.code == 0, said.err
    known = dict.fromkeys(("q", "qd", "qdd"), np.zeros((50, 3)))
    exec(PYTHON, known)
    assert known["tau"].shape == (50, 3)


def test_the_lines_of_the_docs_run(folder, command):
    """The lines on check and diagnosis in docs/python.md run as they stand, and find the cause."""
    page = (ROOT / "docs" / "python.md").read_text()
    script = next(code for code in page.split("```python\n")[1:] if code.startswith("checked =")).split("```")[0]
    os.link(folder / "arm.urdf", "arm.urdf")
    one = read_log(folder / "log.h5").trajectories[0]
    qd = np.gradient(one.q, one.t, axis=0)
    known = {"invdyn": invdyn_cli, "q": one.q, "tau": one.tau, "t": one.t, "qd": qd}
    known["qdd"] = np.gradient(qd, one.t, axis=0)
    exec(script, known)
    found = known["result"].findings[0]
    assert known["checked"].usable and (found.effect, found.joint) == ("coulomb_friction", JOINT)
    assert known["tau"].shape == one.q.shape


def test_what_is_known_is_not_found_again(folder, command):
    """A declared cause, with its size, is in the extended model and not among the findings."""
    known = f"diagnosis.known=[{{effect: coulomb_friction, joint: {JOINT}, coulomb: {COULOMB}}}]"
    said = command("diagnose", f"data.path={folder / 'log.h5'}", known, *CAUSES, "hydra.run.dir=out")
    assert said.code == 0, said.err
    assert claims(Path("out")) == []
    acting = load_model("out/extended_model.json").acting
    assert sum(x.parameters["coulomb"] for x in acting if x.key == ("coulomb_friction", 1)) == pytest.approx(
        COULOMB, rel=0.02
    )


def test_a_reference_shows_what_has_changed(folder, command):
    """With an earlier log as reference, friction and rotors of both logs are no findings, the new friction is."""
    options = (f"data.path={folder / 'now.h5'}", f"data.reference={folder / 'old.h5'}")
    said = command("diagnose", *options, *CAUSES, "hydra.run.dir=out")
    assert said.code == 0, said.err
    assert {(effect, joint) for effect, joint, _ in claims(Path("out"))} == {("coulomb_friction", JOINT)}


def test_stretches_and_several_logs(folder, command):
    """Selections say what chooses, what judges and what is compared with, over two logs; a learner may be named."""
    said = command(
        "diagnose",
        f"data.path=[{folder / 'log.h5'},{folder / 'old.h5'}]",
        'data.train=["log/trajectory_1[0:12]"]',
        'data.test=["log/trajectory_1[12:]"]',
        "data.filter_cutoff=5",
        "model@diagnosis.learner=ffnn",
        "diagnosis.learner.epochs=1",
        *CAUSES,
        "hydra.run.dir=out",
    )
    assert said.code == 0, said.err
    assert ("coulomb_friction", JOINT) in {x[:2] for x in claims(Path("out"))}
    assert "data: data.filter_cutoff is not used: the log is taken as it was recorded" in said.out
    model = json.loads(Path("out/extended_model.json").read_text())
    assert model["provenance"]["trajectories"] == ["log/trajectory_1"]


def test_a_reference_within_the_same_logs(folder):
    """Stretches of a trajectory may be the reference, and the rest of it judge; what is named by nobody chooses."""
    paths = (folder / "log.h5", folder / "old.h5")
    names = {"reference": "old/trajectory_1[:10]", "test": ["old/trajectory_1[10:]"]}
    made = RealLog(path=list(map(str, paths)), **names).recorded(load_urdf(folder / "arm.urdf"))
    assert [x.name for x in made.reference.trajectories] == ["old/trajectory_1[:10]"]
    assert made.reference.trajectories[0].q.shape == (10_000, 3)
    assert [x.name for x in made.log.trajectories] == ["log/trajectory_1", "old/trajectory_1"]
    assert made.windows == {
        "train": [("log/trajectory_1", -np.inf, np.inf)],
        "test": [("old/trajectory_1", 10.0, np.inf)],
    }
    whole = RealLog(path=list(map(str, paths)), reference="old/trajectory_1").recorded(None)
    assert [x.name for x in whole.log.trajectories] == ["log/trajectory_1"] and whole.windows is None


def test_effects_of_ones_own():
    """diagnosis.effects adds to the catalogue, and takes the place of what has the same name there."""
    node = {"_target_": "invdyn_cli.effects.friction.StribeckFriction", "velocities": [0.1]}
    made = effects_of(OmegaConf.create({"diagnosis": {"effects": [node]}}))
    assert set(made) == set(EFFECTS) and list(made["stribeck_friction"].velocities) == [0.1]


def test_a_simulated_arm_is_diagnosed_at_once(folder, command):
    """data=plant plays, then diagnoses; the folder is called after it."""
    effect = f"data.effects=[{{effect: coulomb_friction, joint: {JOINT}, coulomb: {COULOMB}}}]"
    arm = ("robot=urdf", f"robot.path={folder / 'arm.urdf'}")
    said = command("diagnose", "data=plant", *arm, effect, *CAUSES, "data.trajectories=1", "data.duration=12")
    assert said.code == 0, said.err
    assert said.out[-1].endswith("-plant")
    assert ("coulomb_friction", JOINT) in {x[:2] for x in claims(Path(said.out[-1]))}


def test_a_step_is_told_when_it_begins(folder, command, monkeypatch):
    """While the log is diagnosed the screen does not say that the next motion is designed."""
    begun: list[str] = []

    @contextmanager
    def stages(**_):
        yield lambda name: begun.append(name) or (lambda done, note: None)

    def interrupted(*_, progress, **__):
        progress(0.1, "checked")
        raise UsageError("enough")

    monkeypatch.setattr("invdyn_cli.verbs.diagnose.screen.stages", stages)
    monkeypatch.setattr("invdyn_cli.verbs.diagnose.explain", interrupted)
    assert command("diagnose", f"data.path={folder / 'log.h5'}").code == 2
    assert begun == ["read", "data", "diagnose"]


def test_configs_agree_with_classes():
    """conf/diagnose.yaml shows every field of the conditioning with its default."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("diagnose")
    shown = {name: x for name, x in config.diagnosis.conditioning.items() if name != "_target_"}
    own = vars(Preparation())
    assert {k: tuple(v) if isinstance(own[k], tuple) else v for k, v in shown.items()} == own
    assert options_of(config).most is None and len(effects_of(config)) > 15 and learner_of(config) is None


def log_of(folder: Path, **channels) -> Log:
    """log.h5 with channels put in their place, bare of all that is not needed."""
    log = read_log(folder / "log.h5")
    one = replace(log.trajectories[0], qd=None, qdd=None, q_ref=None, q_link=None)
    return replace(log, trajectories=(replace(one, **{c: f(one) for c, f in channels.items()}),))


def first(seconds: float):
    return {c: lambda one, c=c: getattr(one, c)[: int(1000 * seconds)] for c in ("t", "q", "tau")}


SENSELESS = {
    "all zero": {"q": lambda x: 0 * x.q, "tau": lambda x: 0 * x.tau},
    "one posture": {"q": lambda x: x.q[:1] + 0 * x.q},
    "torque of noise": {"tau": lambda x: 10 * np.random.default_rng(0).normal(size=x.tau.shape)},
    "half a second": first(0.5),
    "one sample": first(0.001),
    "no number": {"tau": lambda x: np.nan * x.tau},
    "a clock that stands": {"t": lambda x: 0 * x.t},
}


@pytest.mark.parametrize("name", SENSELESS)
def test_a_senseless_log_is_described(name, folder, command):
    """Whatever is in a log, there is a verdict and no traceback: log_unusable, with a reason, no model, exit code 0."""
    write_log(log_of(folder, **SENSELESS[name]), "log.h5")
    said = command(
        "diagnose", "data.path=log.h5", "robot=urdf", f"robot.path={folder / 'arm.urdf'}", "hydra.run.dir=out"
    )
    assert (said.code, said.err) == (0, [])
    tree = json.loads(Path("out/diagnosis.json").read_text())
    assert tree["verdict"] == "log_unusable" and tree["files"] == {"report": "report.html"}
    assert tree["summary"].startswith("This log cannot be diagnosed: ")
    assert {p.name for p in Path("out").iterdir() if p.name[0] != "."} == {"diagnosis.json", "report.html"}


def test_strict_tells_by_the_exit_code(folder, command):
    """strict=true: exit code 1 where a check failed; the files are there all the same."""
    write_log(log_of(folder, **SENSELESS["all zero"]), "log.h5")
    arm = ("robot=urdf", f"robot.path={folder / 'arm.urdf'}")
    said = command("diagnose", "data.path=log.h5", *arm, "strict=true", "hydra.run.dir=out")
    assert said.code == 1 and Path("out/diagnosis.json").is_file()


def test_an_old_result_does_not_outlive_a_failure(folder, command):
    """In a folder used again, an unusable log leaves no model of the log before it."""
    Path("out").mkdir()
    Path("out/extended_model.json").write_text("{}")
    write_log(log_of(folder, **SENSELESS["all zero"]), "log.h5")
    arm = ("robot=urdf", f"robot.path={folder / 'arm.urdf'}")
    assert command("diagnose", "data.path=log.h5", *arm, "hydra.run.dir=out").code == 0
    assert not Path("out/extended_model.json").exists()


MISUSE = {
    "no log": (("data.path=nix.h5",), "no log nix.h5"),
    "nothing said": ((), "data.path is not set"),
    "no measured log": (("data=sim_clean",), "allowed: a measured log"),
    "another robot": (("robot=apollo_arm",), "no moving joint 'axis1'"),
    "no robot": (("robot=urdf", "robot.path=nix.urdf"), "no robot description"),
    "no trajectory": (("data.train=[walk]",), "no trajectory 'walk'"),
    "no test": (("data.train=[trajectory_1]",), "data.test is empty"),
    "no samples": (('data.test=["trajectory_1[90:]"]',), "no samples in trajectory_1[90:]"),
    "overlap": (('data.train=["trajectory_1[:12]"]', 'data.test=["trajectory_1[10:]"]'), "overlap"),
    "nothing but a reference": (("data.reference=[trajectory_1]",), "data.reference names all"),
    "unknown cause": (("diagnosis.known=[coulomb]",), "no effect 'coulomb'"),
    "unknown joint": (("diagnosis.known=[coulomb_friction@elbow]",), "no joint 'elbow'"),
    "known": (("diagnosis.known=3",), "diagnosis.known=3; allowed: a list"),
    "most": (("diagnosis.most=-1",), "allowed: a whole number from 0"),
    "replay": (("diagnosis.replay=maybe",), "diagnosis.replay=maybe; allowed: true or false"),
    "share": (("data.train_share=1",), "data.train_share=1; allowed: above 0, below 1"),
    "rate": (("diagnosis.conditioning.rate=0",), "diagnosis.conditioning.rate=0"),
    "an effect that is none": (("diagnosis.effects=[{_target_: nix.Nix}]",), "No module named 'nix'"),
    "a learner that is none": (("diagnosis.learner=3",), "model@diagnosis.learner=ffnn"),
    "seed": (("seed=-1",), "seed=-1"),
    "an option that is none": (("diagnosis.knwon=[]",), "did you mean 'diagnosis.known'"),
}


@pytest.mark.parametrize("name", MISUSE)
def test_misuse_is_one_line(name, folder, command):
    """Wrong use: one line that says what is allowed, exit code 2, and no files."""
    overrides, words = MISUSE[name]
    path = (
        () if any(x.startswith(("data.path", "data=")) for x in overrides) or not overrides else ("data.path=log.h5",)
    )
    os.link(folder / "log.h5", "log.h5")
    os.link(folder / "arm.urdf", "arm.urdf")
    said = command("diagnose", *path, *overrides, "hydra.run.dir=out")
    assert said.code == 2
    assert len(said.err) == 1 and words in said.err[0]
    assert not Path("out").exists() or not [p for p in Path("out").iterdir() if p.name[0] != "."]


def test_as_recorded(folder, command):
    """correct=false: a clock in ms is not corrected; the log is unusable, and diagnosis.json and the page say why."""
    log = read_log(folder / "log.h5")
    late = tuple(replace(raw, t=1e3 * raw.t) for raw in log.trajectories)
    write_log(replace(log, trajectories=late), Path("late.h5"))
    robot = ("robot=urdf", f"robot.path={folder / 'arm.urdf'}")
    said = command("diagnose", "data.path=late.h5", *robot, "correct=false", "hydra.run.dir=out")
    assert said.code == 0, said.err
    found = json.loads(Path("out/diagnosis.json").read_text())
    assert found["verdict"] == "log_unusable" and found["log_checks"]["as_recorded"] is True
    assert found["log_checks"]["corrections"] == []
    assert any("correct=false" in note for note in found["notes"]) and "correct=true" in found["summary"]
    assert "correct=false" in Path("out/report.html").read_text("utf-8")
    assert command("diagnose", "data.path=late.h5", *robot, "correct=7").code == 2
