"""Rendered frames of a downward camera with a landing pad, with others, or with none; independent of the detector.

Ground coordinates are metres in the level camera's axes: x to its right, y toward the rear, the origin straight below
it, so that a level picture shows x to the right and y downwards. The pad is sampled 4 x 4 times for each pixel through
the true projection; its truth is the projected middle. A frame depends on its seed and arguments alone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.agents.helipad.letters import LOOKALIKES, ink
from tests.agents.helipad.scenery import Clutter, lay
from zmav.wire import CameraInfo

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]

SIZE = (640, 480)
FOCAL_PX = 520.0
CAMERA = np.array([[FOCAL_PX, 0.0, 319.5], [0.0, FOCAL_PX, 239.5], [0.0, 0.0, 1.0]])
INFO = CameraInfo(
    t=0.0, camera="down", width=640, height=480, focal=(520.0, 520.0), center=(319.5, 239.5), rate_hz=20.0
)
SYMBOL_M = 0.25
OVERSAMPLE = 4
WHITE, YELLOW = (236.0, 240.0, 240.0), (35.0, 190.0, 238.0)
BACKGROUNDS = ((150.0, 75.0, 30.0), (40.0, 38.0, 175.0), (60.0, 118.0, 32.0), (35.0, 35.0, 36.0), (105.0, 103.0, 102.0))
Surface = Callable[[Array, Array], tuple[NDArray[np.uint8], NDArray[np.float32]]]
"""(x, y) in pad units of any shape -> which paint lies there, and each paint's BGR (n, 3); where it is n, there is none
"""


@dataclasses.dataclass(frozen=True)
class Pad:
    """One pad: where, how and of what. Lengths in metres; ``angle`` is clockwise from the top of a level picture."""

    x: float
    y: float
    angle: float
    letter: str = "H"
    symbol_m: float = SYMBOL_M
    width: float = 0.7
    stroke: float = 0.18
    shape: str = "disc"
    """disc, ring, square or none"""
    color: tuple[float, float, float] = WHITE
    background: tuple[float, float, float] = BACKGROUNDS[0]
    size: float = 2.0
    """diameter or side, of the symbol's height"""
    mirrored: bool = False


@dataclasses.dataclass(frozen=True)
class Truth:
    """Where the middle of a letter H is, px; its projected height, px; its heading, rad, clockwise from up, [0, pi)."""

    u: float
    v: float
    scale_px: float
    heading: float


@dataclasses.dataclass(frozen=True)
class Wear:
    """What light, lens and sensor do to a frame."""

    gain: float = 1.0
    defocus_px: float = 0.5
    motion_px: float = 0.0
    motion_angle: float = 0.0
    noise: float = 2.0
    jpeg: int = 92
    gradient: float = 0.0
    glare: float = 0.0
    shadow: float = 1.0
    """what is left of the light on one side of a straight edge"""
    hidden: float = 0.0
    """share of the letter's square that something covers"""


