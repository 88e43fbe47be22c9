"""What a demo flies with: simulator, a ``zmav up`` for each vehicle, the ground's router, the links between them."""

from __future__ import annotations

import asyncio
import contextlib
import select
import socket
import threading
from pathlib import Path

from agents.demo.story import GROUND, Demo, Pair
from zmav.children import Children, simulator_once_up
from zmav.cli.sim.up import is_open
from zmav.process import free_port
from zmav.session import CONNECT

PIECE, RELAY_PATIENCE = 65536, 5.0
"""bytes at a time, and s for one end to take what the other sent"""
BESIDE = 6
"""programs that start beside each other. Where fifty routers join at once on two cores Zenoh 1.10.2 never tells one of
them of a subscription to all vehicles, in most starts: that vehicle is not heard
"""
LOOK = 0.1
"""s between two looks whether a router listens"""


class DemoFleet:
    """``with DemoFleet(...) as stage``: starts and ends all of it.

    ``stacks``: options of ``zmav sim`` that have real flight stacks fly the fleet.
    """

    def __init__(self, demo: Demo, processes: Children, folder: Path, ground: str, stacks: tuple[str, ...]) -> None:
        self.demo, self.processes, self.ground = demo, processes, ground
        self.control = folder / "sim.sock"
        self.cameras = f"http://127.0.0.1:{free_port()}"
        self.routers = {GROUND: ground, **{name: f"tcp/127.0.0.1:{free_port()}" for name in demo.vehicles}}
        """by host: where its own clients find its router"""
        self._stacks = stacks
        self._links = contextlib.ExitStack()
        self._relays: dict[frozenset[str], Relay] = {}

    def __enter__(self) -> DemoFleet:
        return self

    def __exit__(self, *exc: object) -> None:
        self._links.close()

    async def start(self) -> None:
        """Simulator first: it says where its vehicles are reached."""
        port = self.cameras.rpartition(":")[2]
        where = ("--fleet", str(self.demo.path), "--control", str(self.control), "--camera-port", port)
        self.processes.start("sim", "sim", *where, "--free-ports", *self._stacks)
        with await simulator_once_up(self.control, self.processes.check) as sim:
            urls = {vehicle.name: vehicle.url for vehicle in sim.status().vehicles}
        connects: dict[str, list[str]] = {name: [] for name in self.routers}
        for one, other in self.demo.links():
            connects[other].append(self._way((one, other)))
        for number, (name, own) in enumerate(self.routers.items(), start=1):
            ends = ["-l", own]
            for endpoint in connects[name]:
                ends += ["-e", endpoint]
            if name == GROUND:
                self.processes.start(name, "router", *ends)
            else:
                how = ("--file", str(self.demo.path), "--name", name, "--link", urls[name])
                self.processes.start(name, "up", *how, *ends)
            if number % BESIDE == 0:
                await self._listens(own)

    async def _listens(self, endpoint: str) -> None:
        """Wait until a router does; raises what :meth:`Children.check` does."""
        while not await asyncio.to_thread(is_open, endpoint):
            self.processes.check()
            await asyncio.sleep(LOOK)

    def environment(self, on: str) -> dict[str, str]:
        """In which a verb is one of this fleet, on that host."""
        return {CONNECT: self.routers[on], "ZMAV_FLEET": self.demo.fleet.fleet}

    def cut(self, pair: Pair, through: bool) -> None:
        """Let nothing pass between two routers any more; or (``through``) everything again."""
        relay = self._relays[frozenset(pair)]
        if through:
            relay.cut.clear()
        else:
            relay.cut.set()

    def _way(self, pair: Pair) -> str:
        """Where the second finds the first: at its router, or at a relay where the link will be cut."""
        router = self.routers[pair[0]]
        if frozenset(pair) not in self.demo.cuttable():
            return router
        relay = self._links.enter_context(Relay(int(router.rpartition(":")[2])))
        self._relays[frozenset(pair)] = relay
        return f"tcp/127.0.0.1:{relay.port}"


class Relay:
    """The link between two routers of a demo, where it is to be cut in flight: a TCP relay on loopback, without root.

    ``with Relay(port) as relay``: who connects to loopback's ``relay.port`` reaches ``port`` there; while
    :attr:`cut` is set nothing passes, as out of a radio's reach: nobody is told.
    """

    def __init__(self, port: int) -> None:
        self.cut = threading.Event()
        self._to, self._stop = ("127.0.0.1", port), threading.Event()
        self._door = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._door.getsockname()[1])
        self._other: dict[socket.socket, socket.socket] = {}
        """of each connection its other half"""
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stop.set()
        self._thread.join()
        for each in (self._door, *self._other):
            each.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            if self.cut.is_set():
                self._stop.wait(0.05)
                continue
            readable, _, _ = select.select([self._door, *self._other], [], [], 0.05)
            for each in readable:
                if self.cut.is_set():  # meanwhile
                    break
                if each is self._door:
                    self._connect()
                elif each in self._other:
                    self._pass(each)

    def _connect(self) -> None:
        near, _ = self._door.accept()
        try:
            far = socket.create_connection(self._to, RELAY_PATIENCE)
        except OSError:  # the other end is not there yet: who called tries again
            near.close()
            return
        near.settimeout(RELAY_PATIENCE)
        self._other[near], self._other[far] = far, near

    def _pass(self, source: socket.socket) -> None:
        with contextlib.suppress(OSError):
            if data := source.recv(PIECE):
                self._other[source].sendall(data)
                return
        for each in (source, self._other[source]):
            del self._other[each]
            each.close()
