"""What makes scripts short: messages of many vehicles, past events, a place or a reason, a status, a clean end."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

import zmav
from zmav import keys, wire
from zmav.errors import BadInput, BadKey, NoSuchVehicle, Refused, TimedOut
from zmav.mavlink import encode, load_dialect
from zmav.subscription import document

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0


def attitude(sysid: int, roll: float) -> bytes:
    return encode(
        load_dialect(),
        "ATTITUDE",
        {
            "time_boot_ms": 1,
            "roll": roll,
            "pitch": 0.0,
            "yaw": 0.0,
            "rollspeed": 0.0,
            "pitchspeed": 0.0,
            "yawspeed": 0.0,
        },
        sysid=sysid,
        compid=1,
        seq=0,
    )


async def test_one_stream_has_the_messages_of_many(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, z.stream("quad*/ATTITUDE") as messages:
        names = {"quad1": 1, "quad2": 2, "rover1": 3}
        for name, sysid in names.items():
            key = keys.RX.key("demo", name, sys=sysid, comp=1, msg="ATTITUDE")
            if name != "rover1":
                await net.linked(session, key)
            session.put(key, b"no frame")
            session.put(key, attitude(sysid, 0.1 * sysid))
        got = [await asyncio.wait_for(messages.get(), PATIENCE_S) for _ in range(2)]
        assert [(name, message.sysid) for name, message in got] == [("quad1", 1), ("quad2", 2)]
        assert [message.fields["roll"] for _, message in got] == pytest.approx([0.1, 0.2], abs=1e-6)
        assert messages.bad == 2


async def test_a_stream_at_a_rate_says_so_as_long_as_it_is_read(net: Net) -> None:
    session, endpoint = net.router()
    changes: asyncio.Queue[tuple[str, zenoh.SampleKind]] = asyncio.Queue()
    loop = asyncio.get_running_loop()
    wants = keys.WANT.key("demo", "*", msg="*", hz="*", instance="*")
    session.liveliness().declare_subscriber(
        wants, lambda s: loop.call_soon_threadsafe(changes.put_nowait, (str(s.key_expr), s.kind))
    )
    async with zmav.open(connect=[endpoint]) as z:
        async with z.stream("quad*/ATTITUDE", hz=5):
            key, kind = await asyncio.wait_for(changes.get(), PATIENCE_S)
            assert key.startswith("zmav/demo/quad$*/want/ATTITUDE/5/")
            assert kind == zenoh.SampleKind.PUT
        assert (await asyncio.wait_for(changes.get(), PATIENCE_S))[1] == zenoh.SampleKind.DELETE
        with pytest.raises(BadInput, match="a rate is for one message"):
            z.stream("quad1/*", hz=5)
        with pytest.raises(BadKey):
            z.stream("quad1/#")


async def test_events_of_the_past_come_first_where_they_are_asked_for(net: Net) -> None:
    session, endpoint = net.router()
    publisher = zenoh.ext.declare_advanced_publisher(
        session, keys.EVENT.key("demo", "quad1"), cache=zenoh.ext.CacheConfig(max_samples=10), publisher_detection=True
    )
    for number in range(4):
        event = wire.Event(t=time.time(), kind="mode", severity="info", text=f"event {number}")
        publisher.put(wire.encode(event))
    key = keys.EVENT.key("demo", "*")
    async with zmav.open(connect=[endpoint]) as z, z.subscribe(key, _text, history=3) as events:
        assert [await asyncio.wait_for(events.get(), PATIENCE_S) for _ in range(3)] == [f"event {n}" for n in (1, 2, 3)]


def _text(sample: zenoh.Sample) -> str:
    return wire.decode(sample.payload.to_bytes(), wire.Event, "event").text


async def test_a_place_or_the_reason_why_there_is_none(net: Net) -> None:
    session, endpoint = net.router()
    position = wire.GlobalPosition(lat_deg=0.0, lon_deg=0.0, alt_amsl=0.0, alt_rel=0.0)

    async def hear(**more: Any) -> None:
        """Say it until it is heard: the first may come before the client's subscription."""
        state = wire.VehicleState(t=time.time(), fleet="demo", name="quad1", instance="a", **more)
        while quad.last_state != state:
            session.put(keys.STATE.key("demo", "quad1"), wire.encode(state))
            await z.news(0.2)

    async with zmav.open(connect=[endpoint]) as z:
        quad = z.vehicle("quad1")
        with pytest.raises(NoSuchVehicle, match="has not been heard"):
            _ = quad.local
        await asyncio.wait_for(hear(), PATIENCE_S)
        with pytest.raises(Refused, match="quad1 has no position yet"):
            _ = quad.local
        await asyncio.wait_for(hear(position=position), PATIENCE_S)
        with pytest.raises(Refused, match="no fleet origin: start 'zmav up' with --origin"):
            _ = quad.local
        await asyncio.wait_for(hear(position=position, local=(1.0, 2.0, -3.0)), PATIENCE_S)
        assert quad.local == (1.0, 2.0, -3.0)


