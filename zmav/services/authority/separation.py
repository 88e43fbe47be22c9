"""The last resort against a collision: vehicles tell each other where they are about to be, and move aside by
themselves. It needs no planner and no ground.

Each vehicle in flight says five times a second where it is and where its stream or segment leads it (``beacon``). Who
flies a stream of ours and sees that it will meet somebody is moved aside until they are clear. A segment ends with
that: the vehicle holds where it is then, for the place the segment would have it in may be taken.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from zmav import geo, keys, wire
from zmav.autopilots import Target
from zmav.config import Separation as Settings
from zmav.errors import BadInput
from zmav.mavlink import decode
from zmav.services.authority import avoidance
from zmav.services.authority.avoidance import STEP, STEPS, Motion, Other, Track
from zmav.services.authority.bounds import Bounds
from zmav.services.companion import Companion
from zmav.services.queries.intake import Intake

AHEAD = (1.0, 2.0, 3.0, 4.0)
"""s from now of the places in a beacon"""
SILENT, SILENT_AT_REST, DIFFERS = 0.95, 2.95, 0.25
"""s after which the next beacon is sent in any case, and of a vehicle that stays where it is; m by which it must differ
from the last to be sent sooner"""
SILENCE, SILENCE_AT_REST, FORGET = AHEAD[-1] - STEPS * STEP, 7.0, 60.0
"""s without a beacon after which a neighbour is not reckoned with, for what comes after is not in what it said; of one
that stays where it is; and after which it is not known any more how late its beacons are"""
FRESH = 1.0
"""age in s up to which our own position is where we are"""
GAIN, SET = 0.001, 10.0
"""s by which a neighbour's clock may seem to fall behind from beacon to beacon: more is a beacon that was held up; and
from which on its clock was set"""
AROUND = 25.0
"""m within which a neighbour counts for the way out"""
MOST, NEAREST = 500, 12
"""neighbours that are kept, and of them those that the way out is looked for among"""
MOST_WAITING = 128
"""beacons that are looked at in 5 ms, the newest"""
LARGEST = 20.0
"""m: nobody's radius is larger, whatever a beacon says: one that lies must not hold a whole fleet off"""

SHARE = 0.75
"""of the sum of two vehicles' radii, below which they move aside: less than a planner keeps"""
DOWNWASH = 1.5
"""so many metres of height count as one over the ground"""
FLOOR = 3.0
"""m above home: nobody is sent lower"""
FAR = 3.0
"""m from what it was told to be at, from which on a vehicle is taken to be on its way there"""

Future = Callable[[float], Target]
"""what is to be flown so many seconds from now"""


