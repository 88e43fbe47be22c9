"""The files that are written at a time: one .mcap of everything and a .tlog of each vehicle, complete in themselves."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from ground.record import schemas
from ground.record.decoder import STAMP
from ground.record.folder import Tail
from ground.record.schemas import Schema
from zmav import keys, wire
from zmav.errors import BadInput, BadKey
from zmav.mavlink import Dialect

SHARED = "fleet"
"""who is said to own what the whole fleet shares, where history is asked"""


class Asked(NamedTuple):
    """By what history is asked for."""

    fleet: str
    of: str
    what: str


class _Stamped(msgspec.Struct):
    t: float | None = None


_stamped = msgspec.json.Decoder(_Stamped)


class Route:
    """Of one key. Raises :class:`BadKey` for one that is not in the registry or is not recorded."""

    def __init__(self, key: str, dialect: Dialect) -> None:
        channel, parts = keys.match(key)
        if not channel.recorded:
            raise BadKey(f"{key!r} is not recorded: its channel is {channel.name}", field="key", value=key)
        self.key, self.channel = key, channel
        self.fleet, self.vehicle = parts["fleet"], parts.get("vehicle", SHARED)
        self.frames = channel in (keys.RX, keys.TX)
        self.asked = asked_of(key)
        self.base = f"{keys.ROOT}/{self.fleet}/{self.vehicle}"
        self.all_frames = f"{self.base}/mav/{channel.name}"
        """topic of every frame of the vehicle, in one direction"""
        self.message = dialect.by_name.get(parts["msg"]) if self.frames else None

    def schema(self, first: bytes) -> Schema:
        """Of the documents that come on this key; ``first`` is the first one of a file: signals have names of
        their own, and readers offer what the schema lists.
        """
        with contextlib.suppress(BadInput):
            if self.channel is keys.AGENT_OUT:
                return schemas.of_signals(wire.decode(first, wire.Signals, "signals"))
        if self.channel is keys.FLEET:
            kinds: dict[str, type[wire.Wire]] = {"origin": wire.Origin, keys.ORDERED: wire.OrderLine}
            known = kinds.get(self.asked.what)
            return schemas.of_payload(known) if known else schemas.of_any(f"zmav.{self.asked.what}")
        kind = self.channel.payload
        return schemas.of_payload(kind) if kind else schemas.of_any(f"zmav.{self.channel.name}")

    def location(self, document: bytes) -> bytes | None:
        """A state's place for a map; None of what is no such thing."""
        with contextlib.suppress(BadInput):
            if self.channel is keys.STATE:
                return schemas.location(wire.decode(document, wire.VehicleState, "state"))
        return None


def stamp(document: bytes) -> float | None:
    """Its source's time in UTC seconds, 0 where it gives none; None where it is no JSON object."""
    try:
        return _stamped.decode(document).t or 0.0
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return 0.0 if isinstance(msgspec.json.decode(document), dict) else None
        return None


def asked_of(key: str) -> Asked:
    """By what the history of a key is asked for. Raises :class:`BadKey` for one that is not in the registry."""
    channel, parts = keys.match(key)
    return Asked(parts["fleet"], parts.get("vehicle", SHARED), _what(channel, parts))


def _what(channel: keys.Channel, parts: dict[str, str]) -> str:
    if channel is keys.RX:
        return parts["msg"]
    return parts["topic"] if channel is keys.FLEET else channel.name


if TYPE_CHECKING:
    from ground.record.mcapfile import McapFile
    from ground.ros2.recorded import RosMessage

MOST_TLOGS = 300
"""vehicles that get a .tlog: invented names must not use up the files that a process may open"""
LONGEST_NAME = 200
"""letters of a vehicle and its fleet: a longer name cannot be a file's, and must not stop the recording"""
FAR = 4_102_444_800.0
"""the year 2100: a source's time behind it is none"""


