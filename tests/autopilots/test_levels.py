"""Every level of authority as each autopilot wants it: the messages' fields, and what is refused with which reason.

What is expected here was read in the autopilots' own handlers (ArduPilot's GCS_MAVLink_*.cpp, PX4's
mavlink_receiver.cpp) and in https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import math
from typing import Any

import pytest

from zmav import wire
from zmav.autopilots import Autopilot, Command, Message, Target, autopilot_for
from zmav.autopilots.convert import VELOCITY_LAG
from zmav.errors import Unsupported
from zmav.mavlink import Packer, decode, load_dialect, parse_frame

ARDUPILOT, PX4, OTHER = 3, 12, 0
COPTER, PLANE, ROVER, BOAT, VTOL = 2, 1, 10, 11, 20
LOCAL, GLOBAL, ATTITUDE = "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET"
PLACE: dict[str, Any] = {"lat_deg": -35.3632610, "lon_deg": 149.1652300, "alt_rel": 10.0}
LEVELS: dict[str, Target] = {
    "position": Target(**PLACE),
    "velocity": Target(vel=(1.0, 2.0, -0.5)),
    "acceleration": Target(acc=(0.5, 0.0, 0.0)),
    "trajectory": Target(**PLACE, vel=(1.0, 0.0, 0.0), acc=(0.1, 0.0, 0.0)),
    "attitude": Target(attitude=(1.0, 0.0, 0.0, 0.0), thrust=0.5),
    "rates": Target(rates=(0.1, 0.2, 0.3), thrust=0.5),
    "torque": Target(torque=(0.1, 0.0, 0.0), thrust=0.5),
    "manual": Target(manual=wire.ManualControl(x=1.0, y=-0.5, z=0.25, r=0.1, buttons=5)),
    "rc": Target(rc=(1500, 1600, 1000, 1500)),
    "servo": Target(servo=(None, None, 1200)),
}


def of(stack: int, mav_type: int) -> Autopilot:
    return autopilot_for(stack, mav_type)


def sent(autopilot: Autopilot, target: Target) -> dict[str, Any]:
    """The one message's fields as they come out at the other end of a link, with its name."""
    (message,) = autopilot.setpoint(target)
    assert isinstance(message, Message)
    return {"name": message.name, **over_the_link(message)}


def over_the_link(message: Message) -> dict[str, Any]:
    dialect = load_dialect()
    data = Packer(dialect, 1, 191).pack(message.name, **message.addressed(7, 1))
    fields = decode(parse_frame(data, dialect), dialect)
    assert fields.get("target_system", fields.get("target")) == 7
    return fields


def ordered(autopilot: Autopilot, target: Target) -> list[Command]:
    commands = []
    for action in autopilot.setpoint(target):
        assert isinstance(action, Command)
        commands.append(action)
    return commands


@pytest.mark.parametrize(("level", "target"), LEVELS.items())
def test_the_level_of_a_target(level: str, target: Target) -> None:
    assert target.level == level


# Masks as ArduCopter's handler takes them: every part is left out whole or given whole.
@pytest.mark.parametrize(
    ("target", "name", "mask"),
    [
        (LEVELS["position"], GLOBAL, 0xDF8),
        (Target(**PLACE, yaw=1.0), GLOBAL, 0x9F8),
        (Target(**PLACE, yaw_rate=0.1), GLOBAL, 0x5F8),
        (LEVELS["velocity"], LOCAL, 0xDC7),
        (Target(vel=(1.0, 0.0, 0.0), acc=(0.1, 0.0, 0.0)), LOCAL, 0xC07),
        (LEVELS["acceleration"], LOCAL, 0xC3F),
        # A global position with an acceleration alone beside it stops the copter; with a velocity too it is left out.
        (LEVELS["trajectory"], GLOBAL, 0xDC0),
        (Target(**PLACE, acc=(0.1, 0.0, 0.0)), GLOBAL, 0xDF8),
    ],
)
def test_arducopter_motion(target: Target, name: str, mask: int) -> None:
    fields = sent(of(ARDUPILOT, COPTER), target)
    assert (fields["name"], fields["type_mask"]) == (name, mask)
    assert fields["coordinate_frame"] == (6 if name == GLOBAL else 1)
    if target.vel and target.level != "trajectory":
        assert (fields["vx"], fields["vy"], fields["vz"]) == target.vel


