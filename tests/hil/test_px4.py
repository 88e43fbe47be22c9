"""PX4's simulator interface over a real TCP socket, with a protocol peer at the other end that flies by it."""

from __future__ import annotations

import contextlib
import math
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.hil.conftest import MakeWorld, hil_world, plant
from tests.hil.px4_peer import Px4Peer, TcpPeer
from tests.waiting import wait_until
from zmav.hil.px4 import Px4Vehicle
from zmav.hil.stream import BARO, IMU, MAG, HilStream
from zmav.mavlink import load_dialect
from zmav.mavlink.frames import Splitter
from zmav.sim import VehicleSpec, World
from zmav.sim.sensors.atmosphere import pressure_hpa
from zmav.sim.spec import Stack

WAITING = VehicleSpec(autopilot="px4", stack=Stack(port=0))
MakePeer = Callable[..., TcpPeer]


def only(world: World) -> Px4Vehicle:
    vehicle = world.externals.vehicles[0]
    assert isinstance(vehicle, Px4Vehicle)
    return vehicle


@pytest.fixture
def world(make_world: MakeWorld) -> World:
    return make_world(WAITING)


@pytest.fixture
def make_peer(world: World) -> Iterator[MakePeer]:
    peers = []

    def make(**options: Any) -> TcpPeer:
        peer = TcpPeer(only(world).port, **options)
        peers.append(peer)
        return peer

    yield make
    for peer in peers:
        peer.close()


def after(world: World, seconds: float) -> None:
    begun = world.time_s
    world.wait_for(lambda: world.time_s >= begun + seconds, seconds + 60.0)


class TestStream:
    """The messages, without a line."""

    def hear(self, frames: bytes) -> Px4Peer:
        peer = Px4Peer(lambda data: None)
        peer.take(frames)
        return peer

    def stream(self, **options: Any) -> HilStream:
        return HilStream(plant("sih", **options), load_dialect("ardupilotmega"), 1, 10**15)

    def test_a_vehicle_at_rest(self) -> None:
        stream = self.stream(yaw=1.0)
        heard = self.hear(stream.step()).heard
        sensor, gps = heard["HIL_SENSOR"][0], heard["HIL_GPS"][0]
        assert (sensor.xacc, sensor.yacc, sensor.zacc) == pytest.approx((0.0, 0.0, -9.80665), abs=1e-4)
        assert sensor.abs_pressure == pytest.approx(pressure_hpa(584.09), rel=1e-6)
        assert sensor.pressure_alt == pytest.approx(584.09, abs=0.1)
        north = math.hypot(*stream.plant.sensors.field[:2])
        assert math.hypot(sensor.xmag, sensor.ymag) == pytest.approx(north, rel=1e-4)
        assert (gps.fix_type, gps.lat, gps.lon, gps.alt) == (3, -353632610, 1491652300, 584090)
        assert (gps.vel, gps.vn, gps.ve, gps.vd) == (0, 0, 0, 0)
        assert gps.time_usec >= 10**15  # UTC
        assert sensor.time_usec < 10**6  # since the start

    def test_the_compass_points_north_by_the_nose(self) -> None:
        stream = self.stream(yaw=0.7)
        sensor = self.hear(stream.step()).heard["HIL_SENSOR"][0]
        north, east, _ = stream.plant.sensors.field
        assert math.atan2(-sensor.ymag, sensor.xmag) + math.atan2(east, north) == pytest.approx(0.7, abs=1e-3)

    def test_each_sensor_comes_at_its_own_rate(self) -> None:
        stream = self.stream()
        peer = Px4Peer(lambda data: None)
        fields = []
        for _ in range(250):
            peer.take(stream.step())
            fields.append(peer.heard["HIL_SENSOR"][-1].fields_updated)
        assert all(field & IMU == IMU for field in fields)
        assert sum(field & MAG == MAG for field in fields) == pytest.approx(100, abs=20)
        assert sum(field & BARO == BARO for field in fields) == pytest.approx(50, abs=2)
        assert not any(field & 0x400 for field in fields)  # no pitot tube on a quadrotor
        assert peer.counts["HIL_SENSOR"] == 250
        assert peer.counts["HEARTBEAT"] == peer.counts["SYSTEM_TIME"] == 2  # at the start, and a second later

    def test_gps_comes_five_times_a_second_and_late(self) -> None:
        stream = self.stream(noise="typical", start=(0.0, 0.0, -100.0))  # it falls: where it was is where it is not
        peer = Px4Peer(lambda data: None)
        for _ in range(500):
            peer.take(stream.step())
        assert peer.counts["HIL_GPS"] == pytest.approx(10, abs=1)
        age_s = (10**15 + stream.time_us - peer.heard["HIL_GPS"][-1].time_usec) * 1e-6
        assert 0.2 <= age_s < 0.45
        assert peer.heard["HIL_GPS"][-1].vd == pytest.approx(980.665 * (stream.plant.time_s - age_s), rel=0.1)

    def drive(self, stream: HilStream, controls: list[float], mode: int = 129, flags: int = 1) -> None:
        sent: list[bytes] = []
        peer = Px4Peer(sent.append)
        peer.say(peer.mav.hil_actuator_controls_encode(1, controls + [0.0] * (16 - len(controls)), mode, flags))
        for frame in Splitter(load_dialect("ardupilotmega")).feed(b"".join(sent)):
            stream.take(frame)

    @pytest.mark.parametrize(
        ("motor", "roll", "pitch", "yaw"), [(1, -1, 1, 1), (2, 1, -1, 1), (3, 1, 1, -1), (4, -1, -1, -1)]
    )
    def test_motors_sit_where_px4_counts_them(self, motor: int, roll: int, pitch: int, yaw: int) -> None:
        # docs.px4.io, "Airframes Reference", Quadrotor x.
        stream = self.stream(start=(0.0, 0.0, -50.0))
        controls = [0.0] * 4
        controls[motor - 1] = 0.5
        self.drive(stream, controls)
        for _ in range(5):
            stream.step()
        signs = [(rate > 1e-4) - (rate < -1e-4) for rate in stream.plant.truth().rate]
        assert signs == [roll, pitch, yaw]

    def test_a_disarmed_vehicle_turns_nothing_and_an_output_that_is_off_neither(self) -> None:
        stream = self.stream()
        self.drive(stream, [0.5] * 4, mode=1)
        assert (stream.armed, stream.plant.values) == (False, [0.0] * 4)
        self.drive(stream, [0.5, math.nan, 2.0, -1.0], flags=0)
        assert (stream.armed, stream.lockstep) == (True, False)
        assert sorted(stream.plant.values) == [0.0, 0.0, 0.5, 1.0]


