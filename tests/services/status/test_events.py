"""``event``: the autopilot's words, what changes, and floods that stay readable."""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
import zenoh.ext

from zmav import keys
from zmav.errors import Refused
from zmav.mavlink import Packer
from zmav.mavlink.checksum import checksum
from zmav.services.status.events import SEVERITIES

if TYPE_CHECKING:
    from tests.conftest import Samples
    from tests.services.conftest import Bench, StartBench, StartPeer


ARM, FAILED = 400, 4
CRC_EXTRA = 160
"""EVENT's"""
NAMES = {4: "GUIDED", 9: "LAND", 77: "MODE_77"}


def texts(events: Samples, kind: str) -> list[str]:
    return [e["text"] for e in events.objects() if e["kind"] == kind]


async def test_the_autopilot_s_words_in_order_and_with_their_severity(bench: StartBench) -> None:
    b = await (await bench()).connected()
    before = time.time()
    for severity in (*range(8), 200):
        b.peer.send("STATUSTEXT", severity=severity, text=f"word {severity}")
    await b.event("word 200")
    said = [e for e in b.events.objects() if e["kind"] == "statustext"]
    assert [e["text"] for e in said] == [f"word {n}" for n in (*range(8), 200)]
    assert [e["severity"] for e in said] == [*SEVERITIES, "debug"]
    assert said[0]["detail"] == {"component": 1}
    assert all(before <= e["t"] <= time.time() for e in said)


async def test_other_systems_words_are_not_the_vehicle_s(bench: StartBench) -> None:
    b = await (await bench(sysid=1)).connected()
    b.peer.raw(Packer(b.peer.dialect, 2, 1).pack("STATUSTEXT", text="somebody else's trouble"))
    b.peer.raw(Packer(b.peer.dialect, 1, 100).pack("STATUSTEXT", text="the camera's"))
    said = await b.event("the camera's")
    assert said["detail"]["component"] == 100
    assert texts(b.events, "statustext") == ["the camera's"]


async def test_what_is_said_before_anybody_is_known_is_kept(bench: StartBench, peer: StartPeer) -> None:
    one = await peer()
    one.beating = False
    b = await bench(one)
    await one.until(lambda: bool(one.told), "companion")
    one.send("STATUSTEXT", severity=6, text="ArduPilot Ready")
    await b.event("ArduPilot Ready")


async def reached(b: Bench, mode: str, armed: bool) -> None:
    await b.state(lambda s: (s["mode"], s["armed"]) == (mode, armed), f"{mode} and armed {armed}")


async def test_modes_and_arming(bench: StartBench) -> None:
    b = await (await bench()).connected()
    for mode, armed in ((4, False), (4, True), (9, True), (9, False), (77, False)):
        b.peer.mode, b.peer.armed = mode, armed
        await reached(b, NAMES[mode], armed)
    await b.event("mode MODE_77")
    assert texts(b.events, "mode") == ["mode STABILIZE", "mode GUIDED", "mode LAND", "mode MODE_77"]
    assert texts(b.events, "armed") == ["armed", "disarmed"]


async def test_a_flood_gives_few_events_and_says_how_many_were_left_out(bench: StartBench) -> None:
    b = await (await bench()).connected()
    tx = b.vehicle.adapter.tx
    told = len(b.peer.told)
    for sent in range(100, 1001, 100):  # more at once than the adapter keeps would be left out unseen
        for _ in range(100):
            b.ground.put(keys.TX, b"nonsense", sys=1, comp=1, msg="HEARTBEAT")
        await b.state(lambda s, sent=sent: tx.refused == sent, "all refused")  # type: ignore[misc]

    def refusals() -> list[dict[str, Any]]:
        return [e for e in b.events.objects() if e["kind"] == "refused"]

    few = len(refusals())
    assert few < 20
    # The next to be said tells how many were not.
    while len(refusals()) == few or "left_out" not in refusals()[-1]["detail"]:
        b.ground.put(keys.TX, b"nonsense", sys=1, comp=1, msg="HEARTBEAT")
        await b.state(lambda s: True, "a moment")
    said = refusals()
    counted = len(said) + sum(e["detail"].get("left_out", 0) for e in said)
    assert 1000 < counted <= tx.refused
    assert counted >= tx.refused - 10
    assert {t.source for t in b.peer.told[told:]} == {(1, 191)}


async def test_who_comes_late_is_told_what_happened_before(bench: StartBench) -> None:
    b = await (await bench()).connected()
    for n in range(5):
        b.peer.send("STATUSTEXT", severity=4, text=f"before {n}")
    await b.event("before 4")
    late: list[str] = []
    done = b.ground.samples(keys.STATE)
    subscriber = zenoh.ext.declare_advanced_subscriber(
        b.ground.session,
        keys.EVENT.key("demo", "quad1"),
        lambda sample: late.append(sample.payload.to_bytes().decode()),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )
    await done.until(lambda: any("before 4" in text for text in late), "the past")
    assert [n for n in range(5) for text in late if f"before {n}" in text] == [0, 1, 2, 3, 4]
    assert any("system id 1" in text for text in late)
    subscriber.undeclare()


@pytest.mark.parametrize("words", ["", "x" * 50, "ünïcode", 'quote" and \\ and \n'])
async def test_any_words(bench: StartBench, words: str) -> None:
    b = await (await bench()).connected()
    b.peer.send("STATUSTEXT", severity=4, text=words)
    b.peer.send("STATUSTEXT", severity=4, text="the end")
    await b.event("the end")
    assert texts(b.events, "statustext") == [words, "the end"]


