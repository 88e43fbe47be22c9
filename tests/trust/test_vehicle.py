"""Orders and frames of strangers, of the wrong role and of yesterday, at a vehicle that has credentials."""

from __future__ import annotations

import asyncio
import datetime
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

import zmav
from tests.services.conftest import GUIDED, LAND
from tests.trust.conftest import Authority, StartGuarded
from zmav import keys, wire
from zmav.errors import BadConfig, BadInput, Forbidden, Refused
from zmav.mavlink import Packer
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings
from zmav.trust.certificate import Certificate
from zmav.trust.credentials import Credentials
from zmav.trust.gate import Origin
from zmav.trust.proof import MOST
from zmav.trust.verify import Allowance
from zmav.verbs import Verb

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.trust.conftest import Guarded


async def reason(asked: Any) -> str:
    with pytest.raises(Forbidden) as e:
        await asked
    return str(e.value.detail["reason"])


async def test_orders_that_are_not_proven(guarded: StartGuarded, tmp_path_factory: pytest.TempPathFactory) -> None:
    g: Guarded = await guarded()
    op, key = g.authority.member("op", "operator"), g.key(verb="arm")
    arm = json.dumps({"ready_timeout": 0}).encode()
    rogue = Authority(tmp_path_factory.mktemp("rogue")).member("op", "operator")
    quad2 = g.authority.member("quad2", "vehicle")
    for expected, proof in (
        ("unsigned", None),
        ("malformed", b"garbage"),
        ("malformed", bytes(100_000)),
        ("malformed", g.proof(op, key, arm) + bytes(MOST)),
        ("signature", g.proof(op, key, arm + b" ")),
        ("signature", g.proof(op, key.replace("quad1", "quad2"), arm)),
        ("clock", g.proof(op, key, arm, now=1.0)),
        ("unknown", g.proof(g.authority.member("op2", "operator"), key, arm, introduce=False)),
        ("stranger", g.proof(rogue, key, arm)),
        ("expired", g.proof(g.authority.strange("late", "operator", ends=-60.0), key, arm)),
        ("fleet", g.proof(g.authority.strange("foreign", "operator", fleet="other"), key, arm)),
        ("role", g.proof(quad2, key, arm)),
        ("role", g.proof(g.authority.member("eye", "viewer"), key, arm)),
        ("epoch", g.proof(op, key, arm, answers=bytes(8))),
        ("clock", g.proof(op, key, arm, now=4e9)),  # the last: it voids all others
    ):
        assert await reason(g.ask(proof, arm, key)) == expected
        await g.b.event("refused: ", kind="refused", detail={"reason": expected})
    assert (g.b.peer.armed, g.b.peer.commands(400)) == (False, [])
    proof = g.proof(op, key, arm)
    assert (await g.ask(proof, arm, key)).status == "done"
    assert g.b.peer.armed
    assert await reason(g.ask(proof, arm, key)) == "replayed"
    held_back = g.proof(op, key, b"{}", now=time.time() - 10.0)  # by who relays
    await g.ask(g.proof(op, g.key(verb="disarm"), b"{}", now=time.time() - 9.0), b"{}", g.key(verb="disarm"))
    with pytest.raises(Refused, match="arm was given before the last order of op"):
        await g.ask(held_back, b"{}", key)
    assert not g.b.peer.armed
    state = await g.b.state(lambda s: s["forbidden"].get("replayed") == 1, "its counts")
    assert (state["forbidden"]["malformed"], state["forbidden"]["role"]) == (3, 2)
    assert state["gate"] == g.vehicle.gate.epoch.hex()
    # Another member who has overheard an order's id does not read its outcome under it.
    ping = b'{"id": "overheard"}'
    await g.ask(g.proof(op, g.key(), ping), ping)
    with pytest.raises(BadInput, match="was used for another order"):
        await g.ask(g.proof(g.authority.member("eye2", "viewer"), g.key(), ping), ping)
    for _ in range(20):
        await reason(g.ask(None))
    said = [e for e in g.b.events.objects() if e["detail"].get("reason") == "unsigned"]
    assert 1 <= len(said) < 20
    assert "open the session with --credentials" in said[0]["text"]
    assert sum(1 + e["detail"].get("left_out", 0) for e in said) <= 21


