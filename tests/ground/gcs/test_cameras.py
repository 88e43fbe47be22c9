"""A ground station that finds cameras and moves a gimbal through the bridge, by pymavlink: as QGroundControl asks."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import time
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

import zmav
from agents.camera.agent import CameraAgent
from agents.camera.photos import Photos
from agents.camera.settings import CameraSettings
from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Options, parse_endpoint
from ground.gcs.udp import UdpIn
from tests.agents.camera.conftest import Painted
from tests.cli.conftest import Here, zmav_here
from tests.conftest import PATIENCE_S, endpoint_of
from tests.own_thread import OwnThread
from zmav.client import Client
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec, World

os.environ.setdefault("MAVLINK20", "1")

CAMERA, STREAM_ONLY, AUTOPILOT = 100, 101, 1
URI = "rtsp://192.168.144.25:8554/main"
ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3
REQUEST = 512
NAN = math.nan


class Aboard(OwnThread):
    """A copter with a gimbal, a camera of which photos are taken, and one of which there is a stream alone."""

    def __init__(self, folder: Path) -> None:
        super().__init__(PATIENCE_S)
        self._folder = folder

    async def live(self, ready: Future[None]) -> None:
        world = World([VehicleSpec(name="quad1", params={"MNT1_TYPE": 1})], endpoint="tcp:0", ready_s=0.5)
        router = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
        with world, open_session(router) as session:
            self.endpoint = endpoint_of(session)
            client = SessionSettings(connect=[self.endpoint])
            settings = OnboardSettings(link=world.urls[0], name="quad1", streams={"ahead": URI})
            async with contextlib.AsyncExitStack() as stack:
                teller = Client(client, "demo", "ardupilotmega")
                teller.adopt(session)

                async def tell(agent: str, verb: str, args: dict[str, Any]) -> dict[str, Any]:
                    return await teller.vehicle("quad1").tell(agent, verb, **args)

                self.onboard = await stack.enter_async_context(Onboard(session, settings, tell=tell))
                z = await stack.enter_async_context(zmav.open(settings=client))
                self.z = z
                self.quad = (await z.wait_for("quad1", timeout=PATIENCE_S))[0]
                await self.quad.wait_until(lambda s: s.connected and s.position is not None, PATIENCE_S)
                own = CameraSettings(vehicle="quad1")
                source = Painted(width=640, height=480)
                self.camera = CameraAgent(z, own, source, 1.1)
                await stack.enter_async_context(self.camera)
                self.photos = Photos(z, self.camera, self._folder)
                await stack.enter_async_context(self.photos)
                telling = asyncio.create_task(self.photos.run())
                ends = (parse_endpoint("udpin", "0", Options()),)
                self.bridge = Bridge(z, BridgeSettings(endpoints=ends), lambda line: None)
                await stack.enter_async_context(self.bridge)
                self.world = world
                ready.set_result(None)
                await self.stop.wait()
                telling.cancel()

    @property
    def port(self) -> int:
        return next(int(each.address[1]) for each in self.bridge.endpoints if isinstance(each, UdpIn))

    @property
    def gimbal(self) -> Any:
        return self.world.vehicles[0].node.gimbal


class Station:
    """QGroundControl's part, in pymavlink."""

    def __init__(self, port: int) -> None:
        from pymavlink import mavutil

        self.link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255, source_component=190)
        self.texts: list[str] = []
        self.captured: list[Any] = []
        """each CAMERA_IMAGE_CAPTURED, whatever was waited for"""
        self.beat()

    def beat(self) -> None:
        self.link.mav.heartbeat_send(6, 8, 0, 0, 4)

    def get(self, name: str, component: int, true: Any = lambda message: True) -> Any:
        deadline, due = time.monotonic() + PATIENCE_S, 0.0
        while time.monotonic() < deadline:
            if time.monotonic() > due:
                due = time.monotonic() + 1.0
                self.beat()
            message = self.link.recv_match(blocking=True, timeout=0.2)
            if message is None:
                continue
            if message.get_type() == "STATUSTEXT":
                self.texts.append(message.text)
            if message.get_type() == "CAMERA_IMAGE_CAPTURED":
                self.captured.append(message)
            if message.get_type() == name and message.get_srcComponent() == component and true(message):
                return message
        pytest.fail(f"no {name} of component {component}; {self.texts}")

    def command(self, component: int, number: int, *params: float) -> int:
        """Its MAV_RESULT, by that component."""
        padded = [*params, *[0.0] * (7 - len(params))]
        self.link.mav.command_long_send(1, component, number, 0, *padded)
        return int(self.get("COMMAND_ACK", component, lambda ack: ack.command == number).result)

    def ask(self, component: int, name: str, msgid: int) -> Any:
        self.link.mav.command_long_send(1, component, REQUEST, 0, msgid, 0, 0, 0, 0, 0, 0)
        return self.get(name, component)