class Part:
    """Part ``number`` of a session. OSError where files cannot be made or written: then :meth:`abandon` it."""

    def __init__(self, folder: Path, number: int, mcap: bool, dialect: Dialect, about: dict[str, str]) -> None:
        self._folder, self.number, self._dialect = folder, number, dialect
        self.tlogs: dict[tuple[str, str], Tail] = {}
        self.mcap: McapFile | None = None
        if mcap:
            from ground.record.mcapfile import McapFile

            self.mcap = McapFile(folder / f"record.{number:03}.mcap", about)
        self._topics: dict[str, tuple[int | None, int | None]] = {}

    @property
    def files(self) -> list[Tail | McapFile]:
        return [*self.tlogs.values(), *([self.mcap] if self.mcap else [])]

    @property
    def size(self) -> int:
        """Bytes of the largest file."""
        return max((each.tell() for each in self.files), default=0)

    @property
    def total(self) -> int:
        """Bytes of all files together."""
        return sum(each.tell() for each in self.files)

    @property
    def gone(self) -> bool:
        """Whether somebody took one of the files away."""
        return any(each.gone for each in self.files)

    def descriptors(self) -> list[int]:
        """Of its files, each a new one, to be closed by who asked: they outlive the part."""
        return [os.dup(each.fd) for each in self.files]

    def frame(self, route: Route, at: int, data: bytes, decoded: bytes | None) -> None:
        """``at``: ns UTC."""
        tlog = self.tlogs.get((route.fleet, route.vehicle)) or self._new_tlog(route)
        if tlog is not None:
            tlog.write(STAMP.pack(at // 1000) + data)
        if self.mcap is None:
            return
        raw, plain = self._topics.get(route.key) or self._frame_topics(route)
        if raw is not None:
            self.mcap.add(raw, at, data, at)
        if plain is not None and decoded is not None:
            self.mcap.add(plain, at, decoded, at)

    def _new_tlog(self, route: Route) -> Tail | None:
        if len(self.tlogs) >= MOST_TLOGS or len(route.fleet) + len(route.vehicle) > LONGEST_NAME:
            return None
        same = any(name == route.vehicle for _, name in self.tlogs)
        name = f"{route.fleet}.{route.vehicle}" if same else route.vehicle
        tail = Tail(self._folder / f"{name}.{self.number:03}.tlog")
        self.tlogs[route.fleet, route.vehicle] = tail
        return tail

    def _frame_topics(self, route: Route) -> tuple[int | None, int | None]:
        assert self.mcap is not None
        raw, plain = self.mcap.topic(route.all_frames, schemas.FRAMES, schemas.ALL_FRAMES), None
        if route.message is not None:
            schema = schemas.of_message(route.message, self._dialect)
            plain = self.mcap.topic(route.key, schemas.JSON, schemas.DECODED, schema)
        self._topics[route.key] = raw, plain
        return raw, plain

    def document(self, route: Route, at: int, data: bytes) -> None:
        """JSON, or whatever else came on a key."""
        if self.mcap is None:
            return
        t = stamp(data)
        if t is None:
            topic = self.mcap.topic(f"{route.key}/bytes", schemas.BYTES, schemas.AS_IT_CAME, key=route.key)
        else:
            topic, _ = self._topics.get(route.key) or self._document_topic(route, data)
        if topic is None:
            return
        self.mcap.add(topic, at, data, int(t * 1e9) if t and 0.0 < t < FAR else at)
        if (place := route.location(data)) is not None:
            name = f"{route.base}/location"
            extra = self.mcap.topic(name, schemas.JSON, schemas.DERIVED, schemas.LOCATION)
            if extra is not None:
                self.mcap.add(extra, at, place, at)

    def _document_topic(self, route: Route, first: bytes) -> tuple[int | None, None]:
        assert self.mcap is not None
        topic = self.mcap.topic(route.key, schemas.JSON, schemas.AS_IT_CAME, route.schema(first))
        self._topics[route.key] = topic, None
        return topic, None

    def ros(self, made: Iterable[RosMessage], at: int) -> None:
        """Messages of ROS 2 that were made of what came then (ns UTC)."""
        if self.mcap is None:
            return
        for said in made:
            schema = Schema(said.type, said.definition.encode(), "ros2msg")
            topic = self.mcap.topic(said.topic, schemas.CDR, schemas.DERIVED, schema)
            if topic is not None:
                self.mcap.add(topic, at, said.data, at)

    def flush(self) -> None:
        """Bring all of it to the disk's files. OSError where one of them took nothing."""
        for each in self.files:
            each.flush()

    def finish(self) -> None:
        """Complete and close every file, on the disk; the first OSError, once all are closed."""
        failed: OSError | None = None
        for each in self.files:
            try:
                each.finish()
            except OSError as e:
                failed = failed or e
        if failed:
            raise failed

    def abandon(self) -> None:
        """Close them as they are, each readable to its last flush; those that hold nothing are taken away, where the
        disk lets them be.
        """
        self.tlogs = {place: tail for place, tail in self.tlogs.items() if tail.abandon()}
        if self.mcap and not self.mcap.abandon():
            self.mcap = None
