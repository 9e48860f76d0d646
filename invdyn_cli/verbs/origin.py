"""Where a run comes from: versions, commit, machine, and a fingerprint of the code that learned it."""

import datetime
import functools
import hashlib
import importlib.metadata
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax

PACKAGES = ("invdyn", "jax", "jaxlib", "flax", "optax", "numpy", "scipy", "pin", "hydra-core", "h5py")
PACKAGE = Path(__file__).parents[1]
SHOWING = ("cli.py", "verbs", "report", "diagnosis", "testing.py", "store.py")
"""Parts of the package on which no result of a run depends."""


def origin(started: datetime.datetime) -> dict[str, Any]:
    """The provenance of a run that was started then."""
    return {
        "started": started.isoformat(timespec="seconds"),
        "versions": {name: _version(name) for name in PACKAGES} | {"python": platform.python_version()},
        "git": _git_state(),
        "code": fingerprint(),
        "device": str(jax.devices()[0].device_kind),
        "platform": platform.platform(),
    }


@functools.cache
def fingerprint() -> str:
    """A hash of the parts of the package on which the results of a run depend: as long as it is the same, a complete
    run stays valid."""
    return hash_of(x for x in PACKAGE.rglob("*.py") if x.relative_to(PACKAGE).parts[0] not in SHOWING)


def hash_of(files: Iterable[Path]) -> str:
    """A hash of the names and contents of files."""
    found = hashlib.sha256()
    for path in sorted(files):
        found.update(f"{path.name}\0".encode() + path.read_bytes())
    return found.hexdigest()[:16]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _git_state() -> str:
    """Commit of the checkout that this code runs from, "+" where it was changed since; "" outside of one."""
    commands = ["rev-parse", "--short=12", "HEAD"], ["status", "--porcelain", "--", "."]
    try:
        commit, changed = (
            subprocess.run(["git", "-C", str(PACKAGE), *c], capture_output=True, text=True, check=True).stdout.strip()
            for c in commands
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return commit + "+" * bool(changed)