class TestServer:
    def test_a_peer_takes_off_and_hovers_by_its_sensors_alone(self, world: World, make_peer: MakePeer) -> None:
        peer = make_peer()
        peer.start()
        after(world, 15.0)
        truth = only(world).plant.truth()
        assert truth.pos[2] == pytest.approx(-5.0, abs=1.5)
        assert math.hypot(truth.pos[0], truth.pos[1]) < 6.0  # a GPS wanders
        assert max(abs(angle) for angle in truth.euler[:2]) < 0.2
        shown = world.status().vehicles[0]
        assert (shown.autopilot, shown.mode, shown.armed) == ("px4", "external", True)
        peer.target = (0.0, 0.0, 2.0)  # down, and on
        after(world, 15.0)
        assert only(world).plant.truth().contact

    def test_time_goes_on_by_itself_until_the_first_controls(self, world: World, make_peer: MakePeer) -> None:
        peer = make_peer()
        peer.mute = True
        peer.start()
        after(world, 2.0)
        wait_until(lambda: peer.counts.get("HIL_SENSOR", 0) > 450)
        assert only(world).stalls == 0

    def test_in_lock_step_no_reading_comes_before_the_answer_to_the_last(
        self, world: World, make_peer: MakePeer
    ) -> None:
        peer = make_peer()
        peer.start()
        after(world, 1.0)
        peer.mute = True
        before = peer.counts["HIL_SENSOR"]
        after(world, 5.0)  # the world goes on without it
        assert peer.counts["HIL_SENSOR"] - before <= 2 + only(world).stalls
        assert only(world).plant.time_s < world.time_s - 3.0
        peer.mute = False
        peer.say(peer.mav.hil_actuator_controls_encode(0, [0.0] * 16, 1, 1))
        resumed, begun = only(world).plant.time_s, world.time_s
        after(world, 2.0)
        assert only(world).plant.time_s - resumed == pytest.approx(world.time_s - begun, abs=0.2)

    def test_a_late_answer_to_an_earlier_reading_answers_nothing(self) -> None:
        world = hil_world([WAITING], epoch_s=0.0)
        try:
            world.open()
            peer = TcpPeer(only(world).port)
            peer.mute = True
            world.serve()

            def hear() -> int:
                """How many readings there are by now."""
                world.serve()
                peer.socket.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    while data := peer.socket.recv(65536):
                        peer.take(data)
                return peer.counts["HIL_SENSOR"]

            world.step(0.1)
            assert hear() == 25  # PX4 boots: it has told no controls yet
            stamps = [reading.time_usec - 4001 for reading in peer.heard["HIL_SENSOR"]]
            assert stamps[:2] == [0, 4000]

            def answer(stamp: int) -> int:
                peer.say(peer.mav.hil_actuator_controls_encode(stamp, [0.0] * 16, 1, 1))
                return hear()

            assert answer(stamps[1]) == 25
            world.step(0.1)
            assert hear() == 26  # lock step from now on
            assert [answer(stamp) for stamp in stamps[2:]] == [26] * 23
            assert answer(peer.heard["HIL_SENSOR"][-1].time_usec - 4001) == 27
            peer.close()
        finally:
            world.close()

    def test_a_stack_that_stops_answering_is_said_and_nudged(self, world: World, make_peer: MakePeer) -> None:
        peer = make_peer()
        peer.start()
        after(world, 0.5)
        peer.mute = True
        wait_until(lambda: only(world).stalls >= 1)
        before = peer.counts["HIL_SENSOR"]
        wait_until(lambda: peer.counts["HIL_SENSOR"] > before)  # a reading a second, lest both wait for ever
        assert any("stopped answering" in note for note in world.externals.notes)

    def test_without_lock_step_readings_do_not_wait(self, world: World, make_peer: MakePeer) -> None:
        peer = make_peer(lockstep=False)
        peer.start()
        after(world, 1.0)
        peer.mute = True
        before = peer.counts["HIL_SENSOR"]
        after(world, 1.0)
        wait_until(lambda: peer.counts["HIL_SENSOR"] > before + 200)

    def test_frames_torn_into_bytes_and_mixed_with_noise_are_taken(self, world: World, make_peer: MakePeer) -> None:
        peer = make_peer()
        whole = peer.out

        def torn(data: bytes) -> None:
            for piece in (b"\xfd\x00garbage", data[:1], data[1:13], data[13:-1], data[-1:]):
                whole(piece)

        peer.send = torn
        peer.start()
        after(world, 1.0)
        assert only(world).stream.controls > 200
        assert only(world).splitter.counters.garbage > 1000

    def test_a_stack_that_leaves_stops_the_rotors_and_may_come_again(self, world: World, make_peer: MakePeer) -> None:
        first = make_peer()
        first.start()
        after(world, 8.0)
        assert only(world).plant.truth().pos[2] < -2.0
        first.close()
        wait_until(lambda: not only(world).connected)
        assert only(world).plant.values == [0.0] * 4
        assert world.status().vehicles[0].mode == "waiting"
        flown = only(world).plant.time_s
        second = make_peer()
        second.start()
        after(world, 0.1)
        assert only(world).plant.time_s < flown / 2  # it boots where it stood at first
        after(world, 8.0)
        assert only(world).plant.truth().pos[2] < -2.0

    def test_a_second_connection_takes_the_place_of_the_first(self, world: World, make_peer: MakePeer) -> None:
        first, second = make_peer(), make_peer()
        first.start()
        after(world, 0.2)
        second.start()
        after(world, 0.5)
        wait_until(lambda: second.counts.get("HIL_SENSOR", 0) > 50)
        assert only(world).connected

    def test_a_client_that_never_reads_is_given_no_more_than_fits(self, world: World) -> None:
        with socket.create_connection(("127.0.0.1", only(world).port)) as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            after(world, 30.0)
            line = only(world).line
            assert line is not None and line.room() >= 0
            assert only(world).plant.time_s < 20.0

    def test_noise_on_the_port_harms_nobody(self, world: World, make_peer: MakePeer) -> None:
        with socket.create_connection(("127.0.0.1", only(world).port)) as stranger:
            stranger.sendall(b"GET / HTTP/1.1\r\n\r\n" + bytes(range(256)) * 40)
            wait_until(lambda: only(world).splitter.counters.garbage > 10_000)
        peer = make_peer()
        peer.start()
        after(world, 1.0)
        assert only(world).stream.controls > 200
