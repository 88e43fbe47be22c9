"""A MAVProxy session flies the ArduPilot-rules copter, by what a person would type. It knows nothing of zmav."""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.mavproxy import MavProxy
from zmav.sim import SimVehicle, World

SPEED = 10.0  # times real time
SIM_S = 200.0
# Without consoles and maps, which need a screen, and without what asks the network for terrain.
MODULES = "wp,rally,fence,param,arm,mode,cmdlong,misc,ftp,link,log"
HOME = (-35.363261, 149.165230, 584.09)


class Session(MavProxy):
    """One MAVProxy at the one vehicle of a world."""

    def __init__(self, world: World, folder: Path) -> None:
        super().__init__(folder, world.urls[0], MODULES)
        self.world = world
        self.vehicle: SimVehicle = world.vehicles[0]

    def until(self, true: Callable[[], bool]) -> None:
        self.world.wait_for(true, SIM_S)

    @property
    def height(self) -> float:
        return -self.vehicle.copter.local[2]


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    if importlib.util.find_spec("MAVProxy") is None:
        pytest.skip("MAVProxy is not installed (it is in the dev extra)")
    with World(copters=1, endpoint="tcp:0", speed=SPEED, ready_s=1.0) as world:
        session = Session(world, tmp_path)
        try:
            session.hears(r"online system 1")
            session.hears(r"Received \d+ parameters")
            yield session
        finally:
            session.close()


def test_a_flight(session: Session) -> None:
    """Parameters, GUIDED, arming, takeoff, a velocity, a place, RTL, disarmed; every order is acknowledged to it."""
    copter = session.vehicle.copter
    session.set_param("WPNAV_SPEED", 750)
    assert copter.params["WPNAV_SPEED"] == 750
    session.type("param fetch", rf"Received {len(copter.params)} parameters")
    session.type("version", r"REQUEST_MESSAGE: ACCEPTED")
    session.type("mode GUIDED", r"DO_SET_MODE: ACCEPTED")
    session.until(lambda: copter.mode.name == "GUIDED" and copter.position_ok)
    session.type("arm throttle", r"COMPONENT_ARM_DISARM: ACCEPTED")
    session.until(lambda: copter.armed)
    session.type("takeoff 10", r"NAV_TAKEOFF: ACCEPTED")
    session.until(lambda: session.height > 9.7)
    session.type("velocity 3 0 0")
    session.until(lambda: copter.sense.vn > 2.0)
    session.type(f"guided {HOME[0] + 2e-4} {HOME[1]} 14", r"DO_REPOSITION: ACCEPTED")
    session.until(lambda: session.height > 13.5 and abs(copter.local[0] - 2e-4 * 111319.5) < 1.0)
    session.type("mode LAND", r"DO_SET_MODE: ACCEPTED")
    session.until(lambda: copter.mode.name == "LAND")
    session.type("rtl", r"DO_SET_MODE: ACCEPTED")
    session.until(lambda: copter.mode.name == "RTL")
    session.until(lambda: not copter.armed)
    assert math.hypot(*copter.local[:2]) < 1.0
    session.hears("DISARMED")
    session.type("link", r"link 1 OK .* 0 lost")


def test_lists_and_a_mission(session: Session, tmp_path: Path) -> None:
    """A mission, a fence and a rally point go up from files and come back; the mission is flown to its end."""
    copter = session.vehicle.copter
    lat, lon, amsl = HOME
    rows = ["QGC WPL 110", f"0\t1\t0\t16\t0\t0\t0\t0\t{lat}\t{lon}\t{amsl}\t1"]
    items = [(22, 0.0, 0.0, 8), (16, lat + 1e-4, lon, 8), (21, 0.0, 0.0, 0)]
    rows += [f"{i}\t0\t3\t{cmd}\t0\t0\t0\t0\t{x}\t{y}\t{z}\t1" for i, (cmd, x, y, z) in enumerate(items, start=1)]
    (tmp_path / "mission.txt").write_text("\n".join(rows) + "\n")
    session.type(f"wp load {tmp_path / 'mission.txt'}", r"MISSION_ACK: TYPE_MISSION: ACCEPTED")
    session.type("wp list", r"Saved 4 waypoints")
    assert re.search(rf"16 3 {lat + 1e-4:.6f}\d* {lon:.6f}\d* 8\.0", session.said)
    circle = f"QGC WPL 110\n0\t0\t3\t5003\t80\t0\t0\t0\t{lat}\t{lon}\t0\t1\n"
    (tmp_path / "fence.txt").write_text(circle)
    session.type(f"fence load {tmp_path / 'fence.txt'}", r"MISSION_ACK: TYPE_FENCE: ACCEPTED")
    session.type("fence list", r"Requesting 1 fence item")
    (tmp_path / "rally.txt").write_text(f"QGC WPL 110\n0\t0\t3\t5100\t0\t0\t0\t0\t{lat - 1e-4}\t{lon}\t20\t1\n")
    session.type(f"rally load {tmp_path / 'rally.txt'}", r"MISSION_ACK: TYPE_RALLY: ACCEPTED")
    session.type("rally list", r"Requesting 1 rally item")
    session.set_param("AUTO_OPTIONS", 3)  # arming and taking off in AUTO without a hand on the stick
    session.until(lambda: copter.position_ok)
    session.type("mode AUTO", r"DO_SET_MODE: ACCEPTED")
    session.type("arm throttle", r"COMPONENT_ARM_DISARM: ACCEPTED")
    session.hears(r"waypoint 2")
    session.until(lambda: not copter.armed)
    session.type("log list", r"Log \d+|numLogs \d+")
