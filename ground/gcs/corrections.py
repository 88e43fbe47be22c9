"""Corrections that a station injects (GPS_RTCM_DATA, GPS_INJECT_DATA), as a source for the whole fleet.

A frame for each vehicle would cross every radio once for each of them. Here the station's fragments are put together,
and go on as ``zmav rtk`` sends its own: once, and only while no other source is in charge. A station that is limited to
some vehicles corrects all of them: what a base measured is true for everybody.
"""

from __future__ import annotations

import logging
from typing import NamedTuple

from ground.corrections import Publisher, may_publish
from ground.gcs.answerer import Answerer, Ground
from ground.gcs.client import Client
from ground.gcs.request_handlers import HandlersByClient, RequestHandlers
from zmav import wire
from zmav.mavlink import Frame, decode
from zmav.mavlink.rtcm import Joiner
from zmav.ratelimit import RateLimit

logger = logging.getLogger(__name__)
INJECT, RTCM = "GPS_INJECT_DATA", "GPS_RTCM_DATA"
MOST_SOURCES = 8
"""clients of one bridge that inject at a time"""
AGAIN_S, MOST_SAID = 30.0, 100
"""s for which the same words are not repeated to a client; words that are let through in that time"""


class _Source(NamedTuple):
    """One client's."""

    publisher: Publisher
    joiner: Joiner


class Corrections(Answerer):
    takes = frozenset({INJECT, RTCM})

    def __init__(self, ground: Ground, by_client: HandlersByClient) -> None:
        self._ground, self._by_client, self._dialect = ground, by_client, ground.dialect
        self._sources: dict[RequestHandlers, _Source] = {}
        self._may = may_publish(ground.z)
        self._said: RateLimit[tuple[RequestHandlers, str]] = RateLimit(AGAIN_S, MOST_SAID)
        by_client.forget.append(self._forget)

    def offer(self, client: Client, frame: Frame) -> bool:
        """Bounded as all that a client asks is: what is more than 4096 frames behind is left out."""
        if client.read_only or not self._may:
            return False  # it is refused as every frame of that client's is, or goes to each vehicle
        self._by_client.of(client).ask(self._take, frame)
        return True

    # On the event loop.

    def _take(self, handlers: RequestHandlers, frame: Frame) -> None:
        source = self._sources.get(handlers) or self._begin(handlers, frame)
        if source is None:
            return
        told = decode(frame, self._dialect)
        data = bytes(told["data"])
        if self._dialect.name_of(frame.msgid) == RTCM:
            data = source.joiner.add(told["flags"], told["len"], data)
        else:
            data = data[: told["len"]]
        source.publisher.feed(data)

    def _begin(self, handlers: RequestHandlers, frame: Frame) -> _Source | None:
        if len(self._sources) >= MOST_SOURCES:
            self._tell(handlers, frame, "warning", f"refused: {MOST_SOURCES} stations send some already")
            return None
        member = self._ground.z.member
        host = member.credentials.name if member is not None else "gcs"

        def say(line: str) -> None:
            self._tell(handlers, frame, "notice", line)
            logger.info("%s: corrections: %s", handlers.client.name, line)

        publisher = Publisher(self._ground.z, f"{host}/{frame.sysid}", say)
        publisher.__enter__()
        found = self._sources[handlers] = _Source(publisher, Joiner())
        return found

    def _tell(self, handlers: RequestHandlers, frame: Frame, severity: wire.Severity, text: str) -> None:
        """In the name of a vehicle that it sees, for stations show the words of vehicles alone; once a while."""
        seen = self._ground.vehicles(handlers.client, frame)
        if seen and self._said.take((handlers, text)) is not None:
            handlers.tell(seen[0][0], severity, f"zmav: your corrections: {text}")

    def _forget(self, handlers: RequestHandlers) -> None:
        source = self._sources.pop(handlers, None)
        if source is not None:
            source.publisher.__exit__()

    def close(self) -> None:
        for handlers in list(self._sources):
            self._forget(handlers)
