"""Endpoints: how they are written, the ports of real stacks, and serial lines; with pymavlink at the other end."""

from __future__ import annotations

import os
import resource
import select
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink import mavutil

from zmav.errors import BadUrl, PortInUse
from zmav.mavlink import load_dialect
from zmav.mavlink.codec import Packer
from zmav.mavlink.frames import Frame, Splitter
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.sim.endpoints import Address, addresses, parse_endpoint

if TYPE_CHECKING:
    from tests.sim.conftest import MakeGcs

PATIENCE_S = 30.0
LOOPBACK = "127.0.0.1"


def ports(vehicles: list[list[str]]) -> list[list[tuple[str, int]]]:
    return [[(a.kind, a.port) for a in each] for each in addresses(vehicles)]


class TestSpelling:
    def test_the_stacks_own_ports_count_within_the_stack(self) -> None:
        assert ports([["ardupilot"], ["px4"], ["tcp"], ["px4"]]) == [
            [("serial0", 5760), ("serial1", 5762), ("serial2", 5763)],
            [("onboard", 14540), ("ground", 14550)],
            [("tcp", 5770)],
            [("onboard", 14541), ("ground", 14550)],
        ]
        assert [a.local for a in addresses([["tcp"], ["px4"]])[1]] == [14580, 18570]

    def test_others_count_within_the_world(self) -> None:
        assert ports([["ardupilot"], ["tcp:7000+"], ["px4"], ["udp:127.0.0.1:9000+10"]])[1:] == [
            [("tcp", 7001)],
            [("onboard", 14540), ("ground", 14550)],
            [("udp", 9030)],
        ]

    @pytest.mark.parametrize(
        ("text", "index", "address"),
        [
            ("serial1:7000+10", 2, Address("serial1", LOOPBACK, 7020)),
            ("udp-listen:0.0.0.0:14600+", 2, Address("udp-listen", "0.0.0.0", 14602)),
            ("udp-listen:0", 2, Address("udp-listen", LOOPBACK, 0)),
            ("pty", 2, Address("pty", "", 0)),
            ("pty:/tmp/quad", 2, Address("pty", "", 0, path="/tmp/quad")),
            ("pty:/tmp/quad1+", 2, Address("pty", "", 0, path="/tmp/quad3")),
            ("pty:/tmp/quad+10", 2, Address("pty", "", 0, path="/tmp/quad21")),
        ],
    )
    def test_written_so(self, text: str, index: int, address: Address) -> None:
        assert parse_endpoint(text, index) == address

    @pytest.mark.parametrize(
        "text",
        ["pty:", "pty@57600", "ptyx", "serial3", "udp-listen", "udp-listen:x", "tcp:٣", "px4:1"],
    )
    def test_others_are_refused(self, text: str) -> None:
        with pytest.raises(BadUrl, match="expected ardupilot, tcp") as caught:
            parse_endpoint(text, 0)
        assert caught.value.detail["value"] == text


@pytest.fixture
def running() -> Iterator[Any]:
    """Starts worlds of one vehicle that run ten times as fast as life, and ends them."""
    worlds = []

    def run(*endpoints: str, **options: Any) -> SimVehicle:
        spec = VehicleSpec(endpoints=endpoints, params=options.pop("params", {}))
        worlds.append(World([spec], speed=options.pop("speed", 10.0), ready_s=0.5, **options))
        worlds[-1].start()
        return worlds[-1].vehicles[0]

    yield run
    for world in worlds:
        world.close()


def heartbeat(link: Any) -> int:
    """The system id of the next heartbeat."""
    found = link.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENCE_S)
    assert found is not None
    return int(found.get_srcSystem())


def names_in(link: Any, seconds: float = 2.0) -> set[str]:
    """The messages of so many simulated seconds, told by heartbeats."""
    names: set[str] = set()
    left = seconds + 1
    while left > 0:
        message = link.recv_match(blocking=True, timeout=PATIENCE_S)
        assert message is not None
        names.add(message.get_type())
        left -= message.get_type() == "HEARTBEAT"
    return names


