"""Units of a log's channels, how people write them, and what a number is multiplied by on its way into a log."""

import math

_DEG = math.pi / 180
ANGLE = {"rad": 1.0, "deg": _DEG, "rev": 2 * math.pi, "m": 1.0, "mm": 1e-3}
SPEED = {"rad/s": 1.0, "deg/s": _DEG, "rpm": 2 * math.pi / 60, "m/s": 1.0, "mm/s": 1e-3}
ACCELERATION = {"rad/s^2": 1.0, "deg/s^2": _DEG, "m/s^2": 1.0, "mm/s^2": 1e-3}
TORQUE = {"N m": 1.0, "N mm": 1e-3, "N": 1.0, "A": 1.0, "mA": 1e-3, "percent": 1.0}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

ALLOWED = {
    "t": TIME, "q": ANGLE, "q_ref": ANGLE, "q_link": ANGLE, "qd": SPEED, "qdd": ACCELERATION, "tau": TORQUE,
}  # fmt: skip
"""Channel -> unit -> factor into rad, m, rad/s, …, N m, N, A, s."""

CURRENTS = ("A", "mA", "percent")
"""Units of `tau` that only a drive gain turns into N m; a log keeps them as "A"."""

_SPELLINGS = {
    "rad": "rad radian radians", "deg": "deg degree degrees grad grados gradi °", "rev": "rev revs turn turns",
    "m": "m metre meter", "mm": "mm", "rad/s": "rad/s rads rad/sec radps",
    "deg/s": "deg/s degs deg/sec dps degps °/s", "rpm": "rpm rev/min",
    "m/s": "m/s", "mm/s": "mm/s", "rad/s^2": "rad/s^2 rad/s2 rad/s² rad/ss", "deg/s^2": "deg/s^2 deg/s2 deg/s² °/s²",
    "m/s^2": "m/s^2 m/s2 m/s²", "mm/s^2": "mm/s^2 mm/s2", "N m": "nm n*m n.m n·m newtonmetre newtonmeter",
    "N mm": "nmm n*mm", "N": "n", "A": "a amp amps ampere", "mA": "ma", "percent": "percent pct %",
    "s": "s sec secs second seconds", "ms": "ms msec millis milliseconds", "us": "us µs μs usec micros microseconds",
    "ns": "ns nsec nanos nanosec nanoseconds",
}  # fmt: skip
_CANONICAL = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}


def canonical(text: str) -> str | None:
    """The unit that a text means ("Nm" -> "N m", "degrees" -> "deg"), None where it means none."""
    return _CANONICAL.get("".join(text.lower().split()))


def factor(channel: str, unit: str) -> float:
    """What a number of this unit is multiplied by; KeyError for a unit that the channel does not have."""
    return ALLOWED[channel][unit]
