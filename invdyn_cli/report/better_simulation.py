"""The report's section on the better simulation: the replay in words, a table and a picture, and the files for
simulators with what they do not hold."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from invdyn_cli.report.html import folded, picture, table
from invdyn_cli.report.replay_figure import angle_unit
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import units_of
from invdyn_cli.types import Diagnosis

REPLAY_CAPTION = (
    "Every window begins with the measured positions and velocities; from there on the arm follows the logged torques, "
    "and nothing pulls it back. The windows are of data that chose nothing."
)
OPEN = 4
"""Things that a file does not hold, above which their list is folded."""

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
        out += "holds all that was found.</p>" if not sentences else "does not hold, or only nearly:</p>"
        listed = f"<ul>{''.join(f'<li>{escape(x)}</li>' for x in sentences)}</ul>" if sentences else ""
        out += folded(f"{len(sentences)} things", listed) if len(sentences) > OPEN else listed
    mujoco = any(name.endswith(".xml") for name in lacks)
    return out + (folded("in MuJoCo", f"<pre>{escape(MUJOCO)}</pre>") if mujoco else "")


def replay_line(diagnosis: Diagnosis) -> str:
    """'Replayed in MuJoCo: left free for 0.2 s, the arm is off by 0.021 rad (nominal: 0.31), 93 % less.'"""
    replay = diagnosis.replay
    unit = "; ".join(dict.fromkeys(angle_unit(diagnosis).values()))
    after, before = (significant(float(x.mean())) for x in (replay.after, replay.before))
    change = f"{abs(100 * replay.gain):.0f} % {'less' if replay.gain >= 0 else 'more'}"
    free = f"left free for {replay.length:g} s under the logged torques, the extended arm is off by {after} {unit}"
    return f"Replayed in MuJoCo: {free}, the nominal one by {before} {unit}: {change} (RMS, mean of the joints)."


def _held(diagnosis: Diagnosis) -> str:
    """What it takes to hold both arms to the measured motion."""
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
        body += f"<tr><td>{escape(joint)}</td>" + "".join(f"<td>{escape(x)}</td>" for x in cells) + "</tr>"
    heads = ("joint", "free, nominal", "extended", "held, nominal", "extended", "torque, nominal", "extended")
    note = (
        f"RMS. Held: for {replay.held:.0f} s, beside the logged torques, a weak spring and damper, the same for both "
        "arms, pull each joint to the measured motion; torque: what they give. A right model needs nothing."
    )
    return folded("joint by joint, and held", f'{table(heads, body, "")}<p class="note">{escape(note)}</p>')
