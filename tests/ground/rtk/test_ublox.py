"""A base receiver over TCP, that is told by UBX what to be: pyubx2 on both sides."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import tty
from collections.abc import AsyncIterator, Callable

import pytest
from pyubx2 import GET, SET, UBXMessage, UBXReader

from ground.rtk.options import Fixed, Receiver, Survey, parse_source
from ground.rtk.receiver import ReceiverSource
from ground.rtk.ublox import UbxCutter
from tests.rtcm import base_at, message

EPOCH = base_at() + message(1074, size=150)


class FakeUblox:
    """Takes CFG-VALSET, surveys itself in for three ticks, and then sends RTCM 3, among NMEA."""

    def __init__(self, refuses: str = "", mute: bool = False) -> None:
        self.refuses, self.mute = refuses, mute
        self.settings: dict[str, object] = {}
        self.taken: list[dict[str, object]] = []
        self.port = 0
        self._server: asyncio.AbstractServer | None = None

    async def open(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        ticking = asyncio.create_task(self._tick(writer))
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                head = await reader.readexactly(6)
                rest = await reader.readexactly(int.from_bytes(head[4:6], "little") + 2)
                told = UBXReader.parse(head + rest, msgmode=SET)
                assert told.identity == "CFG-VALSET"
                pairs = {name: value for name, value in vars(told).items() if name.startswith("CFG_")}
                self.taken.append(pairs)
                if self.mute:
                    continue
                bad = any(self.refuses and self.refuses in name for name in pairs)
                if not bad:
                    self.settings |= pairs
                answer = "ACK-NAK" if bad else "ACK-ACK"
                writer.write(b"$GNTXT,noise*00\r\n" + UBXMessage("ACK", answer, GET, clsID=6, msgID=0x8A).serialize())
        ticking.cancel()

    async def _tick(self, writer: asyncio.StreamWriter) -> None:
        ticks = 0
        while True:
            await asyncio.sleep(0.05)
            mode = self.settings.get("CFG_TMODE_MODE")
            ticks += mode == 1
            if mode == 1 and ticks < 60:
                told = {"dur": ticks, "meanAcc": 50_000 - 500 * ticks, "obs": ticks, "valid": 0, "active": 1}
                writer.write(UBXMessage("NAV", "NAV-SVIN", GET, **told).serialize() + message(1074, seed=ticks))
            elif mode in (1, 2):
                done = UBXMessage("NAV", "NAV-SVIN", GET, dur=60, obs=60, valid=1, active=0).serialize()
                writer.write((done if mode == 1 else b"") + b"$GNGGA,,,*00\r\n" + EPOCH)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()


Started = tuple[FakeUblox, ReceiverSource, list[tuple[str, str]], list[bytes]]


@contextlib.asynccontextmanager
async def started(wanted: Survey | Fixed | None, port: str | None = None, **more: object) -> AsyncIterator[Started]:
    fake, told, data = FakeUblox(**more), list[tuple[str, str]](), list[bytes]()  # type: ignore[arg-type]
    await fake.open()
    source = ReceiverSource(
        Receiver(f"tcp:127.0.0.1:{fake.port}"),
        lambda messages: data.extend(each.data for each in messages),
        lambda state, text: told.append((state, text)),
        wanted,
        port,
    )
    task = asyncio.create_task(source.run())
    try:
        yield fake, source, told, data
    finally:
        task.cancel()
        await asyncio.wait({task})
        fake.close()


async def until(true: Callable[[], bool]) -> None:
    async def wait() -> None:
        while not true():
            await asyncio.sleep(0.02)

    await asyncio.wait_for(wait(), 30.0)


async def test_it_surveys_itself_in_and_says_how_far_it_is() -> None:
    async with started(Survey(120, 1.5)) as (fake, source, told, data):
        await until(lambda: len(data) >= 4)
        assert any(state == "survey" and "observations" in text for state, text in told)
        assert told[-1][0] == "streaming"
    assert b"".join(data[:2]) == EPOCH
    assert fake.settings["CFG_TMODE_SVIN_MIN_DUR"] == 120
    assert fake.settings["CFG_TMODE_SVIN_ACC_LIMIT"] == 15_000
    assert fake.settings["CFG_UART1OUTPROT_RTCM3X"] == 1
    assert fake.settings["CFG_MSGOUT_RTCM_3X_TYPE1005_UART1"] == 1
    assert source.base is not None
    assert source.base.progress is not None


async def test_it_is_told_where_it_is_to_a_tenth_of_a_millimetre() -> None:
    async with started(Fixed(-35.363262123, 149.165237891, 584.1234), "USB") as (fake, _, _, data):
        await until(lambda: len(data) >= 2)
    found = fake.settings
    assert found["CFG_TMODE_LAT"] * 100 + found["CFG_TMODE_LAT_HP"] == -35_363_262_123  # type: ignore[operator]
    assert found["CFG_TMODE_LON"] * 100 + found["CFG_TMODE_LON_HP"] == 149_165_237_891  # type: ignore[operator]
    assert found["CFG_TMODE_HEIGHT"] * 100 + found["CFG_TMODE_HEIGHT_HP"] == 5_841_234  # type: ignore[operator]
    assert found["CFG_USBOUTPROT_RTCM3X"] == 1
    assert fake.taken[1] == {"CFG_TMODE_MODE": 0}, "or a survey-in would go on"


async def test_a_receiver_that_refuses_or_is_silent_is_told_of() -> None:
    async with started(Survey(60, 2.0), refuses="TMODE") as (_, _, told, _):
        await until(lambda: any(s == "refused" and "older than u-blox's generation 9" in t for s, t in told))
    async with started(Survey(60, 2.0), mute=True) as (fake, _, told, _):
        await until(lambda: any(s == "refused" and "does not answer" in t for s, t in told))
        assert len(fake.taken) == 3


@pytest.mark.parametrize("wanted", [Survey(60, 2.0), Fixed(1.0, 2.0, 3.0)])
async def test_nothing_is_sent_of_one_that_is_not_what_it_was_told_to_be(wanted: Survey | Fixed) -> None:
    """It is a base already, of another place: what it sends meanwhile would lead vehicles there."""
    async with started(wanted, refuses="SVIN" if isinstance(wanted, Survey) else "LAT") as (fake, source, told, data):
        fake.settings["CFG_TMODE_MODE"] = 1
        await until(lambda: any(state == "refused" for state, _ in told))
        fake.settings["CFG_TMODE_MODE"] = 2
        await asyncio.sleep(0.5)
        assert not data
        assert source.base is not None
        source.base.told = True
        if isinstance(wanted, Survey):
            await asyncio.sleep(0.5)
            assert not data, "no word on its survey-in"
        else:
            await until(lambda: bool(data))


async def test_a_base_on_a_serial_port() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    data, told = list[bytes](), list[tuple[str, str]]()
    where = parse_source(f"serial:{os.ttyname(slave)}:115200", {})
    assert isinstance(where, Receiver)
    source = ReceiverSource(
        where, lambda messages: data.extend(m.data for m in messages), lambda state, text: told.append((state, text))
    )
    task = asyncio.create_task(source.run())
    os.close(slave)
    while not data:
        os.write(master, b"$GNGGA,,,*00\r\n" + EPOCH)
        await asyncio.sleep(0.1)
    assert b"".join(data[:2]) == EPOCH
    assert told[-1] == ("streaming", f"from {where.url}")
    task.cancel()
    await asyncio.wait({task})
    os.close(master)


async def test_one_that_is_a_base_already_is_told_nothing() -> None:
    async with started(None) as (fake, _, _, data):
        fake.settings["CFG_TMODE_MODE"] = 2
        await until(lambda: len(data) >= 2)
        assert not fake.taken


def test_ubx_is_found_in_whatever_comes() -> None:
    frame = UBXMessage("NAV", "NAV-SVIN", GET, dur=7).serialize()
    stream = b"\xb5\xb5\x62\xff" + b"\xb5\x62\x01\x02\xff\xff" + EPOCH + frame + b"\xb5" + frame + bytes(400)
    for step in (1, 5, 1000):
        cutter = UbxCutter()
        found = [each for at in range(0, len(stream), step) for each in cutter.feed(stream[at : at + step])]
        assert [each.identity for each in found] == ["NAV-SVIN"] * 2


@pytest.mark.unit
def test_garbage_fills_no_memory() -> None:
    cutter = UbxCutter()
    for _ in range(30):
        assert cutter.feed(b"\xb5\x62\x01\x3b\x00\x04" * 100) == []
        assert len(vars(cutter)["_rest"]) < 2048
