"""Replay links: exactly the recorded frames, in order, at their time by a clock that the test feeds; a clear end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.links import LinkState, ReplayLink, ReplayUrl, open_link

if TYPE_CHECKING:
    from tests.links.conftest import Watch

PATIENCE_S = 30.0
START_US = 1_790_000_000_000_000
Frames = Callable[[int], list[bytes]]


def write_log(path: Path, records: list[tuple[float, bytes]], start_us: int = START_US) -> Path:
    """A recording of (seconds after the start, frame)."""
    path.write_bytes(b"".join((start_us + round(at * 1e6)).to_bytes(8, "big") + frame for at, frame in records))
    return path


class Clock:
    """A clock that moves only when somebody waits on it."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def pause(self, seconds: float) -> bool:
        assert seconds > 0
        self.time += seconds
        return False


def play(url: ReplayUrl) -> list[tuple[float, bytes]]:
    """(seconds after the first, frame) as delivered by a fed clock, to the end of the recording."""
    clock = Clock()
    link = ReplayLink(url, clock.now, clock.pause)
    delivered: list[tuple[float, bytes]] = []
    link.start(lambda data: delivered.append((clock.time, data)), lambda state, detail: None)
    assert link.wait(LinkState.DOWN, PATIENCE_S)
    link.close()
    return [(round(at - delivered[0][0], 6), frame) for at, frame in delivered]


@pytest.mark.parametrize("speed", [1.0, 4.0, 0.5])
def test_frames_come_at_their_time(tmp_path: Path, frames: Frames, speed: float) -> None:
    times = [0.0, 0.01, 0.01, 0.5, 2.0, 2.0, 12.25]
    records = list(zip(times, frames(7), strict=True))
    log = write_log(tmp_path / "a.tlog", records)
    assert play(ReplayUrl(str(log), speed)) == [(at / speed, frame) for at, frame in records]


def test_as_fast_as_possible_waits_never(tmp_path: Path, frames: Frames) -> None:
    records = [(float(n), frame) for n, frame in enumerate(frames(50))]
    log = write_log(tmp_path / "a.tlog", records)
    assert play(ReplayUrl(str(log), 0.0)) == [(0.0, frame) for _, frame in records]


def test_a_clock_that_was_set_is_no_wait(tmp_path: Path, frames: Frames) -> None:
    """Backwards, or more than a minute forwards at once: played as no time at all, then on in step."""
    times = [5.0, 6.0, 1.0, 2.0, 7200.0, 7201.0]
    log = write_log(tmp_path / "a.tlog", list(zip(times, frames(6), strict=True)))
    assert [at for at, _ in play(ReplayUrl(str(log)))] == [0.0, 1.0, 1.0, 2.0, 2.0, 3.0]


def test_a_slow_reader_does_not_shift_what_follows(tmp_path: Path, frames: Frames) -> None:
    """Anyone who is late catches up: the schedule is the recording's, not one wait after another."""
    log = write_log(tmp_path / "a.tlog", [(float(n), frame) for n, frame in enumerate(frames(6))])
    clock = Clock()
    link = ReplayLink(ReplayUrl(str(log)), clock.now, clock.pause)
    seen: list[float] = []

    def on_data(data: bytes) -> None:
        seen.append(clock.time - 100.0)
        if len(seen) == 2:
            clock.time += 2.5  # this frame takes long to handle

    link.start(on_data, lambda state, detail: None)
    assert link.wait(LinkState.DOWN, PATIENCE_S)
    link.close()
    assert seen == pytest.approx([0.0, 1.0, 3.5, 3.5, 4.0, 5.0])


def test_states_counters_and_end(watch: Watch, tmp_path: Path, frames: Frames) -> None:
    log = write_log(tmp_path / "a.tlog", [(0.0, frame) for frame in frames(20)])
    watched = watch(f"replay:{log}")
    link = watched.link
    assert isinstance(link, ReplayLink)
    assert link.wait(LinkState.DOWN, PATIENCE_S)
    assert link.wait(LinkState.DOWN, PATIENCE_S)
    assert watched.pieces == frames(20)
    assert watched.states == [
        (LinkState.CONNECTING, f"opening replay:{log}"),
        (LinkState.UP, f"playing {log}, 1 times real time"),
        (LinkState.DOWN, "end of recording"),
    ]
    counters = link.counters
    assert (counters.opens, counters.rx_bytes, counters.skipped) == (1, len(b"".join(frames(20))), 0)
    assert counters.last_error is None


