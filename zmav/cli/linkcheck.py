"""What ``zmav doctor --link`` does: open a link as ``zmav up`` would, and say what is heard on it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from zmav.autopilots import autopilot_for, kind_of
from zmav.cli.examine import MAX_BAD_CRC, MAX_LOSS
from zmav.cli.finding import Finding
from zmav.errors import BadInput
from zmav.links import Link, LinkState, SerialLink, open_link
from zmav.mavlink import Packer, Splitter, decode, load_dialect
from zmav.services.identity import AUTOPILOT_INVALID, NOT_AUTOPILOTS

BAUD_SEARCH = 12.0
"""s that listening at one baud rate after the other may take"""


class Ear:
    """What has been heard on a link; fed by its reader thread."""

    def __init__(self, dialect: str) -> None:
        self.dialect = load_dialect(dialect)
        self.splitter = Splitter(self.dialect)
        self.heartbeats: dict[tuple[int, int], dict[str, Any]] = {}
        self._heartbeat = self.dialect.message("HEARTBEAT").id

    def hear(self, data: bytes) -> None:
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


def examine_link(url: str, dialect: str, seconds: float) -> list[Finding]:
    """Findings about a link, after ``seconds`` of it (more where a baud rate must be found)."""
    try:
        link, ear = open_link(url), Ear(dialect)
    except BadInput as e:
        return [Finding(False, "link", e.message)]
    with link:
        link.start(ear.hear, lambda state, detail: None)
        if isinstance(link, SerialLink):
            _find_baud(link)
        _converse(link, Packer(ear.dialect, 1, 191), seconds)
        state, detail = link.state, link.detail
    return list(_judge(link, ear, state, detail))


def _find_baud(link: Link) -> None:
    end = time.monotonic() + BAUD_SEARCH
    while link.state is LinkState.CONNECTING and time.monotonic() < end:
        link.wait(LinkState.UP, 0.2)


def _converse(link: Link, packer: Packer, seconds: float) -> None:
    """Our HEARTBEAT once a second, as ``zmav up`` sends it: some autopilots are silent until they are spoken to."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        link.send(packer.pack("HEARTBEAT", type=18, autopilot=AUTOPILOT_INVALID, system_status=4, mavlink_version=3))
        time.sleep(min(left, 1.0))


def _judge(link: Link, ear: Ear, state: LinkState, detail: str) -> Iterator[Finding]:
    counts = ear.splitter.counters
    up = state is LinkState.UP or bool(counts.bytes)
    yield Finding(up, "link", f"{link.url}: {detail}", "" if up else "is the address right, and the other end on?")
    if not up:
        return
    if not counts.frames:
        found = f"{counts.bytes} bytes, but no MAVLink in them" if counts.bytes else "not a byte"
        advice = "is the baud rate right, and the autopilot's port set to MAVLink? does another program hold the port?"
        yield Finding(False, "traffic", found, advice)
        return
    (lost, came), bad, dropped = ear.lost(), counts.bad_crc, link.counters.rx_dropped
    found = f"{counts.bytes} bytes, {counts.frames} frames ({counts.unknown} unknown), {lost} lost, {bad} damaged"
    well = lost <= MAX_LOSS * (came + lost) and bad <= MAX_BAD_CRC * (counts.frames + bad) and not dropped
    found += f", {dropped} dropped by the kernel" if dropped else ""
    yield Finding(well, "traffic", found, "" if well else "look at baud rate and cable, and at net.core.rmem_max")
    yield from _systems(ear)


def _systems(ear: Ear) -> Iterator[Finding]:
    autopilots = ear.autopilots()
    for (sysid, compid), fields in sorted(ear.heartbeats.items()):
        if (sysid, compid) in autopilots:
            what = f"{autopilot_for(fields['autopilot'], fields['type']).name} {kind_of(fields['type'])}"
        else:
            kind = ear.dialect.enum_name("MAV_TYPE", fields["type"]) or str(fields["type"])
            what = kind.removeprefix("MAV_TYPE_").lower().replace("_", " ")
        yield Finding(True, f"system {sysid}/{compid}", what)
    if not autopilots:
        advice = "is this the autopilot's port, and does it send HEARTBEAT there?"
        yield Finding(False, "autopilot", "none among what is heard", advice)
    elif len(autopilots) > 1:
        yield Finding(True, "autopilot", f"{len(autopilots)} on this link: choose one for 'zmav up' with --sysid")
