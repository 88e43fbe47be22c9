"""From a :class:`~zmav.autopilots.base.Target` to MAVLink: one level a function; each stack says which ones it takes.

Messages: https://mavlink.io/en/messages/common.html; off-board control: https://mavlink.io/en/services/offboard_control.html
"""

from __future__ import annotations

from collections.abc import Sequence

from zmav.autopilots.base import NAN, Action, Command, Message, Target, reposition
from zmav.errors import Unsupported

POSITION, VELOCITY, ACCELERATION = 0b111, 0b111_000, 0b111_000_000
YAW, YAW_RATE = 1 << 10, 1 << 11
LOCAL_NED, GLOBAL_INT, GLOBAL_RELATIVE_ALT_INT = 1, 5, 6
RATES, ATTITUDE = 0b111, 1 << 7
"""ATTITUDE_TARGET_TYPEMASK: a set bit leaves that part out"""
LEVEL, ZERO = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
STICK, RELEASED_STICK = 1000.0, 32767
KEEP, FREE_LOW, FREE_HIGH = 65535, 0, 65534
"""RC_CHANNELS_OVERRIDE: leave alone; give back to the radio, channels 1 to 8 and from 9 up"""
LOW_CHANNELS, MAX_CHANNELS = 8, 18
VELOCITY_LAG = 0.35
"""s that ArduCopter's velocity is behind what it is asked for: without it, it was 0.8 m off in a turn at 1.3 m/s²"""


def position_target(target: Target) -> Message:
    """SET_POSITION_TARGET_GLOBAL_INT where a position is given, else SET_POSITION_TARGET_LOCAL_NED.

    The global message keeps the vehicle's own start out of it; velocities and accelerations need no origin.
    """
    parts = ((target.vel, VELOCITY), (target.acc, ACCELERATION), (target.yaw, YAW), (target.yaw_rate, YAW_RATE))
    mask = sum(bits for part, bits in parts if part is None)
    motion = zip(("vx", "vy", "vz", "afx", "afy", "afz"), (*(target.vel or ZERO), *(target.acc or ZERO)), strict=True)
    common = {**dict(motion), "yaw": target.yaw or 0.0, "yaw_rate": target.yaw_rate or 0.0}
    if target.lat_deg is None or target.lon_deg is None:
        fields = {"coordinate_frame": LOCAL_NED, "type_mask": mask | POSITION, **common}
        return Message("SET_POSITION_TARGET_LOCAL_NED", fields)
    relative = target.alt_amsl is None
    place = {
        "coordinate_frame": GLOBAL_RELATIVE_ALT_INT if relative else GLOBAL_INT,
        "type_mask": mask,
        "lat_int": round(target.lat_deg * 1e7),
        "lon_int": round(target.lon_deg * 1e7),
        "alt": (target.alt_rel if relative else target.alt_amsl) or 0.0,
    }
    return Message("SET_POSITION_TARGET_GLOBAL_INT", {**place, **common})


def stop() -> Message:
    """A velocity target of zero."""
    return position_target(Target(vel=ZERO))


def motion(target: Target) -> list[Action]:
    """Position, velocity, acceleration and any mixture of them that the autopilot takes as it is."""
    return [position_target(target)]


def position_and_velocity(target: Target) -> list[Action]:
    """A trajectory for who takes a global position alone or with a velocity, but never with an acceleration.

    Its velocity loop is behind by :data:`VELOCITY_LAG`; with the velocity of so much later it keeps to the position.
    """
    vel, acc = target.vel, target.acc
    if vel is not None and acc is not None:
        vel = (vel[0] + VELOCITY_LAG * acc[0], vel[1] + VELOCITY_LAG * acc[1], vel[2] + VELOCITY_LAG * acc[2])
    return [position_target(_place(target, vel=vel))]


def position_only(target: Target) -> list[Action]:
    """A trajectory for who goes to a position in its own way."""
    return [position_target(_place(target))]


def _place(target: Target, vel: tuple[float, float, float] | None = None) -> Target:
    return Target(
        target.lat_deg,
        target.lon_deg,
        target.alt_amsl,
        target.alt_rel,
        vel=vel,
        yaw=target.yaw,
        yaw_rate=target.yaw_rate,
    )


def ground_velocity(target: Target) -> list[Action]:
    """A velocity over the ground, whose direction is the heading too.

    A heading beside it would turn the sign of a rover's speed, and zero would have it face north: it is told to turn
    at no rate instead.
    """
    vx, vy, _ = target.vel or (0.0, 0.0, 0.0)
    still = abs(vx) < 0.01 and abs(vy) < 0.01
    yaw_rate = (target.yaw_rate or 0.0) if still else None
    return [position_target(Target(vel=(0.0, 0.0, 0.0) if still else (vx, vy, 0.0), yaw_rate=yaw_rate))]


def circle_at(target: Target) -> list[Action]:
    """A point for a plane to circle, never changing the mode; its heading is its own affair."""
    place = Target(target.lat_deg, target.lon_deg, target.alt_amsl, target.alt_rel)
    return [reposition(place, change_mode=False)]


