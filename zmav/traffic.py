"""Who else is in the air: when a position is believed, what several sources know together, who comes near whom.

Feeds on the ground and vehicles with a receiver fill :class:`Tracks` and put reports on ``@fleet/traffic``; vehicles,
planners and screens keep an :class:`AirPicture` of what comes there. No Zenoh and no clock here: ``now`` is in
monotonic seconds.
"""

from __future__ import annotations

import collections
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from zmav import geo, wire
from zmav.corrections import Charge
from zmav.errors import BadInput
from zmav.wire import Vector

MOST_TRACKS = 2000
"""aircraft that one source keeps; a whole country's sky over one antenna has fewer"""
MOST_TOLD, BYTES = 32, 8_000
"""aircraft in a report, the nearest, and bytes of one that are looked at"""
MOST_SOURCES, LONGEST_NAME = 32, 512
FORGET_S = 20.0
"""s without a position after which an aircraft is no longer told of"""
GONE_S = 60.0
"""s without any word after which nothing of it is kept"""
FASTEST, SLACK_M = 400.0, 500.0
"""m/s that anything flies, and m that two positions may differ besides: receivers stamp them late"""
TURNED = 0.4
"""of the way at the speed it says, by which a position may be off beside the slack"""
AGREE = 2
"""positions that agree until they are believed, and as many again after a jump"""
LATE_S = 5.0
"""s by which the time of a report may be other than ours"""
CURRENT_S = 4.0
"""s after which a source's report counts no more but for how old what it told of has become"""
PRESSURE_ERROR, QNH_ERROR, GEOID_ERROR = 250.0, 60.0, 60.0
"""m by which a height may be off: by a pressure altitude without QNH (985 to 1040 hPa), with it (temperature), and by a
GNSS that counts from the ellipsoid"""
SQUAWKS = ("7500", "7600", "7700")
MATES = 0xFA0000
"""addresses from here, of no state by ICAO Annex 10, are the fleet's own: see :func:`mate_address`"""


def on_earth(lat_deg: float, lon_deg: float, alt: float = 0.0) -> bool:
    """Or in the air above it, up to 100 km. ``alt``: m."""
    return abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and abs(alt) <= 1e5


class Sighting(NamedTuple):
    """What one message of a receiver says of an aircraft; None: not in this one."""

    icao: int
    place: tuple[float, float] | None = None
    """latitude and longitude, degrees"""
    alt: float | None = None
    """m"""
    alt_from: wire.AltitudeFrom = "pressure"
    velocity: Vector | None = None
    """m/s, NED"""
    callsign: str | None = None
    ground: bool | None = None
    squawk: str | None = None


class Track:
    """One aircraft as a source has heard it."""

    def __init__(self) -> None:
        self.said = self.at = 0.0
        """of its last word and of the position that is believed"""
        self.place: tuple[float, float] | None = None
        self.positions = 0
        self.alt: float | None = None
        self.alt_from: wire.AltitudeFrom = "pressure"
        self.velocity: Vector | None = None
        self.callsign = self.squawk = ""
        self.ground = False
        self._other: tuple[float, float, float, int] | None = None
        """a position that is not believed yet, when it came, and how many agree with it"""

    def hear(self, place: tuple[float, float], now: float) -> bool:
        """Whether it is believed: it agrees with those before."""
        if self.positions >= AGREE and self.place is not None and self._agree((*self.place, self.at), place, now):
            self.positions += 1
        else:
            other = self._other
            count = other[3] + 1 if other is not None and self._agree(other[:3], place, now) else 1
            self._other = (*place, now, count)
            if count < AGREE:
                return False
            self.positions = count
        self.place, self.at, self._other = place, now, None
        return True

    def _agree(self, before: tuple[float, float, float], place: tuple[float, float], now: float) -> bool:
        lat, lon, at = before
        speed = FASTEST if self.velocity is None else math.hypot(*self.velocity[:2]) * (1.0 + TURNED)
        dt = now - at
        return dt <= GONE_S and geo.horizontal_distance(lat, lon, *place) <= SLACK_M + speed * dt


