"""Who else is in the air, as one vehicle has it: what its autopilot's receiver hears is told to the fleet, who comes
near is warned of, and where the fleet file says so the autopilot is told of the mates in flight.
"""

from __future__ import annotations

import asyncio
import logging
import math
import random
import time
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from zmav import config, geo, keys, wire
from zmav.errors import BadInput, Forbidden
from zmav.mavlink import Frame
from zmav.services.companion import Companion
from zmav.services.corrections.outgoing import Pace
from zmav.services.link.heard import AutopilotMessages
from zmav.services.link.port import one_waits
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import attached
from zmav.traffic import BYTES, FASTEST, AirPicture, Alarm, Seen, Sighting, Tracks, approach, mate_address, read
from zmav.trust.gate import Prove
from zmav.trust.proof import Signer

logger = logging.getLogger(__name__)
MOST_WAITING = 64
"""reports that are looked at in 5 ms, the newest"""
REACH_M = 50_000.0
"""m within which an autopilot's receiver is listened to"""
FAR_M = 1e6
"""m from the fleet's origin that a mate may be"""
HZ = 5.0
"""of ADSB_VEHICLE, an aircraft each: ArduPilot sends none unless it is asked to"""
COORDS, ALTITUDE, HEADING, VELOCITY, CALLSIGN, SQUAWK = 1, 2, 4, 8, 16, 32
"""ADSB_FLAGS: what is valid (https://mavlink.io/en/messages/common.html#ADSB_FLAGS)"""
GEOMETRIC, UAV = 1, 14
"""ADSB_ALTITUDE_TYPE, ADSB_EMITTER_TYPE"""
OLDEST_TSLC = 60
MATE_FRAME = 50
"""bytes of an ADSB_VEHICLE on the link"""
MATE_GOES_ON_S = 4.0
"""s for which a mate that is not heard goes on as its beacon said"""


