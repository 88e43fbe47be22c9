"""Fly verified plans with real vehicles: leases, clocks and the network around a :class:`~.conductor.Conductor`."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

import zmav
from agents.planner.execute.commit import Part
from agents.planner.execute.conductor import Conductor, Phase
from agents.planner.execute.flight import SLACK, Flight, Outcome, Replan, Say, Trouble, margin_for
from agents.planner.execute.following import Following
from agents.planner.execute.offset import Offset
from agents.planner.execute.track import Track
from agents.planner.execute.vehicle_command import Clock, VehicleCommand
from agents.planner.live.frames import enu
from agents.planner.model.problem import Floats, MovingObstacle
from zmav.errors import NotHolder, Refused, Stale, TimedOut, ZmavError
from zmav.waiting import alongside, cancelled

if TYPE_CHECKING:
    from agents.planner.returning.keeper import ReturnKeeper

Own = TypeVar("Own", bound="Executor")
TICK = 0.1
"""s between two looks at everything"""
NEWS = 0.5
"""s in which those that are at their goals say so, and are not told to stay yet"""
MAX_CLOCK = 0.2
"""s by which a vehicle's clock may be other than measured"""
NEAR_START = 1.0
"""m that a vehicle may be away from where its motion begins"""
SETTLE, NEARER, MISSES = 5.0, 0.1, 3
"""s for vehicles to come to their places at the end, or nearer by so many m; how often a new plan is made for those who
did not"""
PATIENCE = 20.0
"""s for which those who are not heard, or were moved aside, are waited for before a new plan is made without them"""
TAKE_AGAIN = 0.5
"""s between two times that a lease is asked for"""
PER_TICK = 25
"""trajectories that are made in one look, so that the loop is not held up"""


def clock_error(name: str, offset: Offset, now: float) -> float:
    """s by which a vehicle's clock may be other than measured; raises :class:`~zmav.errors.Refused` where that is too
    much for any plan.
    """
    error = offset.error(now)
    if not error <= MAX_CLOCK:
        text = f"the clock of {name} is known to ±{1e3 * error:.0f} ms only; at most {1e3 * MAX_CLOCK:.0f} will do"
        raise Refused(text, vehicle=name, error_s=error)
    return error