async def test_what_makes_safe_and_waited_does_not_undo_what_was_ordered_since(guarded: StartGuarded) -> None:
    """A hold to the whole fleet that does not reach this vehicle is sent again, and signed again, while it lands."""
    g: Guarded = await guarded()
    await g.b.connected()
    g.b.peer.armed, g.b.peer.mode = True, GUIDED
    await g.b.state(lambda s: s["armed"] and s["mode"] == "GUIDED", "armed")
    op, boss, now = g.authority.member("op", "operator"), g.authority.member("boss", "operator"), time.time()

    async def give(verb: str, given: float, by: Any = op) -> None:
        payload, key = json.dumps({"given": given, "id": f"{verb} {given}", "wait": 0.0}).encode(), g.key(verb=verb)
        await g.ask(g.proof(by, key, payload), payload, key)

    await give("land", now - 2.0)
    await g.b.peer.until(lambda: g.b.peer.mode == LAND, "LAND")
    with pytest.raises(Refused, match="hold was given before the last order of op that makes it safe"):
        await give("hold", now - 5.0)
    assert g.b.peer.mode == LAND
    await give("hold", now - 1.0)  # a later word of his, whatever took it so long
    await g.b.peer.until(lambda: g.b.peer.mode == GUIDED, "GUIDED")
    await give("land", now - 9.0, boss)  # another's, which nobody can order by time
    await g.b.peer.until(lambda: g.b.peer.mode == LAND, "LAND")


async def test_what_moves_and_waited_is_not_flown_after_what_makes_safe(guarded: StartGuarded) -> None:
    """It is signed again each time it is sent again; a refused disarm and clocks that are set keep no landing back."""
    g: Guarded = await guarded()
    await g.b.connected()
    g.b.peer.armed, g.b.peer.mode = True, GUIDED
    await g.b.state(lambda s: s["armed"] and s["mode"] == "GUIDED", "armed")
    op, now = g.authority.member("op", "operator"), time.time()

    async def give(verb: str, given: float, **more: Any) -> None:
        payload = json.dumps({"given": given, "id": f"{verb} {given}", "wait": 1.0, **more}).encode()
        await g.ask(g.proof(op, g.key(verb=verb), payload), payload, g.key(verb=verb))

    await give("hold", now - 1.0)
    with pytest.raises(Refused, match="set_mode was given before the last order of op that makes it safe: overtaken"):
        await give("set_mode", now - 5.0, mode="LOITER")
    await give("set_mode", now - 0.5, mode="LOITER")
    g.b.peer.results[400] = [4]
    with pytest.raises(Refused):
        await give("disarm", now - 0.2)
    await give("land", now - 0.4)
    await g.b.peer.until(lambda: g.b.peer.mode == LAND, "LAND")
    await give("hold", now - 3600.0)  # its giver's clock was set ahead meanwhile
    await g.b.peer.until(lambda: g.b.peer.mode == GUIDED, "GUIDED")


def test_a_certificate_of_the_year_0_is_none() -> None:
    """Such a date is a ValueError where it is read, and would have cost the orders behind it."""
    key, then = Ed25519PrivateKey.generate(), datetime.datetime(2051, 1, 1)
    name = x509.Name(
        [
            x509.NameAttribute(oid, text)
            for oid, text in (
                (NameOID.COMMON_NAME, "op"),
                (NameOID.ORGANIZATION_NAME, "demo"),
                (NameOID.ORGANIZATIONAL_UNIT_NAME, "operator"),
            )
        ]
    )
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    builder = builder.serial_number(5).not_valid_before(then).not_valid_after(datetime.datetime(2052, 1, 1))
    der = builder.sign(key, None).public_bytes(Encoding.DER)
    Certificate.read(der)
    with pytest.raises(BadConfig, match="not a certificate"):
        Certificate.read(der.replace(b"20510101000000Z", b"00000101000000Z"))


