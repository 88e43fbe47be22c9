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
from typing import Any

import zenoh

from zmav import geo, keys, wire
from zmav.autopilots import Command
from zmav.errors import BadInput, Refused, Unsupported, ZmavError
from zmav.rotation import euler, from_euler, wrap
from zmav.services.authority.may_move import MayMove
from zmav.services.authority.pilot import UNHEARD
from zmav.services.authority.targets import MAX_ANGLE, number, resolve
from zmav.services.companion import Companion
from zmav.services.link.reported import FRESH, fields_of
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Handler, Report
from zmav.waiting import on_loop, within

INFORMATION, STATUS = "GIMBAL_MANAGER_INFORMATION", "GIMBAL_MANAGER_STATUS"
NEUTRAL, LEVEL, LOCK = 2, 4 | 8, 16
"""GIMBAL_MANAGER_FLAGS: neutral; roll and pitch from the horizon; yaw from north"""
EARTH_FRAME = 64
"""of GIMBAL_DEVICE_FLAGS: its yaw is from north. Without it ArduPilot and PX4 tell it from the nose, locked or not"""
HAS_YAW = 256
"""of GIMBAL_MANAGER_CAP_FLAGS"""
ANSWER, TRIES = 1.0, 2
"""s that a message may come after it was asked for, and how often it is"""
HANDED_OVER = 3.0
"""s for the autopilot to tell of a new one who controls it"""
KNOWN = 10.0
"""s for which a gimbal that was found is not looked for again"""
PERIOD = 0.2
"""s between two sets of angles, while it looks at a place"""
HEARD = 3.0
"""s for the vehicle to be heard that is to be looked at"""
STICKS = (212.0, 213.0, 214.0)
"""RCn_OPTION of ArduPilot by which a channel moves the first gimbal: roll, pitch, yaw"""
CHANNELS, RC_HZ, MOVED = range(1, 17), 5.0, 20
"""of RC_CHANNELS: which may move it, how often they are read, and µs by which a stick that is moved differs"""
NOBODY = (0, 0)
NAN = math.nan
Fields = Any
"""of a MAVLink message"""
Holder = tuple[int, int]
"""system and component id of who controls it"""


