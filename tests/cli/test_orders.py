"""Verbs that make a vehicle do something: do goto send."""

from __future__ import annotations

import contextlib
import itertools
import re
import signal
import time
from typing import TYPE_CHECKING, Any

import pytest

from tests.cli.conftest import Speaker
from zmav import wire
from zmav.cli import progress
from zmav.errors import BadInput, BadMessage, NoSuchVehicle, Refused, Stale

if TYPE_CHECKING:
    from tests.cli.conftest import Patience, StartProcess, Vehicle
    from tests.conftest import Net

PATIENCE_S = 30.0


@pytest.mark.usefixtures("hurried")
def test_a_flight_from_the_shell(vehicle: Vehicle) -> None:
    do, sim = vehicle.zmav, vehicle.sim
    assert do("do", "quad1", "arm").out == "quad1: arm done (armed True)\n"
    told = do("do", "quad1", "takeoff", "alt_rel=5")
    assert told.out.startswith("quad1: takeoff done (alt_rel 4.")
    assert sim.status().height_m == pytest.approx(5.0, abs=0.6)
    (line,) = do("goto", "quad*", "--to", "5,-3,6", "--json").lines
    assert line["vehicle"] == "quad1"
    assert line["result"]["away"] <= 1.0
    assert sim.status().ned_m == pytest.approx((5.0, -3.0, -6.0), abs=1.2)
    do("goto", "quad1", "--at", "-35.363261", "149.165230", "--alt", "4", "--tolerance", "0.5")
    assert sim.status().ned_m == pytest.approx((0.0, 0.0, -4.0), abs=0.8)
    do("goto", "quad1", "--at", "-35.363261", "149.165330", "--amsl", "590", "--no-wait")
    do("goto", "quad1", "--to", "3,0,6", "--speed", "2.5", "--radius", "10", "--no-wait")
    assert do("do", "quad?", "hold").code == 0
    do("do", "quad1", "set_mode", "mode=loiter")
    assert sim.status().mode == "LOITER"
    (line,) = do("do", "quad1", "land", "--json").lines
    assert line == {"vehicle": "quad1", "result": {"armed": False}}
    assert not sim.status().armed
    do("do", "quad1", "set_mode", "mode=STABILIZE")
    vehicle.until(lambda s: bool(s.ready and not s.armed and s.mode == "STABILIZE"))


@pytest.mark.usefixtures("hurried")
def test_how_far_a_long_order_is_is_said_meanwhile(vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "EVERY", 0.0)
    do = vehicle.zmav
    do("do", "quad1", "arm")
    told = do("do", "quad1", "takeoff", "alt_rel=40")
    assert re.match(r"quad1: takeoff: at \d+\.\d m\n", told.err)
    assert told.out.startswith("quad1: takeoff done")
    assert do("do", "quad1", "land", "--json").err == "", "a script is told the end alone"


@pytest.mark.usefixtures("hurried")
def test_an_order_that_is_interrupted_says_that_the_vehicle_goes_on(vehicle: Vehicle, start: StartProcess) -> None:
    do = vehicle.zmav
    do("do", "quad1", "arm")
    do("do", "quad1", "takeoff", "alt_rel=5")
    goto = start("goto", "quad?", "--to", "0,900,5", "-e", vehicle.endpoint)
    goto.expect("m to go")
    assert goto.stop(signal.SIGINT) == 130
    assert "only the waiting has ended: quad1 goes on with goto. To stop there: zmav do 'quad?' hold" in goto.err
    vehicle.until(lambda s: bool(s.velocity and s.velocity[1] > 2.0))
    do("do", "quad1", "land")


@pytest.mark.parametrize(
    ("news", "text"),
    [
        ({"away": 123.4}, "123 m to go"),
        ({"waiting_for": ["GPS", "EKF"]}, "waits: GPS, EKF"),
        ({"stage": "autopilot", "waiting_for": "getting /a"}, "autopilot -> vehicle, waits: getting /a"),
        ({"stage": "autopilot", "checking": True}, "autopilot -> vehicle, the autopilot takes the checksum"),
        ({"stage": "autopilot", "bytes": 500, "size": 1000, "rate": 90}, "autopilot -> vehicle, 500 B, 90 B/s, 50%"),
        ({"stage": "network", "bytes": 10, "size": None, "rate": 0}, "vehicle <-> here, 10 B, 0 B/s"),
        ({"kind": "fence", "phase": "send", "done": 3, "of": 7}, "fence, send, 3/7"),
        ({"received": 30, "count": None}, "30/?"),
    ],
)
def test_progress_in_words(news: dict[str, Any], text: str) -> None:
    assert progress.words(news) == text


def test_a_refusal_ends_with_1_and_the_reason(start: StartProcess, vehicle: Vehicle) -> None:
    process = start("do", "quad1", "takeoff", "alt_rel=5", "-e", vehicle.endpoint)
    assert process.wait() == 1
    assert process.stdout == "quad1: takeoff not done: it is disarmed: arm it first"
    (line,) = vehicle.zmav.fails("do", "quad1", "takeoff", "alt_rel=5", "--json").lines
    assert (line["vehicle"], line["error"]) == ("quad1", "refused")