class Executor:
    """``async with Executor(z, names) as executor: outcome = await executor.run(flight)``.

    Entering takes every vehicle's lease and measures its clock, leaving gives the leases back once all are at rest.
    ``clock`` and ``offsets``: what is known of the vehicles' clocks already, and goes on to be; ``followings``: of how
    they follow what they are told. ``homes`` has a way home ready for each vehicle.
    ``say`` is told what happens, ``replan`` asked for a new plan when this one cannot be ended. Raises
    :class:`~zmav.errors.NotHolder` while another commands a vehicle, after ``taking`` seconds in which each lease was
    asked for again and again; ``waits`` is told why. A pilot is not waited for. Of many, those that do not answer in
    that time are left out (:attr:`left`), as long as most do.
    """

    def __init__(
        self,
        z: zmav.Client,
        names: Iterable[str],
        *,
        holder: str = "planner",
        say: Say = lambda kind, severity, text, detail: None,
        replan: Replan | None = None,
        clock: Clock | None = None,
        offsets: Mapping[str, Offset] | None = None,
        followings: Mapping[str, Following] | None = None,
        taking: float = 0.0,
        waits: Callable[[str], None] = lambda text: None,
        homes: ReturnKeeper | None = None,
    ) -> None:
        self.clock, known = clock or Clock(), offsets or {}
        self._taking, self._waits, self._hurry = taking, waits, False
        self.left: dict[str, ZmavError] = {}
        """who did not answer when the leases were taken"""
        self.commands = {name: VehicleCommand(z, name, self.clock, holder, known.get(name)) for name in names}
        self._say, self._replan, self._homes = say, replan, homes
        self.followings = {name: (followings or {}).get(name) or Following() for name in self.commands}
        self._stack = contextlib.AsyncExitStack()
        self._conductor: Conductor | None = None
        self._ghosts: list[Part] = []
        self._paused = False

    async def __aenter__(self: Own) -> Own:
        taking = [asyncio.create_task(self._take(command)) for command in self.commands.values()]
        try:
            for taken in asyncio.as_completed(taking):
                await taken
            if self.left and 2 * len(self.left) >= len(self.commands):
                raise next(iter(self.left.values()))
        except BaseException:
            await cancelled(*taking)
            await self._stack.aclose()
            raise
        for name in self.left:
            del self.commands[name]
        return self

    async def _take(self, command: VehicleCommand) -> None:
        until = self.clock.now() + self._taking
        while True:
            try:
                await self._stack.enter_async_context(command)
                return
            except (NotHolder, Stale, TimedOut) as e:
                if e.detail.get("reason") == "pilot" or (self.clock.now() >= until and isinstance(e, NotHolder)):
                    raise
                if self.clock.now() >= until:
                    self.left[command.name] = e
                    return
                self._waits(e.message)
            await asyncio.sleep(TAKE_AGAIN)

    async def __aexit__(self, *exc: object) -> None:
        await self._stack.aclose()

    @property
    def phase(self) -> Phase | None:
        """None: nothing is flown."""
        return None if self._conductor is None else self._conductor.phase(self.clock.now())

    @property
    def progress(self) -> float:
        """0 to 1."""
        return self._conductor.progress(self.clock.now()) if self._conductor else 0.0

    @property
    def committed(self) -> list[MovingObstacle]:
        """All that each vehicle of this flight may be flying, on our UTC: to others these are movers."""
        parts = self._conductor.parts if self._conductor else []
        return [MovingObstacle(part.id, entry.samples, part.need) for part in parts for entry in part.entries]

    def meant(self) -> dict[str, tuple[Floats, Floats]]:
        """Where each vehicle of this flight is meant to be now, and its velocity: (3,) each, ENU."""
        now = self.clock.now()
        return {part.id: part.place_at(now) for part in (self._conductor.parts if self._conductor else [])}

    def pause(self) -> None:
        """Everybody comes to rest along its way, as soon as that is clear."""
        self._paused = True
        if self._conductor:
            self._conductor.pause()

    def resume(self) -> None:
        self._paused = False
        if self._conductor:
            self._conductor.resume()

    def halt(self, why: str) -> None:
        """As :meth:`pause`, for good: :meth:`run` asks for a new plan at once, or ends."""
        self._hurry = True
        if self._conductor:
            self._conductor.halt(why)

    def avoid(self, movers: Sequence[MovingObstacle]) -> None:
        """What moves by itself (on our UTC), from now on; who cannot stay clear of it stops, and a new plan is made."""
        conductor, now = self._conductor, self.clock.now()
        if conductor is None:
            return
        conductor.reserved.movers = list(movers)
        for part in conductor.parts:
            if part.active and (who := conductor.reserved.blocked_by_mover(part, now)):
                conductor.halt(f"{who} is about to cross the way of {part.id}", vehicle=part.id, mover=who)

    def obstructed(self, clear: Callable[[Floats, Floats, float], bool], why: str) -> None:
        """The world has changed: ``clear(p, q, radius)`` says whether a straight piece is. Where something is in
        anybody's way all come to rest as soon as they can, and a new plan is made.
        """
        conductor, now = self._conductor, self.clock.now()
        if conductor is None or conductor.halting:
            return
        for part in conductor.parts:
            if not part.is_clear(now, clear):
                conductor.halt(f"{why} in the way of {part.id}", vehicle=part.id)
                return

    async def run(self, flight: Flight) -> Outcome:
        """Fly it to its end, replanned as often as needed. Raises :class:`~zmav.errors.Refused` before anything moves
        where a vehicle is not at its start, its clock is not known well enough, or the plan has too little margin.
        """
        replans = missed = 0
        self._ghosts, self._hurry = [], False
        try:
            while True:
                conductor = self._prepare(flight)
                reason = await self._fly(conductor)
                if not reason:
                    reason = await self._arrived(flight, conductor)
                    missed += 1
                    if not reason or missed > MISSES:
                        return self._ended(reason, flight, conductor, replans)
                again = await self._ask(conductor, reason)
                if again is None:
                    return self._ended(reason, flight, conductor, replans)
                flight, replans = again, replans + 1
        finally:
            await self._settled()

    async def follow(self, conductor: Conductor, goes: Callable[[], bool]) -> str:
        """Tell what its source has for as long as it ``goes()``; gives why everybody was brought to rest, if so."""
        self._conductor = conductor
        try:
            while goes() and not conductor.halting:
                self._look(conductor)
                await asyncio.sleep(TICK)
            return conductor.halting
        finally:
            await self._settled()

    # Before.

    def _prepare(self, flight: Flight) -> Conductor:
        now, before = self.clock.now(), self._conductor
        led = {part.id: part.known.rows[-1, 1:4] for part in before.parts if part.active} if before else {}
        parts = [self._part(name, flight, now, led) for name in flight.motions]
        conductor = Conductor(parts, flight.downwash, now, homes=self._homes)
        conductor.reserved.movers, conductor.reserved.ghosts = list(flight.movers), list(self._ghosts)
        if self._paused:
            conductor.pause()
        self._conductor = conductor
        return conductor

    def _part(self, name: str, flight: Flight, now: float, led: Mapping[str, Floats]) -> Part:
        """``led``: where the plan before has brought those to rest that were heard just now or not."""
        track = Track(flight.motions[name])
        tracking = flight.tracking
        command = self.commands.get(name)
        if command is None:
            raise Refused(f"{name} is not under this executor's lease", vehicle=name)
        error = clock_error(name, command.offset, now)
        needed = margin_for(track.speed, error, tracking)
        place = led.get(name, command.place if command.rests else None)
        if place is None:
            raise Refused(f"{name} does not say where it rests", vehicle=name)
        away = float(np.linalg.norm(place - track.pos[0]))
        if away > max(NEAR_START, self.followings[name].within):
            raise Refused(f"{name} is {away:.1f} m from where its motion begins", vehicle=name, metres=away)
        if needed > flight.margin + 1e-6:
            text = (
                f"the plan keeps {flight.margin:.2f} m of margin, and {name} needs {needed:.2f} m: "
                f"{tracking:g} m to follow it, {SLACK:g} m for its curve, and {track.speed:.1f} m/s times "
                f"a clock known to ±{error:.3f} s"
            )
            raise Refused(text, vehicle=name, needed=needed)
        command.offset.fix()
        part = Part(name, track, flight.radius[name], flight.accel[name], tracking, command.offset)
        part.heard, part.error, part.instance = now, error, command.instance
        part.follows(self.followings[name])
        return part

    # In flight.

    async def _fly(self, conductor: Conductor) -> str:
        """Until all are at their goals (gives an empty reason), or at rest without a way on."""
        while True:
            phase = self._look(conductor, ends=True)
            if phase == "done":
                return ""
            if phase == "halted":
                return conductor.halting
            if phase == "stuck":
                lost = [part.id for part in conductor.parts if part.lost]
                waits = ", ".join(f"{one} for {other}" for one, other in conductor.blocked.items())
                return f"{', '.join(lost)} lost" if lost else f"nobody can go on: {waits or 'no way is clear'}"
            await asyncio.sleep(TICK)

    def _look(self, conductor: Conductor, ends: bool = False) -> Phase:
        """Hear everybody, and tell whom there is something to tell.

        ``ends``: nobody once all are at their goals, for an order that comes next would meet a segment on its way.
        """
        now = self.clock.now()
        for part in conductor.parts:
            self._hear(conductor, part, now)
        over = ends and conductor.phase(now) == "done"
        for send in [] if over else conductor.decide(now, PER_TICK):
            done = self.commands[send.part.id].put(send.rows, send.deadline, send.home)
            if done is not None:
                conductor.sent(send, *done, now)
        for saying in conductor.said:
            self._say(saying.kind, saying.severity, saying.text, saying.detail)
        conductor.said.clear()
        return conductor.phase(now)

    def _hear(self, conductor: Conductor, part: Part, now: float) -> None:
        command = self.commands[part.id]
        news = command.news()
        if command.taken:  # the better reason, where it flies no segment of ours any more either
            conductor.gone(part, command.taken, command.place)
        elif news is not None:
            state, came = news
            segment = state.segment
            stamp = (segment.lease, segment.seq) if segment else None
            conductor.heard(part, came, state.t, stamp, segment.end if segment else None, state.instance)
            if state.local is not None:
                place = np.array(enu(state.local))
                if part.off:
                    part.place = place
                elif part.active and part.known.taken:
                    at = part.offset.ours(state.t - state.ages.get("position", 0.0))
                    conductor.strayed(part, now, at, place)
        error = command.offset.error(now)
        if error > part.error + 0.02 and part.active:
            part.error = error
            if error > MAX_CLOCK:
                conductor.halt(f"the clock of {part.id} is known to ±{1e3 * error:.0f} ms only", vehicle=part.id)

    # After.

    async def _ask(self, conductor: Conductor, reason: str) -> Flight | None:
        """A new plan from where everybody rests; meanwhile they are kept there."""
        if self._replan is None:
            return None
        conductor.halt(reason)
        back = await self._gathered(conductor)
        self._ghosts += [part for part in conductor.parts if not part.active and part.id not in back]
        places = {part.id: part.known.rows[-1, 1:4].copy() for part in conductor.parts if part.active} | back
        for part in self._ghosts:
            part.off = part.off or "lost"
        gone = {part.id for part in self._ghosts}
        async with alongside(self._replan(Trouble(reason, places, gone))) as (asking,):
            while not asking.done():
                self._look(conductor)
                await asyncio.wait({asking}, timeout=TICK)
            again: Flight | None = asking.result()
            return again

    async def _gathered(self, conductor: Conductor) -> dict[str, Floats]:
        """Everybody rests, and for a while those who are not heard are waited for, or who were moved aside: these are
        taken along from where they hold then, and their places given.
        """
        until, said = self.clock.now() + PATIENCE, False
        while True:
            flying = self._look(conductor) == "flying"
            strays = [part for part in conductor.parts if part.strays and not self.commands[part.id].taken]
            back = {part.id: place for part in strays if (place := self._held(part)) is not None}
            waits = [part.id for part in conductor.parts if part.lost and not part.off]
            waits += [part.id for part in strays if part.id not in back]
            over = self._hurry or not waits or self.clock.now() > until
            if over and not flying:
                return back
            if waits and not said:
                said = True
                text = f"waits for {', '.join(waits)} before there is another plan"
                self._say("wait", "notice", text, {"vehicles": waits})
            await asyncio.sleep(TICK)

    def _held(self, part: Part) -> Floats | None:
        """Where a vehicle holds that left our trajectory by itself; None while it moves, or could take one of ours."""
        command = self.commands[part.id]
        state = command.vehicle.last_state
        if state is None or state.instance != part.instance:
            return None
        if state.t <= max(entry.deadline for entry in part.entries):
            return None
        return command.place if command.rests else None

    def _is_there(self, part: Part, flight: Flight, away: float) -> bool:
        return flight.near(part.id, away, part.following.within) and self.commands[part.id].ended

    async def _arrived(self, flight: Flight, conductor: Conductor) -> str:
        """Wait until they are at their goals by what they say themselves once their trajectories have ended: what is
        next begins there. Who is not, after a while in which it was heard and came no nearer, has left its way, and why
        the plan is not flown to its end is given; empty: it is.
        """
        begun = ended = self.clock.now()
        nearest = np.inf
        while True:
            away = self._away(flight)
            late = [p for p in conductor.parts if not self._is_there(p, flight, away[p.id])]
            if not late:
                return ""
            now, farthest = self.clock.now(), max(away[part.id] for part in late)
            if farthest < nearest - NEARER:
                nearest, begun = farthest, now
            heard = all(part.heard > begun + SETTLE for part in late)
            if (heard and now > begun + SETTLE) or now > ended + SETTLE + PATIENCE:
                text = f"not at the goal {now - ended:.0f} s after the end"
                for part in late:
                    conductor.gone(part, text, strays=True)
                return f"{', '.join(f'{part.id} ({away[part.id]:.1f} m)' for part in late)}: {text}"
            self._look(conductor, ends=now < begun + NEWS)
            await asyncio.sleep(TICK)

    def _ended(self, reason: str, flight: Flight, conductor: Conductor, replans: int) -> Outcome:
        flown = {part.id: part.known.stop for part in conductor.parts}
        return Outcome(not reason, reason, self._away(flight), replans, flown)

    def _away(self, flight: Flight) -> dict[str, float]:
        found = {}
        for name, motion in flight.motions.items():
            place = self.commands[name].place
            found[name] = float("inf") if place is None else float(np.linalg.norm(place - motion[-1, 1:4]))
        return found

    async def _settled(self) -> None:
        """Whatever ended us, and however often: nobody's lease is given back while it moves, for a vehicle whose lease
        ends stops at once, and not along its way.
        """
        if self._conductor is None:
            return
        interrupted, settling = None, asyncio.ensure_future(self._settle(self._conductor))
        try:
            while not settling.done():
                try:
                    await asyncio.shield(settling)
                except asyncio.CancelledError as e:
                    interrupted = e
            settling.result()
        finally:
            self._conductor = None
        if interrupted is not None:
            raise interrupted

    async def _settle(self, conductor: Conductor) -> None:
        conductor.halt("the execution has ended")
        with contextlib.suppress(ZmavError):
            while conductor.phase(self.clock.now()) == "flying":
                self._look(conductor)
                await asyncio.sleep(TICK)
