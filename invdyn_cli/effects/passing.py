"""Effects that act in a time window, which is estimated with them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn_cli.effects.actuator import AbstractGainEffect
from invdyn_cli.effects.load import AbstractLoadEffect
from invdyn_cli.effects.rigid import force_columns
from invdyn_cli.interfaces import AbstractForceEffect, Parameter, Parameters
from invdyn_cli.types import Array, Motion, Robot


@dataclass(frozen=True)
class PayloadChange(AbstractLoadEffect):
    """A body that is picked up and released."""

    name = "payload_change"
    title = "payload change"
    meaning = "A body that the arm picked up or released."
    equation = "a body of this mass at com in the frame of the last moving joint, for a time"
    reference = "Gaz and De Luca, IROS 2017"
    parameters = {**AbstractLoadEffect.parameters, "mass": Parameter("kg", 0.0)}
    sized_by = "mass"
    passing = True
    confounders = (("payload",), ("external_contact",), ("torque_gain_change",))
    advice = "several postures with the load held and turned by the wrist: weight and centre of mass move as one body"
    shows = ("time",)


@dataclass(frozen=True)
class TorqueGainChange(AbstractGainEffect):
    """A drive that gives more or less torque than before: weakened, derated, at another temperature."""

    name = "torque_gain_change"
    title = "torque gain change"
    meaning = "An actuator that becomes weaker or stronger during the recording."
    equation = "delivered = gain · logged, for a time"
    reference = "Gautier and Briot, ASME JDSMC 2014"
    passing = True
    confounders = (("torque_gain_error",), ("payload_change",), ("external_contact",))
    advice = "the same trajectory before and after the change"
    panels = ("nominal_torque",)
    shows = ("time",)


@dataclass(frozen=True)
class ExternalContact(AbstractForceEffect):
    """A force on the arm from outside, constant in the base frame, at a point of the link that a joint moves. Without a
    point it is at the joint frame's origin. If the axes of several joints meet there, the force is the same for all
    their frames: the outermost joint is named."""

    name = "external_contact"
    title = "external contact"
    meaning = "A force on the arm from something that it touched."
    equation = "−Jᵀ force, J of point in the joint's frame (without one: its origin), for a time"
    reference = "Haddadin, De Luca and Albu-Schäffer, IEEE T-RO 2017"
    parameters = {"force": Parameter("N"), "point": Parameter("m", -2.0, 2.0)}
    defaults = {"point": (0.0, 0.0, 0.0)}
    placed_by = "point"
    scale = 300.0
    passing = True
    confounders = (("external_contact",), ("payload_change",), ("torque_gain_change",))
    advice = "a force sensor or a camera at the contact; or motion of the arm while the contact is held"
    panels = ("joints",)
    shows = ("time",)

    def basis(self, robot: Robot, joint: int | None, motion: Motion) -> Array:
        return self.placed({}, robot, joint, motion)

    def placed(self, trial: Parameters, robot: Robot, joint: int | None, motion: Motion) -> Array:
        assert joint is not None
        return force_columns(robot, joint, np.asarray(self.whole(trial)["point"], float), motion)

    def read(self, coefficients: Sequence[float]) -> dict[str, Any]:
        return {"force": np.asarray(coefficients, float)}

    def coefficients(self, parameters: Parameters) -> list[float]:
        return [float(x) for x in parameters["force"]]
