"""data=pick_place: the paper's real data, replaced by the simulated arm, which picks and places without and with an
object.

Repetitions without the object are training data; as many with it are test data, also for adaptation (paper, section
V-A.3, Table II). The arm has friction, springs in its gears and ripple; the object's weight appears and disappears
gradually, as in a grasp.
"""

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from invdyn_cli import simulation
from invdyn_cli.data.tasks import AbstractTaskSource, Task
from invdyn_cli.effects.friction import StribeckFriction, ViscousFriction
from invdyn_cli.effects.gear import JointElasticity
from invdyn_cli.effects.passing import PayloadChange
from invdyn_cli.effects.transmission import TorqueRipple
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.log import Log, RawTrajectory, Recorded
from invdyn_cli.logfile import read_log, write_log
from invdyn_cli.recording.conditioning import Conditioning
from invdyn_cli.recording.selection import windows
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import SOURCE, simulate
from invdyn_cli.simulation.references import STAGES, Manipulation
from invdyn_cli.simulation.sensors import SIDES, Noise, Side
from invdyn_cli.types import Robot, Splits

DURATION, RATE = 9.6, 1000.0
"""[s] of a recording, [Hz] (the paper: 9 to 10 s, 1 kHz)."""

ARM = {
    "coulomb": (12.5, 13.3, 5.0, 5.0, 2.7, 2.3, 2.3),
    "viscous": (21.0, 20.0, 10.0, 10.0, 3.6, 2.5, 3.0),
    "stiffness": (15000.0, 15000.0, 9000.0, 9000.0, 4000.0, 3000.0, 3000.0),
    "rotor": (3.0, 3.0, 2.0, 2.0, 0.8, 0.4, 0.4),
    "ripple": (0.6, 0.6, 0.3, 0.3, 0.15, 0.1, 0.1),
}
"""Per joint, base first: friction [N m; N m s/rad] as published for the joints of the UR10e (that of the elbow used
twice); springs [N m/rad], rotors [kg m^2] and ripple [N m] typical of strain wave gears of these sizes. The defaults of
`friction` and `torque_noise` make PEST and nets leave as much as in the paper (experiments/adaptation.md)."""

STATIC, STRIBECK, CYCLES = 1.3, 0.05, 20.0
"""Static over Coulomb friction; its speed [rad/s]; ripple per revolution."""


