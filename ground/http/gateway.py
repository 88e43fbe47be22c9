"""What every face of the gateway stands on: the last frame of each message, who has which system id, and sending."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import zenoh

from ground.feed import MOST, Feed, OnFrame, Origin
from ground.http.audit import Audit
from zmav import keys
from zmav.client import Client
from zmav.errors import BadInput, BadMessage, Clash, NoSuchVehicle, Stale
from zmav.mavlink import Dialect, Frame, parse_frame, targets
from zmav.services.rates.demand import NOT_STREAMED
from zmav.vehicle import Vehicle
from zmav.vehicle.rates import want_key
from zmav.waiting import on_loop, within

if TYPE_CHECKING:
    from ground.http.tiles import Picture, Tiles
    from ground.http.tileserver import TileServer
    from ground.record.steering import SteeredPlayer

LASTING = 30.0
"""s that an asked message is wanted for"""
MOST_WANTED = 256
"""tokens at once: more messages are not asked for"""


class Wants:
    """Messages that somebody asked for by name: tokens by fleet, vehicle, message and rate. On the event loop.

    An autopilot sends what somebody reads. The gateway reads whatever flows, which says nothing; so each message that
    is asked for has a token (see :mod:`zmav.vehicle.rates`), which goes a while after the last time.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._tokens: dict[tuple[str, str, str, float], tuple[zenoh.LivelinessToken, float]] = {}
        """and until when they last (monotonic seconds)"""
        self._timer: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return len(self._tokens)

    def want(self, vehicle: str, message: str, hz: float, fleet: str = "") -> bool:
        """Have a message sent at ``hz`` for :data:`LASTING` seconds from now.

        ``vehicle`` and ``fleet`` may be ``*``; no ``fleet`` is the client's. True where it was not wanted before and is
        now. Nobody is asked for what the dialect lacks, nor for answers, events and the heartbeat, which come when they
        come, nor for more than :data:`MOST_WANTED` at once.
        """
        place = (fleet or self._client.fleet_name, vehicle, message, hz)
        found = self._tokens.get(place)
        if found is not None:
            token = found[0]
        else:
            if len(self._tokens) >= MOST_WANTED or not self._is_streamed(message):
                return False
            try:
                rx = keys.RX.key(place[0], vehicle, sys="*", comp="*", msg=message)
                token = self._client.session.liveliness().declare_token(want_key(rx, hz, "http"))
            except BadInput:
                return False
        self._tokens[place] = token, time.monotonic() + LASTING
        if self._timer is None:
            self._sweep()
        return found is None

    def _is_streamed(self, message: str) -> bool:
        found = self._client.dialect.by_name.get(message)
        return found is not None and found.target_system is None and message not in NOT_STREAMED

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        for token, _ in self._tokens.values():
            token.undeclare()
        self._tokens.clear()

    def _sweep(self) -> None:
        now = time.monotonic()
        for place in [place for place, (_, until) in self._tokens.items() if until < now]:
            self._tokens.pop(place)[0].undeclare()
        self._timer = asyncio.get_running_loop().call_later(1.0, self._sweep) if self._tokens else None


APPEAR = 1.0
"""s for a message to come that was not asked for before"""
WANTED_HZ = 4.0
"""the rate at which a message is wanted that somebody asks for now and then"""
RECENT = 30.0
"""s within which a system must have been heard to be a vehicle's"""


class Kept(NamedTuple):
    """The last frame of one message of one system, and what was counted of them.

    ``first`` and ``last`` are UTC seconds, ``at`` is monotonic: when the first and the last came here.
    """

    origin: Origin
    frame: bytes
    counter: int
    first: float
    last: float
    began: float
    at: float

    @property
    def hz(self) -> float:
        """Messages a second since the first one: mavlink2rest's ``frequency``. 0 until there are two."""
        span = self.at - self.began
        return (self.counter - 1) / span if span > 0 else 0.0


