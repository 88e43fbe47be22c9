"""Who of ROS commands one vehicle: its lease, held for one node at a time, and the stream of setpoints under it.

ROS does not say who sends, but the GID in each attachment is the hash of a token in the graph, and so of a node. Nodes
whose GIDs are in no token (some implementations invent them) count as one: they are not told apart but in their
streams, of which the first is flown.
"""

from __future__ import annotations

import asyncio
import copy
import re
import time
from collections.abc import Callable
from typing import Any

from ground.ros2.attachment import Attachment
from ground.ros2.watch import NodeId, Watch
from zmav.errors import BadInput, NotHolder, Refused, ZmavError
from zmav.ratelimit import RateLimit
from zmav.vehicle import Vehicle
from zmav.vehicle.lease import Lease
from zmav.waiting import within

TTL = 2.0
"""s that a lease outlives this process or its network"""
VALID = 0.5
"""s after it was published for which a setpoint may be flown"""
SILENCE = 1.5
"""s without a setpoint after which a lease that came with the stream ends: as if its holder had died"""
FORGOTTEN = 30.0
"""s without a setpoint after which a lease ends that was asked for by a node which no token shows"""
LOOK = 0.1
"""s between two looks at whether a lease is still needed"""
SAY_EVERY, SAY_MOST = 5.0, 20
"""s between two times that one reason is said, and reasons told apart"""
MOST = 64
"""publishers of one vehicle's setpoints that are remembered"""
READ_ONLY = "'zmav ros2' was started without --orders: nothing that ROS says moves or changes a vehicle"
Log = Callable[[str], None]


class Holding:
    """The lease, held for the node of ``gid``. ``asked``: by the lease service, and not by its stream."""

    def __init__(self, gid: bytes, node: NodeId | None, name: str, asked: bool) -> None:
        self.gid, self.node, self.name, self.asked = gid, node, name, asked
        self.stream: bytes | None = None if asked else gid
        """the GID whose setpoints are flown"""
        self.heard = time.monotonic()
        self.stop = asyncio.Event()
        self.lease: asyncio.Future[Lease] = asyncio.get_running_loop().create_future()
        self.task: asyncio.Task[None] | None = None

    @property
    def over(self) -> bool:
        return self.task is not None and self.task.done()

    @property
    def in_force(self) -> Lease | None:
        done = self.lease.done() and not self.lease.cancelled() and self.lease.exception() is None
        return self.lease.result() if done else None


