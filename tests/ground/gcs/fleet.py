"""Simulated vehicles with their real agents, a router, and a bridge before them, for a whole module of tests."""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

import zmav
from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Kind, Options, parse_endpoint
from ground.gcs.tcp import TcpIn
from ground.gcs.udp import UdpIn
from tests.conftest import endpoint_of
from tests.ground.gcs.conftest import PATIENCE_S, Station
from tests.own_thread import OwnThread
from zmav.mavlink import decode
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import SimVehicle, VehicleSpec, World


class Fleet(OwnThread):
    """The vehicles are v1, v2... in their specs' order."""

    def __init__(self, specs: Sequence[VehicleSpec], speed: float = 4.0, **options: str) -> None:
        super().__init__(PATIENCE_S)
        self._specs, self._speed, self._options = specs, speed, options

    async def live(self, ready: Future[None]) -> None:
        world = World(self._specs, endpoint="tcp:0", speed=self._speed, ready_s=0.5)
        router = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
        with world, open_session(router) as session:
            self.endpoint = endpoint_of(session)
            self.names = [f"v{i}" for i in range(1, len(world.vehicles) + 1)]
            self.programs = programs = [
                await Onboard(session, OnboardSettings(link=url, name=name)).__aenter__()
                for url, name in zip(world.urls, self.names, strict=True)
            ]
            async with zmav.open(connect=[self.endpoint]) as z:
                self.world, self.z = world, z
                for vehicle in await z.wait_for(*self.names, timeout=PATIENCE_S):
                    await vehicle.wait_until(lambda s: s.connected, PATIENCE_S)
                    await vehicle.params.list()  # answered once its agent has read them all
                asked: tuple[tuple[Kind, str], ...] = (("tcp", "tcp"), ("udpin", "udpin"), ("tcp", "slow"))
                ends = [parse_endpoint(kind, f"0?{self._options.get(name, '')}", Options()) for kind, name in asked]
                async with Bridge(z, BridgeSettings(endpoints=tuple(ends), streams=False), lambda line: None) as bridge:
                    self.bridge = bridge
                    ready.set_result(None)
                    await self.stop.wait()
            for program in reversed(programs):
                await program.__aexit__(None, None, None)

    def vehicle(self, number: int) -> zmav.Vehicle:
        return self.z.vehicle(f"v{number}")

    def sim(self, number: int) -> SimVehicle:
        return self.world.vehicles[number - 1]

    def params(self, number: int) -> dict[str, float]:
        """What the autopilot itself holds."""
        store = self.sim(number).brain.params
        return {name: store[name] for name in store.names}

    @property
    def tcp(self) -> tuple[str, int]:
        return self._tcps[0]

    @property
    def _tcps(self) -> list[tuple[str, int]]:
        return [(each.address[0], each.address[1]) for each in self.bridge.endpoints if isinstance(each, TcpIn)]

    @property
    def udp(self) -> tuple[str, int]:
        return next((each.address[0], each.address[1]) for each in self.bridge.endpoints if isinstance(each, UdpIn))

    def caller(self, sysid: int = 255, compid: int = 190, *, slow: bool = False) -> Caller:
        """A station on the bridge's TCP server, or on the second one, which may be ``slow``."""
        return Caller(socket.create_connection(self._tcps[slow]), sysid, compid)


class Caller(Station):
    """A station that asks and waits."""

    def wait(self, true: Callable[[], bool], what: str) -> None:
        assert self.wait_for(true), f"never: {what}; {self.texts()}"

    def fields(self, name: str, sysid: int | None = None) -> list[dict[str, Any]]:
        """What came of a message, in order."""
        found = [frame for frame in self.named(name) if sysid in (None, frame.sysid)]
        return [decode(frame, self.dialect) for frame in found]

    def answer(self, question: str, answer: str, /, sysid: int = 1, **fields: Any) -> dict[str, Any]:
        """Say something to a vehicle's autopilot; what comes of ``answer`` next."""
        before = len(self.fields(answer, sysid))
        self.to(question, sysid, **fields)
        self.wait(lambda: len(self.fields(answer, sysid)) > before, f"{answer} to {question}")
        return self.fields(answer, sysid)[before]

    def to(self, message: str, sysid: int = 1, **fields: Any) -> None:
        self.send(message, **{"target_system": sysid, "target_component": 1, **fields})

    def silent_about(self, name: str, sysid: int | None = None) -> None:
        """Whatever was to come of it has come: the answer to another question came after it."""
        before = len(self.fields(name, sysid))
        self.answer("PARAM_REQUEST_READ", "PARAM_ERROR", sysid or 1, param_id="NO_SUCH_THING", param_index=-1)
        assert self.fields(name, sysid)[before:] == []
