"""The library of causes: every effect by its name, and the sets of them that theory allows to stand for one another."""

from collections.abc import Mapping

from invdyn_cli.effects import actuator, friction, load, transmission
from invdyn_cli.interfaces import AbstractEffect

EFFECTS: Mapping[str, AbstractEffect] = {
    effect.name: effect
    for effect in (
        friction.ViscousFriction(),
        friction.CoulombFriction(),
        friction.AsymmetricCoulombFriction(),
        friction.StribeckFriction(),
        friction.LoadDependentFriction(),
        friction.QuadraticFriction(),
        friction.ThermalFrictionDrift(),
        transmission.TorqueRipple(),
        transmission.JointSpring(),
        actuator.RotorInertia(),
        actuator.TorqueGainError(),
        actuator.TorqueOffset(),
        actuator.TorqueDelay(),
        actuator.ActuatorLag(),
        actuator.TorqueSaturation(),
        load.Payload(),
        load.LinkInertiaError(),
        load.BaseTilt(),
        load.EncoderOffset(),
    )
}


def may_be_ambiguous(effect: str, other: tuple[str, ...]) -> bool:
    """Whether theory allows a set of effects to stand for an effect on some log, or the effect for the set."""
    if other in EFFECTS[effect].confounders:
        return True
    return len(other) == 1 and other[0] in EFFECTS and (effect,) in EFFECTS[other[0]].confounders
