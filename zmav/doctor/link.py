"""What ``zmav doctor --link`` does: open a link as ``zmav up`` would, and say what is heard on it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import msgspec

from zmav.autopilots import autopilot_for, kind_of
from zmav.doctor import topics
from zmav.doctor.findings import Finding
from zmav.doctor.serial import check_device
from zmav.doctor.ways import loss_level
from zmav.errors import BadInput
from zmav.links import Link, LinkState, SerialLink, open_link
from zmav.links.url import SerialUrl, parse_url
from zmav.mavlink import Packer, Splitter, decode, load_dialect
from zmav.services.link.identity import AUTOPILOT_INVALID, NOT_AUTOPILOTS

MAX_BAD_CRC = 0.01
MENDING = "look at baud rate and cable, and at net.core.rmem_max"
BAUD_SEARCH = 12.0
"""s that listening at one baud rate after the other may take"""


class FrameCounter:
    """What has been heard on a link; its thread brings the bytes."""

    def __init__(self, dialect: str) -> None:
        self.dialect = load_dialect(dialect)
        self.splitter = Splitter(self.dialect)
        self.heartbeats: dict[tuple[int, int], dict[str, Any]] = {}
        self._heartbeat = self.dialect.message("HEARTBEAT").id

    def count(self, data: bytes) -> None:
        for frame in self.splitter.feed(data):
            if frame.msgid == self._heartbeat:
                self.heartbeats[frame.sysid, frame.compid] = decode(frame, self.dialect)

    def autopilots(self) -> list[tuple[int, int]]:
        """The (system, component) of each, by its HEARTBEAT."""
        return [
            source
            for source, fields in sorted(self.heartbeats.items())
            if fields["autopilot"] != AUTOPILOT_INVALID and fields["type"] not in NOT_AUTOPILOTS
        ]

    def lost(self) -> tuple[int, int]:
        """Frames lost and come of the autopilots themselves: of what they pass on from others they leave out some."""
        sources = [self.splitter.sources[source] for source in self.autopilots()]
        return sum(s.lost for s in sources), sum(s.frames for s in sources)


def examine_link(url: str, dialect: str, seconds: float, user: str | None = None) -> list[Finding]:
    """Findings about a link, after ``seconds`` of it (more where a baud rate must be found).

    A serial device that somebody has open, or ``user`` may not open, is left alone.
    """
    try:
        serial, link, counter = serial_of(url), open_link(url), FrameCounter(dialect)
    except BadInput as e:
        return [topics.OPEN.wrong(e.message, "'zmav up --help' shows what a link looks like")]
    found: list[Finding] = []
    if serial is not None:
        found, free = check_device(serial.path, user)
        if not free:
            return found
    with link:
        link.start(counter.count, lambda state, detail: None)
        if serial is not None and serial.baud is None:
            _find_baud(link)
        _converse(link, Packer(counter.dialect, 1, 191), seconds)
        state, detail = link.state, link.detail
    noise = counter.splitter.counters.bytes and not counter.splitter.counters.frames
    if noise and serial is not None and serial.baud is not None:
        heard = _baud_of(serial)
        if heard is not None:
            text = f"MAVLink is heard at {heard} baud, and not at {serial.baud}"
            found.append(
                topics.OPEN.wrong(text, f'write link = "{serial.path},{heard}", or set the autopilot\'s baud rate')
            )
            return found
    return found + list(_judge(link, counter, state, detail))


def examine_device(url: str, user: str | None = None) -> list[Finding]:
    """What can be said of a serial link without opening it; nothing of any other."""
    try:
        serial = serial_of(url)
    except BadInput as e:
        return [topics.OPEN.wrong(e.message, "'zmav up --help' shows what a link looks like")]
    return check_device(serial.path, user)[0] if serial is not None else []


def serial_of(url: str) -> SerialUrl | None:
    """What a link's URL says of a serial device; None where it is none. Raises :class:`~zmav.errors.BadUrl`."""
    parsed = parse_url(url)
    return parsed if isinstance(parsed, SerialUrl) else None


def _find_baud(link: Link) -> None:
    end = time.monotonic() + BAUD_SEARCH
    while link.state is LinkState.CONNECTING and time.monotonic() < end:
        link.wait(LinkState.UP, 0.2)


def _baud_of(serial: SerialUrl) -> int | None:
    """The rate at which MAVLink is heard on the device; None: not found in time."""
    link = SerialLink(msgspec.structs.replace(serial, baud=None))
    with link:
        link.start(lambda data: None, lambda state, detail: None)
        _find_baud(link)
        return link.baud if link.state is LinkState.UP else None


def _converse(link: Link, packer: Packer, seconds: float) -> None:
    """Our HEARTBEAT once a second, as ``zmav up`` sends it: some autopilots are silent until they are spoken to."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        link.send(packer.pack("HEARTBEAT", type=18, autopilot=AUTOPILOT_INVALID, system_status=4, mavlink_version=3))
        time.sleep(min(left, 1.0))


def _judge(link: Link, counter: FrameCounter, state: LinkState, detail: str) -> Iterator[Finding]:
    counts = counter.splitter.counters
    up = state is LinkState.UP or bool(counts.bytes)
    if not up:
        yield topics.OPEN.wrong(f"{link.url}: {detail}", "is the address right, and the other end on?")
        return
    yield topics.OPEN.well(f"{link.url}: {detail}")
    if not counts.frames:
        found = f"{counts.bytes} bytes, but no MAVLink in them" if counts.bytes else "not a byte"
        advice = "is the baud rate right, and the autopilot's port set to MAVLink? does another program hold the port?"
        yield topics.TRAFFIC.wrong(found, advice)
        return
    (lost, came), bad, dropped = counter.lost(), counts.bad_crc, link.counters.rx_dropped
    found = f"{counts.bytes} bytes, {counts.frames} frames ({counts.unknown} unknown), {lost} lost, {bad} damaged"
    found += f", {dropped} dropped by the kernel" if dropped else ""
    level = loss_level(lost / (came + lost)) if lost else "ok"
    if level == "bad" or bad > MAX_BAD_CRC * (counts.frames + bad) or dropped:
        yield topics.TRAFFIC.wrong(found, MENDING)
    else:
        yield topics.TRAFFIC.well(found) if level == "ok" else topics.TRAFFIC.advise(found, MENDING)
    yield from _systems(counter)


def _systems(counter: FrameCounter) -> Iterator[Finding]:
    autopilots = counter.autopilots()
    for (sysid, compid), fields in sorted(counter.heartbeats.items()):
        if (sysid, compid) in autopilots:
            what = f"{autopilot_for(fields['autopilot'], fields['type']).name} {kind_of(fields['type'])}"
        else:
            kind = counter.dialect.enum_name("MAV_TYPE", fields["type"]) or str(fields["type"])
            what = kind.removeprefix("MAV_TYPE_").lower().replace("_", " ")
        yield topics.SYSTEM.well(what, f"{sysid}/{compid}")
    if not autopilots:
        advice = "is this the autopilot's port, and does it send HEARTBEAT there?"
        yield topics.AUTOPILOT.wrong("none among what is heard", advice)
    elif len(autopilots) > 1:
        yield topics.AUTOPILOT.well(f"{len(autopilots)} on this link: choose one for 'zmav up' with --sysid")
