"""When frames may lie on the link, and for how long."""

from __future__ import annotations

import math
import time
from unittest import mock

import pytest

from zmav.services.authority.control import Control, Mover
from zmav.services.link.patience import AT_REST, LEAST, OF_PERIOD, READ, UNREAD, Patience


class Vehicle:
    """Disarmed, connected, moved by nobody, read by nobody, and nothing is awaited."""

    def __init__(self, *, aside: bool = False) -> None:
        self.companion, self.leases, self.timesync = mock.Mock(), mock.Mock(), mock.Mock()
        self.demands, self.state, self.control = mock.Mock(), mock.Mock(), Control("quad1")
        self.port, self.identity = self.companion.port, self.companion.identity
        self.port.read, self.port.awaited, self.port.spoke = False, 0, -math.inf
        self.identity.connected, self.identity.armed = True, False
        self.leases.holder, self.state.read, self.demands.fastest = None, False, 0.0
        self.timesync.asking, self.timesync.lag = False, math.inf
        self.patience = Patience(
            self.companion, self.control, self.leases, self.timesync, self.demands, self.state, aside=aside
        )


@pytest.mark.parametrize("armed", [False, True])
def test_what_nobody_reads_or_commands_may_lie(armed: bool) -> None:
    vehicle = Vehicle()
    vehicle.identity.armed = armed
    assert vehicle.patience() == (UNREAD if armed else AT_REST)


@pytest.mark.parametrize("read", [False, True])
def test_nothing_lies_while_an_answer_may_come(read: bool) -> None:
    vehicle = Vehicle()
    vehicle.port.read = read
    vehicle.port.awaited = 1
    assert vehicle.patience() == 0.0
    vehicle.port.awaited, vehicle.timesync.asking = 0, True
    assert vehicle.patience() == 0.0
    vehicle.timesync.asking, vehicle.port.spoke = False, time.monotonic()
    assert vehicle.patience() == 0.0
    vehicle.port.spoke, vehicle.identity.connected = -math.inf, False
    assert vehicle.patience() == 0.0, "who it is is not known"


@pytest.mark.parametrize("mover", [mover for mover in Mover if mover is not Mover.NOBODY])
def test_nothing_lies_while_anything_moves_it(mover: Mover) -> None:
    vehicle = Vehicle()
    vehicle.control.take(vehicle, mover)
    assert vehicle.patience() == 0.0
    vehicle.control.leave(vehicle)
    assert vehicle.patience() == AT_REST


def test_nothing_lies_under_a_lease() -> None:
    vehicle = Vehicle()
    vehicle.leases.holder = "planner"
    assert vehicle.patience() == 0.0


def test_nothing_lies_where_an_armed_vehicle_moves_aside_by_itself() -> None:
    vehicle = Vehicle(aside=True)
    assert vehicle.patience() == AT_REST
    vehicle.identity.armed = True
    assert vehicle.patience() == 0.0
    vehicle.identity.armed = None
    assert vehicle.patience() == 0.0, "not known is armed"


def test_who_reads_frames_or_state_of_an_armed_vehicle_has_them_at_once() -> None:
    vehicle = Vehicle()
    vehicle.identity.armed, vehicle.port.read = True, True
    assert vehicle.patience() == 0.0
    vehicle.port.read, vehicle.state.read = False, True
    assert vehicle.patience() == 0.0


def test_a_disarmed_vehicle_is_read_in_small_batches() -> None:
    vehicle = Vehicle()
    vehicle.port.read = True
    assert vehicle.patience() == READ
    vehicle.demands.fastest = 20.0
    assert vehicle.patience() == OF_PERIOD / 20.0, "a tenth of what its fastest reader asked for"
    vehicle.demands.fastest = 1.1 * OF_PERIOD / LEAST
    assert vehicle.patience() == 0.0


def test_the_autopilots_own_question_for_the_time_lies_no_longer_than_it_bears() -> None:
    vehicle = Vehicle()
    vehicle.timesync.lag = 0.005
    assert vehicle.patience() == 0.005
    vehicle.timesync.lag = 0.0001
    assert vehicle.patience() == 0.0, "a simulator in lock step"