class Traffic:
    """The service of one vehicle; lives on the event loop, but for what the intake's thread does.

    ``told``: :meth:`zmav.trust.gate.Gate.check_told`, or nobody looks. ``mates``: names, ages and beacons of
    the others. ``receives``: whether the autopilot says that it has a receiver. ``need`` has messages flow from it.
    """

    def __init__(
        self,
        companion: Companion,
        told: Prove,
        signer: Signer | None,
        settings: config.Traffic,
        mates: Callable[[], list[tuple[str, float, wire.swarm.Beacon]]],
        receives: Callable[[], bool],
        need: Callable[[str, float], None],
    ) -> None:
        self._port, self._events, self._session = companion.port, companion.events, companion.session
        self._identity, self._origin, self._told, self._signer = companion.identity, companion.origin, told, signer
        self._settings, self._mates, self._receives, self._need = settings, mates, receives, need
        self._alarm = Alarm(settings.distance, settings.height, settings.time)
        self._key = keys.TRAFFIC.key(companion.port.fleet)
        self._instance = random.getrandbits(32)
        self._picture, self._tracks = AirPicture(), Tracks()
        self._receiver = AutopilotMessages(companion, {"ADSB_VEHICLE": self._on_aircraft})
        self._pace = Pace(lambda: self._port.link.capacity)
        self._warned: dict[str, str] = {}
        """by address: close or coming"""
        self.worst: wire.TrafficInfo | None = None
        self._publisher: zenoh.Publisher | None = None
        self._introduced = 0.0
        self._heard = False
        """the autopilot's receiver was told of to the fleet within the last seconds"""

    def start(self) -> None:
        hear = one_waits(
            asyncio.get_running_loop(), lambda report: self._picture.hear(report, time.monotonic(), time.time())
        )

        def take(sample: zenoh.Sample) -> None:
            """In the intake's thread: what is not proven comes no further."""
            payload = sample.payload.to_bytes() if len(sample.payload) <= BYTES else b""
            try:
                report = read(payload)
                if report.instance != self._instance:
                    self._told(str(sample.key_expr), payload, attached(sample))
                    hear(report)
            except Forbidden:
                pass  # said and counted by the gate
            except BadInput as e:
                logger.debug("traffic that is none: %s", e)

        self._intake = Intake(self._session.declare_subscriber, self._key, take, MOST_WAITING)
        self._receiver.start()

    def close(self) -> None:
        self._receiver.close()
        self._intake.close()
        if self._publisher is not None:
            self._publisher.undeclare()

    # What the autopilot's receiver hears.

    def _on_aircraft(self, f: Mapping[str, Any], frame: Frame) -> None:
        flags, now = f["flags"], time.monotonic()
        if f["tslc"] > OLDEST_TSLC:
            return
        angle, speed = math.radians(f["heading"] / 100.0), f["hor_velocity"] / 100.0
        velocity = speed * math.cos(angle), speed * math.sin(angle), -f["ver_velocity"] / 100.0
        sighting = Sighting(
            f["ICAO_address"] & 0xFFFFFF,
            place=(f["lat"] / 1e7, f["lon"] / 1e7) if flags & COORDS else None,
            alt=f["altitude"] / 1e3 if flags & ALTITUDE else None,
            alt_from="geometric" if f["altitude_type"] == GEOMETRIC else "pressure",
            velocity=velocity if flags & HEADING and flags & VELOCITY else None,
            callsign=_text(f["callsign"]) if flags & CALLSIGN else None,
            squawk=f"{f['squawk']:04d}" if flags & SQUAWK else None,
        )
        self._tracks.hear(sighting, now - f["tslc"])

    def _tell(self, here: wire.GlobalPosition | None, now: float) -> None:
        self._need("ADSB_VEHICLE", HZ if self._receives() else 0.0)
        if not len(self._tracks) and not self._heard:
            return
        report = wire.Traffic(t=time.time(), source=self._port.name, instance=self._instance)
        self._tracks.tell(report, [(here.lat_deg, here.lon_deg)] if here else [], REACH_M, now)
        self._heard = bool(report.aircraft or report.unplaced)
        self._picture.hear(report, now, report.t)
        payload, proof = wire.encode(report), None
        if self._signer is not None:
            introduce = now - self._introduced >= 1.0
            self._introduced = now if introduce else self._introduced
            proof = self._signer.sign(self._key, payload, introduce=introduce)
        if self._publisher is None:  # most vehicles have no receiver
            self._publisher = self._session.declare_publisher(self._key, **keys.TRAFFIC.publishing())
        self._publisher.put(payload, attachment=proof)

    # Each second.

    def tick(self, here: wire.GlobalPosition | None, velocity: wire.Vector | None) -> None:
        """``here`` and ``velocity`` (NED, m/s): the vehicle's own; None: not known now."""
        now = time.monotonic()
        self._tell(here, now)
        self._warn(here, velocity, now)
        if self._settings.mates and here is not None and self._identity.connected:
            self._tell_mates(here, now)

    def _warn(self, here: wire.GlobalPosition | None, velocity: wire.Vector | None, now: float) -> None:
        if here is None:  # how near anybody is, is not known: that is no word of anybody's being clear
            self.worst = None
            return
        before, self._warned = self._warned, {}
        heard: set[str] = set()
        worst: tuple[bool, float, wire.TrafficInfo] | None = None
        for seen in self._picture.aircraft(now):
            icao = seen.aircraft.icao
            heard.add(icao)
            if seen.aircraft.ground:
                continue
            found = approach(seen, here, velocity)
            word = self._alarm.of(seen, found, icao in before)
            if not word:
                continue
            self._warned[icao] = "close" if "close" in (word, before.get(icao)) else word
            info = wire.TrafficInfo(
                icao=icao,
                callsign=seen.aircraft.callsign,
                distance=round(found.distance),
                height=None if found.height is None else round(found.height),
                nearest=round(found.nearest),
                time=round(found.time, 1),
                close=word == "close",
            )
            if before.get(icao) not in (word, "close"):
                self._say(seen, info)
            urgent = -found.distance if info.close else -found.time
            if worst is None or (info.close, urgent) > worst[:2]:
                worst = info.close, urgent, info
        self.worst = None if worst is None else worst[2]
        for icao in before.keys() - self._warned.keys():
            what = "is clear" if icao in heard else "is not heard any more"
            self._events.emit("traffic", "info", f"traffic: {icao} {what}", limit=f"traffic clear {icao}")

    def _say(self, seen: Seen, info: wire.TrafficInfo) -> None:
        severity: wire.Severity = "warning" if info.close else "notice"
        limit = f"traffic {info.icao} {info.close}"
        self._events.emit("traffic", severity, info.words, limit=limit, icao=info.icao, source=seen.source)

    # What the autopilot is told.

    def _tell_mates(self, here: wire.GlobalPosition, now: float) -> None:
        """The nearest first, as many as its link has room for within this second."""
        if (origin := self._origin) is None:
            return
        near = []
        for name, age, beacon in self._mates():
            if name == self._port.name or not -MATE_GOES_ON_S < age <= self._settings.last:
                continue
            on = min(max(age, 0.0), MATE_GOES_ON_S)
            n, e, d = (p + v * on for p, v in zip(beacon.pos, beacon.vel, strict=True))
            if max(map(abs, (n, e, d))) > FAR_M or max(map(abs, beacon.vel)) > FASTEST:
                continue  # numbers that a beacon may hold, and no vehicle has
            lat, lon, alt = geo.to_global(origin, (n, e, d))
            far = geo.horizontal_distance(here.lat_deg, here.lon_deg, lat, lon)
            if far <= self._settings.within:
                near.append((far, name, _frame(self._port.fleet, name, (lat, lon, alt), beacon.vel, age)))
        for _, _, fields in sorted(near, key=lambda each: each[:2]):
            if self._pace.wait(now) > 1.0:
                break
            self._pace.spend(MATE_FRAME, now)
            self._port.send("ADSB_VEHICLE", **fields)


def _text(value: Any) -> str:
    """A field of characters, as the decoder gives it."""
    return value.decode("ascii", "replace") if isinstance(value, bytes) else str(value).rstrip("\0")


def _frame(fleet: str, name: str, place: tuple[float, float, float], vel: wire.Vector, age: float) -> dict[str, Any]:
    """ADSB_VEHICLE of a mate."""
    lat, lon, alt = place
    north, east, down = vel
    return {
        "ICAO_address": mate_address(fleet, name, zlib.crc32),
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "altitude_type": GEOMETRIC,
        "altitude": round(alt * 1e3),
        "heading": round(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36000,
        "hor_velocity": min(round(math.hypot(north, east) * 100.0), 65535),
        "ver_velocity": max(-32768, min(round(-down * 100.0), 32767)),
        "callsign": name.upper()[:8].encode("ascii", "replace"),
        "emitter_type": UAV,
        "tslc": min(max(round(age), 0), 255),
        "flags": COORDS | ALTITUDE | HEADING | VELOCITY | CALLSIGN,
        "squawk": 0,
    }
