"""From the clients to the vehicles: who speaks, to whom, and what goes no further."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence

import zenoh

from ground.gcs.answerer import Answerer
from ground.gcs.client import Client
from ground.gcs.kinds import HEARTBEAT, Place
from ground.gcs.places import Hub
from ground.gcs.routes import Routes
from ground.gcs.streams import COMMANDS, Streams
from zmav import keys, wire
from zmav.autopilots.safety import makes_safe
from zmav.errors import Clash, NoSuchVehicle, ZmavError
from zmav.mavlink import Frame, decode, targets
from zmav.mavlink.results import CommandResult
from zmav.mavlink.signing import SETUP_SIGNING
from zmav.ratelimit import RateLimit

logger = logging.getLogger(__name__)
BEAT = 0.4
"""s within which a second HEARTBEAT of one component is the same beat, come by another way"""
AUTOPILOTS = (0, 1)
"""target components by which an autopilot is meant"""
MOST_SAID = 1000


class Uplink:
    """:meth:`said` runs on the endpoints' threads."""

    def __init__(self, bridge: Hub, routes: Routes, streams: Streams, answerers: Sequence[Answerer]) -> None:
        self._bridge, self._routes, self._streams, self._answerers = bridge, routes, streams, answerers
        self._dialect = bridge.z.dialect
        self.refused: Counter[str] = Counter()
        """frames of clients that went nowhere, by reason"""
        self.sent = 0
        self._beats: RateLimit[tuple[int, int, tuple[str, ...]]] = RateLimit(BEAT, MOST_SAID)
        """by system, component and the vehicles that are seen: of two stations with one id that see other vehicles each
        beats for its own"""
        self._once: RateLimit[tuple[object, ...]] = RateLimit(math.inf, MOST_SAID)

    def said(self, client: Client, frame: Frame) -> None:
        """A frame of a client. Never raises."""
        try:
            if self._may_speak(client, frame):
                self._take(client, frame)
        except (ZmavError, zenoh.ZError) as e:
            self._refuse(client, "error")
            self._say_once(("error", type(e).__name__), f"{client.name}: {e}")
        except Exception:
            self._refuse(client, "error")
            if self._once.take(("fault",)) is not None:
                logger.exception("%s: a frame of message %d; said once", client.name, frame.msgid)

    # Who speaks.

    def _may_speak(self, client: Client, frame: Frame) -> bool:
        place = frame.sysid, frame.compid
        if frame.sysid in self._routes.systems or not frame.sysid:
            names = ", ".join(known.name for known in self._routes.systems.get(frame.sysid, ())) or "everybody"
            text = f"refused: you speak as system {frame.sysid}, which is {names}: choose another id for the station"
            self._refuse(client, "id", text, frame.sysid)
            return False
        if frame.msgid == SETUP_SIGNING:
            text = "refused: SETUP_SIGNING holds a key, which does not travel: use 'zmav signing setup' on the vehicle"
            self._refuse(client, "signing", text)
            return False
        if place in client.ids:
            return True
        if not frame.verified:
            self._refuse(client, "id")  # garbage makes nobody known
            return False
        if not client.add_id(place):
            self._refuse(client, "ids", "refused: you speak as too many systems and components")
            return False
        self._bridge.identified(client)
        return True

    # What it wants.

    def _take(self, client: Client, frame: Frame) -> None:
        name = self._dialect.name_of(frame.msgid)
        system, component = targets(frame, self._dialect)
        wish = self._streams.wish_of(frame) if component in AUTOPILOTS else None
        if wish is not None:
            self._ask(client, frame, system, wish)
            return
        if any(name in answerer.takes and answerer.offer(client, frame) for answerer in self._answerers):
            return
        if client.read_only:
            if name in COMMANDS and component in AUTOPILOTS:
                self._bridge.ack(client, frame, CommandResult.DENIED)
            text = "" if name == HEARTBEAT else "read-only: what you send reaches no vehicle"
            self._refuse(client, "read-only", text, system, "notice")
            return
        if name == HEARTBEAT:
            if not client.kind_of_station:
                kind = decode(frame, self._dialect)["type"]
                named = self._dialect.enum_name("MAV_TYPE", kind) or f"type {kind}"
                client.kind_of_station = named.removeprefix("MAV_TYPE_")
                self._bridge.identified(client)
            if self._beats.take((frame.sysid, frame.compid, client.options.vehicles)) is None:
                return
        self.route(client, frame)

    def _ask(self, client: Client, frame: Frame, system: int, wish: Mapping[str, float]) -> None:
        """For messages at a rate; a command is answered."""
        try:
            place = self._routes.way_to(system, client.options.sees) if system else None
            if place is not None and not client.options.sees(place[1]):
                self._refuse(client, "target")
                return
            taken = bool(wish) and not client.read_only and self._streams.ask(client, wish, place)
        except (Clash, NoSuchVehicle) as e:
            self._not_routed(client, system, e)
            return
        if self._dialect.name_of(frame.msgid) in COMMANDS:
            self._bridge.ack(client, frame, CommandResult.ACCEPTED if taken else CommandResult.DENIED)

    # To whom.

    def route(self, client: Client, frame: Frame) -> None:
        """Send a frame to the vehicles it is for: the one of its target, or all."""
        system, component = targets(frame, self._dialect)
        name = self._dialect.name_of(frame.msgid)
        if not system:
            for place in self._routes.everybody(client.options.sees):
                self._put(place, 0, component, name, frame)
            return
        try:
            place = self._routes.way_to(system, client.options.sees)
        except (Clash, NoSuchVehicle) as e:
            if not (isinstance(e, Clash) and self._make_safe(client, system, component, name, frame)):
                self._not_routed(client, system, e)
            return
        if not client.options.sees(place[1]):
            self._refuse(client, "target")
            return
        client.addressed[place] = time.monotonic()
        self._put(place, system, component, name, frame)

    def _make_safe(self, client: Client, system: int, component: int, name: str, frame: Frame) -> bool:
        """Of two that claim to be the target each is landed, brought home or halted: nobody can tell who is meant.

        False: the frame does not make them safe, and went nowhere.
        """
        meant = [
            known
            for known in self._routes.systems.get(system, ())
            if client.options.sees(known.place[1]) and makes_safe(frame, self._dialect, known.autopilot)
        ]
        for known in meant:
            self._put(known.place, system, component, name, frame)
        return bool(meant)

    def _put(self, place: Place, system: int, component: int, name: str, frame: Frame) -> None:
        self._bridge.z.put(keys.TX, keys.TX.key(*place, sys=system, comp=component, msg=name), frame.data)
        self.sent += 1

    def _not_routed(self, client: Client, system: int, error: ZmavError) -> None:
        if isinstance(error, Clash):
            self._refuse(client, "clash")
            self._bridge.tell(client, system, "error", f"refused: {error}")
            self._say_once(("clash", system), f"refused for {client.name}: {error}")
        else:
            self._refuse(client, "target")
            self._say_once(("target", system), f"{client.name} speaks to system {system}: {error}")

    # Complaints.

    def _refuse(
        self, client: Client, reason: str, text: str = "", system: int = 0, severity: wire.Severity = "error"
    ) -> None:
        """Count it, and tell the client and the terminal, once."""
        client.counters.refused += 1
        self.refused[reason] += 1
        if text and text not in client.told and len(client.told) < MOST_SAID:
            client.told.add(text)
            self._bridge.tell(client, system, severity, text)
            self._bridge.news(f"{client.name}: {text}")

    def _say_once(self, about: tuple[object, ...], text: str) -> None:
        if self._once.take(about) is not None:
            self._bridge.news(text)
