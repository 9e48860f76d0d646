"""invdyn: learn, adapt, compare and (soon) diagnose inverse dynamics models tau = f(q, qd, qdd).

Importing the package costs nothing: what is offered here is loaded when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from invdyn_cli.store import load_model as load_model
    from invdyn_cli.store import load_run as load_run

__all__ = ["load_model", "load_run"]

_OFFERED = {"load_model": "invdyn_cli.store", "load_run": "invdyn_cli.store"}


def __getattr__(name: str) -> Any:
    if name in _OFFERED:
        return getattr(import_module(_OFFERED[name]), name)
    raise AttributeError(f"module 'invdyn_cli' has no attribute {name!r}")
