"""The report's section on the better simulation: the replay in words, a table and a picture, and the files for
simulators with what they do not contain."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.report.html import folded, picture, row, table
from invdyn_cli.report.replay_figure import angle_unit
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Diagnosis

REPLAY_CAPTION = (
    "Every window begins with the measured positions and velocities. Then the arm moves under the logged torques "
    "alone, without feedback. The windows are from held-out data."
)
OPEN = 4
"""Number of missing parts of a file above which their list is folded."""

MUJOCO = """\
import mujoco

model = mujoco.MjModel.from_xml_path("extended_model.mjcf.xml")
data = mujoco.MjData(model)
data.ctrl[:] = 0.0                # N m, the joints in the log's order: what the log calls torque
mujoco.mj_step(model, data)"""


def better_simulation(diagnosis: Diagnosis, drawn: Path | None, lacks: Mapping[str, Sequence[str]]) -> str:
    """The section as HTML; "" where there is neither a replay nor a file."""
    out = f"<p>{escape(replay_line(diagnosis))}</p>" if diagnosis.replay is not None else ""
    out += picture(drawn, REPLAY_CAPTION) if drawn is not None else ""
    out += _held(diagnosis) if diagnosis.replay is not None else ""
    for name, sentences in lacks.items():
        out += f'<p><span class="name">{escape(name)}</span> '
        out += "does not contain, or only approximates:</p>" if sentences else "contains all effects found.</p>"
        listed = f"<ul>{''.join(f'<li>{escape(x)}</li>' for x in sentences)}</ul>" if sentences else ""
        out += folded(f"{len(sentences)} items", listed) if len(sentences) > OPEN else listed
    mujoco = any(name.endswith(".xml") for name in lacks)
    return out + (folded("in MuJoCo", f"<pre>{escape(MUJOCO)}</pre>") if mujoco else "")


def replay_line(diagnosis: Diagnosis) -> str:
    """A heading: 'Unconstrained replay in MuJoCo, 0.2 s …: the extended arm deviates by 0.021 rad, the nominal by
    0.31.'"""
    replay = diagnosis.replay
    unit = "; ".join(dict.fromkeys(angle_unit(diagnosis).values()))
    after, before = (significant(float(x.mean())) for x in (replay.after, replay.before))
    change = f"{_percent(abs(100 * replay.gain))} % {'less' if replay.gain >= 0 else 'more'}"
    free = f"Unconstrained replay in MuJoCo, {replay.length:g} s under the logged torques"
    off = f"the extended arm deviates by {after} {unit}, the nominal arm by {before} {unit}: {change}"
    return f"{free}: {off} (RMS, mean of the joints)."


def _percent(share: float) -> str:
    """Whole percent; from 99 on so many nines as there are."""
    return f"{share:.0f}" if share < 99 or share >= 100 else f"{100 - float(f'{100 - share:.1g}'):.10g}"


def _held(diagnosis: Diagnosis) -> str:
    """Which torques are needed to hold both arms to the measured motion."""
    replay, angles, torques, body = diagnosis.replay, angle_unit(diagnosis), units_of(diagnosis), ""
    for i, joint in enumerate(replay.joints):
        cells = [
            f"{significant(float(x[i]))} {unit.get(joint, '')}"
            for x, unit in (
                (replay.before, angles),
                (replay.after, angles),
                (replay.held_before, angles),
                (replay.held_after, angles),
                (replay.torque_before, torques),
                (replay.torque_after, torques),
            )
        ]
        body += row(*map(escape, (joint, *cells)))
    heads = (
        "joint",
        "unconstrained, nominal",
        "extended",
        "with spring, nominal",
        "extended",
        "spring torque, nominal",
        "extended",
    )
    note = (
        f"RMS. With spring: for {replay.held:.0f} s, in addition to the logged torques, a weak spring and damper "
        "pull each joint to the measured motion; they are the same for both arms. Spring torque: the torque of both, "
        "which is zero for a correct model."
    )
    return folded("each joint, also with a spring", f'{table(heads, body, "")}<p class="note">{escape(note)}</p>')
