"""invdyn: learn, adapt, compare and diagnose inverse dynamics models tau = f(q, qd, qdd); docs/python.md shows the use.

Importing the package loads nothing heavy: each name is loaded when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from invdyn_cli.diagnosis import Options as Options
    from invdyn_cli.errors import InvdynError as InvdynError
    from invdyn_cli.estimator import InverseDynamicsRegressor as InverseDynamicsRegressor
    from invdyn_cli.functions.arrays import from_arrays as from_arrays
    from invdyn_cli.functions.checking import check as check
    from invdyn_cli.functions.diagnosing import diagnose as diagnose
    from invdyn_cli.functions.fitting import fit as fit
    from invdyn_cli.functions.fitting import simulate as simulate
    from invdyn_cli.functions.inputs import read as read
    from invdyn_cli.logfile import write_log as write_log
    from invdyn_cli.registry import make_model as make_model
    from invdyn_cli.robots import load_urdf as load_urdf
    from invdyn_cli.store import load_model as load_model
    from invdyn_cli.store import load_run as load_run

_OFFERED = {
    "InvdynError": "errors",
    "InverseDynamicsRegressor": "estimator",
    "Options": "diagnosis",
    "check": "functions.checking",
    "diagnose": "functions.diagnosing",
    "fit": "functions.fitting",
    "from_arrays": "functions.arrays",
    "load_model": "store",
    "load_run": "store",
    "load_urdf": "robots",
    "make_model": "registry",
    "read": "functions.inputs",
    "simulate": "functions.fitting",
    "write_log": "logfile",
}
"""Name -> module; a test compares it with the imports above, which editors and pyright read."""

__all__ = [
    "InvdynError",
    "InverseDynamicsRegressor",
    "Options",
    "check",
    "diagnose",
    "fit",
    "from_arrays",
    "load_model",
    "load_run",
    "load_urdf",
    "make_model",
    "read",
    "simulate",
    "write_log",
]


def __getattr__(name: str) -> Any:
    if name in _OFFERED:
        return getattr(import_module(f"invdyn_cli.{_OFFERED[name]}"), name)
    raise AttributeError(f"module 'invdyn_cli' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
