"""The roster's way through the fleet, and what a router does with a newer, an older, a forged and a foreign one."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import random
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zenoh

import zmav
from mesh.credentials.ca import Authority
from mesh.credentials.rosterwatch import RosterWatch
from mesh.plan import plan_router
from tests.waiting import until
from zmav import keys
from zmav.doctor.credentials import rosters
from zmav.errors import BadConfig
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.roster import HeldRoster, Roster, SignedRoster, read_signed

if TYPE_CHECKING:
    from tests.mesh.credentials.conftest import Door, Fleet

ROSTER = keys.FLEET.key("alpha", topic=keys.ROSTER)
PATIENCE_S = 30.0


class Watched:
    """A router, its watch, and what it said."""

    def __init__(self, door: Door, watch: RosterWatch, said: list[str]) -> None:
        self.door, self.watch, self.said = door, watch, said


Watch = Callable[..., Any]


@pytest.fixture
async def watch(fleet: Fleet) -> AsyncIterator[Watch]:
    """``await watch(name, *connect)``: a router of that member with its watch, in a hurry."""
    async with contextlib.AsyncExitStack() as stack:

        async def start(name: str, *connect: str) -> Watched:
            door = await asyncio.to_thread(fleet.router, name, *connect)
            credentials = Credentials.load(fleet.members[name])
            plan = plan_router(None, name, SessionSettings(credentials=str(credentials.folder)))
            said: list[str] = []
            watch = RosterWatch(door.session, plan, credentials, said.append)
            watch.shortest = 0.1
            return Watched(door, await stack.enter_async_context(watch), said)

        yield start


def kept(fleet: Fleet, name: str) -> Roster:
    data = (fleet.members[name] / "roster.json").read_bytes()
    return read_signed(data).open(fleet.authority.certificate, "alpha")


async def test_a_new_roster_crosses_the_fleet_and_is_kept(fleet: Fleet, watch: Watch) -> None:
    """Brought to the one end of a chain of three; a fourth that was cut off gets it when it comes."""
    fleet.issue(view=Role.VIEWER, **{f"quad{n}": Role.VEHICLE for n in range(1, 5)})
    first = await watch("quad1")
    second = await watch("quad2", first.door.quic)
    third = await watch("quad3", second.door.quic)
    chain = {"quad1": first, "quad2": second, "quad3": third}
    heard: list[int] = []
    third.watch.tell(lambda roster: heard.append(roster.number))
    fleet.authority.revoke("view")
    number = fleet.authority.ledger.number
    async with zmav.open(fleet="alpha", connect=[first.door.local]) as z:
        answers = await rosters(z, "alpha", payload=msgspec.json.encode(fleet.authority.roster()))
    assert [(a.name, a.number) for a in answers if isinstance(a, HeldRoster)][:1], "somebody took it"
    for name, each in chain.items():
        await until(lambda each=each: each.watch.roster.number == number, "the roster")  # type: ignore[misc]
        assert kept(fleet, name).number == number
        assert [words for words in each.said if "1 revoked" in words] == [f"roster {number}: 4 members, 1 revoked"]
        assert "access rules" in await asyncio.wait_for(each.watch.outdated(), PATIENCE_S)
    assert heard[-1] == number
    late = await watch("quad4", third.door.quic)
    await until(lambda: late.watch.roster.number == number, "the roster")


async def test_a_newer_roster_with_the_same_rules_asks_for_no_new_start(fleet: Fleet, watch: Watch) -> None:
    fleet.issue(quad1=Role.VEHICLE, quad2=Role.VEHICLE)
    fleet.authority.renew("quad1", out=fleet.members["quad1"])  # with the roster that has both
    one = await watch("quad1")
    fleet.authority.renew("quad2")
    assert one.watch.adopt(fleet.authority.roster())
    with pytest.raises(asyncio.TimeoutError):
        await asyncio.wait_for(one.watch.outdated(), 0.05)
    fleet.issue(quad3=Role.VEHICLE)
    away = fleet.members["quad1"].rename(fleet.members["quad1"].with_name("away"))  # as a disk that cannot be written
    assert one.watch.adopt(fleet.authority.roster())
    with pytest.raises(asyncio.TimeoutError):  # it would hear the same after each start, and start for ever
        await asyncio.wait_for(one.watch.outdated(), 0.05)
    assert "stay as they are until it can be written" in one.said[-1]
    away.rename(fleet.members["quad1"])
    fleet.issue(quad4=Role.VEHICLE)
    assert one.watch.adopt(fleet.authority.roster())
    assert await asyncio.wait_for(one.watch.outdated(), PATIENCE_S)


async def test_older_forged_and_foreign_ones_are_not_taken(fleet: Fleet, watch: Watch, tmp_path: Path) -> None:
    fleet.issue(quad1=Role.VEHICLE)
    old = fleet.authority.roster()
    fleet.issue(ops=Role.OPERATOR)
    one = await watch("quad1")
    before = one.watch.adopt(fleet.authority.roster())
    assert before, "quad1's folder was made before ops was"
    number = one.watch.roster.number
    assert not one.watch.adopt(old)
    body = json.loads(fleet.authority.roster().roster)
    forged = SignedRoster(roster=json.dumps({**body, "number": 99}), signature=old.signature)
    other = Authority.create(tmp_path / "beta", "beta")
    for name in "abcdefgh":
        other.issue(name, Role.VIEWER)
    text = json.dumps({**body, "fleet": "beta", "number": 99}).encode()
    foreign = SignedRoster(roster=text.decode(), signature=base64.b64encode(fleet.authority._key.sign(text)).decode())
    for wrong, why in ((forged, "not signed"), (other.roster(), "not signed"), (foreign, "fleet 'beta'")):
        with pytest.raises(BadConfig, match=why):
            one.watch.adopt(wrong)
    assert one.watch.roster.number == number == kept(fleet, "quad1").number


async def test_rubbish_is_refused_once_in_words_and_ends_nothing(fleet: Fleet, watch: Watch) -> None:
    fleet.issue(quad1=Role.VEHICLE, ops=Role.OPERATOR)
    one = await watch("quad1")
    ops = await asyncio.to_thread(fleet.open, "ops", one.door.quic)
    noise = random.Random(5)
    body = json.loads(fleet.authority.roster().roster)
    rubbish = [b"", b"{}", b"[" * 5000, b'{"roster": "{", "signature": ""}', noise.randbytes(300)]
    rubbish += [
        b'{"roster": "{\\"number\\": 1e99}", "signature": "x"}',
        b'{"roster": "{\\"number\\": -1}", "signature": ""}',
    ]
    for extra in range(200):
        forged = SignedRoster(roster=json.dumps({**body, "number": 50 + extra}), signature="AAAA")
        rubbish.append(msgspec.json.encode(forged))
    rubbish += [b"x" * size + b'{"roster' for size in range(1, 40)]
    for data in rubbish:
        ops.put(ROSTER, data, congestion_control=zenoh.CongestionControl.BLOCK)
    replies = await asyncio.to_thread(lambda: list(ops.get(ROSTER, payload=rubbish[-1], timeout=10.0)))
    assert len(replies) == 1
    (reply,) = await asyncio.to_thread(lambda: list(ops.get(f"{ROSTER}?newer={'9' * 5000}", timeout=10.0)))
    assert reply.ok is not None
    fleet.authority.revoke("ops")
    await asyncio.sleep(1.0)  # the allowance of signatures looked at in a second
    ops.put(ROSTER, msgspec.json.encode(fleet.authority.roster()), congestion_control=zenoh.CongestionControl.BLOCK)
    await until(lambda: one.watch.roster.number == fleet.authority.ledger.number, "the roster")
    assert sum("not signed" in words for words in one.said) == 1
    assert sum("not a roster" in words for words in one.said) == 1


async def test_who_says_our_number_without_our_roster_does_not_silence_us(fleet: Fleet, watch: Watch) -> None:
    """Else anyone who was revoked could keep the news of it from spreading."""
    fleet.issue(quad1=Role.VEHICLE, view=Role.VIEWER)
    fleet.authority.revoke("view")
    one = await watch("quad1")
    home = await asyncio.to_thread(fleet.open, None, one.door.local)
    out = await asyncio.to_thread(fleet.open, "view", one.door.quic)
    forged = msgspec.json.encode(
        SignedRoster(roster=json.dumps({"number": fleet.authority.ledger.number}), signature="")
    )
    genuine: list[bytes] = []

    def on_roster(sample: zenoh.Sample) -> None:
        if (data := sample.payload.to_bytes()) != forged:
            genuine.append(data)

    home.declare_subscriber(ROSTER, on_roster)
    one.watch.adopt(fleet.authority.roster())
    end = asyncio.get_running_loop().time() + PATIENCE_S
    while not genuine and asyncio.get_running_loop().time() < end:
        out.put(ROSTER, forged)
        await asyncio.sleep(0.01)
    assert genuine


async def test_silence_is_cheap(fleet: Fleet, watch: Watch) -> None:
    """Of many that have the same roster, few speak; who hears an older one does."""
    fleet.issue(**{f"quad{n}": Role.VEHICLE for n in range(1, 5)})
    routers = [await watch("quad1")]
    for name in ("quad2", "quad3", "quad4"):
        routers.append(await watch(name, routers[0].door.quic))
    newest = fleet.authority.roster()
    for each in routers:
        with contextlib.suppress(BadConfig):
            each.watch.adopt(newest)
    home = await asyncio.to_thread(fleet.home, routers[0].door)
    await asyncio.sleep(1.5)  # intervals of 0.1, 0.2, 0.4 and 0.8 s: one word in each would be enough
    assert 1 <= home.put.keys.count(ROSTER) <= 10, "and not four in each"


async def test_who_is_linked_and_no_member_is_said_once(fleet: Fleet, watch: Watch) -> None:
    fleet.issue(quad1=Role.VEHICLE, ops=Role.OPERATOR, view=Role.VIEWER)
    fleet.authority.revoke("view")
    one = await watch("quad1")
    one.watch.adopt(fleet.authority.roster())
    for name in ("view", "ops", "view"):
        session = await asyncio.to_thread(fleet.open, name, one.door.quic)
        await until(lambda: bool(list(session.info.routers_zid())), "a router")  # noqa: B023
    await until(lambda: any("view" in words for words in one.said), "refused")
    assert sum("view has a certificate, but is not on the roster" in words for words in one.said) == 1
    assert not [words for words in one.said if "ops" in words]
