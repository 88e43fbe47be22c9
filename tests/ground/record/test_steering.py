"""A recording at a timeline: it is paused, played faster and from elsewhere, and goes on after its end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ground.record.folder import Record
from ground.record.sources import Tlogs
from ground.record.steering import LEAD_S, SteeredPlayer
from tests.ground.record.conftest import Frames
from tests.ground.record.test_replay import START_US, tlog

BEGIN = START_US / 1e6
SECONDS = 60


class Played:
    """A minute with a frame a tenth of a second, and what was played of it: seconds after the beginning."""

    def __init__(self, path: Path) -> None:
        times = [n / 10.0 for n in range(SECONDS * 10 + 1)]
        self.at: list[float] = []
        self.player = SteeredPlayer([(Tlogs("a", [tlog(path / "a.tlog", Frames(), *times)]), self._take)])
        self.player.start()

    def _take(self, record: Record) -> None:
        self.at.append(round(record.at / 1e9 - BEGIN, 3))

    def until(self, true: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 20.0
        while not true():
            assert time.monotonic() < deadline, (self.player.playing, self.at[-3:])
            time.sleep(0.01)


@pytest.fixture
def played(tmp_path: Path) -> Iterator[Played]:
    played = Played(tmp_path)
    yield played
    played.player.close()
    assert played.player.over.is_set() and played.player.error is None


def test_it_says_where_it_is_and_runs_as_fast_as_is_asked(played: Played) -> None:
    played.until(lambda: len(played.at) > 3)
    told = played.player.playing
    assert (told.begin, told.end, told.speed, told.paused) == (BEGIN, BEGIN + SECONDS, 1.0, False)
    assert told.begin <= told.at <= told.end
    began, cpu = time.monotonic(), played.at[-1]
    played.player.steer(speed=20.0)
    played.until(lambda: played.at[-1] > cpu + 20.0)
    assert 0.9 < time.monotonic() - began < 8.0, "20 s take one, and no less"


def test_paused_it_stands_and_goes_on_where_it_was(played: Played) -> None:
    played.until(lambda: len(played.at) > 2)
    played.player.steer(paused=True)
    time.sleep(0.2)
    count = len(played.at)
    time.sleep(0.5)
    assert len(played.at) == count and played.player.playing.paused
    played.player.steer(paused=False)
    played.until(lambda: len(played.at) > count + 2)
    assert played.at == sorted(played.at) and len(set(played.at)) == len(played.at), "nothing is left out or told twice"


def test_a_place_that_is_asked_for_is_shown_at_once_also_while_it_is_paused(played: Played) -> None:
    played.until(lambda: bool(played.at))
    played.player.steer(paused=True, to=40.0)
    played.until(lambda: played.player.playing.at == pytest.approx(BEGIN + 40.0))
    played.until(lambda: played.at[-1] == 40.0)
    assert min(at for at in played.at if at > 5.0) == pytest.approx(40.0 - LEAD_S)
    played.player.steer(to=10.0)
    played.until(lambda: played.at[-1] == 10.0)
    played.player.steer(to=1e9)
    played.until(lambda: played.player.playing.at == BEGIN + SECONDS)


def test_at_its_end_it_is_paused_and_begins_again_when_it_is_to_go_on(played: Played) -> None:
    played.player.steer(to=58.0, speed=20.0)
    played.until(lambda: played.player.playing.paused)
    assert played.at[-1] == SECONDS and not played.player.over.is_set()
    played.player.steer(paused=False, speed=1.0)
    played.until(lambda: 0.0 < played.at[-1] < 5.0)


def test_what_cannot_be_read_any_more_is_said(tmp_path: Path) -> None:
    path = tlog(tmp_path / "a.tlog", Frames(), 0.0, 30.0)
    player = SteeredPlayer([(Tlogs("a", [path]), lambda record: path.unlink(missing_ok=True))])
    player.start()
    deadline = time.monotonic() + 10.0
    while path.exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    player.steer(to=20.0)
    assert player.over.wait(10.0) and isinstance(player.error, OSError)
    player.close()