def test_a_bare_command_goes_beyond_the_usual_bounds_where_it_is_forced(vehicle: Vehicle) -> None:
    faster = ("command", "quad1", "DO_CHANGE_SPEED", "SpeedType=GROUNDSPEED", "Speed=40")
    assert "(--force) passes once" in vehicle.zmav.fails(*faster).out
    told = vehicle.zmav.fails(*faster, "--force").out
    assert (
        told == "quad1: command not done: MAV_CMD_DO_CHANGE_SPEED refused: FAILED\n"
    )  # by the autopilot, on the ground


def test_bad_arguments_are_named_before_anything_is_sent(vehicle: Vehicle) -> None:
    for arguments, field in (
        (("takeoff",), "alt_rel"),
        (("takeoff", "alt_rel=high"), "alt_rel"),
        (("takeoff", "alt_rel=5", "speed=3"), "speed"),
        (("goto", "pos=[1,2]"), "pos"),
        (("set_mode", "mode"), "mode"),
        (("set_mode", "=LOITER"), "=LOITER"),
    ):
        error = vehicle.zmav.fails("do", "quad1", *arguments).error
        assert isinstance(error, BadInput)
        assert error.detail["field"] == field
    (line,) = vehicle.zmav.fails("do", "quad1", "set_mode", "mode=HOVER", "--json").lines
    assert line["error"] == "bad_input"
    assert "LOITER" in line["message"]


def test_nobody_by_that_name(vehicle: Vehicle) -> None:
    error = vehicle.zmav.fails("do", "rover*", "hold").error
    assert isinstance(error, NoSuchVehicle)
    assert str(error) == "no vehicle matches 'rover*'; present: quad1"
    assert isinstance(vehicle.zmav.fails("do", "", "hold").error, BadInput)


def test_one_of_several_may_fail_and_all_are_told(vehicle: Vehicle, net: Net, patience: Patience) -> None:
    """A token without a vehicle behind it: the others do as they are told, and the end is 1."""
    patience(0.5)
    session, _ = net.router(vehicle.endpoint)
    with session.liveliness().declare_token("zmav/demo/quad9/alive/vehicle/9/px4/-/x"):
        end = time.monotonic() + PATIENCE_S
        while len(vehicle.zmav("ls", "--json", "--wait", "0.3").lines) < 2:
            assert time.monotonic() < end
        one, other = vehicle.zmav.fails("do", "*", "ping", "--json").lines
    assert (one["vehicle"], "t" in one["result"]) == ("quad1", True)
    assert (other["vehicle"], other["error"]) == ("quad9", "timed_out")


def test_send_a_message(vehicle: Vehicle) -> None:
    told = vehicle.zmav("send", "quad1", "SET_MODE", "base_mode=1", "custom_mode=5")
    assert told.out == "quad1: SET_MODE sent (18 bytes)\n"
    vehicle.until(lambda s: s.mode == "LOITER")
    vehicle.zmav("send", "quad*", "SET_MODE", "base_mode=1", "custom_mode=0")
    vehicle.until(lambda s: s.mode == "STABILIZE")


def test_send_and_fly_hear_what_is_refused_among_others_words(vehicle: Vehicle, net: Net) -> None:
    """Events without end, every other one no event at all."""
    session, endpoint = net.router(vehicle.endpoint)
    event = wire.encode(wire.Event(t=0.0, kind="statustext", severity="info", text="words"))
    words = itertools.cycle((b"{", event))
    with contextlib.closing(Speaker(session, endpoint)) as speaker:
        speaker.say("zmav/demo/quad1/event", lambda: next(words))
        told = vehicle.zmav("send", "quad1", "SET_MODE", "base_mode=1", "custom_mode=0")
        assert told.out == "quad1: SET_MODE sent (18 bytes)\n"
        told = vehicle.zmav.fails("send", "quad1", "SET_MODE", "base_mode=1", "custom_mode=9", "target_system=9")
        assert "its target_system is 9" in told.err
        error = vehicle.zmav.fails("fly", "quad1", "--vel", "0,0,999", "--for", "1").error
    assert isinstance(error, Refused)
    assert error.detail["reasons"]


def test_send_says_what_is_wrong(vehicle: Vehicle, net: Net) -> None:
    error = vehicle.zmav.fails("send", "quad1", "SET_MODE", "base_mode=one", "colour=3").error
    assert isinstance(error, BadMessage)
    assert set(error.detail["fields"]) == {"base_mode", "colour", "custom_mode"}
    assert "did you mean SET_MODE" in str(vehicle.zmav.fails("send", "quad1", "SETMODE").error)
    before = vehicle.sim.status().mode
    told = vehicle.zmav.fails("send", "quad1", "SET_MODE", "base_mode=1", "custom_mode=9", "target_system=9")
    assert "its target_system is 9" in told.err
    assert vehicle.sim.status().mode == before != "LAND"
    session, endpoint = net.router()
    with session.liveliness().declare_token("zmav/demo/quad9/alive/vehicle/9/px4/-/x"):
        error = vehicle.zmav.fails("send", "quad[19]", "SET_MODE", "base_mode=1", "custom_mode=5", "-e", endpoint).error
    assert isinstance(error, (Stale, NoSuchVehicle))
