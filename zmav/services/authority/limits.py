"""Whether a target may be flown: the fleet's geofence and limits, judged for every setpoint before it is sent.

A position must lie within the fence, and in a fence with a bay so must the straight way to it. For every other level
the vehicle's own place a little later must: so that it is stopped before the fence and not behind it. Out there
already, it may come back. Where the fleet file names no floor, the ground at home is one: no place is under it, and a
vehicle near it sinks no faster than for a landing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from zmav import geo, wire
from zmav.autopilots import Target
from zmav.config import Geofence, Limits
from zmav.errors import BadConfig, BadInput

LOOKAHEAD = 2.0
"""s: so long a vehicle goes on as it is told; it stops from 10 m/s within that at 5 m/s²"""
EDGE = 0.02
"""m: a point this near to the fence is on it, and within; latitudes on the wire are rounded to 1 cm"""
LANDING = 1.5
"""m/s: so fast a vehicle may sink at any height above home, higher up faster"""
MAX_FENCE = 1_000_000.0
"""m from the origin: farther the map is too crooked"""

Edge = tuple[float, float, float, float, float]
"""north and east of a corner and of the next one in metres, and the slope between them: north over east"""


class Here(NamedTuple):
    """Where the vehicle is: WGS84 degrees, m above home (None: not known), m/s NED."""

    lat_deg: float
    lon_deg: float
    alt_rel: float | None
    vel: wire.Vector = (0.0, 0.0, 0.0)


class Fence:
    """A :class:`~zmav.config.Geofence`, made ready for quick answers in metres about ``origin``.

    Without an origin it is about the polygon's first corner. A polygon may lie across the antimeridian. ``ground``:
    home's height is the floor where the fence names none. Raises :class:`~zmav.errors.BadConfig` for one that crosses
    itself, encloses nothing or is too far away.
    """

    def __init__(self, fence: Geofence, origin: wire.Origin | None, *, ground: bool) -> None:
        lat, lon = fence.polygon[0] if fence.polygon else (0.0, 0.0)
        self.origin = origin or wire.Origin(lat_deg=lat, lon_deg=lon, alt_amsl=0.0)
        self.radius = None if fence.radius == math.inf else fence.radius
        self.ground = ground and fence.floor is None
        self.floor, self.ceiling = 0.0 if self.ground else fence.floor, fence.ceiling
        if self.radius is not None and origin is None:
            raise _bad("radius", fence.radius, "an origin: the radius is about the fleet's")
        self._lat, self._lon = self.origin.lat_deg, self.origin.lon_deg
        self._north, self._east = geo.to_ned(self.origin, self._lat + 1.0, self._lon + 1.0, 0.0)[:2]
        corners = [self.local(*corner) for corner in fence.polygon]
        _check_corners(corners)
        self.edges = _edges(corners)
        self.convex = _is_convex(corners)
        self.limits_ground = bool(corners) or self.radius is not None
        self.limits_height = self.floor is not None or self.ceiling is not None

    def local(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """North and east in metres: :func:`zmav.geo.to_ned` without its trigonometry."""
        east = geo.wrap_degrees(lon_deg - self._lon)
        return (lat_deg - self._lat) * self._north, east * self._east

    def excess(self, north: float, east: float, alt_rel: float | None) -> tuple[float, str]:
        """How far beyond the fence a point is in metres (0: within), and which part of it it is beyond.

        ``alt_rel`` None leaves the heights out.
        """
        if self.radius is not None:
            beyond = math.hypot(north, east) - self.radius
            if beyond > EDGE:
                return beyond, f"{beyond:.1f} m beyond the geofence's radius of {self.radius:g} m"
        if self.edges and not self._inside(north, east):
            beyond = self.to_edge(north, east)
            if beyond > EDGE:
                return beyond, f"{beyond:.1f} m outside the geofence's polygon"
        return (0.0, "") if alt_rel is None else self._beside(alt_rel)

    def check_height(self, field: str, alt_rel: float) -> None:
        """Raise :class:`~zmav.errors.BadInput` for a height above home that is beyond the fence, wherever it is."""
        beyond, where = self._beside(alt_rel)
        if beyond:
            raise _outside(field, where)

    def _beside(self, alt_rel: float) -> tuple[float, str]:
        if self.ceiling is not None and alt_rel > self.ceiling + EDGE:
            return alt_rel - self.ceiling, f"at {alt_rel:.1f} m above home, over the ceiling of {self.ceiling:g} m"
        if self.floor is None or alt_rel >= self.floor - EDGE:
            return 0.0, ""
        if self.ground:
            return -alt_rel, f"{-alt_rel:.1f} m under the ground at home"
        return self.floor - alt_rel, f"at {alt_rel:.1f} m above home, under the floor of {self.floor:g} m"

    def _inside(self, north: float, east: float) -> bool:
        """Whether a ray to the north crosses the polygon an odd number of times."""
        inside = False
        for n1, e1, _, e2, slope in self.edges:
            if (e1 > east) != (e2 > east) and north < n1 + (east - e1) * slope:
                inside = not inside
        return inside

    def to_edge(self, north: float, east: float) -> float:
        """Metres from a point to the nearest edge of the polygon."""
        return min(_to_line(north, east, n1, e1, n2, e2) for n1, e1, n2, e2, _ in self.edges)

    def leg(self, n1: float, e1: float, n2: float, e2: float) -> bool:
        """Whether the straight way between two points within stays within: in a convex polygon always."""
        if self.convex:
            return True
        cuts = sorted(filter(None, (_cut(n1, e1, n2, e2, edge) for edge in self.edges)))
        between = ((a + b) / 2.0 for a, b in zip([0.0, *cuts], [*cuts, 1.0], strict=True))
        return all(self.excess(n1 + t * (n2 - n1), e1 + t * (e2 - e1), None)[0] == 0.0 for t in between)


def check(
    target: Target,
    fence: Fence | None,
    limits: Limits | None,
    home_alt_amsl: float | None,
    here: Here | None,
    *,
    flat: bool = False,
) -> None:
    """Raise :class:`BadInput` where ``target`` is beyond the fence or a limit; ``detail["count"]`` says which.

    ``home_alt_amsl`` is the height of home, from which the fence counts; ``flat``: the vehicle keeps to the surface,
    and its heights mean nothing. Where ``here`` is not known, only positions are held against the fence.
    """
    if limits is not None:
        _check_limits(target, limits)
    if fence is not None and (fence.limits_ground or fence.limits_height):
        if target.lat_deg is not None and target.lon_deg is not None:
            _check_place(target, target.lat_deg, target.lon_deg, fence, home_alt_amsl, here, flat)
        elif here is not None:
            _check_motion(target, fence, here, flat)


def check_motion(
    field: str, vel: wire.Vector | None, acc: wire.Vector | None, limits: Limits, slack: float = 1.0
) -> None:
    """Raise :class:`BadInput` for a velocity or an acceleration beyond ``slack`` times the limits.

    ``field`` is put before the name of what is wrong.
    """
    if vel is not None:
        north, east, down = vel
        if limits.speed is not None and math.hypot(north, east) > limits.speed * slack:
            raise _fast(f"{field}vel", "speed", math.hypot(north, east), limits.speed, "m/s over the ground")
        if limits.climb is not None and -down > limits.climb * slack:
            raise _fast(f"{field}vel", "climb", -down, limits.climb, "m/s up")
        if limits.descend is not None and down > limits.descend * slack:
            raise _fast(f"{field}vel", "descend", down, limits.descend, "m/s down")
    if acc is not None and limits.accel is not None and math.hypot(*acc) > limits.accel * slack:
        raise _fast(f"{field}acc", "accel", math.hypot(*acc), limits.accel, "m/s²")


def check_speed(name: str, value: float, limits: Limits) -> None:
    """Raise :class:`BadInput` for a speed (m/s) beyond the limit of that name."""
    most = getattr(limits, name)
    if most is not None and value > most:
        raise _fast(name, name, value, most, "m/s")


def _check_limits(target: Target, limits: Limits) -> None:
    if target.vel is not None or target.acc is not None:
        check_motion("", target.vel, target.acc, limits)
    if limits.yaw_rate is not None:
        if target.yaw_rate is not None and abs(target.yaw_rate) > limits.yaw_rate:
            raise _fast("yaw_rate", "yaw_rate", abs(target.yaw_rate), limits.yaw_rate, "rad/s")
        if target.rates is not None and abs(target.rates[2]) > limits.yaw_rate:
            raise _fast("rates", "yaw_rate", abs(target.rates[2]), limits.yaw_rate, "rad/s about the body's z")
    if limits.tilt is not None and target.attitude is not None:
        _, x, y, _ = target.attitude
        tilt = math.acos(max(-1.0, 1.0 - 2.0 * (x * x + y * y)))
        if tilt > limits.tilt:
            raise _fast("attitude", "tilt", tilt, limits.tilt, "rad from upright")


def _fast(field: str, limit: str, value: float, most: float, unit: str) -> BadInput:
    text = f"{field}: {value:.4g} {unit} is more than the limit {limit} = {most:g}"
    return BadInput(text, field=field, value=value, expected=f"at most {most:g}", count=limit)


def _check_place(
    target: Target, lat: float, lon: float, fence: Fence, home: float | None, here: Here | None, flat: bool
) -> None:
    north, east = fence.local(lat, lon)
    height = None if flat or not fence.limits_height else height_of(target, home)
    beyond, where = fence.excess(north, east, height)
    if beyond:
        raise _outside("pos", where)
    if here is not None and not fence.convex:
        n, e = fence.local(here.lat_deg, here.lon_deg)
        if fence.excess(n, e, None)[0] == 0.0 and not fence.leg(n, e, north, east):
            raise _outside("pos", "behind a bay of the geofence: the straight way there leaves it")


def _check_motion(target: Target, fence: Fence, here: Here, flat: bool) -> None:
    north, east = fence.local(here.lat_deg, here.lon_deg)
    height = None if flat else here.alt_rel
    vn, ve, vd = target.vel or here.vel
    if target.acc is not None and target.vel is None:
        an, ae, ad = target.acc
        vn, ve, vd = vn + an * LOOKAHEAD / 2.0, ve + ae * LOOKAHEAD / 2.0, vd + ad * LOOKAHEAD / 2.0
    later = None if height is None else height - vd * LOOKAHEAD
    if fence.ground and height is not None and later is not None:
        if vd > max(LANDING, height / LOOKAHEAD):
            raise _outside(_moved_by(target), f"sinking at {vd:.1f} m/s {height:.1f} m above the ground at home")
        later = max(later, 0.0)
    beyond, where = fence.excess(north + vn * LOOKAHEAD, east + ve * LOOKAHEAD, later)
    if beyond and beyond > fence.excess(north, east, height)[0]:
        raise _outside(_moved_by(target), f"in {LOOKAHEAD:g} s {where}")


def _moved_by(target: Target) -> str:
    return {"velocity": "vel", "acceleration": "acc"}.get(target.level, target.level)


def height_of(target: Target, home_alt_amsl: float | None) -> float:
    """Metres above home; raises :class:`BadInput` where home's own height is needed and not known."""
    if target.alt_rel is not None:
        return target.alt_rel
    if home_alt_amsl is None or target.alt_amsl is None:
        text = "the geofence counts heights from home, and where home is, is not known yet"
        raise BadInput(text, field="alt_amsl", value=target.alt_amsl, expected="alt_rel, or later", count="fence")
    return target.alt_amsl - home_alt_amsl