def test_arducopter_gets_the_velocity_of_a_trajectory_early_for_it_takes_no_acceleration() -> None:
    fields = sent(of(ARDUPILOT, COPTER), Target(**PLACE, vel=(1.0, 2.0, -0.5), acc=(2.0, -1.0, 0.0)))
    ahead = (1.0 + 2.0 * VELOCITY_LAG, 2.0 - VELOCITY_LAG, -0.5)
    assert (fields["vx"], fields["vy"], fields["vz"]) == pytest.approx(ahead)
    assert VELOCITY_LAG > 0.1


def test_a_global_position() -> None:
    target = Target(51.5, -179.9999999, alt_amsl=100.25, yaw=-1.5)
    fields = sent(of(ARDUPILOT, COPTER), target)
    assert (fields["coordinate_frame"], fields["lat_int"], fields["lon_int"]) == (5, 515000000, -1799999999)
    assert (fields["alt"], fields["yaw"]) == (100.25, -1.5)


def test_arducopter_attitude_carries_all_rates_or_none() -> None:
    autopilot = of(ARDUPILOT, COPTER)
    q = (math.cos(0.1), math.sin(0.1), 0.0, 0.0)
    fields = sent(autopilot, Target(attitude=q, thrust=0.6))
    assert (fields["name"], fields["type_mask"], fields["thrust"]) == (ATTITUDE, 0x07, pytest.approx(0.6))
    assert fields["q"] == pytest.approx(q)
    fields = sent(autopilot, Target(attitude=q, rates=(0.1, 0.2, 0.3), thrust=0.6))
    assert fields["type_mask"] == 0
    rates = [fields[f"body_{axis}_rate"] for axis in ("roll", "pitch", "yaw")]
    assert rates == pytest.approx([0.1, 0.2, 0.3])
    assert sent(autopilot, LEVELS["rates"])["type_mask"] == 0x80


@pytest.mark.parametrize("stack", [ARDUPILOT, PX4])
def test_sticks(stack: int) -> None:
    fields = sent(of(stack, COPTER), LEVELS["manual"])
    assert fields["name"] == "MANUAL_CONTROL"
    assert [fields[name] for name in ("target", "x", "y", "z", "r", "buttons")] == [7, 1000, -500, 250, 100, 5]


def test_the_middle_of_a_rover_s_throttle_stick_is_a_stop() -> None:
    rover = of(ARDUPILOT, ROVER)
    assert sent(rover, Target(manual=wire.ManualControl()))["z"] == 0
    assert sent(rover, Target(manual=wire.ManualControl(z=1.0)))["z"] == 1000
    assert sent(rover, Target(manual=wire.ManualControl(z=0.0)))["z"] == -1000


def test_ardupilot_rc_gives_back_what_is_not_given() -> None:
    autopilot = of(ARDUPILOT, COPTER)
    fields = sent(autopilot, Target(rc=(1100, None, 1900, *[None] * 7, 1300)))
    low, high = [fields[f"chan{i}_raw"] for i in range(1, 9)], [fields[f"chan{i}_raw"] for i in range(9, 19)]
    assert low == [1100, 0, 1900, 0, 0, 0, 0, 0]
    assert high == [65534, 65534, 1300, *[65534] * 7]
    with pytest.raises(Unsupported, match="channel 17"):
        autopilot.setpoint(Target(rc=(*[None] * 16, 1500)))