def attitude_and_rates(target: Target) -> list[Action]:
    """SET_ATTITUDE_TARGET: attitude and thrust, body rates fed forward where they are given."""
    return [_attitude(target, 0 if target.rates else RATES)]


def attitude(target: Target) -> list[Action]:
    """SET_ATTITUDE_TARGET: attitude and thrust."""
    return [_attitude(target, RATES)]


def rates(target: Target) -> list[Action]:
    """SET_ATTITUDE_TARGET: body rates and thrust."""
    return [_attitude(target, ATTITUDE)]


def torques(target: Target) -> list[Action]:
    """SET_ACTUATOR_CONTROL_TARGET: roll, pitch and yaw torque and thrust, as PX4's control group 0 has them."""
    controls = (*(target.torque or ZERO), target.thrust or 0.0, 0.0, 0.0, 0.0, 0.0)
    return [Message("SET_ACTUATOR_CONTROL_TARGET", {"time_usec": 0, "group_mlx": 0, "controls": controls})]


def _attitude(target: Target, mask: int) -> Message:
    p, q, r = ZERO if mask == RATES or target.rates is None else target.rates
    turning = {"body_roll_rate": p, "body_pitch_rate": q, "body_yaw_rate": r}
    fields = {"type_mask": mask, "q": target.attitude or LEVEL, **turning, "thrust": target.thrust or 0.0}
    return Message("SET_ATTITUDE_TARGET", fields)


def sticks(target: Target, lowest: float = 0.0) -> list[Action]:
    """MANUAL_CONTROL, thrust from 0 to 1000."""
    m = target.manual
    assert m is not None
    axes = {"x": m.x * STICK, "y": m.y * STICK, "z": lowest + m.z * (STICK - lowest), "r": m.r * STICK}
    return [Message("MANUAL_CONTROL", {**{axis: round(at) for axis, at in axes.items()}, "buttons": m.buttons})]


def sticks_both_ways(target: Target) -> list[Action]:
    """MANUAL_CONTROL for who drives backwards too: the middle of the thrust stick is a stop."""
    return sticks(target, -STICK)


def released_sticks() -> Message:
    """MANUAL_CONTROL that gives every axis back: INT16_MAX is an invalid axis."""
    return Message("MANUAL_CONTROL", dict.fromkeys("xyzr", RELEASED_STICK))


def rc_override(target: Target) -> list[Action]:
    """RC_CHANNELS_OVERRIDE; what is not given goes back to the pilot's radio."""
    return [_override(target.rc or ())]


def rc_whole(target: Target) -> list[Action]:
    """RC_CHANNELS_OVERRIDE for who takes it as a radio of its own, with so many channels as are given."""
    channels = target.rc or ()
    if None in channels:
        number = channels.index(None) + 1
        text = f"rc channel {number} is missing: an override is the whole radio here, every channel from 1 on"
        raise Unsupported(text, field="rc", value=number, expected="no null among the channels")
    fields = {f"chan{i + 1}_raw": channels[i] if i < len(channels) else KEEP for i in range(MAX_CHANNELS)}
    return [Message("RC_CHANNELS_OVERRIDE", fields)]


def rc_override_16(target: Target) -> list[Action]:
    """As :func:`rc_override`, for who reads the first sixteen channels only."""
    for number, pwm in enumerate(target.rc or (), 1):
        if number > 16 and pwm is not None:
            raise Unsupported(f"rc channel {number} cannot be overridden: the autopilot takes 1 to 16", field="rc")
    return [_override((target.rc or ())[:16])]


def released_rc() -> Message:
    """RC_CHANNELS_OVERRIDE that gives every channel back to the radio."""
    return _override(())


def _override(channels: tuple[int | None, ...]) -> Message:
    fields = {}
    for i in range(MAX_CHANNELS):
        pwm = channels[i] if i < len(channels) else None
        fields[f"chan{i + 1}_raw"] = pwm if pwm is not None else FREE_LOW if i < LOW_CHANNELS else FREE_HIGH
    return Message("RC_CHANNELS_OVERRIDE", fields)


def servos(target: Target) -> list[Action]:
    """DO_SET_SERVO for each output given."""
    return [
        Command("MAV_CMD_DO_SET_SERVO", (float(number), float(pwm)))
        for number, pwm in enumerate(target.servo or (), 1)
        if pwm is not None
    ]


def actuators(target: Target) -> list[Action]:
    """One DO_SET_ACTUATOR for the first six outputs."""
    return [actuator_command(target.servo or ())]


def actuator_command(outputs: Sequence[int | None]) -> Command:
    """DO_SET_ACTUATOR: 1000 to 2000 µs become -1 to 1, NaN leaves an output alone."""
    values = [NAN] * 6
    for number, pwm in enumerate(outputs, 1):
        if pwm is None:
            continue
        if number > len(values):
            raise Unsupported(f"servo output {number} cannot be set: DO_SET_ACTUATOR takes 1 to 6", field="servo")
        values[number - 1] = min(max((pwm - 1500) / 500.0, -1.0), 1.0)
    return Command("MAV_CMD_DO_SET_ACTUATOR", (*values, 0.0))
