"""What differs between two recordings of one flight: messages, rates, constants and fill-ins, values in each phase, and
the direction in which fields move.
"""

from __future__ import annotations

import math
import re
import statistics
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from tests.sim.yardstick.reading import Message, flat, states
from zmav.mavlink.dialect import Dialect
from zmav.sim.arrays import Array

# What may differ by so much (in the field's units) or by a third.
TOLERANCE = {
    "": 3.0,
    "rad": 0.06,
    "deg": 4.0,
    "cdeg": 400.0,
    "degE7": 3000.0,
    "rad/s": 0.05,
    "mrad/s": 50.0,
    "m": 0.5,
    "mm": 500.0,
    "m/s": 0.6,
    "cm/s": 60.0,
    "m/s/s": 0.6,
    "mG": 20.0,
    "mgauss": 140.0,
    "gauss": 0.14,
    "%": 6.0,
    "d%": 60.0,
    "us": 60.0,
    "cA": 400.0,
    "hPa": 2.0,
    "cm": 60.0,
    "mV": 100.0,
}
CLOCKS = {"time_boot_ms", "time_usec", "time_unix_usec", "tc1", "ts1", "timestamp", "event_time_boot_ms", "uid"}
COUNTERS = {"count", "seq", "sequence", "messages_sent", "tx_rate", "rx_rate", "messages_received"}
UNCOMPARED = CLOCKS | COUNTERS
MOTIONS = ("vx", "vy", "vz", "roll", "pitch", "yawspeed")
TURN = {"deg": 360.0, "cdeg": 36000.0, "rad": math.tau}
FILL_INS = {65535.0, 32767.0, 255.0, 2147483647.0, -1.0, -32768.0, math.inf}
"""values that say "not known" in one field or another; NaN is taken for infinite, so that it equals itself"""
RATE_TOLERANCE = 0.1
OFTEN = 0.1  # of all values: no chance any more
LONG_S, MANY = 4.0, 8  # a phase, and messages in it, for a rate to mean something
NEAR_NOWHERE = 1e6  # degrees times 1e7: a place before the GPS has one
FIRM, LOOSE = 0.85, 0.5  # correlation with a motion that shows a sign, and one that shows the opposite


class Difference(NamedTuple):
    """One row of the table."""

    kind: str
    """message, rate, state, constant, value, sign, words"""
    what: str
    """MESSAGE or MESSAGE.field"""
    phase: str
    real: str
    ours: str


class Flight:
    """Messages, cut into phases by what GLOBAL_POSITION_INT and HEARTBEAT say."""

    def __init__(self, messages: list[Message]) -> None:
        self.messages = messages
        self.values: dict[tuple[str, str, str], list[float]] = defaultdict(list)
        """(phase, message, field) -> values"""
        self.count: dict[tuple[str, str], int] = defaultdict(int)
        """(phase, message) -> how many"""
        self.seconds: dict[str, float] = defaultdict(float)
        self.whole: dict[tuple[str, str], list[float]] = defaultdict(list)
        """(message, field) -> values"""
        self.moved: dict[tuple[str, str], list[tuple[float, ...]]] = defaultdict(list)
        """(message, field) -> its value and the :data:`MOTIONS` of that time (NaN: none known yet), while armed"""
        self._cut()

    def _cut(self) -> None:
        phase, armed, was_armed, known, moved_off, before = "boot", False, False, False, False, 0.0
        motions = dict.fromkeys(MOTIONS, math.nan)
        for at, name, fields in self.messages:
            self.seconds[phase] += at - before
            before = at
            if name == "HEARTBEAT":
                armed = bool(fields["base_mode"] & 128)
                was_armed |= armed
            if name == "GLOBAL_POSITION_INT":
                known |= abs(fields["lat"]) > NEAR_NOWHERE
                moved_off |= armed and max(map(abs, (fields["vx"], fields["vy"], fields["vz"]))) > 50
                phase = phase_of(fields, armed, was_armed) if known else "boot"
                if phase == "still":
                    phase = "hovering" if moved_off else "armed"
                motions.update({m: float(fields[m]) for m in MOTIONS[:3]})
            if name == "ATTITUDE":
                motions.update({m: float(fields[m]) for m in MOTIONS[3:]})
            moved = tuple(motions.values())
            self.count[phase, name] += 1
            for field, value in flat(fields):
                if field.partition("[")[0] not in UNCOMPARED:
                    number = math.inf if math.isnan(value) else value
                    self.values[phase, name, field].append(number)
                    self.whole[name, field].append(number)
                    if armed and math.isfinite(number):
                        self.moved[name, field].append((number, *moved))

    @property
    def names(self) -> set[str]:
        return {name for _, name, _ in self.messages}

    @property
    def phases(self) -> list[str]:
        return [phase for phase, lasted in self.seconds.items() if phase and lasted > LONG_S]


