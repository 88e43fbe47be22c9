"""What has been heard of an autopilot's parameters: values by name, and which of the announced ones are still missing.

A reading is one pass over the indices 0 to count - 1. Values stay known by name through several of them; a name that
the last whole reading did not have is gone. https://mavlink.io/en/services/parameter.html
"""

from __future__ import annotations

import hashlib
import re
import time
from dataclasses import dataclass
from typing import NamedTuple

from zmav import wire
from zmav.mavlink import paramvalue
from zmav.mavlink.paramvalue import ParamEncoding

NO_INDEX = 65535
NAME = re.compile(r"[!-~]{1,16}\Z")
NOT_IN_KEYS = frozenset("/*$#?,")
HASH_CHECK = "_HASH_CHECK"
"""PX4 lists a checksum of its set under this name; it is no parameter"""


class Entry(NamedTuple):
    """A value as it travels, and its type's name."""

    raw: bytes
    kind: str


@dataclass(frozen=True)
class ParamValue:
    """One PARAM_VALUE."""

    name: str
    entry: Entry
    count: int
    index: int


def is_name(name: str) -> bool:
    """It can be a parameter's name and stand in a key: what is none is junk on the line."""
    return bool(NAME.match(name)) and not NOT_IN_KEYS & set(name) and name != HASH_CHECK


class ParamSet:
    """The parameters of one autopilot. Written on the event loop; :meth:`param`, :meth:`names` and :meth:`table` are
    read from any thread.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Another autopilot: nothing is known of it."""
        self.count: int | None = None
        self.complete = False
        """the last reading was whole, and nothing has happened since that makes it doubtful"""
        self.missing: set[int] = set()
        """indices this reading has not heard yet"""
        self.entries: dict[str, Entry] = {}
        self.confirmed = 0.0
        """UTC seconds of the last PARAM_VALUE"""
        self.junk = 0
        """PARAM_VALUEs that cannot be one"""
        self.version = getattr(self, "version", 0) + 1
        """grows with every change"""
        self.restarts = 0
        """times the count or the order of the parameters changed"""
        self._names: dict[int, str] = {}

    def begin(self) -> None:
        """A new reading, from the first index on; what is known stays known."""
        self._names = {}
        self.missing = set(range(self.count or 0))

    def doubt(self) -> None:
        """Values may have changed without our hearing of it."""
        self.complete = False
        self.version += 1
        self.begin()

    @property
    def received(self) -> int:
        """Indices this reading has heard."""
        return len(self._names)

    @property
    def whole(self) -> bool:
        """This reading has heard every index, each with a name of its own."""
        return self.count is not None and not self.missing and len(set(self._names.values())) == self.count

    def hear(self, heard: ParamValue) -> bool:
        """Take in a PARAM_VALUE; False where it is junk."""
        announced = 0 < heard.count < NO_INDEX
        if not is_name(heard.name) or (heard.index < NO_INDEX and not (announced and heard.index < heard.count)):
            self.junk += 1
            return False
        self.confirmed = time.time()
        if heard.index == NO_INDEX:
            self._by_name(heard, announced)
        else:
            self._by_index(heard)
        return True

    def _by_index(self, heard: ParamValue) -> None:
        if heard.count != self.count:
            self._recount(heard.count)
        before = self._names.get(heard.index)
        if before not in (None, heard.name):  # in the middle of a reading, too: they have moved
            self._recount(heard.count)
        self._names[heard.index] = heard.name
        self.missing.discard(heard.index)
        self._put(heard)
        if not self.missing and self.whole and not self.complete:
            self._finish()

    def _by_name(self, heard: ParamValue, announced: bool) -> None:
        """The answer to a set or to a question by name: of a name that is hidden from the list, too."""
        if heard.name in self.entries:
            self._put(heard)
        if announced and self.count is not None and heard.count != self.count:
            self._recount(heard.count)

    def _recount(self, count: int) -> None:
        """The autopilot has more or fewer of them, or others: every index may mean another parameter now."""
        self.restarts += self.count is not None
        self.count = count
        self.doubt()

    def _put(self, heard: ParamValue) -> None:
        if self.entries.get(heard.name) != heard.entry:
            if len(self.entries) > 2 * (self.count or 0):  # names that come and go must not fill the memory
                self.entries = {name: self.entries[name] for name in self._names.values() if name in self.entries}
            self.entries[heard.name] = heard.entry
            self.version += 1

    def _finish(self) -> None:
        self.complete = True
        self.version += 1
        names = set(self._names.values())
        self.entries = {name: entry for name, entry in self.entries.items() if name in names}

    def end(self) -> None:
        """A reading that was asked for is over: where it is whole, only its names are left."""
        if self.whole:
            self._finish()

    def spelt(self, name: str) -> str:
        """The name of a parameter as its autopilot writes it: people write small letters."""
        return name.upper() if name not in self.entries and name.upper() in self.entries else name

    def param(self, name: str, encoding: ParamEncoding) -> wire.Param:
        """KeyError for a name that is not known."""
        return _param(name, self.entries[name], encoding)

    def names(self) -> list[str]:
        """All that are known, in their order."""
        return sorted(self.entries.copy())

    def table(self, encoding: ParamEncoding, autopilot: str, firmware: str | None) -> wire.ParamTable:
        """All of it, by index; names whose index is not known come last."""
        # "complete" is read first: what is copied afterwards is no less.
        t, complete, count = self.confirmed, self.complete, self.count or 0
        by_index, entries = self._names.copy(), self.entries.copy()  # both grow meanwhile
        ordered = [name for _, name in sorted(by_index.items()) if name in entries]
        params = [_param(name, entries[name], encoding) for name in dict.fromkeys([*ordered, *sorted(entries)])]
        return wire.ParamTable(
            t=t,
            complete=complete,
            count=count,
            hash=digest(params),
            autopilot=autopilot,
            firmware=firmware,
            encoding=encoding.value,
            params=params,
        )


def _param(name: str, entry: Entry, encoding: ParamEncoding) -> wire.Param:
    raw, kind = entry
    return wire.Param(name=name, value=paramvalue.value_of(raw, kind, encoding), type=kind)


def digest(params: list[wire.Param]) -> str:
    """The same for the same names, values and types in the same order, no matter who computes it."""
    text = "\n".join(f"{p.name} {p.value!r} {p.type}" for p in params)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
