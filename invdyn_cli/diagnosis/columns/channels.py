"""Columns of effects between the logged torque of a joint and what the joint receives."""

from collections.abc import Sequence

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.diagnosis.columns.gears import load_on
from invdyn_cli.diagnosis.columns.kind import AbstractKind, Beside
from invdyn_cli.interfaces import AbstractChannelEffect, Parameters

STEP = 1e-3
"""Relative step of finite differences in a channel's parameters."""

FAR_LESS = 0.5
"""Share of the smallest limit that is tried anyway; below it, a limit that the drive reaches most of the time is tried
as well."""


class Channels(AbstractKind[AbstractChannelEffect]):
    """Delays, lags, limits: what a trial changes of the logged torque (fixed), and the change with each parameter
    (free). A gain acts on the model's torque, which has no noise."""

    def gathered(self, evidence: Evidence, effects: Sequence[AbstractChannelEffect]) -> list[Candidate]:
        places = [(effect, joint) for effect in effects for joint in range(evidence.dofs)]
        return [self.candidate(evidence, *at, shape) for at in places for shape in _shapes(evidence, *at)]

    def candidate(
        self, evidence: Evidence, effect: AbstractChannelEffect, joint: int, trial: Parameters, beside: Beside = ()
    ) -> Candidate:
        rate, pieces = evidence.recording.filter.rate, evidence.recording.pieces
        if effect.factor:
            made = [c for c in evidence.candidates if c.key == (effect.name, joint)]
            if made:
                return made[0]
            parts = [s[joint].transmitted[None] for s in evidence.states]
            (column,) = evidence.append(joint, list(filtered(evidence.recording, parts, joint)))
            return Candidate(effect, joint, trial, {joint: ((), (column,))}, np.zeros(1))

        def changed(parameters: Parameters) -> np.ndarray:
            parts = [p.tau[joint] - effect.delivered(parameters, p.tau[joint], rate) for p in pieces]
            return filtered(evidence.recording, parts, joint)

        fixed = changed(trial)
        # its correction may take it farther than the trial
        farther = {k: 1.5 * v + 0.006 if k != "limit" else v for k, v in trial.items()}
        quieter = _noise_reduction(evidence, effect, joint, farther)
        free = []
        for name, value in trial.items():
            step = max(STEP * abs(value), 2e-4)
            up, down = value + step, max(value - step, effect.parameters[name].lower)
            free.append((changed({**trial, name: up}) - changed({**trial, name: down})) / (up - down))
        numbers = evidence.append(joint, [fixed, *free])
        # the correction reaches about as far as the next trial; beyond, the straight line is no longer true
        reach = [0.3 * abs(v) + 0.004 if effect.parameters[name].unit == "s" else 0.15 * v for name, v in trial.items()]
        columns = {joint: (numbers[:1], numbers[1:])}
        return Candidate(effect, joint, trial, columns, 1 / np.square(reach), quieter)

    def basis(
        self, evidence: Evidence, effect: AbstractChannelEffect, joint: int, piece: int, place: Parameters
    ) -> np.ndarray:
        if not effect.factor:
            return super().basis(evidence, effect, joint, piece, place)
        row = (np.arange(evidence.dofs) == joint)[:, None] * evidence.states[piece][joint].transmitted
        return row[None]


def _shapes(evidence: Evidence, effect: AbstractChannelEffect, joint: int) -> list[Parameters]:
    """The trials of a channel effect; limits beyond the noise, and what the motion took where that is far less than all
    of them: a drive that is at its limit most of the time."""
    recording = evidence.recording
    logged = np.concatenate([p.tau[joint] for p in recording.pieces])
    shapes = list(effect.shapes(logged, recording.filter.rate))
    if effect.invertible:
        return shapes
    least = min((shape["limit"] for shape in shapes), default=0.0)
    taken = np.quantile(np.abs(load_on(evidence, joint)), [0.9, 0.95, 0.99])
    shapes += [{"limit": float(x)} for x in taken if x < FAR_LESS * least]
    return [shape for shape in shapes if shape["limit"] > 6 * recording.torque_noise[joint]]


def _noise_reduction(evidence: Evidence, effect: AbstractChannelEffect, joint: int, trial: Parameters) -> float:
    """Share of white noise that a channel effect removes from a joint's logged torque."""
    rate, noise = evidence.recording.filter.rate, np.random.default_rng(0)
    before, after = [], []
    for p in evidence.recording.pieces:
        e = 1e-6 * (np.std(p.tau[joint]) + 1e-12) * noise.normal(size=len(p.t))
        before.append(e)
        after.append(effect.delivered(trial, p.tau[joint] + e, rate) - effect.delivered(trial, p.tau[joint], rate))
    spread = [np.var(filtered(evidence.recording, x, joint)) for x in (after, before)]
    return float(max(0.0, 1 - spread[0] / max(spread[1], 1e-300)))
