"""Adapters of the benchmark for causes: `python causes_tools.py NAME log.h5 robot.urdf answer.json` (causes.md).

`ours` names causes. The others estimate the parameters of a structure that somebody chose. Of theirs a term counts as
named if its 95 % interval, as that tool computes it, excludes zero, and if it makes over SHARE of its joint's torque.
"""
# pyright: reportAttributeAccessIssue=false

import json
import sys
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.signal import butter, sosfiltfilt

from invdyn_cli.log import Log
from invdyn_cli.logfile import read_log
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.store import plain

SHARE = 0.01
"""Of a joint's RMS torque that a term must make to be named."""

CUTOFF, RATE, MARGIN = 10.0, 100.0, 0.5
"""[Hz] of the low-pass filter and of the rows that estimators get, and [s] that are cut off at both ends."""

WINDOWS, WINDOW, STEP = 24, 0.25, 0.002
"""How many windows MuJoCo simulates, of how many seconds, with which time step [s]."""

MOVES = 0.2
"""Share of a joint's RMS speed, below which least squares does not use its rows: friction is anything there."""

TERMS = {
    "coulomb_friction": "coulomb",
    "viscous_friction": "damping",
    "rotor_inertia": "armature",
    "torque_offset": "offset",
}
"""What the estimators have for every joint, and the name of its size."""


class Rows(NamedTuple):
    """Filtered rows of a log (T, n), and their times (T,)."""

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray

    def column(self, effect: str) -> np.ndarray:
        """The term (T, n) of an effect of size one."""
        columns = {"coulomb_friction": np.sign(self.qd), "viscous_friction": self.qd, "rotor_inertia": self.qdd}
        return columns.get(effect, np.ones_like(self.q))

    def at(self, rate: float) -> "Rows":
        """Every so many rows that `rate` [Hz] is left."""
        step = max(1, round(1 / (rate * (self.t[1] - self.t[0]))))
        return Rows(*(x[::step] for x in self))


def rows_of(log: Log) -> Rows:
    """The only recording of a log after a zero-phase low-pass, with central differences."""
    raw = log.trajectories[0]
    sections = butter(4, CUTOFF, fs=log.rate, output="sos")
    q, tau = (sosfiltfilt(sections, x, axis=0) for x in (raw.q, raw.tau))
    qd = np.gradient(q, 1 / log.rate, axis=0)
    cut = slice(round(MARGIN * log.rate), -round(MARGIN * log.rate))
    return Rows(*(x[cut] for x in (raw.t, q, qd, np.gradient(qd, 1 / log.rate, axis=0), tau)))


def named(rows: Rows, joints: tuple[str, ...], terms: Iterable[tuple[str, str, float, float]]) -> list[dict[str, Any]]:
    """Findings of terms (effect, joint, size, half of the 95 % interval) that the rule counts as named. Friction and
    rotors below zero are no claim: no engineer would believe them."""
    findings = []
    for effect, joint, size, half in terms:
        j = joints.index(joint)
        share = abs(size) * np.sqrt(np.mean(rows.column(effect)[:, j] ** 2) / np.mean(rows.tau[:, j] ** 2))
        if share > SHARE and (abs(size) if effect == "torque_offset" else size) > half:
            findings.append({"effect": effect, "joint": joint, "parameters": {TERMS[effect]: size}})
    return findings


def ours(log: Log, urdf: Path) -> list[dict[str, Any]]:
    """The findings of a diagnosis."""
    from invdyn_cli.compiled import use_compilation_cache
    from invdyn_cli.diagnosis import diagnose

    use_compilation_cache()
    found = diagnose(log, load_urdf(urdf)).findings
    return [
        {
            **{name: getattr(x, name) for name in ("effect", "joint", "status", "alternatives", "window")},
            "parameters": {name: vars(y) for name, y in x.parameters.items()},
        }
        for x in found
    ]


