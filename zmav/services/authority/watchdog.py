"""What happens when the stream stops: the steps from a fresh setpoint down to landing, in a thread of its own.

A watchdog on the event loop would sleep with the loop it guards. This one needs nothing of it: it knows when the stream
goes stale, reads the autopilot's mode from the adapter's memory, and sends through the port, which any thread may.

fresh -> kept alive at the autopilot's rate; a committed segment is interpolated until its end
-> stale for hold_after: hold, repeated until the vehicle shows it
-> stale for land_after: the way home that came with the segment (:mod:`.homeward`), where that is asked for and can be
flown; else the configured action's mode, or the next safer one that the autopilot takes.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from zmav import wire
from zmav.autopilots import Command, Message, Target
from zmav.config import RETURN_LEAD, Failsafe
from zmav.errors import LinkDown, Refused, ZmavError
from zmav.services.authority.control import Control, Mover
from zmav.services.authority.homeward import LATE
from zmav.services.authority.may_move import SetpointCounts
from zmav.services.authority.steps import MOVERS, SAFER, Allowed, Aside, ModeRequested, Near, Step, StreamGivenUp
from zmav.services.authority.stream import ActiveStream, CommandRepeats, future
from zmav.services.authority.trajectory import Segment
from zmav.services.companion import Companion
from zmav.services.link.reported import ReportedMode, shown

ASK_EVERY, LATE_MODE, GIVE_UP = 1.0, 2.0, 3.0
"""s between requests for a mode; s after one in which it may yet show that it was granted, the stream having ended; s
after which a mode that does not come is taken for refused"""
HOLD_EVERY, HOLD_REPEATS = 0.2, 3
HOLD_WATCH = 30.0
"""s for which a vehicle that still moves is told to stop, twice a second"""
RETRY_ACTION = 10.0
ROUND = 1.0
"""s at most between two rounds of the thread: anyone who counts them sees that it lives"""


class StreamWatchdog:
    """Guards one vehicle's stream. Every method from any thread.

    ``allowed(mode)``: that mode of the autopilot is one that was ordered here; the pilot has the vehicle otherwise.
    ``near`` brings a far target within reach (:mod:`zmav.services.authority.leader`). ``aside``: what to fly instead
    for a moment, and because of whom (:mod:`zmav.services.authority.separation`). The port's bus is told of each
    :class:`ModeRequested` and :class:`StreamGivenUp`.
    """

    def __init__(
        self,
        companion: Companion,
        failsafe: Failsafe,
        counts: SetpointCounts,
        control: Control,
        *,
        allowed: Allowed,
        near: Near,
        aside: Aside,
    ) -> None:
        self._port, self._events, self.failsafe, self._counts = companion.port, companion.events, failsafe, counts
        self._allowed, self._near, self._aside, self._control = allowed, near, aside, control
        self._dodging: ActiveStream | None = None
        """what is flown, while the vehicle is moved aside from it"""
        self._changed = threading.Condition(threading.RLock())
        self._repeated = CommandRepeats()
        self._step = Step.IDLE
        self._flown: ActiveStream | None = None
        self._lost: ActiveStream | None = None
        """what flew until a mode came that was not ordered here: for :meth:`stop`, once somebody judges that mode"""
        self._since = 0.0
        """when what is held was last fresh"""
        self._due = math.inf
        self._begun, self._engages = 0.0, 0.0
        """when the present step began, and when the mode may be asked for"""
        self._asked = -math.inf
        self._tries: list[str] = []
        self._repeats = 0
        self._flew_under, self._over = 0, 0
        """the leases under which it flies, and under which the watchdog has acted: nothing is flown under that"""
        self.rounds, self._closing = 0, False
        """rounds: of its thread so far"""
        self._thread = threading.Thread(target=self._run, name=f"watchdog {companion.port.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """End; a vehicle that follows a stream is told to hold, for nobody will watch over it any more."""
        with self._changed:
            for _ in range(HOLD_REPEATS):
                if self._step not in (Step.IDLE, Step.ACTING) and not self._first and self._ours():
                    self._asked = -math.inf
                    self._say_hold()
                    time.sleep(0.02)
            self._end()
            self._closing = True
            self._changed.notify()
        if self._thread.ident is not None:
            self._thread.join(2.0)

    # What the stream does.

    @property
    def step(self) -> Step:
        return self._step

    def fly(self, flown: ActiveStream, mode: str | None) -> bool:
        """Send it and watch over it. False: the mode that follows it is being asked for, ``mode`` is the present one;
        the latest setpoint is flown as soon as it is there. What cannot be sent now is watched over all the same.
        """
        with self._changed:
            if flown.lease == self._over:
                raise Refused("its stream was silent for too long: take a new lease", count="failsafe")
            follows = self._step is Step.FRESH and self._dodging is not self._flown
            flown.check_joined(self._port, self._flown if follows else None)
            now, step = time.monotonic(), self._step
            before, self._flown, self._lost = self._flown, flown, None
            sent: bool | None = True
            if before is not None:
                self._let_go(before, flown)
            if mode == flown.mode:
                if step is Step.HOLDING and self._asked > -math.inf:
                    self._ask(flown.mode, now)  # the mode of the hold may be on its way
                sent = self._send()
                if self._step is not Step.FRESH:
                    self._enter(Step.FRESH)
                elif before is None or type(before.what) is not type(flown.what):
                    self._claim()
            else:
                if self._step is not Step.ENGAGING:
                    self._begin_engaging(flown)
                if flown.autopilot.engage_after > 0.0:
                    self._send()
            due = self._next(now)
            self._wake(min(due, self._due) if step is Step.ENGAGING is self._step else due)
            if sent is None:
                raise Refused("it does not say any more where it is", count="position")
            if not sent:
                raise LinkDown("the link to the autopilot is down or full", count="link")
            return mode == flown.mode

    def future(self) -> Callable[[float], Target] | None:
        """What it flies so many seconds from now; None where nothing is flown."""
        flown = self._flown
        return None if flown is None or self._step not in (Step.FRESH, Step.RETURNING) else future(flown)

    @property
    def on_segment(self) -> bool:
        """A segment is what is flown or, at its end, held; not while the vehicle is moved aside from it."""
        flown = self._flown
        if flown is None or flown.lease == self._over or self._step is Step.IDLE:
            return False
        return isinstance(flown.what, Segment) and self._dodging is not flown

    def hold_now(self, why: str, *, goes_on: bool = True, severity: wire.Severity = "warning") -> None:
        """The stream's right to fly has ended: hold at once. ``goes_on``: land_after follows, unless the end of what is
        held already was meant. ``severity``: of saying so. What acts, or acted in vain and tries again, goes on: only
        an order that moves the vehicle, or the pilot, ends that.
        """
        with self._changed:
            flown = self._flown
            if flown is None or not self._ours():
                self._end(lost=True)  # nothing flies by it
                return
            if flown.lease == self._over:
                return
            if self._first and self._shown().mode != flown.mode:
                self._flown = flown._replace(until=min(flown.until, time.monotonic()), home=None)
                self._wake(time.monotonic())  # nothing flies by it yet
                return
            home = flown.home if time.monotonic() >= flown.until else None  # it begins where this was to end
            if self._step in (Step.FRESH, Step.ENGAGING):
                self._hold(why, severity)
            self._flown = flown._replace(goes_on=flown.goes_on and goes_on, home=home)
            self._dodging = self._flown if self._dodging is flown else self._dodging
            self._wake(self._next(time.monotonic()))

    def stop(self, *, taken: bool = False) -> ActiveStream | None:
        """The stream is over on purpose: an order or the pilot moves the vehicle now, or it has landed. Once this
        returns nothing more is sent, and what was overridden is given back. Returns what was flown, held or given up,
        of a vehicle that was ``taken`` also what ended with its mode before anybody judged that.
        """
        with self._changed:
            flown = None if self._first else self._flown  # nothing flies by that yet
            lost = self._lost if taken else None
            self._end()
            return flown or lost

    def hold(self, flown: ActiveStream, why: str) -> None:
        """Hold what nothing moves any more, while nothing else is flown; land_after counts from now."""
        with self._changed:
            if self._step is not Step.IDLE:
                return
            self._flown = flown
            if not self._ours():
                self._flown = None  # it ended before
                self._end(lost=True)
                return
            self._hold(why)
            self._since = time.monotonic()
            self._wake(self._next(time.monotonic()))

    # The thread.

    def _run(self) -> None:
        with self._changed:
            while not self._closing:
                now = time.monotonic()
                self.rounds += 1
                if now < self._due:
                    self._changed.wait(min(self._due - now, ROUND))
                    continue
                try:
                    self._tick(now)
                    self._due = self._next(time.monotonic())
                except Exception as e:  # it must not end, whatever is wrong
                    self._due = now + HOLD_EVERY
                    self._events.emit("fault", "error", f"watchdog: {e!r}", limit="watchdog")

    def _wake(self, due: float) -> None:
        """A stream moves its due time on with each setpoint: only an earlier one needs the thread."""
        earlier, self._due = due < self._due, due
        if earlier:
            self._changed.notify()

    def _next(self, now: float) -> float:
        """When the present step has something to do."""
        flown = self._flown
        if flown is None or self._step is Step.IDLE:
            return math.inf
        period = flown.period(dodges=self._dodging is not None)
        if self._step in (Step.FRESH, Step.RETURNING):
            return min(flown.holds_at, now + period)
        if self._step is Step.ENGAGING:
            if now >= flown.until:
                return now + 0.05
            waited = max(self._asked + ASK_EVERY, self._engages)
            return min(flown.until, max(now, waited), now + (period if flown.autopilot.engage_after > 0.0 else 0.05))
        return now + HOLD_EVERY

    def _tick(self, now: float) -> None:
        flown = self._flown
        if flown is None:
            return
        if not self._ours():
            self._end(lost=True)
        elif self._step is Step.FRESH:
            lost = isinstance(flown.what, Segment) and self._shown().mode != flown.mode
            if now >= (flown.until if lost else flown.holds_at):
                if isinstance(flown.what, Segment):
                    self._hold("the segment has ended", "info")  # as it was to
                else:
                    self._hold(f"no setpoint for {self.failsafe.hold_after:g} s")
            elif lost:
                self._begin_engaging(flown)  # a hold that was asked for before has come, say
            else:
                self._send()
        elif self._step is Step.ENGAGING:
            self._engage(flown, now)
        elif self._step is Step.HOLDING:
            self._watch_hold(flown, now)
        elif self._step is Step.RETURNING:
            self._return(flown, now)
        else:
            self._act(flown, now)

    # The steps.

    def _begin_engaging(self, flown: ActiveStream) -> None:
        self._enter(Step.ENGAGING)
        self._engages = self._begun + flown.engages_after(self._port)
        # PX4 goes back to the mode it was last asked for as soon as setpoints come.
        self._port.bus.tell(ModeRequested(flown.mode))

    def _engage(self, flown: ActiveStream, now: float) -> None:
        mode = self._shown().mode
        if now >= flown.until:
            late = now - self._asked > LATE_MODE
            if mode == flown.mode or (late and not self._first):
                self._hold(f"the stream ended before {flown.mode} came")
            elif late:
                self._end()
        elif mode == flown.mode and (why := flown.why_not_joined(self._port)):
            self._hold(why, left=True)  # it has gone far ahead meanwhile
        elif mode == flown.mode:
            self._enter(Step.FRESH)
            self._send()
        else:
            if flown.autopilot.engage_after > 0.0:
                self._send()
            if self._step is not Step.ENGAGING:
                return  # it was moved aside
            if not self._first and isinstance(flown.what, Segment) and now - self._begun > GIVE_UP:
                self._hold(f"{flown.mode} does not come again", left=True)
            elif now >= max(self._asked + ASK_EVERY, self._engages):
                self._ask(flown.mode, now)
                if now - self._engages > GIVE_UP:
                    text = f"{flown.mode} does not come; setpoints wait for it"
                    self._events.emit("setpoint", "warning", text, limit="engage")

    def _hold(self, why: str, severity: wire.Severity = "warning", *, left: bool = False) -> None:
        """``left``: away from its segment."""
        assert self._flown is not None
        flown, now = self._flown.left() if left else self._flown, time.monotonic()
        self._flown = flown
        lasts = 0.0 if isinstance(flown.what, Segment) else self.failsafe.hold_after
        self._since = min(now, flown.until - lasts)
        self._enter(Step.HOLDING)
        self._let_go(flown, None)
        self._say_hold()
        self._counts.add("held")
        self._events.emit("setpoint", severity, f"{why}: holding position")

    def _say_hold(self) -> None:
        """Ask for the hold once; it is asked for again, for the message has no acknowledgement."""
        flown = self._flown
        assert flown is not None
        self._repeats += 1
        try:
            mode, message = flown.autopilot.hold()
        except ZmavError as e:
            if self._repeats == 1:
                self._events.emit("setpoint", "error", f"it cannot be told to hold: {e}")
            return
        now, said = time.monotonic(), self._shown()
        # What is shown may be from before the stream, and a failsafe's mode is not yet what it intends.
        there = said.mode == mode and said.intended in (None, mode) and (self._repeats > 1 or mode == flown.mode)
        if not there and now - self._asked >= HOLD_EVERY:
            self._ask(mode, now)
        if message is not None:
            self._give(message)

    def _watch_hold(self, flown: ActiveStream, now: float) -> None:
        """Until it is in the mode and stands still; a few times in any case."""
        after = self.failsafe.land_after
        due = flown.goes_on and after != "never" and now - self._since >= after
        if due and not self._waits_to_return(flown, now):
            self._begin_action(self.failsafe.action)
        elif self._step is Step.RETURNING:
            return
        elif self._repeats <= HOLD_REPEATS or (now - self._begun < HOLD_WATCH and not flown.holds(self._port)):
            self._say_hold()

    def _waits_to_return(self, flown: ActiveStream, now: float) -> bool:
        """The way home is to be flown, and its time may be yet to come. One that cannot be is given up for good."""
        home = flown.home
        if home is None or now < home.begins - RETURN_LEAD:
            return home is not None
        self._flown = flown._replace(home=None)
        if why := home.missed(now, self._port, flown.source, flat=flown.autopilot.on_surface):
            self._events.emit("failsafe", "error", f"the way home is not flown: {why}")
            return False
        self._give_up(flown.lease)
        self._flown = flown._replace(what=home.way, until=home.ends, home=None)
        self._enter(Step.RETURNING)
        text = f"nothing came for {now - self._since:.0f} s: it flies the way home that the planner sent"
        self._events.emit("failsafe", "critical", text, action="return", seconds=round(home.ends - home.begins, 1))
        return True

    def _return(self, flown: ActiveStream, now: float) -> None:
        """Along the way home by its own clock, and down at its end."""
        assert isinstance(flown.what, Segment)
        if now >= flown.until:
            self._begin_action("land")
        elif self._shown().mode == flown.mode:
            self._send()
        elif now - flown.until + flown.what.end - flown.what.start > LATE:
            self._events.emit("failsafe", "error", f"{flown.mode} did not come for the way home: it is not flown")
            self._begin_action(self.failsafe.action)
        else:
            if flown.autopilot.engage_after > 0.0:
                self._send()
            if now >= max(self._asked + ASK_EVERY, self._begun + flown.autopilot.engages_after("trajectory", True)):
                self._ask(flown.mode, now)

    def _begin_action(self, action: str) -> None:
        flown = self._flown
        assert flown is not None
        self._enter(Step.ACTING)
        self._tries = list(SAFER[action])
        self._give_up(flown.lease)
        self._act(flown, time.monotonic())

    def _give_up(self, lease: int) -> None:
        if self._over != lease:
            self._over = lease
            self._port.bus.tell(StreamGivenUp(lease))

    def _act(self, flown: ActiveStream, now: float) -> None:
        """Enter the mode of the first action that the autopilot takes; nothing else is left to try: keep the hold."""
        while self._tries:
            action = self._tries[0]
            try:
                mode = str(getattr(flown.autopilot, action)())
            except ZmavError as e:
                self._refused(action, str(e))
                continue
            if self._shown().mode == mode:
                text = f"no setpoint for {now - self._since:.0f} s: {mode}"
                self._events.emit("failsafe", "critical", text, action=action, mode=mode)
                self._end()
                return
            if now - self._begun > GIVE_UP:
                self._refused(action, f"mode {mode} does not come")
                self._begun, self._asked = now, -math.inf
                continue
            if now - self._asked >= HOLD_EVERY:
                self._ask(mode, now)
            return
        text = f"neither {' nor '.join(SAFER[self.failsafe.action])} is taken: holding position"
        self._events.emit("failsafe", "emergency", text)
        self._enter(Step.HOLDING)
        self._since = now + RETRY_ACTION - float(self.failsafe.land_after)  # and then all of it again
        self._say_hold()

    def _refused(self, action: str, why: str) -> None:
        self._tries.pop(0)
        then = f"{self._tries[0]} instead" if self._tries else "nothing else is left"
        self._events.emit("failsafe", "error", f"{action} is not to be had ({why}): {then}", action=action)

    # How it is done; all of it with the lock.

    def _enter(self, step: Step) -> None:
        self._repeated.reset()
        self._step, self._begun, self._asked, self._repeats = step, time.monotonic(), -math.inf, 0
        if step is Step.FRESH and self._flown is not None:
            self._flew_under = self._flown.lease
        self._claim()

    def _claim(self) -> None:
        """Say as what it moves the vehicle."""
        flies = self._step in (Step.FRESH, Step.ENGAGING) and not self._first
        segment = flies and self._flown is not None and isinstance(self._flown.what, Segment)
        self._control.take(self, Mover.SEGMENT if segment else MOVERS[self._step])

    def _end(self, *, lost: bool = False) -> None:
        """``lost``: by a mode that was not ordered here. What flew is kept, also where its end was seen before."""
        kept = (self._lost or (None if self._first else self._flown)) if lost else None
        if self._flown is not None and self._step in (Step.FRESH, Step.ENGAGING):
            self._let_go(self._flown, None)
        self._step, self._flown, self._due, self._flew_under = Step.IDLE, None, math.inf, 0
        self._dodging, self._lost = None, kept
        self._control.leave(self)
        self._changed.notify_all()

    @property
    def _first(self) -> bool:
        """Its mode is asked for, and nothing has flown under its lease yet."""
        return self._step is Step.ENGAGING and self._flown is not None and self._flown.lease != self._flew_under

    def _shown(self) -> ReportedMode:
        assert self._flown is not None
        return shown(self._port, self._flown.autopilot, self._flown.source)

    def _ours(self) -> bool:
        """It is armed, and in a mode that was ordered here: the pilot has it otherwise."""
        return self._shown().armed and self._allowed(self._shown().mode)

    def _ask(self, mode: str, now: float) -> None:
        assert self._flown is not None
        self._asked = now
        self._port.bus.tell(ModeRequested(mode))
        self._give(self._flown.autopilot.mode(mode).command)

    def _send(self) -> bool | None:
        """The setpoint as it is now; False where the link does not take it, None where :attr:`_near` gives nothing."""
        flown = self._flown
        assert flown is not None
        instead = self._aside(future(flown))
        if instead is not None:
            return self._dodge(flown, *instead)
        if self._dodging is flown and isinstance(flown.what, Segment):
            self._hold("moved aside from the segment", left=True)
            return True
        self._dodging = None
        near = self._near(flown.autopilot, future(flown)(0.0), flown.source, isinstance(flown.what, Segment))
        actions = [] if near is None else flown.autopilot.setpoint(near)
        sent = [self._give(action) for action in actions if self._repeated.due(action, time.monotonic())]
        return None if near is None else all(sent)

    def _dodge(self, flown: ActiveStream, target: Target, whom: str) -> bool:
        if self._dodging is None:
            self._counts.add("aside")
            self._events.emit("separation", "warning", f"moving aside for {whom}", limit="aside", whom=whom)
        self._dodging = flown
        sent = [self._give(action) for action in flown.autopilot.setpoint(target)]
        return all(sent)

    def _let_go(self, before: ActiveStream, after: ActiveStream | None) -> None:
        for message in before.releases(after):
            self._give(message)

    def _give(self, action: Command | Message) -> bool:
        assert self._flown is not None
        message = action if isinstance(action, Message) else action.message(self._port.dialect)
        return self._port.send(message.name, **message.addressed(*self._flown.source))