class Steering:
    """Lives on the event loop. ``may_order``: ROS may move the vehicle at all; ``takes_over``: another 'zmav ros2' has
    shown it until now, and what streams as we begin streamed to that one.
    """

    def __init__(self, vehicle: Vehicle, watch: Watch, log: Log, *, may_order: bool, takes_over: bool = False) -> None:
        self._vehicle, self._watch, self._log, self._may_order = vehicle, watch, log, may_order
        self._begun = time.monotonic() + (SILENCE if takes_over else 0.0)
        """what streams before has not paused since it was another's"""
        self._holding: Holding | None = None
        self._barred: dict[bytes | NodeId, float] = {}
        """GIDs and nodes whose lease was taken from them, and when each was last heard: a stream that goes on asks for
        nothing, on another topic of that node neither"""
        self._sequences: dict[bytes, int] = {}
        self._said: RateLimit[str] = RateLimit(SAY_EVERY, SAY_MOST)
        self._closed = False
        self.dropped = 0
        """setpoints that were not passed on"""

    async def close(self) -> None:
        """From the first on nothing more is flown or given: another 'zmav ros2' may have the vehicle by now."""
        self._closed = True
        if self._holding is not None:
            await self._end(self._holding)

    @property
    def holder(self) -> str | None:
        """The node that commands; None: none of ROS does."""
        held = self._held()
        return held.name if held is not None else None

    # Orders and the lease service.

    def check(self) -> None:
        """Raise :class:`Refused` where ROS may move nothing."""
        if not self._may_order:
            raise Refused(READ_ONLY, vehicle=self._vehicle.name)
        if self._closed:
            text = f"this 'zmav ros2' shows {self._vehicle.name} no longer"
            raise Refused(text, vehicle=self._vehicle.name)

    def token(self, gid: bytes) -> str:
        """The lease under which an order of this GID goes; empty where its node has none."""
        held = self._held()
        lease = held.in_force if held is not None and self._holds(held, gid) else None
        return lease.token if lease is not None else ""

    async def take(self, gid: bytes, priority: int) -> str:
        """Hold the lease for a node until it gives it back or leaves; raises what the vehicle says."""
        self.check()
        if not 0 <= priority <= 100:
            raise BadInput.wrong("priority", priority, "0 to 100")
        before = self._held()
        ours = before is not None and self._holds(before, gid)
        if before is not None and ours:
            before.asked, before.heard = True, time.monotonic()
            lease = await self._granted(before)
            if lease.priority >= priority:
                return lease.holder
        taking = self._start(gid, priority, asked=True)
        try:
            lease = await self._granted(taking)
        except asyncio.CancelledError:
            taking.stop.set()  # nobody waits for it any more
            raise
        self._holding = taking
        if before is not None and ours:
            before.stop.set()  # it gave way to its own node's
        self._barred.clear()
        return lease.holder

    async def _granted(self, holding: Holding) -> Lease:
        """Once the vehicle has answered; raises what it says."""
        await asyncio.wait({holding.lease})
        if holding.lease.cancelled():
            raise Refused(f"the lease of {self._vehicle.name} was not taken", vehicle=self._vehicle.name)
        return holding.lease.result()

    async def give_back(self, gid: bytes) -> None:
        held = self._held()
        if held is None or not self._holds(held, gid):
            text = f"{self._watch.name_of(gid)} does not hold the lease of {self._vehicle.name}"
            raise NotHolder(text, vehicle=self._vehicle.name)
        await self._end(held)

    # Setpoints.

    def fly(self, said: Attachment, fields: dict[str, Any]) -> None:
        """Pass a setpoint on, within :data:`VALID` of when it was published; what is not is counted and said."""
        try:
            self.check()
            self._fly(said, fields)
        except ZmavError as e:
            self.drop(e)

    def drop(self, error: ZmavError) -> None:
        """A setpoint is not passed on, and this is why."""
        self.dropped += 1
        if self._said.take(error.message) is not None:
            self._log(f"setpoint dropped: {error}")

    def _fly(self, said: Attachment, fields: dict[str, Any]) -> None:
        left = self._left(said)
        now = time.monotonic()
        node, held = self._watch.node_of(said.gid), self._held()
        if held is None and now < self._begun and len(self._barred) <= MOST:
            for who in (said.gid, node):
                if who is not None:
                    self._barred.setdefault(who, now)
        barred = {who: self._barred[who] for who in (said.gid, node) if who is not None and who in self._barred}
        if barred:
            self._barred.update(dict.fromkeys(barred, now))
            if now - max(barred.values()) < SILENCE:
                text = f"{self._watch.name_of(said.gid)} lost the lease: stop the stream, or ask the lease service"
                raise NotHolder(text, vehicle=self._vehicle.name)
            for who in barred:
                del self._barred[who]
        if held is None:
            self._holding = self._start(said.gid, 0, asked=False)
            return
        if held.stream is None and self._holds(held, said.gid):
            held.stream = said.gid
        if said.gid != held.stream and (node is None or node != held.node):
            text = f"{held.name} commands {self._vehicle.name}: the lease service has priorities"
            raise NotHolder(text, vehicle=self._vehicle.name)
        held.heard = now
        lease = held.in_force
        if lease is not None:
            lease.setpoint(**fields, valid=left)

    def _left(self, said: Attachment) -> float:
        """Seconds for which it may still be flown; raises for one that is late, or comes out of order."""
        if said.gid in self._sequences and said.sequence <= self._sequences[said.gid]:
            raise BadInput("a setpoint came out of order", field="sequence", value=said.sequence)
        age = time.time() - said.stamp_ns / 1e9
        if not -VALID < age < VALID:
            text = "a setpoint is late, or the clocks of its node and of this host differ"
            raise BadInput(text, field="stamp", value=age, expected=f"within {VALID} s")
        if len(self._sequences) > MOST:
            self._sequences.clear()
        self._sequences[said.gid] = said.sequence
        return VALID - max(age, 0.0)

    # The lease itself.

    def _held(self) -> Holding | None:
        if self._holding is not None and self._holding.over:
            self._holding = None
        if self._holding is not None and self._holding.node is None:  # its token may come after what it says
            self._holding.node = self._watch.node_of(self._holding.gid)
        return self._holding

    def _holds(self, held: Holding, gid: bytes) -> bool:
        """It is the holder's node that says so, or neither can be told from others."""
        return gid == held.gid or self._watch.node_of(gid) == held.node

    def _start(self, gid: bytes, priority: int, *, asked: bool) -> Holding:
        holding = Holding(gid, self._watch.node_of(gid), self._watch.name_of(gid), asked)
        holding.task = asyncio.create_task(self._hold(holding, priority))
        return holding

    async def _end(self, holding: Holding) -> None:
        holding.stop.set()
        if holding.task is not None:
            await asyncio.gather(holding.task, return_exceptions=True)

    async def _hold(self, holding: Holding, priority: int) -> None:
        name = "ros2-" + re.sub(r"[^a-z0-9_]+", "-", holding.name.lower().strip("/"))
        try:
            # A handle of its own: a handle that has a lease renews that lease when it asks for one.
            async with copy.copy(self._vehicle).lease(name[:60], ttl=TTL, priority=priority) as lease:
                holding.lease.set_result(lease)
                while not holding.stop.is_set() and lease.lost is None and self._needed(holding):
                    try:
                        await within(LOOK, holding.stop.wait())
                    except asyncio.TimeoutError:
                        continue
                lease.abandoned = lease.lost is None and not holding.stop.is_set()  # nobody meant the end
                if lease.lost is not None and not holding.stop.is_set():
                    self._log(f"{holding.name} lost the lease: {lease.lost}")
                    self._bar(holding)
        except ZmavError as e:
            self._bar(holding)
            if not holding.lease.done():
                holding.lease.set_exception(e)
                holding.lease.exception()  # anyone who waits has it; that nobody does is no fault
            self._log(f"{holding.name} does not get the lease: {e}")
        finally:
            holding.lease.cancel()

    def _bar(self, holding: Holding) -> None:
        if len(self._barred) > MOST:
            self._barred.clear()
        if holding.stream is not None:
            self._barred[holding.stream] = time.monotonic()
            if holding.node is not None:
                self._barred[holding.node] = time.monotonic()

    def _needed(self, holding: Holding) -> bool:
        """A stream's lease lasts as long as the stream; one that was asked for, as long as its node is there."""
        if holding.asked and holding.node is not None:
            return self._watch.has_node(holding.node)
        return time.monotonic() - holding.heard < (FORGOTTEN if holding.asked else SILENCE)