class Separation:
    """One vehicle's. :meth:`aside` from any thread, the rest on the event loop or Zenoh's threads."""

    def __init__(
        self,
        companion: Companion,
        bounds: Bounds,
        body: Callable[[], wire.swarm.Body],
        settings: Settings,
        is_vehicle: keys.IsVehicle,
        mates: bool,
    ) -> None:
        self._session, self._port, self._identity = companion.session, companion.port, companion.identity
        self._bounds = bounds
        self._events, self._origin, self._body, self._on = companion.events, companion.origin, body, settings.on
        self._is_vehicle, self._mates = is_vehicle, mates
        self._lock = threading.Lock()
        self._heard: dict[str, tuple[float, wire.swarm.Beacon]] = {}
        """by name: our monotonic time less its clock's, by the beacon that came soonest of all, and the last beacon"""
        self._moving = False
        """it moves aside at present"""
        self._intake: Intake | None = None
        self._said: wire.swarm.Beacon | None = None
        self._publisher: zenoh.Publisher | None = None

    @property
    def on(self) -> bool:
        """It is asked for, and there is an origin to count from."""
        return self._on and self._origin is not None

    def start(self) -> None:
        if self.on or (self._mates and self._origin is not None):
            ours, all_of_them = (keys.BEACON.key(self._port.fleet, name) for name in (self._port.name, "*"))
            self._publisher = self._session.declare_publisher(ours, **keys.BEACON.publishing())
            self._intake = Intake(self._session.declare_subscriber, all_of_them, self._on_beacon, MOST_WAITING)

    def close(self) -> None:
        if self._intake is not None:
            self._intake.close()
        if self._publisher is not None:
            self._publisher.undeclare()

    # Telling the others.

    def tick(self, future: Future | None) -> None:
        """Five times a second, with what is flown at present: in flight, say where we are and will be, where the
        neighbours could not know it by what was said last (dead reckoning as in IEEE 1278), or that was a while ago.
        """
        publisher = self._publisher
        if publisher is None or not self._identity.armed or (here := self._here()) is None:
            self._said = None
            return
        pos, vel, _ = here
        ahead = [] if future is None else [self._place(future(t), pos, t) for t in AHEAD]
        beacon = wire.swarm.Beacon(
            t=time.time(),
            pos=_rounded(pos),
            vel=_rounded(vel),
            radius=self._body().radius,
            ahead=[_rounded(p) for p in ahead],
        )
        quiet = SILENT if _moves(beacon) else SILENT_AT_REST
        if self._said is None or abs(beacon.t - self._said.t) > quiet or _differ(self._said, beacon) > DIFFERS:
            self._said = beacon
            publisher.put(wire.encode(beacon))

    def _on_beacon(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).split("/")[2]
        if name == self._port.name or not self._is_vehicle(self._port.fleet, name):
            return
        try:
            beacon = wire.decode(sample.payload.to_bytes(), wire.swarm.Beacon, f"beacon of {name}")
        except BadInput:
            return
        numbers = (beacon.t, beacon.radius, *beacon.pos, *beacon.vel, *(x for place in beacon.ahead for x in place))
        if not all(map(math.isfinite, numbers)) or len(beacon.ahead) > len(AHEAD):
            return
        if not 0.0 <= beacon.radius <= LARGEST:
            return
        shift = time.monotonic() - beacon.t
        with self._lock:
            before = self._heard.get(name)
            if before is not None and abs(shift - before[0]) < SET:
                if beacon.t <= before[1].t:
                    return  # overtaken
                shift = min(shift, before[0] + GAIN)
            if len(self._heard) < MOST or before is not None:
                self._heard[name] = (shift, beacon)

    # Moving aside.

    def aside(self, future: Future) -> tuple[Target, str] | None:
        """What to fly instead, and because of whom; None: go on as you were."""
        autopilot = self._identity.autopilot
        if not self.on or autopilot is None or self._identity.kind not in ("copter", "heli", "rover", "boat"):
            return None  # a plane cannot stop, and is kept apart by heights
        neighbours = self.neighbours()
        here = self._here() if neighbours else None
        if here is None:
            return None
        pos, vel, height = here
        own = self._track(future, pos)
        times = avoidance.CLEARER if self._moving else 1.0
        near = [other for other in neighbours if avoidance.meets(own, other, DOWNWASH, times)]
        self._moving = bool(near)
        if not near:
            return None
        body = self._body()
        flat = autopilot.on_surface
        low = height is not None and height < FLOOR
        motion = Motion(body.speed, body.accel, body.climb, 0.0 if low else body.descend, flat)
        north, east, down = ((q - p) / STEP for p, q in zip(own[0], own[1], strict=True))
        wanted = _within((north, east, down), body.speed)
        far = {other.name: avoidance.least(own, other.track, DOWNWASH)[0] for other in neighbours}
        around = sorted((o for o in neighbours if far[o.name] < AROUND), key=lambda o: far[o.name])[:NEAREST]
        out = avoidance.escape(self._port.name, pos, vel, wanted, around, motion, DOWNWASH, self._allowed)
        return Target(vel=out), ", ".join(sorted(other.name for other in near))

    def neighbours(self) -> list[Other]:
        """Who is about to be where, by the beacons of vehicles."""
        radius = self._body().radius
        return [
            Other(name, _ahead(beacon, age), SHARE * (radius + beacon.radius))
            for name, age, beacon in self.mates()
            if age <= (SILENCE if _moves(beacon) else SILENCE_AT_REST)
        ]

    def mates(self) -> list[tuple[str, float, wire.swarm.Beacon]]:
        """By name: the last beacon, and its age in s, up to a minute."""
        now = time.monotonic()
        with self._lock:
            aged = [(name, now - beacon.t - shift, beacon) for name, (shift, beacon) in self._heard.items()]
            for name in [name for name, age, _ in aged if age > FORGET]:
                del self._heard[name]
        return [each for each in aged if each[1] <= FORGET]

    def _track(self, future: Future, pos: wire.Vector) -> Track:
        """Where the vehicle will be: as it was told to, from where it really is."""
        told = [self._place(future(k * STEP), pos, k * STEP) for k in range(STEPS + 1)]
        off = tuple(a - b for a, b in zip(pos, told[0], strict=True))
        if math.hypot(*off) > FAR:  # on its way to what it was told
            return [self._toward(pos, place, k * STEP) for k, place in enumerate(told)]
        return [(n + off[0], e + off[1], d + off[2]) for n, e, d in told]

    def _place(self, target: Target, pos: wire.Vector, t: float) -> wire.Vector:
        """Where a target has it in ``t`` seconds: metres NED."""
        assert self._origin is not None
        if target.lat_deg is None or target.lon_deg is None:
            return geo.plus(pos, target.vel or (0.0, 0.0, 0.0), t)
        north, east, down = geo.to_ned(self._origin, target.lat_deg, target.lon_deg, target.alt_amsl or 0.0)
        return north, east, pos[2] if target.alt_amsl is None else down

    def _toward(self, pos: wire.Vector, place: wire.Vector, t: float) -> wire.Vector:
        reach, away = self._body().speed * t, math.dist(pos, place)
        return geo.between(pos, place, 1.0 if away <= reach else reach / away)

    def _allowed(self, vel: wire.Vector) -> bool:
        try:
            self._bounds.check(Target(vel=vel))
        except BadInput:
            return False
        return True

    def _here(self) -> tuple[wire.Vector, wire.Vector, float | None] | None:
        """Place and velocity NED, and metres above home; None where they are not known now."""
        source = self._identity.source
        heard = self._port.latest("GLOBAL_POSITION_INT", source) if source else None
        if heard is None or heard.age > FRESH or self._origin is None:
            return None
        p: Mapping[str, Any] = decode(heard.frame, self._port.dialect)
        place = geo.to_ned(self._origin, p["lat"] / 1e7, p["lon"] / 1e7, p["alt"] / 1e3)
        vel = p["vx"] / 100.0, p["vy"] / 100.0, p["vz"] / 100.0
        return geo.plus(place, vel, heard.age), vel, p["relative_alt"] / 1e3


