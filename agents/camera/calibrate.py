"""A camera's constants from views of a chessboard.

Source: Zhang 2000, "A Flexible New Technique for Camera Calibration" (OpenCV's ``calibrateCamera``); corners by Duda
and Frese 2018 (``findChessboardCornersSB``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.camera.settings import Calibration
from agents.camera.sources import pictures_in
from zmav.errors import BadConfig, BadInput
from zmav.vision.opencv import Image, opencv

Array = NDArray[np.float64]

FEWEST, MOST = 8, 40
"""views"""
MOVED = 0.04
"""of the picture's width that a corner must have moved on average for a view to be another one"""
CELLS, COVERED = 3, 5
"""the picture in so many by so many cells, of which so many must have held corners"""
TILTED, TILTS = math.radians(12.0), 3
"""a board seen head on says nothing of the focal length: views tilted by so much, and how many are needed"""
WORST_ERROR = 1.5
"""px, root mean square, above which something is wrong: the squares' count, or a board that is not flat"""
WORST_FOCAL = 0.02
"""standard deviation of the focal length, as a share of it"""


class Result(NamedTuple):
    """What came out, and how good it is."""

    calibration: Calibration
    error_px: float
    focal_sigma: float
    """px"""


class Views:
    """Views of one board of ``squares`` (across, along) with sides of ``side`` metres. Raises :class:`BadInput`."""

    def __init__(self, squares: tuple[int, int], side: float) -> None:
        if min(squares) < 4 or max(squares) > 50 or squares[0] == squares[1]:
            text = f"a board of {squares[0]}x{squares[1]} squares: expected 4 to 50 each way, and not as many both ways"
            raise BadInput(text, field="squares", value=list(squares), expected="like 9x6")
        if not 0.0 < side < 10.0:
            raise BadInput(f"squares of {side} m", field="size", value=side, expected="metres, as in 0.025")
        self._inner = (squares[0] - 1, squares[1] - 1)
        self._side = side
        self.size: tuple[int, int] | None = None
        """width and height in pixels"""
        self.corners: list[Array] = []
        """(N, 2) px of each view that was kept"""

    def add(self, image: Image) -> str:
        """Look for the board in (height, width, 3) BGR and keep the view; a word on why not, else an empty one."""
        cv2 = opencv()
        size = image.shape[1], image.shape[0]
        if self.size not in (None, size):
            return f"has {size[0]}x{size[1]} pixels, others {self.size}"
        if len(self.corners) >= MOST:
            return "enough"
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        found, corners = cv2.findChessboardCornersSB(grey, self._inner, flags=cv2.CALIB_CB_ACCURACY)
        if not found:
            return "no board"
        points: Array = corners.reshape(-1, 2).astype(np.float64)
        if any(_moved(points, other) < MOVED * size[0] for other in self.corners):
            return "like another"
        self.size = size
        self.corners.append(points)
        return ""

    def solve(self) -> Result:
        """The camera's constants; raises :class:`BadInput` that says which views are missing."""
        cv2 = opencv()
        if len(self.corners) < FEWEST or self.size is None:
            raise _too(
                "few",
                f"{len(self.corners)} views of the board, expected {FEWEST} at least: check --squares, and show the "
                "board whole, sharp and from several sides",
            )
        covered = self._covered()
        if covered < COVERED:
            raise _too(
                "similar",
                f"the board was seen in {covered} of {CELLS * CELLS} parts of the picture, expected "
                f"{COVERED}: show it in the corners, too",
            )
        across, along = self._inner
        board = np.zeros((across * along, 3), np.float32)
        board[:, :2] = np.mgrid[0:across, 0:along].T.reshape(-1, 2) * self._side
        views = [points.astype(np.float32)[:, None] for points in self.corners]
        error, matrix, bent, turns, _, sigmas, *_ = cv2.calibrateCameraExtended(
            [board] * len(views), views, self.size, None, None
        )
        tilts = [math.acos(min(1.0, abs(float(cv2.Rodrigues(turn)[0][2, 2])))) for turn in turns]
        tilted = sum(tilt >= TILTED for tilt in tilts)
        if tilted < TILTS:
            raise _too(
                "similar",
                f"{tilted} views are tilted by {math.degrees(TILTED):.0f}° or more, expected {TILTS}: tilt the board "
                "to and fro and to the sides",
            )
        if error > WORST_ERROR:
            text = (
                f"corners are off by {error:.2f} px, expected {WORST_ERROR} at most: is the board flat, is --squares "
                "right, are the pictures sharp?"
            )
            raise BadInput(text, field="squares", value=error, expected=f"{WORST_ERROR} px")
        sigma = float(np.max(sigmas[:2]))
        if sigma > WORST_FOCAL * matrix[0, 0]:
            raise _too("similar", f"the focal length is known to {sigma:.1f} px only: tilt the board more")
        k1, k2, p1, p2, k3 = (float(k) for k in np.asarray(bent).ravel()[:5])
        calibration = Calibration(
            width=self.size[0],
            height=self.size[1],
            focal=(float(matrix[0, 0]), float(matrix[1, 1])),
            center=(float(matrix[0, 2]), float(matrix[1, 2])),
            distortion=(k1, k2, p1, p2, k3),
            error_px=round(float(error), 4),
            views=len(self.corners),
        )
        return Result(calibration, float(error), sigma)

    def _covered(self) -> int:
        assert self.size is not None
        cells = np.floor(np.concatenate(self.corners) / self.size * CELLS).astype(int)
        return len({(int(u), int(v)) for u, v in cells})


def from_folder(folder: Path, views: Views) -> Iterable[tuple[str, str]]:
    """Add each picture of a folder; gives its name and why it was left out. :class:`BadConfig` for no pictures."""
    cv2 = opencv()
    paths = pictures_in(folder)
    if not paths:
        raise BadConfig(f"there are no pictures in {folder}", field="source", value=str(folder), expected="pictures")
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        yield path.name, "no picture" if image is None else views.add(image)


def _moved(a: Array, b: Array) -> float:
    """Mean distance of corners, px; the board may be found from its other end."""
    return min(float(np.hypot(*(a - each).T).mean()) for each in (b, b[::-1]))


def _too(what: str, why: str) -> BadInput:
    return BadInput(f"too {what} views: {why}", field="views", value=what, expected=why)
