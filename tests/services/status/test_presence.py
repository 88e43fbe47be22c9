"""Clashes: two vehicles of one name or one system id are noticed and said by both, and nobody moves them. What makes
them safe passes.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

import zmav
from tests.services.conftest import GUIDED, LAND, SET_MODE
from zmav import keys, wire
from zmav.errors import Clash, Refused
from zmav.mavlink import Packer, encode
from zmav.onboard import Onboard, OnboardSettings

if TYPE_CHECKING:
    from tests.conftest import Net
    from tests.services.conftest import Bench, Peer, StartBench, StartPeer, Told

ARM, REQUEST_MESSAGE = 400, 512
RTL = 6


def tokens(b: Bench) -> list[dict[str, str]]:
    """The vehicles' tokens as the ground sees them."""
    found = b.ground.session.liveliness().get("zmav/demo/*/alive/**")
    return [keys.match(str(reply.ok.key_expr))[1] for reply in found if reply.ok is not None]


async def refuses_everything(b: Bench) -> None:
    """Orders, frames and setpoints to a vehicle in a clash; but not what makes it safe."""
    for verb, args in (
        ("arm", {}),
        ("takeoff", {"alt_rel": 5.0}),
        ("goto", {"pos": [0, 0, -5]}),
        ("set_mode", {"mode": "GUIDED"}),
        ("lease", {"holder": "a"}),
    ):
        with pytest.raises(Clash):
            await b.ground.do(verb, **args)
    fields = {"target_system": 1, "target_component": 1, "command": ARM, "confirmation": 0}
    fields.update({f"param{n}": 0 for n in range(2, 8)}, param1=1)
    frame = encode(b.peer.dialect, "COMMAND_LONG", fields, sysid=255, compid=190)
    b.ground.put(keys.TX, frame, sys=1, comp=1, msg="COMMAND_LONG")
    await b.event("COMMAND_LONG refused", kind="refused")
    b.ground.put(keys.SETPOINT, setpoint(), agent="a")
    await b.state(lambda s: s["setpoints"].get("clash") == 1, "dropped setpoint")
    assert b.vehicle.adapter.tx.refused == 1
    assert b.peer.commands(ARM) == []
    b.peer.mode, b.peer.armed = GUIDED, True
    await b.state(lambda s: s["armed"] and s["mode"] == "GUIDED", "flight")
    for verb, mode in (("hold", GUIDED), ("land", LAND), ("rtl", RTL)):
        order = asyncio.create_task(b.ground.do(verb, id=f"{b.vehicle.settings.name} {verb}", wait=0.1))
        await enters(b.peer, mode)
        await order
    b.peer.mode = GUIDED
    b.ground.put(keys.TX, mode_frame(b, LAND), sys=1, comp=1, msg="COMMAND_LONG")
    await b.peer.until(lambda: b.peer.mode == LAND, "a station's landing")
    b.peer.armed = False
    await b.state(lambda s: not s["armed"], "the ground")


async def enters(peer: Peer, mode: int) -> None:
    await peer.until(lambda: peer.mode == mode, f"mode {mode}, in spite of the clash")


def mode_frame(b: Bench, mode: int) -> bytes:
    """What a ground station sends to have a mode entered."""
    fields = {"target_system": 1, "target_component": 1, "command": SET_MODE, "confirmation": 0}
    fields.update({f"param{n}": 0 for n in range(3, 8)}, param1=1, param2=mode)
    return encode(b.peer.dialect, "COMMAND_LONG", fields, sysid=255, compid=190)


def setpoint() -> bytes:
    return wire.encode(wire.Setpoint(lease="x", seq=1, deadline=time.time() + 1, vel=(0.0, 0.0, 0.0)))


async def test_one_system_id_twice(bench: StartBench) -> None:
    a = await (await bench(name="quad1", uid=1)).connected()
    b = await bench(name="quad2", uid=2, connect=(a.endpoint,))
    for one in (a, b):
        state = await one.state(lambda s: s["clash"], "clash")
        assert "quad1" in state["clash"] and "quad2" in state["clash"] and "system id 1" in state["clash"]
        said = await one.event("both have system id 1", kind="clash")
        assert said["severity"] == "critical"
    await refuses_everything(a)
    await refuses_everything(b)
    b.peer.beating = False
    await a.state(lambda s: s["clash"] is None, "end of the clash")
    await a.event("the clash is over")
    assert (await a.ground.do("ping")).status == "done"
    a.peer.armed = True
    await a.ground.do("disarm")
    assert a.peer.armed is False


