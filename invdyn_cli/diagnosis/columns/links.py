"""The same evidence with the links' inertials from the log: gears and load-dependent friction depend on the weight of
the links."""

from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import add_loaded
from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.columns.kind import nominal
from invdyn_cli.effects.rigid import rigid_torque


def with_links(evidence: Evidence, inertial: np.ndarray) -> Evidence:
    """An evidence whose robot has other inertials (n, 10), with new columns for the effects that depend on the torque
    that a joint transmits; tables, and the logged minus the nominal torque, stay."""
    made = loaded_by(evidence, inertial)
    add_loaded(made)
    return made


def loaded_by(evidence: Evidence, inertial: np.ndarray) -> Evidence:
    """The same without these columns."""
    robot, pieces = replace(evidence.robot, inertial=inertial), evidence.recording.pieces
    torques = [rigid_torque(robot, piece.motion) for piece in pieces]
    return replace(
        evidence,
        robot=robot,
        states=[
            [s._replace(transmitted=x) for s, x in zip(states, torque, strict=True)]
            for states, torque in zip(evidence.states, torques, strict=True)
        ],
        base=[nominal(states) - torque for states, torque in zip(evidence.states, torques, strict=True)],
        kept={key: value for key, value in evidence.kept.items() if key[0] == "grams"},
        candidates=[c for c in evidence.candidates if not c.effect.loaded],
    )
