"""The command protocol beside the autopilot: sent over the local link, acknowledged, retried, and seen to come true.

Protocol: https://mavlink.io/en/services/command.html
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import Any, NamedTuple

from zmav.autopilots import Autopilot, Command, Message
from zmav.errors import Refused, Stale, TimedOut, Unsupported
from zmav.mavlink.results import CommandResult
from zmav.services.authority.control import Control, Mover
from zmav.services.companion import Companion
from zmav.services.link.port import Inbox, is_ours
from zmav.services.orders.orders import Report

RETRIES = 3
EXPLAIN_TIME = 0.2
"""s that the words explaining a refusal may come after it"""
UNKNOWN_PROGRESS = 255


class Ack(NamedTuple):
    """A COMMAND_ACK's verdict, and the command-specific number some come with."""

    result: int
    result_param2: int


class Commander:
    """Sends commands to the autopilot and watches them through. Lives on the event loop."""

    ack_timeout = 0.5
    in_progress_timeout = 10.0
    confirm_timeout = 4.0
    """s for a HEARTBEAT to show what an acknowledgement promised"""

    def __init__(self, companion: Companion, control: Control) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self._control = control
        self._locks: dict[str, asyncio.Lock] = {}
        self._tasks: set[asyncio.Task[Any] | None] = set()
        self.follows: frozenset[str] = frozenset()
        """modes that the order which moves the vehicle leads to by itself: a mission that ends in a return"""
        self._ordered: str | None = None
        self._asked, self._came = 0.0, True
        """when ``_ordered`` was last asked for, and whether it has been shown since it was first"""
        self._overtaken, self._overtaken_at = "", 0.0

    @property
    def ordered(self) -> str | None:
        """The mode last asked for here: any other that the autopilot shows was somebody else's wish, but for one that
        was :meth:`overtaken`.
        """
        return self._ordered

    @ordered.setter
    def ordered(self, mode: str | None) -> None:
        now = time.monotonic()
        if mode != self._ordered:
            comes = not self._came and now - self._asked < self.confirm_timeout
            self._overtaken, self._overtaken_at = (mode and comes and self._ordered) or "", now
        if mode != self._ordered or mode != self._identity.mode:
            self._came = False
        self._ordered, self._asked = mode, now

    def overtaken(self, mode: str) -> bool:
        """It was asked for here right before the one last asked for, has not been shown yet, and may be on the way to
        that.
        """
        return mode == self._overtaken and time.monotonic() - self._overtaken_at < self.confirm_timeout

    def mode_came(self, mode: str | None) -> None:
        """Once the mode last asked for is shown, an earlier one is somebody else's wish."""
        if mode == self._ordered:
            self._overtaken, self._came = "", True

    # The one order that moves the vehicle.

    @property
    def under_way(self) -> bool:
        """An order moves the vehicle, or one beside it may."""
        return bool(self._tasks)

    def supersede(self) -> None:
        """End the order that moves the vehicle, if one is under way, and those beside it."""
        for task in self._tasks:
            self._control.leave(task)
            if task is not None and task is not asyncio.current_task():
                task.cancel()
        self._tasks.clear()

    @contextlib.contextmanager
    def beside(self) -> Iterator[None]:
        """An order that leaves the one that moves the vehicle alone, and ends where that would: with the pilot or the
        next one, which it must not undo by being repeated, nor keep waiting for its acknowledgement.
        """
        me = asyncio.current_task()
        self._tasks.add(me)
        try:
            yield
        finally:
            self._tasks.discard(me)

    @contextlib.asynccontextmanager
    async def move(self) -> AsyncIterator[None]:
        """One order at a time moves the vehicle: a later one ends an earlier one."""
        self.supersede()
        self.follows, me = frozenset(), asyncio.current_task()
        self._control.take(me, Mover.ORDER)
        try:
            with self.beside():
                yield
        finally:
            self._control.leave(me)

    # Who is commanded.

    def autopilot(self) -> Autopilot:
        """The autopilot's rules; raises :class:`Stale` where none is heard."""
        if self._identity.autopilot is None:
            raise Stale(f"no autopilot has been heard on {self._port.link.url}", vehicle=self._port.name)
        if not self._identity.connected:
            raise Stale("the autopilot is silent", vehicle=self._port.name)
        return self._identity.autopilot

    def source(self) -> tuple[int, int]:
        """The autopilot's system and component id; raises :class:`Stale`."""
        self.autopilot()
        assert self._identity.source is not None
        return self._identity.source

    def inbox(self, *names: str) -> Inbox:
        """The autopilot's messages of these names, while the ``with`` lasts."""
        return Inbox(self._port, self.source(), *names)

    # What is sent.

    async def command(self, command: Command, report: Report | None = None) -> Ack:
        """Send a MAV_CMD until it is acknowledged; the progress of a long one is reported.

        Raises :class:`Refused` with the autopilot's words, :class:`Unsupported` or :class:`TimedOut`.
        """
        lock = self._locks.setdefault(command.name, asyncio.Lock())
        async with lock:
            with self.inbox("COMMAND_ACK", "STATUSTEXT") as inbox:
                since = time.monotonic()
                ack = await self._acknowledged(command, inbox, report)
                if ack.result != CommandResult.ACCEPTED:
                    raise await self._refusal(command, ack.result, since, inbox)
                return ack

    async def give(self, action: Command | Message) -> None:
        """Give a command, or send a message that has no acknowledgement."""
        if isinstance(action, Command):
            await self.command(action)
        else:
            self._port.send(action.name, **action.addressed(*self.source()))

    async def enter(self, name: str) -> None:
        """Change the mode, judged by what tells it: PX4 acknowledges DO_SET_MODE before its commander has decided, so
        that a later acknowledgement may still refuse it. Raises :class:`Refused`, :class:`TimedOut`, :class:`BadInput`.
        """
        mode = self.autopilot().mode(name)
        before, self.ordered = self.ordered, mode.name
        try:
            # What HEARTBEAT shows is up to a second old: the mode may have been left for another that was ordered.
            if not self._is_in(mode.name) or before not in (None, mode.name):
                since = time.monotonic()
                with self.inbox("COMMAND_ACK", *self._identity.mode_messages) as inbox:
                    await self.command(mode.command)
                    await self._confirm_mode(mode.command, mode.name, since, inbox)
        except Exception:  # no cancellation: who superseded us, or the pilot, has had his say about it
            self._ordered, self._overtaken, self._came = before, "", True  # what was refused is not on its way
            raise

    def _is_in(self, mode: str) -> bool:
        """It is in that mode by intention: a failsafe's would be left again as soon as its cause has gone."""
        return self._identity.mode == mode and self._identity.intended in (None, mode)

    async def until_mode_told(self) -> None:
        """Wait for the next message that tells the mode, where an older one may be wrong; a second at most."""
        with self.inbox(*self._identity.mode_messages) as inbox:
            await inbox.get(self.confirm_timeout)

    async def until_heartbeat(self, true: Callable[[], bool], otherwise: str) -> None:
        """Wait until a HEARTBEAT, or what tells the mode sooner, shows it; raises :class:`TimedOut` with the words
        given.
        """
        with self.inbox(*self._identity.mode_messages) as inbox:
            deadline = time.monotonic() + self.confirm_timeout
            while not true():
                if await inbox.get(deadline - time.monotonic()) is None:
                    raise TimedOut(otherwise, vehicle=self._port.name)

    def check_mode(self, mode: str | None) -> None:
        """The pilot wins: an order ends when the mode is no longer its own."""
        if self._identity.mode != mode:
            text = f"taken over: the mode is now {self._identity.mode}"
            raise Refused(text, vehicle=self._port.name, mode=self._identity.mode)

    async def next(self, inbox: Inbox, deadline: float, late: str) -> tuple[str, Mapping[str, Any]]:
        """The next message; raises :class:`TimedOut` after the deadline, :class:`Stale` for a silent autopilot."""
        while (heard := await inbox.get(min(deadline - time.monotonic(), 1.0))) is None:
            self.autopilot()
            if time.monotonic() >= deadline:
                raise TimedOut(late, vehicle=self._port.name)
        return heard

    # How it is done.

    async def _acknowledged(self, command: Command, inbox: Inbox, report: Report | None) -> Ack:
        number = self._port.dialect.value("MAV_CMD", command.name)
        for attempt in range(RETRIES + 1):
            message = command.message(self._port.dialect, attempt)
            self._port.send(message.name, **message.addressed(*self.source()))
            deadline = time.monotonic() + self.ack_timeout
            while (heard := await inbox.get(deadline - time.monotonic())) is not None:
                name, fields = heard
                if name != "COMMAND_ACK" or fields["command"] != number or not is_ours(fields, self._port):
                    continue
                if fields["result"] != CommandResult.IN_PROGRESS:
                    return Ack(int(fields["result"]), int(fields["result_param2"]))
                if report is not None and fields["progress"] != UNKNOWN_PROGRESS:
                    report({"progress": fields["progress"] / 100.0})
                deadline = time.monotonic() + self.in_progress_timeout
        why = f"no acknowledgement of {command.name} after {RETRIES + 1} attempts"
        raise TimedOut(why, vehicle=self._port.name, command=command.name)

    async def _refusal(self, command: Command, result: int, since: float, inbox: Inbox) -> Refused | Unsupported:
        """The error for a result, with the words that came shortly before or after it."""
        deadline = time.monotonic() + EXPLAIN_TIME
        while await inbox.get(deadline - time.monotonic()) is not None:
            pass
        name = self._port.dialect.enum_name("MAV_RESULT", result) or str(result)
        reasons = self._events.texts_since(since)
        text = f"{command.name} refused: {name.removeprefix('MAV_RESULT_')}"
        text += f" ({'; '.join(reasons)})" if reasons else ""
        kind = Unsupported if result == CommandResult.UNSUPPORTED else Refused
        return kind(text, vehicle=self._port.name, command=command.name, result=name, reasons=reasons)

    async def _confirm_mode(self, command: Command, mode: str, since: float, inbox: Inbox) -> None:
        number = self._port.dialect.value("MAV_CMD", command.name)
        deadline = time.monotonic() + self.confirm_timeout
        while not self._is_in(mode):
            heard = await inbox.get(deadline - time.monotonic())
            if heard is None:
                text = f"mode {mode} was acknowledged, but does not come"
                raise TimedOut(text, vehicle=self._port.name, mode=self._identity.mode)
            name, fields = heard
            if name != "COMMAND_ACK" or fields["command"] != number or not is_ours(fields, self._port):
                continue
            if fields["result"] not in (CommandResult.ACCEPTED, CommandResult.IN_PROGRESS):
                raise await self._refusal(command, int(fields["result"]), since, inbox)
