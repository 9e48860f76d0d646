"""Names of result folders, and outputs/latest, which links to the newest finished one."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import ListConfig, OmegaConf

OUTPUTS, LATEST = "outputs", "latest"
GROUPS = ("model", "data", "adaptation")
"""Groups whose choices name a job, in this order."""

LONGEST_PART, LONGEST = 40, 100
"""Characters of a part of a name, and of a name."""


def safe(text: Any) -> str:
    """A text as a part of a file's name: letters, digits and -_.+ stay, others become "_"."""
    return "".join(c if c.isalnum() or c in "-_.+" else "_" for c in str(text))[:LONGEST_PART].lstrip(".") or "_"


def job_name(choices: Mapping[str, Any], seed: Any) -> str:
    """The parts of a run folder's name: model, data, adaptation and seed."""
    return "-".join([*(safe(choices[group]) for group in GROUPS if choices.get(group)), f"seed{safe(seed)}"])


def log_name(path: Any) -> str:
    """The name of a diagnosis folder: that of the log, of the first of several, or of the source without a log."""
    paths = [str(x) for x in path] if isinstance(path, list | tuple | ListConfig) else [str(path)]
    more = f"+{len(paths) - 1}" if len(paths) > 1 else ""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in Path(paths[0]).stem) + more


def sweep_folder(overrides: Sequence[str], defaults: Mapping[str, str]) -> Path:
    """The folder of a sweep over these overrides, the same for the same ones: run again, the sweep goes on.

    `defaults` are the choices of the groups that no override names. A name that another sweep has taken gets a number.
    """
    split = (override.lstrip("+~").partition("=") for override in sorted(overrides))
    given: dict[str, str] = {key: value for key, _, value in split}
    parts = [given.pop(group, defaults.get(group, "")) for group in GROUPS]
    seed = given.pop("seed", "")
    parts += [f"{key.rpartition('.')[2]}{value}" for key, value in given.items()] + [f"seed{seed}"] * bool(seed)
    name = "-".join(safe(part.replace(",", "+")) for part in parts if part)[:LONGEST]
    number = 1
    while True:
        folder = Path(OUTPUTS, "sweeps", f"{name}-{number}" if number > 1 else name)
        if _swept(folder) in (None, sorted(overrides)):
            return folder
        number += 1


def job_folder(number: int, overrides: Sequence[str], fixed: Sequence[str]) -> str:
    """What the folder of a job of a sweep is called after: its number, and the overrides in which it differs from other
    jobs, those of all but the `fixed` keys."""
    split = [override.lstrip("+~").partition("=") for override in overrides]
    parts = [_value(key, value) for key, _, value in split if key not in fixed]
    return "-".join([str(number), *filter(None, parts)])[:LONGEST].rstrip("-_.")


def _value(key: str, value: str) -> str:
    """A value in a folder's name: a choice as it is, a file by its name, a number after the name of its option."""
    name = key.rpartition(".")[2]
    if name == "path":
        return safe(Path(value.strip("'\"")).stem)
    return safe(("" if key in GROUPS or "@" in key else name) + value.strip("'\"[]{}"))


def of_jobs(argv: Sequence[str]) -> list[str]:
    """The override that tells `job_folder` which options are equal in all jobs of a sweep; [] without a sweep."""
    if not {"-m", "--multirun"} & set(argv):
        return []
    fixed = []
    for text in (a for a in argv if "=" in a and not a.startswith(("-", "hydra.", "hydra/", "+hydra"))):
        with suppress(HydraException):
            one = OverridesParser.create().parse_override(text)
            fixed += [one.get_key_element().lstrip("+~")] * (not one.is_sweep_override())
    return [f"hydra.job.config.override_dirname.exclude_keys=[{','.join(map(repr, fixed))}]"]


def _swept(folder: Path) -> list[str] | None:
    """The overrides of the sweep in a folder, sorted; None where there is none."""
    try:
        kept = yaml.safe_load((folder / "multirun.yaml").read_text(encoding="utf-8"))
        return sorted(map(str, kept["hydra"]["overrides"]["task"]))
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return None


def point_to(folder: Path) -> None:
    """Let outputs/latest lead to a finished folder of a verb below outputs/: a relative link, or, where links are not
    possible, a text file with the path. A folder of that name that a user made stays."""
    root = Path.cwd() / OUTPUTS
    place = Path(os.path.abspath(folder))  # noqa: PTH100 (resolve() would follow links)
    if root not in place.parents or place.parent == root:
        return
    relative, link, made = place.relative_to(root), root / LATEST, root / f".{LATEST}.{os.getpid()}"
    with suppress(OSError):
        try:
            made.symlink_to(relative, target_is_directory=True)
        except OSError:
            made.write_text(f"{relative}\n", encoding="utf-8")
        try:
            made.replace(link)
        finally:
            made.unlink(missing_ok=True)


OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)
OmegaConf.register_new_resolver("job_name", job_name, replace=True)
OmegaConf.register_new_resolver("log_name", log_name, replace=True)
