"""A group's gateway: the group's own network on one side, the network of gateways (the trunk) on the other.

Towards the trunk, once a second, it says what its vehicles do in short (``@group/{group}/states``). Everything else of
a vehicle crosses only when somebody names that vehicle:

- a query (an order, a parameter, a mission, its state) goes in and its answers come out; one with a wildcard where the
  vehicle's name stands stops here, for it would reach every vehicle of every group;
- setpoints and frames put for it go in;
- its messages, its state (``want/state``) and its events (``want/event``) come out while a reader's ``want`` token says
  so, and that token is shown to the vehicle, as is the token of a lease's holder.

Keys and proofs of origin pass as they are: the vehicle judges who spoke, not who carried it.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import Any

import zenoh

from tests.bench.scale.group import GROUP
from tests.bench.scale.shorten import parts, shorten
from zmav import keys, wire
from zmav.errors import BadConfig, BadInput, BadKey
from zmav.waiting import on_loop

PERIOD = 1.0
FORGET = 30.0
"""s after which a vehicle that is not heard is left out"""
ASK_TIMEOUT = 10.0
"""s a query may take inside the group"""
MOST_MIRRORED = 4096
"""tokens of the trunk that are shown inside the group at most"""


class Gateway:
    """``async with Gateway(inside, trunk, fleet, group)``: both sessions stay the caller's. Lives on the event loop.

    Raises :class:`BadConfig` where both lead to one router: what goes out would come in again, for ever.
    """

    def __init__(self, inside: zenoh.Session, trunk: zenoh.Session, fleet: str, group: str) -> None:
        sides = [{each.info.zid(), *each.info.routers_zid()} for each in (inside, trunk)]
        if sides[0] & sides[1]:
            text = "a gateway stands between two networks that are not linked otherwise; these share a router"
            raise BadConfig(text, field="trunk", value=[str(zid) for zid in sides[0] & sides[1]])
        self._inside, self._trunk, self._fleet, self._group = inside, trunk, fleet, keys.check_name(group, "group")
        self._heard: dict[str, tuple[wire.VehicleState, float]] = {}
        self._doors: dict[str, list[Any]] = {}
        self._flows: dict[tuple[str, str], Any] = {}
        self._mirrored: dict[str, tuple[str, Any]] = {}
        self._waiting: dict[str, str] = {}
        self._held: list[Any] = []
        self._teller: asyncio.Task[None] | None = None
        self.refused = 0
        """queries with a wildcard for the vehicle's name"""
        self.bad = 0
        """states that cannot be read, or are of another vehicle"""

    async def __aenter__(self) -> Gateway:
        loop, key = asyncio.get_running_loop(), GROUP.key(self._fleet, group=self._group)
        self._publisher = self._trunk.declare_publisher(key, **GROUP.publishing())
        take = self._inside.declare_subscriber
        tokens = self._trunk.liveliness().declare_subscriber
        want = keys.WANT.key(self._fleet, "*", msg="*", hz="*", instance="*")
        holder = keys.HOLDER.key(self._fleet, "*", holder="*", instance="*")
        self._held = [
            self._publisher,
            take(keys.STATE.key(self._fleet, "*"), on_loop(loop, self._on_state)),
            tokens(want, on_loop(loop, self._on_token), history=True),
            tokens(holder, on_loop(loop, self._on_token), history=True),
        ]
        self._teller = loop.create_task(self._tell())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._teller:
            self._teller.cancel()
        for each in (*self._held, *self._flows.values()):
            each.undeclare()
        self._flows.clear()
        for name in list(self._doors):
            self._shut(name)

    @property
    def doors(self) -> int:
        """Vehicles that the trunk can ask."""
        return len(self._doors)

    # What the group says.

    def _on_state(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).split("/")[2]
        try:
            state = wire.decode(sample.payload.to_bytes(), wire.VehicleState, f"state of {name}")
        except BadInput:
            self.bad += 1
            return
        if state.name != name or not keys.NAME.match(name):
            self.bad += 1
            return
        self._heard[name] = (state, time.monotonic())
        if name not in self._doors:
            self._open(name)

    async def _tell(self) -> None:
        while True:
            now = time.monotonic()
            for name in [name for name, (_, at) in self._heard.items() if now - at > FORGET]:
                del self._heard[name]
                self._shut(name)
            members = [shorten(state, now - at) for state, at in self._heard.values()]
            for part in parts(self._group, time.time(), members):
                self._publisher.put(part)
            await asyncio.sleep(PERIOD)

    # What is asked for by a vehicle's name.

    def _open(self, name: str) -> None:
        """The trunk may ask this vehicle and put to it."""
        below = f"{keys.ROOT}/{self._fleet}/{name}"
        self._doors[name] = [
            self._trunk.declare_queryable(f"{below}/**", self._on_query),
            *(
                self._trunk.declare_subscriber(key, self._put_inside)
                for key in (
                    keys.SETPOINT.key(self._fleet, name, agent="*"),
                    keys.TX.key(self._fleet, name, sys="*", comp="*", msg="*"),
                )
            ),
        ]
        for key in [key for key, vehicle in self._waiting.items() if vehicle == name]:
            del self._waiting[key]
            self._show(key, name)

    def _shut(self, name: str) -> None:
        for door in self._doors.pop(name, []):
            door.undeclare()
        for key in [key for key, (vehicle, _) in self._mirrored.items() if vehicle == name]:
            self._hide(key)
            self._waiting[key] = name

    def _on_query(self, query: zenoh.Query) -> None:
        """On Zenoh's thread: the query waits inside as long as somebody answers it."""
        asked = str(query.key_expr)
        vehicle = asked.split("/")[2] if asked.count("/") > 2 else "*"
        if not keys.NAME.match(vehicle):
            self.refused += 1
            query.drop()
            return

        def on_reply(reply: zenoh.Reply) -> None:
            with contextlib.suppress(zenoh.ZError):  # the asker has gone
                if reply.ok is not None:
                    query.reply(
                        reply.ok.key_expr, reply.ok.payload, encoding=reply.ok.encoding, attachment=reply.ok.attachment
                    )
                elif reply.err is not None:
                    query.reply_err(reply.err.payload, encoding=reply.err.encoding)

        handler: Any = zenoh.handlers.Callback(on_reply, query.drop, indirect=False)
        self._inside.get(
            query.selector,
            handler,
            payload=query.payload,
            encoding=query.encoding,
            attachment=query.attachment,
            timeout=ASK_TIMEOUT,
            consolidation=zenoh.ConsolidationMode.NONE,
            **keys.DO.qos.options(),
        )

    def _put_inside(self, sample: zenoh.Sample) -> None:
        _pass(self._inside, sample)

    # What somebody wants to read.

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        vehicle = key.split("/")[2]
        if sample.kind != zenoh.SampleKind.PUT:
            self._waiting.pop(key, None)
            self._hide(key)
        elif len(self._mirrored) + len(self._waiting) < MOST_MIRRORED:
            if vehicle in self._doors:
                self._show(key, vehicle)
            else:
                self._waiting[key] = vehicle

    def _show(self, key: str, vehicle: str) -> None:
        """Show a token of the trunk inside, and let out what it wants."""
        if key in self._mirrored:
            return
        wanted = self._wanted(key)
        ours = wanted is not None and "/mav/rx/" not in wanted  # the vehicle knows tokens of its messages only
        self._mirrored[key] = (vehicle, None if ours else self._inside.liveliness().declare_token(key))
        if wanted and (vehicle, wanted) not in self._flows:
            self._flows[vehicle, wanted] = self._inside.declare_subscriber(wanted, self._put_outside)

    def _hide(self, key: str) -> None:
        if key not in self._mirrored:
            return
        vehicle, token = self._mirrored.pop(key)
        if token is not None:
            token.undeclare()
        wanted = self._wanted(key)
        if wanted and not any(v == vehicle and self._wanted(k) == wanted for k, (v, _) in self._mirrored.items()):
            flow = self._flows.pop((vehicle, wanted), None)
            if flow is not None:
                flow.undeclare()

    def _wanted(self, key: str) -> str | None:
        """The key that a ``want`` token asks for; None: another token."""
        try:
            channel, named = keys.match(key)
            if channel is not keys.WANT:
                return None
            vehicle, msg = named["vehicle"], keys.check_message(named["msg"])
        except BadKey:
            return None
        if msg in ("state", "event"):
            return {"state": keys.STATE, "event": keys.EVENT}[msg].key(self._fleet, vehicle)
        return keys.RX.key(self._fleet, vehicle, sys="*", comp="*", msg=msg)

    def _put_outside(self, sample: zenoh.Sample) -> None:
        _pass(self._trunk, sample)


def _pass(session: zenoh.Session, sample: zenoh.Sample) -> None:
    """The same key, bytes, proof and class of service on the other side; never a put that blocks."""
    with contextlib.suppress(zenoh.ZError):  # that side is closing
        session.put(
            sample.key_expr,
            sample.payload,
            encoding=sample.encoding,
            attachment=sample.attachment,
            priority=sample.priority,
            congestion_control=zenoh.CongestionControl.DROP,
        )
