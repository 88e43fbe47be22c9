"""How pictures are made smaller or fewer, in this order: quality, rate to a half, half size, quality of that, rate.

Quality goes first because a helipad is still found at 40; the rate before the size because a halved picture shows a
small symbol only half as far away; and when there is room for a few pictures only, they are small ones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agents.camera.settings import CameraSettings
from zmav.vision.chunks import count_of
from zmav.vision.parity import needed

WORST_QUALITY = 30
ROOM = 0.95
"""of the budget that pictures are planned to take"""
UP = 0.8
"""of the budget that a better step must fit in: else two steps would take turns"""
LEARNS = 0.3
"""weight of the newest picture in what pictures are expected to be"""
HALF_BYTES, PER_QUALITY = 0.3, 1.1
"""bytes of a half picture beside a whole one; exponent of bytes over quality: until both are measured"""
SLOWEST = 0.2
"""Hz; where not even that fits, pictures come as the budget lets them"""


class QualityStep(NamedTuple):
    """One way to make pictures."""

    half: bool
    quality: int
    rate: float
    """Hz"""

    @property
    def words(self) -> str:
        return f"{'half' if self.half else 'full'} size, quality {self.quality}, {self.rate:.3g} Hz"


class QualitySteps:
    """The steps from best to least, what a picture of each takes, and on which one we are."""

    def __init__(self, settings: CameraSettings) -> None:
        best, rate = settings.quality, settings.rate
        middle, low = (max(round(best * part), min(WORST_QUALITY, best)) for part in (0.8, 0.6))
        slowest = min(SLOWEST, rate)
        self.steps = [
            QualityStep(False, best, rate),
            QualityStep(False, middle, rate),
            QualityStep(False, low, rate),
            QualityStep(True, middle, rate),
            QualityStep(True, low, rate),
        ]
        """from best to least, each at its full rate"""
        self._least = [rate, rate, max(rate / 2.0, slowest), rate, slowest]
        self.step = self.steps[-1]
        """the one that we are on, at the rate that the budget has room for"""
        self._sizes: dict[tuple[bool, int], float] = {}
        self._at = len(self.steps) - 1
        self._first = True

    def learn(self, step: QualityStep, length: int) -> None:
        """A picture of that step had ``length`` bytes."""
        key = step.half, step.quality
        before = self._sizes.get(key, float(length))
        self._sizes[key] = before + LEARNS * (length - before)

    def expected(self, step: QualityStep) -> float:
        """Bytes of a picture, measured or from the measured one that is most like it."""
        key = step.half, step.quality
        if key in self._sizes:
            return self._sizes[key]
        if not self._sizes:
            return (15e3 if step.half else 50e3) * math.pow(step.quality / 70.0, PER_QUALITY)
        like = min(self._sizes, key=lambda each: (each[0] != step.half, abs(each[1] - step.quality)))
        size = self._sizes[like] * math.pow(step.quality / like[1], PER_QUALITY)
        return size * (1.0 if like[0] == step.half else HALF_BYTES if step.half else 1.0 / HALF_BYTES)

    def bytes(self, step: QualityStep, loss: float) -> float:
        """Of a picture with its parity, where a share ``loss`` of chunks is lost."""
        size = self.expected(step)
        count = count_of(max(round(size), 1))
        return size * (count + needed(count, loss)) / count

    def choose(self, budget: float, loss: float) -> QualityStep:
        """The best step that fits at its least rate; a better one than now only where it fits easily."""
        for i, step in enumerate(self.steps):
            room = budget * (ROOM if i >= self._at or self._first else UP)
            fits = room / self.bytes(step, loss)
            if fits >= self._least[i] or step is self.steps[-1]:
                self._at = i
                self.step = step._replace(rate=min(step.rate, max(fits, self._least[i])))
                break
        self._first = not self._sizes
        return self.step
