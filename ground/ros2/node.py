"""A ROS 2 node on a Zenoh session: what it publishes, subscribes to and serves, with the tokens that show it.

What others send may be anything: what is no message of the type is counted and left out, a request that is none gets an
error, and nothing of it is raised.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import zenoh

from ground.ros2 import attachment, graph
from ground.ros2.attachment import Attachment
from ground.ros2.qos import RELIABLE, RosQos
from ground.ros2.types import LARGEST, Types, known
from zmav import keys, wire
from zmav.direct import direct
from zmav.errors import BadInput, Refused, ZmavError
from zmav.services.queries.proven import attached
from zmav.waiting import on_loop

logger = logging.getLogger(__name__)
MOST_WAITING = 16
"""requests of one service that are under way: more are not taken, and other services go on"""
MOST_SPEAKERS = 64
"""publishers of one topic whose newest messages wait at a time"""
SERVICES = RosQos(depth=10)

Answer = Callable[[Any, bytes], Awaitable[Any]]
"""``await answer(request, gid)`` is the response; raises :class:`~zmav.errors.ZmavError`"""


class Ros:
    """ROS 2 in one ``domain`` of a session. Made on the event loop, which answers services."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self.session, self.domain = session, domain
        self.types: Types = known()
        self.zid = str(session.info.zid())
        self.loop = asyncio.get_running_loop()
        self.numbers = itertools.count()
        """of nodes and endpoints: unique in a session"""
        self.bad = 0
        """messages and requests that were left out because they were none"""

    def node(self, namespace: str, name: str) -> RosNode:
        return RosNode(self, namespace, name)


class RosNode:
    """A node and its endpoints; :meth:`close` takes all of them away."""

    def __init__(self, ros: Ros, namespace: str, name: str) -> None:
        self.ros = ros
        self.node = graph.Node(ros.domain, ros.zid, next(ros.numbers), namespace, name)
        self.endpoints: list[graph.Endpoint] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._declared: list[Any] = [ros.session.liveliness().declare_token(self.node.token)]

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        for each in reversed(self._declared):
            each.undeclare()
        self._declared.clear()

    def endpoint(self, kind: str, name: str, ros_type: str, qos: RosQos = RELIABLE) -> graph.Endpoint:
        """Of this node; a name without a first slash is within its namespace."""
        full = name if name.startswith("/") else f"{self.node.namespace.rstrip('/')}/{name}"
        digest = self.ros.types.hash(ros_type)
        return graph.Endpoint(self.node, next(self.ros.numbers), kind, full, ros_type, digest, qos)

    def publish(self, name: str, ros_type: str, qos: RosQos = RELIABLE) -> Publisher:
        publisher = Publisher(self.ros, self.endpoint(graph.PUBLISHER, name, ros_type, qos))
        self._declare(publisher.endpoint, publisher.declared)
        return publisher

    def subscribe(self, name: str, ros_type: str, call: Callable[[Any, Attachment], None]) -> None:
        """Have ``call(message, attachment)`` called on the event loop: of each publisher the newest, none twice."""
        endpoint = self.endpoint(graph.SUBSCRIBER, name, ros_type)
        inbox = _Inbox(self.ros, ros_type, call)
        self._declare(endpoint, self.ros.session.declare_subscriber(endpoint.key, direct(inbox.take)))

    def serve(self, name: str, ros_type: str, answer: Answer) -> None:
        """Answer a service, on the event loop."""
        endpoint = self.endpoint(graph.SERVER, name, ros_type, SERVICES)
        room = threading.BoundedSemaphore(MOST_WAITING)
        begin = on_loop(self.ros.loop, self._begin)

        def take(query: zenoh.Query) -> None:
            if too_large(query.payload):  # nothing so large is kept until it is looked at
                self.ros.bad += 1
                query.drop()
            elif room.acquire(blocking=False):
                begin(endpoint, answer, query, room.release)
            else:
                query.drop()

        declared = self.ros.session.declare_queryable(endpoint.key, direct(take), complete=True)
        self._declare(endpoint, declared)

    def _declare(self, endpoint: graph.Endpoint, declared: Any) -> None:
        self.endpoints.append(endpoint)
        self._declared += [declared, self.ros.session.liveliness().declare_token(endpoint.token)]

    def _begin(self, endpoint: graph.Endpoint, answer: Answer, query: zenoh.Query, release: Callable[[], None]) -> None:
        task = self.ros.loop.create_task(self._answer(endpoint, answer, query))
        self._tasks.add(task)

        def end(task: asyncio.Task[None]) -> None:
            self._tasks.discard(task)
            release()
            query.drop()

        task.add_done_callback(end)

    async def _answer(self, endpoint: graph.Endpoint, answer: Answer, query: zenoh.Query) -> None:
        types, what = self.ros.types, endpoint.type
        try:
            try:
                asked = attachment.read(attached(query))
                payload = query.payload.to_bytes() if query.payload is not None else b""
                request = types.decode(payload, f"{what}_Request")
            except BadInput:
                self.ros.bad += 1
                raise
            response = types.encode(await answer(request, asked.gid), f"{what}_Response")
            said = attachment.write(asked.sequence, asked.gid)
            query.reply(endpoint.key, response, attachment=said)
        except zenoh.ZError:
            pass  # who asked is gone
        except Exception as e:
            if not isinstance(e, ZmavError):
                logger.exception("%s was not answered", endpoint.name)
                e = Refused(f"{endpoint.name}: {e}")
            _refuse(query, e)


