"""Track before detect: what is doubtful in each picture and stays in one place on the ground is a pad.

Each sight is put where it lies on the ground, by the vehicle's own place and attitude. A track is tentative while too
few pictures have shown it, and confirmed by M of the last N of them, as radars do it (Blackman and Popoli, "Design and
Analysis of Modern Tracking Systems", 1999, section 6.2), if the mean of its upright patches passes the learned check:
noise and smears differ from picture to picture, and what is no H stays none.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.helipad.check import LearnedCheck
from agents.helipad.detector import Detection, Sight

Image = NDArray[np.float32]

PICTURES, LEAST = 5, 3
"""that a track is judged by, and in how many of them it must be seen"""
SURE = 3.0
"""logarithm of the odds that the mean patch must have"""
GATE, SYMBOLS = 2.0, 0.5
"""a sight belongs to a track within so many standard deviations and heights of the symbol"""
TURNED = math.radians(25.0)
"""within which its bearing must agree"""
FOLLOWED = 3
"""tracks about which the next picture is looked at more closely"""
OLD = 1.0
"""s between two sights of one track at most"""


class Place(NamedTuple):
    """Of a sight on the ground; relative to what carries the pad, where that moves."""

    north: float
    east: float
    deviation: float
    """standard, m"""
    bearing: float
    """rad, modulo pi"""


class Told(NamedTuple):
    """A sight that is believed."""

    number: int
    """among those that were given"""
    detection: Detection
    """its score is of all these pictures"""
    pictures: int
    """that this rests on: 1 where it is sure alone"""
    span: float
    """s from the first of these to this one"""


class _Track:
    def __init__(self, t: float, sight: Sight, place: Place) -> None:
        self.place = place
        self.seen: deque[tuple[float, Image] | None] = deque(maxlen=PICTURES)
        """time and patch of each of the last pictures, None where it was not seen"""
        self.hit(t, sight, place)

    def hit(self, t: float, sight: Sight, place: Place) -> None:
        patch = sight.patch
        if any(self.seen):  # half a turn is not known: the way round that fits better
            mean = self.mean
            patch = max(patch, patch[::-1], key=lambda each: float(each @ mean))
        self.place, self.last, self.odds = place, t, sight.odds
        self.seen.append((t, patch))

    @property
    def mean(self) -> Image:
        """(M,)"""
        return np.asarray(np.mean([each[1] for each in self.seen if each], axis=0), dtype=np.float32)

    def away(self, place: Place) -> float:
        """m; infinite where it cannot be the same."""
        gate = GATE * math.hypot(place.deviation, self.place.deviation)
        off = (place.bearing - self.place.bearing + math.pi / 2.0) % math.pi - math.pi / 2.0
        away = math.hypot(place.north - self.place.north, place.east - self.place.east)
        return away if away <= gate and abs(off) <= TURNED else math.inf


class Tracks:
    """Of the pictures of one camera, one after another; for symbols ``symbol_m`` metres high."""

    def __init__(self, symbol_m: float) -> None:
        self._symbol_m = symbol_m
        self._check = LearnedCheck.built_in()
        self._tracks: list[_Track] = []

    @property
    def wanted(self) -> list[Place]:
        """Where to look again in the next picture: the tracks that are likeliest."""
        return [each.place for each in sorted(self._tracks, key=lambda each: -each.odds)[:FOLLOWED]]

    def told(self, t: float, sights: list[tuple[Sight, Place | None]]) -> list[Told]:
        """Which of the ``sights`` of a picture taken at ``t`` (s) are believed, best first. Those without a place are
        where they are sure alone.
        """
        self._tracks = [each for each in self._tracks if 0.0 <= t - each.last <= OLD and any(each.seen)]
        free = list(self._tracks)
        result: list[Told] = []
        for number, (sight, place) in enumerate(sights):
            track = None if place is None else self._track(free, t, sight, place)
            if sight.sure:
                result.append(Told(number, sight.detection, 1, 0.0))
            elif track is not None and (odds := self._odds(track)) >= SURE:
                times = [each[0] for each in track.seen if each]
                score = sight.correlation / (1.0 + math.exp(-odds))
                found = dataclasses.replace(sight.detection, score=score)
                result.append(Told(number, found, len(times), t - times[0]))
        for missed in free:
            missed.seen.append(None)
        return sorted(result, key=lambda each: -each.detection.score)

    def _track(self, free: list[_Track], t: float, sight: Sight, place: Place) -> _Track:
        """The one of ``free`` that the sight belongs to, which is then no longer free, or a new one."""
        place = place._replace(deviation=place.deviation + SYMBOLS / GATE * self._symbol_m)
        track = min(free, key=lambda each: each.away(place), default=None)
        if track is None or not math.isfinite(track.away(place)):
            self._tracks.append(track := _Track(t, sight, place))
            return track
        free.remove(track)
        track.hit(t, sight, place)
        return track

    def _odds(self, track: _Track) -> float:
        """Logarithm of the odds of the pictures together."""
        if sum(map(bool, track.seen)) < LEAST:
            return -math.inf
        return float(self._check.odds(track.mean[None])[0])