def least_squares(log: Log, urdf: Path) -> list[dict[str, Any]]:
    """Joint by joint on what the URDF's inverse dynamics leave, while the joint moves: Coulomb, viscous, rotor inertia,
    offset. Intervals take the residual for white noise, as textbooks do."""
    import pinocchio as pin  # pyright: ignore[reportMissingImports]

    rows = rows_of(log).at(RATE)
    model: Any = pinocchio_model(load_urdf(urdf, joints=log.joints))
    data = model.createData()
    rest = rows.tau - [pin.rnea(model, data, *x) for x in zip(rows.q, rows.qd, rows.qdd, strict=True)]  # pyright: ignore
    terms = []
    for j, joint in enumerate(log.joints):
        moves = abs(rows.qd[:, j]) > MOVES * np.sqrt(np.mean(rows.qd[:, j] ** 2))
        columns = np.stack([rows.column(effect)[moves, j] for effect in TERMS], axis=1)
        sizes, *_ = np.linalg.lstsq(columns, rest[moves, j], rcond=None)
        noise = np.sum((rest[moves, j] - columns @ sizes) ** 2) / (len(columns) - len(sizes))
        half = 1.96 * np.sqrt(noise * np.diag(np.linalg.pinv(columns.T @ columns)))
        terms += zip(TERMS, [joint] * len(TERMS), sizes.tolist(), half.tolist(), strict=True)
    return named(rows, log.joints, terms)


def pest(log: Log, urdf: Path) -> list[dict[str, Any]]:
    """Inertial parameters of all links beside the same terms, `model=pest`; terms that are base parameters of their own
    can be named. Intervals count the residual's autocorrelation."""
    import jax

    from invdyn_cli.models.pest import Pest
    from invdyn_cli.types import Dataset, Motion, Trajectory

    rows = rows_of(log).at(RATE)
    one = Trajectory("log", rows.t, Motion(rows.q, rows.qd, rows.qdd), rows.tau)
    model = Pest(friction="coulomb_viscous", offset=True, rotor_inertia=True, weighting="torque_spread")
    data = Dataset((one,), log.joints, load_urdf(urdf, joints=log.joints))
    base = model.fit(data, jax.random.key(0)).details["base_parameters"]
    short = {"coulomb": "coulomb_friction", "viscous": "viscous_friction", "armature": "rotor_inertia"}
    columns = {f"{x}[{joint}]": (short.get(x, "torque_offset"), joint) for x in model.extras for joint in log.joints}
    found = zip(base["expressions"], base["values"], base["std"], strict=True)
    return named(rows, log.joints, [(*columns[x], float(y), 1.96 * float(s)) for x, y, s in found if x in columns])