def _outside(field: str, where: str) -> BadInput:
    return BadInput(f"{field}: {where}", field=field, value=where, expected="within the geofence", count="fence")


# Polygons.


def _edges(corners: list[tuple[float, float]]) -> list[Edge]:
    found = []
    for (n1, e1), (n2, e2) in zip(corners, corners[1:] + corners[:1], strict=True):
        if (n1, e1) != (n2, e2):
            found.append((n1, e1, n2, e2, (n2 - n1) / (e2 - e1) if e1 != e2 else 0.0))
    return found


def _check_corners(corners: list[tuple[float, float]]) -> None:
    if not corners:
        return
    for corner in corners:
        if math.hypot(*corner) > MAX_FENCE:
            raise _bad("polygon", corner, "corners within 1000 km of the origin")
    edges = _edges(corners)
    twice_area = sum(n1 * e2 - n2 * e1 for n1, e1, n2, e2, _ in edges)
    if len(edges) < 3 or abs(twice_area) < 2.0:
        raise _bad("polygon", len(corners), "corners that enclose at least 1 m²")
    for i, edge in enumerate(edges):
        for other in edges[i + 2 : len(edges) - (i == 0)]:
            cut = _cut(*edge[:4], other)
            if cut is not None:
                raise _bad("polygon", len(corners), "edges that do not cross each other")