def test_a_recording_does_not_listen(watch: Watch, tmp_path: Path, frames: Frames) -> None:
    log = write_log(tmp_path / "a.tlog", [(0.0, frames(1)[0]), (30.0, frames(1)[0])])
    watched = watch(f"replay:{log}")
    watched.expect_state(LinkState.UP)
    assert watched.link.send(b"land!") is False
    assert watched.link.counters.tx_dropped == 1
    assert watched.link.counters.tx_bytes == 0


def test_close_in_the_middle_of_a_wait(tmp_path: Path, frames: Frames) -> None:
    log = write_log(tmp_path / "a.tlog", [(0.0, frames(2)[0]), (50.0, frames(2)[1])])
    link = open_link(f"replay:{log}")
    first, heard = threading.Event(), []

    def on_data(data: bytes) -> None:
        heard.append(data)
        first.set()

    link.start(on_data, lambda state, detail: None)
    assert first.wait(PATIENCE_S)
    link.close()
    assert link.state is LinkState.CLOSED
    assert heard == frames(1)


def test_a_file_without_records_ends_at_once(watch: Watch, tmp_path: Path) -> None:
    log = tmp_path / "a.tlog"
    log.write_bytes(b"no recording at all\n" * 40)
    watched = watch(f"replay:{log}")
    watched.expect_state(LinkState.DOWN, f"{log} holds no MAVLink records")
    assert watched.pieces == []
    assert watched.link.counters.skipped == 800
    assert watched.link.counters.last_error == f"{log} holds no MAVLink records"
    assert watched.link.wait(LinkState.DOWN, PATIENCE_S)


def test_damage_is_skipped_and_told(watch: Watch, tmp_path: Path, frames: Frames) -> None:
    log = write_log(tmp_path / "a.tlog", [(0.0, frame) for frame in frames(10)])
    data = log.read_bytes()
    half = len(data) // 2
    size = 8 + len(frames(10)[-1])
    log.write_bytes(b"junk" + data[: len(data) - size] + data[len(data) - size : -3])
    watched = watch(f"replay:{log}?speed=max")
    watched.expect_state(LinkState.DOWN, "end of recording")
    assert watched.pieces == frames(9)
    assert half > 0
    assert watched.link.counters.skipped == 4 + size - 3
    assert watched.link.counters.last_error == (
        f"{log}: ends in the middle of a record: {size - 3} bytes at offset {4 + len(data) - size} dropped"
    )


def test_file_that_vanished_and_came_back(watch: Watch, tmp_path: Path, frames: Frames) -> None:
    log = write_log(tmp_path / "a.tlog", [(0.0, frames(1)[0])])
    link = open_link(f"replay:{log}")
    log.unlink()
    watched = watch(link)
    after = watched.expect_state(LinkState.DOWN, f"cannot open {log}: No such file or directory")
    write_log(log, [(0.0, frames(1)[0])])
    watched.expect_state(LinkState.DOWN, "end of recording", after)
    assert watched.pieces == frames(1)


@pytest.mark.parametrize("name", ["copter", "copter_params", "plane", "rover", "px4", "px4_three"])
def test_real_recordings_frame_by_frame(watch: Watch, shared_data: Path, name: str) -> None:
    log = (shared_data / f"{name}.tlog").read_bytes()
    expected, at = [], 0
    while at < len(log):
        end = at + 8 + 12 + log[at + 9] + (13 if log[at + 10] & 1 else 0)
        expected.append(log[at + 8 : end])
        at = end
    watched = watch(f"{shared_data / name}.tlog?speed=max")
    watched.expect_state(LinkState.DOWN, "end of recording")
    assert watched.pieces == expected
