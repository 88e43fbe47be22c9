"""Pictures one after another, as a vehicle takes them that drifts above a pad: the same ground, pad and light, another
place, attitude, blur and noise in each; and what happens to a pad meanwhile.

The ground's x is east and its y is south, metres; a level camera of yaw 0 is as in :mod:`generator`.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.helipad import Detection, Detector
from agents.helipad.geometry import View
from agents.helipad.tracks import Place, Told, Tracks
from tests.agents.helipad.generator import (
    CAMERA,
    SIZE,
    SYMBOL_M,
    Frame,
    Pad,
    Truth,
    Wear,
    ground_to_picture,
    project,
    random_pad,
    render,
    truth_of,
    wear_of,
)
from tests.agents.helipad.letters import LOOKALIKES

Array = NDArray[np.float64]
EVERY = 1.0 / 15.0
"""s between two pictures"""
HAPPENINGS = ("hand", "shadow", "edge", "blur", "rolling shutter", "exposure", "video")
MARGIN_PX = 12.0
"""of a pad from the picture's edge"""


@dataclasses.dataclass(frozen=True)
class Shot:
    """One picture; ``x`` and ``y`` of the camera over the ground (m), and its attitude (rad, yaw from north)."""

    t: float
    frame: Frame
    pads: tuple[Truth, ...]
    specs: tuple[Pad, ...]
    height_m: float
    roll: float
    pitch: float
    yaw: float
    x: float
    y: float

    def known(self, rng: np.random.Generator) -> Shot:
        """As the vehicle knows itself: 1 % + 3 cm of the height, 0.4 degrees of the attitude, 1 of the yaw and 3 cm of
        the place.
        """
        tilt = math.radians(0.4)
        return dataclasses.replace(
            self,
            height_m=max(self.height_m * (1.0 + 0.01 * rng.normal()) + 0.03 * rng.normal(), 0.3),
            roll=self.roll + tilt * rng.normal(),
            pitch=self.pitch + tilt * rng.normal(),
            yaw=self.yaw + math.radians(1.0) * rng.normal(),
            x=self.x + 0.03 * rng.normal(),
            y=self.y + 0.03 * rng.normal(),
        )