def _is_convex(corners: list[tuple[float, float]]) -> bool:
    turns = []
    for i, (n2, e2) in enumerate(corners):
        (n1, e1), (n3, e3) = corners[i - 1], corners[(i + 1) % len(corners)]
        turns.append((n2 - n1) * (e3 - e2) - (e2 - e1) * (n3 - n2))
    return all(turn >= 0.0 for turn in turns) or all(turn <= 0.0 for turn in turns)


def _to_line(north: float, east: float, n1: float, e1: float, n2: float, e2: float) -> float:
    dn, de = n2 - n1, e2 - e1
    share = ((north - n1) * dn + (east - e1) * de) / (dn * dn + de * de)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(north - n1 - share * dn, east - e1 - share * de)


def _cut(n1: float, e1: float, n2: float, e2: float, edge: Edge) -> float | None:
    """Where between 0 and 1 on the way from 1 to 2 it meets an edge; None: nowhere."""
    en, ee = edge[2] - edge[0], edge[3] - edge[1]
    dn, de = n2 - n1, e2 - e1
    across = dn * ee - de * en
    if across == 0.0:
        return None  # side by side: the other edges tell
    gn, ge = edge[0] - n1, edge[1] - e1
    on_way, on_edge = (gn * ee - ge * en) / across, (gn * de - ge * dn) / across
    return on_way if 0.0 <= on_way <= 1.0 and 0.0 <= on_edge <= 1.0 else None


def _bad(name: str, value: object, expected: str) -> BadConfig:
    return BadConfig(f"geofence.{name}: expected {expected}", field=f"geofence.{name}", value=value, expected=expected)
