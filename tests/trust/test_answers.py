"""Somebody else answers in a vehicle's place: the order arrives all the same, and only the vehicle's word counts."""

from __future__ import annotations

import asyncio
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
import zenoh

from tests.conftest import PATIENCE_S
from tests.trust.conftest import StartGuarded
from zmav import keys, wire
from zmav.errors import Forbidden, TimedOut, ZmavError
from zmav.services.queries.proven import proof_of_error
from zmav.trust.credentials import Credentials
from zmav.trust.proof import Signer, challenge
from zmav.trust.verify import Allowance

if TYPE_CHECKING:
    from tests.trust.conftest import Guarded
    from zmav.client import Client

DONE = wire.encode(wire.Outcome(verb="land", status="done", took=0.1, result={"mode": "LIE"}))
Answer = Callable[[zenoh.Query], None]


@contextmanager
def diverting(g: Guarded, z: Client, key: str, answer: Answer) -> Iterator[threading.Event]:
    """A program on the same host that declares itself complete for what the vehicle answers; set when it was asked.

    ``z`` knows of it: what it asks from now on comes here, too.
    """
    asked = threading.Event()

    def on_query(query: zenoh.Query) -> None:
        with query:
            answer(query)
        asked.set()

    session, probe = g.b.ground.session, f"probe/{uuid.uuid4()}"
    queryable = session.declare_queryable(key, zenoh.handlers.Callback(on_query), complete=True)
    behind = session.declare_queryable(probe, lambda query: query.reply(probe, b""))  # it is declared after the other
    try:
        while not [reply for reply in z.session.get(probe, timeout=PATIENCE_S) if reply.ok is not None]:
            pass
        yield asked
    finally:
        behind.undeclare()
        queryable.undeclare()


def lies(payload: bytes, sign: Callable[[zenoh.Query], bytes | None] = lambda query: None) -> Answer:
    return lambda query: query.reply(str(query.key_expr), payload, encoding=keys.JSON, attachment=sign(query))


async def test_an_order_arrives_and_the_vehicle_alone_says_how_it_ended(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    quad2, op = g.authority.member("quad2", "vehicle"), g.authority.member("op", "operator")
    recorded: list[tuple[bytes, bytes]] = []
    refusal = wire.error_body(Forbidden("sign it for me", reason="epoch", gate=bytes(8).hex()))

    def by(signer: Signer, answers: Callable[[zenoh.Query], bytes]) -> Callable[[zenoh.Query], bytes | None]:
        return lambda query: signer.answer(str(query.key_expr), DONE, answers(query))

    def asked(query: zenoh.Query) -> bytes:
        found = challenge(query.attachment.to_bytes() if query.attachment else None)
        assert found is not None
        return found

    def again(query: zenoh.Query) -> None:
        """What the vehicle once signed, for another order."""
        payload, proof = recorded[0]
        query.reply(str(query.key_expr), payload, encoding=keys.JSON, attachment=proof)

    async with g.client("alice", "operator") as z:
        assert z.member is not None
        vehicle, mode, expected = z.vehicle("quad1"), g.key(verb="set_mode"), 0
        own = z.member.question(mode, b'{"mode": "GUIDED"}')
        for reply in await asyncio.to_thread(
            lambda: list(z.session.get(mode, payload=b'{"mode": "GUIDED"}', attachment=own, timeout=20.0))
        ):
            assert reply.ok is not None
            assert reply.ok.attachment is not None
            recorded.append((reply.ok.payload.to_bytes(), reply.ok.attachment.to_bytes()))
        for reason, answer in (
            ("unsigned", lies(DONE)),
            ("malformed", lies(DONE, lambda query: b"rubbish")),
            ("name", lies(DONE, by(Signer(quad2), asked))),
            ("name", lies(DONE, by(Signer(op), asked))),
            ("replayed", lies(DONE, by(Signer(quad2), lambda query: bytes(8)))),
            ("replayed", again),
            ("unsigned", lambda query: query.reply_err(refusal)),
        ):
            before = z.member.counts[f"answer {reason}"]
            expected = 5 - expected  # LOITER and STABILIZE in turn
            with diverting(g, z, keys.DO.key("demo", "quad1", verb="*"), answer) as seen:
                await vehicle.set_mode("LOITER" if expected else "STABILIZE")
                assert g.b.peer.mode == expected
                assert await asyncio.to_thread(seen.wait, PATIENCE_S)
                while z.member.counts[f"answer {reason}"] == before:
                    await asyncio.sleep(0.01)


async def test_who_answers_alone_is_not_believed(guarded: StartGuarded) -> None:
    """The vehicle is cut off: the operator is told that nothing is known, and not 'done'."""
    g: Guarded = await guarded()
    async with g.client("alice", "operator") as z:
        vehicle = z.vehicle("quad1")
        vehicle.give_up, vehicle.ask_again = 1.0, 0.5
        await g.vehicle.orders.close()
        with diverting(g, z, keys.DO.key("demo", "quad1", verb="*"), lies(DONE)), pytest.raises(TimedOut) as e:
            await vehicle.land()
        assert "not believed: unsigned" in str(e.value)


async def test_a_refusal_is_the_vehicles_own(guarded: StartGuarded) -> None:
    """Also where the vehicle's proof goes another way, as Zenoh gives errors no attachment."""
    g: Guarded = await guarded()
    async with g.client("eye", "viewer") as z:
        with pytest.raises(Forbidden) as e:
            await z.vehicle("quad1").land()
        assert e.value.detail["reason"] == "role"
        (reply,) = await asyncio.to_thread(
            lambda: list(z.session.get(g.key(verb="land"), payload=b"{}", attachment=bytes(8), timeout=20.0))
        )
        assert reply.err is not None
        body = reply.err.payload.to_bytes()
        proof = proof_of_error(reply.err, wire.error_from(body))
        assert z.member is not None
        z.member.believe(g.key(verb="land"), body, proof, bytes(8))
        with pytest.raises(Forbidden):
            z.member.believe(g.key(verb="land"), body + b" ", proof, bytes(8))


async def test_parameters_and_missions_are_the_vehicles(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    lie = b'{"lie": true}'
    async with g.client("alice", "operator") as z:
        for channel, key in (
            (keys.PARAMS, g.key(keys.PARAMS)),
            (keys.MISSION, g.key(keys.MISSION, kind="fence")),
        ):
            with diverting(g, z, key, lies(lie)) as asked:
                (answer,) = await z.ask(key, timeout=20.0, channel=channel)
                assert await asyncio.to_thread(asked.wait, PATIENCE_S)
            assert isinstance(answer, ZmavError) or answer.payload != lie


async def test_more_forged_answers_than_are_looked_at_shut_none_of_the_vehicles_out(guarded: StartGuarded) -> None:
    """Neither an outcome nor a refusal."""
    g: Guarded = await guarded()
    async with g.client("alice", "operator") as z:
        assert z.member is not None
        vehicle, own = z.vehicle("quad1"), Credentials.load(g.authority.folder / "quad1").certificate
        await vehicle.ping()
        z.member.verifier._forgeries[own.fingerprint, False] = Allowance(0.0, time.monotonic)  # at any time
        await vehicle.set_mode("LOITER")
        assert g.b.peer.mode == 5
        with pytest.raises(ZmavError, match="no order 'dance'"):
            await vehicle.order("dance", wire.Order())
