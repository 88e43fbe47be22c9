"""The whole fleet as one MAVLink endpoint: vehicles' frames to every station, stations' frames to whom they name.

Bytes pass as they came. Vehicles keep their system ids, stations theirs; who is asked for what is not here: the way
down is :mod:`ground.gcs.downlink`, the way up :mod:`ground.gcs.uplink`. Everything here only subscribes, and puts what
a station says: a second bridge changes nothing.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import msgspec

import zmav
from ground.feed import Feed
from ground.gcs.answerer import Answerer, Ground
from ground.gcs.client import Client
from ground.gcs.corrections import Corrections
from ground.gcs.downlink import Downlink
from ground.gcs.missions import Missions
from ground.gcs.options import Endpoint, Kind, Options
from ground.gcs.params import Params
from ground.gcs.places import StationEndpoint
from ground.gcs.request_handlers import HandlersByClient
from ground.gcs.routes import Routes
from ground.gcs.serial import Serial
from ground.gcs.streams import GCS, Streams
from ground.gcs.tcp import TcpIn
from ground.gcs.udp import UdpIn, UdpOut
from ground.gcs.uplink import Uplink
from zmav import keys, wire
from zmav.mavlink import Dialect, Frame, decode
from zmav.ratelimit import RateLimit
from zmav.subscription import document
from zmav.waiting import in_thread, on_loop

TOLD = frozenset({"refused", "lease", "pilot", "failsafe", "clash", "certificate", "fault", "mission"})
"""kinds of events that somebody at a station must see, and the autopilot does not say"""
AGAIN, MOST_SAID = 5.0, 1000
"""s for which the same words about a vehicle are not repeated; words that are let through in that time"""
TICK = 0.2
"""s between two looks at who is there"""
ENDPOINTS: dict[Kind, type[StationEndpoint]] = {"udp": UdpOut, "udpin": UdpIn, "tcp": TcpIn, "serial": Serial}


class BridgeSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What a bridge is made of."""

    endpoints: tuple[Endpoint, ...]
    vehicles: tuple[str, ...] = ("*",)
    streams: bool = True
    """the messages that stations need (:data:`ground.gcs.streams.GCS`) are wanted while a client is there"""

    def read_only(self) -> BridgeSettings:
        """The same, and nothing that a station says reaches a vehicle."""
        shut = (
            msgspec.structs.replace(each, options=msgspec.structs.replace(each.options, read_only=True))
            for each in self.endpoints
        )
        return msgspec.structs.replace(self, endpoints=tuple(shut))


