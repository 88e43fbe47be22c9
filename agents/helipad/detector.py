"""The helipad detector: a frame in, the symbols that are seen out. It knows a camera and a symbol, and no vehicle."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agents.helipad import channels
from agents.helipad.channels import Picture, Pyramid
from agents.helipad.check import LearnedCheck
from agents.helipad.geometry import View
from agents.helipad.refine import heading, window
from agents.helipad.search import ASTRAY, KNOWN, UNKNOWN, YELLOW, Effort, Proposals, Searcher
from zmav.errors import BadInput

Array = NDArray[np.float64]
Image = NDArray[np.float32]

MIN_HEIGHT_M, MAX_HEIGHT_M = 0.5, 13.0
"""where to look when no height is given"""
HEIGHT_STEP = 1.4
"""between the heights that are supposed where none is known; the search at one of them reaches half-way to the next"""
ASTRAY_STEP, ASTRAY_STEPS = 1.5, 2
"""a given height is believed to be wrong by a factor of 2.7 at most"""
MOST_TILT = math.radians(60.0)
REFINE_PX = 26.0
"""height of a symbol in the picture that its place and heading are measured in"""
REFINE_STEPS = 3
SAME = 0.5
"""two detections nearer than this, in heights of the symbol, are of the same one"""
TRACK_REACH = 2.0
"""how far from the last place a track looks, in heights of the symbol"""
TRACK_LEAST_PX = 40.0
LEAST_CORRELATION = 0.5
"""with the symbol, below which the learned check is not believed"""
DOUBTFUL = -3.0
"""logarithm of the odds above which something is a sight"""
MOST_SIGHTS = 8


@dataclasses.dataclass(frozen=True)
class Detection:
    """A symbol in a frame."""

    u: float
    """middle, pixels to the right; 0 is the centre of the first pixel"""
    v: float
    """middle, pixels down"""
    scale_px: float
    """the symbol's height as it is seen, pixels"""
    heading: float
    """where its upright points in the picture: radians clockwise from up, in [0, pi). Of a tilted camera that is
    not the direction on the ground, which :func:`agents.helipad.geolocate.bearing` gives.
    """
    score: float
    """how sure, 0 to 1; only what is taken for the symbol is given at all"""


@dataclasses.dataclass(frozen=True)
class Sight:
    """What may be a symbol in one frame: where several pictures are looked at together, what is doubtful in each may be
    sure in all.
    """

    detection: Detection
    patch: Image
    """(M,) upright, ground at 0 and paint at 1"""
    correlation: float
    """with the symbol, 0 to 1"""
    odds: float
    """logarithm of the odds that the learned check gives"""
    sure: bool
    """alone"""