def _ahead(beacon: wire.swarm.Beacon, age: float) -> Track:
    """Where its sender will be from now on, by a beacon ``age`` seconds old: straight from place to place."""
    places = [beacon.pos, *(beacon.ahead or [geo.plus(beacon.pos, beacon.vel, t) for t in AHEAD])]
    times = (0.0, *AHEAD)[: len(places)]
    track = []
    for k in range(STEPS + 1):
        t = age + k * STEP
        i = max(0, min(len(times) - 2, sum(x <= t for x in times) - 1))
        track.append(geo.between(places[i], places[min(i + 1, len(places) - 1)], (t - times[i]) / AHEAD[0]))
    return track


def _moves(beacon: wire.swarm.Beacon) -> bool:
    """It is, or will be, somewhere else than it is."""
    return math.hypot(*beacon.vel) > DIFFERS or any(math.dist(place, beacon.pos) > DIFFERS for place in beacon.ahead)


def _differ(said: wire.swarm.Beacon, new: wire.swarm.Beacon) -> float:
    """m by which the place that follows from what was said is wrong at most."""
    return max(map(math.dist, _ahead(said, new.t - said.t), _ahead(new, 0.0)))


def _within(v: wire.Vector, speed: float) -> wire.Vector:
    """``v``, or as much of it as the vehicle can fly."""
    size = math.hypot(*v)
    n, e, d = v if size <= speed else tuple(x * speed / size for x in v)
    return n, e, d


def _rounded(v: wire.Vector) -> wire.Vector:
    return round(v[0], 2), round(v[1], 2), round(v[2], 2)
