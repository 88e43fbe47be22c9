"""What is told to the whole fleet, as a vehicle judges it: who may, of now, and once."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from ground.corrections import Publisher
from tests.services.corrections.test_corrections import batch, given
from tests.services.traffic.test_traffic import HOME, craft
from zmav import keys, wire
from zmav.errors import Forbidden
from zmav.trust.proof import Signer

if TYPE_CHECKING:
    from tests.trust.conftest import StartGuarded

KEY = keys.RTCM.key("demo")


async def refused(guarded: Any, payload: bytes, attachment: bytes | None, key: str = KEY) -> str:
    gate = guarded.vehicle.gate
    with pytest.raises(Forbidden) as error:
        gate.check_told(key, payload, attachment)
    return str(error.value.detail["reason"])


async def test_an_operators_corrections_reach_the_autopilot_and_no_others(guarded: StartGuarded) -> None:
    g = await guarded()
    async with (
        g.client("gs", "operator") as z,
        g.client("plan", "planner") as planner,
        g.client("eye", "viewer") as eye,
    ):
        publisher = z.session.declare_publisher(KEY, **keys.RTCM.publishing())
        for other in (planner, eye):
            with pytest.raises(Forbidden, match="may not use rtcm"):
                Publisher(other, "other")
            other.put(keys.RTCM, KEY, batch(source="other").pack())
        z.session.put(KEY, batch(source="nobody").pack())
        await asyncio.sleep(0.5)
        assert not g.b.peer.heard("GPS_RTCM_DATA")
        good = batch()
        z.put(keys.RTCM, KEY, good.pack(), publisher=publisher)
        wanted = b"".join(each.data for each in good.messages)
        await g.b.peer.until(lambda: given(g.b) == wanted, "the operator's corrections")
    counts = g.vehicle.gate.counts if g.vehicle.gate else {}
    assert (counts["role"], counts["unsigned"]) == (2, 1)
    await g.b.event("may not use rtcm")


async def test_proofs_of_corrections_are_good_once_and_now(guarded: StartGuarded) -> None:
    g = await guarded()
    by = Signer(g.authority.member("gs", "operator"))
    payload = batch().pack()
    first, second = (by.sign(KEY, payload, introduce=True) for _ in range(2))
    assert g.vehicle.gate.check_told(KEY, payload, second).name == "gs"
    assert await refused(g, payload, second) == "replayed"
    assert await refused(g, payload, first) == "replayed"
    assert await refused(g, payload + b"x", by.sign(KEY, payload, introduce=True)) == "signature"
    assert await refused(g, payload, by.sign(KEY, payload, now=1.0)) == "clock"
    assert await refused(g, payload, None) == "unsigned"


async def test_traffic_is_believed_of_operators_and_vehicles_and_of_no_others(guarded: StartGuarded) -> None:
    g = await guarded()
    key = keys.TRAFFIC.key("demo")
    for name, role in (("gs", "operator"), ("quad7", "vehicle")):
        payload = wire.encode(wire.Traffic(t=time.time(), source=name, instance=1))
        by = Signer(g.authority.member(name, role))
        assert g.vehicle.gate.check_told(key, payload, by.sign(key, payload, introduce=True)).name == name
    for name, role in (("plan", "planner"), ("eye", "viewer")):
        by = Signer(g.authority.member(name, role))
        assert await refused(g, payload, by.sign(key, payload, introduce=True), key) == "role"
    assert await refused(g, payload, None, key) == "unsigned"


async def test_a_vehicle_tells_of_its_own_receiver_alone(guarded: StartGuarded) -> None:
    """... and does not take the charge of the ground's feeds, nor speaks as another vehicle."""
    g = await guarded()
    b, key = g.b, keys.TRAFFIC.key("demo")
    b.peer.send("GPS_RAW_INT", fix_type=3)
    b.peer.place = HOME
    await b.state(lambda s: bool(s.get("position")), "its position")
    by = Signer(g.authority.member("quad7", "vehicle"))
    for icao, source, serves in (("3c0001", "quad7", "sbs:gs:1"), ("3c0002", "quad8", ""), ("3c0003", "quad7", "")):
        near = msgspec.structs.replace(craft(300.0), icao=icao, callsign="")
        payload = wire.encode(
            wire.Traffic(t=time.time(), source=source, instance=1, serves=serves, priority=9, aircraft=[near])
        )
        b.ground.session.put(key, payload, attachment=by.sign(key, payload, introduce=True))
    await b.event("traffic: 3c0003", kind="traffic")
    assert [e["text"] for e in b.events.objects() if "3c0001" in e["text"] or "3c0002" in e["text"]] == []
    assert g.vehicle.gate is not None
    assert g.vehicle.gate.counts["name"] == 2


async def test_who_is_not_known_yet_is_not_complained_of(guarded: StartGuarded) -> None:
    g = await guarded()
    by = Signer(g.authority.member("gs", "operator"))
    payload = batch().pack()
    assert await refused(g, payload, by.sign(KEY, payload)) == "unknown"
    g.vehicle.gate.check_told(KEY, payload, by.sign(KEY, payload, introduce=True))
    g.vehicle.gate.check_told(KEY, payload, by.sign(KEY, payload))
    assert not [e for e in g.b.events.objects() if e["kind"] == "refused"]