async def test_an_order_says_when_it_was_given_first(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    before, told = time.time(), list[wire.Order]()
    allow = g.vehicle.authority.allow

    def heard(verb: Verb, args: wire.Order, origin: Origin | None = None) -> None:
        told.append(args)
        allow(verb, args, origin)

    g.vehicle.authority.allow = heard  # type: ignore[method-assign]
    async with g.client("op", "operator") as z:
        await z.vehicle("quad1").hold()
    assert before <= told[-1].given <= time.time()


async def test_a_client_with_credentials_does_not_notice(guarded: StartGuarded, onboard: StartOnboard) -> None:
    """Not even that the vehicle's agent is started again, which makes every earlier proof worthless."""
    g: Guarded = await guarded()
    async with g.client("op", "operator") as z:
        vehicle = z.vehicle("quad1")
        await vehicle.arm(ready_timeout=0)
        assert g.b.peer.armed
        recorded = g.proof(z.member.credentials, g.key(), b"{}")  # type: ignore[union-attr]
        session = g.vehicle.adapter.session
        await onboard.close(g.vehicle)
        again = await onboard(session, g.b.peer.url, "quad1", **g.settings)
        await g.b.state(lambda s: s["gate"] == again.gate.epoch.hex() and s["connected"], "the new start's state")  # type: ignore[union-attr]
        assert await reason(g.ask(recorded)) == "epoch"
        assert z.member is not None
        z.member._gates.clear()  # as if its first state had not come yet
        assert await vehicle.ping() > 0.0
        z.member._gates.clear()
        await vehicle.set_mode("LOITER")
        gate = again.gate
        assert gate is not None
        gate.utc, before = lambda: time.time() - 10.0, gate.epoch  # nor that the vehicle's clock is set back
        assert await vehicle.ping() > 0.0
        assert gate.epoch != before
    assert g.b.peer.mode == 5


async def test_who_flies_and_who_configures(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    async with g.client("swap", "planner") as z:
        vehicle = z.vehicle("quad1")
        await vehicle.set_mode("GUIDED")
        for order in (
            vehicle.params.set("ARMING_CHECK", 0),
            vehicle.reboot(),
            vehicle.revoke(),
            vehicle.files.remove("/a"),
            vehicle.command("PREFLIGHT_REBOOT_SHUTDOWN"),
        ):
            assert await reason(order) == "role"
    async with g.client("eye", "viewer") as z:
        vehicle = z.vehicle("quad1")
        await vehicle.ping()
        for refused in (vehicle.hold(), vehicle.land(), vehicle.disarm(), vehicle.params.refresh()):
            assert await reason(refused) == "role"
        with pytest.raises(Forbidden):
            async with vehicle.lease("eye"):
                pass
    async with g.client("quad1", "vehicle") as z:  # the vehicle's own programs
        await z.vehicle("quad1").set_mode("STABILIZE")
        assert await reason(z.vehicle("quad1").reboot()) == "role"
    async with g.client("quad2", "vehicle") as z:
        assert await reason(z.vehicle("quad1").set_mode("GUIDED")) == "role"
    assert (g.b.peer.mode, g.b.peer.commands(246)) == (0, [])


async def test_raw_frames_are_the_operators(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    frame = Packer(g.b.peer.dialect, 255, 190).pack("COMMAND_LONG", command=400, param1=1.0, target_system=1)
    key = g.key(keys.TX, sys=1, comp=0, msg="COMMAND_LONG")
    op = g.authority.member("op", "operator")
    first = g.proof(op, key, frame)

    def put(attachment: bytes | None) -> None:
        g.b.ground.session.put(key, frame, attachment=attachment, congestion_control=zenoh.CongestionControl.BLOCK)

    put(None)
    put(first[:-1])
    put(g.proof(g.authority.member("swap", "planner"), key, frame))
    await g.b.state(lambda s: s["forbidden"] == {"unsigned": 1, "malformed": 1, "role": 1}, "three refusals")
    assert g.b.peer.commands(400) == []
    put(first)
    put(first)
    await g.b.state(lambda s: s["forbidden"].get("replayed") == 1, "a refused replay")
    assert len(g.b.peer.commands(400)) == 1
    put(g.proof(op, key, frame, introduce=False))
    await g.b.peer.until(lambda: len(g.b.peer.commands(400)) == 2, "the next")


async def test_a_clients_frames(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    frame = Packer(g.b.peer.dialect, 255, 190).pack("COMMAND_LONG", command=400, param1=1.0, target_system=1)
    key = g.key(keys.TX, sys=1, comp=0, msg="COMMAND_LONG")
    async with g.client("op", "operator") as z:
        for _ in range(3):
            z.put(keys.TX, key, frame)
        await g.b.peer.until(lambda: len(g.b.peer.commands(400)) == 3, "three frames")


async def test_a_flood_of_forgeries_leaves_it_flying(guarded: StartGuarded) -> None:
    """Its stream goes on, and another operator is heard."""
    g: Guarded = await guarded()
    op, other = g.authority.member("op", "operator"), g.authority.member("op2", "operator")
    g.vehicle.gate.learn(op.certificate.der)  # type: ignore[union-attr]
    key = g.key(keys.TX, sys=1, comp=0, msg="COMMAND_LONG")
    forged = g.proof(op, g.key(verb="land"), b"")
    block: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.BLOCK}
    async with g.client("pilot", "planner") as z:
        await g.b.flying()
        async with z.vehicle("quad1").lease("pilot") as lease:

            def flood() -> None:
                for _ in range(500):
                    g.b.ground.session.put(key, b"", attachment=forged, **block)

            flooding = asyncio.create_task(asyncio.to_thread(flood))
            flown = g.vehicle.setpoints.counts
            while not flooding.done() or flown["flown"] < 3:
                lease.setpoint(vel=(1.0, 0.0, 0.0))
                await asyncio.sleep(0.02)
            await flooding
            await g.b.state(lambda s: s["forbidden"].get("signature", 0) > 0, "refused forgeries")
            assert (await g.ask(g.proof(other, g.key(), b"{}"))).status == "done"


async def test_a_member_in_whose_name_more_is_forged_than_is_looked_at_is_heard(guarded: StartGuarded) -> None:
    """Its orders and frames, each at the first attempt."""
    g: Guarded = await guarded()
    frame = Packer(g.b.peer.dialect, 255, 190).pack("COMMAND_LONG", command=400, param1=1.0, target_system=1)
    async with g.client("op", "operator") as z:
        await g.b.flying()
        gate, op = g.vehicle.gate, Credentials.load(g.authority.folder / "op").certificate
        assert gate is not None
        gate._forgeries[gate.learn(op.der).fingerprint, False] = Allowance(0.0, time.monotonic)  # at any time
        await z.vehicle("quad1").hold()
        z.put(keys.TX, g.key(keys.TX, sys=1, comp=0, msg="COMMAND_LONG"), frame)
        await g.b.peer.until(lambda: len(g.b.peer.commands(400)) == 1, "the frame")
        assert gate.counts["busy"] == 0


@pytest.mark.parametrize(
    ("name", "role", "fleet", "words"),
    [
        ("quad2", "vehicle", "demo", "the name 'quad2'; expected 'quad1'"),
        ("quad1", "operator", "demo", "the role 'operator'; expected 'vehicle'"),
        ("quad1", "vehicle", "other", "the fleet 'other'; expected 'demo'"),
    ],
)
def test_credentials_of_somebody_else(net: Net, tmp_path: Path, name: str, role: str, fleet: str, words: str) -> None:
    folder, (session, _) = Authority(tmp_path, fleet).issue(name, role), net.router()
    with pytest.raises(BadConfig, match=words):
        Onboard(session, OnboardSettings(link="udpin:127.0.0.1:0", name="quad1", credentials=str(folder)))


async def test_a_client_of_another_fleet_is_told_so(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    settings = SessionSettings(connect=[g.b.endpoint], credentials=str(g.authority.issue("op", "operator")))
    with pytest.raises(BadConfig, match="say --fleet demo, not other"):
        async with zmav.open(fleet="other", settings=settings):
            pass
