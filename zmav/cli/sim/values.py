"""The values that options of ``zmav sim`` take in one word: a place, a wind."""

from __future__ import annotations

import math

from zmav.errors import BadConfig
from zmav.sim import Home
from zmav.sim.environment import Vector

FROM_DEG = 270.0  # where a wind comes from that nobody gave a direction: west
GUSTS = {"gusty": "moderate", "light": "light", "moderate": "moderate", "severe": "severe", "steady": "none"}
FASTEST_WIND = 100.0


def parse_home(text: str) -> Home:
    """``LAT,LON,AMSL,HEADING``; :class:`BadConfig` for anything else, or a place that is none."""
    expected = "LAT,LON,AMSL,HEADING in degrees and metres, such as 47.3977,8.5456,488,90"
    try:
        lat, lon, alt, heading = (float(word) for word in text.replace(",", " ").split())
    except ValueError:
        raise BadConfig(f"--home {text!r}; expected {expected}", field="home", value=text, expected=expected) from None
    if not (abs(lat) <= 89.0 and abs(lon) <= 180.0 and abs(alt) <= 10_000.0 and abs(heading) <= 360.0):
        raise BadConfig(
            f"--home {text!r} is no place; expected {expected}", field="home", value=text, expected=expected
        )
    return Home(lat, lon, alt, heading)


def parse_wind(text: str) -> tuple[Vector, str]:
    """``SPEED[@FROM][,GUSTS]``: m/s, degrees that it comes *from* as meteorologists say (270: from the west), and how
    gusty. Gives the wind in m/s NED, where it blows to, and the name of the gusts.
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
        raise BadConfig(f"--wind {text!r}; expected {expected}", field="wind", value=text, expected=expected)
    to = math.radians(come_from + 180.0)
    return (speed * math.cos(to), speed * math.sin(to), 0.0), GUSTS[gusts] if comma else "none"