def phase_of(position: dict[str, Any], armed: bool, was_armed: bool) -> str:
    """The part of the flight that a GLOBAL_POSITION_INT belongs to; empty between two."""
    north, east, down = position["vx"], position["vy"], position["vz"]
    if not armed:
        return "landed" if was_armed else "standing"
    if down < -150:
        return "climbing"
    if 40 < down < 80 and max(abs(north), abs(east)) < 60:
        return "landing"
    for name, along, across in (("north", north, east), ("east", east, north)):
        if abs(along) > 150 and abs(across) < 0.25 * abs(along) and abs(down) < 60:
            return name if along > 0 else {"north": "south", "east": "west"}[name]
    return "still" if max(abs(north), abs(east), abs(down)) < 20 else ""


def compare(real: Flight, ours: Flight, dialect: Dialect, kinds: Mapping[str, tuple[str, ...]]) -> Iterator[Difference]:
    """All rows. ``kinds``: messages whose fields are states, to be gone through in the same order."""
    for name in sorted(real.names ^ ours.names):
        here = name in real.names
        yield Difference("message", name, "", "sent" if here else "-", "-" if here else "sent")
    yield from _rates(real, ours)
    for name, fields in kinds.items():
        a, b = states(real.messages, name, *fields), states(ours.messages, name, *fields)
        if a != b:
            yield Difference("state", name, "", str(a), str(b))
    yield from _words(real, ours)
    constants = list(_constants(real, ours, dialect))
    yield from constants
    told = {row.what for row in constants}
    yield from (row for row in _values(real, ours, dialect) if row.what not in told)
    yield from (row for row in _signs(real, ours) if row.what not in told)


def _rates(real: Flight, ours: Flight) -> Iterator[Difference]:
    for phase in real.phases:
        if phase not in ours.phases:
            continue
        for name in sorted(real.names & ours.names):
            a, b = real.count[phase, name], ours.count[phase, name]
            if max(a, b) < MANY or name in ("STATUSTEXT", "PARAM_VALUE", "EVENT"):
                continue
            rates = a / real.seconds[phase], b / ours.seconds[phase]
            # One message more or less at either end is chance.
            slack = 2.0 / min(real.seconds[phase], ours.seconds[phase])
            if abs(rates[0] - rates[1]) > max(RATE_TOLERANCE * max(rates), slack):
                yield Difference("rate", name, phase, f"{rates[0]:.2f} Hz", f"{rates[1]:.2f} Hz")


def _words(real: Flight, ours: Flight) -> Iterator[Difference]:
    # Without numbers, such as the speed of the touch-down.
    said = [{re.sub(r"[\d.]+", "#", f["text"]) for _, n, f in x.messages if n == "STATUSTEXT"} for x in (real, ours)]
    for text in sorted(said[0] ^ said[1]):
        here = text in said[0]
        yield Difference("words", text.strip(), "", "said" if here else "-", "-" if here else "said")


