"""data=plant: recordings of a simulated arm that replaces the real one, with hidden effects; they are treated as a real
log.

The arm is simulated by MuJoCo (`invdyn_cli.simulation`); its log is then treated like a measured one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Any, Literal

from invdyn_cli.errors import UsageError, listed
from invdyn_cli.fields import counts
from invdyn_cli.interfaces import AbstractHiddenEffect, AbstractSource, Progress, silent
from invdyn_cli.log import POSITION_SIDES, Log, Recorded
from invdyn_cli.recording.conditioning import Conditioning
from invdyn_cli.recording.selection import SETS, windows
from invdyn_cli.simulation.control import Control
from invdyn_cli.simulation.hidden import Hidden, refuse
from invdyn_cli.simulation.plant import MOST_SAMPLES, SOURCE, record, refuse_clock, refuse_events, refuse_link_encoder
from invdyn_cli.simulation.references import AbstractReference, ConstantSpeed, Multisine, PickPlace
from invdyn_cli.simulation.sensors import SIDES, Noise
from invdyn_cli.types import Robot, Splits

REFERENCES = {"multisine": Multisine, "pick_place": PickPlace, "constant_speed": ConstantSpeed}


@dataclass(frozen=True)
class Plant(AbstractSource):
    """Recordings trajectory_1, trajectory_2, … of one simulated arm.

    Attributes:
        effects: hidden effects, a list of {effect: name, joint: name, parameter: value, …} (docs/plant.md); one in a
            time window also has window: [from, to] in seconds, and may have a trajectory. One of your own:
            {_target_: module.Class, joint: name, …} (docs/own_effects.md).
        reference: reference motion: multisine, pick_place or constant_speed, or such an object with options of its own.
        trajectories: number of recordings, each with its own random motion.
        duration: [s] length of each recording.
        rate: [Hz] rate of the controller and of the log.
        substeps: physics steps per sample.
        position_noise: [rad; m] RMS of white noise on the positions, which the controller sees too; one number, or one
            for each joint.
        velocity_noise: [rad/s; m/s] RMS of white noise of a velocity sensor; None: velocities are not logged.
        torque_noise: [N m; N] RMS of white noise on the logged torque.
        position_quantum: [rad; m] resolution of the encoders; 0: none.
        torque_quantum: [N m; N] resolution of the logged torque; 0: none.
        torque_side: where the torque is measured: command or motor (the same here), or link (behind friction and gear).
        position_side: where the position is measured: motor or unknown (the same here), or link (behind an elastic
            gear).
        link_encoder: whether the links' angles are logged too, as q_link (for position_side=motor).
        control_frequency: [Hz] bandwidth of the feedback; None: 4, or less with delayed torques.
        controller_knows: model of the feedforward: arm (with the hidden effects) or nominal (tracking is then worse).
        seed: random seed of motions and noise; the trajectories count on from it.
        train, validation, test, train_share, validation_share, derivatives, filter_cutoff, filter_order, causal,
            torque_lag, decimate: as in data=real_log.
    """

    effects: Sequence[Mapping[str, Any] | AbstractHiddenEffect] = ()
    reference: str | AbstractReference = "multisine"
    trajectories: int = 3
    duration: float = 30.0
    rate: float = 1000.0
    substeps: int = 4
    position_noise: float | Sequence[float] = 0.0
    velocity_noise: float | Sequence[float] | None = None
    torque_noise: float | Sequence[float] = 0.0
    position_quantum: float | Sequence[float] = 0.0
    torque_quantum: float | Sequence[float] = 0.0
    torque_side: Literal["command", "motor", "link"] = "command"
    position_side: Literal["motor", "link", "unknown"] = "unknown"
    link_encoder: bool = False
    control_frequency: float | None = None
    controller_knows: Literal["arm", "nominal"] = "arm"
    seed: int = 0
    train: Sequence[str] | None = None
    validation: Sequence[str] | None = None
    test: Sequence[str] | None = None
    train_share: float = 0.7
    validation_share: float = 0.1
    derivatives: str = "auto"
    filter_cutoff: float | None = 10.0
    filter_order: int = 4
    causal: bool = False
    torque_lag: int = 0
    decimate: int = 10

    has_log = True

    def __post_init__(self) -> None:
        for name in ("effects", *SETS):
            value = getattr(self, name)
            if value is not None:
                alone = isinstance(value, str | Mapping | AbstractHiddenEffect)
                object.__setattr__(self, name, (value,) if alone else tuple(value))
        for name in ("position_noise", "velocity_noise", "torque_noise", "position_quantum", "torque_quantum"):
            value = getattr(self, name)
            if isinstance(value, Sequence):
                object.__setattr__(self, name, tuple(value))
        for one in self.hidden():
            refuse(one)
        if isinstance(self.reference, str) and self.reference not in REFERENCES:
            raise UsageError(f"data.reference={self.reference}; allowed: {listed(REFERENCES)}")
        if not isinstance(self.reference, str | AbstractReference):
            got = f"data.reference is a {type(self.reference).__name__}"
            raise UsageError(f"{got}; allowed: {listed(REFERENCES)}, or a _target_ in invdyn_cli.simulation.references")
        counts(self, "data", "trajectories")
        if not (isinstance(self.seed, int) and self.seed >= 0):
            raise UsageError(f"data.seed={self.seed}; allowed: a whole number >= 0")
        for name, allowed in (("torque_side", SIDES), ("position_side", POSITION_SIDES)):
            if getattr(self, name) not in allowed:
                raise UsageError(f"data.{name}={getattr(self, name)}; allowed: {listed(allowed)}")
        refuse_clock(self.duration, self.rate, self.substeps)
        if self.trajectories * self.duration * self.rate > MOST_SAMPLES:
            got = f"data.trajectories={self.trajectories} of {self.duration:g} s at {self.rate:g} Hz"
            raise UsageError(f"{got}; allowed: {MOST_SAMPLES:.0e} samples in all")
        refuse_link_encoder(self.link_encoder, self.position_side)
        refuse_events(self.hidden(), self.duration, [f"trajectory_{i + 1}" for i in range(self.trajectories)])
        self._control()
        self._conditioning().refuse_options()

    def hidden(self) -> tuple[Hidden, ...]:
        """The effects as the simulation takes them; UsageError for one that is neither a mapping nor one's own."""
        return tuple(_hidden(one) for one in self.effects)

    def told(self) -> list[dict[str, Any]]:
        """What is hidden, as plain data: {"effect", "joint", "parameters"}."""
        return [
            asdict(_hidden(one))
            if isinstance(one, Mapping)
            else {"effect": one.name, "joint": one.joint, "parameters": _sizes(one)}
            for one in self.effects
        ]

    def recorded(self, robot: Robot | None, progress: Progress = silent) -> Recorded:
        """The log, simulated anew; UsageError as `record`."""
        assert robot is not None
        log = self.record(robot, progress)
        blocks = self._conditioning().asked([x.name for x in log.trajectories])
        notes = dict.fromkeys(x.notes for x in log.trajectories if x.notes)
        return Recorded(log, windows=windows(blocks, log, self.train_share), notes=tuple(notes))

    def record(self, robot: Robot, progress: Progress = silent) -> Log:
        """The log of all trajectories, as it would have been recorded.

        Raises:
            UsageError: for effects that this robot cannot have, or an arm that goes out of control.
        """
        reference = REFERENCES[self.reference]() if isinstance(self.reference, str) else self.reference
        return record(
            robot,
            [reference] * self.trajectories,
            self.hidden(),
            rate=self.rate,
            torque_side=self.torque_side,
            position_side=self.position_side,
            link_encoder=self.link_encoder,
            seed=self.seed,
            noise=Noise(
                position=self.position_noise,
                velocity=self.velocity_noise,
                torque=self.torque_noise,
                position_quantum=self.position_quantum,
                torque_quantum=self.torque_quantum,
            ),
            duration=self.duration,
            substeps=self.substeps,
            control=self._control(),
            progress=progress,
        )

    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """Simulate, then split and condition as a real log."""
        assert robot is not None
        log = self.record(robot, lambda done, note: progress(0.95 * done, note))
        notes = list(dict.fromkeys(raw.notes for raw in log.trajectories if raw.notes))
        reference = self.reference if isinstance(self.reference, str) else type(self.reference).__name__
        what = {"source": SOURCE, "effects": self.told(), "reference": reference}
        return self._conditioning().splits_of_log(
            log,
            robot,
            notes=notes,
            description=what | {"torque_side": self.torque_side, "position_side": self.position_side},
            progress=lambda done, note: progress(0.95 + 0.05 * done, note),
        )

    def _control(self) -> Control:
        return Control(frequency=self.control_frequency, knows=self.controller_knows)

    def _conditioning(self) -> Conditioning:
        return Conditioning.of(self, rate=None, max_gap=1.5 / self.rate)


def _hidden(one: Any) -> Hidden:
    if isinstance(one, AbstractHiddenEffect):
        return Hidden("custom", one.joint, {"force": one.force})
    if not isinstance(one, Mapping) or not isinstance(one.get("effect"), str):
        raise UsageError(
            f"data.effects has {one!r}; allowed: {{effect: name, joint: name, parameter: value, …}}, or an "
            "AbstractHiddenEffect of your own",
            advice="'data.effects=[{effect: coulomb_friction, joint: arm_joint_2, coulomb: 2.0}]'",
        )
    return Hidden(one["effect"], one.get("joint"), {k: v for k, v in one.items() if k not in ("effect", "joint")})


def _sizes(one: AbstractHiddenEffect) -> dict[str, Any]:
    """The fields of a hidden effect of the user's own, but its joint."""
    known = fields(one) if is_dataclass(one) else ()
    return {x.name: getattr(one, x.name) for x in known if x.name != "joint"}
