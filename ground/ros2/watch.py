"""Who else is in the ROS graph: whether anybody subscribes to a topic, and who it is that has a GID.

Anybody declares tokens, and as many as he likes: so many are looked at, and no more.
"""

from __future__ import annotations

import asyncio
import collections
import logging
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import msgspec
import zenoh

from ground.ros2 import graph
from ground.ros2.node import Ros
from zmav import keys
from zmav.client import Client
from zmav.direct import direct
from zmav.subscription import document
from zmav.waiting import cancelled, on_loop

logger = logging.getLogger(__name__)
W = TypeVar("W", bound=msgspec.Struct)
MOST = 20_000
"""endpoints of others that are remembered"""
SAID = 100
"""differences of types that are said"""
NodeId = tuple[str, int]
"""a node's session, and its number in that"""


class WhileWanted:
    """What :meth:`Watch.offer` calls where work is to go on while somebody subscribes: a task of ``work()``. Lives on
    the event loop.
    """

    def __init__(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._work = work
        self._task: asyncio.Task[None] | None = None

    def __bool__(self) -> bool:
        """It goes on."""
        return self._task is not None

    def __call__(self, wanted: bool) -> None:
        if wanted and self._task is None:
            self._task = asyncio.create_task(self._work())
        elif not wanted and self._task is not None:
            self._task.cancel()
            self._task = None

    async def close(self) -> None:
        """Returns once it has ended."""
        task, self._task = self._task, None
        await cancelled(task)


async def hear(z: Client, fleet: str, topic: str, payload: type[W], publish: Callable[[W], None]) -> None:
    """Have what is said of a topic of the fleet published, for :class:`WhileWanted`."""
    async with z.subscribe(keys.FLEET.key(fleet, topic=topic), document(payload)) as told:
        async for _, each in told:
            try:
                publish(each)
            except Exception:
                logger.exception("what was said of %s's %s was not published", fleet, topic)


def _less(counter: collections.Counter[Any], what: Any) -> None:
    counter[what] -= 1
    if not counter[what]:
        del counter[what]


class Watch:
    """Lives on the event loop. ``say(line)``: what the user should know, once."""

    def __init__(self, ros: Ros, say: Callable[[str], None]) -> None:
        self._zid, self._say = ros.zid, say
        self._count_of_all = 0
        self._endpoints: dict[str, dict[str, graph.Endpoint]] = {}
        """of others, by topic and token"""
        self._by_gid: dict[bytes, graph.Endpoint] = {}
        self._nodes: collections.Counter[NodeId] = collections.Counter()
        """how many endpoints of each there are"""
        self._speakers: dict[str, collections.Counter[str]] = {}
        """sessions that serve as a node of that name, and how many services each: a viewer's certificate shows none"""
        self._readers: dict[tuple[str, str], set[str]] = {}
        """tokens of who subscribes, by topic and hash"""
        self._offered: dict[str, dict[str, tuple[graph.Endpoint, Callable[[bool], None]]]] = {}
        """by topic and token: /tf is every vehicle's"""
        self._said: set[str] = set()
        self._subscriber = ros.session.liveliness().declare_subscriber(
            f"{graph.SPACE}/{ros.domain}/**", direct(on_loop(ros.loop, self._on_token)), history=True
        )

    def close(self) -> None:
        self._subscriber.undeclare()

    def offer(self, endpoint: graph.Endpoint, wanted: Callable[[bool], None]) -> None:
        """Have ``wanted(True)`` called when somebody begins to subscribe to a topic, and ``wanted(False)`` when nobody
        does any more; and have it said where somebody knows a topic or a service by another type.
        """
        self._offered.setdefault(endpoint.name, {})[endpoint.token] = endpoint, wanted
        if self._readers.get((endpoint.name, endpoint.hash)):
            wanted(True)
        for other in self._endpoints.get(endpoint.name, {}).values():
            self._compare(endpoint, other)

    def withdraw(self, endpoint: graph.Endpoint) -> None:
        offered = self._offered.get(endpoint.name, {})
        offered.pop(endpoint.token, None)
        if not offered:
            self._offered.pop(endpoint.name, None)

    def who(self, gid: bytes) -> graph.Endpoint | None:
        """The endpoint that has this GID; None for one whose token is not there, or has another."""
        return self._by_gid.get(gid)

    def node_of(self, gid: bytes) -> NodeId | None:
        """The node of the endpoint that has this GID, as far as the graph shows."""
        found = self.who(gid)
        return None if found is None else (found.node.zid, found.node.nid)

    def has_node(self, node: NodeId) -> bool:
        """Any endpoint of it is there."""
        return node in self._nodes

    def sessions_of(self, path: str) -> set[str]:
        """Others' sessions that serve as a node of that name: ``/quad1/zmav``."""
        return set(self._speakers.get(path, ()))

    def name_of(self, gid: bytes) -> str:
        """The node's name, or its GID where that is not known."""
        found = self.who(gid)
        return found.node.path if found is not None else gid.hex()[:8]

    def _on_token(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        found = graph.parse(token)
        if found is None or found.node.zid == self._zid:
            return
        there = self._endpoints.get(found.name, {})
        if sample.kind != zenoh.SampleKind.PUT:
            if there.pop(token, None) is not None:
                self._count_of_all -= 1
                self._by_gid.pop(graph.gid_of(token), None)
                _less(self._nodes, (found.node.zid, found.node.nid))
                if found.kind == graph.SERVER:
                    speakers = self._speakers[found.node.path]
                    _less(speakers, found.node.zid)
                    if not speakers:
                        del self._speakers[found.node.path]
                self._count(found, token, False)
            if not there:
                self._endpoints.pop(found.name, None)
        elif token not in there and self._count_of_all < MOST:
            self._count_of_all += 1
            self._endpoints.setdefault(found.name, {})[token] = found
            self._by_gid[graph.gid_of(token)] = found
            self._nodes[found.node.zid, found.node.nid] += 1
            if found.kind == graph.SERVER:
                self._speakers.setdefault(found.node.path, collections.Counter())[found.node.zid] += 1
            self._count(found, token, True)
            for endpoint, _ in self._offered.get(found.name, {}).values():
                self._compare(endpoint, found)

    def _count(self, found: graph.Endpoint, token: str, there: bool) -> None:
        if found.kind != graph.SUBSCRIBER:
            return
        place = found.name, found.hash
        readers = self._readers.setdefault(place, set())
        before = bool(readers)
        (readers.add if there else readers.discard)(token)
        if not readers:
            del self._readers[place]
        if bool(readers) != before:
            for endpoint, wanted in list(self._offered.get(found.name, {}).values()):
                if endpoint.hash == found.hash:
                    wanted(there)

    def _compare(self, ours: graph.Endpoint, theirs: graph.Endpoint) -> None:
        """A type that another ROS has in another version is never received, and nobody would know why."""
        if (ours.type, ours.hash) == (theirs.type, theirs.hash):
            return
        what = f"as {theirs.type}" if ours.type != theirs.type else f"with another definition of {ours.type}"
        here = f"here it is {ours.type} ({ours.hash[:15]})"
        self._tell(f"{theirs.node.path} knows {ours.name} {what} ({theirs.hash[:15]}); {here}")

    def _tell(self, text: str) -> None:
        if text not in self._said and len(self._said) < SAID:
            self._said.add(text)
            self._say("".join(each if each.isprintable() else "?" for each in text))  # anybody's words
