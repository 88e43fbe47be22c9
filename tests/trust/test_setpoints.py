"""Setpoints under a sealed lease: only its holder's are flown, no matter who has overheard the lease's token."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from tests.trust.conftest import StartGuarded, secret_of
from zmav import keys, wire
from zmav.config import Failsafe
from zmav.errors import BadInput, NotHolder
from zmav.trust.seal import Exchange, seal

if TYPE_CHECKING:
    from tests.trust.conftest import Guarded
    from zmav.client import Client

FORWARD, BACK = (1.5, 0.0, 0.0), (-9.0, 0.0, 0.0)
LOCAL = "SET_POSITION_TARGET_LOCAL_NED"
BLOCK: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.BLOCK}
SETTINGS = {"failsafe": Failsafe(hold_after=60.0, land_after="never")}


def key(agent: str = "alice") -> str:
    return keys.SETPOINT.key("demo", "quad1", agent=agent)


def point(token: str, seq: int, vel: wire.Vector = BACK) -> bytes:
    return wire.encode(wire.Setpoint(lease=token, seq=seq, deadline=time.time() + 4.0, vel=vel))


async def counted(g: Guarded, what: str, count: int) -> None:
    counts = g.vehicle.setpoints.counts

    async def there() -> None:
        while counts[what] < count:
            await asyncio.sleep(0.005)

    await asyncio.wait_for(there(), 30.0)
    assert counts[what] == count


def flown(g: Guarded) -> set[float]:
    return {told.fields["vx"] for told in g.b.peer.heard(LOCAL)}


class Tap:
    """What anybody who relays hears of setpoints: key, payload, attachment."""

    def __init__(self, g: Guarded) -> None:
        self.heard: list[tuple[str, bytes, bytes]] = []
        self._session = g.b.ground.session
        self._session.declare_subscriber(key("*"), self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        self.heard.append((str(sample.key_expr), sample.payload.to_bytes(), sample.attachment.to_bytes()))

    async def replay_first(self) -> None:
        async def there() -> None:
            while not self.heard:
                await asyncio.sleep(0.005)

        await asyncio.wait_for(there(), 30.0)
        at, payload, attachment = self.heard[0]
        self._session.put(at, payload, attachment=attachment, **BLOCK)


def put(g: Guarded, payload: bytes, attachment: bytes | None = None, agent: str = "alice") -> None:
    g.b.ground.session.put(key(agent), payload, attachment=attachment, **BLOCK)


async def test_only_the_holders_are_flown(guarded: StartGuarded) -> None:
    g: Guarded = await guarded(**SETTINGS)
    async with g.client("swap", "planner") as z:
        await g.b.flying()
        async with z.vehicle("quad1").lease("alice", ttl=30.0) as lease:
            lease.setpoint(vel=FORWARD)
            await counted(g, "flown", 1)
            stolen = point(lease.token, 50)
            put(g, stolen)
            put(g, stolen, b"garbage")
            put(g, stolen, bytes(100_000))
            put(g, stolen, seal(bytes(32), key(), stolen))
            put(g, stolen, seal(secret_of(lease), key("bob"), stolen))
            put(g, b"{" * 5000, b"\x02" + bytes(16))
            await counted(g, "forged", 6)
            lease.setpoint(vel=FORWARD)
            await counted(g, "flown", 2)
            state = await g.b.state(lambda s: s["setpoints"] == {"flown": 2, "forged": 6}, "what was counted")
            assert (state["lease"]["holder"], state["lease"]["origin"]) == ("alice", "swap")
        await recorded_ones_are_worth_nothing(g, z)
    assert FORWARD[0] in flown(g)
    assert BACK[0] not in flown(g)
    await g.b.event("setpoint of alice dropped: it has no seal: take a lease with credentials", kind="setpoint")


async def recorded_ones_are_worth_nothing(g: Guarded, z: Client) -> None:
    vehicle, tap = z.vehicle("quad1"), Tap(g)
    async with vehicle.lease("alice", ttl=30.0) as lease:
        lease.setpoint(vel=FORWARD, valid=4.9)
        await counted(g, "flown", 3)
        await tap.replay_first()
        await counted(g, "order", 1)
    await tap.replay_first()
    await counted(g, "lease", 1)
    async with vehicle.lease("alice", ttl=30.0):
        await tap.replay_first()
        await counted(g, "lease", 2)
    async with vehicle.lease("alice", ttl=30.0):
        await tap.replay_first()
        await counted(g, "forged", 7)


async def test_who_held_it_before_cannot_use_the_token_of_who_holds_it_now(guarded: StartGuarded) -> None:
    g: Guarded = await guarded(**SETTINGS)
    async with g.client("swap", "planner") as z, g.client("swap2", "planner") as z2:
        await g.b.flying()
        alice, bob = z.vehicle("quad1"), z2.vehicle("quad1")
        async with alice.lease("alice", ttl=30.0) as first, bob.lease("bob", ttl=30.0, priority=1) as second:
            stolen = point(second.token, 50)
            put(g, stolen, seal(secret_of(first), key(), stolen))
            await counted(g, "lease", 1)
            own = point(first.token, 51)
            put(g, own, seal(secret_of(first), key(), own))
            await counted(g, "lease", 2)
            await g.b.event("bob (priority 1) took the lease from alice (0)", kind="lease")
            second.setpoint(vel=FORWARD)
            await counted(g, "flown", 1)
    assert FORWARD[0] in flown(g)
    assert BACK[0] not in flown(g)


async def test_an_overheard_token_is_its_holders(guarded: StartGuarded) -> None:
    """Renewed, released and used for orders by the certificate that took it, and by no other."""
    g: Guarded = await guarded(**SETTINGS)
    async with (
        g.client("swap", "planner") as z,
        g.client("thief", "planner") as thief,
        g.client("chief", "operator") as chief,
    ):
        await g.b.flying()
        vehicle, other = z.vehicle("quad1"), thief.vehicle("quad1")
        async with vehicle.lease("alice", ttl=30.0) as lease:
            token = lease.token
            for verb, args in (
                ("lease", wire.TakeLease(holder="alice", lease=token, ttl=0.1)),
                ("release", wire.DropLease(lease=token)),
                ("set_mode", wire.SetMode(mode="LOITER", lease=token)),
            ):
                with pytest.raises(NotHolder, match="was given to swap, and thief asks"):
                    await other.order(verb, args)
            await vehicle.order("lease", wire.TakeLease(holder="alice", lease=token, ttl=20.0))
            lease.setpoint(vel=FORWARD)
            await counted(g, "flown", 1)
            assert g.b.peer.mode == 4
            await vehicle.set_mode("LOITER")
            assert g.b.peer.mode == 5
            await other.order("hold", wire.Order(lease=token))  # open to all, and so it ends a stranger's lease
            await g.b.event("lease of alice revoked: hold was ordered", kind="lease")
        async with vehicle.lease("alice", ttl=30.0) as lease:
            assert await chief.vehicle("quad1").revoke("enough") == "alice"
            await g.b.event("lease of alice revoked by the operator chief: enough", kind="lease")
            await vehicle.wait_until(lambda state: lease.lost is not None, 20.0)
            assert lease.lost is not None
            assert lease.lost.detail["reason"] == "revoked"


async def test_it_needs_a_key_and_keeps_it_when_renewed(guarded: StartGuarded) -> None:
    g: Guarded = await guarded(**SETTINGS)
    async with g.client("swap", "planner") as z:
        vehicle = z.vehicle("quad1")
        for public in ("", "00" * 32, "rubbish"):
            with pytest.raises(BadInput) as e:
                await vehicle.order("lease", wire.TakeLease(holder="alice", key=public))
            assert e.value.detail["field"] == "key"
        assert g.vehicle.leases.holder is None
        ours = Exchange()
        granted = await vehicle.order("lease", wire.TakeLease(holder="alice", key=ours.public, ttl=30.0))
        token = granted["lease"]
        again = await vehicle.order("lease", wire.TakeLease(holder="alice", lease=token, ttl=30.0))
        assert (again["key"], again["lease"]) == (granted["key"], token)
        assert g.vehicle.leases.secret == ours.secret(granted["key"], "demo/quad1", token)