class Detector:
    """Finds the letter H, ``symbol_height_m`` metres high, in frames of a camera that looks down: white or yellow, in
    the proportions of small pads and of ICAO's. It is its own mirror image, so a mirrored H is an H.

    ``camera_matrix``: (3, 3), pixels. ``distortion``: OpenCV's coefficients (4, 5, 8, 12 or 14), or None.
    ``trust_height``: where nothing is found at the height given, look at no other. Nothing is then found while it is
    wrong by more than 20 %, but a frame with nothing in it costs far less.
    Raises :class:`BadInput`.

    After Coombes et al. 2014 and Ciratefi (Kim and de Araújo 2007); docs/vision.md says what is different. One detector
    belongs to one thread at a time. A result depends on the arguments alone, but for which other height is looked at
    where a given one shows nothing.
    """

    def __init__(
        self,
        camera_matrix: ArrayLike,
        symbol_height_m: float = 0.25,
        *,
        distortion: ArrayLike | None = None,
        trust_height: bool = False,
    ) -> None:
        self._k = k = _numbers("camera_matrix", camera_matrix)
        if k.shape != (3, 3) or k[0, 0] <= 0.0 or k[1, 1] <= 0.0 or k[2].tolist() != [0, 0, 1]:
            raise _bad("camera_matrix", camera_matrix, "(3, 3): fx 0 cx, 0 fy cy, 0 0 1, pixels")
        bent = np.zeros(0) if distortion is None else _numbers("distortion", distortion).ravel()
        if bent.size not in (0, 4, 5, 8, 12, 14):
            raise _bad("distortion", distortion, "4, 5, 8, 12 or 14 numbers")
        self._distortion = bent if bent.any() else None
        self._trust_height = trust_height
        self._symbol_m = _number("symbol_height_m", symbol_height_m, 1e-3, 100.0)
        steps = math.ceil(math.log(MAX_HEIGHT_M / MIN_HEIGHT_M) / math.log(HEIGHT_STEP))
        self._heights = [MAX_HEIGHT_M / HEIGHT_STEP**i for i in range(steps + 1)]
        self._searcher = Searcher()
        self._check = LearnedCheck.built_in()
        self._lost = 0
        """searches with a height that found nothing there: tells which other one is next"""

    def detect(
        self,
        frame_bgr: object,
        height_m: float | None = None,
        roll: float = 0.0,
        pitch: float = 0.0,
        near: Detection | None = None,
    ) -> list[Detection]:
        """The symbols in ``frame_bgr`` ((height, width, 3) BGR or (height, width) grey, uint8), best first.

        ``height_m``: of the camera above the symbol. Without it all heights are searched. Where nothing is found at it
        and about 20 % either way, one of four from 0.44 to 2.25 times of it is searched, less closely and in grey
        alone: the next one in every such frame, so that a wrong height is got over within four frames.
        ``roll``, ``pitch``: of the camera as of a vehicle that carries it, radians (right side down, nose up); without
        them the frame is taken as level, which makes the heading less exact.
        ``near``: look only about this one of the last frame; an empty list says that it is lost.
        Raises :class:`BadInput` for a frame or a number that is none.
        """
        return [each.detection for each in self.sights(frame_bgr, height_m, roll, pitch, near) if each.sure]

    def sights(
        self,
        frame_bgr: object,
        height_m: float | None = None,
        roll: float = 0.0,
        pitch: float = 0.0,
        near: Detection | None = None,
        also: Sequence[tuple[float, float]] = (),
    ) -> list[Sight]:
        """:meth:`detect`, with what is doubtful, too; for :class:`agents.helipad.tracks.Tracks`. ``also``: pixels
        about which there may be one, as doubtful ones were there before; of a search at a height, without ``near``.
        """
        frame = channels.check_frame(frame_bgr)
        height = None if height_m is None else _number("height_m", height_m, 1e-3, 1e5)
        roll = _number("roll", roll, -MOST_TILT, MOST_TILT)
        pitch = _number("pitch", pitch, -MOST_TILT, MOST_TILT)
        if near is not None:
            return self._track(frame, near, height, roll, pitch)
        supposed, effort = (self._heights, UNKNOWN) if height is None else ([height], KNOWN)
        wanted = np.array([each for each in also if height is not None and np.isfinite(each).all()]).reshape(-1, 2)
        grey, found = self._in_grey_or_yellow(frame, (0, 0), supposed, roll, pitch, effort, wanted)
        if not _any_sure(found) and height is not None and not self._trust_height and (others := self._others(height)):
            found += self._search(grey, [others[self._lost % len(others)]], roll, pitch, ASTRAY)
            self._lost += 1
        return _best(found)

    def _others(self, height: float) -> list[float]:
        """The heights to look at when ``height`` is wrong."""
        ratio = ASTRAY_STEP
        low, high = self._heights[-1] / HEIGHT_STEP**0.5, self._heights[0] * HEIGHT_STEP**0.5
        steps = range(-ASTRAY_STEPS, ASTRAY_STEPS + 1)
        return [height * ratio**i for i in steps if i and low <= height * ratio**i <= high]

    def _track(self, frame: Picture, near: Detection, height: float | None, roll: float, pitch: float) -> list[Sight]:
        reach = max(TRACK_REACH * near.scale_px, TRACK_LEAST_PX)
        middle = np.array([near.u, near.v])
        if not (np.isfinite(middle).all() and np.isfinite(reach)):
            raise _bad("near", near, "a detection of numbers")
        part, low = window(frame, middle, reach)
        if min(part.shape[:2], default=0) < 16:
            return []
        if height is None:
            height = self._symbol_m * float(self._k[1, 1]) / max(near.scale_px, 1.0)
        origin = (int(low[0]), int(low[1]))
        return _best(self._in_grey_or_yellow(part, origin, [height], roll, pitch, KNOWN)[1])

    def _in_grey_or_yellow(
        self,
        part: Picture,
        origin: tuple[int, int],
        heights: list[float],
        roll: float,
        pitch: float,
        effort: Effort,
        also: Array | None = None,
    ) -> tuple[Pyramid, list[Sight]]:
        """What is found in the intensity of a part of the frame, else in its yellow; and that intensity."""
        grey = Pyramid(channels.grey(part), origin)
        found = self._search(grey, heights, roll, pitch, effort, also)
        if not _any_sure(found) and (yellow := channels.yellow(part)) is not None:
            paint, (u, v) = yellow
            found += self._search(
                Pyramid(paint, (origin[0] + u, origin[1] + v)),
                heights,
                roll,
                pitch,
                YELLOW if effort is KNOWN else effort,
            )
        return grey, found

    def _search(
        self,
        picture: Pyramid,
        heights: list[float],
        roll: float,
        pitch: float,
        effort: Effort,
        also: Array | None = None,
    ) -> list[Sight]:
        """What may be one at any of ``heights``, each place once, best first."""
        found: list[tuple[float, Proposals, int]] = []
        for height in heights:
            view = View(self._k, self._distortion, height / self._symbol_m, roll, pitch)
            proposals = self._searcher.proposals(picture, view, effort, also)
            odds = self._check.odds(proposals.patches)
            found += [(float(odds[i]), proposals, int(i)) for i in np.flatnonzero(odds > DOUBTFUL)]
        found.sort(key=lambda each: -each[0])
        kept: list[Sight] = []
        for odds_, proposals, i in found:
            if len(kept) < MOST_SIGHTS and _apart(proposals.middles[i], kept):
                correlation = float(np.clip(proposals.correlation[i], 0.0, 1.0))
                sure = odds_ >= effort.sure and correlation >= LEAST_CORRELATION
                place = proposals.middles[i : i + 1], proposals.affines[i : i + 1]
                if sure:
                    place = self._measured(picture, *place)
                score = correlation / (1.0 + math.exp(-odds_))
                kept.append(Sight(_detection(*place, score), proposals.patches[i], correlation, odds_, sure))
        return kept

    def _measured(self, picture: Pyramid, middles: Array, affines: Array) -> tuple[Array, Array]:
        """One place (1, 2) and its affine map (1, 2, 2), aligned once more in a finer picture of what is about it, in
        the proportions that fit best.
        """
        tall = float(np.linalg.norm(affines[0, :, 1]))
        part, low = window(picture.whole, middles[0] - picture.origin, 1.2 * tall + 4.0)
        if min(part.shape) < 8:
            return middles, affines
        here = Pyramid(part, (int(low[0] + picture.origin[0]), int(low[1] + picture.origin[1])))
        fine, factors = here.shrunk(REFINE_PX / tall)
        aligner = self._searcher.aligner
        each = np.arange(len(aligner.masks))
        start = (middles - here.origin + 0.5) * factors - 0.5, affines * factors[:, None]
        placed, turned = aligner.align(
            fine, each, start[0].repeat(len(each), axis=0), start[1].repeat(len(each), axis=0), REFINE_STEPS
        )
        best = int(aligner.correlation(aligner.patches(fine, placed, turned))[each, each].argmax())
        moved = (placed[best : best + 1] + 0.5) / factors - 0.5 + here.origin
        if float(np.linalg.norm(moved - middles)) >= 0.2 * tall:
            return middles, affines
        return moved, turned[best : best + 1] / factors[:, None]


