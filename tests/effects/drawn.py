"""Parameters of every effect, drawn at random within physics, and motions to put them on."""

from typing import Any

import numpy as np

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractEffect, JointState


def named(kind: type[AbstractEffect]) -> list[str]:
    """Names of all effects of this kind."""
    return [name for name, effect in EFFECTS.items() if isinstance(effect, kind)]


def parameters(name: str, d: np.random.Generator) -> dict[str, Any]:
    """Parameters of an effect; a KeyError says that a new one is missing here."""
    u = d.uniform
    return {
        "viscous_friction": lambda: {"damping": u(0.1, 3)},
        "coulomb_friction": lambda: {"coulomb": u(0.1, 3)},
        "asymmetric_coulomb_friction": lambda: {"positive": u(1, 2), "negative": u(0.1, 1)},
        "stribeck_friction": lambda: {
            "coulomb": u(0.5, 1),
            "static": u(1.2, 2),
            "velocity": u(0.02, 0.3),
            "exponent": u(1, 2),
        },
        "load_dependent_friction": lambda: {"mu": u(0.02, 0.2)},
        "quadratic_friction": lambda: {"drag": u(0.1, 3)},
        "presliding_hysteresis": lambda: {"coulomb": (c := u(0.1, 3)), "stiffness": c / u(0.001, 0.02)},
        "coupled_friction": lambda: {
            "coulomb": u(0.1, 3),
            "damping": u(0.1, 3),
            "armature": u(0.01, 1),
            "ratio": float(d.choice([-1.0, 1.0])),
        },
        "torque_offset_drift": lambda: {"rate": u(-0.3, 0.3)},
        "backlash": lambda: {"gap": u(0.001, 0.01), "link_coulomb": u(0.0, 0.3), "link_damping": u(0.0, 0.3)},
        "joint_elasticity": lambda: {
            "stiffness": u(50, 5000),
            "damping_ratio": u(0.02, 0.4),
            "link_coulomb": u(0.0, 0.3),
            "link_damping": u(0.0, 0.3),
        },
        "thermal_friction_drift": lambda: {"cold": u(2, 3), "warm": u(0.5, 1.5), "time_constant": u(2, 20)},
        "torque_ripple": lambda: {"amplitude": u(0.1, 2), "cycles": u(3, 40), "phase": u(-3, 3)},
        "joint_spring": lambda: {"stiffness": u(0.5, 20), "rest": u(-1, 1)},
        "rotor_inertia": lambda: {"armature": u(0.01, 1)},
        "torque_gain_error": lambda: {"gain": u(0.6, 1.5)},
        "torque_gain_change": lambda: {"gain": u(0.6, 0.9)},
        "torque_offset": lambda: {"offset": u(-3, 3)},
        "torque_delay": lambda: {"delay": u(0.003, 0.05) * d.choice([-1, 1])},
        "actuator_lag": lambda: {"time_constant": u(0.003, 0.05) * d.choice([-1, 1])},
        "torque_saturation": lambda: {"limit": u(0.5, 2)},
        "payload": lambda: {"mass": u(0.2, 3), "com": u(-0.1, 0.1, 3), "inertia": u(-0.01, 0.01, 6)},
        "payload_change": lambda: {"mass": u(0.2, 3), "com": u(-0.1, 0.1, 3), "inertia": u(-0.01, 0.01, 6)},
        "external_contact": lambda: {"force": u(-20, 20, 3), "point": u(-0.2, 0.2, 3)},
        "link_inertia_error": lambda: {
            "mass": u(-0.5, 2),
            "moment": u(-0.2, 0.2, 3),
            "inertia": u(-0.1, 0.1, 6),
        },
        "base_tilt": lambda: {"angle": u(0.05, 0.5), "azimuth": u(-3, 3)},
        "encoder_offset": lambda: {"offset": u(-0.3, 0.3)},
    }[name]()


def joint_of(name: str, joint: int) -> int | None:
    """Where an effect acts that may stand on a joint: None for those that belong to the whole arm."""
    return None if name in ("payload", "payload_change", "base_tilt") else joint


def joint_state(d: np.random.Generator, samples: int = 300) -> JointState:
    """A joint at random, 30 s, and the joint before it; a tenth of its signs lie between -1 and 1, as at a reversal."""
    sign = np.where(d.random(samples) < 0.1, d.uniform(-1, 1, samples), np.sign(d.normal(size=samples)))
    q, qd, qdd, load = d.normal(size=(4, samples))
    before = JointState(np.linspace(0, 30, samples), *d.normal(size=(3, samples)), sign, load)
    return JointState(np.linspace(0, 30, samples), q, qd, qdd, sign, 5 * load, driver=before)
