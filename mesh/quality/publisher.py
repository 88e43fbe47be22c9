"""``link/{neighbour}``: what is known of each neighbour, once a second and whenever somebody asks."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Iterator

import msgspec
import zenoh

from mesh.plan import RouterPlan
from mesh.quality.interface import address_of, signal
from mesh.quality.probe import Neighbour, Prober
from zmav import keys, wire
from zmav.config import Host
from zmav.config.mesh import parse_budget
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions, Reply
from zmav.trust.gate import anybody
from zmav.waiting import cancelled

PERIOD = 1.0
NAMELESS = 3.0
"""s that a new neighbour has to say its name before it is told of by its router's id"""
AUTOPILOT = "autopilot"
"""the link of that name is the vehicle's own"""
UNUSABLE = 65_535
"""of a link that is down or lets nothing through; the most that Zenoh's weights can say, too"""
UNIT = 1e-5
SENDING = 1e-3
"""s that a kilobyte takes beside the way: of a radio of 10 Mbit/s"""


class LinkQualities:
    """Measures and publishes the neighbours of one router. Runs beside it, on the event loop."""

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        name: str,
        prober: Prober | None = None,
        period: float = PERIOD,
    ) -> None:
        self._session, self._fleet, self._name, self._period = session, fleet, name, period
        self.prober = prober or Prober(session, fleet, name)
        self.latest: dict[str, wire.NeighbourQuality] = {}
        """by the neighbour's name; never changed, only replaced: any thread may read it"""

    async def __aenter__(self) -> LinkQualities:
        self.prober.start()
        everything = keys.LINK.key(self._fleet, self._name, link="*")
        self._questions = Questions(self._session, Answers(None, None), anybody)
        self._questions.declare(everything, self._answer)
        self._task = asyncio.get_running_loop().create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        await cancelled(self._task)
        self._questions.close()
        await self.prober.close()

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(self._period)
            self.latest = self.measure()
            for name, quality in self.latest.items():
                with contextlib.suppress(zenoh.ZError):
                    key = keys.LINK.key(self._fleet, self._name, link=name)
                    data = wire.encode(quality)
                    self._session.put(key, data, encoding=keys.LINK.encoding, **keys.LINK.qos.options())

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        for name, quality in self.latest.items():
            key = keys.LINK.key(self._fleet, self._name, link=name)
            if query.key_expr.intersects(zenoh.KeyExpr(key)):
                yield Reply(key, wire.encode(quality), keys.LINK.encoding)

    # What there is to tell.

    def measure(self) -> dict[str, wire.NeighbourQuality]:
        """Every neighbour's quality now, by name; those that are linked go before their namesakes that were."""
        self.prober.take()
        now = time.monotonic()
        found: dict[str, wire.NeighbourQuality] = {}
        for neighbour in sorted(self.prober.neighbours.values(), key=lambda n: (not n.linked, -n.since)):
            if neighbour.name is None and neighbour.linked and now - neighbour.since < NAMELESS:
                continue
            name = neighbour.name or neighbour.zid
            if name in (AUTOPILOT, self._name) or (name in found and neighbour.linked):
                name = neighbour.zid  # it has a name that is somebody else's
            if name not in found:
                found[name] = self._quality(name, neighbour, now)
        return found

    def _quality(self, name: str, neighbour: Neighbour, now: float) -> wire.NeighbourQuality:
        figures, interface = neighbour.meter.figures(now), neighbour.interface
        address = address_of(neighbour.url)
        quality = wire.NeighbourQuality(
            t=time.time(),
            name=name,
            router=self.prober.zid,
            peer=neighbour.zid,
            url=neighbour.url,
            state=_state(neighbour, figures.silent),
            age=_rounded(figures.age, 3),
            rtt=_rounded(figures.rtt, 6),
            rtt_min=_rounded(figures.rtt_min, 6),
            loss_in=_rounded(figures.loss_in, 4),
            loss_out=_rounded(figures.loss_out, 4),
            signal=signal(interface, address) if interface and address and neighbour.linked else None,
            interface=interface,
            since=round(time.time() - (now - neighbour.since), 1),
        )
        return msgspec.structs.replace(quality, cost=cost(quality))


def cost(quality: wire.NeighbourQuality) -> int:
    """Expected time to bring a kilobyte over the link, repeats included, in units of 10 µs: 1 to ``UNUSABLE``.

    As the airtime metric of IEEE 802.11-2016, 14.9, it is a time divided by the share that arrives, there and back, as
    in ETX (De Couto et al. 2003); the time is half the least round trip, which grows as a radio slows. What is not
    known is taken for good.
    """
    if quality.state in ("down", "silent"):
        return UNUSABLE
    delivered = (1.0 - (quality.loss_in or 0.0)) * (1.0 - (quality.loss_out or 0.0))
    if delivered <= 0.0:
        return UNUSABLE
    seconds = (quality.rtt_min or 0.0) / 2 + SENDING
    return max(1, min(round(seconds / delivered / UNIT), UNUSABLE))


def _state(neighbour: Neighbour, silent: bool) -> wire.LinkState:
    if not neighbour.linked:
        return "down"
    return "silent" if silent else "up"


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


@contextlib.asynccontextmanager
async def link_qualities(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[LinkQualities]:
    """The part of :class:`mesh.router.Router`."""
    lease = (plan.value("transport/link/tx/lease") or 1000) / 1000
    prober = Prober(session, plan.fleet, plan.name, budget=budgets(plan.host), lease=lease)
    async with LinkQualities(session, plan.fleet, plan.name, prober) as running:
        yield running


def budgets(host: Host) -> Callable[[str | None], float | None]:
    """The budget in bytes/s of what leaves through an interface; through loopback, where bearers are, the least one."""
    found = {r.interface or "": parse_budget(r.budget) for r in host.radios if r.budget}
    least = min(found.values(), default=None)
    return lambda interface: least if interface in (None, "lo") else found.get(interface, found.get(""))
