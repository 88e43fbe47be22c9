"""``link/autopilot``: what was injected is what is counted."""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys, wire
from zmav.mavlink import Packer, encode, load_dialect

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.services.conftest import StartBench, Told


def corrupt(frame: bytes) -> bytes:
    return frame[:-1] + bytes((frame[-1] ^ 0xFF,))


async def test_what_was_injected_is_counted(bench: StartBench) -> None:
    b = await (await bench()).connected()
    samples = b.ground.samples(keys.LINK, link="autopilot")
    other = Packer(b.peer.dialect, 77, 1)
    good = [other.pack("ATTITUDE", yaw=n / 10) for n in range(20)]
    beat = dict.fromkeys(("type", "autopilot", "base_mode", "custom_mode", "system_status"), 1)
    v1 = encode(b.peer.dialect, "HEARTBEAT", beat, sysid=78, compid=1, version=1)
    short = bytes((0xFE, 3)) + v1[2:9] + b"\0\0"
    flags = good[0][:2] + b"\x02" + good[0][3:]
    unknown = bytes((0xFD, 1, 0, 0, 20, 77, 1)) + (54_321).to_bytes(3, "little") + b"\x01\x12\x34"
    wrong = [corrupt(good[5]), b"\x00" * 50, short, flags]
    for data in (*good[:5], *good[8:], unknown, *wrong, v1):  # three of system 77's are missing: that is not the link
        b.peer.raw(data)
    for _ in range(2):
        b.peer.packer.pack("ATTITUDE")  # never sent
    b.peer.heartbeat()
    injected = sum(map(len, b.peer.sent))
    report = await samples.object(lambda r: r["rx_bytes"] >= injected, "report of it all")
    assert {name: report[name] for name in ("lost", "bad_crc", "bad_length", "bad_flags", "garbage", "unknown")} == {
        "lost": 2,
        "bad_crc": 1,
        "bad_length": 1,
        "bad_flags": 1,
        "garbage": sum(map(len, wrong)),
        "unknown": 1,
    }
    # It goes on beating and acknowledging: the report is of all that was sent up to some frame, and of nothing else.
    sums = list(itertools.accumulate(map(len, b.peer.sent)))
    assert report["rx_frames"] == sums.index(report["rx_bytes"]) + 1 - len(wrong)
    assert (report["name"], report["url"], report["state"], report["opens"]) == ("autopilot", b.peer.url, "up", 1)


async def test_it_answers_queries_too(bench: StartBench) -> None:
    b = await (await bench()).connected()
    # Once a second, and answered as it was published last: before the link was up, or after.
    await b.ground.samples(keys.LINK, link="autopilot").object(lambda r: r["state"] == "up", "link that is up")
    (reply,) = await b.ground.ask(keys.LINK.key("*", "*", link="*"))
    assert reply.ok is not None
    assert str(reply.ok.key_expr) == keys.LINK.key("demo", "quad1", link="autopilot")
    quality = wire.decode_link(reply.ok.payload.to_bytes())
    assert isinstance(quality, wire.LinkQuality) and quality.state == "up"


async def test_loss_rate_and_age_over_the_last_interval(bench: StartBench) -> None:
    b = await (await bench()).connected()
    samples = b.ground.samples(keys.LINK, link="autopilot")
    while not any(r["loss"] > 0.3 for r in samples.objects()):
        for n in range(10):
            data = b.peer.packer.pack("ATTITUDE")
            if n % 2:
                b.peer.raw(data)
        await b.state(lambda s: True, "a moment")
    report = await samples.object(lambda r: r["loss"] > 0.3, "loss")
    assert report["loss"] <= 0.5
    assert report["rx_rate"] > 0 and report["rx_bytes_rate"] > report["rx_rate"] * 12
    assert 0 <= report["age"] < 1.0
    await b.state(lambda s: s["link_loss"] > 0.3, "loss in the state")


async def test_round_trip_by_timesync(bench: StartBench) -> None:
    b = await (await bench()).connected()
    samples = b.ground.samples(keys.LINK, link="autopilot")
    await samples.until(lambda: len(samples.items) >= 2, "two reports without an answer")
    assert all(r["rtt"] is None for r in samples.objects())
    received = b.peer.datagram_received
    delay = 0.05

    def answer(data: bytes, addr: Any) -> None:
        received(data, addr)
        told: Told = b.peer.told[-1]
        if told.name == "TIMESYNC" and told.fields["tc1"] == 0:
            asyncio.get_running_loop().call_later(
                delay, lambda: b.peer.send("TIMESYNC", tc1=123, ts1=told.fields["ts1"])
            )

    b.peer.send("TIMESYNC", tc1=0, ts1=5)  # its own question is no answer
    b.peer.send("TIMESYNC", tc1=9, ts1=5)  # nor is an answer to somebody else
    b.peer.datagram_received = answer  # type: ignore[method-assign]
    report = await samples.object(lambda r: r["rtt"] is not None, "round trip")
    assert delay <= report["rtt"] < 1.0


async def test_what_is_sent_refused_and_dropped(bench: StartBench) -> None:
    b = await (await bench()).connected()
    early = b.vehicle.adapter.tx.dropped  # before the link was open
    b.ground.put(keys.TX, b"nonsense", sys=1, comp=1, msg="HEARTBEAT")
    b.ground.put(keys.TX, Packer(b.peer.dialect, 255, 190).pack("HEARTBEAT"), sys=0, comp=0, msg="HEARTBEAT")
    samples = b.ground.samples(keys.LINK, link="autopilot")
    report = await samples.object(lambda r: r["tx_refused"] == 1, "refusal")
    await b.peer.until(lambda: any(t.source == (255, 190) for t in b.peer.told), "the good one")
    assert (report["tx_dropped"], report["last_error"], report["rx_dropped"]) == (early, None, 0)
    await b.peer.until(lambda: len(b.peer.told) >= report["tx_frames"] > 0, "every frame counted as sent")
    await b.peer.until(lambda: len(b.peer.told) == b.vehicle.adapter.tx.frames, "no other frame")


@pytest.mark.parametrize(("url", "fleet"), [("tcp:127.0.0.1:1", "demo"), ("replay:{}", "demo-replay")])
async def test_a_link_that_takes_nothing(net: Net, onboard: StartOnboard, tmp_path: Path, url: str, fleet: str) -> None:
    recording = tmp_path / "one.tlog"
    recording.write_bytes(bytes(8) + Packer(load_dialect(), 1, 1).pack("HEARTBEAT", type=2, autopilot=3))
    session, endpoint = net.router()
    samples = net.ground(endpoint, fleet=fleet).samples(keys.LINK, link="autopilot")
    await onboard(session, url.format(recording), fleet=fleet)
    report = await samples.object(lambda r: r["tx_dropped"] > 0 and r["state"] == "down", "drops")
    assert report["tx_frames"] == 0
