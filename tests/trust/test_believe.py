"""What a member believes of vehicles, and which namesake a vehicle takes for one."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zenoh

from tests.trust.conftest import Authority, StartGuarded
from zmav import keys, wire
from zmav.client import STRANGERS
from zmav.errors import Clash, Forbidden
from zmav.tokens import OF_EACH
from zmav.trust.credentials import Credentials
from zmav.trust.member import ROSTERS, Member
from zmav.trust.proof import Signer, read

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.services.conftest import StartPeer
    from tests.trust.conftest import Guarded
    from zmav.client import Client

BLOCK: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.BLOCK}
STATE, EVENT = keys.STATE.key("demo", "quad1"), keys.EVENT.key("demo", "quad1")


async def refused(z: Client, reason: str, count: int = 1) -> None:
    """Wait until the client has left out so many for that reason."""
    assert z.member is not None
    while z.member.counts[reason] < count:
        await asyncio.sleep(0.01)
    assert z.member.counts[reason] == count


async def test_a_state_is_its_vehicles_or_nobodys(
    guarded: StartGuarded, tmp_path_factory: pytest.TempPathFactory
) -> None:
    g: Guarded = await guarded()
    async with g.client("eye", "viewer") as z:
        assert z.member is not None
        quad2, op = g.authority.member("quad2", "vehicle"), g.authority.member("quad1", "operator", folder="op")
        rogue = Authority(tmp_path_factory.mktemp("rogue")).member("quad1", "vehicle")
        lie = msgspec.structs.replace(z.vehicle("quad1").state, mode="LIE")
        data = wire.encode(lie)

        def put(attachment: bytes | None, payload: bytes = data) -> None:
            g.b.ground.session.put(STATE, payload, attachment=attachment, **BLOCK)

        for member in (quad2, op):
            z.member.verifier.learn(member.certificate.der)
        put(None)
        await refused(z, "unsigned")
        put(b"rubbish")
        await refused(z, "malformed")
        put(Signer(quad2).sign(STATE, data))
        await refused(z, "name")
        put(Signer(op).sign(STATE, data))
        await refused(z, "name", 2)
        put(Signer(rogue).sign(STATE, data, introduce=True))
        await refused(z, "stranger")
        put(Signer(rogue).sign(STATE, data))
        await refused(z, "unknown")
        modes = set()
        for _ in range(2):
            await z.news(10.0)
            modes.add(z.vehicle("quad1").state.mode)
        assert modes == {"STABILIZE"}
        assert {"name", "stranger"} <= set(z.disbelieved("quad1", "demo"))
        assert z.disbelieved("quad2", "demo") == []


async def test_an_earlier_state_is_not_taken_for_a_new_one(guarded: StartGuarded) -> None:
    """Nor is a new one taken for an earlier one where several read it."""
    g: Guarded = await guarded()

    def read(sample: zenoh.Sample) -> str | None:
        return wire.decode(sample.payload.to_bytes(), wire.VehicleState, "state").mode

    recorded: list[tuple[bytes, bytes]] = []

    def record(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        recorded.append((sample.payload.to_bytes(), sample.attachment.to_bytes()))

    tap = g.b.ground.session.declare_subscriber(STATE, record)
    async with g.client("eye", "viewer") as z, z.subscribe("quad1", read) as one, z.subscribe("quad1", read) as two:
        g.b.peer.mode = 4
        await z.vehicle("quad1").wait_until(lambda s: s.mode == "GUIDED", 20.0)
        tap.undeclare()
        for reader in (one, two):  # beside the client's own, and later than it
            while await asyncio.wait_for(reader.get(), 20.0) != "GUIDED":
                pass
            assert reader.bad == 0
        payload, attachment = next(r for r in recorded if json.loads(r[0])["mode"] == "STABILIZE")
        g.b.ground.session.put(STATE, payload, attachment=attachment, **BLOCK)
        await refused(z, "replayed")
        assert z.vehicle("quad1").state.mode == "GUIDED"


async def test_events_are_its_vehicles_and_may_be_old(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    async with g.client("eye", "viewer") as z, z.subscribe("quad1/event") as events:
        own = Signer(Credentials.load(g.authority.folder / "quad1"))
        event = wire.Event(t=time.time() - 100.0, kind="fault", severity="error", text="old and true")
        old, lie = wire.encode(event), wire.encode(msgspec.structs.replace(event, text="a lie"))
        for payload, attachment in (
            (lie, None),
            (lie, own.sign(EVENT, old)),
            (lie, Signer(g.authority.member("quad2", "vehicle")).sign(EVENT, lie)),
            (old, own.sign(EVENT, old, now=time.time() - 100.0)),
        ):
            g.b.ground.session.put(EVENT, payload, attachment=attachment, **BLOCK)
        sample = await asyncio.wait_for(events.get(), 20.0)
        assert json.loads(sample.payload.to_bytes())["text"] == "old and true"
        assert events.bad == 3


def test_forged_rosters_cost_so_many_checks_a_second(authority: Authority) -> None:
    now = 0.0
    member = Member(authority.member("eye", "viewer"), lambda: now)
    for _ in range(int(ROSTERS) + 100):
        member.take_roster(authority.roster().replace(b"demo", b"omed"))
    assert (member.counts["roster"], member.counts["roster busy"]) == (ROSTERS, 100)
    now = 1.0
    member.take_roster(authority.roster())
    assert member.verifier.roster.number == authority.number


def test_a_flood_of_old_rosters_costs_the_new_one_nothing(authority: Authority) -> None:
    """Who forges an older number, or says a true one again and again, is not looked at."""
    member = Member(authority.member("eye", "viewer"), lambda: 0.0)
    old = authority.roster()
    member.take_roster(old)
    forged = old.replace(b"demo", b"omed")
    for _ in range(5000):
        member.take_roster(old)
        member.take_roster(forged)
    member.take_roster(authority.roster())
    assert member.verifier.roster.number == authority.number
    assert not member.counts


async def test_a_client_judges_rosters_beside_its_event_loop(guarded: StartGuarded) -> None:
    """A hundred forged ones at once held up all that it heard, and the true one among them was not looked at."""
    g: Guarded = await guarded()
    async with g.client("eye", "viewer") as z:
        assert z.member is not None
        threads, take, loop = set[int](), z.member.take_roster, threading.get_ident()

        def taken(data: bytes) -> None:
            threads.add(threading.get_ident())
            take(data)

        z.member.take_roster = taken  # type: ignore[method-assign]
        key = keys.FLEET.key("demo", topic=keys.ROSTER)
        for _ in range(50):
            g.b.ground.session.put(key, g.authority.roster().replace(b"demo", b"omed"), **BLOCK)
        g.b.ground.session.put(key, g.authority.roster(), **BLOCK)
        while z.member.verifier.roster.number != g.authority.number:
            await asyncio.sleep(0.01)
        assert loop not in threads


async def test_a_client_asks_no_invented_names(guarded: StartGuarded) -> None:
    """States in names that nobody has, of an hour ago: each had a question sent through the whole fleet."""
    g: Guarded = await guarded()
    asked: list[str] = []
    for channel in (keys.STATE, keys.CERTIFICATE):
        g.b.ground.session.declare_queryable(channel.key("demo", "*"), lambda query: asked.append(str(query.key_expr)))
    viewer = Signer(g.authority.member("view", "viewer"))
    async with g.client("eye", "viewer") as z:
        assert z.member is not None
        for n in range(200):
            key = keys.STATE.key("demo", f"ghost{n}")
            for age in (0.0, 3600.0):
                g.b.ground.session.put(key, b"{}", attachment=viewer.sign(key, b"{}", now=time.time() - age), **BLOCK)
        while z.member.counts["clock"] + z.member.counts["unknown"] < 400:
            await asyncio.sleep(0.01)
        g.b.ground.session.put(STATE, b"{}", attachment=viewer.sign(STATE, b"{}", now=time.time() - 3600.0), **BLOCK)
        while STATE not in asked:  # what was asked before has come before
            await asyncio.sleep(0.01)
    ghosts = [key for key in asked if "ghost" in key]
    assert not [key for key in ghosts if key.endswith("/state")]
    assert len(ghosts) <= 3 * STRANGERS


def test_who_speaks_to_all_introduces_himself_on_each_topic(authority: Authority) -> None:
    """One topic that is said often took the introductions of all: who heard but another never came to believe it."""
    now = 0.0
    member = Member(authority.member("plan", "planner"), lambda: now)
    sent: dict[str, int] = {"charge": 0, "goal": 0}
    for n in range(40):
        now = n * 0.3
        for topic in sent if n % 4 == 1 else ("charge",):
            proof = member.proof(keys.FLEET.key("demo", topic=topic), b"{}")
            assert proof is not None
            sent[topic] += bool(read(proof).certificate)
    assert sent == {"charge": 10, "goal": 10}


def token(g: Guarded, name: str, sysid: int, instance: str) -> zenoh.LivelinessToken:
    key = keys.ALIVE.key("demo", name, role=keys.VEHICLE, sys=sysid, autopilot="ardupilot", uid="77", instance=instance)
    return g.b.ground.session.liveliness().declare_token(key)


async def test_a_token_that_is_not_proven_stops_nobody(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    g.vehicle.presence.ask_every = 0.3
    asked: list[str] = []
    quad2 = Signer(g.authority.member("quad2", "vehicle"))
    lie = json.loads(wire.encode(g.vehicle.state.build()))

    def answer(query: zenoh.Query) -> None:
        """As quad2, which has credentials of its own, would speak as another quad1; and with what it recorded."""
        with query:
            key = str(query.key_expr)
            asked.append(key)
            assert query.payload is not None
            data = json.dumps({**lie, "instance": "ghost", "name": key.split("/")[2]}).encode()
            answers = query.payload.to_bytes() if "quad1" in key else bytes(8)
            proof = quad2.answer(key, data, answers)
            query.reply(key, data, attachment=proof)

    for name in ("quad1", "quad2"):
        g.b.ground.session.declare_queryable(keys.STATE.key("demo", name), answer)
    tokens = [token(g, "quad1", 9, "ghost"), token(g, "quad2", 1, "ghost")]
    while len(set(asked)) < 2:
        await asyncio.sleep(0.02)
    async with g.client("op", "operator") as z:
        await z.vehicle("quad1").set_mode("GUIDED")
        assert z.vehicle("quad1").state.clash is None
    assert g.vehicle.presence.clash is None
    assert len(g.vehicle.presence.others) == 2
    for one in tokens:
        one.undeclare()


async def test_a_namesake_is_seen_among_forged_tokens(
    guarded: StartGuarded,
    net: Net,
    onboard: StartOnboard,
    peer: StartPeer,
) -> None:
    """A relay's flood of quad2's tokens came before the true one, and goes on after it: nobody saw that quad2 had our
    system id.
    """
    g: Guarded = await guarded()
    g.vehicle.presence.ask_every = 0.3
    g.authority.issue("quad2", "vehicle")
    assert g.vehicle.gate is not None
    g.vehicle.gate.learn(Credentials.load(g.authority.folder / "quad2").certificate.der)
    tokens = [token(g, "quad2", 9, f"before{n}") for n in range(OF_EACH + 4)]
    while g.vehicle.presence.others.crowded() != ["quad2"]:
        await asyncio.sleep(0.01)
    session, _ = net.router(g.b.endpoint)
    other = await peer(1, uid=2)
    twin = await onboard(session, other.url, "quad2", credentials=str(g.authority.folder / "quad2"))

    async def flood() -> None:
        for n in range(100_000):
            tokens.append(token(g, "quad2", 9, f"after{n}"))
            await asyncio.sleep(0.005)

    flooding = asyncio.create_task(flood())
    await g.b.event("quad2 and quad1 both have system id 1", kind="clash")
    flooding.cancel()
    for one in tokens:
        one.undeclare()
    await onboard.close(twin)
    await g.b.event("the clash is over", kind="clash")


async def test_a_namesake_that_proves_it_is_a_clash(
    guarded: StartGuarded, net: Net, onboard: StartOnboard, peer: StartPeer
) -> None:
    """The same credentials on two computers."""
    g: Guarded = await guarded()
    session, _ = net.router(g.b.endpoint)
    other = await peer(2, uid=2)
    twin = await onboard(session, other.url, "quad1", **g.settings)
    said = await g.b.event("another vehicle is named quad1", kind="clash")
    assert said["severity"] == "critical"
    await g.b.state(lambda s: s["clash"] and s["instance"] == g.vehicle.presence.instance, "the one's clash")
    await g.b.state(lambda s: s["clash"] and s["instance"] == twin.presence.instance, "the other's clash")
    async with g.client("op", "operator") as z:
        with pytest.raises((Clash, Forbidden)):  # of one of the two, or not for the gate of the other
            await z.vehicle("quad1").set_mode("GUIDED")
    assert (g.b.peer.mode, other.mode) == (0, 0)
    await onboard.close(twin)
    await g.b.event("the clash is over", kind="clash")