async def test_words_that_are_no_text(bench: StartBench) -> None:
    b = await (await bench()).connected()
    frame = bytearray(b.peer.packer.pack("STATUSTEXT", severity=4, text="abc"))
    assert frame[11:14] == b"abc"
    b.peer.raw(stitched(b, bytes(frame).replace(b"abc", b"\xff\xfe\xfd")))
    said = await b.events.object(lambda e: e["kind"] == "statustext", "some words")
    assert said["text"] == "\N{REPLACEMENT CHARACTER}" * 3


def stitched(b: Bench, frame: bytes) -> bytes:
    """The frame with a true checksum."""
    end = 10 + frame[1]
    return frame[:end] + checksum(frame[1:end], b.peer.dialect.message("STATUSTEXT").crc_extra).to_bytes(2, "little")


# Texts in pieces, and events without words.


def piece(b: Bench, text: str, number: int, seq: int) -> None:
    b.peer.send("STATUSTEXT", severity=2, text=text, id=number, chunk_seq=seq)


async def test_texts_in_pieces_are_one_event_each(bench: StartBench) -> None:
    b = await (await bench()).connected()
    one, two = "PreArm: " + "a" * 42, "Crash: " + "b" * 43
    piece(b, one, 7, 0)
    piece(b, two, 8, 0)
    piece(b, " and so on", 7, 1)
    piece(b, " and so on", 7, 1)
    piece(b, " and on", 8, 1)
    b.peer.send("STATUSTEXT", severity=6, text="last")
    await b.event("last")
    assert texts(b.events, "statustext") == [one + " and so on", two + " and on", "last"]
    assert [e["severity"] for e in b.events.objects() if e["kind"] == "statustext"] == ["critical", "critical", "info"]


async def test_a_text_whose_end_does_not_come_is_said_all_the_same(bench: StartBench) -> None:
    b = await (await bench()).connected()
    piece(b, "PreArm: " + "a" * 42, 7, 0)
    said = await b.event("PreArm")
    assert said["text"] == "PreArm: " + "a" * 42 + "[...]"
    assert said["detail"] == {"component": 1, "incomplete": True}


async def test_a_refusal_gives_the_whole_words_even_where_their_end_is_lost(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.results[ARM] = [FAILED]
    await ready(b)
    long = "Arm: Compass not calibrated, and the battery is below " + "what it should be to take off with this load"
    acknowledge = b.peer.acknowledge

    def explain(number: int, result: int, to: tuple[int, int] = (0, 0)) -> None:
        acknowledge(number, result, to)
        if number == ARM:
            for seq, start in enumerate(range(0, len(long) - lost, 50)):
                piece(b, long[start : start + 50], 9 + lost, seq)

    b.peer.acknowledge = explain  # type: ignore[method-assign]
    for left, words in ((0, long), (len(long) - 50, long[:50] + "[...]")):
        lost = left
        with pytest.raises(Refused) as caught:
            await b.ground.do("arm", ready_timeout=0.0)
        assert caught.value.detail["reasons"] == [words]


async def ready(b: Bench) -> None:
    """Fit for arming, so that it is the autopilot that refuses."""
    b.peer.send("EKF_STATUS_REPORT", flags=0x33F)
    b.peer.send("SYS_STATUS", onboard_control_sensors_health=0x10000000)
    await b.state(lambda s: s["ready"], "ready")


def event_frame(number: int, sequence: int, levels: int, extra: int = CRC_EXTRA, sysid: int = 1) -> bytes:
    payload = struct.pack("<IIHBBB40s", number, 1000, sequence, 0, 0, levels, b"\x07\x2a")
    payload = payload.rstrip(b"\0")
    body = bytes((len(payload), 0, 0, 0, sysid, 1)) + (410).to_bytes(3, "little") + payload
    return b"\xfd" + body + checksum(body, extra).to_bytes(2, "little")


async def test_px4_s_events_come_by_number(bench: StartBench) -> None:
    b = await (await bench(autopilot=12)).connected()
    for frame in (
        event_frame(0x01000001, 10, 0x63),
        event_frame(0x01000001, 10, 0x63),  # again, for somebody who missed it
        event_frame(0x01000002, 11, 0x68),  # for protocols only
        event_frame(0x01000003, 12, 0x64, extra=CRC_EXTRA ^ 1),  # no event at all
        event_frame(0x01000004, 13, 0x64, sysid=2),  # another vehicle's
        event_frame(0x01000005, 15, 0x66),
        event_frame(0x01000006, 3, 0x60),  # it has restarted
    ):
        b.peer.raw(frame)
    await b.event("0x01000006")
    said = [e for e in b.events.objects() if e["kind"] == "numbered"]
    assert [(e["text"], e["severity"], e["detail"].get("missed")) for e in said] == [
        ("PX4 event 0x01000001 (072a)", "error", None),
        ("PX4 event 0x01000005 (072a)", "info", 3),
        ("PX4 event 0x01000006 (072a)", "emergency", None),
    ]
    assert said[0]["detail"]["id"] == 0x01000001
    assert b.vehicle.events.texts_since(0.0)[-1] == "PX4 event 0x01000006 (072a)"
