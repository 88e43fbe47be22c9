"""Parameters: the store of one vehicle and the legacy parameter protocol with values cast to float.

Protocol: https://mavlink.io/en/services/parameter.html (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST)
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from typing import Any

from zmav.errors import BadConfig
from zmav.sim.protocol.channel import Answer, Channel, Part, Sender

NO_INDEX = 65535
PER_TICK = 16  # PARAM_VALUEs of a download in one tick: 1354 of them take about 0.9 s, as measured
_TYPES = {"b": 2, "h": 4, "i": 6}  # MAV_PARAM_TYPE, by the letter behind a value in a file; none: 9, a float
_BOUNDS = {2: 2**7, 4: 2**15, 6: 2**31}


Table = tuple[tuple[str, float, int], ...]
Observer = Callable[[str, float], None]


@cache
def defaults(name: str) -> Table:
    """(name, value, MAV_PARAM_TYPE) of every parameter in ``data/<name>.parm``, in the order of a download.

    A line there begins with what its names have in common ("-": nothing; "SERVO1-8_": eight times the same) and goes on
    where the next one is indented. "ALT=1500i" is a name's rest, its value, and the letter of its type.
    """
    groups: list[tuple[str, list[str]]] = []
    for line in resources.files("zmav.sim").joinpath("data", f"{name}.parm").read_text(encoding="ascii").splitlines():
        words = line.partition("#")[0].split()
        if words and not line.startswith(" "):
            groups.append((words.pop(0), []))
        if words:
            groups[-1][1].extend(words)
    return tuple(_row(prefix, word) for common, words in groups for prefix in _prefixes(common) for word in words)


def _prefixes(common: str) -> list[str]:
    if common == "-":
        return [""]
    many = re.fullmatch(r"(\w+?)(\d+)-(\d+)_", common)
    return [f"{many[1]}{i}_" for i in range(int(many[2]), int(many[3]) + 1)] if many else [common]


def _row(prefix: str, word: str) -> tuple[str, float, int]:
    rest, value = word.split("=")
    return prefix + rest, float(value.rstrip("bhi")), _TYPES.get(value[-1], 9)


class ParamStore:
    """Named values of one vehicle."""

    def __init__(self, table: Table, own: Table = ()) -> None:
        """``own``: rows that differ for this vehicle, or that only it has."""
        table = tuple({row[0]: row for row in (*table, *own)}.values())
        self.names = [row[0] for row in table]
        self.index = {name: i for i, name in enumerate(self.names)}
        self._values = {row[0]: to_float32(row[1]) for row in table}
        self._types = {row[0]: row[2] for row in table}
        self._observers: list[Observer] = []

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def get(self, name: str, default: float = 0.0) -> float:
        """A value, or ``default`` where this kind of vehicle has no such parameter."""
        return self._values.get(name, default)

    def __len__(self) -> int:
        return len(self.names)

    def type_of(self, name: str) -> int:
        return self._types[name]

    def set(self, name: str, value: float) -> None:
        """Store ``value`` as the parameter's type holds it. KeyError for a name that is not there."""
        kind = self._types[name]
        if kind in _BOUNDS:
            bound = _BOUNDS[kind]
            value = float(min(max(round(value), -bound), bound - 1))
        else:
            value = to_float32(value)
        self._values[name] = value
        for observer in self._observers:
            observer(name, value)

    def watch(self, observer: Observer) -> None:
        """Call ``observer(name, value)`` after every change."""
        self._observers.append(observer)

    def preset(self, values: dict[str, float]) -> None:
        """Values from a configuration; :class:`BadConfig` for a name that is not a parameter."""
        for name, value in values.items():
            if name not in self._values:
                raise BadConfig(f"no parameter {name!r}", field=f"params.{name}", value=value, expected="a known name")
            self.set(name, value)


def to_float32(value: float) -> float:
    """As the value travels: a single-precision number."""
    clipped = min(max(value, -3.4e38), 3.4e38)
    return float(struct.unpack("<f", struct.pack("<f", clipped))[0])


class ParamProtocol(Part):
    """Answers the PARAM_ messages of one vehicle."""

    def __init__(
        self, store: ParamStore, everyone: Callable[[], list[Channel]], banner: Callable[[Channel], None]
    ) -> None:
        self.store = store
        self._everyone = everyone
        self._banner = banner

    def answers(self) -> Mapping[str, Answer]:
        return {
            "PARAM_REQUEST_LIST": self.request_list,
            "PARAM_REQUEST_READ": self.request_read,
            "PARAM_SET": self.set,
        }

    def request_list(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        channel.params_next = 0
        self.due = -math.inf
        self._banner(channel)

    def request_read(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """By index, or by name where the index is -1; what does not exist stays unanswered."""
        index = msg["param_index"]
        if index >= 0:
            if index < len(self.store):
                self._send(channel, self.store.names[index], index)
        elif msg["param_id"] in self.store:
            self._send(channel, msg["param_id"], NO_INDEX)

    def set(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """Store and tell everyone; unknown names and values that are no numbers are ignored."""
        name, value = msg["param_id"], msg["param_value"]
        if name in self.store and math.isfinite(value):
            self.store.set(name, value)
            self.tell(name)

    def tell(self, name: str) -> None:
        """Send a value to everyone: somebody, or the vehicle itself, changed it."""
        for each in self._everyone():
            self._send(each, name, NO_INDEX)

    @property
    def sending(self) -> bool:
        return any(channel.params_next is not None for channel in self._everyone())

    def tick(self, now: float) -> None:
        self.due = math.inf
        for channel in self._everyone():
            self._feed(channel)
            if channel.params_next is not None:
                self.due = -math.inf

    def _feed(self, channel: Channel) -> None:
        """Go on with a download where the channel has room."""
        if channel.params_next is None:
            return
        for _ in range(PER_TICK):
            if channel.params_next >= len(self.store):
                channel.params_next = None
                return
            # Telemetry keeps its share of a slow link.
            if not channel.has_room(4):
                return
            self._send(channel, self.store.names[channel.params_next], channel.params_next)
            channel.params_next += 1

    def to_field(self, value: float, kind: int) -> float:
        """A value of a type as the message's float field carries it: cast."""
        return value

    def _send(self, channel: Channel, name: str, index: int) -> None:
        channel.send(
            "PARAM_VALUE",
            param_id=name,
            param_value=self.to_field(self.store[name], self.store.type_of(name)),
            param_type=self.store.type_of(name),
            param_count=len(self.store),
            param_index=index,
        )
