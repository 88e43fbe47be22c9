"""Values of a world that are written as one word, on a command line or in a fleet file: a place, a wind, a speed."""

from __future__ import annotations

import math

from zmav.errors import BadConfig
from zmav.sim.clock import FASTEST, SLOWEST
from zmav.sim.environment import Vector
from zmav.sim.spec import Home

FROM_DEG = 270.0  # where a wind comes from that nobody gave a direction: west
GUSTS = {"gusty": "moderate", "light": "light", "moderate": "moderate", "severe": "severe"}
FASTEST_WIND = 100.0


def parse_home(text: str) -> Home:
    """``LAT,LON,AMSL,HEADING``; :class:`BadConfig` for anything else, or a place that is none."""
    expected = "LAT,LON,AMSL,HEADING in degrees and metres, such as 47.3977,8.5456,488,90"
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
        home = Home(*numbers) if len(numbers) == 4 else None
    except ValueError:
        home = None
    if home is None:
        raise BadConfig.wrong("home", text, expected, f"home {text!r}")
    return check_home(home)


def check_home(home: Home) -> Home:
    """``home`` itself; :class:`BadConfig` where there is no such place."""
    bounds = {"lat_deg": 89.0, "lon_deg": 180.0, "alt_amsl_m": 10_000.0, "yaw_deg": 360.0}
    for field, most in bounds.items():
        value = getattr(home, field)
        if not abs(value) <= most:  # so that NaN is refused, too
            expected = f"±{most:g} at most"
            raise BadConfig.wrong(field, value, expected, f"home: {field} is {value}")
    return home


def parse_wind(text: str) -> tuple[Vector, str]:
    """``SPEED[@FROM][,GUSTS]``: m/s, degrees that it comes *from* as meteorologists say (270: from the west), and how
    gusty. Gives the wind in m/s NED, where it blows to, and the name of the gusts. :class:`BadConfig` otherwise.
    """
    expected = "SPEED[@FROM][,gusty|light|moderate|severe], such as 5@270,gusty: 5 m/s from the west"
    steady, comma, gusts = text.partition(",")
    speed_text, at, from_text = steady.partition("@")
    try:
        speed, come_from = float(speed_text), float(from_text) if at else FROM_DEG
    except ValueError:
        speed = come_from = math.nan
    known = not comma or gusts in GUSTS
    if not (0.0 <= speed <= FASTEST_WIND and abs(come_from) <= 360.0 and known):
        raise BadConfig.wrong("wind", text, expected, f"wind {text!r}")
    to = math.radians(come_from + 180.0)
    return (speed * math.cos(to), speed * math.sin(to), 0.0), GUSTS[gusts] if comma else "none"


def parse_speed(text: str) -> float:
    """Times real time; infinite for ``max`` and 0. :class:`BadConfig` for anything else."""
    try:
        times = 0.0 if text == "max" else float(text)
    except ValueError:
        times = math.nan
    if times != 0.0 and not SLOWEST <= times <= FASTEST:
        expected = f"a number such as 4, from {SLOWEST:g} to {FASTEST:g}, or 'max'"
        raise BadConfig.wrong("speed", text, expected, f"speed {text!r}")
    return times or math.inf
