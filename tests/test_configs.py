"""Configs and classes agree: every choice composes, and every YAML shows its class's fields with their defaults."""

import inspect
from dataclasses import MISSING, fields, is_dataclass

import hydra
import pytest
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from invdyn_cli import registry
from invdyn_cli.verbs.launch import config_folder
from invdyn_cli.verbs.objects import instantiate
from tests.commands import ROOT

CONF = ROOT / "conf"
VERBS = sorted(p.stem for p in CONF.glob("*.yaml"))
CHOICES = sorted((p.parent.name, p.stem) for p in CONF.glob("*/*.yaml"))
BUILT = [x for x in CHOICES if x[0] in ("model", "adaptation") and x[1] != "extended"]
"""Choices that make an object of a class of their own; `extended` reads one from a file."""
MEANT = {
    ("data", "sim_noisy"): {"noisy": True},
    ("model", "ffnn_deep"): {"hidden": (100, 100, 10), "joints": {}, "epochs": 200},
    ("model", "pest_coulomb"): {"friction": "coulomb_viscous", "offset": True, "weighting": "torque_spread"},
    ("model", "pest_friction"): {
        "rest_speed": 0.003,
        "least_speed": 0.05,
        "weighting": "torque_spread",
        "friction": "stribeck",
        "ripples": 1,
        "rotor_inertia": True,
    },
    ("robot", "apollo_arm"): {"path": "apollo_arm"},
    ("robot", "apollo_four"): {"path": "apollo_arm", "dofs": 4},
    ("robot", "from_log"): {"path": None},
}
"""What makes a choice another one than its class's defaults."""


@pytest.fixture
def compose():
    """compose(verb, override, …) -> the config, by Hydra."""
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        yield lambda verb, *overrides: hydra.compose(verb, list(overrides))


def test_the_checkout_uses_its_own_configs():
    """The configs that are tested here are those that commands use."""
    assert config_folder() == CONF


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_composes(verb, compose):
    """Each verb's config composes as it stands, and every interpolation in it resolves but Hydra's own."""
    config = compose(verb)
    OmegaConf.to_container(config, resolve=True)


@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_every_choice_composes(group, choice, compose):
    """Each choice of each group composes with `invdyn run`, and gives a node that says what it makes."""
    assert "_target_" in compose("run", f"{group}={choice}")[group]


@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_configs_show_every_field(group, choice, compose):
    """A YAML names each field of its class and nothing else: `--help` hides no option, none is invented."""
    node = compose("run", f"{group}={choice}")[group]
    assert {str(name) for name in node if not str(name).startswith("_")} == set(defaults(node))


@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_defaults_agree(group, choice, compose):
    """Python and command line agree: a YAML gives what its class gives by itself, but for what makes the choice."""
    node = compose("run", f"{group}={choice}")[group]
    meant = MEANT.get((group, choice), {})
    expected = {k: meant.get(k, v) for k, v in defaults(node).items() if k in meant or v is not MISSING}
    target = hydra.utils.get_object(node._target_)
    if is_dataclass(target):
        unsaid = [k for k, v in defaults(node).items() if v is MISSING]
        for name in unsaid:
            if OmegaConf.is_missing(node, name) or not isinstance(node[name], DictConfig):
                node[name] = "x"
        missing = {k: instantiate(node[k]) if isinstance(node[k], DictConfig) else "x" for k in unsaid}
        assert instantiate(node) == target(**missing, **meant)
    else:
        assert {k: node[k] for k in expected} == expected


@pytest.mark.parametrize(
    ("overrides", "joints"),
    [
        ((), 4),
        (("data=sim_clean",), 4),
        (("robot.dofs=7",), 7),
        (("robot=apollo_arm",), None),
        (("robot.path=arm.urdf",), None),
        (("robot=urdf", "robot.path=arm.urdf"), None),
        (("data=pick_place",), None),
        (("data=pick_place", "robot=apollo_four"), 4),
    ],
)
def test_sine_tasks_take_the_papers_four_joints(overrides, joints, compose):
    """The paper's simulated data are of its four joints, unless the command line names another robot or number; other
    data are of the whole arm."""
    assert compose("run", *overrides).robot.dofs == joints


@pytest.mark.parametrize(("group", "choice"), BUILT)
def test_files_may_name_every_choice(group, choice, compose):
    """A run of each model and adaptation of the package is read back without the trust that foreign code needs."""
    assert hydra.utils.get_object(compose("run", f"{group}={choice}")[group]._target_) in registry.CLASSES.values()


def defaults(node: DictConfig) -> dict[str, object]:
    """Fields of the class, or arguments of the function, that a node makes; MISSING where there is no default."""
    target = hydra.utils.get_object(node._target_)
    if is_dataclass(target):
        return {f.name: f.default for f in fields(target) if f.init}
    parameters = inspect.signature(target).parameters.values()
    return {p.name: MISSING if p.default is p.empty else p.default for p in parameters}
