"""The world: determinism, the clock, endpoints and their clients, and what it is made of."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from zmav.errors import BadConfig, BadInput, BadUrl, PortInUse, TimedOut
from zmav.mavlink import load_dialect
from zmav.mavlink.codec import Packer, decode
from zmav.mavlink.frames import Frame, Splitter
from zmav.sim import Home, SimVehicle, VehicleSpec, World
from zmav.sim.endpoints import Address, parse_endpoint

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

PATIENCE_S = 30.0


class Client:
    """A TCP client of one vehicle."""

    def __init__(self, url: str) -> None:
        _, host, port = url.split(":")
        self.dialect = load_dialect("ardupilotmega")
        self.socket = socket.create_connection((host, int(port)), timeout=PATIENCE_S)
        self.splitter = Splitter(self.dialect)
        self.packer = Packer(self.dialect, 255, 190)
        self._frames: list[Frame] = []

    def send(self, name: str, **fields: object) -> None:
        self.socket.sendall(self.packer.pack(name, **fields))

    def next(self, name: str) -> dict[str, object]:
        """The next such message; everything before it is dropped."""
        while True:
            while self._frames:
                frame = self._frames.pop(0)
                if self.dialect.name_of(frame.msgid) == name:
                    return decode(frame, self.dialect)
            data = self.socket.recv(65536)
            assert data, "the connection ended"
            self._frames += self.splitter.feed(data)

    def command(self, number: int, *params: float) -> object:
        fields = {f"param{i}": p for i, p in enumerate(params, start=1)}
        self.send("COMMAND_LONG", target_system=0, target_component=1, command=number, **fields)
        return self.next("COMMAND_ACK")["result"]

    def close(self) -> None:
        self.socket.close()


def state(world: World) -> np.ndarray:
    return np.array(
        [[*v.copter.sense, v.copter.mode.number, v.copter.armed, v.copter.consumed_mah] for v in world.vehicles]
    )


class TestDeterminism:
    def script(self, make_gcs: MakeGcs, seed: int) -> np.ndarray:
        gcs = make_gcs(2, seed=seed, noise="typical", wind=(2.0, 1.0, 0.0))
        gcs.take_off(3.0)
        gcs.goto(5.0, 3.0, -4.0)
        gcs.world.step(3.0)
        return state(gcs.world)

    def test_two_worlds_of_one_seed_are_identical_and_of_another_are_not(self, make_gcs: MakeGcs) -> None:
        one, same, other = (self.script(make_gcs, seed) for seed in (1, 1, 2))
        assert (one == same).all()
        assert (one != other).any()

    def test_even_their_words_are_the_same(self, make_gcs: MakeGcs) -> None:
        def words() -> list[bytes]:
            gcs = make_gcs()
            assert gcs.command(511, 30, 5e4) == 0
            assert gcs.command(511, 24, 2e5) == 0
            gcs.world.step(2.0)
            return [frame.data for frame in gcs.frames]

        assert words() == words()


def test_vehicles_stand_in_a_row_unless_told_otherwise(make_gcs: MakeGcs) -> None:
    specs = [VehicleSpec(), VehicleSpec(start_ned_m=(5.0, -3.0, 0.0), yaw_deg=90.0), VehicleSpec(name="tail")]
    world = make_gcs(specs, spacing_m=7.0, home=Home(yaw_deg=-10.0)).world
    world.step(0.1)
    found = [v.status() for v in world.vehicles]
    assert [s.ned_m for s in found] == [(0.0, 0.0, 0.0), (5.0, -3.0, 0.0), (0.0, 14.0, 0.0)]
    assert [s.heading_deg for s in found] == pytest.approx([350.0, 90.0, 350.0])
    assert [s.name for s in found] == ["quad1", "quad2", "tail"]
    assert [s.sysid for s in found] == [1, 2, 3]


def test_each_reports_its_own_place(make_gcs: MakeGcs, another_gcs: type[Gcs]) -> None:
    first = make_gcs(2, home=Home(lat_deg=47.0, lon_deg=8.0, alt_amsl_m=400.0))
    second = another_gcs(first.world, first.world.vehicles[1])
    first.world.step(1.0)
    east = second.last("GLOBAL_POSITION_INT")["lon"] - first.last("GLOBAL_POSITION_INT")["lon"]
    assert east == pytest.approx(10.0 / (111318.845 * np.cos(np.radians(47.0))) * 1e7, abs=2)
    assert first.last("GLOBAL_POSITION_INT")["alt"] == 400_000
    assert second.last("LOCAL_POSITION_NED")["y"] == 0.0  # about its own origin


def test_two_airframes_fly_side_by_side(make_gcs: MakeGcs, another_gcs: type[Gcs]) -> None:
    first = make_gcs([VehicleSpec(airframe="hexa"), VehicleSpec()])
    second = another_gcs(first.world, first.world.vehicles[1])
    assert first.last("HEARTBEAT")["type"] == 13
    assert second.last("HEARTBEAT")["type"] == 2
    first.take_off(3.0)
    assert second.ned == (0.0, 0.0, 0.0)
    outputs = first.last("SERVO_OUTPUT_RAW")
    assert min(outputs[f"servo{i}_raw"] for i in range(1, 7)) > 1100
    assert outputs["servo7_raw"] == 0


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"copters": -1}, "copters"),
        ({"copters": 256}, "vehicles"),
        ({"speed": 0.0}, "speed"),
        ({"speed": float("nan")}, "speed"),
        ({"speed": 1e-9}, "speed"),
        ({"seed": -1}, "seed"),
        ({"epoch_s": float("nan")}, "epoch_s"),
        ({"home": Home(lat_deg=float("nan"))}, "lat_deg"),
        ({"home": Home(yaw_deg=float("inf"))}, "yaw_deg"),
        ({"vehicles": [VehicleSpec(params={"FS_GCS_ENABLE": float("nan")})]}, "params.FS_GCS_ENABLE"),
        ({"endpoint": "pty:/tmp/\0"}, "endpoint"),
        ({"vehicles": [VehicleSpec(sysid=0)]}, "sysid"),
        ({"vehicles": [VehicleSpec(sysid=256)]}, "sysid"),
        ({"spacing_m": float("nan")}, "spacing_m"),
        ({"ready_s": -1.0}, "ready_s"),
        ({"wind": (float("inf"), 0.0, 0.0)}, "wind"),
        ({"vehicles": [VehicleSpec(uid=0)]}, "uid"),
        ({"vehicles": [VehicleSpec(uid=1 << 64)]}, "uid"),
        ({"vehicles": [VehicleSpec(start_ned_m=(0.0, float("inf"), 0.0))]}, "start_ned_m"),
        ({"vehicles": [VehicleSpec(yaw_deg=float("nan"))]}, "yaw_deg"),
        ({"vehicles": [VehicleSpec(airframe="zeppelin")]}, "airframe"),
        ({"endpoint": "serial:/dev/null"}, "endpoint"),
    ],
)
def test_bad_options_are_named(options: dict[str, object], field: str) -> None:
    with pytest.raises(BadInput) as caught:
        World(**options)  # type: ignore[arg-type]
    assert isinstance(caught.value, BadConfig | BadUrl)
    assert caught.value.detail["field"] == field


@pytest.mark.parametrize(
    ("text", "index", "address"),
    [
        ("tcp", 2, Address("tcp", "127.0.0.1", 5780)),
        ("tcp:0", 2, Address("tcp", "127.0.0.1", 0)),
        ("tcp:7000", 2, Address("tcp", "127.0.0.1", 7000)),
        ("tcp:0.0.0.0:7000+5", 2, Address("tcp", "0.0.0.0", 7010)),
        ("udp:127.0.0.1:14550", 2, Address("udp", "127.0.0.1", 14550)),
        ("udp:127.0.0.1:14540+", 2, Address("udp", "127.0.0.1", 14542)),
    ],
)
def test_endpoints_are_spelled_so(text: str, index: int, address: Address) -> None:
    assert parse_endpoint(text, index) == address


@pytest.mark.parametrize(
    "text",
    ["", "udp", "udp:14550", "udp:host:", "tcp:host", "tcp:1:2:x", "udp:h:0", "tcp:70000", "tcp:65535+1", "tcp:1+x"],
)
def test_others_are_refused(text: str) -> None:
    with pytest.raises(BadUrl, match="expected"):
        parse_endpoint(text, 1)


def test_a_port_in_use_is_said_and_leaves_nothing_open() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        world = World([VehicleSpec(endpoints=("tcp:0",)), VehicleSpec(endpoints=(f"tcp:{port}",))])
        with pytest.raises(PortInUse, match=str(port)), world:
            pytest.fail("it has started")
        assert world.vehicles[0].endpoints == []


def test_a_vehicle_without_an_endpoint_says_so(make_gcs: MakeGcs) -> None:
    with pytest.raises(BadInput, match="no open endpoint"):
        _ = make_gcs().vehicle.url


@pytest.fixture
def vehicle() -> Iterator[SimVehicle]:
    """One vehicle of a running world, on a free TCP port and ten times as fast as life."""
    with World(copters=1, endpoint="tcp:0", speed=10.0, ready_s=0.5) as world:
        yield world.vehicles[0]


class TestClients:
    def test_two_at_once_have_their_own_links(self, vehicle: SimVehicle) -> None:
        first, second = Client(vehicle.url), Client(vehicle.url)
        assert first.command(511, 30, 1e5) == 0
        assert first.next("ATTITUDE")
        assert second.command(511, 33, 1e5) == 0
        assert second.next("GLOBAL_POSITION_INT")
        for _ in range(3):
            first.next("HEARTBEAT")
            second.next("HEARTBEAT")
        assert first.splitter.counters.lost == second.splitter.counters.lost == 0
        names = {first.dialect.name_of(f.msgid) for f in second._frames}
        assert "ATTITUDE" not in names
        first.close()
        second.close()

    def test_one_that_vanishes_leaves_the_others_alone(self, vehicle: SimVehicle) -> None:
        stays = Client(vehicle.url)
        for _ in range(20):
            goes = Client(vehicle.url)
            goes.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
            # Reset, rather than a polite farewell.
            goes.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            goes.close()
        assert stays.command(511, 30, 1e5) == 0
        assert stays.next("ATTITUDE")
        stays.next("HEARTBEAT")
        stays.next("HEARTBEAT")
        assert vehicle.endpoints[0].clients() == 1
        assert len(vehicle.node.channels) == 1
        stays.close()

    def test_one_that_never_reads_holds_nobody_up(self, vehicle: SimVehicle) -> None:
        deaf, well = Client(vehicle.url), Client(vehicle.url)
        deaf.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for msgid in (30, 31, 32, 33, 24, 1, 36, 65):
            deaf.send("COMMAND_LONG", target_system=1, target_component=1, command=511, param1=msgid, param2=1e4)
        for _ in range(200):
            deaf.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
        assert well.command(511, 30, 1e5) == 0
        stamps = [well.next("ATTITUDE")["time_boot_ms"] for _ in range(60)]
        gaps = np.diff(np.array(stamps, dtype=float))
        assert gaps.max() <= 110.0
        deaf.close()
        well.close()

    def test_one_that_sends_garbage_is_not_held_against_the_rest(self, vehicle: SimVehicle) -> None:
        rude, polite = Client(vehicle.url), Client(vehicle.url)
        noise = np.random.default_rng(5).integers(0, 256, 200_000, dtype=np.uint8).tobytes()
        sender = threading.Thread(target=rude.socket.sendall, args=(noise,))
        sender.start()
        assert polite.command(511, 30, 1e5) == 0
        assert polite.next("ATTITUDE")
        sender.join(PATIENCE_S)
        assert not sender.is_alive()
        assert rude.command(511, 30, 1e5) == 0
        rude.close()
        polite.close()


def test_udp_goes_out_from_one_kept_port_and_answers_come_in() -> None:
    dialect = load_dialect("ardupilotmega")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(PATIENCE_S)
        port = ground.getsockname()[1]
        with World(copters=2, endpoint=f"udp:127.0.0.1:{port}", speed=10.0, ready_s=0.5) as world:
            assert world.urls == [f"udpin:127.0.0.1:{port}"] * 2
            senders: dict[int, tuple[str, int]] = {}
            packer = Packer(dialect, 255, 190)
            splitters = {1: Splitter(dialect), 2: Splitter(dialect)}
            acks = 0
            for count in range(400):
                datagram, sender = ground.recvfrom(2048)
                sysid = datagram[5]
                frames = splitters[sysid].feed(datagram)
                assert len(frames) == 1  # one frame a datagram
                assert senders.setdefault(sysid, sender) == sender
                acks += dialect.name_of(frames[0].msgid) == "COMMAND_ACK"
                if count in (5, 6, 7, 8):
                    target = 1 + count % 2
                    if target in senders:
                        data = packer.pack(
                            "COMMAND_LONG", target_system=target, target_component=1, command=511, param1=30, param2=2e4
                        )
                        ground.sendto(data, senders[target])
            assert len(senders) == 2
            assert acks >= 2
            assert [s.counters.lost for s in splitters.values()] == [0, 0]


def test_udp_to_nobody_is_endured() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with World(copters=1, endpoint=f"udp:127.0.0.1:{port}", speed=20.0, ready_s=0.5) as world:
        world.wait_for(lambda: world.time_s > 5.0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
            ground.bind(("127.0.0.1", port))
            ground.settimeout(PATIENCE_S)
            assert ground.recv(2048)[0] == 0xFD


class TestClock:
    def test_as_fast_as_it_goes_until_closed(self) -> None:
        with World(copters=1, endpoint="tcp:0", speed=float("inf")) as world:
            world.wait_for(lambda: world.time_s > 30.0)
        ended = world.time_s
        assert ended > 30.0
        world.step(1.0)
        assert world.time_s == pytest.approx(ended + 1.0)

    def test_calls_run_between_ticks_in_the_worlds_thread(self) -> None:
        with World(copters=1, endpoint="tcp:0") as world:
            assert world.call(lambda: threading.current_thread().name) == "zmav-sim"
            with pytest.raises(ZeroDivisionError):
                world.call(lambda: 1 // 0)
            assert world.call(lambda: 2) == 2  # it has taken no harm

    def test_waiting_has_an_end(self) -> None:
        with World(copters=1, endpoint="tcp:0", speed=50.0) as world, pytest.raises(TimedOut, match="simulated time"):
            world.wait_for(lambda: False, sim_s=1.0)

    def test_run_serves_in_the_callers_thread_until_stopped(self) -> None:
        world = World(copters=1, endpoint="tcp:0", speed=10.0)
        threading.Timer(0.3, world.stop).start()
        world.run()
        assert world.ticks > 0
        world.close()

    def test_an_error_in_the_world_comes_out_at_the_end(self) -> None:
        world = World(copters=1, endpoint="tcp:0", speed=10.0)

        def fail(*_: object) -> None:
            raise RuntimeError("a defect")

        world.start()
        world.vehicles[0].copter.update = fail  # type: ignore[method-assign,assignment]
        with pytest.raises(TimedOut, match="a defect"):
            world.wait_for(lambda: False)
        with pytest.raises(RuntimeError, match="a defect"):
            world.close()

    def test_closing_leaves_no_thread_and_no_socket(self) -> None:
        others = set(threading.enumerate())
        world = World(copters=2, endpoint="tcp:0")
        world.start()
        assert set(threading.enumerate()) > others
        url = world.urls[0]
        world.close()
        world.close()  # again does no harm
        assert set(threading.enumerate()) <= others
        with pytest.raises(ConnectionRefusedError):
            Client(url)


class TestPause:
    def test_clients_are_answered_and_nothing_is_caught_up_with(self) -> None:
        """A clock that stands still is told truly, and what was asked in a pause does not arrive afterwards."""
        with World(copters=1, endpoint="tcp:0", speed=20.0, ready_s=0.5) as world:
            client = Client(world.urls[0])
            assert client.command(511, 30, 1e5) == 0
            world.pause()
            stamps = []
            for question in (1, 2):
                client.send("TIMESYNC", tc1=0, ts1=question)
                stamps.append(client.next("TIMESYNC"))
            assert [s["ts1"] for s in stamps] == [1, 2]
            assert stamps[0]["tc1"] == stamps[1]["tc1"]
            assert client.command(512, 148) == 0
            before = world.time_s
            world.resume()
            times = [client.next("ATTITUDE")["time_boot_ms"] for _ in range(10)]
            assert np.diff(np.array(times, dtype=float)) == pytest.approx([100.0] * 9, abs=11.0)
            assert world.time_s > before
            client.close()

    def test_so_many_seconds_and_no_more(self) -> None:
        with World(copters=1, endpoint="tcp:0", speed=50.0) as world:
            world.pause()
            before = world.time_s
            found = world.advance(3.0).result(PATIENCE_S)
            assert found.paused
            assert world.time_s == pytest.approx(before + 3.0)
            assert [world.call(lambda: world.time_s) for _ in range(3)] == [world.time_s] * 3
            for seconds in (0.0, -1.0, float("nan"), 1e9):
                with pytest.raises(BadInput, match=r"expected 0\.01 to 1000000"):
                    world.advance(seconds)

    def test_the_end_is_told_to_who_waits(self) -> None:
        with World(copters=1, endpoint="tcp:0", speed=1.0) as world:
            waiting = world.advance(1e5)
        with pytest.raises(TimedOut, match="has ended"):
            waiting.result(PATIENCE_S)


class TestDefects:
    """A defect of the simulator is loud, and costs no more than the vehicle that has it."""

    @pytest.fixture
    def world(self) -> Iterator[World]:
        world = World(copters=2, rovers=1, endpoint="tcp:0", speed=20.0, ready_s=0.5)
        world.start()
        yield world
        world.failures.clear()
        world.close()

    def fail(self, *_: object) -> None:
        raise RuntimeError("a defect")

    def until(self, world: World, sim_s: float) -> None:
        """Wait for so many simulated seconds, no matter who has failed."""
        end = world.time_s + sim_s
        while world.call(lambda: world.time_s) < end:
            pass

    def test_of_an_autopilot(self, world: World) -> None:
        told: list[str] = []
        world.on_failure = lambda vehicle, error: told.append(f"{vehicle.name}: {error}")
        dead, well = Client(world.urls[0]), Client(world.urls[1])
        dead.next("HEARTBEAT")
        world.call(lambda: setattr(world.vehicles[0].brain, "update", self.fail))
        self.until(world, 5.0)
        for _ in range(3):
            assert well.next("HEARTBEAT")
        assert told == ["quad1: a defect"]
        assert [v.failed for v in world.status().vehicles] == ["RuntimeError('a defect')", None, None]
        with pytest.raises(TimedOut, match="quad1 has failed"):
            world.wait_for(lambda: False)
        dead.close()
        well.close()

    def test_of_the_physics_of_one_kind(self, world: World) -> None:
        squad = next(squad for squad in world._squads if len(squad.vehicles) == 2)
        client = Client(world.urls[2])
        world.call(lambda: setattr(squad.fleet, "advance", self.fail))
        self.until(world, 3.0)
        assert [bool(v.failed) for v in world.status().vehicles] == [True, True, False]
        assert client.next("HEARTBEAT")
        client.close()

    def test_in_answering_a_client(self, world: World) -> None:
        vehicle = world.vehicles[0]
        world.call(lambda: vehicle.node.answer("PING", self.fail))
        client = Client(vehicle.url)
        for _ in range(20):
            client.send("PING", seq=1, target_system=0, target_component=0)
        assert client.command(512, 148) == 0  # it goes on, and so does the link
        assert client.next("HEARTBEAT")
        assert [(v.name, str(e)) for v, e in world.failures] == [("quad1", "a defect")]  # once
        assert world.status().vehicles[0].failed is None
        client.close()

    def test_in_a_stepped_world_it_comes_out(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs(2)
        gcs.vehicle.copter.update = self.fail  # type: ignore[method-assign,assignment]
        with pytest.raises(RuntimeError, match="a defect"):
            gcs.world.step(1.0)
        assert gcs.world.time_s == pytest.approx(1.0)
        gcs.world.step(1.0)  # said once
        gcs.clear()
        gcs.send("PING", seq=1, target_system=0, target_component=0)
        assert gcs.frames == []  # a dead autopilot does not answer either


def test_the_status_tells_how_it_stands(make_gcs: MakeGcs) -> None:
    gcs = make_gcs()
    gcs.take_off(3.0)
    found = gcs.world.status()
    one = found.vehicles[0]
    assert found.time_s == gcs.world.time_s
    assert (one.mode, one.armed, one.landed, one.ready, one.links) == ("GUIDED", True, False, True, 1)
    assert one.flying
    assert one.height_m == pytest.approx(3.0, abs=0.4)
    assert 95 <= one.battery_pct <= 100


def test_every_kind_has_a_full_battery_and_only_what_flies_is_flying(make_gcs: MakeGcs) -> None:
    world = make_gcs([VehicleSpec(autopilot=each) for each in ("arducopter", "ardurover", "arduplane", "px4")]).world
    world.step(5.0)
    rover = world.vehicles[1]
    assert rover.brain.arm()
    world.step(1.0)
    assert [(one.battery_pct, one.armed, one.flying) for one in world.status().vehicles] == [
        (100, False, False),
        (100, True, False),
        (100, False, False),
        (100, False, False),
    ]
