"""The library of causes: every effect by its name, and the sets of effects that can, in theory, replace one another."""

from collections.abc import Mapping

from invdyn_cli.effects import actuator, coupling, friction, gear, load, passing, presliding, transmission
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
        presliding.PreslidingHysteresis(),
        friction.ThermalFrictionDrift(),
        coupling.CoupledFriction(),
        actuator.TorqueOffsetDrift(),
        gear.Backlash(),
        gear.JointElasticity(),
        transmission.TorqueRipple(),
        transmission.JointSpring(),
        actuator.RotorInertia(),
        actuator.TorqueGainError(),
        passing.TorqueGainChange(),
        actuator.TorqueOffset(),
        actuator.TorqueDelay(),
        actuator.ActuatorLag(),
        actuator.TorqueSaturation(),
        load.Payload(),
        passing.PayloadChange(),
        passing.ExternalContact(),
        load.LinkInertiaError(),
        load.BaseTilt(),
        load.EncoderOffset(),
    )
}


def may_be_ambiguous(effect: str, other: tuple[str, ...]) -> bool:
    """Whether, in theory, a set of effects can explain the same log as an effect, or the effect the same log as the
    set."""
    if other in EFFECTS[effect].confounders:
        return True
    return len(other) == 1 and other[0] in EFFECTS and (effect,) in EFFECTS[other[0]].confounders
