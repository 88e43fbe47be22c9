"""The newest roster, kept, acted on and passed on.

Routers tell each other which roster they have by the Trickle algorithm (RFC 6206): each puts its own at times that grow
from seconds to a minute, and not at all where it has just heard the same; one that hears an older one, or gets a newer
one, speaks soon. So a change crosses the fleet in a second or two, also after a partition, and silence is cheap. The
authority's own computer brings one as a query's payload, and sees who took it.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import re
import time
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import Future
from typing import Any

import msgspec
import zenoh

from mesh.credentials import files
from mesh.credentials.acl import access_control
from mesh.plan import RouterPlan
from zmav import keys, wire
from zmav.errors import BadConfig, BadInput
from zmav.process import log
from zmav.services.link.port import one_waits
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions, Reply
from zmav.trust import credentials
from zmav.trust.certificate import warn_of_end
from zmav.trust.credentials import Credentials
from zmav.trust.gate import anybody
from zmav.trust.roster import HeldRoster, Roster, SignedRoster, read_signed
from zmav.trust.verify import Allowance
from zmav.waiting import cancelled, on_loop, within

LONGEST = 64.0
"""s: Trickle's longest interval"""
ENOUGH = 1
"""of others' that are like ours within an interval, and we need not speak"""
MOST_WAITING = 64
"""rosters that have come and were not looked at yet: the newest"""
MOST_CHECKED = 200.0
"""signatures checked in a second: what is forged costs no more than that"""
NUMBER = re.compile(r"[0-9]{1,18}\Z")


