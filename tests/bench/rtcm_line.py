"""What corrections cost the commands beside them on a line of 57,600 baud: ``python -m tests.bench.rtcm_line``.

A pseudo-terminal is read at the line's pace; a command is sent each 0.23 s, and a rich base's moment of 2.4 kB each
second. ``paced`` is how a vehicle's agent sends them, ``at once`` what a station that injects them would do.
"""

from __future__ import annotations

import os
import pty
import statistics
import threading
import time
import tty
from collections.abc import Iterator

from tests.rtcm import base_at, message
from zmav.corrections import Batch
from zmav.formats.rtcm3 import Message
from zmav.links import open_link
from zmav.mavlink import Packer, Splitter, decode, load_dialect
from zmav.mavlink.rtcm import fields
from zmav.services.corrections.outgoing import AROUND, Outgoing, Pace

BAUD = 57600
LINE = BAUD / 10.0
PIECE = 29
"""bytes that are read at a time: 5 ms of the line"""
COMMAND_S, LASTS_S = 0.23, 20.0


class Line:
    """Reads what was written at the line's pace, and notes when each command was through."""

    def __init__(self) -> None:
        self._master, slave = pty.openpty()
        for end in (self._master, slave):
            tty.setraw(end)
        self.path = os.ttyname(slave)
        self.through: dict[int, float] = {}
        self.fragments = 0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        dialect = load_dialect()
        splitter, at = Splitter(dialect), time.monotonic()
        while data := os.read(self._master, PIECE):
            at = max(at, time.monotonic()) + len(data) / LINE
            time.sleep(max(at - time.monotonic(), 0.0))
            for frame in splitter.feed(data):
                if dialect.name_of(frame.msgid) == "COMMAND_LONG":
                    self.through[int(decode(frame, dialect)["param3"])] = time.monotonic()
                else:
                    self.fragments += 1


def moment(seed: int) -> Batch:
    sizes = {1077: 700, 1087: 500, 1097: 700, 1127: 500}
    data = [base_at(), *(message(number, size=size, seed=seed) for number, size in sizes.items())]
    return Batch(0, 1, 1, round(time.time() * 1e6), seed, "bench", tuple(map(Message, data)))


def run(how: str, capacity: float | None) -> str:
    line, packer = Line(), Packer(load_dialect(), 1, 191)
    queue, pace = Outgoing(), Pace(lambda: capacity)
    sent: dict[int, float] = {}
    pieces: Iterator[tuple[int, bytes]] = iter(())
    with open_link(f"serial:{line.path}:{BAUD}") as link:
        link.start(lambda data: None, lambda state, text: None)
        time.sleep(0.5)
        began = time.monotonic()
        moments = 0
        while (now := time.monotonic()) < began + LASTS_S:
            if now > began + len(sent) * COMMAND_S:
                number = len(sent) + 1
                sent[number] = now
                link.send(packer.pack("COMMAND_LONG", command=400, param1=1.0, param3=float(number), param7=1.0))
            if how != "none" and now > began + moments:
                queue.put(moment(moments))
                moments += 1
            if pace.wait(now) <= 0.0:
                piece = next(pieces, None)
                if piece is None and (waiting := queue.next(time.time())) is not None:
                    pieces = queue.pieces(waiting.message)
                    piece = next(pieces)
                if piece is not None:
                    link.send(packer.pack("GPS_RTCM_DATA", **fields(*piece)))
                    pace.spend(len(piece[1]) + AROUND, now)
            time.sleep(0.002)
        time.sleep(1.0)
    delays = sorted(1e3 * (line.through[number] - at) for number, at in sent.items() if number in line.through)
    late, lost = delays[int(0.95 * len(delays))], len(sent) - len(delays)
    words = f"{statistics.median(delays):.0f}/{late:.0f}/{delays[-1]:.0f} ms (median, 95 %, most), {lost} lost"
    flow = f"{line.fragments / LASTS_S:.1f} fragments/s, dropped {dict(queue.dropped)}"
    return f"{how}: {len(sent)} commands {words}; {flow}"


def main() -> None:
    print(run("none", LINE))
    print(run("paced", LINE))
    print(run("at once", None))


if __name__ == "__main__":
    main()