class Bridge:
    """``async with Bridge(z, settings, say): ...``; ``say`` gets a line for anyone who watches, on the event loop.

    Raises a typed error where an endpoint cannot be had.
    """

    def __init__(
        self, z: zmav.Client, settings: BridgeSettings, say: Callable[[str], None] = lambda line: None
    ) -> None:
        if keys.is_replay(z.fleet_name):
            settings = settings.read_only()  # recordings are looked at, and told nothing
        self.z, self.settings = z, settings
        self.dialect: Dialect = z.dialect
        self.loop = asyncio.get_running_loop()
        self.news: Callable[[str], None] = on_loop(self.loop, say)
        self.routes = Routes(Options(vehicles=settings.vehicles), self.news)
        self.ground = Ground(z, self.loop, self.routes)
        self._by_client = HandlersByClient(self.ground)
        self._answerers: list[Answerer] = [
            each(self.ground, self._by_client) for each in (Params, Missions, Corrections)
        ]
        self.downlink = Downlink(self.dialect, self.routes, self._answerers)
        standard = GCS if settings.streams else {}
        self.streams = Streams(z.session, self.dialect, z.fleet_name, settings.vehicles, standard)
        self.uplink = Uplink(self, self.routes, self.streams, self._answerers)
        self._said: RateLimit[tuple[object, str]] = RateLimit(AGAIN, MOST_SAID)
        """words about a vehicle, to a client or to all"""
        self.endpoints: list[StationEndpoint] = []
        self._present: set[Client] = set()
        self._tasks: list[asyncio.Task[None]] = []
        self._feed: Feed | None = None

    @property
    def clients(self) -> tuple[Client, ...]:
        return self.downlink.clients

    async def __aenter__(self) -> Bridge:
        self.endpoints = [ENDPOINTS[endpoint.kind](endpoint, self) for endpoint in self.settings.endpoints]
        self._look()
        try:
            for endpoint in self.endpoints:
                await asyncio.to_thread(endpoint.start)
            z, vehicles = self.z, self.settings.vehicles
            self._feed = Feed(z.session, z.is_vehicle, self.downlink.on_frame, z.fleet_name, vehicles)
        except BaseException:
            await self.__aexit__()
            raise
        self._tasks = [self.loop.create_task(self._watch()), self.loop.create_task(self._tell_events())]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        if self._feed is not None:
            await in_thread(self._feed.close)
        for endpoint in self.endpoints:
            await in_thread(endpoint.close)
        for answerer in self._answerers:
            answerer.close()
        self._by_client.close()
        self.streams.close()

    # What endpoints tell: on their threads.

    def joined(self, client: Client) -> None:
        self.downlink.add(client)
        if client.present:
            self.news(f"{client.name} is there")

    def left(self, client: Client, why: str) -> None:
        client.close()
        self.downlink.remove(client)
        self._by_client.left(client)
        self.news(f"{client.name} is gone: {why}")

    def said(self, client: Client, frame: Frame) -> None:
        self.uplink.said(client, frame)

    def identified(self, client: Client) -> None:
        self.downlink.changed()
        if client.kind_of_station:
            ids = ", ".join(f"{system}/{component}" for system, component in sorted(client.ids))
            self.news(f"{client.name} is {ids} ({client.kind_of_station})")

    def ack(self, client: Client, frame: Frame, result: int) -> None:
        """Answer a command in the vehicle's place; one to all, in the place of each."""
        fields = decode(frame, self.dialect)
        system = fields["target_system"]
        answer = {"command": fields["command"], "result": result}
        asker = {"target_system": frame.sysid, "target_component": frame.compid}
        for known in self.routes.vehicles.values():
            if system in (0, known.sysid) and client.options.sees(known.name):
                client.send(self.ground.pack(known.sysid, known.compid, "COMMAND_ACK", **answer, **asker))

    # What clients are told.

    def tell(self, client: Client, sysid: int, severity: wire.Severity, text: str) -> None:
        seen = (known.sysid for known in self.routes.vehicles.values() if client.options.sees(known.name))
        system = sysid if sysid in self.routes.systems else next(seen, 0)
        if system and self._said.take(((client.name, sysid), text)) is not None:
            for frame in self.ground.words(system, severity, f"zmav: {text}"):
                client.send(frame)

    async def _tell_events(self) -> None:
        """Pass on what vehicles' agents say that a person at a station must see."""
        async with self.z.subscribe(keys.EVENT.key(self.z.fleet_name, "*"), document(wire.Event)) as events:
            async for key, event in events:
                _, fleet, name, *_ = key.split("/")
                known = self.routes.vehicles.get((fleet, name))
                if known is None or event.kind not in TOLD or self._said.take((known.place, event.text)) is None:
                    continue
                for client in self.clients:
                    if client.options.sees(known.name) and known.sysid not in client.systems:
                        for frame in self.ground.words(known.sysid, event.severity, event.text):
                            client.send(frame)
                if event.kind == "refused":
                    self.news(f"{name}: {event.text}")

    # Who is there.

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(TICK)
            self._look()

    def _look(self) -> None:
        came, gone = self.routes.refresh(self.z.fleet())
        for known in came:
            self.news(f"{known.name} is there: {known.what}")
        for known in gone:
            self.news(f"{known.name} is gone")
        there = {client for client in self.clients if client.present}
        for client in self._present - there:
            if client.stays and not client.gone:
                self.news(f"{client.name} is silent")
                client.forget()
                self.downlink.changed()
        self._present = there
        self.streams.refresh(there)