class Tracks:
    """All that one source hears. ``refused`` counts by reason what was not taken."""

    def __init__(self, most: int = MOST_TRACKS, ours: Sequence[int] = ()) -> None:
        self._most, self._ours = most, frozenset(ours)
        self._tracks: dict[int, Track] = {}
        self._swept = 0.0
        self.refused: collections.Counter[str] = collections.Counter()
        self.heard = 0.0
        """when the last message came that was taken; 0: none yet"""

    def __len__(self) -> int:
        return len(self._tracks)

    def room(self, icao: int, now: float) -> bool:
        """Whether what an aircraft says would be looked at; counted where not."""
        if now - self._swept > 1.0:
            self._swept = now
            for gone in [icao for icao, track in self._tracks.items() if now - track.said > GONE_S]:
                del self._tracks[gone]
        if icao in self._ours or MATES <= icao < MATES + 0x10000:
            self.refused["ours"] += 1
        elif icao in self._tracks or len(self._tracks) < self._most:
            return True
        else:
            self.refused["full"] += 1
        return False

    def hear(self, s: Sighting, now: float) -> None:
        """Take what is possible of it, and count the rest."""
        if not self.room(s.icao, now):
            return
        track = self._tracks.setdefault(s.icao, Track())
        track.said = self.heard = now
        if s.velocity is not None and self._possible("velocity", math.hypot(*s.velocity) <= FASTEST):
            track.velocity = s.velocity
        if s.alt is not None and self._possible("altitude", -1000.0 <= s.alt <= 30_000.0):
            track.alt, track.alt_from = s.alt, s.alt_from
        if s.callsign is not None:
            track.callsign = "".join(c for c in s.callsign.upper() if c.isascii() and (c.isalnum() or c == "-"))[:8]
        if s.ground is not None:
            track.ground = s.ground
        if s.squawk is not None:
            track.squawk = s.squawk if s.squawk in SQUAWKS else ""
        if s.place is None:
            return
        lat, lon = s.place
        if self._possible("position", on_earth(lat, lon) and s.place != (0.0, 0.0)):
            before = track.positions
            if not track.hear(s.place, now) and before >= AGREE:
                self.refused["jump"] += 1

    def _possible(self, what: str, yes: bool) -> bool:
        if not yes:
            self.refused[what] += 1
        return yes

    def placed(self, now: float) -> int:
        """How many have a position that is believed, and of now."""
        return sum(track.place is not None and now - track.at <= FORGET_S for track in self._tracks.values())

    def tell(self, report: wire.Traffic, places: Sequence[tuple[float, float]], reach: float, now: float) -> None:
        """Fill in a report: within ``reach`` m of one of ``places``, the nearest first; all where there are none."""
        near: list[tuple[float, int, Track]] = []
        for icao, track in self._tracks.items():
            if track.place is None or now - track.at > FORGET_S:
                report.unplaced += now - track.said <= FORGET_S
                continue
            far = min((geo.horizontal_distance(*place, *track.place) for place in places), default=0.0)
            if far <= reach:
                near.append((far, icao, track))
            else:
                report.left_out += 1
        near.sort(key=lambda each: each[:2])
        report.left_out += len(near[MOST_TOLD:])
        report.aircraft = [_aircraft(icao, track, now) for _, icao, track in near[:MOST_TOLD]]


def _aircraft(icao: int, track: Track, now: float) -> wire.Aircraft:
    assert track.place is not None
    lat, lon = track.place
    return wire.Aircraft(
        icao=f"{icao:06x}",
        lat_deg=round(lat, 6),
        lon_deg=round(lon, 6),
        age=round(now - track.at, 1),
        alt=None if track.alt is None else round(track.alt, 1),
        alt_from=track.alt_from,
        velocity=None if track.velocity is None else tuple(round(v, 1) for v in track.velocity),  # type: ignore[arg-type]
        callsign=track.callsign,
        positions=track.positions,
        ground=track.ground,
        emergency=track.squawk,
    )


