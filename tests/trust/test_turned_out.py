"""A newer roster at a vehicle: whom the fleet has turned out commands no more."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

from tests.failsafe.conftest import held
from tests.services.authority.test_leader import ORIGIN
from tests.services.conftest import ARM
from tests.waiting import until
from zmav import wire
from zmav.client import Answer, Client
from zmav.errors import Forbidden, Refused
from zmav.trust.roster import Roster, read_signed

if TYPE_CHECKING:
    from tests.trust.conftest import Guarded, StartGuarded


def newer(g: Guarded) -> Roster:
    return read_signed(g.authority.roster()).open(g.authority.certificate, "demo")


async def test_the_lease_of_who_was_turned_out_ends_at_once(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    async with g.client("swap", "planner") as z:
        vehicle, member = z.vehicle("quad1"), z.member
        assert member is not None
        certificate = member.credentials.certificate
        async with vehicle.lease("alice", ttl=30.0):
            g.vehicle.take_roster(newer(g))
            assert g.vehicle.leases.holder == "alice", "it was admitted later than that roster was signed"
            again = {"name": "swap", "role": "planner", "fingerprint": "00" * 8, "not_after": certificate.not_after}
            g.authority.members.append(again)  # the name was given again, with another key
            g.authority.revoked.append(certificate.fingerprint.hex())
            g.vehicle.take_roster(newer(g))
            assert g.vehicle.leases.holder is None
            await g.b.event("lease of alice ended: the fleet turned swap out", kind="lease")
            with pytest.raises(Forbidden, match="revoked"):
                await vehicle.ping()


async def turn_out(g: Guarded, z: Client) -> None:
    """Whose client it is; the vehicle hears of it."""
    assert z.member is not None
    g.authority.revoked.append(z.member.credentials.certificate.fingerprint.hex())
    g.vehicle.take_roster(newer(g))


async def test_who_was_turned_out_arms_no_vehicle_that_was_not_ready(guarded: StartGuarded) -> None:
    """With the lease, the order would have ended with that."""
    g: Guarded = await guarded()
    async with g.client("swap", "planner") as z:
        order = asyncio.create_task(z.vehicle("quad1").order("arm", wire.Arm(ready_timeout=60.0)))
        await g.b.state(lambda s: s["mover"] == "order", "the order")
        await turn_out(g, z)
        await g.b.state(lambda s: s["mover"] == "nobody", "the order's end")
        g.b.peer.send("SYS_STATUS", onboard_control_sensors_health=0x10000000)
        g.b.peer.send("EKF_STATUS_REPORT", flags=16)
        await g.b.state(lambda s: s["ready"], "ready")
        with pytest.raises((Refused, Forbidden)):
            await order
        assert g.b.peer.commands(ARM) == []


@pytest.mark.parametrize("arrive", [True, False], ids=["under way", "led there"])
async def test_who_was_turned_out_leads_a_vehicle_nowhere(guarded: StartGuarded, arrive: bool) -> None:
    g: Guarded = await guarded(origin=ORIGIN)
    await g.b.flying()
    g.b.peer.place = (ORIGIN.lat_deg, ORIGIN.lon_deg)
    await g.b.state(lambda s: s["position"], "position")
    async with g.client("swap", "planner") as z, g.client("alice", "operator") as alice:
        goto = wire.GoTo(pos=(400.0, 0.0, -10.0), arrive=arrive)
        order = asyncio.create_task(z.vehicle("quad1").order("goto", goto))
        await g.b.state(lambda s: s["mover"] == ("order" if arrive else "target"), "it is led")
        await turn_out(g, alice)
        then = time.time()
        await g.b.state(lambda s: s["t"] > then and s["mover"] == ("order" if arrive else "target"), "it is led still")
        await turn_out(g, z)
        await held(g.b)
        await g.b.state(lambda s: s["mover"] == "hold", "a hold")
        await g.b.event("the fleet turned swap out: holding position")
        await asyncio.wait({order})
        assert isinstance(order.exception(), (Refused, Forbidden)) is arrive


async def test_who_was_turned_out_while_an_order_was_judged_gives_none(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    async with g.client("swap", "operator") as z:
        g.b.peer.beating = False  # it is judged by the next HEARTBEAT
        arming = wire.RunCommand(command="COMPONENT_ARM_DISARM", params={"param1": 1.0})
        order = asyncio.create_task(z.vehicle("quad1").order("command", arming))
        await until(lambda: g.vehicle.orders.under_way or order.done(), "it is not judged")
        await turn_out(g, z)
        g.b.peer.beating = True
        with pytest.raises(Forbidden, match="swap"):
            await order
        assert g.b.peer.commands(ARM) == []


async def test_a_reader_who_was_turned_out_asks_a_flying_vehicle_in_vain(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    asked = ("param", "body", "rates", "host", "msg/HEARTBEAT", "mission/mission", "file/x", "link/autopilot")
    async with g.client("lab", "viewer") as lab, g.client("alice", "operator") as alice:
        assert lab.member is not None
        assert [a for a in await lab.ask("zmav/demo/quad1/body") if isinstance(a, Answer)]
        await g.b.flying()
        g.authority.revoked.append(lab.member.credentials.certificate.fingerprint.hex())
        g.vehicle.take_roster(newer(g))
        for what in asked:
            answers = await lab.ask(f"zmav/demo/quad1/{what}")
            assert [type(a) for a in answers] == [Forbidden], what
            assert isinstance(answers[0], Forbidden)
            assert answers[0].detail["reason"] == "revoked"
        # Its state it publishes; and by asking for it over a challenge a member whose clock is off believes it again.
        assert [type(a) for a in await lab.ask("zmav/demo/quad1/state")] == [Answer]
        unsigned = await g.b.ground.ask("zmav/demo/quad1/body")
        assert [wire.error_from(r.err.payload.to_bytes()).detail["reason"] for r in unsigned if r.err] == ["unsigned"]
        for what in ("body", "state"):  # who is a member still signs it when it is told to, and is answered
            assert [type(a) for a in await alice.ask(f"zmav/demo/quad1/{what}")] == [Answer], what
        assert [type(a) for a in await alice.ask("zmav/demo/*/body")] == [Answer]