def test_px4_rc_is_a_whole_radio() -> None:
    autopilot = of(PX4, COPTER)
    fields = sent(autopilot, LEVELS["rc"])
    channels = [fields[f"chan{i}_raw"] for i in range(1, 19)]
    assert channels == [1500, 1600, 1000, 1500, *[65535] * 14]
    with pytest.raises(Unsupported, match="channel 2 is missing"):
        autopilot.setpoint(Target(rc=(1500, None, 1500)))


def test_servo_outputs() -> None:
    commands = ordered(of(ARDUPILOT, COPTER), Target(servo=(None, 1200, None, 1900)))
    assert [(c.name, c.params) for c in commands] == [
        ("MAV_CMD_DO_SET_SERVO", (2.0, 1200.0)),
        ("MAV_CMD_DO_SET_SERVO", (4.0, 1900.0)),
    ]
    (command,) = ordered(of(PX4, COPTER), Target(servo=(1000, None, 1500, 1750, None, 2200)))
    assert command.name == "MAV_CMD_DO_SET_ACTUATOR"
    one, two, three, four, five, six, index = command.params
    assert (one, three, four, six, index) == (-1.0, 0.0, 0.5, 1.0, 0.0)
    assert math.isnan(two) and math.isnan(five)
    with pytest.raises(Unsupported, match="output 7"):
        of(PX4, COPTER).setpoint(Target(servo=(*[None] * 6, 1500)))


@pytest.mark.parametrize("mav_type", [ROVER, BOAT])
def test_ardurover_motion(mav_type: int) -> None:
    rover = of(ARDUPILOT, mav_type)
    assert sent(rover, LEVELS["trajectory"])["type_mask"] == 0xDF8
    # A heading beside a velocity turns the sign of its speed by vx: the velocity alone says where to go.
    fields = sent(rover, Target(vel=(-1.0, 0.5, 3.0), yaw=2.0, yaw_rate=0.2))
    assert (fields["type_mask"], fields["vx"], fields["vy"], fields["vz"]) == (0xDC7, -1.0, 0.5, 0.0)
    # Zero alone would have it turn to the north.
    fields = sent(rover, Target(vel=(0.0, 0.0, 0.0)))
    assert (fields["type_mask"], fields["yaw_rate"]) == (0x5C7, 0.0)
    fields = sent(rover, Target(vel=(0.0, 0.0, 0.0), yaw_rate=0.5))
    assert (fields["type_mask"], fields["yaw_rate"]) == (0x5C7, 0.5)
    # With a yaw rate that is not left out, the quaternion would not be looked at.
    assert sent(rover, Target(attitude=(1.0, 0.0, 0.0, 0.0), rates=(0.0, 0.0, 1.0), thrust=0.3))["type_mask"] == 0x07


@pytest.mark.parametrize("mav_type", [PLANE, VTOL])
def test_arduplane_circles_and_never_changes_the_mode(mav_type: int) -> None:
    plane = of(ARDUPILOT, mav_type)
    (command,) = ordered(plane, Target(**PLACE, yaw=1.0))
    assert (command.name, command.frame) == ("MAV_CMD_DO_REPOSITION", "MAV_FRAME_GLOBAL_RELATIVE_ALT")
    speed, flags, radius, yaw, lat, lon, alt = command.params
    assert (speed, flags, radius, lat, lon, alt) == (-1.0, 0.0, 0.0, -353632610, 1491652300, 10.0)
    assert math.isnan(yaw), "a heading is taken for the direction to circle in"
    assert sent(plane, LEVELS["attitude"])["type_mask"] == 0x07


