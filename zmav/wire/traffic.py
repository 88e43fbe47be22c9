"""Who else is in the air, as it is told to the whole fleet."""

from __future__ import annotations

from typing import Literal

from zmav.wire.base import Told, Vector

AltitudeFrom = Literal["pressure", "geometric"]


class Aircraft(Told, kw_only=True, omit_defaults=True):
    """An aircraft that is not of the fleet, with a position that is believed."""

    icao: str
    """its 24-bit address, six hexadecimal digits"""
    lat_deg: float
    lon_deg: float
    age: float
    """s since it was there, when the report was made"""
    alt: float | None = None
    """m; None: it does not say"""
    alt_from: AltitudeFrom = "pressure"
    """pressure: above the surface of 1013.25 hPa; geometric: by its GNSS"""
    velocity: Vector | None = None
    """m/s, NED; None: it does not say"""
    callsign: str = ""
    positions: int = 2
    """how many that agree have come, one after another"""
    ground: bool = False
    """it says that it stands or rolls"""
    emergency: str = ""
    """its squawk, where that is 7500, 7600 or 7700"""


class Traffic(Told, kw_only=True):
    """``@fleet/traffic``: what one receiver, or the feeds of one ground process, know; each second."""

    t: float
    source: str
    """the host, or the vehicle whose autopilot has the receiver"""
    instance: int
    """a number that the process drew at its start"""
    serves: str = ""
    """the feeds; of several processes with the same ones, one is in charge; empty: a receiver of its own"""
    priority: int = 0
    since: float = 0.0
    """UTC seconds since which it is in charge"""
    qnh: float | None = None
    """hPa: pressure altitudes are brought to sea level by it; None: nobody has said it"""
    aircraft: list[Aircraft] = []
    """the nearest first"""
    left_out: int = 0
    """aircraft that were too many, or too far"""
    unplaced: int = 0
    """aircraft that are heard, and say no position that can be believed"""

    @property
    def rank(self) -> tuple[float, float, float]:
        """Among several processes with the same feeds the highest is in charge."""
        return self.priority, -self.since, -self.instance


class TrafficInfo(Told, kw_only=True):
    """The aircraft that a vehicle warns of, by its own reckoning."""

    icao: str
    callsign: str
    distance: float
    """m over the ground, now"""
    height: float | None
    """m above the vehicle, now; None: not known"""
    nearest: float
    """m over the ground, at the closest approach if both go on as they do"""
    time: float
    """s until then; 0: it goes away already"""
    close: bool = False
    """nearer than may be: else it is only about to be"""

    @property
    def words(self) -> str:
        height = self.height
        above = "height unknown" if height is None else f"{abs(height):.0f} m {'above' if height >= 0.0 else 'below'}"
        text = f"traffic: {self.callsign or self.icao} {self.distance:.0f} m away, {above}"
        return text if self.time <= 0.0 else f"{text}, {self.nearest:.0f} m in {self.time:.0f} s"