def mujoco_sysid(log: Log, urdf: Path) -> list[dict[str, Any]]:
    """MuJoCo's system identification: Coulomb and viscous friction and armature of every joint, so that the simulation
    of WINDOWS short windows, driven by the logged torques, moves as the log does. Intervals are its own."""
    sysid: Any = import_module("mujoco.sysid")
    rows, raw = rows_of(log), log.trajectories[0]
    spec: Any = mujoco.MjSpec.from_file(str(urdf))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    params = sysid.ParameterDict()
    fields = {"coulomb_friction": "frictionloss", "viscous_friction": "damping", "rotor_inertia": "armature"}
    torque, speed, turn = (np.sqrt(np.mean(x**2, axis=0)) for x in (rows.tau, rows.qd, rows.qdd))
    for j, joint in enumerate(log.joints):
        spec.add_actuator(name=f"{joint}_torque", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        spec.add_sensor(name=f"{joint}_speed", type=mujoco.mjtSensor.mjSENS_JOINTVEL, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        spec.sensors[-1].objname = joint
        most = dict(zip(fields, torque[j] / (1.0, speed[j], turn[j]), strict=True))
        for effect, name in fields.items():

            def put(spec: Any, parameter: Any, joint: str = joint, name: str = name) -> None:
                size = np.zeros(np.shape(getattr(spec.joint(joint), name)))  # of damping newer versions have three
                size.flat[0] = parameter.value[0]
                setattr(spec.joint(joint), name, size)

            params.add(sysid.Parameter(f"{effect}@{joint}", 0.02 * most[effect], 0.0, most[effect], modifier=put))
    model = spec.compile()
    length = round(WINDOW * log.rate)
    starts = np.linspace(0, len(rows.t) - length - 1, WINDOWS).astype(int)
    at = np.searchsorted(raw.t, rows.t[0])
    states, controls, sensors = [], [], []
    for k in starts:
        part = slice(k, k + length)
        t = rows.t[part] - rows.t[k]
        states.append(sysid.create_initial_state(model, rows.q[k], rows.qd[k], np.zeros(0)))
        controls.append(sysid.TimeSeries(t, raw.tau[at:][part]))
        sensors.append(sysid.TimeSeries.from_names(t, rows.qd[part], model))
    names = [f"window {k}" for k in starts]
    windows = sysid.ModelSequences(log.robot, spec, names, states, controls, sensors)
    models: dict[bytes, mujoco.MjModel] = {}

    def build(params: Any, spec: Any) -> mujoco.MjModel:
        """The model of some parameters, compiled once for all windows."""
        key = params.as_vector().tobytes()
        if key not in models:
            models[key] = sysid.apply_param_modifiers(params, spec)
        return models[key]

    def differ(params: Any, predicted: Any, measured: Any, *_: Any, **__: Any) -> tuple[np.ndarray, Any, Any]:
        """In shares of the joints' speeds; by default each window has shares of its own, and rest counts for most."""
        measured = sysid.apply_delayed_ts_window(measured, predicted, 0.0, 0.0)
        predicted = predicted.resample(measured.times)
        return (predicted.data - measured.data) / speed, predicted, measured

    options: dict[str, Any] = {"build_model": build, "modify_residual": differ, "n_threads": 1}
    residual = sysid.build_residual_fn(models_sequences=[windows], **options)
    best, result = sysid.optimize(params, residual, verbose=False, max_iters=30)
    _, halves = sysid.calculate_intervals(residual(result.x, best)[0], result.jac)
    columns = [(effect, joint) for joint in log.joints for effect in fields]
    found = zip(columns, result.x, halves, strict=True)
    return named(rows, log.joints, [(*column, float(x), float(half)) for column, x, half in found])


def figaroh(log: Log, urdf: Path) -> list[dict[str, Any]]:
    """FIGAROH's identification of base parameters with friction, actuator inertia and offset, by weighted least
    squares; terms that are base parameters of their own can be named."""
    import yaml
    from figaroh.identification.base_identification import BaseIdentification  # pyright: ignore[reportMissingImports]
    from figaroh.tools.load_robot import load_robot  # pyright: ignore[reportMissingImports]

    raw = log.trajectories[0]
    step = max(1, round(log.rate / 250))
    rate = log.rate / step

    class Identification(BaseIdentification):
        def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Any]:
            """Angles and torques; derivatives are FIGAROH's."""
            return {"timestamps": raw.t[::step], "positions": raw.q[::step], "torques": raw.tau[::step]}

        def process_torque_data(self, **kwargs: Any) -> np.ndarray:
            """The torques, filtered as the angles are."""
            return self._apply_filters(self.raw_data["torques"], **self.filter_config["filter_params"])

    task = {
        "enabled": True,
        "joints": {"active_joints": list(log.joints)},
        "problem": {"qr_relative_tolerance": 1e-4},
        "signal_processing": {"sampling_frequency": rate, "cutoff_frequency": CUTOFF},
    }
    config = Path("figaroh.yaml")
    config.write_text(yaml.safe_dump({"robot": {"name": log.robot}, "tasks": {"identification": task}}))
    fit = Identification(load_robot(str(urdf)), str(config))
    moving = [fit.model.joints[fit.model.getJointId(joint)] for joint in log.joints]
    fit.identif_config |= {"act_idxq": [x.idx_q for x in moving], "act_idxv": [x.idx_v for x in moving]}
    fit.initialize()
    fit.solve(decimation_factor=2, plotting=False, wls=True)
    short = {"fs": "coulomb_friction", "fv": "viscous_friction", "Ia": "rotor_inertia", "off": "torque_offset"}
    columns = {f"{x}_{joint}": (effect, joint) for x, effect in short.items() for joint in log.joints}
    spread = np.abs(fit.phi_base) * fit.result["wls_std_deviations"] / 100
    found = zip(fit.params_base, fit.phi_base, spread, strict=True)
    return named(
        rows_of(log), log.joints, [(*columns[x], float(y), 1.96 * float(s)) for x, y, s in found if x in columns]
    )


ADAPTERS: dict[str, Callable[[Log, Path], list[dict[str, Any]]]] = {
    "ours": ours,
    "least_squares": least_squares,
    "pest": pest,
    "mujoco_sysid": mujoco_sysid,
    "figaroh": figaroh,
}


def main(name: str, log: str, urdf: str, answer: str) -> None:
    """Write the answer of a tool."""
    Path(answer).write_text(json.dumps(plain(ADAPTERS[name](read_log(log), Path(urdf)))))


if __name__ == "__main__":
    main(*sys.argv[1:])
