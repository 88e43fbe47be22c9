"""Reports of health and arming checks, as events that come one after another."""

from __future__ import annotations

import asyncio
import struct
from unittest import mock

from zmav.autopilots.px4_events import ARMING_SUMMARY, HEALTH_SUMMARY
from zmav.mavlink.event import Event, event_id
from zmav.services.status import px4_events
from zmav.services.status.px4_events import MOST_CHECKS, Checks

GPS, UNKNOWN = event_id("check_estimator_gps_fix_too_low"), event_id("check_of_another_firmware")
HOLD = 1 << 4


def event(number: int, arguments: bytes, level: int = 3) -> Event:
    return Event(number, 0, 0, level, level, arguments.ljust(40, b"\0"))


def report(checks: Checks, can_arm: int, *failing: Event, chunk: int = 0) -> list[bool]:
    assert not checks.hear(event(ARMING_SUMMARY, struct.pack("<BIIII", chunk, 0, 0, can_arm, 0), 8))
    new = [checks.hear(each) for each in failing]
    assert not checks.hear(event(HEALTH_SUMMARY, struct.pack("<BIII", chunk, 0, 0, 0), 8))
    return new


def test_what_stands_against_a_mode_is_told_and_each_check_is_new_once() -> None:
    checks = Checks()
    failing = event(GPS, struct.pack("<IB", HOLD, 3)), event(UNKNOWN, struct.pack("<IB", HOLD << 1, 3))
    assert report(checks, 0, *failing) == [True, True]
    assert report(checks, 0, *failing) == [False, False]
    assert checks.known
    assert checks.against("HOLD") == ["GPS fix too low"]
    assert checks.against("RTL") == [str(failing[1])]
    assert checks.against("MODE_4/99") == ["GPS fix too low", str(failing[1])]
    report(checks, HOLD, *failing)
    assert checks.against("HOLD") == []


def test_a_report_that_is_not_whole_is_none() -> None:
    checks = Checks()
    checks.hear(event(ARMING_SUMMARY, struct.pack("<BIIII", 0, 0, 0, 0, 0), 8))
    assert checks.coming
    checks.lose()
    checks.hear(event(HEALTH_SUMMARY, bytes(13), 8))
    assert not checks.known
    assert checks.against(None) == []


def test_the_end_of_another_report_ends_this_one() -> None:
    checks = Checks()
    checks.hear(event(ARMING_SUMMARY, struct.pack("<BIIII", 1, 0, 0, 0, 0), 8))
    checks.hear(event(HEALTH_SUMMARY, bytes(13), 8))
    assert not checks.known and not checks.coming


async def test_each_loss_is_followed_by_as_many_questions() -> None:
    companion, commander = mock.Mock(), mock.AsyncMock()
    companion.identity.connected, companion.identity.armed = True, False
    texts = px4_events.EventTexts(companion, commander)
    texts.every, texts.ask_every = 0.001, 0.0
    texts.start()
    for loss in range(1, 4):
        while commander.command.await_count < loss * px4_events.ASKS:
            await asyncio.sleep(0.001)
        report(texts.checks, 0)
        await asyncio.sleep(0.05)
        assert commander.command.await_count == loss * px4_events.ASKS
        texts.checks.lose()
    await texts.close()


def test_a_report_without_end_is_bounded() -> None:
    checks = Checks()
    report(checks, 0, *(event(number, b"\xff" * 5) for number in range(3 * MOST_CHECKS)))
    assert len(checks._heard) <= MOST_CHECKS
    assert len(checks.against(None)) == 5
