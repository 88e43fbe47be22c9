"""A program that runs for one vehicle, on board or on the ground: what vision, followers and controllers stand on.

class Blinker(zmav.Agent):
    name = "blinker"
    tunables = {"period": Tunable(1.0, 0.1, 10.0, "s", "between two blinks")}

    async def run(self) -> None:
        while True:
            self.status("on", f"every {self['period']:g} s")
            await asyncio.sleep(self["period"])

It meets others in the key space only: it says its status, answers orders and is tuned under ``agent/{name}``, and moves
the vehicle under a lease like everybody else.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections import deque
from collections.abc import Iterator, Mapping
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import zenoh

from zmav import keys, wire
from zmav.bus import Alive, Bus
from zmav.errors import BadInput, Clash, ZmavError
from zmav.process import say
from zmav.ratelimit import RateLimit
from zmav.services.orders.orders import Guarded, Orders, proof_is_enough
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions, Reply
from zmav.trust.gate import Origin, ProofRefused, anybody
from zmav.tunable import Tunable as Tunable
from zmav.tunable import check_tunable
from zmav.verbs import Access, Verb
from zmav.waiting import cancelled, on_loop, within

if TYPE_CHECKING:
    from zmav.client import Client

logger = logging.getLogger(__name__)
ALONE = 1.0
"""s for another one of the name to answer, where there is one"""
HEARTBEAT = 1.0
"""s between two words of its status, where nothing changes"""
SELDOM, KINDS = 1.0, 64
"""s between two words on refusals of one kind, and kinds that are told apart"""
EVENTS = 10
"""what happened last, told with the status"""
TUNING: dict[str, Verb] = {
    "set": Verb("set", wire.SetTunable, Access.CHANGE, "change a parameter while it runs"),
    "params": Verb("params", wire.Order, Access.READ, "all parameters, their values and bounds"),
}
"""what every agent can be asked"""


class NoSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of an agent that needs none."""