async def test_a_status_is_said_under_its_host(net: Net) -> None:
    _, endpoint = net.router()
    key = keys.AGENT_STATUS.key("demo", "*", agent="*")
    async with zmav.open(connect=[endpoint]) as z, z.subscribe(key) as statuses:
        z.say_status("orbit", "circling", "lap 1", vehicle="quad1", radius=8.0)
        sample = await asyncio.wait_for(statuses.get(), PATIENCE_S)
        status = wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "status")
        assert str(sample.key_expr) == "zmav/demo/quad1/agent/orbit/status"
        assert (status.agent, status.state, status.text, status.detail) == ("orbit", "circling", "lap 1", {"radius": 8})
        z.say_status("orbit", "circling")
        assert str((await asyncio.wait_for(statuses.get(), PATIENCE_S)).key_expr).startswith("zmav/demo/ground/")
        with pytest.raises(BadKey, match="agent 'My Agent' cannot stand in a key"):
            z.say_status("My Agent", "x")
    async with zmav.open(connect=[endpoint], fleet="*") as z:
        with pytest.raises(BadKey, match="fleet"):
            z.say_status("orbit", "x")


# A script's end.


def exit_code(number: int | None = None, error: Exception | None = None, result: int | None = None) -> Any:
    """How a script ends that gets a signal or an error, having cleaned up; None: it goes on behind ``zmav.run``."""
    cleaned = []

    async def main() -> int | None:
        try:
            if error is not None:
                raise error
            if number is not None:
                os.kill(os.getpid(), number)
                await asyncio.sleep(PATIENCE_S)
            return result
        finally:
            await asyncio.sleep(0)  # what it does at its end is waited for
            cleaned.append(True)

    try:
        zmav.run(main())
    except SystemExit as e:
        return e.code
    finally:
        assert cleaned == [True]
    return None


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_a_script_told_to_end_cleans_up(number: int, code: int) -> None:
    before = signal.getsignal(number)
    assert exit_code(number) == code
    assert signal.getsignal(number) == before


def test_a_script_ends_with_its_result_or_its_error_in_words() -> None:
    assert exit_code() is None
    assert exit_code(result=3) == 3
    assert str(exit_code(error=TimedOut("quad1 does not answer"))).endswith(": quad1 does not answer")
    with pytest.raises(ZeroDivisionError):  # a defect keeps its traceback
        exit_code(error=ZeroDivisionError())


async def test_a_slow_reader_loses_the_oldest_and_is_told_how_many(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, z.subscribe("zmav/test/x", depth=3) as samples:
        await net.linked(session, "zmav/test/x")
        for n in range(10):
            session.put("zmav/test/x", bytes([n]))
        end = time.monotonic() + PATIENCE_S
        while samples.dropped < 7 and time.monotonic() < end:
            await asyncio.sleep(0.01)
        assert [(await samples.get()).payload.to_bytes() for _ in range(3)] == [b"\x07", b"\x08", b"\x09"]
        assert samples.dropped == 7


async def test_documents_come_with_their_keys_and_what_is_none_is_counted(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, z.subscribe("zmav/test/*", document(wire.Signals)) as signals:
        await net.linked(session, "zmav/test/x")
        for payload in (b"none", b"[]", wire.encode(wire.Signals(t=7.0, values={"is.roll": 0.5}))):
            session.put("zmav/test/x", payload)
        heard, signals_of_x = await asyncio.wait_for(signals.get(), PATIENCE_S)
        assert (heard, signals_of_x.t, signals_of_x.values) == ("zmav/test/x", 7.0, {"is.roll": 0.5})
        assert signals.bad == 2
