"""A relay that was taken over: its owner has the host's certificate and no access rules. Run in its host by test_rogue.

    python rogue.py FLEET_FILE HOST VICTIM [drop]

It carries the fleet's traffic as a router does, and lies: it answers the victim's orders, brings its states and events
forged, sends every order that it overhears at once and all before it again, and with ``drop`` lets no order through.
A line for each order.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import os
import queue
import sys
import threading
from collections.abc import AsyncIterator

import msgspec
import zenoh

from mesh.cli.options import plan_host
from mesh.plan import RouterPlan, Setting
from mesh.router import PARTS, Router
from zmav import keys, wire
from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials
from zmav.trust.proof import Signer, challenge

LIE = wire.encode(wire.Outcome(verb="land", status="done", took=0.1, result={"mode": "LIE"}))
FALSE_ALT = 4321.0


class Lies:
    """What the rogue does beside routing. Zenoh calls it on threads of its own."""

    def __init__(self, session: zenoh.Session, plan: RouterPlan, victim: str) -> None:
        assert plan.credentials is not None
        self._session, self._signer, self._seen = session, Signer(plan.credentials), set[bytes]()
        self._orders: queue.Queue[tuple[str, bytes, bytes]] = queue.Queue()
        every = keys.DO.key(plan.fleet, victim, verb="*")
        self._kept = [
            session.declare_queryable(every, self._answer, complete=True),
            session.declare_subscriber(keys.STATE.key(plan.fleet, victim), self._forge),
            session.declare_subscriber(keys.EVENT.key(plan.fleet, victim), self._forge),
        ]
        threading.Thread(target=self._send_again, daemon=True).start()

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            key, payload = str(query.key_expr), query.payload.to_bytes() if query.payload else b""
            proof = query.attachment.to_bytes() if query.attachment else b""
            mine = self._signer.answer(key, LIE, challenge(proof) or bytes(8), introduce=True)
            query.reply(key, LIE, encoding=keys.JSON, attachment=mine)
            if len(proof) > 8 and proof not in self._seen:
                self._seen.add(proof)
                self._orders.put((key, payload, proof))

    def _send_again(self) -> None:
        orders: list[tuple[str, bytes, bytes]] = []
        while True:
            orders.insert(0, self._orders.get())
            said = [
                (reply.ok or reply.err).payload.to_string()  # type: ignore[union-attr]  # one of the two is there
                for key, payload, proof in orders
                for reply in self._session.get(
                    key,
                    payload=payload,
                    attachment=proof,
                    timeout=3.0,
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                )
            ]
            print(msgspec.json.encode(said).decode(), flush=True)

    def _forge(self, sample: zenoh.Sample) -> None:
        """The same with another altitude, under the proof of the true one and under the rogue's own."""
        try:
            told = msgspec.json.decode(sample.payload.to_bytes())
        except msgspec.DecodeError:
            return
        if told.get("text") == "forged" or (told.get("position") or {}).get("alt_amsl") == FALSE_ALT:
            return
        key = str(sample.key_expr)
        if key.endswith("/state"):
            told["position"] = {"lat_deg": 0.0, "lon_deg": 0.0, "alt_rel": 0.0, "alt_amsl": FALSE_ALT}
        else:
            told["text"] = "forged"
        payload = msgspec.json.encode(told)
        for proof in (sample.attachment, self._signer.sign(key, payload, introduce=True)):
            self._session.put(key, payload, encoding=keys.JSON, attachment=proof)


async def lie(fleet_file: str, host: str, victim: str, drop: bool) -> None:
    @contextlib.asynccontextmanager
    async def beside(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[Lies]:
        yield Lies(session, plan, victim)

    folder = os.environ["ZMAV_CREDENTIALS"]
    order = keys.DO.key(Credentials.load(folder).fleet, victim, verb="*")
    orders = {"id": "drop", "permission": "deny", "flows": ["egress"], "messages": ["query"], "key_exprs": [order]}
    policies = [{"rules": ["drop"], "subjects": ["all"]}]
    dropping = {"enabled": True, "default_permission": "allow", "rules": [orders], "subjects": [{"id": "all"}]}
    rules = {**dropping, "policies": policies} if drop else {"enabled": False}
    settings = SessionSettings(credentials=folder)
    plan = plan_host(fleet_file, host, settings, vehicle=True)
    plan = dataclasses.replace(plan, settings={**plan.settings, "access_control": Setting(rules, "the rogue")})
    async with Router(plan, settings, (*PARTS, beside)):
        print("routing", flush=True)
        await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(lie(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:] == ["drop"]))