def _spread(values: set[float]) -> float:
    return max(values) - min(values)


def _constants(real: Flight, ours: Flight, dialect: Dialect) -> Iterator[Difference]:
    """What never changes, and what says "not known", is the same."""
    for name, field in sorted(real.whole.keys() & ours.whole.keys()):
        a, b = real.whole[name, field], ours.whole[name, field]
        if len(a) < MANY or len(b) < MANY:
            continue
        one, other = set(a), set(b)
        units = dialect.by_name[name].by_name[field.partition("[")[0]].units
        still = _spread(one) <= TOLERANCE.get(units, 0.0)
        near = TOLERANCE.get(units, 0.0) if units else 0.0
        if len(one) == 1 and not all(abs(a[0] - each) <= near or a[0] == each for each in other):
            yield Difference("constant", f"{name}.{field}", "", _number(a[0]), _some(other))
        elif len(one) > 3 and len(other) == 1 and not still:
            yield Difference("constant", f"{name}.{field}", "", _some(one), _number(b[0]))
        else:
            for value in FILL_INS & (one | other):
                shares = a.count(value) / len(a), b.count(value) / len(b)
                if min(shares) == 0.0 and max(shares) > OFTEN:
                    told = [f"{_number(value)} in {share:.0%}" for share in shares]
                    yield Difference("constant", f"{name}.{field}", "", *told)


def _values(real: Flight, ours: Flight, dialect: Dialect) -> Iterator[Difference]:
    for key in sorted(real.values.keys() & ours.values.keys()):
        phase, name, field = key
        if phase not in real.phases or phase not in ours.phases:
            continue
        if min(len(real.values[key]), len(ours.values[key])) < MANY:
            continue
        a, b = statistics.median(real.values[key]), statistics.median(ours.values[key])
        units = dialect.by_name[name].by_name[field.partition("[")[0]].units
        apart = gap(a, b, units)
        if apart > max(TOLERANCE.get(units, 3.0), max(abs(a), abs(b)) / 3):
            yield Difference("value", f"{name}.{field}", phase, f"{_number(a)} {units}", f"{_number(b)} {units}")


def gap(a: float, b: float, units: str) -> float:
    """The difference of two numbers; of angles, the short way round."""
    if math.isinf(a) or math.isinf(b):
        return 0.0 if a == b else math.inf
    turn, apart = TURN.get(units), abs(a - b)
    return apart if turn is None else min(apart % turn, turn - apart % turn)


def _signs(real: Flight, ours: Flight) -> Iterator[Difference]:
    """A field that follows a motion in the one follows it in the other, and not its opposite."""
    for key in sorted(real.moved.keys() & ours.moved.keys()):
        there, here = (np.array(flight.moved[key]).T for flight in (real, ours))
        for i, motion in enumerate(MOTIONS, start=1):
            a = _correlation(there[0], there[i])
            if abs(a) < FIRM:
                continue
            b = _correlation(here[0], here[i])
            if a * b < 0.0 and abs(b) > LOOSE:
                yield Difference("sign", ".".join(key), f"with {motion}", f"{a:+.2f}", f"{b:+.2f}")


def _correlation(values: Array, motion: Array) -> float:
    known = np.isfinite(motion)
    if known.sum() < 3 * MANY:
        return 0.0
    # From the first one on: the differences of large numbers, such as places, are what counts.
    xs, ys = (each[known] - each[known][0] for each in (values, motion))
    if np.ptp(xs) < 1e-9 or np.ptp(ys) < 1e-9:
        return 0.0
    return float(np.corrcoef(xs, ys)[0, 1])


def _number(value: float) -> str:
    return "NaN" if math.isinf(value) else f"{value:g}"


def _some(values: set[float]) -> str:
    shown = sorted(values)
    return ", ".join(map(_number, shown[:3])) + (f" ... {_number(shown[-1])}" if len(shown) > 3 else "")
