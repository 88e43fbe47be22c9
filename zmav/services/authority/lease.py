"""One commander at a time: a time-limited lease, renewed by use, preempted by priority, ended with its holder."""

from __future__ import annotations

import asyncio
import collections
import re
import secrets
import time
from typing import Any

import zenoh

from zmav import keys, wire
from zmav.errors import BadInput, NotHolder
from zmav.services.authority.may_move import MayMove
from zmav.services.companion import Companion
from zmav.services.queries.everybody import ask_everybody
from zmav.trust.gate import Origin
from zmav.trust.seal import Exchange
from zmav.waiting import on_loop, within

MAX_TTL = 60.0
MAX_PRIORITY = 100
MOST_PRESENT = 1024
"""holders' tokens that are remembered; a lease of who has no place among them ends when it is not renewed"""
REMEMBERED = 32
"""ended leases whose holders are still told why"""
CLOCK_SET = 0.05
"""s by which the host's time moves at once where it is set; a clock that is only slewed moves less from tick to tick"""
INSTANCE = re.compile(r"[A-Za-z0-9_-]{1,64}\Z")
ROUTER = re.compile(r"[0-9a-f]{1,32}\Z")
STREAMS = ("tcp", "tls", "unixsock-stream")
ASK_EVERY, ANSWER_S, ANSWERS = 0.3, 1.0, 2
"""s between questions to the router of a holder whose token went, s for an answer, and answers in a row that say that
the holder has died: where a way changes, a router may be heard before the tokens behind it
"""


def severity_of(reason: wire.LeaseEnding) -> wire.Severity:
    """How loud it is said that a lease ended so: its holder's own end of it is nothing to be warned of."""
    return "info" if reason == "released" else "warning"


