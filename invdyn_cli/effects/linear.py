"""Torques that are linear in all of their parameters."""

from collections.abc import Sequence
from functools import reduce
from operator import add

from invdyn_cli.interfaces import AbstractTorqueEffect, JointState, Parameters
from invdyn_cli.types import Array


class AbstractLinearEffect(AbstractTorqueEffect):
    """Its columns are what its parameters are multiplied with, in their order."""

    def term(self, parameters: Parameters, state: JointState) -> Array:
        columns = zip(self.parameters, self.basis(state, parameters), strict=True)
        return reduce(add, (parameters[name] * column for name, column in columns))

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        return dict(zip(self.parameters, coefficients, strict=True))
