"""Who moves the vehicle: the strongest claim, what is refused for it, and what a vehicle says of it in flight."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

from tests.services.authority.test_leader import GLOBAL, ORIGIN, at
from tests.services.authority.test_segment import stand
from tests.services.authority.test_setpoint import pilot
from zmav import wire
from zmav.config import Failsafe, PilotSwitch
from zmav.errors import Refused
from zmav.onboard import Onboard, OnboardSettings
from zmav.services.authority.control import Control, Mover

if TYPE_CHECKING:
    from tests.conftest import Net
    from tests.services.conftest import StartBench


def test_the_strongest_claim_has_it_and_each_ends_by_itself() -> None:
    control = Control("quad1")
    assert (control.mover, control.pilot, control.ours) == (Mover.NOBODY, None, False)
    control.take("watchdog", Mover.STREAM)
    control.take("orders", Mover.ORDER)
    assert control.mover is Mover.ORDER
    assert control.claimed(Mover.STREAM)
    control.take("pilot", Mover.PILOT, "his switch")
    assert (control.mover.value, control.pilot, control.ours) == ("pilot", "his switch", True)
    control.take("watchdog", Mover.FAILSAFE)
    assert not control.claimed(Mover.STREAM)
    control.leave("orders")
    assert not control.ours, "a failsafe is nothing that a pilot is told to have ended"
    control.leave("pilot")
    assert control.mover.value == "failsafe"
    control.leave("watchdog")
    control.leave("watchdog")
    assert control.mover.value == "nobody"


def test_what_is_refused_for_it() -> None:
    control = Control("quad1")
    control.take("orders", Mover.ORDER)
    control.check_pilot()
    with pytest.raises(Refused, match="an order moves the vehicle"):
        control.check_order()
    control.take("pilot", Mover.PILOT, "his switch")
    with pytest.raises(Refused, match="the pilot has it: his switch"):
        control.check_pilot()
    control.leave("pilot")
    control.leave("orders")
    control.check_pilot()
    control.check_order()


async def test_a_vehicle_says_who_moves_it(bench: StartBench) -> None:
    settings = {
        "origin": ORIGIN,
        "failsafe": Failsafe(hold_after=0.5, land_after="never"),
        "pilot_switch": PilotSwitch(channel=7),
    }
    b = await bench(settings=settings)
    alice = await pilot(b)

    async def moved_by(mover: str) -> None:
        await b.state(lambda s: s["mover"] == mover, f"moved by {mover}")

    async def put() -> None:
        while True:  # one alone would be followed by the hold before a busy machine tells of it
            alice.put()
            await asyncio.sleep(0.1)

    async def moved_by_stream() -> None:
        streaming = asyncio.get_running_loop().create_task(put())
        await moved_by("stream")
        streaming.cancel()

    await moved_by("nobody")
    await stand(b)
    t = time.time()
    points = [wire.SegmentPoint(t=t, pos=(0.0, 0.0, -10.0)), wire.SegmentPoint(t=t + 2.0, pos=(3.0, 0.0, -10.0))]
    alice.put(vel=None, segment=points)
    await moved_by("segment")
    await moved_by_stream()
    await moved_by("hold")

    b.peer.send("GLOBAL_POSITION_INT", **at())
    await b.state(lambda s: s["position"], "position")
    await b.ground.do("goto", pos=[400.0, 0.0, -10.0], id="g", wait=0, lease=alice.token)
    await moved_by("order")
    await b.ground.do("goto", pos=[400.0, 0.0, -10.0], arrive=False, lease=alice.token)
    await moved_by("target")
    before = len(b.peer.heard(GLOBAL))
    await b.peer.count(GLOBAL, before + 1)
    await moved_by_stream()
    led = len(b.peer.heard(GLOBAL))
    await moved_by("hold")
    assert len(b.peer.heard(GLOBAL)) <= led + 1, "who streams is not led somewhere else at the same time"

    b.peer.send("RC_CHANNELS", chancount=16, chan7_raw=1900)
    await moved_by("pilot")
    b.peer.send("RC_CHANNELS", chancount=16, chan7_raw=1100)
    await moved_by("nobody")


@pytest.mark.parametrize("failing", ["presence", "forwarder", "authority"])
async def test_a_start_that_fails_says_why_and_closes_what_had_started(
    net: Net, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    session, _ = net.router()
    onboard = Onboard(session, OnboardSettings(link="udpin:127.0.0.1:0", name="quad1"))
    closed: list[str] = []

    def fail() -> None:
        raise Refused("the real reason")

    def note(name: str) -> None:
        service = getattr(onboard, name)
        close = service.close

        def noted() -> object:
            closed.append(name)
            return close()

        monkeypatch.setattr(service, "close", noted)

    for name in ("events", "timesync", "state", "presence", "identity", "missions", "orders", "authority"):
        note(name)
    monkeypatch.setattr(getattr(onboard, failing), "start", fail)
    with pytest.raises(Refused, match="the real reason"):
        await onboard.__aenter__()
    whole = ["orders", "missions", "identity", "presence", "state", "timesync", "events"]
    assert closed == {"presence": whole[4:], "forwarder": whole[2:], "authority": whole}[failing]


async def test_a_close_that_fails_keeps_no_other_from_closing(net: Net, monkeypatch: pytest.MonkeyPatch) -> None:
    session, _ = net.router()
    onboard = Onboard(session, OnboardSettings(link="udpin:127.0.0.1:0", name="quad1"))
    await onboard.__aenter__()
    close = onboard.authority.close

    def fail() -> None:
        close()
        raise Refused("it does not close")

    monkeypatch.setattr(onboard.authority, "close", fail)
    with pytest.raises(Refused, match="it does not close"):
        await onboard.__aexit__(None, None, None)
    assert onboard.adapter.link.state.value == "closed"
