"""Flat pictures with transparency that lie anywhere in the world, the pads, and how they and plain polygons are drawn.

A sprite is kept at falling sizes (a pyramid; Williams, "Pyramidal Parametrics", SIGGRAPH 1983), each the last one's
by the root of 2, so that it can be drawn from any distance: with texels larger than a pixel it would be blurred, with
much smaller ones its edges would be ragged, and up to a third of a pixel off their place. Colours are multiplied by
their alpha beforehand (Porter and Duff, "Compositing Digital Images", SIGGRAPH 1984).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim.arrays import Array

Image = NDArray[np.uint8]
NEAR_M = 0.02  # nothing nearer than that to the lens is drawn
MARGIN = 2  # clear texels around every size of a picture: its edge then fades as any other
SMALL = 0.12  # of the picture's area
EDGE_ON = 1e-6  # determinant of a plane's projection below which nothing is seen of it
SHIFT = 6  # bits of a pixel in OpenCV's drawing


class Sprite:
    """``picture`` (h, w, 4): B, G, R times alpha, and alpha, 0 to 255; row 0 is ahead, column 0 left.

    ``texel``: metres; the sprite's plane has its origin in the picture's middle, the first axis ahead, the second to
    the right.
    """

    def __init__(self, picture: Image, texel: float) -> None:
        self.texel = texel
        self.half = (picture.shape[0] * texel / 2.0, picture.shape[1] * texel / 2.0)
        """metres ahead and to the right that it reaches"""
        self.levels: list[Image] = []
        self.placements: list[Array] = []
        """of each size: (3, 3) texel (column, row, 1) -> (ahead, right, 1) in metres"""
        height, width = picture.shape[:2]
        # The next two sizes: this one's by the root of 2, and its half.
        following = [_resized(picture, height / math.sqrt(2.0), width / math.sqrt(2.0))]
        while True:
            rows, columns = picture.shape[:2]
            border = (MARGIN, MARGIN, MARGIN, MARGIN)
            padded = cv2.copyMakeBorder(picture, *border, cv2.BORDER_CONSTANT, value=(0.0, 0.0, 0.0, 0.0))
            self.levels.append(padded.astype(np.uint8, copy=False))
            dy, dx = texel * height / rows, texel * width / columns
            top, left = self.half[0] - dy * (0.5 - MARGIN), -self.half[1] + dx * (0.5 - MARGIN)
            self.placements.append(np.array([[0.0, -dy, top], [dx, 0.0, left], [0.0, 0.0, 1.0]]))
            if max(rows, columns) <= 2:
                return
            following.append(_resized(picture, rows / 2.0, columns / 2.0))
            picture = following.pop(0)

    def level(self, footprint: float) -> int:
        """The size whose texels are about ``footprint`` metres."""
        if footprint <= self.texel:
            return 0
        return min(int(2.0 * math.log2(footprint / self.texel) + 0.2), len(self.levels) - 1)


def _resized(picture: Image, rows: float, columns: float) -> Image:
    size = (max(round(columns), 1), max(round(rows), 1))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


def clip_near(points: Array, near: float = NEAR_M) -> Array:
    """A convex polygon of (3, N) homogeneous picture points, cut off where w is below ``near`` (Sutherland and Hodgman,
    CACM 17(1), 1974).
    """
    w = points[2]
    if (w >= near).all():
        return points
    kept = []
    n = points.shape[1]
    for i in range(n):
        a, b = points[:, i], points[:, (i + 1) % n]
        if a[2] >= near:
            kept.append(a)
        if (a[2] >= near) != (b[2] >= near):
            kept.append(a + (b - a) * ((near - a[2]) / (b[2] - a[2])))
    return np.array(kept).T if kept else np.empty((3, 0))


def region(points: Array, size: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """The pixels (x0, y0, x1, y1) of a picture of ``size`` about the (3, N) points (w above 0); None outside."""
    if points.shape[1] < 3:
        return None
    u, v = points[0] / points[2], points[1] / points[2]
    x0, y0 = max(math.floor(u.min()) - 1, 0), max(math.floor(v.min()) - 1, 0)
    x1, y1 = min(math.ceil(u.max()) + 2, size[0]), min(math.ceil(v.max()) + 2, size[1])
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def draw(image: Image, sprite: Sprite, plane: Array) -> None:
    """Put ``sprite`` on ``image`` (h, w, 3) BGR, in place. ``plane``: (3, 3) (ahead, right, 1) in metres -> (u w, v w,
    w).
    """
    a, r = sprite.half
    corners = plane @ np.array([[a, a, -a, -a], [-r, r, r, -r], [1.0, 1.0, 1.0, 1.0]])
    seen = clip_near(corners)
    where = region(seen, (image.shape[1], image.shape[0]))
    if where is None or abs(np.linalg.det(plane)) < EDGE_ON:
        return
    x0, y0, x1, y1 = where
    # What is small in the picture is drawn at twice its size and averaged: its edges are then within a hundredth.
    fine = 2 if (x1 - x0) * (y1 - y0) < SMALL * image.shape[0] * image.shape[1] else 1
    level = sprite.level(_footprint(plane, seen) / fine)
    first = 0.5 * (fine - 1)  # of the finer pixels whose middle is the first pixel's
    window = np.array([[fine, 0.0, first - fine * x0], [0.0, fine, first - fine * y0], [0.0, 0.0, 1.0]])
    to_picture = window @ plane @ sprite.placements[level]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (fine * (x1 - x0), fine * (y1 - y0))
    patch = cv2.warpPerspective(sprite.levels[level], np.linalg.inv(to_picture), size, flags=flags)
    if fine > 1:
        patch = cv2.resize(patch, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
    if seen is not corners:
        mask = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
        polygon = _fixed(seen - np.outer([x0, y0, 0.0], seen[2]))
        cv2.fillConvexPoly(mask, polygon, (255.0,), cv2.LINE_AA, SHIFT)
        patch = cv2.bitwise_and(patch, patch, mask=mask)
    target = image[y0:y1, x0:x1]
    alpha = cv2.cvtColor(255 - cv2.extractChannel(patch, 3), cv2.COLOR_GRAY2BGR)
    cv2.multiply(target, alpha, dst=target, scale=1.0 / 255.0)
    cv2.add(target, cv2.cvtColor(patch, cv2.COLOR_BGRA2BGR), dst=target)


def fill(image: Image, points: Array, color: tuple[float, ...]) -> None:
    """A filled convex polygon of (3, N) homogeneous picture points, in place; edges are smooth."""
    seen = clip_near(points)
    if region(seen, (image.shape[1], image.shape[0])) is not None:
        cv2.fillConvexPoly(image, _fixed(seen), color, cv2.LINE_AA, SHIFT)


def _fixed(points: Array) -> NDArray[np.int32]:
    """Picture points as OpenCV draws them: in 2^-SHIFT pixels, kept within what it can hold."""
    flat = np.clip((points[:2] / points[2]).T, -20_000.0, 20_000.0)
    fixed: NDArray[np.int32] = np.rint(flat * (1 << SHIFT)).astype(np.int32)
    return fixed


def _footprint(plane: Array, seen: Array) -> float:
    """Metres of the plane that a pixel about the middle of the points ``seen`` (3, N) takes."""
    center = seen.mean(1)
    at = np.linalg.inv(plane) @ np.array([center[0] / center[2], center[1] / center[2], 1.0])
    ahead, right = at[0] / at[2], at[1] / at[2]
    u, v, w = plane @ np.array([ahead, right, 1.0])
    j = (plane[:2, :2] - np.outer([u / w, v / w], plane[2, :2])) / w
    return float(1.0 / math.sqrt(max(abs(j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]), 1e-12)))
