"""Simulated vehicles with their agents and ``zmav ros2`` before them, and other people's ROS 2 to look at them with."""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import pytest
from zenoh_ros2_sdk import discovery
from zenoh_ros2_sdk.publisher import ROS2Publisher
from zenoh_ros2_sdk.service_client import ROS2ServiceClient
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.subscriber import ROS2Subscriber

import zmav
from ground.ros2.face import Face
from ground.ros2.types import INTERFACES, known
from tests.conftest import endpoint_of
from tests.own_thread import OwnThread
from tests.waiting import wait_until
from zmav import wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec, World

HOME = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
PATIENCE_S = 60.0


def pytest_collection_finish(session: pytest.Session) -> None:
    """Where a planner flies, compile its kernels, once on a machine, while no test's clock runs."""
    flown = any(item.path == Path(__file__).parent / "test_swarm.py" for item in session.items)
    if flown and not session.config.option.collectonly:
        from agents.planner.solve import jit
        from agents.planner.solve.warm import warm

        if not jit.compiled():
            warm()


class Peer:
    """zenoh-ros2-sdk on the router at ``port``: a peer of its own, as ROS 2's nodes are."""

    def __init__(self, port: int) -> None:
        self.where: dict[str, Any] = {"router_ip": "127.0.0.1", "router_port": port}
        self._open: list[Any] = []

    def close(self) -> None:
        for each in reversed(self._open):
            each.close()
        ZenohSession.get_instance(**self.where).close()

    def topics(self) -> dict[str, list[str]]:
        return dict(discovery.get_topic_names_and_types(0, **self.where))

    def services(self) -> dict[str, list[str]]:
        return dict(discovery.get_service_names_and_types(0, **self.where))

    def info(self, topic: str) -> Any:
        return discovery.get_topic_info(topic, 0, verbose=True, **self.where)

    def subscribe(
        self, topic: str, kind: str, definition: str = "", **more: Any
    ) -> tuple[list[Any], Callable[[], None]]:
        """What comes, and how to end it. The SDK has the text of the definition, and works out the hash by itself."""
        came: list[Any] = []
        text, digest = definition or known().definition(kind), known().hash(kind)
        subscriber = ROS2Subscriber(
            topic, kind, came.append, msg_definition=text, type_hash=digest, domain_id=0, **self.where, **more
        )
        self._open.append(subscriber)
        return came, subscriber.close

    def publish(self, topic: str, kind: str) -> Any:
        text, digest = known().definition(kind), known().hash(kind)
        publisher = ROS2Publisher(topic, kind, text, type_hash=digest, domain_id=0, **self.where)
        self._open.append(publisher)
        return publisher

    def client(self, service: str, kind: str, timeout: float = 30.0) -> Any:
        """The definition is the text that ROS has; what it needs of other packages is registered before."""
        package, what, name = kind.split("/")
        text = (INTERFACES / package / what / f"{name}.srv").read_text()
        text = re.sub(r"^([A-Z]\w+)(?=\S* )", rf"{package}/\1", text, flags=re.MULTILINE)
        request, answer = f"\n{text}".split("\n---\n")
        session = ZenohSession.get_instance(**self.where)
        plain = ("builtin_interfaces/msg/Time", "geometry_msgs/msg/Point", "rcl_interfaces/msg/ParameterValue")
        for each in (*plain, "unique_identifier_msgs/msg/UUID", "action_msgs/msg/GoalInfo"):
            session.register_message_type(known().definition(each), each)
        for each in ("Parameter", "SetParametersResult", "ListParametersResult", "ParameterDescriptor"):
            full = f"rcl_interfaces/msg/{each}"
            session.register_message_type(known().definition(full), full)
        client = ROS2ServiceClient(
            service,
            kind,
            request.strip() or "uint8 structure_needs_at_least_one_member",
            answer,
            type_hash=known().hash(kind),
            domain_id=0,
            timeout=timeout,
            **self.where,
        )
        self._open.append(client)
        return client


class Fleet(OwnThread):
    """Vehicles are as ``names`` says, in their specs' order."""

    def __init__(
        self,
        names: Sequence[str],
        specs: Sequence[VehicleSpec],
        speed: float,
        *,
        may_order: bool,
        beside: Callable[[str], AbstractAsyncContextManager[None]] | None = None,
    ) -> None:
        super().__init__(PATIENCE_S)
        self.names, self._specs, self._speed, self.may_order = names, specs, speed, may_order
        self._beside = beside
        """what else runs in the fleet, by the router's endpoint"""
        self.said: list[str] = []

    def wants(self, name: str) -> set[str]:
        """The messages that ``zmav ros2`` wants of a vehicle."""
        table = self.run(self.z.vehicle(name).rates.table())
        return {each.name for each in table.messages if any(reader.startswith("ros2-") for reader in each.readers)}

    async def live(self, ready: Future[None]) -> None:
        world = World(self._specs, endpoint="tcp:0", speed=self._speed, ready_s=0.5)
        router = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
        with world, open_session(router) as session:
            self.world, endpoint = world, endpoint_of(session)
            self.port = int(endpoint.rpartition(":")[2])
            programs = [
                await Onboard(session, OnboardSettings(link=url, name=name, origin=HOME)).__aenter__()
                for url, name in zip(world.urls, self.names, strict=True)
            ]
            async with zmav.open(connect=[endpoint]) as z:
                self.z = z
                for vehicle in await z.wait_for(*self.names, timeout=PATIENCE_S):
                    await vehicle.wait_until(lambda s: s.connected and bool(s.ready), PATIENCE_S)
                async with contextlib.AsyncExitStack() as stack:
                    if self._beside is not None:
                        await stack.enter_async_context(self._beside(endpoint))
                    face = Face(z, 0, {}, self.said.append, may_order=self.may_order)
                    self.face = await stack.enter_async_context(face)
                    while len(face.vehicles) < len(self.names):
                        await asyncio.sleep(0.02)
                    ready.set_result(None)
                    await self.stop.wait()
            for program in reversed(programs):
                await program.__aexit__(None, None, None)


@pytest.fixture
def fast(fleet: Fleet) -> Iterator[None]:
    """For a test that flies: time runs faster meanwhile. Where nothing flies, a fast clock is only work."""
    before = fleet.world.speed
    fleet.world.set_speed(4.0)
    yield
    fleet.world.set_speed(before)


@pytest.fixture
def peer(fleet: Fleet) -> Iterator[Peer]:
    found = Peer(fleet.port)
    yield found
    found.close()


def first(came: list[Any]) -> Any:
    """The newest that came, once any has."""
    wait_until(lambda: came, "nothing came")
    return came[-1]
