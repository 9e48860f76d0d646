"""A fleet: `invdyn diagnose -m data.path=a.h5,b.h5`, a diagnosis for each log and one page of all."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from invdyn_cli import untrusted
from invdyn_cli.errors import InvdynError, RunFileError
from invdyn_cli.files import write_file
from invdyn_cli.functions.diagnosing import DIAGNOSIS, REPORT
from invdyn_cli.report import fleet
from invdyn_cli.report.fleet import Diagnosed
from invdyn_cli.types import Finding, Quantity
from invdyn_cli.verbs.screen import Screen
from invdyn_cli.verbs.sweep import STATUS, end, run_side_by_side


class Fleet(Callback):
    """Prints the table of all logs when a sweep of diagnoses ends, and writes report.html and fleet.csv.

    Raises SystemExit with exit code 2 if a log was not diagnosed.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Jobs that run in parallel use one thread each."""
        run_side_by_side(config)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Read what the jobs left in their folders."""
        folder = Path(config.hydra.sweep.dir)
        logs = sorted((_diagnosed(path.parent) for path in folder.glob(f"*/{STATUS}")), key=lambda x: x.number)
        if not logs:
            return
        write_file(folder / "fleet.csv", fleet.fleet_csv(logs))
        write_file(folder / REPORT, fleet.page(logs))
        console = Screen()
        console.print(fleet.fleet_table(logs))
        for line in fleet.change_lines(logs):
            console.print(line)
        console.whole(f"page: {folder / REPORT}")
        console.whole(folder)
        end(folder, [one.verdict == "failed" for one in logs])


def _diagnosed(folder: Path) -> Diagnosed:
    """The result of a job; a job that was killed, or left something else, has failed."""
    number, robot, log = 0, "", folder.name
    try:
        left = untrusted.read_json(folder / STATUS, RunFileError)
        number, robot, log = int(left["job"]), str(left["robot"]), str(left["log"])
        if left["status"] != "ran":
            return Diagnosed(number, robot, log, folder.name, "failed", str(left["message"] or "killed"))
        found = untrusted.read_json(folder / DIAGNOSIS, RunFileError)
        findings = tuple(map(_finding, found["findings"]))
        terms = {
            (str(x["effect"]), joint): _quantity(x)
            for joint, row in found["standard"].items()
            for x in (row.values() if joint != "inertials" else ())
        }
        errors = {joint: float(x["rmse"]) for joint, x in found["extended"].items()}
        verdict = str(found["verdict"])
        return Diagnosed(number, robot, log, folder.name, verdict, findings=findings, terms=terms, errors=errors)
    except (InvdynError, ValueError, TypeError, KeyError, AttributeError) as error:
        return Diagnosed(number, robot, log, folder.name, "failed", f"{folder.name} holds something else: {error}")


def _finding(tree: Mapping[str, Any]) -> Finding:
    """A finding of diagnosis.json, with the fields that a page of many logs needs."""
    return Finding(
        effect=str(tree["effect"]),
        joint=None if tree["joint"] is None else str(tree["joint"]),
        status=str(tree["status"]),
        alternatives=tuple(untrusted.names(x, "alternatives") for x in tree["alternatives"]),
        parameters={str(name): _quantity(x) for name, x in tree["parameters"].items()},
        evidence={fleet.TORQUE: dict(tree["evidence"].get(fleet.TORQUE, {}))},
        trajectory=None if tree.get("trajectory") is None else str(tree["trajectory"]),
        window=tuple(tree["window"]) if tree.get("window") else None,
        group=str(tree.get("group", "anomaly")),
    )


def _quantity(tree: Mapping[str, Any]) -> Quantity:
    return Quantity(tree["value"], str(tree["unit"]), tree.get("interval95"))