@dataclass(frozen=True)
class PickPlace(AbstractTaskSource):
    """Recordings unloaded_1, … and loaded_1, … of one arm, stages and all.

    Attributes:
        repetitions: number of repetitions of the task without the object (training), and again with it (test).
        watched: number of further repetitions without the object, for validation.
        mass: [kg] mass of the object.
        com: [m] centre of mass of the object in the last link's frame.
        ramp: [s] shortest and longest time in which the object's weight comes and goes; drawn at random in between.
        friction: [-] Coulomb, Stribeck and viscous friction of every joint, as a share of the sizes in `ARM`.
        elastic: whether the gears are elastic, with rotors before them.
        ripple: [-] torque ripple of the gears, as a share of the sizes in `ARM`.
        torque_side: where the torque is measured: command (motors, with friction) or link (sensors behind friction and
            gears).
        position_noise: [rad] RMS of white noise on the measured positions, which the controller sees too.
        torque_noise: [-] RMS of white noise on the logged torque, as a share of each joint's Coulomb friction in `ARM`.
        seed: random seed of motions, grasps and noise.
        cache: folder in which the simulated log is kept; None: it is simulated anew each time.
        filter_cutoff, filter_order, causal: as in data=real_log.
        torque_lag: [samples] the state at t is paired with the torque that many samples earlier (1: paper, V-A.3).
        decimate: as in data=real_log.
    """

    repetitions: int = 10
    watched: int = 2
    mass: float = 0.851
    com: Sequence[float] = (0.0, 0.0, 0.08)
    ramp: Sequence[float] = (0.1, 0.3)
    friction: float = 0.14
    elastic: bool = True
    ripple: float = 1.0
    torque_side: Side = "command"
    position_noise: float = 1e-5
    torque_noise: float = 0.18
    seed: int = 0
    cache: str | None = "outputs/data"
    filter_cutoff: float | None = 10.0
    filter_order: int = 4
    causal: bool = False
    torque_lag: int = 1
    decimate: int = 1

    has_log = True
    rate = RATE

    def __post_init__(self) -> None:
        for name in ("com", "ramp"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        for name, good, allowed in (
            ("repetitions", isinstance(self.repetitions, int) and self.repetitions >= 1, "a whole number from 1"),
            ("watched", isinstance(self.watched, int) and self.watched >= 0, "a whole number from 0"),
            ("torque_side", self.torque_side in SIDES, ", ".join(SIDES)),
            ("mass", self.mass > 0, "a mass above 0 kg"),
            ("com", len(self.com) == 3, "three numbers [m]"),
            ("ramp", len(self.ramp) == 2 and 0 <= self.ramp[0] <= self.ramp[1] <= 0.4, "[from, to] within 0 to 0.4 s"),
            ("friction", 0 <= self.friction < np.inf, "a share from 0"),
            ("ripple", 0 <= self.ripple < np.inf, "a share from 0"),
            ("position_noise", self.position_noise >= 0, "from 0 rad"),
            ("torque_noise", self.torque_noise >= 0, "a share from 0"),
            ("seed", isinstance(self.seed, int) and self.seed >= 0, "a whole number from 0"),
        ):
            if not good:
                raise UsageError(f"data.{name}={getattr(self, name)}; allowed: {allowed}")
        self._conditioning().refuse_options()

    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """Read or simulate the log, then split and condition it as a real one."""
        assert robot is not None
        log = self.log(robot, lambda done, note: progress(0.9 * done, note))
        what = {"source": SOURCE, "object": {"mass": self.mass, "com": self.com, "ramp": self.ramp}}
        return self._conditioning().splits_of_log(
            log,
            robot,
            notes=[],
            description=what | {name: getattr(self, name) for name in ("friction", "elastic", "ripple", "seed")},
            progress=lambda done, note: progress(0.9 + 0.1 * done, note),
        )

    def recorded(self, robot: Robot | None, progress: Progress = silent) -> Recorded:
        """The whole recording; repetitions without the object are for training, those with it for the test."""
        assert robot is not None
        log, how = self.log(robot, progress), self._conditioning()
        return Recorded(log, windows=windows(how.asked([x.name for x in log.trajectories]), log, how.train_share))

    def log(self, robot: Robot, progress: Progress = silent) -> Log:
        """The whole recording, from the cache where it is there."""
        path = None if self.cache is None else Path(self.cache) / f"pick_place-{self._named(robot)}.h5"
        if path is not None and path.is_file():
            return read_log(path)
        wanted = list(itertools.product((False, True), range(self.repetitions)))
        wanted += [(False, self.repetitions + k) for k in range(self.watched)]
        trajectories = []
        for loaded, k in wanted:
            trajectories.append(self._repetition(robot, k, loaded=loaded))
            progress(len(trajectories) / len(wanted), trajectories[-1].name)
        made = Log(
            robot=robot.name,
            joints=robot.joints,
            torque_side=self.torque_side,
            torque_unit="N m",
            rate=RATE,
            trajectories=tuple(trajectories),
            source=SOURCE,
            position_side="motor",
        )
        if path is not None:
            write_log(made, path)
        return made

    def hidden(self, robot: Robot) -> tuple[Hidden, ...]:
        """The effects that are always in the arm."""
        size = {name: np.resize(values, robot.dofs) for name, values in ARM.items()}
        out: list[Hidden] = []
        for i, joint in enumerate(robot.joints):
            coulomb, damping = self.friction * size["coulomb"][i], self.friction * size["viscous"][i]
            level = {"coulomb": float(coulomb), "static": float(STATIC * coulomb), "velocity": STRIBECK}
            gear = {"stiffness": float(size["stiffness"][i]), "rotor": float(size["rotor"][i])}
            wave = {"amplitude": float(self.ripple * size["ripple"][i]), "cycles": CYCLES, "phase": float(i)}
            out += [Hidden(StribeckFriction.name, joint, level)] * (self.friction > 0)
            out += [Hidden(ViscousFriction.name, joint, {"damping": float(damping)})] * (self.friction > 0)
            out += [Hidden(JointElasticity.name, joint, gear)] * self.elastic
            out += [Hidden(TorqueRipple.name, joint, wave)] * (self.ripple > 0)
        return tuple(out)

    def trial(self, robot: Robot, number: int, *, loaded: bool) -> Task:
        """Repetitions that come after those in the log."""
        return self.task(robot, self.repetitions + self.watched + number, loaded=loaded)

    def task(self, robot: Robot, k: int, *, loaded: bool) -> Task:
        """Repetition k of the log, from 0, without the object or with it."""
        draw = np.random.default_rng([self.seed, int(loaded), k])
        own, reference = int(draw.integers(2**31)), Manipulation()
        times = reference.times(own)
        load = {"mass": self.mass, "com": list(self.com), "window": list(times["holds"])}
        load["ramp"] = float(draw.uniform(self.ramp[0], self.ramp[1]))
        torque_noise = tuple(self.torque_noise * np.resize(ARM["coulomb"], robot.dofs))
        return Task(
            name=f"{'loaded' if loaded else 'unloaded'}_{k + 1}",
            reference=reference,
            duration=DURATION,
            seed=own,
            hidden=(*self.hidden(robot), *[Hidden(PayloadChange.name, None, load)] * loaded),
            noise=Noise(position=self.position_noise, torque=torque_noise),
            begins={stage: times[stage][0] for stage in STAGES},
        )

    def _repetition(self, robot: Robot, k: int, *, loaded: bool) -> RawTrajectory:
        task = self.task(robot, k, loaded=loaded)
        raw = simulate(
            robot,
            task.reference,
            task.hidden,
            noise=task.noise,
            duration=task.duration,
            rate=RATE,
            seed=task.seed,
            torque_side=self.torque_side,
            position_side="motor",
            name=task.name,
        )
        return replace(raw, stage=task.stages(raw.t), payload_mass=self.mass if loaded else 0.0)

    def _named(self, robot: Robot) -> str:
        """Sixteen hex digits of all that the log depends on."""
        later = {"cache", *(f.name for f in fields(Conditioning))}
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in later}
        found = hashlib.sha256(repr(own).encode())
        for name, value in vars(robot).items():
            found.update(f"{name}{np.asarray(value).tolist()}".encode())
        for path in (Path(__file__), *sorted(Path(simulation.__path__[0]).glob("*.py"))):
            found.update(path.read_bytes())
        return found.hexdigest()[:16]

    def _conditioning(self) -> Conditioning:
        learned, last = self.repetitions, self.repetitions + self.watched
        return Conditioning.of(
            self,
            train=[f"unloaded_{k + 1}" for k in range(learned)],
            validation=[f"unloaded_{k + 1}" for k in range(learned, last)] or None,
            test=[f"loaded_{k + 1}" for k in range(learned)],
            train_share=0.7,
            validation_share=0.0,
            derivatives="positions",
            rate=None,
            max_gap=1.5 / RATE,
        )
