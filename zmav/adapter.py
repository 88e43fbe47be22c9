"""Links <-> keys: the hot path.

One frame's way: the link's reader thread calls :meth:`Adapter._on_data` with bytes; the splitter checks them once and
cuts frames; each frame is put, untouched, on its own key by a publisher that was declared when the first of its kind
came; where nobody reads any frame, none is put. Nothing is decoded here. The last frame of each kind is kept, so that
services decode what somebody asks for.

The other way, for others' frames: :mod:`zmav.forwarding`.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import zenoh

from zmav import keys
from zmav.bus import Bus
from zmav.direct import direct
from zmav.links import Link, LinkState
from zmav.mavlink import Dialect, Frame, Packer, Splitter
from zmav.mavlink.signing import SETUP_SIGNING, Signing
from zmav.services.link.port import Flow, LastFrame, Listener, TxCounters
from zmav.session import is_read

MAX_STREAMS = 1024
"""Kinds of frames a vehicle has a declared publisher for and is remembered by; beyond it, frames are put undeclared."""
MAX_UNKNOWN = 256
"""... of which the dialect lacks the message: invented ids must not take the place of the vehicle's own."""
WAITED_NOT_S = 20e-6
"""a read that took no longer found what it brought there already"""
HEARTBEAT, TIMESYNC = 0, 111
COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: as what we speak"""


class LinkChanged(NamedTuple):
    """The link's state, and why, in words. Told from the link's threads."""

    state: LinkState
    text: str


class Put(Protocol):
    def __call__(self, payload: bytes) -> None: ...


class Stream:
    """The frames of one message from one (system, component): where they go, and the last of them."""

    __slots__ = ("count", "frame", "heard", "listeners", "put", "size")

    def __init__(self, put: Put) -> None:
        self.put = put
        self.frame: Frame | None = None
        self.heard = 0.0
        self.count = 0
        self.size = 0
        self.listeners: tuple[Listener, ...] = ()


class Adapter:
    """Carries one link's frames to the keys of one vehicle, and what its services send to the link.

    Thread-safe where marked. ``bus`` is told of each :class:`LinkChanged`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        name: str,
        link: Link,
        dialect: Dialect,
        bus: Bus,
        *,
        signing: Signing | None = None,
    ) -> None:
        self.session, self.fleet, self.name = session, keys.check_name(fleet, "fleet"), keys.check_name(name)
        self.link, self.dialect, self.bus = link, dialect, bus
        self.splitter = Splitter(dialect)
        self.tx = TxCounters()
        self.heard = 0.0
        self.signing = signing
        self._packer = Packer(dialect, 1, COMPONENT)
        self._routes: dict[bytes, Stream] = {}
        self._streams: dict[tuple[int, int, int], Stream] = {}
        self._unknown = 0
        self._listeners: dict[int, tuple[Listener, ...]] = {}
        self._listening = threading.Lock()
        """a stream that begins while somebody begins to listen must not miss it"""
        self._publishers: list[zenoh.Publisher] = []
        self._readers: zenoh.Publisher | None = None
        """of everything: nothing is put on it, it tells whether anybody reads any frame"""
        self.read = True
        """somebody reads frames, here or elsewhere in the network"""
        self.spoke = 0.0
        """monotonic seconds at which something was sent that may be answered, and nothing below knows of that"""
        self.awaited = 0
        """transactions that wait for frames (:func:`~zmav.services.link.port.listening`)"""

    def start(self) -> None:
        """Begin to carry; the link keeps itself open from now on."""
        everything = keys.RX.key(self.fleet, self.name, sys="*", comp="*", msg="*")
        self._readers = self.session.declare_publisher(everything)
        self._readers.declare_matching_listener(direct(self._on_readers))
        self._look()
        self.link.joins_s = 0.0 if self.link.recorded else WAITED_NOT_S
        self.link.start(self._on_data, self._on_link_state)

    def close(self) -> None:
        self.link.close()
        if self.signing is not None:
            self.signing.close()
        for publisher in (*self._publishers, self._readers):
            if publisher is not None:
                publisher.undeclare()
        self._readers = None
        self._publishers.clear()

    # From the link to the keys: the reader thread.

    def _look(self) -> bool:
        """Whether anybody reads. It is told, too, but a moment later."""
        self.read = self._readers is not None and is_read(self._readers)
        return self.read

    def _on_readers(self, status: zenoh.MatchingStatus) -> None:
        self.read = status.matching
        self.link.hurry()  # who reads does not wait for frames that lay for nobody

    def _on_data(self, data: bytes) -> None:
        frames = self.splitter.feed(data)
        if self.signing is not None:
            frames = [frame for frame in frames if self.signing.accepts(frame)]
        if not frames:
            return
        now = self.heard = time.monotonic()
        routes = self._routes
        try:
            read = self.read or self._look()
            for frame in frames:
                raw = frame.data
                # sysid, compid and message id lie side by side in both headers; the lengths tell the versions apart.
                stream = routes.get(raw[5:10] if raw[0] == 0xFD else raw[3:6]) or self._new_stream(frame)
                stream.frame = frame
                stream.heard = now
                stream.count += 1
                stream.size += len(raw)
                if read:
                    stream.put(raw)
                for listener in stream.listeners:
                    listener(frame)
        except zenoh.ZError:
            return  # only a closed session refuses a put: we are being closed

    def _new_stream(self, frame: Frame) -> Stream:
        raw, place = frame.data, (frame.sysid, frame.compid, frame.msgid)
        stream = self._streams.get(place)
        if stream is None:
            kept = len(self._streams) < MAX_STREAMS and (frame.verified or self._unknown < MAX_UNKNOWN)
            stream = Stream(self._putter(frame, kept))
            with self._listening:
                stream.listeners = self._listeners.get(frame.msgid, ())
                if not kept:
                    return stream
                self._streams[place] = stream
            self._unknown += not frame.verified
        self._routes[raw[5:10] if raw[0] == 0xFD else raw[3:6]] = stream
        return stream

    def _putter(self, frame: Frame, declared: bool) -> Put:
        key = keys.RX.key(
            self.fleet, self.name, sys=frame.sysid, comp=frame.compid, msg=self.dialect.name_of(frame.msgid)
        )
        if frame.msgid == SETUP_SIGNING:
            return lambda payload: None  # it holds the key
        if not declared:
            options = keys.RX.qos.options()
            return lambda payload: self.session.put(key, payload, **options)
        publisher = self.session.declare_publisher(key, **keys.RX.publishing())
        self._publishers.append(publisher)
        return publisher.put

    def _on_link_state(self, state: LinkState, text: str) -> None:
        if state is not LinkState.UP:
            self.splitter.reset()
        self.bus.tell(LinkChanged(state, text))

    # What services use; every method is thread-safe.

    def speak_as(self, sysid: int) -> None:
        """Use the vehicle's own system id, so that the companion never masks the loss of the real ground station."""
        if sysid != self._packer.sysid:
            self._packer = Packer(self.dialect, sysid, COMPONENT)

    @property
    def address(self) -> tuple[int, int]:
        """The system and component id we speak as."""
        return self._packer.sysid, COMPONENT

    def send(self, name: str, **fields: Any) -> bool:
        """Send a message of our own; False where the link is down or full."""
        data = self._packer.pack(name, **fields)
        return self.send_raw(data if self.signing is None else self.signing.sign(data))

    def send_raw(self, data: bytes) -> bool:
        msgid = int.from_bytes(data[7:10], "little") if data[0] == 0xFD else data[5]
        if msgid != HEARTBEAT:
            if msgid != TIMESYNC and not self.awaited:
                self.spoke = time.monotonic()
            self.link.hurry()  # last: it asks at once how long what comes may lie
        sent = self.link.send(data)
        if sent:
            self.tx.frames += 1
        else:
            self.tx.dropped += 1
        return sent

    def latest(self, name: str, source: tuple[int, int]) -> LastFrame | None:
        """The last such message of that (system, component), ``UNKNOWN_44000`` included; None: never heard."""
        stream = self._streams.get((*source, self.msgid(name)))
        return None if stream is None else self._heard(stream)

    def newest(self, name: str) -> LastFrame | None:
        """As :meth:`latest`, of whichever source spoke last."""
        msgid = self.msgid(name)
        found = filter(None, (self._heard(s) for place, s in list(self._streams.items()) if place[2] == msgid))
        return min(found, key=lambda heard: heard.age, default=None)

    @staticmethod
    def _heard(stream: Stream) -> LastFrame | None:
        if stream.frame is None:
            return None
        return LastFrame(stream.frame, time.monotonic() - stream.heard, stream.count)

    def names(self) -> list[str]:
        """The messages heard on this link, by name."""
        return sorted({self.dialect.name_of(msgid) for _, _, msgid in list(self._streams)})

    def flows(self) -> list[Flow]:
        """What came so far, by source and message."""
        name_of = self.dialect.name_of
        return [
            Flow(name_of(place[2]), place[0], place[1], stream.count, stream.size, stream.heard)
            for place, stream in list(self._streams.items())
        ]

    def msgid(self, name: str) -> int:
        """The number of a message, ``UNKNOWN_44000`` included."""
        number = name.removeprefix("UNKNOWN_")
        return int(number) if number != name and re.fullmatch("[0-9]+", number) else self.dialect.message(name).id

    def listen(self, name: str, listener: Listener) -> Callable[[], None]:
        """Call ``listener(frame)`` in the reader thread for every such message of any source, ``UNKNOWN_44000``
        included; returns what ends it.
        """
        msgid = self.msgid(name)
        self._set_listeners(msgid, lambda before: (*before, listener))
        return lambda: self._set_listeners(msgid, lambda before: tuple(x for x in before if x is not listener))

    def _set_listeners(self, msgid: int, change: Callable[[tuple[Listener, ...]], tuple[Listener, ...]]) -> None:
        with self._listening:
            listeners = self._listeners[msgid] = change(self._listeners.get(msgid, ()))
            for place, stream in self._streams.items():
                if place[2] == msgid:
                    stream.listeners = listeners
