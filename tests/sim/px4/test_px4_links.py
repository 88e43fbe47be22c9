"""PX4's UDP links: which ports, who is answered, and a plain pymavlink script that flies by them."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.ports import free_udp_ports
from zmav.errors import BadUrl, PortInUse
from zmav.mavlink.codec import Packer
from zmav.sim import VehicleSpec, World
from zmav.sim.endpoints import Address, expand, parse_endpoint
from zmav.sim.protocol.px4.node import px4_dialect

mavutil = pytest.importorskip("pymavlink.mavutil")

PATIENCE_S = 30.0


class TestEndpoints:
    def test_the_ports_are_px4s(self) -> None:
        assert expand(["px4"]) == ["onboard", "ground"]
        assert parse_endpoint("onboard", 2) == Address("onboard", "127.0.0.1", 14542, 14582)
        assert parse_endpoint("onboard", 12) == Address("onboard", "127.0.0.1", 14549, 14592)
        assert parse_endpoint("ground", 12) == Address("ground", "127.0.0.1", 14550, 18582)

    def test_others_can_be_named(self) -> None:
        assert parse_endpoint("onboard:0:9000+10", 1) == Address("onboard", "127.0.0.1", 9010, 0)
        assert parse_endpoint("ground:7000+1:192.0.2.1:9000", 3) == Address("ground", "192.0.2.1", 9000, 7003)

    @pytest.mark.parametrize(
        "text", ["onboard:", "onboard:1", "onboard:a:1", "ground:1:0", "ground:65535+1:1", "px4:1"]
    )
    def test_and_wrong_ones_are_refused(self, text: str) -> None:
        with pytest.raises(BadUrl, match="onboard"):
            parse_endpoint(text, 1)

    def test_a_port_in_use_is_named(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            port = taken.getsockname()[1]
            world = World([VehicleSpec(autopilot="px4", endpoints=(f"onboard:{port}:9",))])
            try:
                with pytest.raises(PortInUse, match=str(port)):
                    world.open()
            finally:
                world.close()


@pytest.fixture
def remote() -> Iterator[socket.socket]:
    """The port that the vehicle sends to."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(PATIENCE_S)
        yield sock


class TestLatch:
    def test_it_sends_to_whoever_spoke_first(self, remote: socket.socket) -> None:
        port = remote.getsockname()[1]
        with (
            World([VehicleSpec(autopilot="px4", endpoints=(f"onboard:0:{port}",))], speed=2.0) as world,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second,
        ):
            data, vehicle = remote.recvfrom(2048)
            assert (data[0], len(data)) == (0xFD, 12 + data[1])  # one frame a datagram
            packer = Packer(px4_dialect(), 240, 191)
            for sock in (first, second):
                sock.settimeout(PATIENCE_S)
                sock.sendto(packer.pack("HEARTBEAT", type=18), vehicle)
            assert first.recvfrom(2048)[1] == vehicle
            # Everybody is obeyed, but only the first is answered.
            params = {"target_system": 1, "target_component": 1, "param1": 1.0}
            world.wait_for(lambda: world.vehicles[0].px4.checks_ok)
            second.sendto(packer.pack("COMMAND_LONG", command=400, **params), vehicle)
            world.wait_for(lambda: world.vehicles[0].px4.armed)
            second.setblocking(False)
            with pytest.raises(BlockingIOError):
                second.recv(2048)


class Script:
    """The lines that such a script has."""

    def __init__(self, url: str) -> None:
        self.link = mavutil.mavlink_connection(url, source_system=240, source_component=191)
        self.link.wait_heartbeat(timeout=PATIENCE_S)

    def next(self, kind: str, true: Any = lambda m: True) -> Any:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            message = self.link.recv_match(type=kind, blocking=True, timeout=PATIENCE_S)
            if message is not None and true(message):
                return message
        raise AssertionError(f"no such {kind}")

    def command(self, number: int, *params: float, acks: int = 1) -> int:
        self.link.mav.command_long_send(1, 1, number, 0, *params, *[0.0] * (7 - len(params)))
        return [int(self.next("COMMAND_ACK", lambda m: m.command == number).result) for _ in range(acks)][-1]

    def until_mode(self, main: int, sub: int = 0) -> None:
        self.next("HEARTBEAT", lambda m: m.get_srcComponent() == 1 and m.custom_mode == main << 16 | sub << 24)

    def go(self, north: float, east: float, down: float, mask: int = 0x9F8) -> None:
        self.link.mav.set_position_target_local_ned_send(0, 1, 1, 1, mask, north, east, down, 0, 0, 0, 0, 0, 0, 0, 0)

    def fly_to(self, north: float, east: float, down: float) -> None:
        while True:
            self.go(north, east, down)
            at = self.next("LOCAL_POSITION_NED")
            if max(abs(at.x - north), abs(at.y - east), abs(at.z - down)) < 0.5:
                return


def test_a_plain_script_flies_it_as_it_flies_the_real_one() -> None:
    port = free_udp_ports(1)
    spec = VehicleSpec(autopilot="px4", endpoints=(f"onboard:0:{port}",))
    with World([spec], speed=5.0) as world:
        script = Script(f"udpin:127.0.0.1:{port}")
        script.next("SYS_STATUS", lambda m: m.onboard_control_sensors_health & 0x10000000)
        assert script.command(176, 1, 4, 3, acks=2) == 0
        assert script.command(400, 1) == 0
        assert script.command(176, 1, 4, 2, acks=2) == 0
        script.until_mode(4, 2)
        script.until_mode(4, 3)
        start = script.next("LOCAL_POSITION_NED").time_boot_ms
        while script.next("LOCAL_POSITION_NED").time_boot_ms < start + 1500:
            script.go(0.0, 0.0, -5.0)
        assert script.command(176, 1, 6, 0, acks=2) == 0
        script.fly_to(0.0, 0.0, -5.0)
        script.fly_to(4.0, 2.0, -5.0)
        assert script.command(176, 1, 4, 6, acks=2) == 0
        script.next("HEARTBEAT", lambda m: m.get_srcComponent() == 1 and not m.base_mode & 128)
        assert not world.vehicles[0].px4.armed
        script.link.close()