@pytest.fixture(scope="module")
def aboard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Aboard]:
    with Aboard(tmp_path_factory.mktemp("photos")) as one:
        yield one


@pytest.fixture
def station(aboard: Aboard) -> Iterator[Station]:
    one = Station(aboard.port)
    one.get("HEARTBEAT", AUTOPILOT)
    yield one
    one.link.close()


def by_name(station: Station) -> dict[str, int]:
    """The components of cameras by what they call themselves: who came first has the first id."""
    found = {}
    for component in (CAMERA, STREAM_ONLY):
        beat = station.get("HEARTBEAT", component)
        assert (beat.type, beat.autopilot) == (30, 8)
        told = station.ask(component, "CAMERA_INFORMATION", 259)
        found[bytes(told.model_name).rstrip(b"\0").decode()] = component
    return found


def test_each_camera_is_found_with_what_it_can(station: Station) -> None:
    components = by_name(station)
    assert sorted(components) == ["ahead", "down"]
    down = station.ask(components["down"], "CAMERA_INFORMATION", 259)
    assert bytes(down.vendor_name).startswith(b"zmav")
    assert down.flags == 2 | 64
    assert (down.resolution_h, down.resolution_v) == (640, 480)
    ahead = components["ahead"]
    assert station.ask(ahead, "CAMERA_INFORMATION", 259).flags == 256
    stream = station.ask(ahead, "VIDEO_STREAM_INFORMATION", 269)
    assert (stream.uri, stream.type, stream.flags, stream.count) == (URI, 0, 1, 1)
    assert station.ask(ahead, "VIDEO_STREAM_STATUS", 270).flags == 1
    assert station.command(components["down"], REQUEST, 269) == UNSUPPORTED
    storage = station.ask(components["down"], "STORAGE_INFORMATION", 261)
    assert storage.status == 2 and 0 < storage.available_capacity < storage.total_capacity
    assert station.ask(ahead, "STORAGE_INFORMATION", 261).status == 3
    station.link.mav.command_long_send(1, ahead, 521, 0, 1, 0, 0, 0, 0, 0, 0)  # as older stations ask
    assert station.get("CAMERA_INFORMATION", ahead).flags == 256


def test_photos_are_taken_and_told_of(aboard: Aboard, station: Station) -> None:
    down = by_name(station)["down"]
    before = aboard.photos.taken
    assert station.command(down, 2000, 0, 0, 1, 0) == ACCEPTED
    captured = station.captured[-1] if station.captured else station.get("CAMERA_IMAGE_CAPTURED", down)
    assert (captured.image_index, captured.capture_result) == (before + 1, 1)
    assert captured.lat == pytest.approx(-353632621, abs=2000)
    assert Path(captured.file_url).is_file()
    again = station.ask(down, "CAMERA_IMAGE_CAPTURED", 263)
    assert (again.image_index, again.time_utc) == (captured.image_index, captured.time_utc)
    for confirmation in (0, 1, 2):  # asked again before it is acknowledged: one photo
        station.link.mav.command_long_send(1, down, 2000, confirmation, 0, 0, 1, 0, 0, 0, 0)
    assert station.get("COMMAND_ACK", down, lambda ack: ack.command == 2000).result == ACCEPTED
    assert station.command(down, 531, 2, 1e30) == ACCEPTED, "as far as it goes"
    assert station.ask(down, "CAMERA_CAPTURE_STATUS", 262).image_count == before + 2
    assert station.command(down, 2000, 0, 0.3, 0, 0) == ACCEPTED
    series = station.ask(down, "CAMERA_CAPTURE_STATUS", 262)
    assert series.image_status == 3
    assert series.image_interval == pytest.approx(0.3)
    for _ in range(2):
        station.get("CAMERA_IMAGE_CAPTURED", down)
    assert station.command(down, 2001) == ACCEPTED
    assert station.ask(down, "CAMERA_CAPTURE_STATUS", 262).image_status == 0


