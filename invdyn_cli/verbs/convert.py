"""invdyn convert: files of other formats -> an invdyn log, and the column map that made it beside the log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from invdyn_cli.errors import LogError, RobotError, UsageError
from invdyn_cli.files import relative, write_file
from invdyn_cli.formats import map_file
from invdyn_cli.formats.columns import ColumnMap
from invdyn_cli.formats.map_file import ENTRIES
from invdyn_cli.formats.reading import imported
from invdyn_cli.functions.inputs import robot_of
from invdyn_cli.logfile import write_log
from invdyn_cli.verbs import imports
from invdyn_cli.verbs.launch import launch, quoted
from invdyn_cli.verbs.run import refuse_flags, size_limit
from invdyn_cli.verbs.screen import Screen

OWN = ("source", "output", "columns", "force", "max_size", "hydra")


def main(argv: Sequence[str]) -> int:
    """Convert with the overrides in argv, bare paths meaning source= and, the last, output=; the exit code."""
    paths = [a for a in argv if not _is_option(a)]
    given = [a for a in argv if _is_option(a)]
    if paths[1:]:
        given += [f"source=[{','.join(map(quoted, paths[:-1]))}]", f"output={quoted(paths[-1])}"]
    elif paths:
        given += [f"source={quoted(paths[0])}"]
    return launch("convert", given, task)


def task(config: DictConfig) -> None:
    """Read, show, write."""
    console = Screen()
    output = _output(config)
    sources = list(config.source) if isinstance(config.source, ListConfig) else [config.source]
    made = imported([str(x) for x in sources], _given(config), size_limit(config))
    imports.show(made.log, made.columns, console)
    if Path(made.log.urdf).suffix == ".urdf" and Path(made.log.urdf).is_file():
        try:
            robot_of(None, made.log)
        except RobotError as error:
            raise LogError(str(error).replace("robot.joints=", "joints=")) from None
    write_log(made.log, output)
    kept = output.with_suffix(".columns.yaml")
    write_file(kept, map_file.to_yaml(made.columns, Path(str(sources[0])).name, kept.parent))
    console.whole(f"column map: {relative(kept)}")
    console.whole(relative(output))


def _given(config: DictConfig) -> ColumnMap:
    """What the map of `columns` says, and the command line beside it, which wins."""
    own: Any = OmegaConf.to_container(config, resolve=True)
    said = map_file.from_plain({name: own[name] for name in ENTRIES}, "convert")
    if config.columns is None:
        return said
    if not isinstance(config.columns, str):
        raise UsageError(f"columns={config.columns}; allowed: the path of a column map, NAME.yaml")
    return map_file.merged(map_file.load(Path(config.columns).expanduser()), said)


def _output(config: DictConfig) -> Path:
    """The path of the new log.

    Raises:
        UsageError: if it is none, or there is a file already and force is not set.
    """
    refuse_flags(config, "force")
    output = Path(str(config.output)).expanduser()
    if output.suffix not in (".h5", ".hdf5"):
        raise UsageError(f"output={output}; allowed: the path of a new log, NAME.h5")
    if output.exists() and not (config.force and output.is_file()):
        raise UsageError(f"{output} is there already; allowed: a new path", advice="force=true to replace a file")
    return output


def _is_option(argument: str) -> bool:
    """Whether an argument sets an option; paths may have a "=" in them, too."""
    name = argument.lstrip("+~").partition("=")[0].partition(".")[0]
    return argument.startswith("-") or ("=" in argument and (name in (*OWN, *ENTRIES) or not Path(argument).exists()))
