"""Faults on every kind of vehicle, over real sockets, and with noisy sensors."""

from __future__ import annotations

import math
import socket

import pytest

from tests.sim.conftest import MakeGcs
from zmav.mavlink import load_dialect
from zmav.mavlink.frames import Frame, Splitter
from zmav.sim import VehicleSpec, World

BODY = ("gps-loss", "gps-glitch", "compass", "baro", "rangefinder", "imu", "pitot", "motor", "battery", "rc-loss")
CORRECTIONS = ("rtcm-loss", "rtcm-jump", "rtcm-foreign")
GUIDED = 4
PATIENCE_S = 30.0


@pytest.mark.parametrize("kind", ["copters", "hexas", "rovers", "planes", "px4"])
def test_every_fault_begins_and_ends_on_every_kind(kind: str) -> None:
    count = {kind: 1}
    world = World(**count, ready_s=0.5, epoch_s=0.0)  # type: ignore[arg-type]
    (vehicle,) = world.vehicles
    world.step(1.0)
    for fault in (*BODY, *CORRECTIONS, "frozen", "link-loss"):
        world.fault(vehicle.name, fault)
        world.step(0.1)
    assert len(world.faults()) == len(BODY) + len(CORRECTIONS) + 2
    assert world.clear() == len(BODY) + len(CORRECTIONS) + 2
    world.fault(vehicle.name, "reboot")
    world.step(5.0)
    assert world.faults() == []
    assert vehicle.brain.position_ok
    assert vehicle.node.seat.fleet.efficiency.min() == 1.0
    assert not vehicle.node.seat.belief().troubled
    s = vehicle.brain.sense
    assert (s.north, s.east) == pytest.approx((s.true_north, s.true_east), abs=0.1)
    world.close()


def test_a_plane_without_its_motor_has_no_thrust() -> None:
    world = World(planes=1, ready_s=0.5, epoch_s=0.0)
    dynamics = world.vehicles[0].node.seat.fleet.dynamics
    world.fault("plane1", "motor")
    world.fault("plane1", "frozen")  # so that nothing but this test moves the throttle
    held = world.vehicles[0].node.seat.fleet._held[0]
    held["throttle"] = held["throttle"] + 1.0
    world.step(0.5)
    assert dynamics.thrust.tolist() == [0.0]  # type: ignore[attr-defined]
    world.clear("plane1", "motor")
    world.step(0.5)
    assert dynamics.thrust[0] > 1.0  # type: ignore[attr-defined]
    world.close()


def test_a_cut_link_over_tcp_is_silent_and_stays_open() -> None:
    spec = VehicleSpec(endpoints=("tcp:0",))
    with World([spec], ready_s=0.5, speed=20.0) as world:
        _, host, port = world.urls[0].split(":")
        with socket.create_connection((host, int(port)), PATIENCE_S) as client:
            splitter = Splitter(load_dialect("ardupilotmega"))
            client.settimeout(PATIENCE_S)
            frames: list[Frame] = []
            while not frames:
                frames = splitter.feed(client.recv(4096))
            world.fault("quad1", "link-cut")
            client.setblocking(False)
            now = world.time_s
            world.wait_for(lambda: world.time_s > now + 1.0)
            _drain(client)
            world.wait_for(lambda: world.time_s > now + 5.0)
            assert _drain(client) == b""
            world.clear()
            client.settimeout(PATIENCE_S)
            frames = []
            while not frames:
                frames = splitter.feed(client.recv(4096))
            assert frames[0].verified


def _drain(client: socket.socket) -> bytes:
    """What has come by now."""
    found = b""
    try:
        while data := client.recv(65536):
            found += data
    except BlockingIOError:
        pass
    return found


def test_a_copter_flies_with_noisy_sensors(make_gcs: MakeGcs) -> None:
    gcs = make_gcs(noise="typical", seed=3)
    gcs.until(lambda: gcs.vehicle.copter.position_ok)
    assert [gcs.command(176, 1, GUIDED), gcs.command(400, 1), gcs.command(22, 0, 0, 0, 0, 0, 0, 6.0)] == [0, 0, 0]
    gcs.until(lambda: gcs.vehicle.brain.sense.true_down < -5.0)
    gcs.goto(10.0, 0.0, -6.0)
    gcs.clear()
    gcs.send("COMMAND_LONG", command=511, param1=24.0, param2=2e5)
    gcs.world.step(15.0)
    sense = gcs.vehicle.brain.sense
    assert math.hypot(sense.true_north - 10.0, sense.true_east) < 8.0
    assert abs(sense.true_down + 6.0) < 2.0
    assert gcs.last("EKF_STATUS_REPORT")["flags"] == 0x33F
    assert len({m["lat"] for m in gcs.all("GPS_RAW_INT")}) > 30
    assert gcs.texts() == []
