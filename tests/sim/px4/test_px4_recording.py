"""The simulated PX4 beside the recording of a real one (1.16.1, SIH): the steps of its states, its events, and how long
each part takes, and what the messages hold.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sim.yardstick.flights import px4
from tests.sim.yardstick.measure import only_what_is_explained_differs
from tests.sim.yardstick.reading import Message, from_tlog, rates, states
from zmav.sim.protocol.px4.node import px4_dialect

# What the real one sends once in a while and this one has no part of.
NOT_SENT = {
    "COMMAND_LONG": "PX4 steers a gimbal that is not there when it begins to land",
    "OPEN_DRONE_ID_LOCATION": "nobody on the link reads it",
    "OPEN_DRONE_ID_SYSTEM": "the same",
    "TIME_ESTIMATE_TO_TARGET": "the same",
}
# Sent only in some phases, so that their mean rate depends on how long these were; and what is sent when it happens.
PHASED = {"POSITION_TARGET_LOCAL_NED", "POSITION_TARGET_GLOBAL_INT", "COMMAND_ACK", "EVENT", "CURRENT_EVENT_SEQUENCE"}


@pytest.fixture(scope="module")
def real(shared_data: Path) -> list[Message]:
    return list(from_tlog(shared_data / "px4.tlog", px4_dialect()))


@pytest.fixture(scope="module")
def ours() -> list[Message]:
    return px4()


def first(messages: list[Message], name: str, after: float = 0.0, **fields: int) -> float:
    return next(
        at for at, each, values in messages if each == name and at >= after and fields.items() <= values.items()
    )


def test_only_what_is_explained_differs(real: list[Message], ours: list[Message]) -> None:
    only_what_is_explained_differs("px4", real, ours)


def test_the_flight_looks_the_same(real: list[Message], ours: list[Message]) -> None:
    expected, found = {name for _, name, _ in real}, {name for _, name, _ in ours}
    assert expected - found == NOT_SENT.keys()
    assert found <= expected
    # The real one ran 1.5 % slower than its own clock.
    steady = [{k: v for k, v in rates(x).items() if k not in PHASED | NOT_SENT.keys()} for x in (ours, real)]
    assert steady[0] == pytest.approx(steady[1], rel=0.05)
    for name, fields in {
        "HEARTBEAT": ("type", "base_mode", "custom_mode", "system_status"),
        "EXTENDED_SYS_STATE": ("landed_state",),
        "SYS_STATUS": (
            "onboard_control_sensors_present",
            "onboard_control_sensors_enabled",
            "onboard_control_sensors_health",
        ),
        "CURRENT_MODE": ("standard_mode", "custom_mode", "intended_custom_mode"),
        "POSITION_TARGET_GLOBAL_INT": ("type_mask", "coordinate_frame"),
        "ATTITUDE_TARGET": ("type_mask",),
        "MISSION_CURRENT": ("seq", "total", "mission_state"),
        "GPS_RAW_INT": ("fix_type", "satellites_visible"),
    }.items():
        assert states(ours, name, *fields)[-8:] == states(real, name, *fields)[-8:], name
    assert states(ours, "COMMAND_ACK", "command", "result") == states(real, "COMMAND_ACK", "command", "result")

    def events(messages: list[Message]) -> list[tuple[str, int, str]]:
        told = [v for _, name, v in messages if name == "EVENT"]
        return [(hex(v["id"]), v["log_levels"], bytes(v["arguments"]).rstrip(b"\0").hex()) for v in told]

    assert events(ours) == events(real)


def test_it_takes_as_long(real: list[Message], ours: list[Message]) -> None:
    def times(messages: list[Message]) -> dict[str, float]:
        armed = first(messages, "EVENT", id=0x0190CAF3)
        lifted = first(messages, "EVENT", id=0x01414569)
        held = first(messages, "EXTENDED_SYS_STATE", after=lifted, landed_state=2)
        lost = first(messages, "EVENT", id=0x01DEDBD0)
        landing = first(messages, "EXTENDED_SYS_STATE", landed_state=4)
        landed = first(messages, "EVENT", id=0x019638AC)
        disarmed = first(messages, "EVENT", id=0x01F46777)
        return {
            "arming to takeoff": lifted - armed,
            "to HOLD": held - lifted,
            "landing": landed - lost,
            "to the state of landing": landing - lost,
            "disarming": disarmed - landed,
        }

    expected, found = times(real), times(ours)
    tolerance = {
        "arming to takeoff": 0.3,
        "to HOLD": 1.0,
        "landing": 2.5,  # the real one's estimate of its height wanders: it takes longer to be sure of the ground
        "to the state of landing": 1.3,
        "disarming": 0.2,
    }
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=tolerance[name]), name


def test_a_step_of_the_position_is_answered_alike(real: list[Message], ours: list[Message]) -> None:
    """8 m to the north: how fast it gets, and how long it takes to be within a metre."""

    def answer(messages: list[Message]) -> tuple[float, float]:
        track = [(at, v["x"], v["vx"]) for at, name, v in messages if name == "LOCAL_POSITION_NED"]
        start = next(i for i, (_, x, vx) in enumerate(track) if vx > 1.0 and x < 2.0)
        there = next(i for i in range(start, len(track)) if track[i][1] > 7.0)
        return max(vx for _, _, vx in track[start:there]), track[there][0] - track[start][0]

    (speed, took), (real_speed, real_took) = answer(ours), answer(real)
    assert speed == pytest.approx(real_speed, rel=0.4)
    assert took == pytest.approx(real_took, rel=0.4)
