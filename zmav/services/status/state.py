"""``state``: what the vehicle is and does, put together from the last frames five times a second and on change."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

import zenoh

from zmav import geo, keys, wire
from zmav.mavlink import Frame, decode
from zmav.services.companion import Companion
from zmav.services.link.heard import AutopilotMessages
from zmav.services.link.reported import fields_of
from zmav.services.queries.questions import Reply
from zmav.session import is_read
from zmav.trust.gate import anybody
from zmav.trust.proof import ANSWERS, Signer

FRESH = 3.0
"""seconds after which a message no longer counts for readiness"""
REUSED_S = 0.02
"""s that a state which was built for one question is good for others: a flood of them costs fifty a second"""


class StateService:
    """Builds and publishes :class:`zmav.wire.VehicleState`. Lives on the event loop.

    ``checks``: what the autopilot's own report of its checks has against arming now.
    """

    def __init__(
        self,
        companion: Companion,
        instance: str,
        signer: Signer | None,
        checks: Callable[[], Sequence[str]],
    ) -> None:
        self._questions, self._instance, self._signer = companion.questions, instance, signer
        self._port, self._identity, self.origin = companion.port, companion.identity, companion.origin
        self.extras: list[Callable[[wire.VehicleState], None]] = []
        """other services' additions: link, lease, clash"""
        self.checks = checks
        self._key = keys.STATE.key(companion.port.fleet, companion.port.name)
        self._publisher = companion.session.declare_publisher(self._key, **keys.STATE.publishing())
        self._last, self._last_at = b"", -math.inf
        self.battery_fresh = 30.0
        """s for which a battery's estimate holds: one comes each two seconds, of several batteries in turn"""
        self._times: dict[int, tuple[float, float]] = {}
        """s left, and when that was heard, by battery"""
        self._batteries = AutopilotMessages(companion, {"BATTERY_STATUS": self._on_battery})
        self.read = True
        """somebody subscribes to it"""

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        # Anybody may ask: it is published, too.
        self._questions.declare(self._key, lambda query: self._answer(query, loop), admit=anybody)
        self._batteries.start()
        if self._signer is not None:
            key, der = keys.CERTIFICATE.key(self._port.fleet, self._port.name), self._signer.certificate.der
            introduction = Reply(key, der, keys.CERTIFICATE.encoding)
            self._questions.declare(key, lambda query: iter([introduction]), admit=anybody)

    def close(self) -> None:
        self._batteries.close()
        self._publisher.undeclare()

    def _on_battery(self, told: Mapping[str, Any], frame: Frame) -> None:
        left = told["time_remaining"] if told["time_remaining"] > 0 else math.inf  # 0: it gives none
        self._times[told["id"]] = left, time.monotonic()

    def _time_left(self) -> float | None:
        now = time.monotonic()
        least = min((left for left, at in self._times.values() if now - at < self.battery_fresh), default=math.inf)
        return least if least < math.inf else None

    def publish(self) -> None:
        """To those who read it; who asks is answered in any case."""
        self.read = is_read(self._publisher)
        if not self.read:
            return
        data = self._encode()
        self._publisher.put(data, attachment=self._signer.sign(self._key, data) if self._signer else None)

    def _encode(self) -> bytes:
        self._last, self._last_at = wire.encode(self.build()), time.monotonic()
        return self._last

    async def _now(self) -> bytes:
        return self._last if time.monotonic() - self._last_at < REUSED_S else self._encode()

    def _answer(self, query: zenoh.Query, loop: asyncio.AbstractEventLoop) -> Iterator[Reply | Future[Any]]:
        """As it is now. With a challenge of 8 bytes, the answer is proven to be of now, and introduces who gives it."""
        yield (told := asyncio.run_coroutine_threadsafe(self._now(), loop))
        data, proof = told.result(), None
        if self._signer is not None:
            asked = query.payload.to_bytes() if query.payload else b""
            if len(asked) == ANSWERS:
                proof = self._signer.answer(self._key, data, asked)
            else:
                proof = self._signer.sign(self._key, data, introduce=True)
        yield Reply(self._key, data, keys.STATE.encoding, proof)

    def latest(self, name: str) -> Mapping[str, Any] | None:
        """The vehicle's last message of that name where it is fresh enough to decide by."""
        return fields_of(self._port, name, self._identity.source, FRESH)

    def last(self, name: str) -> Mapping[str, Any] | None:
        """The vehicle's last message of that name, however old."""
        return fields_of(self._port, name, self._identity.source)

    def _heard(self, name: str) -> tuple[Mapping[str, Any], float] | None:
        source = self._identity.source
        found = self._port.latest(name, source) if source else None
        return (decode(found.frame, self._port.dialect), found.age) if found else None

    def missing(self) -> list[str]:
        """What is not ready for arming; empty: ready."""
        autopilot = self._identity.autopilot
        return autopilot.missing(self.latest, self.checks()) if autopilot else ["no autopilot heard"]

    def build(self) -> wire.VehicleState:
        """The state now."""
        who = self._identity
        state = wire.VehicleState(t=time.time(), fleet=self._port.fleet, name=self._port.name, instance=self._instance)
        state.replayed = keys.is_replay(state.fleet)
        if who.source and who.autopilot and who.heartbeat:
            state.connected = who.connected
            state.sysid, state.compid = who.source
            state.uid, state.firmware, state.kind = who.uid, who.firmware, who.kind
            state.autopilot, state.mode, state.armed = who.autopilot.name, who.mode, who.armed
            status = self._port.dialect.enum_name("MAV_STATE", who.heartbeat["system_status"])
            state.status = status.removeprefix("MAV_STATE_") if status else None
            state.not_ready = self.missing() if not who.armed else []
            state.ready = not state.not_ready
            self._add_motion(state)
            self._add_health(state)
        for add in self.extras:
            add(state)
        state.ages = {name: round(age, 3) for name, age in state.ages.items()}
        return state

    def place(self) -> wire.GlobalPosition | None:
        """Where the vehicle was last; None where it does not know."""
        position, autopilot = self.last("GLOBAL_POSITION_INT"), self._identity.autopilot
        return _place(position) if position and autopilot and autopilot.has_position(self.last) else None

    def velocity(self) -> wire.Vector | None:
        """m/s, NED, as it was last; None where it does not say."""
        position = self.last("GLOBAL_POSITION_INT")
        return _velocity(position) if position else None

    def _add_motion(self, state: wire.VehicleState) -> None:
        position = self._heard("GLOBAL_POSITION_INT")
        if position and self._identity.autopilot and self._identity.autopilot.has_position(self.last):
            p, state.ages["position"] = position
            state.position = _place(p)
            state.velocity = _velocity(p)
            if self.origin:
                g = state.position
                north, east, down = geo.to_ned(self.origin, g.lat_deg, g.lon_deg, g.alt_amsl)
                state.local = round(north, 3), round(east, 3), round(down, 3)  # as exact as the position itself
        if attitude := self._heard("ATTITUDE"):
            a, state.ages["attitude"] = attitude
            state.attitude = wire.Attitude(roll=a["roll"], pitch=a["pitch"], yaw=a["yaw"])
        if extended := self._heard("EXTENDED_SYS_STATE"):
            landed = extended[0]["landed_state"]
            state.landed = None if landed == 0 else landed == 1

    def _add_health(self, state: wire.VehicleState) -> None:
        if status := self._heard("SYS_STATUS"):
            s, state.ages["battery"] = status
            state.battery = wire.Battery(
                voltage=None if s["voltage_battery"] == 0xFFFF else s["voltage_battery"] / 1e3,
                current=None if s["current_battery"] < 0 else s["current_battery"] / 100.0,
                remaining=None if s["battery_remaining"] < 0 else s["battery_remaining"] / 100.0,
                time_left=self._time_left(),
            )
        if gps := self._heard("GPS_RAW_INT"):
            g, state.ages["gps"] = gps
            fix = self._port.dialect.enum_name("GPS_FIX_TYPE", g["fix_type"]) or str(g["fix_type"])
            state.gps = wire.Gps(
                fix=fix.removeprefix("GPS_FIX_TYPE_"),
                satellites=None if g["satellites_visible"] == 255 else g["satellites_visible"],
                hdop=None if g["eph"] == 0xFFFF else g["eph"] / 100.0,
                h_acc=None if g["h_acc"] in (0, 0xFFFFFFFF) else g["h_acc"] / 1e3,
            )
        if filtered := self._heard("ESTIMATOR_STATUS"):
            e, state.ages["estimate"] = filtered
            state.estimate = wire.Estimate(accuracy=_known(e["pos_horiz_accuracy"]), ratio=_known(e["pos_horiz_ratio"]))
        elif filtered := self._heard("EKF_STATUS_REPORT"):  # ArduPilot calls its ratio a variance
            e, state.ages["estimate"] = filtered
            state.estimate = wire.Estimate(ratio=_known(e["pos_horiz_variance"]))


def _known(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) and value >= 0.0 else None


def _velocity(fields: Mapping[str, Any]) -> wire.Vector:
    """Of a GLOBAL_POSITION_INT."""
    return fields["vx"] / 100.0, fields["vy"] / 100.0, fields["vz"] / 100.0


def _place(fields: Mapping[str, Any]) -> wire.GlobalPosition:
    """Of a GLOBAL_POSITION_INT."""
    lat, lon, alt, rel = (fields[name] for name in ("lat", "lon", "alt", "relative_alt"))
    return wire.GlobalPosition(lat_deg=lat / 1e7, lon_deg=lon / 1e7, alt_amsl=alt / 1e3, alt_rel=rel / 1e3)