def test_each_serial_port_has_its_own_rates(running: Any) -> None:
    vehicle = running("tcp:0", "serial1:0", "serial2:0", params={"MAV1_EXTRA1": 4, "MAV2_EXTRA2": 4})
    links = [mavutil.mavlink_connection(url, source_system=255) for url in vehicle.urls]
    heard = [names_in(link) for link in links]
    assert [("ATTITUDE" in names, "VFR_HUD" in names) for names in heard] == [
        (True, False),
        (False, True),
        (False, False),
    ]
    for link in links:
        link.close()


def test_a_listener_answers_who_spoke_last(running: Any) -> None:
    vehicle = running("udp-listen:0")
    port = vehicle.url.rpartition(":")[2]
    assert vehicle.url == f"udpout:{LOOPBACK}:{port}"
    assert vehicle.endpoints[0].clients() == 0
    first = mavutil.mavlink_connection(vehicle.url, source_system=255)
    first.mav.heartbeat_send(6, 8, 0, 0, 0)
    assert heartbeat(first) == 1
    assert vehicle.endpoints[0].clients() == 1
    second = mavutil.mavlink_connection(vehicle.url, source_system=254)
    second.mav.heartbeat_send(6, 8, 0, 0, 0)
    assert heartbeat(second) == 1
    first.close()
    second.close()


