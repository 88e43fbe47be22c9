"""The bearer of one host: a thread between its router's sockets on loopback and its radios.

A thread of its own and no event loop: what it carries must not wait for the adapter and the services beside it. A
datagram costs it 13 µs without a budget and 22 µs with one (tests/bench/qos.py).
"""

from __future__ import annotations

import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from mesh.bearer.flows import Local
from mesh.bearer.header import Data, Probe, host_tag, pack_data, pack_probe, unpack
from mesh.bearer.peer import Peer, Route, RouteStatus
from mesh.bearer.port import AT_ONCE, Address, RadioPort
from mesh.bearer.shaper import Bucket
from zmav.config import Radio

TICK = 0.05
"""s between judgements of the paths, at most"""
STRANGERS = 2000.0
"""bytes/s of echoes and probes to addresses that have proven nothing, all of them together"""
SMALL = 64
"""bytes of a probe with its headers, roughly"""
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Far:
    """A neighbour: its name and its ways, each our radio's place in the list, its address there, and the cost."""

    name: str
    ways: Sequence[tuple[int, Address, int]]
    opens: bool
    """our router opens the link: only one of the two should"""


class Bearer:
    """``with Bearer(...) as bearer``; ``bearer.local[name]`` is the port on loopback that leads to a neighbour.

    ``radios`` with the port to listen on, each; ``router`` is where our own router listens on loopback; ``known`` are
    the fleet's hosts, which may call though we have not named them. Raises :class:`~zmav.errors.BadConfig` for a budget
    that is none.
    """

    def __init__(
        self,
        fleet: str,
        name: str,
        radios: Sequence[tuple[Radio, int]],
        neighbours: Sequence[Far],
        router: Local,
        known: Sequence[str] = (),
    ) -> None:
        now = time.monotonic()
        self.ports = [RadioPort(radio, port, now) for radio, port in radios]
        self._tag, self._router = host_tag(fleet, name), router
        self._known = {host_tag(fleet, other): other for other in known if other != name}
        self._peers: dict[int, Peer] = {}
        for far in neighbours:
            peer = self._peers[host_tag(fleet, far.name)] = Peer(
                far.name, host_tag(fleet, far.name), router, opens=far.opens
            )
            for place, address, cost in far.ways:
                peer.add(self.ports[place], address, cost, now)
        self.local: Mapping[str, Local] = {
            peer.name: peer.opened.socket.getsockname() for peer in self._peers.values() if peer.opened
        }
        self._strangers = Bucket(STRANGERS, now)
        self._buffer = bytearray(65536)
        self._selector = selectors.DefaultSelector()
        self._wake, self._waker = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name="bearer", daemon=True)

    def __enter__(self) -> Bearer:
        self._selector.register(self._wake, selectors.EVENT_READ, None)
        for peer in self._peers.values():
            self._watch_local(peer)
        now = time.monotonic()
        self._open_ports(now)
        self._tick(now)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._waker.close()
        self._thread.join()
        self._selector.close()
        self._wake.close()
        for port in self.ports:
            port.close()
        for peer in self._peers.values():
            peer.close()

    @property
    def status(self) -> dict[str, list[RouteStatus]]:
        """By neighbour, now; from any thread."""
        return {peer.name: peer.status() for peer in list(self._peers.values())}

    # The thread.

    def _run(self) -> None:
        ticked = time.monotonic()
        while True:
            now = time.monotonic()
            for key, _ in self._selector.select(self._until(now, ticked)):
                if key.fileobj is self._wake:
                    return
                self._safely(key.data)
            now = time.monotonic()
            for port in self.ports:
                port.flush(now)
            if now - ticked >= TICK:
                ticked = now
                self._safely(self._open_ports, now)
                self._safely(self._tick, now)

    def _safely(self, action: Callable[..., None], *arguments: float) -> None:
        """Whatever came of it (no descriptors are left, say), the others' datagrams go on."""
        try:
            action(*arguments)
        except Exception:
            log.exception("bearer")

    def _until(self, now: float, ticked: float) -> float:
        """Seconds until something is due though nothing comes."""
        waits = [wait for wait in (port.wait(now) for port in self.ports) if wait is not None]
        return min([*waits, max(ticked + TICK - now, 0.0)])

    def _open_ports(self, now: float) -> None:
        """Close the sockets of radios that have gone, and open those that have come."""
        for port in self.ports:
            if port.socket is not None and port.gone:
                self._selector.unregister(port.socket)  # before it is closed: another may get its number
                port.close()
            if port.open(now) and port.socket is not None:
                self._selector.register(port.socket, selectors.EVENT_READ, partial(self._on_radio, port))

    def _tick(self, now: float) -> None:
        """Probe what is due, and choose paths again."""
        for peer in self._peers.values():
            peer.judge(now)
            for route in peer.routes:
                if route.path.due(now) <= 0.0 and self._may(route, now):
                    nonce, number = route.path.ask(now)
                    self._send(route, pack_probe(self._tag, nonce, number, echo=False), now)
            for quiet in peer.taken.quiet(now):
                self._selector.unregister(quiet)
                quiet.close()

    def _may(self, route: Route, now: float) -> bool:
        """Something small may be sent there: to the proven as often as we like, to others together so much."""
        return route.proven or self._strangers.take(SMALL, now)

    def _send(self, route: Route, data: bytes, now: float) -> None:
        route.port.send(None, data, route.to, now, first=True)

    # From our router.

    def _watch_local(self, peer: Peer) -> None:
        if peer.opened is not None:
            self._selector.register(peer.opened.socket, selectors.EVENT_READ, partial(self._on_opened, peer))

    def _on_opened(self, peer: Peer) -> None:
        """Our router sends on flows that it has opened."""
        assert peer.opened is not None
        now, view = time.monotonic(), memoryview(self._buffer)
        for _ in range(AT_ONCE):
            try:
                size, local = peer.opened.socket.recvfrom_into(self._buffer)
            except OSError:
                return
            number = peer.opened.number(local, now)
            if number is not None:
                self._carry(peer, number, False, view[:size], now)

    def _on_taken(self, peer: Peer, number: int, from_router: socket.socket) -> None:
        """Our router answers on a flow that the neighbour has opened."""
        now, view = time.monotonic(), memoryview(self._buffer)
        for _ in range(AT_ONCE):
            try:
                size = from_router.recv_into(self._buffer)
            except OSError:  # nothing more, or the router is not listening yet
                return
            self._carry(peer, number, True, view[:size], now)

    def _carry(self, peer: Peer, number: int, back: bool, payload: memoryview, now: float) -> None:
        if peer.route is None:
            return
        if len(payload) > peer.largest:
            peer.route.port.counters.too_big += 1
            return
        peer.route.port.send(peer, pack_data(self._tag, number, back, payload), peer.route.to, now)

    # From the radios.

    def _on_radio(self, port: RadioPort) -> None:
        now = time.monotonic()
        for data, source in port.receive(self._buffer):
            found = unpack(data)
            peer = self._peer(found.sender) if found is not None else None
            if found is None or peer is None:
                port.counters.foreign += 1
            elif isinstance(found, Probe):
                self._on_probe(port, peer, source, found, now)
            else:
                self._on_data(port, peer, source, found, now)

    def _peer(self, tag: int) -> Peer | None:
        """The neighbour of that tag; a host of the fleet that we have not named becomes one when it calls."""
        found = self._peers.get(tag)
        if found is None and tag in self._known:
            found = self._peers[tag] = Peer(self._known[tag], tag, self._router, opens=False)
        return found

    def _on_probe(self, port: RadioPort, peer: Peer, source: Address, probe: Probe, now: float) -> None:
        route = peer.find(port, source)
        if probe.echo:
            if route is None or not route.path.echoed(probe.nonce, probe.number, now):
                port.counters.foreign += 1
            else:
                route.proven = True
            return
        if route is None:
            if self._strangers.take(SMALL, now):
                route = peer.add(port, source, 2 * port.radio.way_cost(), now, learned=True)
            if route is None:
                port.counters.foreign += 1
                return
        elif not route.echoes.take(SMALL, now):
            return
        if route.proven:
            route.path.word(now)
        self._send(route, pack_probe(self._tag, probe.nonce, probe.number, echo=True), now)

    def _on_data(self, port: RadioPort, peer: Peer, source: Address, data: Data, now: float) -> None:
        route = peer.find(port, source)
        if route is None or not route.proven:
            port.counters.foreign += 1
            return
        route.path.word(now)
        if data.back:
            if peer.opened is None or not peer.opened.deliver(data.flow, data.payload):
                port.counters.foreign += 1
            return
        made = peer.taken.deliver(data.flow, data.payload, now)
        if made is not None:
            self._selector.register(made, selectors.EVENT_READ, partial(self._on_taken, peer, data.flow, made))