def test_zoom_and_what_it_cannot(aboard: Aboard, station: Station) -> None:
    components = by_name(station)
    down, ahead = components["down"], components["ahead"]
    assert station.command(down, 531, 2, 100.0) == ACCEPTED
    assert aboard.camera.zoom == 8.0
    assert station.ask(down, "CAMERA_SETTINGS", 260).zoomLevel == pytest.approx(100.0)
    assert station.command(down, 531, 0, -1) == ACCEPTED
    assert aboard.camera.zoom == pytest.approx(6.4)
    assert station.command(down, 531, 1, 1) == UNSUPPORTED
    assert station.command(down, 2500) == UNSUPPORTED
    assert station.command(ahead, 2000, 0, 0, 1) == UNSUPPORTED
    assert station.command(down, 400, 1) == UNSUPPORTED, "what is for a camera does not reach the autopilot"
    assert aboard.quad.state.armed is False
    for _ in range(2):
        station.get("HEARTBEAT", down)
    assert "it records no video here" in "".join(station.texts)


def test_the_gimbal_is_moved_and_its_control_shown(aboard: Aboard, station: Station) -> None:
    told = station.ask(AUTOPILOT, "GIMBAL_MANAGER_INFORMATION", 280)
    assert told.gimbal_device_id == 1
    assert station.command(AUTOPILOT, 1001, 255, 190, -1, -1) == ACCEPTED
    assert station.command(AUTOPILOT, 1000, -20.0, 10.0, NAN, NAN, 12) == ACCEPTED
    assert aboard.gimbal.angles == pytest.approx((math.radians(-20.0), math.radians(10.0)), abs=1e-3)
    status = station.ask(AUTOPILOT, "GIMBAL_MANAGER_STATUS", 281)
    assert (status.primary_control_sysid, status.primary_control_compid) == (255, 190)
    order = asyncio.run_coroutine_threadsafe(
        aboard.quad.order("gimbal_turn", zmav.wire.TurnGimbal(pitch=0.0)), aboard.loop
    )
    with pytest.raises(zmav.errors.Refused, match="controlled by 255/190"):
        order.result(PATIENCE_S)
    assert station.command(AUTOPILOT, 1001, -3, -3, -1, -1) == ACCEPTED


def test_photos_and_zoom_from_the_shell(aboard: Aboard) -> None:
    do = Here("-e", aboard.endpoint)
    before = aboard.photos.taken
    (line,) = do("camera", "photo", "quad1", "--json").lines
    assert (line["vehicle"], line["number"]) == ("quad1", before + 1)
    assert Path(line["file"]).is_file()
    assert do("camera", "zoom", "quad1", "2").out == "quad1/down: factor 2.0\n"
    assert aboard.camera.zoom == 2.0
    assert do("camera", "photo", "quad1", "--every", "5").out.startswith("quad1/down: every 5.0")
    assert do("camera", "photo", "quad1", "--stop").code == 0
    told = do.fails("camera", "zoom", "quad1", "2", "--name", "nosuch")
    assert (told.code, "no 'zmav camera run' of that camera answers" in told.out) == (1, True)
    assert zmav_here("camera", "photo", "quad1", "--count", "3").code == 2


def test_a_camera_whose_program_ended_is_no_more(aboard: Aboard, station: Station) -> None:
    down = by_name(station)["down"]
    cameras = aboard.onboard.cameras
    status = zmav.wire.AgentStatus(t=0.0, agent="photos-extra", state="ready", text="", detail={"width": 10})
    key = zmav.keys.AGENT_STATUS.key("demo", "quad1", agent="photos-extra")
    aboard.z.put(zmav.keys.AGENT_STATUS, key, status)
    extra = station.get("HEARTBEAT", 102)
    assert extra.type == 30
    deadline = time.monotonic() + PATIENCE_S
    while "extra" in cameras.cameras and time.monotonic() < deadline:
        time.sleep(0.1)
    assert set(cameras.cameras) == {"ahead", "down"}
    assert cameras.cameras["down"].component == down