class TestSerialLine:
    def test_it_outlives_its_clients(self, running: Any, tmp_path: Path) -> None:
        path = tmp_path / "quad1"
        vehicle = running(f"pty:{path}")
        assert vehicle.url == f"{path},115200"
        stamps = []
        for _ in range(3):
            link = mavutil.mavlink_connection(str(path), baud=57600, source_system=255)
            assert heartbeat(link) == 1
            link.mav.command_long_send(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)
            ack = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=PATIENCE_S)
            assert (ack.command, ack.result) == (512, 0)
            assert link.recv_match(type="AUTOPILOT_VERSION", blocking=True, timeout=PATIENCE_S)
            link.mav.timesync_send(0, 1)
            stamps.append(link.recv_match(type="TIMESYNC", blocking=True, timeout=PATIENCE_S).tc1)
            assert link.mav.total_receive_errors == 0
            link.close()
        assert stamps == sorted(set(stamps))

    def test_what_was_said_while_nobody_listened_is_lost(self, make_gcs: MakeGcs) -> None:
        """Nor does the next client read what the last one left."""
        gcs = make_gcs([VehicleSpec(endpoints=("pty",))])
        world, vehicle = gcs.world, gcs.vehicle
        world.open()
        device = vehicle.url.partition(",")[0]
        world.step(3.0)
        for _ in range(2):
            client = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            with pytest.raises(BlockingIOError):
                os.read(client, 10)
            assert not vehicle.endpoints[0].clients()
            serve(world, 1.5)
            assert vehicle.endpoints[0].clients() == 1
            frames = Splitter(gcs.dialect).feed(read_soon(client))
            assert [frame.msgid for frame in frames].count(0) in (1, 2)
            serve(world, 5.0)
            os.close(client)
            serve(world, 5.0)

    def test_it_waits_for_a_descriptor_where_none_is_left(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs([VehicleSpec(endpoints=("pty",))])
        gcs.world.open()
        client = os.open(gcs.vehicle.url.partition(",")[0], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        os.close(lowest := os.dup(client))
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, hard))
        try:
            serve(gcs.world, 1.0)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert gcs.vehicle.endpoints[0].clients() == 0
        serve(gcs.world, 1.0)
        assert gcs.vehicle.endpoints[0].clients() == 1
        os.close(client)

    def test_one_that_never_reads_holds_nobody_up(self, running: Any) -> None:
        vehicle = running("pty", "tcp:0", params={"MAV1_EXTRA1": 50, "MAV1_RAW_SENS": 50, "MAV1_POSITION": 50})
        deaf = os.open(vehicle.url.partition(",")[0], os.O_RDWR | os.O_NOCTTY)
        link = mavutil.mavlink_connection(vehicle.urls[1], source_system=255)
        while not vehicle.node.channels[0].dropped:
            assert heartbeat(link) == 1
        for _ in range(10):
            assert heartbeat(link) == 1
        os.close(deaf)
        link.close()

    def test_the_link_goes_with_the_world(self, running: Any, tmp_path: Path) -> None:
        path = tmp_path / "quad1"
        with World(copters=2, endpoint=f"pty:{path}+", ready_s=0.5) as world:
            assert world.urls == [f"{tmp_path}/quad1,115200", f"{tmp_path}/quad2,115200"]
            with pytest.raises(PortInUse, match="leads to /dev/pts/"), World(endpoint=f"pty:{path}"):
                pytest.fail("two on one path")
            assert path.exists()
        assert list(tmp_path.iterdir()) == []

    def test_a_link_that_leads_nowhere_is_replaced(self, tmp_path: Path) -> None:
        path = tmp_path / "quad1"
        path.symlink_to("/dev/pts/999999")
        with World(endpoint=f"pty:{path}", ready_s=0.5):
            assert path.exists()

    def test_a_link_of_a_killed_simulator_to_a_number_given_out_again_is_replaced(self, tmp_path: Path) -> None:
        path = tmp_path / "quad1"
        with World(endpoint="pty", ready_s=0.5) as world:
            path.symlink_to(world.urls[0].partition(",")[0])
        with World(endpoint=f"pty:{path}", ready_s=0.5) as world:  # has the number that has just become free
            assert world.urls == [f"{path},115200"]

    def test_who_opens_it_in_a_pause_is_answered(self) -> None:
        with World(endpoint="pty", ready_s=0.5) as world:
            world.pause()
            client = os.open(world.urls[0].partition(",")[0], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            packer = Packer(load_dialect(), 255, 190)
            os.write(client, packer.pack("PING", seq=7, target_system=0, target_component=0))
            frames = Splitter(load_dialect()).feed(read_soon(client))
            assert [load_dialect().name_of(frame.msgid) for frame in frames] == ["PING"]
            os.close(client)

    def test_what_is_no_link_is_left_alone(self, tmp_path: Path) -> None:
        path = tmp_path / "notes"
        path.write_text("mine")
        with pytest.raises(BadUrl, match="is no link to a terminal"), World(endpoint=f"pty:{path}"):
            pytest.fail("over a file")
        assert path.read_text() == "mine"
        with pytest.raises(BadUrl, match="directory"), World(endpoint=f"pty:{tmp_path}/none/quad1"):
            pytest.fail("in no directory")


def read_soon(client: int) -> bytes:
    """What a terminal holds; the kernel may hand it over a moment after it was written."""
    select.select([client], [], [], PATIENCE_S)
    return os.read(client, 65536)


def serve(world: World, seconds: float) -> None:
    """Step a world that no thread runs, and serve its endpoints meanwhile."""
    for _ in range(max(round(seconds / 0.05), 1)):
        world.step(0.05)
        world.serve()


@pytest.mark.parametrize("endpoint", ["udp:a..b:14550", "tcp:a..b:0", "onboard:0:a..b:14540", "tcp:256.1.1.1:0"])
def test_a_host_that_cannot_be_is_said(endpoint: str) -> None:
    world = World(endpoint=endpoint)
    with pytest.raises(BadUrl, match=r"a\.\.b|256"):
        world.open()
    assert world.vehicles[0].endpoints == []
    world.close()


def test_a_clash_in_the_middle_closes_all() -> None:
    with socket.create_server((LOOPBACK, 0)) as taken:
        port = taken.getsockname()[1]
        specs = [VehicleSpec(endpoints=("tcp:0", "udp-listen:0", "pty")) for _ in range(3)]
        specs.append(VehicleSpec(endpoints=("pty", f"tcp:{port}")))
        world = World(specs, ready_s=0.5)
        descriptors = len(list(Path("/proc/self/fd").iterdir()))
        with pytest.raises(PortInUse, match=f"tcp:{LOOPBACK}:{port} is in use"):
            world.open()
        assert len(list(Path("/proc/self/fd").iterdir())) == descriptors
        assert [v.endpoints for v in world.vehicles] == [[]] * 4
        assert [v.node.channels for v in world.vehicles] == [[]] * 4
        world.close()


def test_two_hundred_and_fifty_vehicles_are_served() -> None:
    dialect = load_dialect()
    with World(copters=250, endpoint="tcp:0", ready_s=0.5) as world:
        links = [socket.create_connection((LOOPBACK, int(url.rpartition(":")[2])), PATIENCE_S) for url in world.urls]
        heard = []
        for link in links:
            splitter, frames = Splitter(dialect), list[Frame]()
            while not frames:
                frames = splitter.feed(link.recv(4096))
            heard.append(frames[0].sysid)
            link.close()
        assert heard == list(range(1, 251))
        assert threading.active_count() < 20