def read(payload: bytes) -> wire.Traffic:
    """A report as it came. Raises :class:`BadInput` for anything that cannot be one."""
    if len(payload) > BYTES:
        raise BadInput.wrong("traffic", len(payload), f"at most {BYTES} bytes")
    report = wire.decode(payload, wire.Traffic, "traffic")
    if len(report.aircraft) > MOST_TOLD:
        raise BadInput.wrong("traffic.aircraft", len(report.aircraft), f"at most {MOST_TOLD}")
    if not 0.0 <= report.t <= 1e11 or not 0.0 <= report.since <= 1e11:
        raise BadInput.wrong("traffic.t", report.t, "UTC seconds")
    if report.qnh is not None and not 850.0 <= report.qnh <= 1100.0:
        raise BadInput.wrong("traffic.qnh", report.qnh, "850 to 1100 hPa")
    if len(report.source) + len(report.serves) > LONGEST_NAME:
        raise BadInput.wrong("traffic.serves", report.serves[:80], f"at most {LONGEST_NAME} characters")
    for each in report.aircraft:
        said = each.icao + each.callsign + each.emergency  # which are shown to people, and name things
        well = len(each.icao) == 6 and len(each.callsign) <= 8 and len(each.emergency) <= 4
        if not well or not (said.isascii() and said.isprintable() and each.icao.isalnum()):
            raise BadInput.wrong(
                "traffic.icao", each.icao[:8], "six digits, and a callsign of eight characters at most"
            )
        v = each.velocity or (0.0, 0.0, 0.0)
        well = on_earth(each.lat_deg, each.lon_deg) and 0.0 <= each.age <= FORGET_S + 1.0
        if not (well and math.hypot(*v) <= FASTEST and -1000.0 <= (each.alt or 0.0) <= 30_000.0):
            raise BadInput.wrong(f"traffic.{each.icao[:8]}", each.lat_deg, "a place, an age and a speed that can be")
    return report


class Seen(NamedTuple):
    """An aircraft, brought to now."""

    aircraft: wire.Aircraft
    source: str
    age: float
    """s since it was where ``aircraft`` says"""
    lat_deg: float
    lon_deg: float
    """where it is now, if it goes on as it did"""
    amsl: float | None
    height_error: float
    """m by which ``amsl`` may be off"""

    @property
    def name(self) -> str:
        return self.aircraft.callsign or self.aircraft.icao

    @property
    def error(self) -> float:
        """m over the ground by which it may be elsewhere: it turns, or its speed is not known."""
        v = self.aircraft.velocity
        return (FASTEST / 4.0 if v is None else TURNED * math.hypot(*v[:2])) * self.age

    def ned(self, origin: wire.Origin | wire.GlobalPosition) -> tuple[Vector, Vector]:
        """Place and velocity about an origin; at the origin's own height where its height is not known."""
        alt = origin.alt_amsl if self.amsl is None else self.amsl
        return geo.to_ned(origin, self.lat_deg, self.lon_deg, alt), self.aircraft.velocity or (0.0, 0.0, 0.0)


