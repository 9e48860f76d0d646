"""Models and adaptations <-> plain values: {"class": a name, "fields": {...}}, members likewise.

This table and the reader decide which classes a file may name, never the file: a name that is not in the table belongs
to a module, and that module is imported only if the reader trusts it by name. The whole tree is checked (classes, names
and types of fields) before the first constructor runs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from importlib import import_module
from typing import Any, get_type_hints

from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.adaptation.error_model import ErrorModel
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.adaptation.local_error_model import LocalErrorModel
from invdyn_cli.adaptation.memory_learning_rate import MemoryLearningRate
from invdyn_cli.adaptation.online import OnlineUpdate
from invdyn_cli.adaptation.payload import Payload
from invdyn_cli.adaptation.rls import Rls
from invdyn_cli.errors import RunFileError, UsageError, closest, listed, shortened
from invdyn_cli.fields import in_words, made, suits
from invdyn_cli.hybrid import Hybrid
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.models.dbm import Dbm
from invdyn_cli.models.extended import Extended
from invdyn_cli.models.ffnn import Ffnn, JointNet
from invdyn_cli.models.gip import Gip
from invdyn_cli.models.gpr import Gpr
from invdyn_cli.models.gru import Gru
from invdyn_cli.models.lagrangian_net import LagrangianNet
from invdyn_cli.models.lip import Lip
from invdyn_cli.models.local_gp import LocalGp
from invdyn_cli.models.lwpr import Lwpr
from invdyn_cli.models.pest import Pest
from invdyn_cli.models.rff import Rff
from invdyn_cli.models.standard import Standard
from invdyn_cli.models.svr import Svr

CLASSES: Mapping[str, type] = {
    "pest": Pest,
    "ffnn": Ffnn,
    "ffnn.joint": JointNet,
    "dbm": Dbm,
    "standard": Standard,
    "hybrid": Hybrid,
    "extended": Extended,
    "gpr": Gpr,
    "svr": Svr,
    "rff": Rff,
    "gip": Gip,
    "lip": Lip,
    "lwpr": Lwpr,
    "local_gp": LocalGp,
    "lagrangian_net": LagrangianNet,
    "gru": Gru,
    "batch": Batch,
    "incremental": Incremental,
    "error_model": ErrorModel,
    "payload": Payload,
    "rls": Rls,
    "online": OnlineUpdate,
    "memory_learning_rate": MemoryLearningRate,
    "local_error_model": LocalErrorModel,
}
"""Names in files. A class may move or be renamed; these names stay."""

MODELS: Mapping[str, type[AbstractModel]] = {k: v for k, v in CLASSES.items() if issubclass(v, AbstractModel)}
"""The models among them."""

_NAMES: Mapping[type, str] = {kind: name for name, kind in CLASSES.items()}
_PATHS: Mapping[str, type] = {
    "invdyn_cli.models.pest:Pest": Pest,
    "invdyn_cli.models.ffnn:Ffnn": Ffnn,
    "invdyn_cli.models.ffnn:JointNet": JointNet,
    "invdyn_cli.models.dbm:Dbm": Dbm,
    "invdyn_cli.hybrid:Hybrid": Hybrid,
    "invdyn_cli.models.extended:Extended": Extended,
    "invdyn_cli.adaptation.batch:Batch": Batch,
    "invdyn_cli.adaptation.incremental:Incremental": Incremental,
    "invdyn_cli.adaptation.error_model:ErrorModel": ErrorModel,
    "invdyn_cli.adaptation.payload:Payload": Payload,
}
"""What files of version 0.1 called them."""


@dataclass(frozen=True)
class _Planned:
    """Stands for an object that is not built yet."""

    kind: type
    fields: Mapping[str, Any]


def make_model(name: str | AbstractModel, **hyperparameters: Any) -> AbstractModel:
    """The model of a name with these hyperparameters (`invdyn models NAME`), or a model object with some changed.

    Raises:
        UsageError: for a name, a hyperparameter or a value that is not allowed.
    """
    if isinstance(name, AbstractModel):
        options = {f.name: getattr(name, f.name) for f in fields(name) if f.init}  # pyright: ignore[reportArgumentType]
        return made(type(name), options | hyperparameters, type(name).__name__) if hyperparameters else name
    if not isinstance(name, str) or name not in MODELS:
        got = f"model={name!r}" if isinstance(name, str) else f"the model is a {type(name).__name__}"
        near = closest(name, MODELS) if isinstance(name, str) else ""
        raise UsageError(f"{got}{near}; allowed: {listed(MODELS)}, or an AbstractModel")
    return made(MODELS[name], hyperparameters, f"the model {name}")


def encode(value: Any) -> Any:
    """A frozen dataclass as {"class": name, "fields": {...}}, its fields likewise; plain values stay.

    A class that is not in CLASSES is called "module:Name".
    """
    if is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        name = _NAMES.get(kind, f"{kind.__module__}:{kind.__qualname__}")
        return {"class": name, "fields": {f.name: encode(getattr(value, f.name)) for f in fields(value) if f.init}}
    if isinstance(value, Mapping):
        return {str(k): encode(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [encode(v) for v in value]
    return value


def decode(value: Any, kind: type, trust: Sequence[str] = ()) -> Any:
    """The object of this kind that `encode` stored.

    Args:
        value: plain values from any file.
        kind: what it has to be.
        trust: modules of the reader's whose dataclasses may be named; each is imported when its first class is.

    Raises:
        RunFileError: for a class that is neither in CLASSES nor of a trusted module, for fields that it does not have
            or whose values do not suit, and for another kind.
    """
    plan = _plan(value, trust)
    if not _is_a(plan, kind):
        got = plan.kind.__name__ if isinstance(plan, _Planned) else type(plan).__name__
        raise RunFileError(f"a {got} stands where a {kind.__name__} belongs")
    return _build(plan)


def _plan(value: Any, trust: Sequence[str]) -> Any:
    if isinstance(value, list):
        return tuple(_plan(v, trust) for v in value)
    if not isinstance(value, Mapping):
        return value
    if set(value) != {"class", "fields"}:
        return {k: _plan(v, trust) for k, v in value.items()}
    kind = _class_of(value["class"], trust)
    if not isinstance(value["fields"], Mapping):
        raise RunFileError(f"{shortened(value['class'])} has no fields")
    own = {f.name: f for f in fields(kind) if f.init}
    hints = get_type_hints(kind)
    planned = {name: _plan(v, trust) for name, v in value["fields"].items()}
    for name, given in planned.items():
        if name not in own:
            raise RunFileError(f"{kind.__name__} has no option {shortened(name)!r}; allowed: {listed(own)}")
        if not suits(given, hints[name], _is_a):
            got = given.kind.__name__ if isinstance(given, _Planned) else shortened(given)
            raise RunFileError(f"{kind.__name__}: {name}={got}; allowed: {in_words(hints[name])}")
    for name, one in own.items():
        if name not in planned and one.default is MISSING and one.default_factory is MISSING:
            raise RunFileError(f"{kind.__name__} lacks {name}")
    return _Planned(kind, planned)


def _class_of(name: Any, trust: Sequence[str]) -> type:
    known = CLASSES.get(name) or _PATHS.get(name) if isinstance(name, str) else None
    if known is not None:
        return known
    module, _, own = str(name).partition(":")
    if module not in trust:
        got = f"the class {shortened(name)!r} is not one of invdyn's own"
        raise RunFileError(
            f"{got}; allowed: {listed(CLASSES)}, and those of modules that you trust",
            advice=f"trust=[{shortened(module)}], if you know that module, because its code will be run",
        )
    try:
        kind = vars(import_module(module)).get(own)
    except ImportError as error:
        got = f"the trusted module {module} cannot be imported ({error})"
        advice = "run invdyn in the folder of its file, or put that folder on PYTHONPATH"
        raise RunFileError(got, advice=advice) from None
    if not (isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == module):
        raise RunFileError(f"the trusted module {module} has no dataclass {shortened(own)!r} of its own")
    return kind


def _is_a(value: Any, kind: type) -> bool:
    return isinstance(value, _Planned) and issubclass(value.kind, kind)


def _build(plan: Any) -> Any:
    if isinstance(plan, _Planned):
        return plan.kind(**{name: _build(v) for name, v in plan.fields.items()})
    if isinstance(plan, tuple):
        return tuple(_build(v) for v in plan)
    if isinstance(plan, Mapping):
        return {k: _build(v) for k, v in plan.items()}
    return plan