def _detection(middles: Array, affines: Array, score: float) -> Detection:
    return Detection(
        u=float(middles[0, 0]),
        v=float(middles[0, 1]),
        scale_px=float(np.linalg.norm(affines[0, :, 1])),
        heading=float(heading(affines)[0]),
        score=score,
    )


def _apart(middle: Array, kept: list[Sight]) -> bool:
    found = (each.detection for each in kept)
    return all(math.hypot(middle[0] - each.u, middle[1] - each.v) > SAME * each.scale_px for each in found)


def _best(found: list[Sight]) -> list[Sight]:
    """Of sights in several pictures of one frame, each place once, best first."""
    kept: list[Sight] = []
    for each in sorted(found, key=lambda each: (-each.sure, -each.detection.score)):
        if _apart(np.array([each.detection.u, each.detection.v]), kept):
            kept.append(each)
    return kept


def _any_sure(found: list[Sight]) -> bool:
    return any(each.sure for each in found)


def _number(field: str, value: object, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not low <= float(value) <= high:
        raise _bad(field, value, f"a number from {low:g} to {high:g}")
    return float(value)


def _numbers(field: str, value: ArrayLike) -> Array:
    try:
        found = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise _bad(field, value, "numbers") from None
    if not np.isfinite(found).all():
        raise _bad(field, value, "finite numbers")
    return found


def _bad(field: str, value: object, expected: str) -> BadInput:
    return BadInput.wrong(field, repr(value), expected, f"{field} is {value!r}")