def to_level(yaw: float, x: float, y: float) -> Array:
    """(3, 3): the ground's metres to a level camera's, which is at (x, y)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, s, -c * x - s * y], [-s, c, s * x - c * y], [0.0, 0.0, 1.0]])


@dataclasses.dataclass(frozen=True)
class _Way:
    """How the camera drifts."""

    height_m: float
    yaw: float
    start: Array
    velocity: Array
    sway: Array
    """rad of roll and pitch, their frequencies (Hz) and phases: (3, 2)"""

    @classmethod
    def drawn(cls, rng: np.random.Generator, height: tuple[float, float]) -> _Way:
        height_m = float(rng.uniform(*height))
        reach = np.array(SIZE) / 520.0 * height_m / 2.0
        sway = np.array([rng.uniform(0.0, 0.12, 2), rng.uniform(0.2, 0.8, 2), rng.uniform(0.0, 6.3, 2)])
        start = rng.uniform(-0.6, 0.6, 2) * reach
        return cls(height_m, rng.uniform(-3.1, 3.1), start, rng.uniform(-0.8, 0.8, 2), sway)

    def at(self, t: float) -> tuple[float, float, float, float, float, float]:
        """Height, roll, pitch, yaw, x and y."""
        roll, pitch = self.sway[0] * np.sin(2.0 * math.pi * self.sway[1] * t + self.sway[2])
        x, y = self.start + self.velocity * t
        height = self.height_m + 0.1 * math.sin(0.7 * t)
        return height, float(roll), float(pitch), self.yaw + 0.1 * math.sin(t), float(x), float(y)


def _matrix(place: tuple[float, float, float, float, float, float]) -> Array:
    height, roll, pitch, yaw, x, y = place
    return np.asarray(ground_to_picture(height, roll, pitch) @ to_level(yaw, x, y), dtype=float)


def _inside(pad: Pad, matrix: Array) -> bool:
    reach = 0.6 * pad.symbol_m
    edge = [
        project(matrix, pad.x + reach * math.cos(a), pad.y + reach * math.sin(a)) for a in np.arange(8) * math.pi / 4.0
    ]
    return all(MARGIN_PX < u < SIZE[0] - MARGIN_PX and MARGIN_PX < v < SIZE[1] - MARGIN_PX for u, v in edge)


def sequence(
    seed: int,
    kind: str = "pad",
    hard: bool = False,
    height: tuple[float, float] = (2.0, 12.0),
    count: int = 8,
    letters: Sequence[str] = LOOKALIKES,
    happening: str = "",
) -> list[Shot]:
    """``count`` pictures of a pad, of a pad with another letter ("lookalike") or of none ("clutter"). ``happening``:
    one of :data:`HAPPENINGS` from a quarter of them on, to three quarters.
    """
    rng = np.random.default_rng([seed, 8 * hard + ("pad", "lookalike", "clutter").index(kind)])
    while True:
        way = _Way.drawn(rng, height)
        pad = random_pad(rng, kind, False, _matrix(way.at(0.0)), letters, {}) if kind != "clutter" else None
        if pad is None or all(_inside(pad, _matrix(way.at(i * EVERY))) for i in range(count)):
            break
    wear = wear_of(rng, hard)
    things, scene = int(rng.integers(0, 26)), int(rng.integers(1 << 30))
    specs = () if pad is None else (pad,)
    shots = []
    for i in range(count):
        t = i * EVERY
        done = _Happening(happening, (i - count / 4) / (count / 2), way.height_m)
        height_m, roll, pitch, yaw, x, y = place = done.moved(way.at(t), pad)
        matrix = _matrix(place)
        taken = np.random.default_rng([scene, i])
        worn = dataclasses.replace(
            wear,
            motion_px=taken.uniform(0.0, 8.0 if hard else 1.5),
            motion_angle=taken.uniform(0.0, math.pi),
        )
        reach = (1.3 * way.height_m, 1.3 * way.height_m)
        frame = render(
            np.random.default_rng(scene), matrix, height_m, list(specs), done.worn(worn, taken), things, reach, taken
        )
        truths = tuple(truth_of(each, matrix) for each in specs if each.letter == "H")
        frame = done.seen(frame, truths, taken)
        shots.append(Shot(t, frame, truths, specs, height_m, roll, pitch, yaw, x, y))
    return list(_as_video(shots)) if happening == "video" else shots


@dataclasses.dataclass(frozen=True)
class _Happening:
    """What happens to a picture; ``share`` of it is past, below 0 and above 1 there is nothing."""

    name: str
    share: float
    height_m: float

    @property
    def on(self) -> bool:
        return 0.0 <= self.share <= 1.0

    def moved(
        self, place: tuple[float, float, float, float, float, float], pad: Pad | None
    ) -> tuple[float, float, float, float, float, float]:
        """The camera goes so far aside that half the pad is out of its picture, and comes back."""
        if self.name != "edge" or not self.on or pad is None:
            return place
        height, roll, pitch, yaw, x, y = place
        u = float(project(_matrix(place), pad.x, pad.y)[0])
        aside = math.sin(math.pi * self.share) * u / 520.0 * height  # along the picture's u: the pad comes to its edge
        return height, roll, pitch, yaw, x + aside * math.cos(yaw), y + aside * math.sin(yaw)

    def worn(self, wear: Wear, rng: np.random.Generator) -> Wear:
        if self.name == "blur" and self.on:
            return dataclasses.replace(wear, motion_px=rng.uniform(4.0, 14.0))
        if self.name == "exposure" and self.on:
            return dataclasses.replace(wear, gain=wear.gain * (0.3, 1.0, 2.2)[int(6.0 * self.share) % 3])
        return wear

    def seen(self, frame: Frame, pads: tuple[Truth, ...], rng: np.random.Generator) -> Frame:
        if not self.on or not pads:
            return frame
        pad = pads[0]
        along = 4.0 * self.share - 2.0  # heights of the symbol, across the pad's middle
        if self.name == "hand":
            middle = (round(16 * (pad.u + along * pad.scale_px)), round(16 * pad.v))
            axes = (round(16 * 0.55 * pad.scale_px), round(16 * 0.8 * pad.scale_px))
            skin = (110.0, 140.0, 200.0)
            cv2.ellipse(frame, middle, axes, 20.0, 0.0, 360.0, skin, -1, cv2.LINE_AA, 4)
        elif self.name == "shadow":
            u = np.arange(SIZE[0], dtype=np.float32) - np.float32(pad.u + along * pad.scale_px)
            v = np.arange(SIZE[1], dtype=np.float32)[:, None] - np.float32(pad.v)
            light = 1.0 - 0.6 * np.clip((u * 0.9 + v * 0.4) / 2.0 + 0.5, 0.0, 1.0)
            return np.asarray(np.rint(frame * light[..., None]), dtype=np.uint8)
        elif self.name == "rolling shutter":
            rows = np.arange(SIZE[1], dtype=np.float32)[:, None]
            shake = 2.0 * np.sin(rows / 45.0 + np.float32(rng.uniform(0.0, 6.3))) + 0.04 * (rows - np.float32(pad.v))
            u = np.arange(SIZE[0], dtype=np.float32) + shake
            return np.asarray(cv2.remap(frame, u, np.broadcast_to(rows, u.shape).copy(), cv2.INTER_LINEAR), np.uint8)
        return frame


def _as_video(shots: list[Shot]) -> Iterator[Shot]:
    """The same pictures from a file of compressed video (MPEG-4, as OpenCV writes it)."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "pictures.mp4")
        writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"mp4v"), 15.0, SIZE)
        if not writer.isOpened():
            raise RuntimeError("this OpenCV writes no MPEG-4")
        for shot in shots:
            writer.write(shot.frame)
        writer.release()
        reader = cv2.VideoCapture(path)
        for shot in shots:
            good, frame = reader.read()
            assert good
            yield dataclasses.replace(shot, frame=np.asarray(frame, dtype=np.uint8))
        reader.release()


