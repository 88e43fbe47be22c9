"""The vehicle's gimbal, by the gimbal manager of its autopilot: MAVLink's gimbal protocol, version 2.

Regions of interest (DO_SET_ROI_LOCATION) are left alone: ArduCopter turns the vehicle where its gimbal has no yaw, or
there is none, and PX4 turns it in missions. A place is looked at by angles that are worked out here.

Protocol: https://mavlink.io/en/services/gimbal_v2.html
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from zmav import geo, keys, wire
from zmav.autopilots import Command
from zmav.errors import BadInput, Refused, Unsupported, ZmavError
from zmav.rotation import euler, from_euler, wrap
from zmav.services.authority.targets import MAX_ANGLE, number, resolve
from zmav.services.companion import Companion
from zmav.services.link.port import on_loop
from zmav.services.link.reported import fields_of
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Handler, Report

INFORMATION, STATUS, ATTITUDE = (
    "GIMBAL_MANAGER_INFORMATION",
    "GIMBAL_MANAGER_STATUS",
    "GIMBAL_DEVICE_ATTITUDE_STATUS",
)
NEUTRAL, LEVEL, LOCK = 2, 4 | 8, 16
"""GIMBAL_MANAGER_FLAGS: neutral; roll and pitch from the horizon; yaw from north"""
EARTH_FRAME = 64
"""of GIMBAL_DEVICE_FLAGS: its yaw is from north. Without it ArduPilot and PX4 tell it from the nose, locked or not"""
HAS_YAW = 256
"""of GIMBAL_MANAGER_CAP_FLAGS"""
ANSWER, TRIES = 1.0, 2
"""s that a message may come after it was asked for, and how often it is"""
KNOWN = 10.0
"""s for which a gimbal that was found is not looked for again"""
PERIOD = 0.2
"""s between two sets of angles, while it looks at a place"""
FRESH = 2.0
"""s: age up to which a position says where somebody is"""
HEARD = 3.0
"""s for the vehicle to be heard that is to be looked at"""
NOBODY = (0, 0)
NAN = math.nan
Holder = tuple[int, int]
"""system and component id of who controls it"""


class Ranges(NamedTuple):
    """What GIMBAL_MANAGER_INFORMATION tells; radians."""

    device: int
    turns: bool
    """it has a yaw axis"""
    pitch: tuple[float, float]
    yaw: tuple[float, float]


class Seen(NamedTuple):
    """Where something is: WGS84, and m/s NED; ``at``: monotonic seconds."""

    lat_deg: float
    lon_deg: float
    alt_amsl: float
    vel: wire.Vector = (0.0, 0.0, 0.0)
    at: float = 0.0


class Gimbal:
    """Handlers of ``gimbal_*``. Lives on the event loop.

    ``need`` has messages flow from the autopilot (:meth:`zmav.services.rates.rates.Rates.need`); ``is_vehicle`` says
    of whom it is believed where they are.
    """

    def __init__(
        self,
        companion: Companion,
        commander: Commander,
        need: Callable[[str, float], None],
        is_vehicle: keys.IsVehicle,
    ) -> None:
        self._session, self._port, self._identity = companion.session, companion.port, companion.identity
        self._events, self._origin, self._do = companion.events, companion.origin, commander
        self._need, self._is_vehicle = need, is_vehicle
        self._task: asyncio.Task[None] | None = None
        self._aim = ""
        """what it looks at, in words"""
        self._held = False
        """control was taken, and not given back"""

    @property
    def handlers(self) -> dict[str, Handler]:
        """The verbs of this service."""
        return {
            "gimbal_point": self.point,
            "gimbal_turn": self.turn,
            "gimbal_neutral": self.neutral,
            "gimbal_release": self.release,
            "gimbal_status": self.status,
        }

    def close(self) -> None:
        """End; control is given back, once: nobody waits for the answer."""
        self._stop()
        if self._held:
            with contextlib.suppress(ZmavError):
                message = _configure(-3, -3, 0).message(self._port.dialect)
                self._port.send(message.name, **message.addressed(*self._do.source()))

    # The orders.

    async def turn(self, args: wire.TurnGimbal, report: Report) -> dict[str, Any]:
        """Turn it to angles. Raises :class:`BadInput` for those out of its range, and what :meth:`_take` does."""
        for name in ("pitch", "yaw"):
            number(name, getattr(args, name), MAX_ANGLE)
        ranges = await self._take(args.take)
        yaw = wrap(args.yaw)
        _within("pitch", args.pitch, ranges.pitch)
        if not ranges.turns and (args.lock or yaw):
            raise BadInput.wrong("yaw", args.yaw, "0, without lock", "the gimbal has no yaw axis")
        if ranges.turns and not args.lock:
            _within("yaw", yaw, ranges.yaw)
        flags = LEVEL | (LOCK if args.lock else 0)
        await self._pitch_yaw(math.degrees(args.pitch), math.degrees(yaw), flags, ranges.device)
        return {"pitch": args.pitch, "yaw": yaw, "lock": args.lock}

    async def neutral(self, args: wire.TakeGimbal, report: Report) -> dict[str, Any]:
        """Turn it back to where it looks without orders."""
        ranges = await self._take(args.take)
        await self._pitch_yaw(NAN, NAN, NEUTRAL, ranges.device)
        return {}

    async def point(self, args: wire.PointGimbal, report: Report) -> dict[str, Any]:
        """Have it look at a place or a vehicle from now on; without a yaw axis, up and down only."""
        place = None if args.vehicle else self._place(args)
        if args.vehicle and (args.pos is not None or args.lat_deg is not None or args.lon_deg is not None):
            raise BadInput.wrong("vehicle", args.vehicle, "a vehicle or a place", "a vehicle and a place are given")
        if args.vehicle == self._port.name:
            raise BadInput.wrong("vehicle", args.vehicle, "another vehicle", f"{args.vehicle} cannot look at itself")
        target = Target(self._session, self._port.fleet, args.vehicle, place, self._is_vehicle)
        try:
            await target.found()
            own = self._own_place()
            ranges = await self._take(args.take)
        except BaseException:
            target.close()
            raise
        self._aim = args.vehicle or "a place"
        self._task = asyncio.get_running_loop().create_task(self._track(target, ranges))
        pitch, yaw = _direction(own, target.now())
        return {"at": self._aim, "pitch": pitch, "yaw": yaw, "turns": ranges.turns}

    async def release(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Look at nothing any more, and give control back where it is ours."""
        ranges = await self._find()
        self._stop()
        await self._do.command(_configure(-3, -3, ranges.device))
        self._held = False
        return {"controller": self._words(await self._holder())}

    async def status(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Where it looks, and who controls it; raises :class:`Refused` where there is none."""
        ranges = await self._find()
        looks, own = await self._asked(ATTITUDE), fields_of(self._port, "ATTITUDE", self._do.source(), FRESH)
        said: dict[str, Any] = {"device": ranges.device, "controller": self._words(await self._holder())}
        if looks is not None:
            _, pitch, yaw = euler(looks["q"])
            heading = own["yaw"] if own else None
            from_north = bool(looks["flags"] & EARTH_FRAME)
            said |= {"pitch": pitch, "yaw": yaw if not from_north else None, "heading": yaw if from_north else None}
            if heading is not None:
                said["yaw" if from_north else "heading"] = wrap(yaw - heading if from_north else yaw + heading)
        return {**said, "turns": ranges.turns, "pitch_range": ranges.pitch, "yaw_range": ranges.yaw, "at": self._aim}

    # Who is there, and who has it.

    async def _find(self) -> Ranges:
        """What there is; raises :class:`Refused` where no gimbal manager of the autopilot answers."""
        said = fields_of(self._port, INFORMATION, self._do.source(), KNOWN) or await self._asked(INFORMATION)
        if said is None:
            text = "no gimbal answers: the autopilot has none, or it is not set up (docs/gimbal.md)"
            raise Refused(text, vehicle=self._port.name, reason="no gimbal")
        pitch, yaw = (_range(said[f"{axis}_min"], said[f"{axis}_max"]) for axis in ("pitch", "yaw"))
        return Ranges(said["gimbal_device_id"], bool(said["cap_flags"] & HAS_YAW), pitch, yaw)

    async def _asked(self, name: str) -> Any:
        """The fields of a message that is asked for; None: it does not come."""
        command = Command("MAV_CMD_REQUEST_MESSAGE", (float(self._port.msgid(name)),))
        with self._do.inbox(name) as inbox:
            for _ in range(TRIES):
                with contextlib.suppress(Refused, Unsupported):
                    await self._do.command(command)
                    if (heard := await inbox.get(ANSWER)) is not None:
                        return heard[1]
        return None

    async def _holder(self) -> Holder:
        said = await self._asked(STATUS)
        if said is None:
            raise Refused("the gimbal does not tell who controls it", vehicle=self._port.name)
        return said["primary_control_sysid"], said["primary_control_compid"]

    async def _take(self, from_others: bool) -> Ranges:
        """Have control, and end what was looked at; raises :class:`Refused` where somebody else has it, unless it may
        be taken ``from_others``.
        """
        ranges, holder, ours = await self._find(), await self._holder(), self._port.address
        if holder not in (NOBODY, ours):
            who = self._words(holder)
            if not from_others:
                text = f"the gimbal is controlled by {who}: it is taken with take=true (--take)"
                raise Refused(text, vehicle=self._port.name, controller=who, reason="controlled")
            self._events.emit("gimbal", "notice", f"the gimbal is taken from {who}")
        self._stop()
        if holder != ours:
            await self._do.command(_configure(*ours, ranges.device))
            if (holder := await self._holder()) != ours:
                text = f"the gimbal is still controlled by {self._words(holder)}"
                raise Refused(text, vehicle=self._port.name, reason="controlled")
        self._held = True
        return ranges

    def _words(self, holder: Holder) -> str:
        if holder == NOBODY:
            return "nobody"
        if holder == self._port.address:
            return "us"
        if holder == self._identity.source:
            return "the autopilot itself, for the pilot's sticks"
        return f"{holder[0]}/{holder[1]}"

    # Looking at a place.

    def _place(self, args: wire.PointGimbal) -> Seen:
        level = args.pos is None and args.alt_amsl is None and args.alt_rel is None
        named = wire.GoTo(
            frame="global" if args.pos is None else "ned",
            pos=args.pos,
            lat_deg=args.lat_deg,
            lon_deg=args.lon_deg,
            alt_amsl=args.alt_amsl,
            alt_rel=0.0 if level else args.alt_rel,
        )
        place = resolve(named, self._origin)
        assert place.lat_deg is not None and place.lon_deg is not None
        amsl = place.alt_amsl
        if amsl is None:
            own = self._fields()
            amsl = (place.alt_rel or 0.0) + (own["alt"] - own["relative_alt"]) / 1e3
        return Seen(place.lat_deg, place.lon_deg, amsl)

    def _fields(self) -> Any:
        """GLOBAL_POSITION_INT; raises :class:`Refused` where the vehicle does not know where it is."""
        said = fields_of(self._port, "GLOBAL_POSITION_INT", self._do.source(), FRESH)
        if said is None or not (said["lat"] or said["lon"]):
            raise Refused("the vehicle does not know where it is: it cannot look at a place", vehicle=self._port.name)
        return said

    def _own_place(self) -> Seen:
        said = self._fields()
        return Seen(said["lat"] / 1e7, said["lon"] / 1e7, said["alt"] / 1e3)

    async def _track(self, target: Target, ranges: Ranges) -> None:
        """Until the next order, or until control is seen to have gone; an autopilot that is silent is waited for."""
        self._need(STATUS, 1.0)
        try:
            while True:
                source = self._identity.source
                said = fields_of(self._port, STATUS, source, FRESH)
                holder = self._port.address if said is None else _primary(said)
                if holder != self._port.address:
                    self._held, self._aim = False, ""
                    text = f"the gimbal is controlled by {self._words(holder)} now: it looks at {target.words} no more"
                    self._events.emit("gimbal", "notice", text)
                    return
                with contextlib.suppress(ZmavError):
                    self._look(target, ranges)
                await asyncio.sleep(PERIOD)
        finally:
            target.close()
            self._need(STATUS, 0.0)

    def _look(self, target: Target, ranges: Ranges) -> None:
        pitch, yaw = _direction(self._own_place(), target.now())
        flags = LEVEL | (LOCK if ranges.turns else 0)
        system, component = self._do.source()
        self._port.send(
            "GIMBAL_MANAGER_SET_ATTITUDE",
            target_system=system,
            target_component=component,
            flags=flags,
            gimbal_device_id=ranges.device,
            q=list(from_euler(0.0, pitch, yaw if ranges.turns else 0.0)),
            angular_velocity_x=NAN,
            angular_velocity_y=NAN,
            angular_velocity_z=NAN,
        )

    async def _pitch_yaw(self, pitch_deg: float, yaw_deg: float, flags: int, device: int) -> None:
        params = (pitch_deg, yaw_deg, NAN, NAN, float(flags), 0.0, float(device))
        await self._do.command(Command("MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW", params))

    def _stop(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._task, self._aim = None, ""


class Target:
    """What is looked at: a place, or a vehicle by its state. On the event loop."""

    def __init__(
        self, session: zenoh.Session, fleet: str, vehicle: str, place: Seen | None, is_vehicle: keys.IsVehicle
    ) -> None:
        self.words = vehicle or "a place"
        self._vehicle, self._seen, self._news = vehicle, place, asyncio.Event()
        self._subscriber: zenoh.Subscriber[Any] | None = None
        if vehicle:
            key = keys.STATE.key(fleet, keys.check_name(vehicle, "vehicle"))
            if not is_vehicle(fleet, vehicle):
                raise BadInput.wrong("vehicle", vehicle, "a vehicle of this fleet", f"{vehicle} is no vehicle")
            self._subscriber = session.declare_subscriber(key, on_loop(asyncio.get_running_loop(), self._on_state))

    async def found(self) -> None:
        """Wait until it is known where it is; raises :class:`Refused`."""
        if self._seen is None:
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._news.wait(), HEARD)
        if self._seen is None:
            raise Refused(f"{self.words} is not heard, or does not say where it is", reason="not heard")

    def now(self) -> Seen:
        """Where it is; of a vehicle that is silent, where it was."""
        seen = self._seen
        assert seen is not None
        late = min(time.monotonic() - seen.at, FRESH) if self._vehicle else 0.0
        north, east, down = (part * late for part in seen.vel)
        lat, lon, alt = geo.to_global(_origin(seen), (north, east, down))
        return Seen(lat, lon, alt)

    def close(self) -> None:
        if self._subscriber is not None:
            with contextlib.suppress(zenoh.ZError):  # the session has gone
                self._subscriber.undeclare()

    def _on_state(self, sample: zenoh.Sample) -> None:
        try:
            state = wire.decode(sample.payload.to_bytes(), wire.VehicleState, f"state of {self._vehicle}")
        except BadInput:
            return
        place, vel = state.position, state.velocity or (0.0, 0.0, 0.0)
        numbers = (place.lat_deg, place.lon_deg, place.alt_amsl, *vel) if place else (NAN,)
        if place is not None and all(map(math.isfinite, numbers)):
            self._seen = Seen(place.lat_deg, place.lon_deg, place.alt_amsl, vel, time.monotonic())
            self._news.set()


def _origin(seen: Seen) -> wire.Origin:
    return wire.Origin(lat_deg=seen.lat_deg, lon_deg=seen.lon_deg, alt_amsl=seen.alt_amsl)


def _direction(own: Seen, other: Seen) -> tuple[float, float]:
    """Pitch up from the horizon and yaw from north, rad."""
    north, east, down = geo.to_ned(_origin(own), other.lat_deg, other.lon_deg, other.alt_amsl)
    return math.atan2(-down, math.hypot(north, east)), math.atan2(east, north)


def _primary(said: Any) -> Holder:
    return said["primary_control_sysid"], said["primary_control_compid"]


def _range(low: float, high: float) -> tuple[float, float]:
    """In rad; PX4 1.16 tells degrees."""
    degrees = max(abs(low), abs(high)) > math.tau
    return (math.radians(low), math.radians(high)) if degrees else (low, high)


def _within(field: str, value: float, reach: tuple[float, float]) -> None:
    low, high = reach
    if not low - 1e-3 <= value <= high + 1e-3:
        expected = f"{math.degrees(low):.0f}° to {math.degrees(high):.0f}°"
        raise BadInput.wrong(field, value, expected, f"{field} {math.degrees(value):.0f}° is out of the gimbal's reach")


def _configure(system: int, component: int, device: int) -> Command:
    """DO_GIMBAL_MANAGER_CONFIGURE: who controls it; -3: nobody any more, where it is us."""
    return Command("MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE", (system, component, -1.0, -1.0, 0.0, 0.0, float(device)))
