"""HIL over a serial line: a pseudo-terminal with a protocol peer in place of the flight controller."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from tests.hil.conftest import MakeWorld, hil_world
from tests.hil.px4_peer import Px4Peer
from tests.waiting import wait_until
from zmav.errors import BadConfig, BadUrl
from zmav.hil.hardware import HardwareVehicle, fitting_hz, parse_device
from zmav.sim import VehicleSpec, World
from zmav.sim.spec import Stack

HIL, ARMED = 32, 128


class Board(Px4Peer):
    """A flight controller on a pty: it beats ten times a second, goes to HIL when asked by SET_MODE (if it is
    ``willing``), and flies then. ``shy``: it says nothing before it hears a heartbeat, as PX4 on USB. ``link`` is the
    device; :meth:`unplug` takes it away.
    """

    def __init__(self, link: Path, *, willing: bool = True, base_mode: int = 81, shy: bool = False) -> None:
        super().__init__(self.out, lockstep=False)
        self.link = link
        self.willing = willing
        self.shy = shy
        self.base_mode = base_mode
        self._stop = threading.Event()
        self.plug()
        self._thread = threading.Thread(target=self._run, name="board", daemon=True)
        self._thread.start()

    def plug(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        with contextlib.suppress(FileNotFoundError):
            self.link.unlink()
        self.link.symlink_to(os.ttyname(slave))
        os.close(slave)  # from now on it is the simulator's alone

    def unplug(self) -> None:
        self.link.unlink()
        os.close(self._master)
        self._master = -1

    def out(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def _run(self) -> None:
        while not self._stop.wait(0.0):
            if self._master < 0:
                self._stop.wait(0.02)
                continue
            self._beat_now_and_then()
            try:
                if select.select([self._master], [], [], 0.05)[0]:
                    self.take(os.read(self._master, 65536))
            except OSError:
                self._stop.wait(0.02)  # nobody has the device open

    def _beat_now_and_then(self) -> None:
        if self.shy and "HEARTBEAT" not in self.counts:
            return
        self._beats = getattr(self, "_beats", 0) + 1
        if self._beats % 20 == 1:
            self.say(self.mav.heartbeat_encode(2, 12, self.base_mode, 50593792, 3))

    def take(self, data: bytes) -> None:
        before = self.counts.get("SET_MODE", 0)
        super().take(data)
        if self.counts.get("SET_MODE", 0) > before and self.willing:
            self.base_mode |= self.heard["SET_MODE"][-1].base_mode & HIL

    def close(self) -> None:
        self._stop.set()
        self._thread.join(10.0)
        if self._master >= 0:
            os.close(self._master)


MakeBoard = Callable[..., Board]


@pytest.fixture
def make_board(tmp_path: Path) -> Iterator[MakeBoard]:
    boards = []

    def make(**options: Any) -> Board:
        boards.append(Board(tmp_path / "ttyACM0", **options))
        return boards[-1]

    yield make
    for board in boards:
        board.close()


def hardware(path: Path, baud: int = 921600) -> VehicleSpec:
    return VehicleSpec(autopilot="px4", endpoints=("tcp:0",), stack=Stack(device=f"{path}:{baud}"))


def only(world: World) -> HardwareVehicle:
    vehicle = world.externals.vehicles[0]
    assert isinstance(vehicle, HardwareVehicle)
    return vehicle


def test_a_controller_is_put_into_hil_and_flies_in_real_time(make_world: MakeWorld, make_board: MakeBoard) -> None:
    board = make_board()
    world = make_world(hardware(board.link), speed=1.0)
    wait_until(lambda: only(world).in_hil)
    assert board.heard["SET_MODE"][0].base_mode == 81 | HIL
    assert board.heard["SET_MODE"][0].custom_mode == 50593792  # the mode it was in
    wait_until(lambda: world.status().vehicles[0].ned_m[2] < -1.0)
    assert board.counts["HIL_SENSOR"] > 50
    assert world.status().vehicles[0].armed
    asked = board.heard["COMMAND_LONG"][0]
    assert (asked.command, asked.param1) == (511, 93)
    # PX4 would take it for its own estimate.
    assert "HIL_STATE_QUATERNION" not in board.counts
    # Nor is the simulator the ground station whose loss is a failsafe.
    assert {(beat.type, beat.autopilot) for beat in board.heard["HEARTBEAT"]} == {(0, 8)}


def test_a_controller_that_waits_for_a_heartbeat_gets_one(make_world: MakeWorld, make_board: MakeBoard) -> None:
    board = make_board(shy=True, base_mode=81 | HIL)
    world = make_world(hardware(board.link), speed=1.0)
    wait_until(lambda: only(world).stream.controls > 20)
    assert "SET_MODE" not in board.counts  # it is in HIL by itself
    wait_until(lambda: [(m.command, m.param1) for m in board.heard.get("COMMAND_LONG", [])] == [(511, 93.0)])


def test_a_controller_gets_no_reading_before_it_is_in_hil(make_world: MakeWorld, make_board: MakeBoard) -> None:
    board = make_board(willing=False)
    world = make_world(hardware(board.link), speed=1.0)
    wait_until(lambda: any("SYS_HITL" in note for note in world.externals.notes))
    wait_until(lambda: board.counts["SET_MODE"] >= 5)
    assert "HIL_SENSOR" not in board.counts
    assert world.status().vehicles[0].mode == "waiting"


def test_a_controller_that_is_armed_is_left_alone(make_world: MakeWorld, make_board: MakeBoard) -> None:
    board = make_board(base_mode=81 | ARMED)
    world = make_world(hardware(board.link), speed=1.0)
    wait_until(lambda: any("armed outside HIL" in note for note in world.externals.notes))
    wait_until(lambda: len(world.externals.notes) >= 2)
    assert "SET_MODE" not in board.counts


def test_the_rest_of_the_line_is_for_ground_stations(make_world: MakeWorld, make_board: MakeBoard) -> None:
    board = make_board()
    world = make_world(hardware(board.link), speed=1.0)
    wait_until(lambda: only(world).in_hil)
    station = mavutil.mavlink_connection(only(world).urls[0], source_system=255)
    try:
        beat = station.recv_match(type="HEARTBEAT", blocking=True, timeout=20)
        assert (beat.get_srcSystem(), beat.autopilot) == (1, 12)
        station.mav.command_long_send(1, 1, 520, 0, 1, 0, 0, 0, 0, 0, 0)
        wait_until(lambda: any(m.command == 520 for m in board.heard.get("COMMAND_LONG", [])))
        got = next(m for m in board.heard["COMMAND_LONG"] if m.command == 520)
        assert got.get_srcSystem() == 255
        # What belongs to the simulation stays on the line.
        assert station.recv_match(type="HIL_ACTUATOR_CONTROLS", blocking=True, timeout=0.5) is None
    finally:
        station.close()
    assert only(world).stream.controls > 10


def test_it_is_unplugged_and_plugged_in_again(make_world: MakeWorld, make_board: MakeBoard) -> None:
    board = make_board()
    world = make_world(hardware(board.link), speed=1.0)
    wait_until(lambda: only(world).stream.controls > 20)
    board.unplug()
    wait_until(lambda: any("has gone" in note for note in world.externals.notes))
    assert not only(world).connected
    board.base_mode = 81
    board.plug()
    wait_until(lambda: only(world).in_hil and only(world).stream.controls > 20)


def test_a_file_in_the_device_s_place_ends_nothing(make_world: MakeWorld, make_board: MakeBoard) -> None:
    """As a shell makes one that writes to a device which is not there."""
    board = make_board()
    world = make_world(hardware(board.link), speed=1.0)
    wait_until(lambda: only(world).in_hil)
    board.unplug()
    board.link.write_text("")
    wait_until(lambda: any("has gone" in note for note in world.externals.notes))
    wait_until(lambda: any("remove what stands there" in note for note in world.externals.notes))
    board.base_mode = 81
    board.plug()
    wait_until(lambda: only(world).in_hil)
    assert sum("remove what stands there" in note for note in world.externals.notes) == 1


def test_a_device_that_is_not_there_yet_is_waited_for(
    make_world: MakeWorld, make_board: MakeBoard, tmp_path: Path
) -> None:
    world = make_world(hardware(tmp_path / "ttyACM0"), speed=1.0)
    assert any("waiting for" in note for note in world.externals.notes)
    make_board()
    wait_until(lambda: only(world).in_hil)


def test_what_is_no_serial_device_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadUrl, match="no serial device"), hil_world([hardware(tmp_path / "file")]):
        raise AssertionError("opened")


def test_hardware_flies_in_real_time_only(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="real time"):
        hil_world([hardware(tmp_path / "ttyACM0")], speed=2.0)


@pytest.mark.parametrize("text", ["", ":921600", "/dev/ttyACM0:fast", "/dev/ttyACM0:12345", "/dev/ttyACM0:0"])
def test_a_device_is_a_path_and_perhaps_a_rate(text: str) -> None:
    with pytest.raises(BadUrl, match="PATH"):
        parse_device(text)


def test_readings_fit_the_line() -> None:
    assert parse_device("/dev/ttyUSB0:57600") == ("/dev/ttyUSB0", 57600)
    assert parse_device("/dev/ttyACM0") == ("/dev/ttyACM0", 921600)
    assert fitting_hz("/dev/ttyACM0", 57600) == 250.0  # USB takes no notice
    assert fitting_hz("/dev/ttyUSB0", 921600) == 250.0
    assert fitting_hz("/dev/ttyUSB0", 115200) == pytest.approx(0.6 * 11520 / 76)
