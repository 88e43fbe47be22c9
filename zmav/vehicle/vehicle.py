"""A vehicle as a script sees it: state with its age, orders that end well or in a typed error, streams, setpoints."""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from collections.abc import AsyncIterator, Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import msgspec
import zenoh

from zmav import geo, keys, wire
from zmav.errors import BadInput, NoSuchVehicle, Refused, Stale, TimedOut, ZmavError
from zmav.mavlink import MavMessage, decode, describe, parse_frame
from zmav.vehicle.files import Files, Logs
from zmav.vehicle.lease import Lease, take_lease
from zmav.vehicle.missions import Missions
from zmav.vehicle.params import Params
from zmav.vehicle.rates import Rates, want_key
from zmav.vehicle.terrain import GroundPieces
from zmav.verbs import GRANTABLE, VERBS
from zmav.waiting import cancelled
from zmav.wire.orders import OTHER, UNKNOWN

if TYPE_CHECKING:
    from zmav.client import Answer, Client
    from zmav.subscription import Subscription

LARGE = 1 << 16
"""bytes from which on an order is sent in the class of files, for it has one in it: others must not wait behind it"""
APPEAR = 1.0
"""s for a vehicle that has not been heard to appear: the session may just have been opened"""

FAST_CLOCK = 20_000.0
"""ppm by which the autopilot's clock may differ: beyond, it is a simulation's and tells no UTC"""

Progress = Callable[[dict[str, Any]], None]


def is_meant(answer: Answer | ZmavError) -> bool:
    """Where two vehicles have one name, the one that was not meant says so."""
    return not isinstance(answer, ZmavError) or answer.detail.get("reason") != OTHER


class Place(NamedTuple):
    """Where the vehicle was at ``t`` (UTC s): m and m/s, NED about the fleet's origin."""

    t: float
    pos: wire.Vector
    vel: wire.Vector