class Gateway:
    """Use it with ``async with``, on an open client. Faces read it on the event loop.

    ``on_frame`` of the feed stores bytes and counts, and no more: anyone who asks has them decoded.
    """

    def __init__(
        self,
        client: Client,
        read_only: bool = False,
        stream_timeout: float = 60.0,
        tiles: Tiles | TileServer | None = None,
        picture: Picture | None = None,
        player: SteeredPlayer | None = None,
    ) -> None:
        self.client, self.read_only, self.stream_timeout = client, read_only, stream_timeout
        self.tiles, self.picture, self.player = tiles, picture, player
        self.started = time.time()
        self.wants = Wants(client)
        self.audit = Audit(client)
        self.sent = 0
        """frames put to vehicles by the faces"""
        self.figures: dict[str, Callable[[], float]] = {}
        """what the faces count of themselves, for /metrics: see :mod:`ground.http.metrics`"""
        self._kept: dict[str, Kept] = {}
        self._listeners: tuple[OnFrame, ...] = ()
        self._numbers: dict[tuple[int, int], Iterator[int]] = defaultdict(itertools.count)
        self._feed: Feed | None = None
        self._ends: list[Callable[[], None]] = []

    async def __aenter__(self) -> Gateway:
        await asyncio.to_thread(lambda: self.dialect)  # a second of reading that no request should wait for
        self._feed = Feed(self.client.session, self.client.is_vehicle, self._on_frame, self.client.fleet_name)
        return self

    async def __aexit__(self, *_: object) -> None:
        for end in self._ends:
            end()
        self.wants.close()
        if self.tiles is not None:
            self.tiles.close()
        if self._feed is not None:
            self._feed.close()

    @property
    def dialect(self) -> Dialect:
        return self.client.dialect

    def at_end(self, end: Callable[[], None]) -> None:
        """Have ``end`` called when the gateway ends."""
        self._ends.append(end)

    # What was heard.

    def add_listener(self, listener: OnFrame) -> Callable[[], None]:
        """Call ``listener(origin, frame)`` on a thread of Zenoh's for every frame; returns what ends that.

        It must be quick and must not raise.
        """
        self._listeners = (*self._listeners, listener)

        def remove() -> None:
            self._listeners = tuple(each for each in self._listeners if each is not listener)

        return remove

    def kept(self, sysid: int | None = None, compid: int | None = None, message: str | None = None) -> list[Kept]:
        """The last frame of each message, by vehicle, system, component and message; of one only where named."""
        found = [
            each
            for each in list(self._kept.values())
            if (sysid is None or each.origin.sysid == sysid)
            and (compid is None or each.origin.compid == compid)
            and (message is None or each.origin.message == message)
        ]
        return sorted(found, key=lambda each: each.origin[:5])

    def last(self, key: str) -> Kept | None:
        """The last frame that came on a key of ``mav/rx``."""
        return self._kept.get(key)

    def newest(self, sysid: int, compid: int, message: str) -> Kept | None:
        """The last such message of a system; ``compid`` 0: of any of its components."""
        return max(self.kept(sysid, compid or None, message), key=lambda kept: kept.at, default=None)

    def missing(self, sysid: int, compid: int, message: str) -> str:
        """That a message was not heard, and what was."""
        there = sorted({each.origin.message for each in self.kept(sysid, compid or None)})
        if not there:
            return f"nothing was heard of {sysid}/{compid}; system ids: {self.who()}"
        return f"no {message} was heard of {sysid}/{compid}; there are {', '.join(there)}"

    async def wanted(self, sysid: int, compid: int, message: str) -> Kept | None:
        """The last such message, which its vehicle is asked for, too; None where none comes within a second.

        What is asked for the first time is waited for: an autopilot does not send what nobody reads.
        """
        new = False
        for vehicle in self.vehicle_of(sysid):
            new |= self.wants.want(vehicle.name, message, WANTED_HZ, fleet=vehicle.fleet)
        kept = self.newest(sysid, compid, message)
        if new and (kept is None or time.monotonic() - kept.at > APPEAR):
            await self.next_frame(
                lambda o: o.message == message and o.sysid == sysid and compid in (0, o.compid), APPEAR
            )
            kept = self.newest(sysid, compid, message)
        return kept

    async def next_frame(self, fits: Callable[[Origin], bool], timeout: float) -> None:
        """Return when the next such frame has come, or after ``timeout`` seconds. ``fits``: on a thread of Zenoh's."""
        came = asyncio.Event()
        wake = on_loop(asyncio.get_running_loop(), came.set)

        def listen(origin: Origin, frame: bytes) -> None:
            if fits(origin):
                wake()

        remove = self.add_listener(listen)
        try:
            with contextlib.suppress(asyncio.TimeoutError):
                await within(timeout, came.wait())
        finally:
            remove()

    @property
    def frames(self) -> int:
        """Frames heard so far."""
        return self._feed.frames if self._feed is not None else 0

    def parse(self, kept: Kept) -> Frame:
        """Raises :class:`~zmav.errors.BadMessage` for bytes that are no frame."""
        return parse_frame(kept.frame, self.dialect)

    def _on_frame(self, origin: Origin, frame: bytes) -> None:
        now, at = time.time(), time.monotonic()
        before = self._kept.get(origin.key)
        if before is not None:
            self._kept[origin.key] = Kept(origin, frame, before.counter + 1, before.first, now, before.began, at)
        elif len(self._kept) < MOST:
            self._kept[origin.key] = Kept(origin, frame, 1, now, now, at, at)
        for listener in self._listeners:
            listener(origin, frame)

    # Who is there.

    def vehicle_of(self, sysid: int) -> list[Vehicle]:
        """The vehicles that speak as that system: more than one is a clash."""
        return self.sysids.get(sysid, [])

    @property
    def sysids(self) -> dict[int, list[Vehicle]]:
        """The vehicles present by the ids of their autopilots, and of whatever else was heard behind them of late."""
        names: dict[int, set[tuple[str, str]]] = defaultdict(set)
        present = {(vehicle.fleet, vehicle.name): vehicle for vehicle in self.client.fleet()}
        for place, vehicle in present.items():
            state = vehicle.last_state
            if state is not None and state.sysid is not None:
                names[state.sysid].add(place)
        known, now = set(names), time.monotonic()
        for kept in list(self._kept.values()):
            place, sysid = (kept.origin.fleet, kept.origin.vehicle), kept.origin.sysid
            if sysid not in known and place in present and now - kept.at < RECENT:
                names[sysid].add(place)
        return {sysid: [present[place] for place in sorted(found)] for sysid, found in sorted(names.items())}

    def the_vehicle(self, sysid: int) -> Vehicle:
        """The one vehicle of that system id; raises :class:`NoSuchVehicle` or :class:`Clash` saying who there is."""
        found = self.vehicle_of(sysid)
        if not found:
            raise NoSuchVehicle(f"no vehicle has system id {sysid}; there are {self.who()}", sysid=sysid)
        if len(found) > 1:
            names = " and ".join(f"{each.fleet}/{each.name}" for each in found)
            raise Clash(f"{names} share system id {sysid}: give one of them another (SYSID_THISMAV)", sysid=sysid)
        return found[0]

    def who(self) -> str:
        """The system ids there are and whose they are, in words."""
        found = [f"{sysid} ({', '.join(each.name for each in places)})" for sysid, places in self.sysids.items()]
        return ", ".join(found) or "none"

    # Sending.

    def next_seq(self, sysid: int, compid: int) -> int:
        """The sequence number of the next frame that we send as that system and component."""
        return next(self._numbers[sysid, compid]) & 0xFF

    def send(self, data: bytes, target: tuple[int, int] | None = None) -> list[str]:
        """Put a frame to the vehicle it is for, or to every vehicle where it is for all; returns the keys.

        ``target``: system and component for a message that names none itself. Raises
        :class:`~zmav.errors.BadMessage`, :class:`NoSuchVehicle`, :class:`Stale`, :class:`Clash`, and with credentials
        :class:`~zmav.errors.Forbidden` where our role may not. What the vehicle itself refuses comes as an event.
        """
        frame = parse_frame(data, self.dialect)
        sysid, compid = _target(frame, self.dialect, target)
        vehicles = [self._reachable(sysid)] if sysid else [each for each in self.client.fleet() if each.present]
        name, found = self.dialect.name_of(frame.msgid), []
        for vehicle in vehicles:
            key = keys.TX.key(vehicle.fleet, vehicle.name, sys=sysid, comp=compid, msg=name)
            if self.client.member is not None:
                self.client.member.check_role(key)
            self.client.put(keys.TX, key, data)
            self.sent += 1
            found.append(key)
        self.audit.say(f"frame/{name}", [vehicle.name for vehicle in vehicles], "", "sent")
        return found

    def _reachable(self, sysid: int) -> Vehicle:
        vehicle = self.the_vehicle(sysid)
        if not vehicle.present:
            age = vehicle.age or 0.0
            raise Stale(f"{vehicle.name} was last heard {age:.1f} s ago", vehicle=vehicle.name, age=age)
        return vehicle


def _target(frame: Frame, dialect: Dialect, wanted: tuple[int, int] | None) -> tuple[int, int]:
    """System and component of the key; raises :class:`BadMessage` where the message names another than is wanted."""
    said, message = targets(frame, dialect), dialect.by_id.get(frame.msgid)
    if wanted is None or message is None:
        return wanted or said
    names = ("target_system", message.target_system), ("target_component", message.target_component)
    for (field, offset), here, there in zip(names, said, wanted, strict=True):
        if offset is not None and here != there:
            raise BadMessage(f"{field} is {here}, but it was to go to {wanted[0]}/{wanted[1]}", field=field, value=here)
    return wanted