class Leases:
    """A vehicle's lease. Lives on the event loop.

    ``may_take()`` raises while nobody may have one (the pilot's switch); the port's bus is told the
    :class:`~zmav.wire.LeaseEnd` of each, on the event loop.
    Where orders are proven, a lease belongs to whose certificate took it, and has a secret that seals the setpoints
    under it.
    """

    def __init__(self, companion: Companion, *, may_take: MayMove[[]]) -> None:
        self._session, self._events, self._bus = companion.session, companion.events, companion.port.bus
        self._fleet, self.vehicle, self._may_take = companion.port.fleet, companion.port.name, may_take
        self._port = companion.port
        self.last_end: wire.LeaseEnd | None = None
        self.number = 0
        """counts the leases granted, and names the one in force: the token itself is its holder's secret"""
        self.secret, self.last_secret = b"", b""
        """what seals the setpoints of the lease in force, and of the one before; empty where nothing is proven"""
        self._token = self._holder = self._instance = self._router = ""
        """``_router``: the holder's, where its token may go without the holder"""
        self._looking: asyncio.Task[None] | None = None
        """for an absent holder: its token went, and it is not known whether it has died or only the way to it"""
        self.origin: Origin | None = None
        """whose certificate it was given to, where that is proven"""
        self._answer: dict[str, Any] = {}
        self._priority = 0
        self._ttl = 0.0
        self._expires = self._committed = self._used = 0.0
        self._ahead = self._set_by = 0.0
        """UTC less monotonic seconds when last looked at, and by how much it was set since the lease was given"""
        self.present: set[tuple[str, str]] = set()
        """holder and instance of each whose token is there"""
        self._ended: collections.OrderedDict[str, wire.LeaseEnd] = collections.OrderedDict()
        self._subscriber: Any = None

    def start(self) -> None:
        holders = keys.HOLDER.key(self._fleet, self.vehicle, holder="*", instance="*")
        heard = on_loop(asyncio.get_running_loop(), self._on_token)
        self._subscriber = self._session.liveliness().declare_subscriber(holders, heard, history=True)

    @property
    def misses_holder(self) -> bool:
        """The holder's token went, and it is not known yet whether the holder did."""
        return self._looking is not None

    def close(self) -> None:
        self._found()
        self._subscriber.undeclare()

    @property
    def holder(self) -> str | None:
        return self._holder if self._token else None

    # The orders.

    async def take(self, args: wire.TakeLease, report: object, origin: Origin | None) -> dict[str, Any]:
        """Grant or renew; raises :class:`NotHolder` while another of the same or a higher priority holds it (a namesake
        without the token included), or when the lease to be renewed has ended or was given to another ``origin``.
        """
        self._check(args)
        self.tick()
        if args.lease:
            if args.lease != self._token:
                raise self.refusal(args.lease)
            self._check_origin(origin)
        else:
            token = secrets.token_hex(8)
            secret, answer = self._agree(args, token) if origin else (b"", {})
            self._may_take()
            if self._looking:  # who asks meanwhile has it
                self._gone()
            if self._token and args.priority <= self._priority:
                raise self.refusal()
            if self._token:
                text = f"{args.holder} (priority {args.priority}) took the lease from {self._holder} ({self._priority})"
                self.end("preempted", text, by=args.holder)
            self._token, self._holder, self.origin = token, args.holder, origin
            self.secret, self._answer = secret, answer
            self.number += 1
            self._port.link.hurry()  # frames lie no more: the pilot is heard at once
            self._committed = self._set_by = 0.0
            proven = {"origin": origin.name} if origin else {}
            words = f"{args.holder} commands"
            self._events.emit("lease", "info", words, holder=args.holder, priority=args.priority, **proven)
        self._instance, self._priority, self._ttl = args.instance, args.priority, args.ttl
        self._router = "" if self._tells(args.router) else args.router
        self.renew()
        granted = {"lease": self._token, "holder": self._holder, "ttl": self._ttl, "number": self.number}
        return {**granted, **self._answer}

    async def drop(self, args: wire.DropLease, report: object, origin: Origin | None) -> dict[str, Any]:
        """The holder gives it back."""
        self.require(args.lease)
        self._check_origin(origin)
        self.end("released", f"{self._holder} gave the lease back")
        return {}

    async def revoke(self, args: wire.RevokeLease, report: object, origin: Origin | None) -> dict[str, Any]:
        """An operator ends anybody's lease; harmless where there is none."""
        held = self.holder
        if held is not None:
            why = f": {args.reason}" if args.reason else ""
            who = f"the operator {origin.name}" if origin else "an operator"
            self.end("revoked", f"lease of {held} revoked by {who}{why}", by=origin.name if origin else None)
        return {"holder": held}

    # What others use.

    def allow(self, token: str, origin: Origin | None) -> None:
        """Raise :class:`NotHolder` where somebody else commands, or ``token``'s lease has ended: who was given it does
        not go on as if nothing had been. With no lease given out, an order needs none.
        """
        self.tick()
        if token != self._token:
            raise self.refusal(token)
        if self._token:
            self._check_origin(origin)
            self.renew()

    def require(self, token: str) -> None:
        """Raise :class:`NotHolder` unless ``token`` is the lease in force, and renew it."""
        self.tick()
        if not self._token or token != self._token:
            raise self.refusal(token)
        self.renew()

    def holds(self, token: str, origin: Origin | None) -> bool:
        """``token`` is the lease in force and ``origin``'s, or none is."""
        return not self._token or (token == self._token and origin == self.origin)

    def renew(self) -> None:
        """It is in use."""
        self._used = time.monotonic()
        self._expires = max(self._used + self._ttl, self._committed)

    def commit(self, until: float) -> None:
        """What was handed over lasts until then (monotonic seconds), and the lease with it, renewed or not."""
        self._committed = until
        self.renew()

    def tick(self) -> None:
        """A few times a second, and before each decision."""
        self._watch_clock()
        if self._token and time.monotonic() > self._expires:
            self.end("expired", f"lease of {self._holder} ran out")

    def _watch_clock(self) -> None:
        begun, utc = time.monotonic(), time.time()
        if time.monotonic() - begun < CLOCK_SET / 5.0:  # we were not held up between the two
            change, self._ahead = utc - begun - self._ahead, utc - begun
            self._set_by += change if abs(change) > CLOCK_SET else 0.0

    def check_clock(self) -> None:
        """Raise :class:`NotHolder` and end the lease where this host's time was set since it was given: its holder
        measured another clock, and would have its segments flown too early or too late.
        """
        if self._set_by:
            token = self._token
            self.end("clock", f"the clock of {self.vehicle} was set by {self._set_by:+.2f} s")
            raise self.refusal(token)

    def end(self, reason: wire.LeaseEnding, text: str, by: str | None = None) -> None:
        """The lease is over, and its holder hears ``text`` from now on; nothing where there is none."""
        if not self._token:
            return
        self._found()
        end = wire.LeaseEnd(t=time.time(), number=self.number, holder=self._holder, reason=reason, text=text, by=by)
        self._ended[self._token] = end
        while len(self._ended) > REMEMBERED:
            self._ended.popitem(last=False)
        self._token = self._holder = self._instance = ""
        self.origin, self.secret, self.last_secret = None, b"", self.secret
        self.last_end = end
        self._events.emit(
            "lease", severity_of(reason), text, holder=end.holder, reason=reason, **({"by": by} if by else {})
        )
        self._bus.tell(end)

    def info(self) -> wire.LeaseInfo | None:
        if not self._token:
            return None
        expires = time.time() + self._expires - time.monotonic()
        return wire.LeaseInfo(
            holder=self._holder,
            expires=expires,
            priority=self._priority,
            number=self.number,
            origin=self.origin.name if self.origin else None,
        )

    def refusal(self, token: str = "") -> NotHolder:
        """Why ``token`` does not command the vehicle."""
        ended = self._ended.get(token)
        detail = {"vehicle": self.vehicle, **({"reason": ended.reason} if ended else {})}
        if not self._token:
            why = f"no such lease on {self.vehicle}" + (f" any more: {ended.text}" if ended else "")
            return NotHolder(f"{why}; ask for one with do/lease", **detail)
        left = self._expires - time.monotonic()
        text = (
            f"{self._holder} commands {self.vehicle} (for {left:.1f} s more unless renewed); hold, land, rtl and "
            "disarm are open to everybody and end its lease"
        )
        if ended:
            text = f"{ended.text}; {text}"
        return NotHolder(text, holder=self._holder, priority=self._priority, **detail)

    # How it is done.

    def _agree(self, args: wire.TakeLease, token: str) -> tuple[bytes, dict[str, Any]]:
        """The secret of a new lease, and what its holder is told so that he comes to the same one."""
        ours = Exchange()
        return ours.secret(args.key, f"{self._fleet}/{self.vehicle}", token), {"key": ours.public}

    def _check_origin(self, origin: Origin | None) -> None:
        """A token can be overheard: it is its holder's only as long as he proves that he asks."""
        if origin != self.origin:
            given, asks = (one.name if one else "nobody proven" for one in (self.origin, origin))
            text = f"that lease on {self.vehicle} was given to {given}, and {asks} asks"
            raise NotHolder(text, vehicle=self.vehicle, holder=self._holder, reason="origin")

    def _check(self, args: wire.TakeLease) -> None:
        if not args.holder:
            raise BadInput.wrong("holder", args.holder, "a name")
        keys.check_name(args.holder, "holder")
        for field, value, low, high in (("ttl", args.ttl, 0.1, MAX_TTL), ("priority", args.priority, 0, MAX_PRIORITY)):
            if not low <= value <= high:
                expected = f"{low:g} to {high:g}"
                raise BadInput(f"a lease needs a {field} from {expected}", field=field, value=value, expected=expected)
        if args.instance and not INSTANCE.match(args.instance):
            raise BadInput.wrong("instance", args.instance, "the end of a liveliness token: letters, digits, '_', '-'")
        if args.router and not ROUTER.match(args.router):
            raise BadInput.wrong("router", args.router, "a Zenoh id: up to 32 hexadecimal digits")

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Only a token that was there can go: one that is late on a bad network ends nothing."""
        parts = keys.match(str(sample.key_expr))[1]
        who = (parts["holder"], parts["instance"])
        holds = bool(self._token) and who == (self._holder, self._instance)
        if sample.kind == zenoh.SampleKind.PUT:
            if len(self.present) < MOST_PRESENT:
                self.present.add(who)
            if holds:
                self._found()
        elif who in self.present:
            self.present.discard(who)
            if holds and self._router:
                self._found()
                self._looking = asyncio.get_running_loop().create_task(self._look())
            elif holds:
                self._gone()

    def _tells(self, router: str) -> bool:
        """A holder's token goes only when the holder does: its router is ours, or its connection to ours closes when it
        ends. One by datagrams, or one further away, is merely not heard any more.
        """
        info = self._session.info
        near = [str(link.dst).split("/")[0] for link in info.links() if str(link.zid) == router]
        return router == str(info.zid()) or any(each in STREAMS for each in near)

    def _gone(self) -> None:
        self.end("gone", f"{self._holder}, who held the lease, is gone")

    def _found(self) -> None:
        """Nobody is looked for any more."""
        if self._looking:
            self._looking.cancel()
        self._looking = None

    async def _look(self) -> None:
        """A token goes with its holder, and with the way to it. The holder has died where its router is heard without
        the token, and nothing comes under the lease; where the router is not heard either, the lease lasts its time:
        the stream has its watchdog.
        """
        answers, loop, key = 0, asyncio.get_running_loop(), f"@/{self._router}/router"
        while answers < ANSWERS:
            used, heard = self._used, asyncio.Event()
            await asyncio.sleep(ASK_EVERY)
            replies = on_loop(loop, lambda reply, heard=heard: reply.ok and heard.set())
            ask_everybody(self._session, keys.DO.qos, key, replies, timeout=ANSWER_S)
            try:
                await within(ANSWER_S, heard.wait())
                answers = answers + 1 if used == self._used else 0
            except asyncio.TimeoutError:
                answers = 0
        self._gone()
