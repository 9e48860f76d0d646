"""The available experiments: experiments/NAME.yaml in the package or the checkout, and in the working folder."""

import sys
from importlib.machinery import ModuleSpec
from importlib.util import module_from_spec
from pathlib import Path
from typing import Any

import yaml
from omegaconf import OmegaConf

from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.verbs.launch import config_folder

SWEEP = ("title", "source", "columns", "jobs")
"""What the file of an experiment says that is a sweep of runs."""
CLASS = ("title", "_target_")
"""What the file of an experiment says that is a class; all else in it is options."""


def places() -> list[Path]:
    """The folders of experiments; the package's own comes first, so that no other folder changes it."""
    return [config_folder().with_name("experiments"), Path.cwd() / "experiments"]


def names() -> list[str]:
    """All experiments."""
    return sorted({path.stem for place in places() for path in place.glob("*.yaml")})


def path_of(name: str) -> Path:
    """The YAML of an experiment.

    Raises:
        UsageError: if there is none, naming those that there are.
    """
    for place in places():
        if (place / f"{name}.yaml").is_file():
            return place / f"{name}.yaml"
    raise UsageError(f"experiment={name}; allowed: {listed(names(), most=30)}{closest(name, names())}")


def read(name: str) -> dict[str, Any]:
    """The contents of the YAML of an experiment.

    Raises:
        UsageError: if there is no such experiment, or its file lacks something.
    """
    path = path_of(name)
    try:
        spec = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise UsageError(f"{path} cannot be read as an experiment: {error}") from error
    needed = CLASS if isinstance(spec, dict) and "_target_" in spec else SWEEP
    for allowed, one in ((needed, spec), *((("name", "overrides"), job) for job in _jobs(spec))):
        if lacking := [name for name in allowed if not isinstance(one, dict) or name not in one]:
            raise UsageError(
                f"{path} lacks {listed(lacking)}; an experiment needs {listed(SWEEP)} (each job "
                f"with a name and overrides), or {listed(CLASS)}"
            )
    return spec  # pyright: ignore[reportReturnType]


def _jobs(spec: Any) -> list:
    jobs = spec.get("jobs") if isinstance(spec, dict) else None
    return jobs if isinstance(jobs, list) else []


def admit(folders: list[Path]) -> None:
    """Make `experiments.NAME` importable from these folders; the first one has precedence."""
    package = sys.modules.get("experiments")
    if package is None:
        spec = ModuleSpec("experiments", None, is_package=True)
        package = sys.modules["experiments"] = module_from_spec(spec)
    for folder in map(str, folders):
        if folder not in package.__path__:
            package.__path__.append(folder)