class Agent:
    """Base of agents. ``settings``: a Struct of the class's own kind, what is fixed while it runs; ``tuned``: values of
    parameters to begin with. Raises :class:`~zmav.errors.BadInput` for one that is unknown or out of bounds.

    Subclasses give :attr:`name`, :meth:`run`, and for each of their :attr:`verbs` a handler ``on_VERB(args, report,
    origin)`` as of :class:`~zmav.services.orders.orders.Orders`.
    """

    name: str
    """in keys: the class's, or one that it gives itself before :meth:`__init__`"""
    settings_type: ClassVar[type[msgspec.Struct]] = NoSettings
    tunables: ClassVar[Mapping[str, Tunable]] = MappingProxyType({})
    verbs: ClassVar[Mapping[str, Verb]] = MappingProxyType({})

    def __init__(
        self,
        z: Client,
        vehicle: str,
        settings: msgspec.Struct | None = None,
        tuned: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self.z, self.vehicle = z, z.vehicle(vehicle)
        self.settings: Any = self.settings_type() if settings is None else settings
        self._declared = self.tunables
        self._values = {name: each.default for name, each in self._declared.items()}
        for name, value in tuned.items():
            self.tune(name, value)
        self._state, self._text, self._detail = "starting", "", dict[str, Any]()
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS)
        self._refusals: RateLimit[str] = RateLimit(SELDOM, KINDS)
        self._changed = asyncio.Event()
        self._heart: asyncio.Task[None] | None = None
        self._topics: dict[str, zenoh.Publisher] = {}
        self.bus = Bus()
        """is told :class:`~zmav.bus.Alive` with each word of its status"""
        table = {**TUNING, **self.verbs}
        self._gate = z.member.make_gate(self.bus) if z.member else None
        answers = Answers(z.member.signer if z.member else None, self._gate)
        self._questions = Questions(z.session, answers, anybody)
        self._orders = Orders(
            z.session,
            self.vehicle.fleet,
            vehicle,
            self._gate.check if self._gate else anybody,
            answers,
            proof_is_enough,
            keys.AGENT_DO,
            table,
            parts={"agent": self.name},
            questions=self._questions,
        )
        for verb in table:
            handler: Guarded = getattr(self, f"on_{verb}")
            self._orders.add(verb, handler)

    # What it is made of.

    @staticmethod
    def check(settings: Any) -> None:
        """Raise what can be known to be wrong before it runs, such as a file that ``settings`` name."""

    async def run(self) -> None:
        """What it does, until cancelled or done."""
        raise NotImplementedError

    def __getitem__(self, name: str) -> float:
        """A parameter's value now."""
        return self._values[name]

    def tune(self, name: str, value: float) -> float:
        """Change a parameter; gives what it was. Raises :class:`~zmav.errors.BadInput`."""
        check_tunable(self.name, self._declared, name, value)
        before, self._values[name] = self._values[name], value
        self.tuned(name, value)
        return before

    def tuned(self, name: str, value: float) -> None:
        """A parameter has another value."""

    def declare(self, tunables: Mapping[str, Tunable]) -> None:
        """Have other parameters from now on; one that was there before keeps its value, where that is within bounds."""
        before, self._declared = self._values, tunables
        self._values = {name: each.default for name, each in tunables.items()}
        for name in before.keys() & tunables.keys():
            if tunables[name].low <= before[name] <= tunables[name].high:
                self._values[name] = before[name]

    # What it says.

    def status(self, state: str, text: str = "", **detail: Any) -> None:
        """What it does now, in a word and a sentence; said again every second, and at once where the word changes."""
        news = state != self._state
        self._state, self._text, self._detail = state, text, detail
        if news:
            self._changed.set()

    def say(self, kind: str, severity: wire.Severity, text: str, **detail: Any) -> None:
        """Something happened: in the log, and in the status for a while."""
        event = wire.Event(t=time.time(), kind=kind, severity=severity, text=text, detail=detail)
        self._events.append(msgspec.to_builtins(event, enc_hook=str))
        say(f"{self.vehicle.name}/{self.name}: " + (text if severity in ("info", "notice") else f"{severity}: {text}"))
        self._changed.set()

    def publish(self, topic: str, values: Mapping[str, float], t: float | None = None) -> None:
        """Stream numbers by their names on ``agent/{name}/out/{topic}``, as of ``t`` (UTC seconds; None: now), where
        'zmav echo', 'zmav view' and the recorder find them. Those that are not finite are left out. Raises
        :class:`~zmav.errors.BadKey` for a topic that cannot be a name, :class:`~zmav.errors.BadInput` for what are no
        numbers. From one thread, any.
        """
        if topic not in self._topics:
            key = keys.AGENT_OUT.key(
                self.vehicle.fleet, self.vehicle.name, agent=self.name, topic=keys.check_name(topic, "topic")
            )
            self._topics[topic] = self.z.session.declare_publisher(key, **keys.AGENT_OUT.publishing())
        try:
            finite = {name: value for name, value in values.items() if math.isfinite(value)}
        except (AttributeError, TypeError) as e:
            raise BadInput.wrong("what is published", values, "numbers by their names: {'speed': 1.5}") from e
        self._topics[topic].put(wire.encode(wire.Signals(t=time.time() if t is None else t, values=finite)))

    def _speak(self) -> None:
        detail = {**self._detail, "params": dict(self._values), "events": list(self._events)}
        try:
            told = msgspec.to_builtins(detail, enc_hook=str)
            self.z.say_status(self.name, self._state, self._text, vehicle=self.vehicle.name, **told)
        except zenoh.ZError as e:  # a closed session hears nothing
            logger.debug("no status: %s", e)

    async def _beat(self) -> None:
        while True:
            self._changed.clear()
            self._speak()
            self.bus.tell(Alive())
            with contextlib.suppress(asyncio.TimeoutError):
                await within(HEARTBEAT, self._changed.wait())

    # What it is asked.

    async def on_set(self, args: wire.SetTunable, report: object, origin: Origin | None) -> dict[str, Any]:
        before = self.tune(args.name, args.value)
        by = f", by {origin.name}" if origin else ""
        self.say(
            "param",
            "notice",
            f"{args.name} is {args.value:g}, was {before:g}{by}",
            name=args.name,
            value=args.value,
            before=before,
        )
        self.z.put(keys.AGENT_PARAM, self._param_key(args.name), self._tunable(args.name))
        return {"name": args.name, "value": args.value, "before": before}

    async def on_params(self, args: wire.Order, report: object, origin: Origin | None) -> dict[str, Any]:
        return {name: msgspec.to_builtins(self._tunable(name)) for name in self._declared}

    def _tunable(self, name: str) -> wire.TunableInfo:
        t = self._declared[name]
        return wire.TunableInfo(value=self[name], default=t.default, low=t.low, high=t.high, unit=t.unit, doc=t.doc)

    def _param_key(self, name: str) -> str:
        return keys.AGENT_PARAM.key(self.vehicle.fleet, self.vehicle.name, agent=self.name, param=name)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        """Each parameter that the asked key expression fits."""
        for name in self._declared:
            if query.key_expr.intersects(zenoh.KeyExpr(self._param_key(name))):
                yield Reply(self._param_key(name), wire.encode(self._tunable(name)))

    # Its life.

    async def __aenter__(self) -> Agent:
        """Raises :class:`~zmav.errors.Clash` where one of its name runs for the vehicle: both would hear its orders."""
        where = keys.AGENT_DO.key(self.vehicle.fleet, self.vehicle.name, agent=self.name, verb="params")
        if await self.z.ask(where, b"{}", ALONE, enough=lambda answer: True):
            text = f"an agent {self.name} runs for {self.vehicle.name} already: end that one first"
            raise Clash(text, vehicle=self.vehicle.name, agent=self.name)
        if self._gate is not None:
            self._say_soon = on_loop(asyncio.get_running_loop(), self.say)
            self.bus.on(ProofRefused, self._on_refused)
        self._orders.start()
        self._questions.declare(self._param_key("*"), self._answer)
        self._heart = asyncio.create_task(self._beat())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await cancelled(self._heart)
        self._questions.close()
        for publisher in self._topics.values():
            publisher.undeclare()
        await self._orders.close()
        self.status("ended", str(error) if isinstance(error, ZmavError) else "")
        self._speak()

    def _on_refused(self, told: ProofRefused) -> None:
        """From any thread: one a second for each reason, and the next says how many were left out."""
        error = told.error
        left_out = self._refusals.take(str(error.detail.get("reason")))
        if left_out is not None:
            more = f" (and {left_out} more before)" if left_out else ""
            self._say_soon("refused", "warning", f"refused: {error}{more}")
