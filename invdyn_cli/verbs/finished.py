"""Finished runs read from their folders, for pages that show several of them."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from invdyn_cli import store, untrusted
from invdyn_cli.errors import InvdynError, RunFileError
from invdyn_cli.report.compared import MOST_CURVES, Compared

REPORT = "report.html"


def finished(folders: Sequence[Path], names: Sequence[str], beside: Path) -> list[Compared]:
    """The finished runs among these folders, with the given `names`, for a page in the folder `beside`. Those with the
    lowest errors are read completely, for curves over time; unreadable ones are left out."""
    found = [x for x in map(_measured, folders, names, [beside] * len(names)) if x is not None]
    ranked = sorted(found, key=lambda x: x.score("rmse") if x.score("rmse") >= 0 else float("inf"))
    whole = {x.name for x in ranked[:MOST_CURVES]}
    places = dict(zip(names, folders, strict=True))
    return [_with_record(x, places[x.name] / store.RUN) if x.name in whole else x for x in found]


def _measured(folder: Path, name: str, beside: Path) -> Compared | None:
    try:
        metrics: Any = untrusted.read_json(folder / store.METRICS, RunFileError)
        one = Compared(name, metrics, None, page_of(folder, beside))
        joints = untrusted.names(metrics["joints"], "joints")
        _ = [one.joint(kind, joint) for kind in ("nmse", "rmse") for joint in joints]  # another shape raises here
        return one
    except (InvdynError, LookupError, TypeError, AttributeError):
        return None


def _with_record(one: Compared, path: Path) -> Compared:
    try:
        return Compared(one.name, one.metrics, store.load_run(path), one.link)
    except InvdynError:  # its numbers are there, its curves are not
        return one


def page_of(run: Path, folder: Path) -> str:
    """The link to a run's own page, relative to a folder."""
    page = run / REPORT
    return Path(os.path.relpath(page, folder)).as_posix() if page.is_file() else ""