class RosterWatch:
    """One router's. Lives on the event loop. ``say`` gets what a person should know, a line each."""

    shortest = 1.0
    """s: Trickle's shortest interval"""

    def __init__(self, session: zenoh.Session, plan: RouterPlan, held: Credentials, say: Callable[[str], None]) -> None:
        self._session, self._plan, self._credentials, self._say = session, plan, held, say
        self._key = keys.FLEET.key(held.fleet, topic=keys.ROSTER)
        self._signed = credentials.newest_roster(held.folder, held.authority, held.fleet)
        self.roster = self._signed.open(held.authority, held.fleet)
        self._rules = self._rules_by(self.roster)
        self._outdated = asyncio.Event()
        self._listeners: list[Callable[[Roster], None]] = []
        self._alike = 0
        self._hurry = asyncio.Event()
        self._said: set[str] = set()
        self._checks = Allowance(MOST_CHECKED, time.monotonic)
        self._tasks: list[asyncio.Task[None]] = []
        self._declared: list[Any] = []

    async def __aenter__(self) -> RosterWatch:
        loop = asyncio.get_running_loop()
        self._questions = Questions(self._session, Answers(None, None), anybody)
        self._questions.declare(self._key, lambda query: self._answer(query, loop), parameters=("newer",))
        take = one_waits(loop, self._on_sample)  # anybody may put them, as fast as he likes
        self._declared = [self._session.info.declare_link_events_listener(on_loop(loop, self._on_link), history=True)]
        self._intake = Intake(self._session.declare_subscriber, self._key, take, MOST_WAITING)
        self._tasks = [loop.create_task(self._tell())]
        if not self._plan.vehicle:  # which says it as an event
            self._tasks.append(loop.create_task(warn_of_end(self._credentials.certificate, self._say)))
        return self

    async def __aexit__(self, *_: object) -> None:
        await cancelled(*self._tasks)
        self._intake.close()
        self._questions.close()
        for declared in self._declared:
            declared.undeclare()

    def tell(self, listener: Callable[[Roster], None]) -> None:
        """Call ``listener`` with the roster there is, and with each that takes its place."""
        self._listeners.append(listener)
        listener(self.roster)

    async def outdated(self) -> str:
        """Return when the router's access rules are another roster's, with the reason in words."""
        await self._outdated.wait()
        return f"its access rules are older than roster {self.roster.number}"

    def adopt(self, signed: SignedRoster) -> bool:
        """Take ``signed`` in the place of ours where it is newer; whether it was.

        Raises :class:`BadConfig` for one that says it is newer, and is not our authority's or of another fleet.
        """
        number = signed.number
        if number <= self.roster.number:
            # Anyone who only says its number does not keep us from passing ours on.
            self._alike += signed == self._signed
            if number < self.roster.number:
                self._hurry.set()
            return False
        if not self._checks.take():
            self._hurry.set()  # who has a true one hears that we do not, and says it again
            return False
        roster = signed.open(self._credentials.authority, self._credentials.fleet)
        self._signed, self.roster, self._alike = signed, roster, 0
        self._say(f"roster {roster.number}: {len(roster.members)} members, {len(roster.revoked)} revoked")
        if roster.is_revoked(self._credentials.certificate.fingerprint):
            self._say_once("own", "our own certificate was revoked: others give us nothing, and take nothing from us")
        kept = self._is_kept(signed)
        if self._rules_by(roster) == self._rules:
            self._outdated.clear()
        elif kept:
            self._outdated.set()
        self._hurry.set()
        for listener in self._listeners:
            listener(roster)
        return True

    def _is_kept(self, signed: SignedRoster) -> bool:
        """On a read-only disk it is forgotten at the next start and heard again: to start again would have no end."""
        try:
            files.write(credentials.roster_place(self._credentials.folder), msgspec.json.encode(signed))
        except BadConfig as e:
            self._say_once("write", f"{e}; the rules between routers stay as they are until it can be written")
            return False
        return True

    def _rules_by(self, roster: Roster) -> dict[str, Any]:
        return access_control(self._plan.file, self._credentials.fleet, self._credentials.name, roster)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        with contextlib.suppress(BadInput):
            self._take(sample.payload.to_bytes())

    def _take(self, data: bytes) -> None:
        try:
            self.adopt(read_signed(data))
        except BadInput as e:
            self._say_once(e.message.partition(":")[0], f"a roster was not taken: {e}")
            raise

    def _answer(self, query: zenoh.Query, loop: asyncio.AbstractEventLoop) -> Iterator[Reply | Future[HeldRoster]]:
        yield (held := asyncio.run_coroutine_threadsafe(self._held(query), loop))
        yield Reply(self._key, wire.encode(held.result()))

    async def _held(self, query: zenoh.Query) -> HeldRoster:
        if query.payload:
            self._take(query.payload.to_bytes())
        newer = query.parameters.get("newer")
        wanted = newer is not None and NUMBER.match(newer) is not None and int(newer) < self.roster.number
        return HeldRoster(
            name=self._plan.name, number=self.roster.number, t=self.roster.t, newer=self._signed if wanted else None
        )

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        """Say of each neighbour that shows a certificate and is no member, once, that it gets nothing."""
        name = event.link.auth_identifier
        if event.kind != zenoh.SampleKind.PUT or name is None or self._is_member(name):
            return
        self._say_once(
            f"link {name}", f"{name} has a certificate, but is not on the roster: nothing but rosters passes"
        )

    def _is_member(self, name: str) -> bool:
        return any(m.name == name and m.fingerprint not in self.roster.revoked for m in self.roster.members)

    def _say_once(self, what: str, text: str) -> None:
        if what not in self._said and len(self._said) < 1000:
            self._said.add(what)
            self._say(text)

    async def _tell(self) -> None:
        """Trickle's timer."""
        interval = self.shortest
        while True:
            self._alike, at = 0, random.uniform(interval / 2, interval)
            hurried = await self._hurried(at, interval)
            if not hurried and self._alike < ENOUGH:
                with contextlib.suppress(zenoh.ZError):  # the session is closing
                    self._session.put(
                        self._key,
                        msgspec.json.encode(self._signed),
                        encoding=keys.JSON,
                        **keys.Qos.MUST_ARRIVE.options(),
                    )
            hurried = hurried or await self._hurried(interval - at, interval)
            interval = self.shortest if hurried else min(2 * interval, LONGEST)

    async def _hurried(self, seconds: float, interval: float) -> bool:
        """Wait so long, or until there is reason to speak soon; sooner than in the shortest interval never is."""
        if interval <= self.shortest:
            await asyncio.sleep(seconds)
            self._hurry.clear()
            return False
        with contextlib.suppress(asyncio.TimeoutError):
            await within(seconds, self._hurry.wait())
        hurried = self._hurry.is_set()
        self._hurry.clear()
        return hurried


@contextlib.asynccontextmanager
async def watch_roster(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[RosterWatch | None]:
    """The part of a router: None where there are no credentials."""
    if plan.credentials is None:
        yield None
        return
    async with RosterWatch(session, plan, plan.credentials, log) as watch:
        yield watch