def too_large(payload: zenoh.ZBytes | None) -> bool:
    return payload is not None and len(payload) > LARGEST


def _refuse(query: zenoh.Query, error: ZmavError) -> None:
    with contextlib.suppress(zenoh.ZError):  # who asked may be gone
        query.reply_err(wire.error_body(error), encoding=keys.JSON)


class Publisher:
    """Of one topic. Thread-safe."""

    def __init__(self, ros: Ros, endpoint: graph.Endpoint) -> None:
        self.endpoint, self._types = endpoint, ros.types
        self._numbers = itertools.count(1)
        options = keys.Qos.LATEST_WINS.options()
        if endpoint.qos.transient_local:
            self.declared: Any = zenoh.ext.declare_advanced_publisher(
                ros.session,
                endpoint.key,
                cache=zenoh.ext.CacheConfig(endpoint.qos.depth),
                sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
                publisher_detection=True,
                **options,
            )
        else:
            self.declared = ros.session.declare_publisher(endpoint.key, **options)

    def __call__(self, message: Any) -> None:
        data = self._types.encode(message, self.endpoint.type)
        self.declared.put(data, attachment=attachment.write(next(self._numbers), self.endpoint.gid))


class _Inbox:
    """The newest message of each publisher of a topic, until the event loop has looked at it."""

    def __init__(self, ros: Ros, ros_type: str, call: Callable[[Any, Attachment], None]) -> None:
        self._ros, self._type, self._call = ros, ros_type, call
        self._newest: dict[bytes, tuple[Attachment, zenoh.Sample]] = {}
        self._lock = threading.Lock()
        self._wake = on_loop(ros.loop, self._look)

    def take(self, sample: zenoh.Sample) -> None:
        """On a thread of Zenoh's."""
        try:
            said = attachment.read(attached(sample))
        except BadInput:
            self._ros.bad += 1
            return
        if too_large(sample.payload):
            self._ros.bad += 1
            return
        with self._lock:
            first = not self._newest
            if said.gid in self._newest or len(self._newest) < MOST_SPEAKERS:
                self._newest[said.gid] = said, sample
        if first:
            self._wake()

    def _look(self) -> None:
        with self._lock:
            found, self._newest = list(self._newest.values()), {}
        for said, sample in found:
            try:
                message = self._ros.types.decode(sample.payload.to_bytes(), self._type)
            except BadInput:
                self._ros.bad += 1
                continue
            try:
                self._call(message, said)
            except Exception:
                logger.exception("not taken: a message on %s", sample.key_expr)
