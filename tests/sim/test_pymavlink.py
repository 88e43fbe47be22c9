"""A plain pymavlink script flies the simulated copter, as it would fly the real one. It knows nothing of zmav."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from zmav.sim import VehicleSpec, World
from zmav.sim.protocol.params import defaults

mavutil = pytest.importorskip("pymavlink.mavutil")

SPEED = 10.0  # times real time
PATIENCE_S = 60.0
ARM, TAKEOFF, SET_MODE, SET_INTERVAL, LAND = 400, 22, 176, 511, 21
GUIDED = 4
POSITION, VELOCITY = 0x0DF8, 0x0DC7


class Script:
    """A mavutil connection with the few lines every such script has."""

    def __init__(self, url: str, **options: Any) -> None:
        self.link = mavutil.mavlink_connection(url, source_system=255, source_component=190, **options)
        self.texts: list[str] = []
        self.link.wait_heartbeat(timeout=PATIENCE_S)

    def next(self, kind: str, true: Callable[[Any], bool] = lambda message: True, sim_s: float = 60.0) -> Any:
        """The next message of that kind for which ``true`` holds, within so many seconds on the vehicle's clock."""
        start: int | None = None
        while True:
            message = self.link.recv_match(blocking=True, timeout=PATIENCE_S)
            assert message is not None, f"nothing heard while waiting for {kind}; last: {self.texts[-3:]}"
            if message.get_type() == "STATUSTEXT":
                self.texts.append(message.text)
            now = getattr(message, "time_boot_ms", None)
            if now is not None:
                start = now if start is None else start
                assert now - start < sim_s * 1000, f"no such {kind} within {sim_s} s; last: {self.texts[-3:]}"
            if message.get_type() == kind and true(message):
                return message

    def command(self, number: int, *params: float) -> int:
        padded = [*params, *[0.0] * (7 - len(params))]
        self.link.mav.command_long_send(self.link.target_system, 1, number, 0, *padded)
        ack = self.next("COMMAND_ACK", lambda m: m.command == number)
        return int(ack.result)

    def goto(self, north: float, east: float, down: float) -> None:
        self._target(POSITION, (north, east, down), (0.0, 0.0, 0.0))

    def fly(self, vn: float, ve: float, vd: float) -> None:
        self._target(VELOCITY, (0.0, 0.0, 0.0), (vn, ve, vd))

    def _target(self, mask: int, pos: tuple[float, ...], vel: tuple[float, ...]) -> None:
        self.link.mav.set_position_target_local_ned_send(
            0, self.link.target_system, 1, 1, mask, *pos, *vel, 0, 0, 0, 0, 0
        )


@pytest.fixture
def script() -> Iterator[Script]:
    # Long enough to be refused first, however late this process gets its turn.
    with World(copters=1, endpoint="tcp:0", speed=SPEED, ready_s=40.0) as world:
        script = Script(world.urls[0])
        yield script
        script.link.close()


def test_a_whole_flight(script: Script) -> None:
    """Boot, refusals, arming, 5 m up, an 8 m square, a velocity that runs out, landing, disarmed."""
    for msgid in (1, 30, 32, 33, 193):
        assert script.command(SET_INTERVAL, msgid, 1e5) == 0
    assert script.command(SET_INTERVAL, 331, 1e5) == 2
    assert script.command(31999) == 3

    assert script.command(SET_MODE, 1, GUIDED) == 0
    refusals = 0
    while script.command(ARM, 1) == 4:
        refusals += 1
        script.next("EKF_STATUS_REPORT")
    assert refusals > 0
    assert "Arm: Need Position Estimate" in script.texts
    flags = script.next("EKF_STATUS_REPORT").flags
    assert flags & 16
    assert not flags & 128
    assert script.link.motors_armed() or script.next("HEARTBEAT", lambda m: m.base_mode & 128)

    assert script.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == 0
    script.next("LOCAL_POSITION_NED", lambda m: m.z < -4.8 and abs(m.vz) < 0.2)
    assert script.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == 4
    assert script.command(ARM, 0) == 4

    for north, east in ((8, 0), (8, 8), (0, 8), (0, 0)):
        script.goto(north, east, -5)

        def arrived(m: Any, n: float = north, e: float = east) -> bool:
            return math.hypot(m.x - n, m.y - e) < 0.5 and abs(m.vx + m.vy) < 0.3

        there = script.next("LOCAL_POSITION_NED", arrived)
        assert abs(there.z + 5) < 0.5

    script.fly(3.0, 0.0, 0.0)
    begun = script.next("LOCAL_POSITION_NED", lambda m: m.vx > 2.5, sim_s=5.0)
    stopped = script.next("LOCAL_POSITION_NED", lambda m: abs(m.vx) < 0.2, sim_s=8.0)
    assert stopped.time_boot_ms - begun.time_boot_ms < 6000
    assert stopped.x > 5.0

    assert script.command(LAND) == 0
    assert script.next("HEARTBEAT").custom_mode == 9
    landed = script.next("HEARTBEAT", lambda m: not m.base_mode & 128)
    assert landed.system_status == 3
    assert script.texts[-1] == "Disarming motors"
    assert abs(script.next("GLOBAL_POSITION_INT").relative_alt) < 100


def test_mavutils_own_helpers_work(script: Script) -> None:
    """The calls most scripts are made of: modes by name, arming helpers, the parameter download."""
    assert script.link.mode_mapping()["GUIDED"] == GUIDED
    script.link.set_mode("GUIDED")
    script.next("HEARTBEAT", lambda m: m.custom_mode == GUIDED)
    script.link.param_fetch_all()
    values: dict[str, float] = {}
    while len(values) < 1354:
        message = script.next("PARAM_VALUE")
        assert message.param_count == 1354
        values[message.param_id] = message.param_value
    assert values == pytest.approx({name: value for name, value, _ in defaults("arducopter")}, rel=1e-6)
    script.link.param_set_send("RTL_ALT", 900)
    assert script.next("PARAM_VALUE", lambda m: m.param_id == "RTL_ALT").param_value == 900
    script.command(SET_INTERVAL, 193, 1e5)
    script.next("EKF_STATUS_REPORT", lambda m: m.flags & 16)
    script.link.arducopter_arm()
    script.next("HEARTBEAT", lambda m: m.base_mode & 128)
    script.link.arducopter_disarm()
    script.next("HEARTBEAT", lambda m: not m.base_mode & 128)


def test_over_udp_as_a_ground_station_listens(free_udp_port: int) -> None:
    spec = VehicleSpec(endpoints=(f"udp:127.0.0.1:{free_udp_port}",), sysid=7)
    world = World([spec], speed=SPEED, ready_s=0.5)
    world.start()
    try:
        script = Script(f"udpin:127.0.0.1:{free_udp_port}")
        assert script.link.target_system == 7
        assert script.command(SET_INTERVAL, 32, 1e5) == 0
        assert script.command(SET_MODE, 1, GUIDED) == 0
        script.next("LOCAL_POSITION_NED")
        assert script.command(ARM, 1) == 0
        assert script.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 3) == 0
        script.next("LOCAL_POSITION_NED", lambda m: m.z < -2.7)
        script.link.close()
    finally:
        world.close()


@pytest.fixture
def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