async def test_one_name_twice(bench: StartBench, peer: StartPeer, net: Net) -> None:
    a = await (await bench(name="quad1", sysid=1)).connected()
    other, _ = net.router(a.endpoint)
    # Two routers know of each other's subscribers a few milliseconds before anything goes through.
    probe = a.ground.samples("zmav/probe")
    while not probe.items:
        other.put("zmav/probe", b"")
        await a.state(lambda s: True, "a moment")
    async with Onboard(other, OnboardSettings(link=(await peer(sysid=2)).url, name="quad1")) as b:
        await b_clash(a, b)
        with pytest.raises(Clash):
            b.presence.check()
    await a.state(lambda s: s["clash"] is None and s["instance"] == a.vehicle.presence.instance, "end of the clash")
    a.vehicle.presence.check()


async def b_clash(a: Bench, b: Onboard) -> None:
    """Both instances say so; they share every key, so the ground hears them side by side."""
    instances = {a.vehicle.presence.instance, b.presence.instance}
    await a.states.until(
        lambda: (
            {s["instance"] for s in a.states.objects() if s["clash"] == "another vehicle is named quad1"} == instances
        ),
        "the clash in both states",
    )
    replies = await a.ground.ask("zmav/demo/quad1/do/arm")
    assert replies
    for reply in replies:
        assert reply.err is not None
        assert wire.error_from(reply.err.payload.to_bytes()).code == "clash"
    await a.events.until(
        lambda: sum(e["kind"] == "clash" and e["severity"] == "critical" for e in a.events.objects()) == 2,
        "two events of a clash",
    )


async def test_of_two_of_one_name_the_one_is_halted_that_the_order_names(
    bench: StartBench, peer: StartPeer, net: Net
) -> None:
    """Two vehicles with one name, as a copied SD card makes them, both in the air."""
    a = await (await bench(name="quad1", sysid=1, uid=1)).connected()
    other, _ = net.router(a.endpoint)
    second = await peer(sysid=2, uid=2)
    async with Onboard(other, OnboardSettings(link=second.url, name="quad1")) as b:
        await a.state(lambda s: s["clash"] and s["uid"] == f"{2:016x}", "the second's clash")
        for one in (a.peer, second):
            one.mode, one.armed = GUIDED, True
        await a.state(lambda s: s["armed"] and s["uid"] == f"{1:016x}", "the first in the air")
        await a.state(lambda s: s["armed"] and s["uid"] == f"{2:016x}", "the second in the air")
        async with zmav.open(connect=[a.endpoint]) as z:
            (vehicle,) = await z.wait_for("quad1")
            landing = asyncio.create_task(vehicle.order("land", wire.Order(uid=f"{2:016x}")))
            await second.until(lambda: second.mode == LAND, "the landing of the one that is meant")
            second.armed = False
            assert await landing == {"armed": False}
            assert (a.peer.mode, a.peer.armed) == (GUIDED, True)
            with pytest.raises(Clash):
                await vehicle.order("goto", wire.GoTo(pos=(0.0, 0.0, -5.0), uid=f"{2:016x}"))
            second.armed = True
            await asyncio.gather(vehicle.order("hold", wire.Order()), return_exceptions=True)
            returning = asyncio.create_task(vehicle.order("rtl", wire.Order()))
            for one in (a.peer, second):
                await enters(one, RTL)  # nothing tells them apart
                one.armed = False
            await returning
        assert b.presence.clash


async def test_who_does_not_know_its_uid_yet_takes_what_makes_safe(bench: StartBench, peer: StartPeer) -> None:
    """It may be the one that is meant; what moves it waits until that is known."""
    silent = await peer(uid=5)
    silent.mute = {REQUEST_MESSAGE}
    b = await bench(silent)
    silent.mode, silent.armed = GUIDED, True
    await b.state(lambda s: s["armed"] and s["uid"] is None, "a vehicle in the air that has no uid yet")
    uid = f"{5:016x}"
    with pytest.raises(Refused, match="this one is not known yet"):
        await b.ground.do("set_mode", mode="RTL", uid=uid)
    await b.ground.do("hold", uid=uid)
    for verb, mode in (("rtl", RTL), ("land", LAND)):
        silent.armed = True
        await b.state(lambda s: s["armed"], "a vehicle in the air")
        ordered = asyncio.create_task(b.ground.do(verb, uid=uid))
        await enters(silent, mode)
        silent.armed = False
        await ordered
    silent.mute = set()
    await b.state(lambda s: s["uid"] == uid, "its uid")
    with pytest.raises(Refused, match="the order is for the autopilot 6"):
        await b.ground.do("hold", uid="6")


