"""Cursor on target: a vehicle's state, its alarm and its planned way as events. Pure: no network, no clock.

Types and attributes as MITRE's "Cursor on Target Message Router User's Guide" and ATAK's own events have them.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from datetime import datetime, timezone

from zmav import geo, wire
from zmav.doctor.words import clean

TYPES = {
    "copter": "a-f-A-M-H-Q",
    "heli": "a-f-A-M-H-Q",
    "plane": "a-f-A-M-F-Q",
    "vtol": "a-f-A-M-F-Q",
    "rover": "a-f-G-E-V",
    "boat": "a-f-S",
}
"""friendly: unmanned rotary and fixed wing, vehicle, vessel"""
OTHER = "a-f-G"
ALERT, CANCEL, ROUTE, POINT, GOAL = "b-a-o-tbl", "b-a-o-can", "b-m-r", "b-m-p-w", "b-m-p-w-GOTO"
UNKNOWN = 9999999.0
"""of heights and errors"""
GEOID_ERROR, HEIGHT_ERROR = 110.0, 10.0
"""m by which a height above the ellipsoid may be off where the geoid's height is not known, and where it is"""
MOST_POINTS = 12
"""of a route"""
LONGEST_TEXT = 200
Place = tuple[float, float, float]
"""latitude and longitude, degrees, and m AMSL"""


class Cot:
    """Events of one fleet. ``geoid``: m of the geoid above the ellipsoid there, by which heights above sea level become
    those above the ellipsoid that events have; None: not known, and heights are said as they are.
    """

    def __init__(self, fleet: str, geoid: float | None) -> None:
        self._fleet, self._geoid = fleet, geoid

    def uid(self, name: str) -> str:
        """Always the same for one vehicle."""
        return f"zmav.{self._fleet}.{clean(name)}"

    def vehicle(self, state: wire.VehicleState, now: float, stale: float) -> bytes | None:
        """Where it is and how it goes; None where it does not know. ``now``: UTC s; ``stale``: s."""
        at = state.position
        if at is None:
            return None
        event = self._event(self.uid(state.name), TYPES.get(state.kind or "", OTHER), now, stale)
        self._point(event, (at.lat_deg, at.lon_deg, at.alt_amsl), state.gps.h_acc if state.gps else None)
        detail = ET.SubElement(event, "detail")
        ET.SubElement(detail, "contact", callsign=clean(state.name))
        if state.velocity is not None:
            north, east, _ = state.velocity
            course = math.degrees(math.atan2(east, north)) % 360.0
            if state.attitude is not None and math.hypot(north, east) < 0.5:
                course = math.degrees(state.attitude.yaw % math.tau)
            ET.SubElement(detail, "track", course=f"{course:.1f}", speed=f"{math.hypot(north, east):.2f}")
        if state.battery is not None and state.battery.remaining is not None:
            ET.SubElement(detail, "status", battery=f"{100.0 * state.battery.remaining:.0f}")
        ET.SubElement(detail, "precisionlocation", altsrc="GPS", geopointsrc="GPS")
        armed = "armed" if state.armed else "disarmed"
        words = (
            f"{state.kind or 'vehicle'} {armed} {state.mode or ''}, {at.alt_rel:.0f} m above home, {self.height_words}"
        )
        ET.SubElement(detail, "remarks").text = clean(words)[:LONGEST_TEXT]
        return ET.tostring(event)

    @property
    def height_words(self) -> str:
        """What the heights of its events count from."""
        return "hae is above sea level" if self._geoid is None else "hae is above the ellipsoid"

    def alarm(self, state: wire.VehicleState, text: str, now: float, stale: float) -> bytes | None:
        """Its emergency, in words; an empty text ends it."""
        if state.position is None:
            return None
        event = self._event(f"{self.uid(state.name)}-9-1-1", ALERT if text else CANCEL, now, stale)
        at = state.position
        self._point(event, (at.lat_deg, at.lon_deg, at.alt_amsl))
        detail = ET.SubElement(event, "detail")
        ET.SubElement(detail, "link", uid=self.uid(state.name), type=TYPES.get(state.kind or "", OTHER), relation="p-p")
        ET.SubElement(detail, "contact", callsign=f"{clean(state.name)}-Alert")
        more = {"type": "911 Alert"} if text else {"cancel": "true"}
        ET.SubElement(detail, "emergency", more).text = clean(state.name)
        ET.SubElement(detail, "remarks").text = clean(text)[:LONGEST_TEXT]
        return ET.tostring(event)

    def way(self, name: str, goal: str, places: Sequence[Place], now: float, stale: float) -> list[bytes]:
        """A vehicle's planned way as a route, and its end as a marker."""
        if not places:
            return []
        end = self._event(f"{self.uid(name)}.goal", GOAL, now, stale)
        self._point(end, places[-1])
        detail = ET.SubElement(end, "detail")
        ET.SubElement(detail, "contact", callsign=clean(f"{name}: {goal}"))
        ET.SubElement(detail, "link", uid=self.uid(name), relation="p-p", type=POINT)
        route = self._event(f"{self.uid(name)}.way", ROUTE, now, stale)
        self._point(route, (0.0, 0.0, 0.0))
        detail = ET.SubElement(route, "detail")
        step = max(1.0, (len(places) - 1) / (MOST_POINTS - 1))
        kept = [places[min(round(i * step), len(places) - 1)] for i in range(min(len(places), MOST_POINTS))]
        for i, place in enumerate(kept):
            lat, lon, height = self._at(place)
            uid = f"{self.uid(name)}.way.{i}"
            point = f"{lat:.7f},{lon:.7f},{height:.1f}"
            ET.SubElement(detail, "link", uid=uid, type=POINT, point=point, callsign=f"{i + 1}", relation="c")
        ET.SubElement(detail, "link_attr", method="Flying", direction="Infil", routetype="Primary", order="Ascending")
        ET.SubElement(detail, "contact", callsign=clean(f"{name} {goal}"))
        return [ET.tostring(end), ET.tostring(route)]

    def _at(self, place: Place) -> Place:
        lat, lon, alt = place
        return lat, lon, alt + (self._geoid or 0.0)

    def _event(self, uid: str, kind: str, now: float, stale: float) -> ET.Element:
        times = {"time": _time(now), "start": _time(now), "stale": _time(now + stale)}
        return ET.Element("event", {"version": "2.0", "uid": uid, "type": kind, "how": "m-g", **times})

    def _point(self, event: ET.Element, place: Place, error: float | None = None) -> None:
        lat, lon, height = self._at(place)
        off = GEOID_ERROR if self._geoid is None else HEIGHT_ERROR
        ce = UNKNOWN if error is None else error
        words = {
            "lat": f"{lat:.7f}",
            "lon": f"{lon:.7f}",
            "hae": f"{height:.1f}",
            "ce": f"{ce:.1f}",
            "le": f"{off:.1f}",
        }
        ET.SubElement(event, "point", words)


def _time(t: float) -> str:
    return datetime.fromtimestamp(t, timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


def places_of(state: wire.VehicleState, track: Sequence[tuple[float, float, float, float]]) -> list[Place]:
    """A planned track (s, north, east, down) on the globe, by a vehicle that says where it is in both frames."""
    if state.position is None or state.local is None:
        return []
    here, (n, e, d) = state.position, state.local
    return [geo.to_global(here, (north - n, east - e, down - d)) for _, north, east, down in track]