def placed(shot: Shot, one: Detection, symbol_m: float) -> Place:
    """Where a detection lies by what is ``known`` of the camera: 0.5 degrees of tilt and 3 cm are its deviation."""
    view = View(CAMERA, None, shot.height_m / symbol_m, shot.roll, shot.pitch)
    middle = np.array([one.u, one.v])
    top = middle + np.array([math.sin(one.heading), -math.cos(one.heading)]) * one.scale_px / 2.0
    level = view.to_plane(np.array([middle, top])) * symbol_m
    back: Array = np.asarray(np.linalg.inv(to_level(shot.yaw, shot.x, shot.y)), dtype=float)
    (x, y), (x2, y2) = (project(back, *point) for point in level)
    deviation = math.hypot(math.radians(0.7) * shot.height_m, 0.05)
    return Place(-float(y), float(x), deviation, math.atan2(x2 - x, y - y2) % math.pi)


def pixel(shot: Shot, place: Place, symbol_m: float) -> tuple[float, float]:
    """Where ``place`` is seen, by what is ``known`` of the camera."""
    level = project(to_level(shot.yaw, shot.x, shot.y), place.east, -place.north)
    view = View(CAMERA, None, shot.height_m / symbol_m, shot.roll, shot.pitch)
    u, v = view.to_pixels(level[None] / symbol_m)[0]
    return float(u), float(v)


def watched(shots: list[Shot]) -> list[list[Told]]:
    """What a detector and its tracks tell of each picture, as the agent has them look."""
    symbol_m = shots[0].specs[0].symbol_m if shots[0].specs else SYMBOL_M
    detector, tracks = Detector(CAMERA, symbol_m), Tracks(symbol_m)
    rng = np.random.default_rng(len(shots))
    result = []
    for shot in shots:
        known = shot.known(rng)
        also = [pixel(known, place, symbol_m) for place in tracks.wanted]
        found = detector.sights(shot.frame, known.height_m, known.roll, known.pitch, also=also)
        result.append(tracks.told(shot.t, [(each, placed(known, each.detection, symbol_m)) for each in found]))
    return result


def right(shot: Shot, one: Detection) -> bool:
    return any(math.hypot(one.u - pad.u, one.v - pad.v) < 0.3 * pad.scale_px for pad in shot.pads)


def longest_gap(seen: Sequence[bool]) -> int:
    """Pictures in a row in which it was not."""
    return max(len(run) for run in "".join(".x"[each] for each in seen).split("x"))