async def test_one_autopilot_heard_by_two_companions_is_no_clash(bench: StartBench, peer: StartPeer) -> None:
    silent = await peer(uid=5)
    silent.mute = {REQUEST_MESSAGE}
    a = await (await bench(name="quad1", uid=5)).connected()
    b = await bench(silent, name="quad2", connect=(a.endpoint,))
    # As long as the second cannot tell who it is, they may be two.
    await a.state(lambda s: s["clash"], "clash with an unknown")
    await b.state(lambda s: s["clash"], "clash of an unknown")
    silent.mute = set()
    for one in (a, b):
        state = await one.state(lambda s: s["uid"] and s["clash"] is None, "peace")
        assert state["uid"] == f"{5:016x}"
    a.vehicle.presence.check()
    b.vehicle.presence.check()


async def test_one_autopilot_is_no_clash_at_any_moment(bench: StartBench) -> None:
    a = await (await bench(name="quad1", uid=5)).connected()
    b = await (await bench(name="quad2", uid=5, connect=(a.endpoint,))).connected()
    await b.state(lambda s: [t["uid"] for t in tokens(b)] == [f"{5:016x}"] * 2, "both tokens")
    await a.state(lambda s: True, "another state")
    assert all(s["clash"] is None for s in a.states.objects() + b.states.objects())


async def test_two_system_ids_are_no_clash_and_the_tokens_say_who_is_there(bench: StartBench) -> None:
    a = await (await bench(name="1", sysid=1, uid=1)).connected()
    b = await (await bench(name="2", sysid=2, uid=2, connect=(a.endpoint,))).connected()
    wanted = {("1", "1", f"{1:016x}"), ("2", "2", f"{2:016x}")}
    await b.state(lambda s: {(t["vehicle"], t["sys"], t["uid"]) for t in tokens(b)} == wanted, "both tokens")
    assert {t["autopilot"] for t in tokens(b)} == {"ardupilot"}
    await a.state(lambda s: True, "another state")
    assert all(s["clash"] is None for s in a.states.objects() + b.states.objects())


async def test_two_autopilots_of_one_system_id_on_one_link(
    bench: StartBench,
    peer: StartPeer,
) -> None:
    one, there = await peer(uid=1), True
    b = await (await bench(one)).connected()
    b.vehicle.identity.uid_memory, b.vehicle.identity.ask_every = 2.0, 0.5

    def answer_twice(told: Told) -> None:
        if there and told.fields.get("command") == REQUEST_MESSAGE:
            twin(one)

    one.on_told = answer_twice
    state = await b.state(lambda s: s["clash"], "clash")
    assert state["clash"] == "2 autopilots with system id 1 on this link"
    with pytest.raises(Clash):
        await b.ground.do("arm")
    there = False
    await b.state(lambda s: s["clash"] is None and s["uid"] == f"{1:016x}", "end of the clash")


def twin(one: Peer) -> None:
    """The same system's answer, from another machine."""
    one.raw(Packer(one.dialect, 1, 1).pack("AUTOPILOT_VERSION", uid=2))


async def test_a_token_that_makes_no_sense_harms_nobody(bench: StartBench) -> None:
    b = await (await bench()).connected()
    liveliness = b.ground.session.liveliness()
    odd = [
        liveliness.declare_token(f"zmav/demo/odd/alive/vehicle/{rest}")
        for rest in ("first/none/-/nobody", "1/ardupilot/77/somebody")
    ]
    assert "odd" in (await b.state(lambda s: s["clash"], "clash with the one that does"))["clash"]
    assert not [e for e in b.events.objects() if e["kind"] == "fault"]
    for token in odd:
        token.undeclare()
    await b.state(lambda s: s["clash"] is None, "end of the clash")