class Gimbal:
    """Handlers of ``gimbal_*``. Lives on the event loop.

    ``need`` has messages flow from the autopilot (:meth:`zmav.services.rates.rates.Rates.need`); ``is_vehicle`` says
    of whom it is believed where they are; ``may_move`` is asked before each set of angles, and raises while two claim
    to be the vehicle; ``param``: the autopilot's parameter of that name, if known.
    """

    def __init__(
        self,
        companion: Companion,
        commander: Commander,
        need: Callable[[str, float], None],
        is_vehicle: keys.IsVehicle,
        may_move: MayMove[[]],
        param: Callable[[str], float | None],
    ) -> None:
        self._session, self._port, self._identity = companion.session, companion.port, companion.identity
        self._events, self._origin, self._do = companion.events, companion.origin, commander
        self._need, self._is_vehicle, self._may_move, self._param = need, is_vehicle, may_move, param
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
            "gimbal_release": self.release,
            "gimbal_status": self.status,
        }

    def close(self) -> None:
        """End; control is given back, once: nobody waits for the answer."""
        self._stop()
        if self._held:
            with contextlib.suppress(ZmavError):
                message = _configure(-3, -3).message(self._port.dialect)
                self._port.send(message.name, **message.addressed(*self._do.source()))

    # The orders.

    async def turn(self, args: wire.TurnGimbal, report: Report) -> dict[str, Any]:
        """Turn it. Raises :class:`BadInput` for angles out of its range, and what :meth:`_take` does."""
        for name in ("pitch", "yaw"):
            number(name, getattr(args, name), MAX_ANGLE)
        info, yaw, flags = await self._find(), wrap(args.yaw), LEVEL | (LOCK if args.lock else 0)
        angles = (NAN, NAN)
        if args.pitch is None:
            flags = NEUTRAL
        else:
            _within("pitch", args.pitch, info)
            if not _turns(info) and (args.lock or yaw):
                raise BadInput.wrong("yaw", args.yaw, "0, without lock", "the gimbal has no yaw axis")
            if _turns(info) and not args.lock:
                _within("yaw", yaw, info)
            angles = (math.degrees(args.pitch), math.degrees(yaw))
        await self._take(args.take)
        params = (*angles, NAN, NAN, float(flags), 0.0, float(info["gimbal_device_id"]))
        await self._do.command(Command("MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW", params))
        return {"pitch": args.pitch, "yaw": yaw, "lock": args.lock}

    async def point(self, args: wire.PointGimbal, report: Report) -> dict[str, Any]:
        """Have it look at a place or a vehicle from now on; without a yaw axis, up and down only."""
        if args.vehicle and {args.pos, args.lat_deg, args.lon_deg, args.alt_amsl, args.alt_rel} != {None}:
            raise BadInput.wrong("vehicle", args.vehicle, "one of them", "a vehicle and a place are given")
        if args.vehicle and (args.vehicle == self._port.name or not self._is_vehicle(self._port.fleet, args.vehicle)):
            raise BadInput.wrong("vehicle", args.vehicle, "another vehicle of this fleet")
        place = None if args.vehicle else self._place(args)
        target = Target(self._session, self._port.fleet, args.vehicle, place)
        try:
            await target.found()
            pitch, yaw = _direction(self._own_place(), target.now())
            info = await self._take(args.take)
        except BaseException:
            target.close()
            raise
        self._stop()  # what another order began meanwhile
        self._aim = target.words
        self._task = asyncio.get_running_loop().create_task(self._track(target, info))
        return {"at": self._aim, "pitch": pitch, "yaw": yaw, "turns": _turns(info)}

    async def release(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Look at nothing any more, and give control back where it is ours."""
        self._stop()  # first: also where it does not answer now
        await self._find()
        await self._do.command(_configure(-3, -3))
        self._held = False
        return {"controller": self._words(await self._holder(lambda holder: holder != self._port.address))}

    async def status(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Where it looks, and who controls it; raises :class:`Refused` where there is none."""
        info = await self._find()
        looks = await self._asked("GIMBAL_DEVICE_ATTITUDE_STATUS")
        own = fields_of(self._port, "ATTITUDE", self._do.source(), FRESH)
        said: dict[str, Any] = {"controller": self._words(await self._holder()), "at": self._aim}
        if looks is not None:
            _, said["pitch"], yaw = euler(looks["q"])
            nose = NAN if own is None else own["yaw"]
            north = yaw if looks["flags"] & EARTH_FRAME else yaw + nose
            said |= {"yaw": wrap(north - nose) if looks["flags"] & EARTH_FRAME else yaw, "heading": wrap(north)}
        reach = {f"{axis}_range": _reach(axis, info) for axis in ("pitch", "yaw")}
        return {**said, "turns": _turns(info), **reach}

    # Who is there, and who has it.

    async def _find(self) -> Fields:
        """Its GIMBAL_MANAGER_INFORMATION; raises :class:`Refused` where no gimbal manager of the autopilot answers."""
        said = fields_of(self._port, INFORMATION, self._do.source(), KNOWN) or await self._asked(INFORMATION)
        if said is None:
            raise self._none()
        return said

    def _none(self) -> Refused:
        text = "no gimbal answers: the autopilot has none, or it is not set up (docs/gimbal.md)"
        return Refused(text, vehicle=self._port.name, reason="no gimbal")

    async def _asked(self, name: str) -> Fields | None:
        """The fields of a message that is asked for; None: it does not come."""
        command = Command("MAV_CMD_REQUEST_MESSAGE", (float(self._port.msgid(name)),))
        with self._do.inbox(name) as inbox:
            for _ in range(TRIES):
                with contextlib.suppress(Refused, Unsupported):
                    await self._do.command(command)
                    if (heard := await inbox.get(ANSWER)) is not None:
                        return heard[1]
        return None

    async def _holder(self, wanted: Callable[[Holder], bool] = lambda holder: True) -> Holder:
        """Who controls it, once that is as ``wanted``, or after :data:`HANDED_OVER`: PX4 tells it once a second."""
        until = time.monotonic() + HANDED_OVER
        while (said := await self._asked(STATUS)) is not None:
            if wanted(holder := _primary(said)) or time.monotonic() > until:
                return holder
            await asyncio.sleep(PERIOD)
        raise self._none()

    async def _take(self, from_others: bool) -> Fields:
        """Have control, and end what was looked at; raises :class:`Refused` where somebody else has it, unless it may
        be taken ``from_others``.
        """
        info, holder, ours = await self._find(), await self._holder(), self._port.address
        who = self._words(holder)
        if holder not in (NOBODY, ours) and not from_others:
            text = f"the gimbal is controlled by {who}: it is taken with take=true (--take)"
            raise Refused(text, vehicle=self._port.name, controller=who, reason="controlled")
        self._stop()
        if holder != ours:
            await self._do.command(_configure(*ours))
            self._held = True  # it may yet become so, and is given back then
            if (now := await self._holder(lambda holder: holder == ours)) != ours:
                raise Refused(f"the gimbal is still controlled by {self._words(now)}", vehicle=self._port.name)
            if holder != NOBODY:
                self._events.emit("gimbal", "notice", f"the gimbal is taken from {who}")
        self._held = True
        return info

    def _words(self, holder: Holder) -> str:
        known = {NOBODY: "nobody", self._port.address: "us"}
        if holder == self._identity.source:
            return "the autopilot itself, for the pilot's sticks"
        return known.get(holder, f"{holder[0]}/{holder[1]}")

    def _stop(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._task, self._aim = None, ""

    # Looking at a place.

    def _place(self, args: wire.PointGimbal) -> wire.Origin:
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
        return wire.Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_amsl=amsl)

    def _fields(self) -> Fields:
        """GLOBAL_POSITION_INT; raises :class:`Refused` where the vehicle does not know where it is."""
        said = fields_of(self._port, "GLOBAL_POSITION_INT", self._do.source(), FRESH)
        if said is None or not (said["lat"] or said["lon"]):
            raise Refused("the vehicle does not know where it is: it cannot look at a place", vehicle=self._port.name)
        return said

    def _own_place(self) -> wire.Origin:
        said = self._fields()
        return wire.Origin(lat_deg=said["lat"] / 1e7, lon_deg=said["lon"] / 1e7, alt_amsl=said["alt"] / 1e3)

    async def _track(self, target: Target, info: Fields) -> None:
        """Until the next order, until control is seen to have gone, or until the pilot moves it. While it is not known
        who has control, an autopilot's that is silent for example, nothing is sent: it may be another's by now.
        """
        self._need(STATUS, 1.0)
        self._need("RC_CHANNELS", RC_HZ)
        rest: dict[int, int] = {}
        try:
            while True:
                known = await self._tells()
                if why := self._gone(rest):
                    self._aim = ""
                    self._events.emit("gimbal", "notice", f"{why}: it looks at {target.words} no more")
                    return
                if known:
                    with contextlib.suppress(ZmavError):
                        self._look(target, info)
                await asyncio.sleep(PERIOD if known else ANSWER)
        finally:
            target.close()
            self._need(STATUS, 0.0)
            self._need("RC_CHANNELS", 0.0)

    async def _tells(self) -> bool:
        """It has told of late who controls it; it is asked where that does not come by itself."""
        if fields_of(self._port, STATUS, self._identity.source, FRESH) is not None:
            return True
        with contextlib.suppress(ZmavError):
            return await self._asked(STATUS) is not None
        return False

    def _gone(self, rest: dict[int, int]) -> str:
        """Who has it now instead of us; empty: nobody. ``rest``: where the pilot's sticks were, in µs, at first."""
        said = fields_of(self._port, STATUS, self._identity.source, FRESH)
        if said is not None and _primary(said) != self._port.address:
            self._held = False
            return f"the gimbal is controlled by {self._words(_primary(said))} now"
        # ArduPilot obeys its pilot's sticks besides, and does not tell: the next angles would take it from him.
        radio = fields_of(self._port, "RC_CHANNELS", self._identity.source, FRESH)
        if radio is None:
            return ""
        for channel in CHANNELS:
            pwm = int(radio[f"chan{channel}_raw"])
            if pwm in UNHEARD or self._param(f"RC{channel}_OPTION") not in STICKS:
                continue
            if abs(pwm - rest.setdefault(channel, pwm)) > MOVED:
                return f"the pilot moves the gimbal (channel {channel})"
        return ""

    def _look(self, target: Target, info: Fields) -> None:
        self._may_move()
        pitch, yaw = _direction(self._own_place(), target.now())
        system, component = self._do.source()
        self._port.send(
            "GIMBAL_MANAGER_SET_ATTITUDE",
            target_system=system,
            target_component=component,
            flags=LEVEL | (LOCK if _turns(info) else 0),
            gimbal_device_id=info["gimbal_device_id"],
            q=list(from_euler(0.0, pitch, yaw if _turns(info) else 0.0)),
            **{f"angular_velocity_{axis}": NAN for axis in "xyz"},
        )


class Target:
    """What is looked at: a place, or a vehicle by its state. On the event loop."""

    def __init__(self, session: zenoh.Session, fleet: str, vehicle: str, place: wire.Origin | None) -> None:
        self.words = vehicle or "a place"
        self._place, self._news = place, asyncio.Event()
        self._vel, self._at = (0.0, 0.0, 0.0), 0.0
        """m/s NED; monotonic seconds"""
        self._held: Any = None
        if vehicle:
            key = keys.STATE.key(fleet, keys.check_name(vehicle, "vehicle"))
            self._held = session.declare_subscriber(key, on_loop(asyncio.get_running_loop(), self._on_state))

    async def found(self) -> None:
        """Wait until it is known where it is; raises :class:`Refused`."""
        if self._place is None:
            with contextlib.suppress(asyncio.TimeoutError):
                await within(HEARD, self._news.wait())
        if self._place is None:
            raise Refused(f"{self.words} is not heard, or does not say where it is", reason="not heard")

    def now(self) -> wire.Origin:
        """Where it is; of a vehicle that is silent, where it was."""
        assert self._place is not None
        north, east, down = (part * min(time.monotonic() - self._at, FRESH) for part in self._vel)
        lat, lon, amsl = geo.to_global(self._place, (north, east, down))
        return wire.Origin(lat_deg=lat, lon_deg=lon, alt_amsl=amsl)

    def close(self) -> None:
        if self._held is not None:
            with contextlib.suppress(zenoh.ZError):  # the session has gone
                self._held.undeclare()

    def _on_state(self, sample: zenoh.Sample) -> None:
        try:
            state = wire.decode(sample.payload.to_bytes(), wire.VehicleState, f"state of {self.words}")
        except BadInput:
            return
        if (place := state.position) is not None:
            self._place = wire.Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_amsl=place.alt_amsl)
            self._vel, self._at = state.velocity or (0.0, 0.0, 0.0), time.monotonic()
            self._news.set()