def test_px4_multicopter() -> None:
    px4 = of(PX4, COPTER)
    fields = sent(px4, LEVELS["trajectory"])
    assert (fields["name"], fields["type_mask"], fields["afx"]) == (GLOBAL, 0xC00, pytest.approx(0.1))
    assert sent(px4, LEVELS["velocity"])["type_mask"] == 0xDC7
    assert sent(px4, LEVELS["acceleration"])["type_mask"] == 0xC3F
    # Rates beside an attitude would be published as setpoints of their own.
    assert sent(px4, Target(attitude=(1.0, 0.0, 0.0, 0.0), rates=(1.0, 0.0, 0.0), thrust=0.5))["type_mask"] == 0x07
    assert sent(px4, LEVELS["rates"])["type_mask"] == 0x80


def test_a_px4_on_its_way_in_hold_is_stopped_by_a_reposition_to_nowhere() -> None:
    """It flies a reposition in HOLD: entering HOLD again would let it fly on."""
    px4 = of(PX4, COPTER)
    assert px4.hold()[0] == "HOLD"
    assert px4.pause is not None
    assert (px4.pause.name, px4.pause.params[1]) == ("MAV_CMD_DO_REPOSITION", 1.0)
    assert all(math.isnan(p) for p in px4.pause.params[3:])
    assert of(ARDUPILOT, COPTER).pause is None


@pytest.mark.parametrize(
    ("stack", "mav_type", "refused"),
    [
        (ARDUPILOT, COPTER, {"torque"}),
        (ARDUPILOT, ROVER, {"torque", "acceleration"}),
        (ARDUPILOT, PLANE, {"torque", "acceleration", "velocity", "trajectory", "rates"}),
        (PX4, COPTER, {"torque"}),
        (PX4, PLANE, {"torque", "acceleration", "velocity"}),
        (PX4, ROVER, {"torque", "acceleration"}),
        (OTHER, COPTER, {"torque"}),
    ],
)
def test_what_is_refused_says_why(stack: int, mav_type: int, refused: set[str]) -> None:
    autopilot = of(stack, mav_type)
    for level, target in LEVELS.items():
        if level in refused:
            with pytest.raises(Unsupported) as caught:
                autopilot.setpoint(target)
            assert len(str(caught.value)) > 30
            assert level not in caught.value.detail["expected"].split(", ")
            with pytest.raises(Unsupported):
                autopilot.guided_for(target)
        else:
            assert autopilot.setpoint(target)


def test_torques_go_to_the_px4_that_says_it_takes_them() -> None:
    px4 = of(PX4, COPTER).told(0xE8FF | 0x400)
    fields = sent(px4, Target(torque=(0.1, -0.2, 0.3), thrust=0.5))
    assert (fields["name"], fields["group_mlx"]) == ("SET_ACTUATOR_CONTROL_TARGET", 0)
    assert fields["controls"] == pytest.approx([0.1, -0.2, 0.3, 0.5, 0, 0, 0, 0])
    assert px4.guided_for(LEVELS["torque"]) == "OFFBOARD"
    with pytest.raises(Unsupported, match=r"1\.14 dropped"):
        px4.told(0xE8FF).setpoint(LEVELS["torque"])
    with pytest.raises(Unsupported):
        of(ARDUPILOT, COPTER).told(0x400).setpoint(LEVELS["torque"])


def test_the_mode_that_follows() -> None:
    for stack, mode in ((ARDUPILOT, "GUIDED"), (PX4, "OFFBOARD")):
        autopilot = of(stack, COPTER)
        modes = {level: autopilot.guided_for(t) for level, t in LEVELS.items() if level != "torque"}
        sticks = modes.pop("manual")
        assert sticks == ("POSCTL" if stack is PX4 else None)  # in HOLD PX4 moves nothing by them
        assert {level for level, each in modes.items() if each is None} == {"rc", "servo"}
        assert {each for each in modes.values() if each is not None} == {mode}
    assert of(OTHER, COPTER).guided_for(LEVELS["manual"]) is None
    assert (of(PX4, COPTER).engage_after, of(ARDUPILOT, COPTER).engage_after) == (1.0, 0.0)
    assert of(PX4, COPTER).keepalive_hz > 2.0 > 1.0 / 3.0 < of(ARDUPILOT, COPTER).keepalive_hz


