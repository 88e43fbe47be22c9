"""The supervisor's own parameters: the envelope, what full sticks ask for, how often signals are told."""

from __future__ import annotations

from zmav.agent import Tunable

TUNABLES: dict[str, Tunable] = {
    "guard_tilt_deg": Tunable(60.0, 5.0, 85.0, "deg", "of tilt at most"),
    "guard_rate_dps": Tunable(400.0, 30.0, 1500.0, "deg/s", "about any axis at most"),
    "guard_low": Tunable(1.0, -1000.0, 1000.0, "m", "above home at least"),
    "guard_high": Tunable(120.0, 1.0, 10000.0, "m", "above home at most"),
    "guard_radius": Tunable(100.0, 1.0, 10000.0, "m", "over the ground from where it took over, at most"),
    "guard_error": Tunable(5.0, 0.1, 100.0, "m", "off a reference of positions at most"),
    "guard_error_deg": Tunable(60.0, 5.0, 180.0, "deg", "off a reference of attitudes at most"),
    "guard_late": Tunable(8.0, 2.0, 25.0, "cycles", "in a row without an output at most"),
    "stick_tilt_deg": Tunable(35.0, 5.0, 60.0, "deg", "of the full stick"),
    "stick_yaw_dps": Tunable(120.0, 10.0, 400.0, "deg/s", "of the full stick"),
    "stick_rate_dps": Tunable(220.0, 10.0, 720.0, "deg/s", "of roll and pitch of the full stick"),
    "stick_speed": Tunable(3.0, 0.2, 15.0, "m/s", "of the full stick"),
    "stick_climb": Tunable(1.5, 0.2, 5.0, "m/s", "of the full stick"),
    "signals_hz": Tunable(50.0, 1.0, 500.0, "Hz", "of the stream of signals"),
}


def usual() -> dict[str, float]:
    """Each of them by its name, in its own unit: what guard and references go by, and what is changed in flight."""
    return {name: each.default for name, each in TUNABLES.items()}
