"""model=extended: the result of a diagnosis as a model: tau of the extended_model.json; nothing is learned.

The text of the file is a field of the model, so that a run.h5 stays whole when the file is gone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli import untrusted
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.description import ExtendedModel, from_dict
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.interfaces import AbstractEffect, AbstractModel, Progress, silent
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

HINT = "the extended_model.json in the folder that `invdyn diagnose` prints in its last line"


@dataclass(frozen=True)
class Extended(AbstractModel):
    """A robot with the effects that were found. It brings its own robot; `read` makes it from a file.

    Parameters are the effects': {"0_coulomb_friction": {"coulomb": (), …}, …}, so that an adaptation can go on from
    them.

    Attributes:
        text: what the extended_model.json holds.
        path: where it was read from, for the record.
        effects: of the user's own beside the catalogue, where the file names some.
    """

    text: str
    path: str = ""
    effects: tuple[AbstractEffect, ...] = ()

    needs_robot = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", tuple(self.effects))
        for one in self.effects:
            if not isinstance(one, AbstractEffect):
                raise UsageError(f"model.effects has {one!r}; allowed: {{_target_: module.Class}} of an effect")
        _parsed(self.text, self.path or "the model", self.effects)

    @property
    def model(self) -> ExtendedModel:
        """The robot with its effects, as the file has them."""
        return _parsed(self.text, self.path or "the model", self.effects)

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """The parameters of the file: nothing is learned."""
        return {
            _name(i, one): {k: np.asarray(v, float) for k, v in one.parameters.items() if _is_number(v)}
            for i, one in enumerate(self.model.acting)
        }

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample; delays and lags, which need a history, are left out."""
        return self._with(params, jnp.asarray).apply(jax.tree.map(jnp.asarray, motion))

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """The parameters of the file.

        Raises:
            UsageError: if the data are of other joints than the model.
        """
        joints = self.model.robot.joints
        if dataset.joints != joints:
            got = f"{self.path or 'the model'} has joints {listed(joints)}, the data have {listed(dataset.joints)}"
            raise UsageError(
                f"{got}; allowed: the same joints in the same order",
                advice="robot.path=…, the URDF that diagnose was given",
            )
        params = self.init(dataset, key)
        count = sum(np.size(x) for x in jax.tree.leaves(params))
        return Fit(params=params, robot=self.model.robot, joints=joints, parameters=int(count))

    def linear(self, params: PyTree) -> PyTree:
        """The effects'; in some of them (a Stribeck speed) the torque is not linear."""
        return params

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n) of one recording, delays and lags included; the clock is the one that makes qd the derivative
        of q, and starts with the motion."""
        return self._with(fit.params, _plain).predict(motion.q, motion.qd, motion.qdd)

    def _with(self, params: PyTree, as_array: Any) -> ExtendedModel:
        """The model with these parameters in the place of the file's."""
        acting = [
            replace(one, parameters={**one.parameters, **{k: as_array(v) for k, v in params[_name(i, one)].items()}})
            for i, one in enumerate(self.model.acting)
        ]
        return replace(self.model, acting=tuple(acting))


def read(path: str, effects: Sequence[AbstractEffect] = ()) -> Extended:
    """The model of an extended_model.json, with the user's own effects that it names.

    Args:
        path: the extended_model.json that `invdyn diagnose` wrote.
        effects: your own effects that the file names, each {_target_: module.Class}, as in diagnosis.effects.

    Raises:
        UsageError: if there is no such file, or it holds no such model.
    """
    where = Path(str(path)).expanduser()
    return Extended(untrusted.read_text(where, UsageError, HINT), str(where), tuple(effects))


@lru_cache(maxsize=16)
def _parsed(text: str, where: str, effects: tuple[AbstractEffect, ...]) -> ExtendedModel:
    known = {**EFFECTS, **{one.name: one for one in effects}}
    return from_dict(untrusted.parsed(text, where, UsageError, HINT), where, known)


def _name(index: int, one: EffectInstance) -> str:
    return f"{index}_{one.effect.name}"


def _is_number(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "fi"


def _plain(value: Any) -> Any:
    """A parameter as the file gives it: a float, or an array of numpy."""
    array = np.asarray(value, float)
    return array if array.ndim else float(array)