def test_what_is_given_back() -> None:
    autopilot = of(ARDUPILOT, COPTER)
    (message,) = autopilot.release(LEVELS["rc"])
    fields = over_the_link(message)
    assert [fields[f"chan{i}_raw"] for i in range(1, 19)] == [0] * 8 + [65534] * 10
    (message,) = autopilot.release(LEVELS["manual"])
    fields = over_the_link(message)
    assert [fields[axis] for axis in "xyzr"] == [32767] * 4
    assert autopilot.release(LEVELS["velocity"]) == autopilot.release(LEVELS["servo"]) == []
    assert of(PX4, COPTER).release(LEVELS["rc"]) == []


def test_what_a_level_needs_of_the_parameters() -> None:
    def unmet(autopilot: Autopilot, level: str, **params: float) -> list[str | None]:
        return [need.unmet(params.get, 7) for need in autopilot.needs(LEVELS[level])]

    copter = of(ARDUPILOT, COPTER)
    for level in ("manual", "rc"):
        (why,) = unmet(copter, level, MAV_GCS_SYSID=255.0)
        assert why is not None and why.endswith("set MAV_GCS_SYSID to 7 (it is 255)")
        assert unmet(copter, level, SYSID_MYGCS=7.0) == [None]
        assert unmet(copter, level) == [None], "what is not known is not held against it"
        assert copter.needs(LEVELS[level])[0].fatal
    (why,) = unmet(copter, "attitude", GUID_OPTIONS=1.0)
    assert why is not None and "set GUID_OPTIONS to 9" in why
    assert unmet(copter, "rates", GUID_OPTIONS=8.0) == [None]
    assert unmet(of(ARDUPILOT, ROVER), "attitude", GUID_OPTIONS=0.0) == []
    (why,) = unmet(of(PX4, COPTER), "manual", COM_RC_IN_MODE=0.0)
    assert why is not None and "set COM_RC_IN_MODE to 2" in why
    assert unmet(of(PX4, COPTER), "manual", COM_RC_IN_MODE=3.0) == [None]
    assert unmet(copter, "velocity") == []


@pytest.mark.parametrize("mav_type", [COPTER, PLANE, ROVER, BOAT, VTOL])
@pytest.mark.parametrize("stack", [ARDUPILOT, PX4])
def test_the_ladder_s_modes_are_modes(stack: int, mav_type: int) -> None:
    autopilot = of(stack, mav_type)
    for name in (autopilot.loiter(), autopilot.rtl(), autopilot.hold()[0], autopilot.guided):
        assert name in autopilot.modes()


def test_what_px4_misses() -> None:
    healthy, sick = ({"SYS_STATUS": {"onboard_control_sensors_health": bit}} for bit in (0x10000000, 0))
    hold, offboard = ({"HEARTBEAT": {"base_mode": 1, "custom_mode": mode}} for mode in (0x3040000, 0x60000))

    def missing(*heard: dict[str, dict[str, int]]) -> list[str]:
        latest = {name: fields for each in heard for name, fields in each.items()}
        return of(PX4, COPTER).missing(lambda name: latest.get(name))

    assert missing(healthy, offboard) == []
    assert missing(sick, hold) == missing(sick) == ["pre-arm checks fail"]
    assert "enter another mode" in missing(sick, offboard)[0]
    assert missing() == ["SYS_STATUS not heard"]
    px4 = of(PX4, COPTER)
    assert px4.missing(sick.get, ["no fix", "no home"]) == ["no fix", "no home"]
    assert px4.missing({**sick, **offboard}.get, ["no fix"]) == [
        "no fix (in OFFBOARD without a stream: enter another mode, such as HOLD)"
    ]
    assert px4.missing(healthy.get, ["what was said before"]) == []