class Vehicle:
    """A handle, cheap to make; nothing is sent until something is asked.

    Orders raise :class:`~zmav.errors.Refused` with the autopilot's reason, :class:`~zmav.errors.TimedOut`,
    :class:`~zmav.errors.NoSuchVehicle`, :class:`~zmav.errors.Stale`, :class:`~zmav.errors.NotHolder` or
    :class:`~zmav.errors.Clash`. The vehicle sees an order through by itself: who stops waiting for it does not end it;
    :meth:`hold` does.
    """

    ask_again = 2.0
    """s without an answer after which a vehicle is asked once more; the order itself may last much longer"""
    give_up = 10.0
    """s without any answer from a vehicle that has been heard"""

    def __init__(self, client: Client, name: str, fleet: str) -> None:
        self._client, self.name, self._within = client, name, fleet
        self._lease = ""
        self.params = Params(self)
        self.files = Files(self, client)
        self.logs = Logs(self, self.files)
        self.rates = Rates(self, client)
        self.terrain = GroundPieces(self)

    def __repr__(self) -> str:
        return f"Vehicle({self.name!r})"

    # What it is and does.

    @property
    def fleet(self) -> str:
        """The fleet it flies in. A client of all fleets finds it by the vehicle's name: raises :class:`NoSuchVehicle`,
        or :class:`BadInput` where several fleets have one of that name.
        """
        if self._within != "*":
            return self._within
        found = self._client.fleets_of(self.name)
        if not found:
            raise NoSuchVehicle(f"{self.name} has not been heard in any fleet", vehicle=self.name)
        if len(found) > 1:
            text = f"{self.name} is in the fleets {', '.join(found)}: open one of them"
            raise BadInput(text, field="fleet", value="*", expected=" or ".join(found))
        return found[0]

    @property
    def state(self) -> wire.VehicleState:
        """The last state heard; raises :class:`NoSuchVehicle` or :class:`Stale` where it cannot be relied on."""
        heard = self._client.heard(self.name, self._within)
        if heard is None:
            raise NoSuchVehicle(f"{self.name} has not been heard", vehicle=self.name)
        age, limit = time.monotonic() - heard.at, keys.STATE.stale_after or 0.0
        if age > limit:
            raise Stale(f"{self.name} was last heard {age:.1f} s ago", vehicle=self.name, age=age)
        return heard.state

    @property
    def local(self) -> wire.Vector:
        """Where it is: metres north, east and down of the fleet's origin. Raises as :attr:`state`, and :class:`Refused`
        where it has no position or no origin was declared.
        """
        state = self.state
        if state.local is None:
            text = "no fleet origin: start 'zmav up' with --origin" if state.position else "no position yet"
            raise Refused(f"{self.name} has {text}", vehicle=self.name)
        return state.local

    @property
    def last_state(self) -> wire.VehicleState | None:
        """The last state heard, however old; None: never."""
        heard = self._client.heard(self.name, self._within)
        return heard.state if heard else None

    @property
    def age(self) -> float | None:
        """Seconds since its state was last heard; None: never."""
        heard = self._client.heard(self.name, self._within)
        return time.monotonic() - heard.at if heard else None

    @property
    def present(self) -> bool:
        return self._client.present(self.name, self._within)

    @property
    def disbelieved(self) -> list[str]:
        """Why something said in its name was not believed; with credentials only."""
        return self._client.disbelieved(self.name, self._within)

    async def wait_until(self, true: Callable[[wire.VehicleState], bool], timeout: float) -> wire.VehicleState:
        """Wait for a state of which ``true`` holds; raises :class:`TimedOut`."""
        deadline = time.monotonic() + timeout
        while True:
            state = self.last_state
            if state is not None and true(state):
                return state
            if not await self._client.news(deadline - time.monotonic()) and time.monotonic() >= deadline:
                raise TimedOut(f"{self.name}: it did not come true within {timeout:.0f} s", vehicle=self.name)

    async def message(self, name: str) -> wire.LastMessage:
        """The last message of that name, decoded, with its age; raises :class:`BadInput` if none came."""
        answer = await self._ask(keys.MSG.key(self.fleet, self.name, msg=keys.check_message(name)))
        return wire.decode(answer, wire.LastMessage, f"reply to msg/{name}")

    def stream(self, name: str, depth: int = 1000, hz: float | None = None) -> Subscription[MavMessage]:
        """Every message of that name: ``async with vehicle.stream("ATTITUDE") as s: async for message in s: ...``.
        Those of others on its autopilot's link are in it: see :meth:`is_autopilot`.

        With ``hz``, the autopilot is asked for that many a second as long as it is read; the fastest reader decides.
        Raises :class:`~zmav.errors.BadMessage` where the dialect lacks it; ``UNKNOWN_44000`` names it by its number.
        """
        dialect = self._client.dialect
        if not keys.check_message(name).startswith("UNKNOWN_"):
            dialect.message(name)

        def convert(sample: zenoh.Sample) -> MavMessage:
            return describe(parse_frame(sample.payload.to_bytes(), dialect), dialect)

        key = keys.RX.key(self._within, self.name, sys="*", comp="*", msg=name)
        return self._client.subscribe(key, convert, depth, token=want_key(key, hz) if hz is not None else "")

    def places(self, hz: float, depth: int = 200) -> Subscription[Place]:
        """Where it is, ``hz`` times a second: between its states, too. As :meth:`stream`, but only what its autopilot
        says: of others on its link, it would be their place.
        """
        dialect = self._client.dialect

        def convert(sample: zenoh.Sample) -> Place:
            frame, state = parse_frame(sample.payload.to_bytes(), dialect), self.last_state
            if state is None or state.local is None or state.position is None:
                raise BadInput(f"{self.name} has not said where it is", field="position")
            if not self.is_autopilot(frame.sysid, frame.compid):
                raise BadInput(f"that is where {frame.sysid}/{frame.compid} is, not {self.name}", field="sysid")
            fields = decode(frame, dialect)
            vx, vy, vz = (float(fields[name]) / 100.0 for name in ("vx", "vy", "vz"))
            pos = geo.in_fleet_frame(state.position, state.local, fields)
            return Place(self.time_of(fields), pos, (vx, vy, vz))

        key = keys.RX.key(self._within, self.name, sys="*", comp="*", msg="GLOBAL_POSITION_INT")
        return self._client.subscribe(key, convert, depth, token=want_key(key, hz))

    def is_autopilot(self, sysid: int, compid: int) -> bool:
        """Whether that MAVLink address is its autopilot's, as its state says: others may be on its link."""
        state = self.last_state
        return state is not None and (state.sysid, state.compid) == (sysid, compid)

    def time_of(self, fields: Mapping[str, Any]) -> float:
        """UTC s of a message's ``time_boot_ms`` by the vehicle's clock; now, where that is not known or no real one."""
        clock = self.last_state.clock if self.last_state is not None else None
        if clock is None or abs(clock.drift_ppm) > FAST_CLOCK:
            return time.time()
        return clock.boot_t + float(fields["time_boot_ms"]) / 1e3

    def events(self, depth: int = 50) -> Subscription[wire.Event]:
        """What it says that happened, as it comes."""
        key = keys.EVENT.key(self._within, self.name)
        return self._client.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), wire.Event, "event"), depth)

    @property
    def missions(self) -> Missions:
        """Missions, fences and rally points."""
        return Missions(self, self._client.dialect)

    # Orders.

    async def arm(self, *, ready_timeout: float = 60.0, progress: Progress | None = None) -> None:
        """Wait up to ``ready_timeout`` seconds until the autopilot is ready, and arm."""
        await self.order("arm", wire.Arm(ready_timeout=ready_timeout), progress)

    async def disarm(self) -> None:
        """Disarm; refused in the air."""
        await self.order("disarm", wire.Order())

    async def takeoff(self, alt_rel: float, *, progress: Progress | None = None) -> None:
        """Climb to ``alt_rel`` metres above home; returns when there."""
        await self.order("takeoff", wire.Takeoff(alt_rel=alt_rel), progress)

    async def goto(
        self,
        *,
        pos: wire.Vector | None = None,
        lat_deg: float | None = None,
        lon_deg: float | None = None,
        alt_amsl: float | None = None,
        alt_rel: float | None = None,
        yaw: float | None = None,
        tolerance: float = 1.0,
        timeout: float = 300.0,
        arrive: bool = True,
        speed: float | None = None,
        radius: float | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Fly to ``pos`` (m, NED about the fleet's origin) or to a WGS84 place; returns on arrival. ``speed`` (m/s) and
        ``radius`` (m of a plane's circle there, negative: counter-clockwise) as in :class:`zmav.wire.GoTo`.
        """
        frame: Literal["ned", "global"] = "ned" if pos is not None else "global"
        args = wire.GoTo(
            frame=frame,
            pos=pos,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_amsl=alt_amsl,
            alt_rel=alt_rel,
            yaw=yaw,
            tolerance=tolerance,
            timeout=timeout,
            arrive=arrive,
            speed=speed,
            radius=radius,
        )
        await self.order("goto", args, progress)

    async def hold(self) -> None:
        """Stop where it is; open to everybody."""
        await self.order("hold", wire.Order())

    async def land(self, *, progress: Progress | None = None) -> None:
        """Land where it is; returns when it has disarmed; open to everybody."""
        await self.order("land", wire.Order(), progress)

    async def rtl(self, *, progress: Progress | None = None) -> None:
        """Return to launch, open to everybody; returns when it is disarmed there, or stands or circles there."""
        await self.order("rtl", wire.Order(), progress)

    async def reboot(self) -> None:
        """Restart the disarmed autopilot; returns when it is heard again."""
        await self.order("reboot", wire.Order())

    async def command(
        self,
        name: str,
        params: dict[str, float | str | None] | None = None,
        *,
        frame: str | None = None,
        progress: Progress | None = None,
    ) -> dict[str, Any]:
        """Any MAV_CMD by name, its parameters by the dialect's labels or as ``param1`` to ``param7``.

        Raises :class:`BadInput` naming the parameters there are.
        """
        args = wire.RunCommand(command=name, params=params or {}, frame=frame)
        return await self.order("command", args, progress)

    async def gimbal(self, verb: Literal["point", "turn", "release", "status"], **args: Any) -> dict[str, Any]:
        """Have its gimbal look somewhere: the arguments are those of :class:`zmav.wire.PointGimbal` and
        :class:`zmav.wire.TurnGimbal`. Raises :class:`Refused` where no gimbal answers, or somebody else controls it.
        """
        name = f"gimbal_{verb}"
        return await self.order(name, wire.build(args, VERBS[name].args, name))

    async def set_mode(self, mode: str) -> None:
        """Enter a flight mode by its name (``LOITER``)."""
        await self.order("set_mode", wire.SetMode(mode=mode))

    async def order(self, verb: str, args: wire.Order, progress: Progress | None = None) -> dict[str, Any]:
        """Give an order and see it through: sent again with the same id until the vehicle says how it ended."""
        args = msgspec.structs.replace(
            args, id=uuid.uuid4().hex, lease=args.lease or self._lease, given=args.given or time.time()
        )
        payload = wire.encode_request(args)
        again = wire.encode(wire.Again(again=args.id)) if len(payload) >= LARGE else payload
        return await self._see_through(keys.DO.key(self.fleet, self.name, verb=verb), payload, again, progress)

    async def tell(
        self, agent: str, verb: str, progress: Progress | None = None, /, **arguments: Any
    ) -> dict[str, Any]:
        """Give an order to an agent that runs for this vehicle (:class:`zmav.Agent`), and see it through. Raises
        :class:`TimedOut` where none of that name answers, and what the agent refuses it with.
        """
        key = keys.AGENT_DO.key(self.fleet, self.name, agent=keys.check_name(agent, "agent"), verb=verb)
        wire.check_finite(arguments)
        try:
            payload = msgspec.json.encode({**arguments, "id": uuid.uuid4().hex})
            return await self._see_through(key, payload, payload, progress)
        except TimedOut as e:
            text = f"no agent {agent} answers for {self.name}: start 'zmav agent run {agent} --vehicle {self.name}'"
            raise TimedOut(text, vehicle=self.name, agent=agent) from e

    async def _see_through(self, key: str, payload: bytes, again: bytes, progress: Progress | None) -> dict[str, Any]:
        """``again``: what is asked instead of ``payload`` once that was sent."""
        if keys.is_replay(self.fleet):
            raise Refused(f"{self.name} is a recording: it takes no orders", vehicle=self.name, fleet=self.fleet)
        come = False
        while True:
            outcome = wire.decode(await self._ask(key, payload, again, come), wire.Outcome, f"reply to {key}")
            come = True
            if outcome.status == "done":
                return outcome.result
            if progress is not None:
                progress(outcome.result)

    async def ping(self) -> float:
        """Seconds a query takes to the vehicle and back."""
        start = time.perf_counter()
        await self._ask(keys.DO.key(self.fleet, self.name, verb="ping"))
        return time.perf_counter() - start

    @contextlib.asynccontextmanager
    async def lease(self, holder: str, ttl: float = 3.0, priority: int = 0) -> AsyncIterator[Lease]:
        """Command the vehicle alone while the ``async with`` lasts; renewed by itself. A higher ``priority`` (0 to 100)
        takes it from a lower one. Raises :class:`NotHolder`, or Refused while the pilot's switch says that he has it.
        """
        async with take_lease(self, self._client, holder, ttl, priority) as lease:
            self._lease = lease.token
            try:
                yield lease
            finally:
                self._lease = ""

    async def revoke(self, reason: str = "") -> str | None:
        """As an operator, end anybody's lease: the vehicle holds. Returns who held it."""
        ended = await self.order("revoke", wire.RevokeLease(reason=reason))
        return ended["holder"] and str(ended["holder"])

    async def _ask(self, key: str, payload: bytes = b"", again: bytes | None = None, come: bool = False) -> bytes:
        """One answer from this vehicle; asked again for a while where none comes: the network may have a hole.

        What was asked before stays open: over bad hops every answer may take longer than :attr:`ask_again`. ``again``
        is sent instead of ``payload`` where that was sent already, or has ``come`` there: it travels behind it.
        """
        again = payload if again is None else again
        send = again if come else payload
        start = time.monotonic()
        channel = keys.DO if len(payload) < LARGE else keys.FILE_CHUNK
        asked: set[asyncio.Task[list[Answer | ZmavError]]] = set()
        try:
            while True:
                asked.add(asyncio.ensure_future(self._client.ask(key, send, self.give_up, channel)))
                send = again
                done, asked = await asyncio.wait(asked, timeout=self.ask_again, return_when=asyncio.FIRST_COMPLETED)
                answers = [answer for task in done for answer in task.result()]
                # Where two have one name, the last word is that of the one that is meant, whichever came first; the
                # other's is none as long as the one that is meant may not have been found.
                meant = [answer for answer in answers if is_meant(answer)]
                for answer in reversed(meant or (answers if time.monotonic() - start > APPEAR else [])):
                    if again != payload and isinstance(answer, Refused) and answer.detail.get("reason") == UNKNOWN:
                        send = payload  # it was lost on the way
                        continue
                    if isinstance(answer, ZmavError):
                        raise answer
                    return answer.payload
                if self._client.member is not None:
                    self._client.member.check_role(key, GRANTABLE)
                waited = time.monotonic() - start
                if self.age is None and not self.present and waited > APPEAR:
                    raise NoSuchVehicle(f"no vehicle {self.name} is present in fleet {self.fleet}", vehicle=self.name)
                if waited > self.give_up:
                    break
                await asyncio.sleep(0.1)
        finally:
            await cancelled(*asked)
        if self._client.member is not None:
            self._client.member.check_role(key)
        if not self.present:
            raise Stale(f"{self.name} was last heard {self.age or 0.0:.1f} s ago", vehicle=self.name, age=self.age)
        doubts = f"; not believed: {', '.join(self.disbelieved)}" if self.disbelieved else ""
        raise TimedOut(f"{self.name} does not answer on {key}{doubts}", vehicle=self.name)