@dataclasses.dataclass(frozen=True)
class Sample:
    frame: Frame
    pads: tuple[Truth, ...]
    height_m: float
    roll: float
    pitch: float
    pad_specs: tuple[Pad, ...] = ()

    def hints(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Height, roll and pitch as a vehicle knows them: 1 % + 3 cm and 0.4 degrees of noise."""
        height = self.height_m * (1.0 + 0.01 * rng.normal()) + 0.03 * rng.normal()
        tilt = math.radians(0.4)
        return max(height, 0.3), self.roll + tilt * rng.normal(), self.pitch + tilt * rng.normal()


def ground_to_picture(height_m: float, roll: float, pitch: float) -> Array:
    """(3, 3): ground (x, y, 1) in metres -> (u w, v w, w) in pixels."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    # Body to level, axes forward, right, down; the camera's are right, rearward, down.
    level = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
    to_body = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotation = to_body.T @ level @ to_body  # camera to level camera
    result: Array = CAMERA @ rotation.T @ np.diag([1.0, 1.0, height_m])
    return result


def project(to_picture: Array, x: float, y: float) -> Array:
    """(2,): the pixel of one point on the ground."""
    point = to_picture @ (x, y, 1.0)
    result: Array = point[:2] / point[2]
    return result


def truth_of(pad: Pad, to_picture: Array) -> Truth:
    middle = project(to_picture, pad.x, pad.y)
    up = np.array([math.sin(pad.angle), -math.cos(pad.angle)]) * pad.symbol_m / 2.0
    top, foot = (project(to_picture, pad.x + s * up[0], pad.y + s * up[1]) for s in (1.0, -1.0))
    along = top - foot
    heading = math.atan2(along[0], -along[1]) % math.pi
    return Truth(float(middle[0]), float(middle[1]), float(np.hypot(*along)), heading)


def sample(
    seed: int,
    kind: str = "pad",
    hard: bool = False,
    height: tuple[float, float] = (1.0, 12.0),
    whole_pad: bool = False,
    pads: int = 1,
    letters: Sequence[str] = LOOKALIKES,
    **fixed: object,
) -> Sample:
    """One frame. ``kind``: "pad" (an H), "clutter" (no pad), "lookalike" (a pad with one of ``letters``), "tag" (an
    AprilTag 36h11 of the symbol's height on white).

    ``whole_pad``: the pad is 0.25 m wide, and the letter what fits. ``fixed``: fields of :class:`Pad` that shall not be
    left to chance.
    """
    rng = np.random.default_rng([seed, 4 * hard + 2 * whole_pad + (kind == "lookalike"), kind == "clutter"])
    height_m = float(rng.uniform(*height))
    roll, pitch = (float(a) for a in np.radians(rng.uniform(-15.0, 15.0, 2)))
    matrix = ground_to_picture(height_m, roll, pitch)
    specs: list[Pad] = []
    for _ in range(20 * pads):  # they may not all have room
        if kind == "clutter" or len(specs) == pads:
            break
        pad = random_pad(rng, kind, whole_pad, matrix, letters, fixed)
        if all(math.hypot(pad.x - o.x, pad.y - o.y) > 3.0 * o.symbol_m for o in specs):
            specs.append(pad)
    wear = wear_of(rng, hard)
    frame = render(
        rng,
        matrix,
        height_m,
        specs,
        wear,
        things=int(rng.integers(0, 26)) if kind in ("clutter", "lookalike") or hard else 6,
    )
    truths = tuple(truth_of(pad, matrix) for pad in specs if pad.letter in ("H", "tag"))
    return Sample(frame, truths, height_m, roll, pitch, tuple(specs))


def random_pad(
    rng: np.random.Generator,
    kind: str,
    whole_pad: bool,
    matrix: Array,
    letters: Sequence[str],
    fixed: dict[str, object],
) -> Pad:
    shape = str(fixed.get("shape", rng.choice(["disc", "ring", "square", "none"])))
    size = rng.uniform(1.6, 2.0 if whole_pad else 2.4)
    color = WHITE if rng.random() < 0.65 else YELLOW
    bright = rng.uniform(0.85, 1.05)
    dark = BACKGROUNDS[int(rng.integers(len(BACKGROUNDS)))]
    values: dict[str, object] = {
        "angle": rng.uniform(0.0, 2.0 * math.pi),
        "letter": {"pad": "H", "tag": "tag"}.get(kind) or str(rng.choice(letters)),
        "symbol_m": SYMBOL_M / size if whole_pad else SYMBOL_M,
        "width": rng.uniform(0.58, 0.82),
        "stroke": rng.uniform(0.14, 0.22),
        "shape": shape,
        "color": tuple(c * bright for c in color),
        "background": tuple(c * rng.uniform(0.6, 1.15) for c in dark),
        "size": size,
    }
    if kind == "tag":
        values.update(shape="square", color=WHITE, background=(28.0, 28.0, 28.0), size=1.25)
    values.update(fixed)
    x, y = _place(rng, matrix, float(values["symbol_m"]))  # type: ignore[arg-type]
    return Pad(x=x, y=y, **values)  # type: ignore[arg-type]


def _place(rng: np.random.Generator, matrix: Array, symbol_m: float) -> tuple[float, float]:
    """A point on the ground whose letter lies in the picture, whichever way it is turned."""
    back: Array = np.asarray(np.linalg.inv(matrix), dtype=float)
    while True:
        u, v = rng.uniform((0.0, 0.0), SIZE)
        x, y = project(back, float(u), float(v))
        edge = [project(matrix, x + 0.68 * symbol_m * dx, y + 0.68 * symbol_m * dy) for dx, dy in _ROUND]
        if all(2.0 <= e[0] <= SIZE[0] - 3.0 and 2.0 <= e[1] <= SIZE[1] - 3.0 for e in edge):
            return float(x), float(y)


_ROUND = tuple((math.cos(a), math.sin(a)) for a in np.arange(8) * math.pi / 4.0)


def wear_of(rng: np.random.Generator, hard: bool) -> Wear:
    if not hard:
        return Wear(
            gain=rng.uniform(0.85, 1.1),
            defocus_px=rng.uniform(0.3, 0.8),
            motion_px=rng.uniform(0.0, 1.5),
            motion_angle=rng.uniform(0.0, math.pi),
            noise=rng.uniform(1.0, 4.0),
            gradient=rng.uniform(0.0, 0.25),
        )
    return Wear(
        gain=math.exp(rng.uniform(math.log(0.35), math.log(1.9))),
        defocus_px=rng.uniform(0.4, 1.6),
        motion_px=rng.uniform(0.0, 8.0),
        motion_angle=rng.uniform(0.0, math.pi),
        noise=rng.uniform(2.0, 10.0),
        jpeg=int(rng.integers(35, 90)),
        gradient=rng.uniform(0.0, 0.5),
        glare=rng.uniform(80.0, 250.0) if rng.random() < 0.25 else 0.0,
        shadow=rng.uniform(0.35, 0.8) if rng.random() < 0.5 else 1.0,
        hidden=rng.uniform(0.0, 0.3),
    )


def render(
    rng: np.random.Generator,
    matrix: Array,
    height_m: float,
    pads: list[Pad],
    wear: Wear,
    things: int = 0,
    reach: tuple[float, float] | None = None,
    noise: np.random.Generator | None = None,
) -> Frame:
    """The frame (480, 640, 3) BGR of such ground, pads and things, as the camera gives it. ``reach``: how far things
    lie from the origin, m; else as far as is seen. ``noise``: of the sensor, where ``rng`` is the scene's alone.
    """
    picture = lay(rng, matrix, height_m / FOCAL_PX, SIZE)
    reach = reach or (height_m * SIZE[0] / 2.0 / FOCAL_PX, height_m * SIZE[1] / 2.0 / FOCAL_PX)
    around = [(p.x, p.y, p.symbol_m * max(p.size / 2.0 * 1.5, 0.7)) for p in pads]
    Clutter(rng, picture, matrix, reach).scatter(things, around)
    for pad in pads:
        stamp(
            picture, matrix, (pad.x, pad.y), pad.angle, pad.symbol_m, pad.size + 0.2, surface_of(rng, pad, wear.hidden)
        )
    return _worn(rng, picture, wear, noise or rng)


def stamp(
    picture: NDArray[np.float32],
    matrix: Array,
    middle: tuple[float, float],
    angle: float,
    unit_m: float,
    extent: float,
    surface: Surface,
) -> None:
    """Paint ``surface``, a square of ``extent`` units turned by ``angle``, into ``picture`` in place, exactly."""
    c, s = math.cos(angle) * unit_m, math.sin(angle) * unit_m
    # Pad units: x right and y up of the upright letter; ground: y toward the rear.
    to_ground = np.array([[c, s, middle[0]], [s, -c, middle[1]], [0.0, 0.0, 1.0]])
    to_picture = matrix @ to_ground
    half = max(extent, 1.6) / 2.0
    corners = np.array([project(to_picture, x, y) for x in (-half, half) for y in (-half, half)])
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 2, SIZE)
    if np.any(high <= low):
        return
    fine = (np.arange(OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
    u = (np.arange(low[0], high[0])[:, None] + fine).ravel()
    v = (np.arange(low[1], high[1])[:, None] + fine).ravel()[:, None]
    back = np.linalg.inv(to_picture)
    w = 1.0 / (back[2, 0] * u + (back[2, 1] * v + back[2, 2]))
    x = (back[0, 0] * u + (back[0, 1] * v + back[0, 2])) * w
    y = (back[1, 0] * u + (back[1, 1] * v + back[1, 2])) * w
    which, paints = surface(x, y)
    size = (int(high[0] - low[0]), int(high[1] - low[1]))
    bare = np.ones((size[1], size[0], 1), dtype=np.float32)
    laid = np.zeros((size[1], size[0], 3), dtype=np.float32)
    for number, paint in enumerate(paints):
        share = cv2.resize((which == number).astype(np.float32), size, interpolation=cv2.INTER_AREA)[..., None]
        bare -= share
        laid += share * paint
    part = picture[low[1] : high[1], low[0] : high[0]]
    part[:] = part * bare + laid


def surface_of(rng: np.random.Generator, pad: Pad, hidden: float) -> Surface:
    half = pad.size / 2.0
    cover = _cover(rng, hidden)
    cover_color = np.array(rng.uniform(30.0, 190.0, 3) if rng.random() < 0.5 else (rng.uniform(20, 200),) * 3)
    rim = rng.uniform(0.08, 0.14)

    paints = np.array([pad.background, pad.color, cover_color], dtype=np.float32)

    def surface(x: Array, y: Array) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        if pad.mirrored:
            x = -x
        radius = x * x + y * y
        letter = _tag(x, y) if pad.letter == "tag" else ink(pad.letter, x, y, pad.width, pad.stroke)
        if pad.shape == "square":
            there = (np.abs(x) <= half) & (np.abs(y) <= half)
        elif pad.shape == "none":
            there = letter.copy()
        else:
            there = radius <= half * half
        bright = letter | (radius > (half - rim) ** 2) if pad.shape == "ring" else letter
        which = np.where(there, bright, np.uint8(len(paints)))
        if hidden > 0.0:
            which[cover(x, y)] = 2
        return which, paints

    return surface


def _tag(x: Array, y: Array) -> NDArray[np.bool_]:
    """Where an AprilTag 36h11 (number 5, its black border 1 unit wide) and the paper about it are white."""
    marks = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(np.asarray(cv2.aruco.generateImageMarker(marks, 5, 8)), 1, constant_values=255)
    column = np.clip(np.floor(x * 8.0).astype(int) + 5, 0, 9)
    row = np.clip(np.floor(-y * 8.0).astype(int) + 5, 0, 9)
    result: NDArray[np.bool_] = cells[row, column] > 127
    return result


def _cover(rng: np.random.Generator, hidden: float) -> Callable[[Array, Array], NDArray[np.bool_]]:
    """What hides that share of the letter's square: an edge, a bar across, or a round thing."""
    axis = (np.arange(40) + 0.5) / 40 - 0.5
    x, y = axis * 0.75, axis[:, None]
    angle = rng.uniform(0.0, 2.0 * math.pi)
    c, s = math.cos(angle), math.sin(angle)
    kind = str(rng.choice(["edge", "bar", "round"]))
    place = rng.uniform(-0.4, 0.4, 2)
    if hidden <= 0.0:
        return lambda x, y: np.zeros(np.broadcast(x, y).shape, dtype=bool)

    def field(x: Array, y: Array) -> Array:
        """Small where it hides first."""
        if kind == "edge":
            return np.asarray(c * x + s * y + 0 * (x + y))
        if kind == "bar":
            return np.asarray(np.abs(c * (x - place[0]) + s * (y - place[1])))
        return np.asarray(np.hypot(x - place[0], y - place[1]))

    limit = float(np.quantile(field(x, y), hidden))
    return lambda x, y: (field(x, y) <= limit) & (np.abs(x) <= 0.7) & (np.abs(y) <= 0.7)


def _worn(rng: np.random.Generator, picture: NDArray[np.float32], wear: Wear, sensor: np.random.Generator) -> Frame:
    width, height = SIZE
    across, down = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    angle = rng.uniform(0.0, 2.0 * math.pi)
    run = (math.cos(angle) * (across - width / 2) + math.sin(angle) * (down - height / 2)) / (width / 2)
    light = wear.gain * (1.0 + wear.gradient * run)
    if wear.shadow < 1.0:
        angle = rng.uniform(0.0, 2.0 * math.pi)
        x, y = rng.uniform((0.1 * width, 0.1 * height), (0.9 * width, 0.9 * height))
        edge = math.cos(angle) * (across - x) + math.sin(angle) * (down - y)
        light = light * (1.0 - (1.0 - wear.shadow) * np.clip(edge / rng.uniform(1.0, 8.0) + 0.5, 0.0, 1.0))
    picture = picture * light[..., None].astype(np.float32)
    if wear.glare > 0.0:
        x, y = rng.uniform((0, 0), SIZE)
        spread = rng.uniform(40.0, 120.0)
        picture += (wear.glare * np.exp(-((across - x) ** 2 + (down - y) ** 2) / (2 * spread**2)))[..., None]
    if wear.motion_px > 0.3:
        smeared = cv2.filter2D(picture, cv2.CV_32F, _smear(wear.motion_px, wear.motion_angle))
        picture = np.asarray(smeared, dtype=np.float32)
    picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), max(wear.defocus_px, 0.2)), dtype=np.float32)
    noise = sensor.standard_normal((height, width, 3), dtype=np.float32)
    noise *= np.float32(wear.noise)
    frame = np.asarray(cv2.add(picture, noise, dtype=cv2.CV_8U), dtype=np.uint8)
    if wear.jpeg < 100:
        _, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, wear.jpeg])
        frame = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
    return frame


def _smear(length: float, angle: float) -> NDArray[np.float32]:
    """A straight line of ``length`` pixels, centred, as a kernel of weight 1."""
    side = 2 * math.ceil(length / 2.0) + 3
    fine = np.zeros((side, side), dtype=np.float32)
    for t in np.linspace(-0.5, 0.5, 64):
        x, y = side // 2 + t * length * math.cos(angle), side // 2 + t * length * math.sin(angle)
        x0, y0 = math.floor(x), math.floor(y)
        for dx, wx in ((0, 1 - (x - x0)), (1, x - x0)):
            for dy, wy in ((0, 1 - (y - y0)), (1, y - y0)):
                fine[y0 + dy, x0 + dx] += wx * wy
    result: NDArray[np.float32] = fine / fine.sum()
    return result
