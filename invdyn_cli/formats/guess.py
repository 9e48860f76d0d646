"""Completes a column map: what the user did not say is guessed from the format, the names and the values of columns.

A guess is made only if a single reading remains. If several remain, an optional channel is left out with a note, and a
necessary one is asked for: all questions of a file are in one line.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from invdyn_cli.errors import LogError, listed
from invdyn_cli.formats import values
from invdyn_cli.formats.candidates import NAME, candidates, in_order, meant, ranged
from invdyn_cli.formats.columns import GIVEN, NONE, Channel, ColumnMap, each, expanded, numbered, seconds
from invdyn_cli.formats.joint_names import matched, placed
from invdyn_cli.formats.table import ASK, Table
from invdyn_cli.formats.units import ACCELERATION, ALLOWED, CURRENTS, SPEED, factor
from invdyn_cli.formats.words import meaning

VALUES = "guessed from values"
OPTIONAL = ("qd", "qdd", "q_ref", "q_link")
TORQUES = ("tau", "current", "load")


def complete(where: str, table: Table, given: ColumnMap) -> ColumnMap:
    """The map with everything that a log needs.

    Raises:
        LogError: one line with everything that the file leaves open, or for columns that it does not have.
    """
    return _Guess(where, table, given).made()


class _Guess:
    """The state of one completion: what is known so far, the questions, the notes."""

    def __init__(self, where: str, table: Table, given: ColumnMap) -> None:
        self.where, self.table, self.given = where, table, given
        self.channels: dict[str, Channel] = {}
        self.known: dict[str, str] = {}
        self.questions: list[str] = []
        self.notes: list[str] = []
        self.advice: list[str] = []
        self.candidates = candidates(table)
        self.joints: list[str] = []
        self.clock: np.ndarray | None = None

    def made(self) -> ColumnMap:
        self.time()
        self.positions()
        if self.joints:
            self.torques()
            for name in OPTIONAL:
                self.optional(name)
        side = self.side()
        if self.questions:
            options = " ".join(self.advice)
            raise LogError(
                f"{self.where}: the file does not say: {'; '.join(self.questions)}",
                advice=f"invdyn convert {self.where} OUT.h5 {options} (later: data.columns=OUT.columns.yaml)",
            )
        said = {"joints": tuple(self.joints), "channels": self.channels, "torque_side": side}
        known = {name: GIVEN for name in ("torque_side", "joints", "rate") if getattr(self.given, name)}
        return replace(self.given, **said, known=self.known | known, notes=tuple(self.notes))

    def ask(self, what: str, *options: str) -> None:
        self.questions.append(what)
        self.advice += options

    # What the rows stand at.

    def time(self) -> None:
        given = self.given.channel("t")
        named = [] if given.columns else self.named_clock()
        if given.columns == (NONE,) or (not given.columns and not named and self.given.rate):
            self.channels["t"], self.known["t"] = Channel((NONE,)), GIVEN
        elif given.columns:
            self.channels["t"] = replace(given, columns=expanded(self.where, self.table, given.columns[:1]))
            self.known["t"] = GIVEN
        elif named:
            name, known = named[0]
            self.channels["t"], self.known["t"] = replace(given, columns=(name,)), known
        else:
            rate = "(or rate=HZ; without converting: 'data.columns={rate: HZ}')"
            return self.ask("the clock (no column increases in equal steps)", "time.column=NAME", rate)
        self.time_unit()
        if not self.questions:
            self.clock = seconds(self.where, self.table, replace(self.given, channels=self.channels))
        return None

    def named_clock(self) -> list[tuple[str, str]]:
        """Columns that may be the clock, the best first."""
        named = [c for c in self.candidates if c.meaning.quantity == "t" and not c.meaning.commanded]
        told = [(x, c.known) for c in named for joint, x in c.columns.items() if not joint]
        grows = [x for x in told if (np.diff(self.table.columns[x[0]]) >= 0).mean() > 0.5]
        if grows:  # a count of runs is not, or an epoch that stays
            return sorted(grows, key=lambda x: (np.diff(self.table.columns[x[0]]) > 0).mean() < 0.5)
        first = next(iter(self.table.columns))
        column = self.table.columns[first]
        named = any(meaning(name).quantity for name in self.table.columns)
        unfit = named and (meaning(first).quantity or not values.time_unit(column))  # an index, for example
        return [(first, VALUES)] if not unfit and values.is_clock(column) else []

    def time_unit(self) -> None:
        one = self.channels["t"]
        if one.columns == (NONE,):
            return
        if one.unit:
            self.known["t.unit"] = GIVEN
            return
        column = self.table.columns[one.columns[0]]
        written = meant(self.table, one.columns[0]).unit
        unit = written or values.time_unit(column)
        self.channels["t"] = replace(one, unit=(unit,) if unit else ())
        self.known["t.unit"] = (self.table.by if one.columns[0] in self.table.told else NAME) if written else VALUES
        if not unit:
            step = float(np.median(np.diff(column)))
            self.ask(f"the unit of {one.columns[0]} (median step {step:.4g})", "time.unit=s|ms|us|ns")

    # Channels.

    def positions(self) -> None:
        given = self.given.channel("q")
        if given.columns:
            columns = expanded(self.where, self.table, given.columns)
            named = [self.joint(name) for name in columns]
            unique = all(named) and len(set(named)) == len(named)
            found = dict(zip(named if unique else map(str, range(len(columns))), columns, strict=True))
            self.known["q"] = GIVEN
        else:
            found = self.choose("q") or self.by_derivatives()
        if not found:
            if not any("q.columns" in x for x in self.advice):
                self.ask(f"the positions among {listed(self.table.columns, most=40)}", "q.columns=FIRST:LAST")
                if not self.given.channel("tau").columns and not any(
                    x.meaning.quantity in TORQUES for x in self.candidates
                ):
                    self.ask("the torques or currents", "tau.columns=FIRST:LAST", "tau.unit='N m'|A|mA|percent")
            return
        self.joints_by, self.columns_q = list(found), list(found.values())
        self.channels["q"] = replace(given, columns=tuple(found.values()))
        self.joints = self.names()
        self.unit("q", values.angle_unit, "q.unit=rad|deg")

    def names(self) -> list[str]:
        """What the joints are called."""
        words = not all(joint.isdigit() or not joint for joint in self.joints_by)
        named = self.joints_by if words else list(numbered(len(self.joints_by)))
        wanted = list(self.given.joints)
        if not wanted:
            self.known["joints"] = NAME if words else "numbered"
            return named
        if len(wanted) != len(named) or len(set(wanted)) < len(wanted):
            got = f"{self.where}: joints={wanted}, and q has {len(named)} columns: {listed(self.columns_q)}"
            raise LogError(f"{got}; allowed: a name for each column, each once")
        if order := matched(named, wanted) if words else None:  # an order, not new names
            self.joints_by = [self.joints_by[k] for k in order]
            if self.given.channel("q").columns:
                self.channels["q"] = self.reordered("q", self.channels["q"], order)
            else:  # units and signs are given in the order of the joints
                self.channels["q"] = replace(self.channels["q"], columns=placed(order, self.columns_q))
        return wanted

    def arranged(self, name: str, one: Channel) -> Channel:
        """A channel whose columns are given, in the order of the joints if the columns' names say which is which."""
        named = [self.joint(x) for x in one.columns]
        if len(named) != len(self.joints):
            return one
        order = matched(named, self.joints_by) or matched(named, self.joints)
        return self.reordered(name, one, order) if order else one

    def reordered(self, name: str, one: Channel, order: list[int]) -> Channel:
        """A channel with its columns, and what is given for each of them, in another order; a note says so. Columns
        that have only numbers keep the order in which they are given: a robot's axes may be counted otherwise."""
        if order == list(range(len(order))):
            return one
        columns = placed(order, one.columns)
        if all(self.joint(x).isdigit() for x in columns):
            kept = f"{name}.columns are read in the given order, not by their numbers: {listed(one.columns)} are those"
            self.notes.append(f"{kept} of {listed(self.joints or self.given.joints)}.")
            return one
        self.notes.append(f"{name}.columns are put in the order of the joints, by their names: {listed(columns)}.")
        return Channel(columns, placed(order, one.unit), placed(order, one.sign), placed(order, one.full_scale))

    def joint(self, column: str) -> str:
        one = meant(self.table, column)
        return one.joint if one.quantity else ""

    def choose(self, channel: str, quantity: str = "", *, commanded: bool = False) -> dict[str, str]:
        """The columns of a channel, one per joint of `q` once these are known; {} if there are none, or if several
        readings remain, which leads to a question or a note."""
        found = [
            c
            for c in self.candidates
            if c.meaning.quantity == (quantity or channel)
            and c.meaning.commanded == commanded
            and c.meaning.link == (channel == "q_link")
        ]
        found = [replace(c, columns=self.ordered(c.columns)) for c in found]
        found = [c for c in found if c.columns]
        best = [c for c in found if c.meaning.measured] or found
        if len(best) > 1:
            which = listed(ranged(list(c.columns.values())) for c in best)
            if channel in OPTIONAL:
                self.notes.append(f"{channel} is left out: it may be {which}; {channel}.columns=… selects one.")
            else:
                self.ask(f"which columns are {channel}: {which}", f"{channel}.columns=FIRST:LAST")
            return {}
        if not best:
            return {}
        self.known[channel] = best[0].known
        return best[0].columns

    def ordered(self, columns: dict[str, str]) -> dict[str, str]:
        """The columns of the joints of `q`, in that order; numbers that are as many are taken in order."""
        if not self.joints:
            return {joint: columns[joint] for joint in in_order(columns)}
        if set(self.joints_by) <= set(columns):
            return {joint: columns[joint] for joint in self.joints_by}
        numbers = all(joint.isdigit() for joint in (*columns, *self.joints_by))
        if numbers and len(columns) == len(self.joints):
            return dict(zip(self.joints_by, (columns[x] for x in in_order(columns)), strict=True))
        return {}

    def by_derivatives(self) -> dict[str, str]:
        """The positions of a file without names: the block of columns whose derivative is the next block."""
        names = [x for x in self.table.columns if x not in self.channels.get("t", Channel()).columns]
        if self.clock is None or any(meaning(x).quantity in ("q", "qd", "tau") for x in names):
            return {}
        pair = values.position_blocks(self.clock, names, self.table.columns)
        if pair is None:
            return {}
        self.known["q"] = self.known["qd"] = "guessed from values: one block is the derivative of the other"
        self.channels["qd"] = replace(self.given.channel("qd"), columns=tuple(pair[1]))
        return {str(k): name for k, name in enumerate(pair[0])}

    def torques(self) -> None:
        given = self.given.channel("tau")
        if given.columns == (NONE,):
            self.channels["tau"], self.known["tau"] = given, GIVEN
            return
        if given.columns:
            given = replace(given, columns=expanded(self.where, self.table, given.columns))
            self.channels["tau"] = self.arranged("tau", given)
            self.known["tau"] = GIVEN
        else:
            tried = [("tau", False), ("current", False), ("load", False), ("tau", True), ("current", True)]
            asked = len(self.questions)
            found = next((x for q, c in tried if (x := self.choose("tau", q, commanded=c))), {})
            if len(self.questions) > asked:
                return
            if not found:
                self.no_torques()
                return
            self.channels["tau"] = replace(given, columns=tuple(found.values()))
        self.unit("tau", self.torque, "tau.unit='N m'|A|mA|percent")

    def no_torques(self) -> None:
        """Columns that are named, but too few or too many, are asked for, and so are some without names; otherwise the
        file has none, and a note says so."""
        named = [list(c.columns.values()) for c in self.candidates if c.meaning.quantity in TORQUES]
        nearest = max(named, key=len, default=[])
        if len(nearest) > len(self.joints) / 2:
            pair = f"the joints of {ranged(nearest)} ({len(nearest)}) are not those of {ranged(self.columns_q)}"
            return self.ask(f"which columns are tau: {pair}", "q.columns=FIRST:LAST", "tau.columns=FIRST:LAST")
        used = {x for one in self.channels.values() for x in one.columns}
        rest = [x for x in self.table.columns if x not in used and not meaning(x).quantity]
        if any(meaning(x).quantity for x in self.table.columns) or len(rest) < len(self.joints):
            self.channels["tau"] = Channel((NONE,))
            self.known["tau"] = "no name says torque, current or load"
            self.notes.append("The file has no torques or currents: tau is NaN. The log keeps the clock, positions and")
            self.notes[-1] += " commands; check, run and diagnose need torques."
            if len(rest) >= len(self.joints):
                columns = f"'data.columns={{tau: {{columns: \"{ranged(rest)}\", unit: A}}}}'"
                self.notes[-1] += f" If {ranged(rest)} are torques or currents: {columns}, or another unit."
            return
        n = len(self.joints)
        blocks = [ranged(rest[k : k + n]) for k in range(0, len(rest) - n + 1, n)]
        self.ask(f"which columns are tau: {listed(blocks)}", "tau.columns=FIRST:LAST", "tau.unit='N m'|A|mA|percent")

    def optional(self, name: str) -> None:
        given = self.given.channel(name)
        guessed = name in self.channels
        if given.columns == (NONE,):
            self.channels.pop(name, None)
            return
        if given.columns:
            given = replace(given, columns=expanded(self.where, self.table, given.columns))
            self.channels[name] = self.arranged(name, given)
            self.known[name] = GIVEN
        elif not guessed:
            quantity = "q" if name in ("q_ref", "q_link") else name
            found = self.choose(name, quantity, commanded=name == "q_ref")
            if not found:
                return
            self.channels[name] = replace(given, columns=tuple(found.values()))
        self.unit(name, partial(self.by_comparison, name), "")

    # Units.

    def unit(self, name: str, guess: Callable[[np.ndarray], str | None], option: str) -> None:
        """Set the unit of a channel: given, said by format or name, guessed, asked for, or (where there is no option to
        ask for) the channel left out."""
        one = self.channels[name]
        if one.unit:
            self.known[f"{name}.unit"] = GIVEN
            return
        units = tuple(meant(self.table, x).unit for x in one.columns)
        if set(units) <= set(ALLOWED[name]):
            told = one.columns[0] in self.table.told
            self.known[f"{name}.unit"] = self.table.by if told else NAME
        else:
            self.known[f"{name}.unit"] = VALUES
            matrix = np.column_stack([self.table.columns[x] for x in one.columns]).astype(float)
            guessed = None if ASK in units and option else guess(matrix)
            units = (guessed,) if guessed else ()
        if units:
            self.channels[name] = replace(one, unit=units[:1] if len(set(units)) == 1 else units)
        elif option:
            largest = max(float(np.nanmax(np.abs(self.table.columns[x]), initial=0)) for x in one.columns)
            self.ask(f"the unit of {name}, {ranged(list(one.columns))} (largest {largest:.4g})", option)
        else:
            del self.channels[name]
            why = "its unit does not follow from its values and those of q"
            self.notes.append(f"{name} ({ranged(list(one.columns))}) is left out: {why}; {name}.unit=… keeps it.")

    def torque(self, matrix: np.ndarray) -> str | None:
        quantity = {meant(self.table, x).quantity for x in self.channels["tau"].columns}
        if quantity == {"current"}:
            return values.current_unit(matrix)
        if quantity == {"tau"}:
            self.known["tau.unit"] = f"{NAME}: a torque"
            return "N m"
        return None

    def by_comparison(self, name: str, matrix: np.ndarray) -> str | None:
        """The unit beside positions, or of accelerations beside velocities."""
        of = {"qd": "q", "qdd": "qd"}.get(name, "q")
        if of not in self.channels or not self.channels[of].unit or self.clock is None:
            return None
        other = values.continuous(self.scaled(of)) if of == "q" else self.scaled(of)
        matrix = matrix * np.array(each(f"{name}.sign", self.channels[name].sign or (1,), matrix.shape[1]))
        if name in ("qd", "qdd"):
            ratio = values.derivative_ratio(self.clock, other, matrix)
            return values.matching(ratio, SPEED if name == "qd" else ACCELERATION)
        units = self.channels[of].unit
        if len(set(units)) > 1:
            return None
        return units[0] if values.follows(other, values.continuous(matrix * factor("q", units[0]))) else None

    def scaled(self, name: str) -> np.ndarray:
        """A channel (T, n) in rad, rad/s, …."""
        one = self.channels[name]
        n = len(one.columns)
        factors = [factor(name, unit) for unit in each(f"{name}.unit", one.unit, n)]
        signs = each(f"{name}.sign", one.sign or (1,), n)
        return np.column_stack([self.table.columns[x] for x in one.columns]) * np.array(factors) * np.array(signs)

    def side(self) -> str:
        """The torque side: given, `motor` for currents, `command` for commanded torques, else `unknown`."""
        tau = self.channels.get("tau", Channel())
        if self.given.torque_side or tau.columns in ((), (NONE,)):
            return self.given.torque_side or "unknown"
        read = [meaning(x) for x in tau.columns]
        if all(x.commanded and x.quantity in ("tau", "current") for x in read):
            self.known["torque_side"] = NAME
            self.notes.append("tau is a commanded torque, not a measured one.")
            return "command"
        if tau.unit and set(tau.unit) <= set(CURRENTS):
            self.known["torque_side"] = "guessed from the unit"
            if "percent" not in tau.unit and not self.given.drive_gain:
                said = "tau is a current: drive_gain=[…], N m per A, makes torques of it"
                self.notes.append(f"{said}; without, invdyn diagnose estimates gains from the URDF's masses.")
            if "percent" in tau.unit and not tau.full_scale:
                said = "tau is in percent of full scale and stored as if it were A, so drive gains are N m per percent"
                self.notes.append(f"{said}; tau.full_scale=[…], N m at 100 percent, gives torques.")
            return "motor"
        if any(x.word in ("effort", "efforts") for x in read) and self.known.get("tau.unit") != GIVEN:
            self.notes.append("Some drivers publish currents as effort; if this one does, say tau.unit=A.")
        said = "The torque side is unknown; it decides which effects the log can show. Say where it was measured:"
        self.notes.append(
            f"{said} 'data.columns={{torque_side: motor}}', or link, command (convert: torque_side=motor)."
        )
        return "unknown"