def _direction(own: wire.Origin, other: wire.Origin) -> tuple[float, float]:
    """Pitch up from the horizon and yaw from north, rad."""
    north, east, down = geo.to_ned(own, other.lat_deg, other.lon_deg, other.alt_amsl)
    return math.atan2(-down, math.hypot(north, east)), math.atan2(east, north)


def _primary(said: Fields) -> Holder:
    return said["primary_control_sysid"], said["primary_control_compid"]


def _turns(info: Fields) -> bool:
    """It has a yaw axis."""
    return bool(info["cap_flags"] & HAS_YAW)


def _reach(axis: str, info: Fields) -> tuple[float, float]:
    """In rad; PX4 1.16 tells degrees."""
    low, high = info[f"{axis}_min"], info[f"{axis}_max"]
    return (math.radians(low), math.radians(high)) if max(abs(low), abs(high)) > math.tau else (low, high)


def _within(axis: str, value: float, info: Fields) -> None:
    low, high = _reach(axis, info)
    if not low - 1e-3 <= value <= high + 1e-3:
        expected = f"{math.degrees(low):.0f}° to {math.degrees(high):.0f}°"
        raise BadInput.wrong(axis, value, expected, f"{axis} {math.degrees(value):.0f}° is out of the gimbal's reach")


def _configure(system: int, component: int) -> Command:
    """DO_GIMBAL_MANAGER_CONFIGURE: who controls it; -3: nobody any more, where it is us."""
    return Command("MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE", (system, component, -1.0, -1.0))
