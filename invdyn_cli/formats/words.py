"""What the name of a column says: quantity, joint, unit, and whether it is measured or commanded.

English words, and those of German, French, Spanish and Italian controllers that mean one thing only.
"""

import re
from dataclasses import dataclass

from invdyn_cli.formats.units import canonical

QUANTITIES = {
    "q": "q pos position positions angle angles theta state winkel lage posicion posizione",
    "qd": "qd dq vel velocity velocities speed speeds omega qdot geschwindigkeit drehzahl vitesse velocidad velocita",
    "qdd": "qdd ddq acc accel acceleration accelerations qddot",
    "tau": "tau torque torques trq effort efforts eff moment moments drehmoment drehmomente couple coppia",
    "current": "current currents cur curr amps i strom courant corriente corrente",
    "load": "load pwm",
    "t": "t time timestamp timestamps stamp clock epoch unixtime zeit zeitstempel temps tiempo tempo",
}
_FLAGS = {
    "commanded": "target desired des cmd command commanded commands ref reference setpoint goal action d soll "
    "sollwert consigne",
    "measured": "actual act measured meas msr feedback fb present observation ist istwert",
    "other": "tcp pose cartesian ee wrench ext external error err temp temperature temperatures temperatur "
    "voltage volt ft spannung",
    "filler": "joint joints jnt jt j a axis dof gelenk achse axe motor robot value values data sensor states field "
    "header",
    "unit": "deg degs degree degrees grad grados gradi rad rads radian radians ms us ns nm nmm ma rpm "
    "percent pct dps msec usec nsec",
}
COMMANDED, MEASURED, OTHER, FILLERS, UNITS = (frozenset(words.split()) for words in _FLAGS.values())
"""Words of targets, of measurements, of what a log has no channel for, beside "joint", of units anywhere in a name."""

LAST_UNITS = {"s": "t", "sec": "t", "secs": "t", "seconds": "t", "a": "current"}
"""Units only at the end of the name of that quantity: elsewhere they may mean anything."""

OF_SLIDES = {"q": (("m",), ("mm",)), "qd": (("m", "s"), ("mm", "s")), "tau": (("n",),)}
OF_SLIDES["qdd"] = tuple((*unit, "2") for unit in OF_SLIDES["qd"])
"""Units of a joint that slides, at the end of the name of that quantity behind a joint's."""

FORCES = frozenset({"force", "kraft", "fuerza", "forza"})
"""A force of a joint with a name is the torque of a slide; forces with a number or an axis are those of a sensor."""

_CLOCKS = (
    "unix epoch posix utc gps wall system sys host pc cpu ros log logger rec recording sample elapsed relative rel abs "
    "absolute monotonic controller device server local"
)
CLOCKS = frozenset(_CLOCKS.split())
"""Words that say which clock a time is of."""

_QUANTITY = {word: quantity for quantity, words in QUANTITIES.items() for word in words.split()}
_QUANTITY |= dict.fromkeys(FORCES, "tau")
_TOKEN = re.compile(r"[a-zµ°%]+|\d+")
_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]")


@dataclass(frozen=True)
class Meaning:
    """What a name says.

    Attributes:
        quantity: "t", "q", "qd", "qdd", "tau", "current", "load"; "" for what a log has no channel for.
        word: the word that says so.
        joint: its joint: a name, or a number as text; "" where there is none.
        commanded, measured, link: whether the name says that.
        unit: as `units` has it, "" where the name has none.
    """

    quantity: str
    word: str = ""
    joint: str = ""
    commanded: bool = False
    measured: bool = False
    link: bool = False
    unit: str = ""


def meaning(name: str) -> Meaning:
    """What the name of a column says; a quantity of "" where it says nothing that a log needs."""
    text, unit = name, ""
    for found in _BRACKETS.finditer(name):
        if canonical(found[1]):
            text, unit = text.replace(found[0], " "), canonical(found[1]) or ""
    text = re.sub(r"(?<=[a-z]{2})(?=[A-Z])", "_", text)
    tokens = [(m[0], m.start(), m.end()) for m in _TOKEN.finditer(text.lower())]
    words = [word for word, _, _ in tokens]
    if any(word in OTHER for word in words):
        return Meaning("")
    found = [i for i, word in enumerate(words) if word in _QUANTITY]
    if len({words[i] for i in found}) > 1:  # a joint that is called T
        found = [i for i in found if words[i] != "t"]
    apart = [i for i in found if not text[tokens[i][2] :][:1].isdigit()]  # of a joint that is called q1
    found = apart or found
    word = words[next((i for i in reversed(found) if words[i] != "state"), found[-1])] if found else ""
    quantity = _QUANTITY.get(word, "")
    if word == "state" and "observation" not in words:  # that of a machine
        quantity = ""
    unit, used = (unit, set()) if unit else _unit(words, quantity)
    joint_d = any(text[start:end] == "D" for _, start, end in tokens) and not text.isupper()  # "d" is "desired"
    flags = {w for w in words if w in COMMANDED or w in MEASURED or w == "link"} - ({"d"} if joint_d else set())
    rest = [i for i, w in enumerate(words) if i not in used and w not in flags and i not in found]
    kept = [i for i in rest if words[i] not in FILLERS] or [i for i in rest if len(words[i]) == 1]
    joint = _joint(text, tokens, kept)
    if quantity == "t" and {words[i] for i in kept} <= CLOCKS:
        joint = ""
    if word in FORCES and (len(joint) < 2 or joint.isdigit()):
        return Meaning("")
    return Meaning(
        quantity,
        word,
        joint,
        commanded=any(w in COMMANDED for w in flags),
        measured=any(w in MEASURED for w in flags),
        link="link" in flags,
        unit=unit,
    )


def _unit(words: list[str], quantity: str) -> tuple[str, set[int]]:
    """The unit that stands in a name without brackets, and which of its words it takes."""
    for i, word in enumerate(words):
        if word in UNITS or (i == len(words) - 1 > 0 and LAST_UNITS.get(word) == quantity):
            after = words[i + 1 : i + 3]
            if word in ("deg", "rad") and after == ["s", "2"]:
                return f"{word}/s^2", {i, i + 1, i + 2}
            if word in ("deg", "rad") and after[:1] == ["s"]:
                return f"{word}/s", {i, i + 1}
            return canonical(word) or "", {i}
    for unit in OF_SLIDES.get(quantity, ()):
        start = len(words) - len(unit)
        if start > 1 and tuple(words[start:]) == unit:
            written = "/".join(unit[:2]) + "^2" * (len(unit) > 2)
            return canonical(written) or "", set(range(start, len(words)))
    return "", set()


def _joint(text: str, tokens: list[tuple[str, int, int]], kept: list[int]) -> str:
    """The name of the joint as it is written: the rest of a name, with "joint" if it stands behind it, and with the "j"
    of "j3_quill"."""
    if not kept:
        return ""
    if all(tokens[i][0].isdigit() for i in kept):
        return tokens[kept[-1]][0]
    first, last = kept[0], kept[-1]
    if first and tokens[first - 1][0] in FILLERS and tokens[first - 1][2] == tokens[first][1]:
        first -= 1
    while last + 1 < len(tokens) and tokens[last + 1][0] in FILLERS:
        last += 1
    return text[tokens[first][1] : tokens[last][2]]