class AirPicture:
    """What all sources tell: of those with the same feeds the one in charge, and of each aircraft the newest place."""

    def __init__(self) -> None:
        self._charges: dict[str, Charge[wire.Traffic]] = {}
        self._reports: dict[str, tuple[wire.Traffic, float]] = {}
        """by whom: the last, and when what it tells of was so old as it says"""

    def hear(self, report: wire.Traffic, now: float, utc: float) -> bool:
        """False: it is not of now, of one that stands by, or of one too many."""
        late = utc - report.t
        if abs(late) > LATE_S:
            return False
        name = report.serves or report.source
        if name not in self._charges and len(self._charges) >= MOST_SOURCES:
            self._expire(now)
            if len(self._charges) >= MOST_SOURCES:
                return False
        if not self._charges.setdefault(name, Charge(CURRENT_S)).hear(report, now):
            return False
        self._reports[name] = report, now - max(late, 0.0)
        return True

    def _expire(self, now: float) -> None:
        for name in [name for name, (_, at) in self._reports.items() if now - at > FORGET_S]:
            del self._reports[name], self._charges[name]

    def reports(self, now: float) -> Iterator[tuple[wire.Traffic, float]]:
        """What each source said last, and how many s ago."""
        self._expire(now)
        for report, at in self._reports.values():
            yield report, now - at

    def aircraft(self, now: float) -> list[Seen]:
        """Each once, where it is known by its newest place."""
        found: dict[str, Seen] = {}
        for report, ago in self.reports(now):
            for each in report.aircraft:
                age = each.age + ago
                if age <= FORGET_S and (each.icao not in found or age < found[each.icao].age):
                    found[each.icao] = _seen(each, report, age)
        return list(found.values())


def _seen(each: wire.Aircraft, report: wire.Traffic, age: float) -> Seen:
    here = wire.Origin(lat_deg=each.lat_deg, lon_deg=each.lon_deg, alt_amsl=0.0)
    v = each.velocity or (0.0, 0.0, 0.0)
    lat, lon, risen = geo.to_global(here, (v[0] * age, v[1] * age, v[2] * age))
    amsl, error = each.alt, GEOID_ERROR
    if each.alt_from == "pressure":
        error = PRESSURE_ERROR if report.qnh is None else QNH_ERROR
        if amsl is not None and report.qnh is not None:
            amsl += 44_307.694 * ((report.qnh / 1013.25) ** 0.190284 - 1.0)  # ICAO standard atmosphere
    if amsl is not None:
        amsl += risen
    return Seen(each, report.source, age, max(-90.0, min(lat, 90.0)), lon, amsl, error)


class Approach(NamedTuple):
    """How near two come, if both go on as they do."""

    distance: float
    height: float | None
    nearest: float
    time: float


def approach(seen: Seen, place: wire.GlobalPosition, velocity: Vector | None) -> Approach:
    """Of an aircraft to a vehicle: metres over the ground, m that it is above, and s."""
    (north, east, down), theirs = seen.ned(place)
    own = velocity or (0.0, 0.0, 0.0)
    v = theirs[0] - own[0], theirs[1] - own[1]
    square = v[0] * v[0] + v[1] * v[1]  # of what cannot be it is infinite, where ** raises
    time = 0.0 if square < 0.01 else max(0.0, -(north * v[0] + east * v[1]) / square)
    nearest = math.hypot(north + v[0] * time, east + v[1] * time)
    return Approach(math.hypot(north, east), None if seen.amsl is None else -down, nearest, time)


class Alarm(NamedTuple):
    """When an aircraft is warned of: nearer than this now or within ``time`` s, and until ``again`` times that."""

    distance: float = 500.0
    height: float = 150.0
    time: float = 60.0
    again: float = 1.5

    def of(self, seen: Seen, found: Approach, before: bool) -> str:
        """``close``, ``coming`` or nothing."""
        more = self.again if before else 1.0
        distance = (self.distance + seen.error) * more
        if found.height is not None and abs(found.height) > (self.height + seen.height_error) * more:
            return ""
        if found.distance <= distance:
            return "close"
        return "coming" if found.time <= self.time * more and found.nearest <= distance else ""


def mate_address(fleet: str, name: str, checksum: Callable[[bytes], int]) -> int:
    """The address under which a vehicle's autopilot is told of a mate: always the same, and nobody else's."""
    return MATES + (checksum(f"{fleet}/{name}".encode()) & 0xFFFF)
