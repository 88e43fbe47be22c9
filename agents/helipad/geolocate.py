"""From a pixel to a place on the ground, and how sure that is.

A ray through the pixel (the lens undone), turned by the mount and by the vehicle's attitude at the picture's own time,
meets the level plane in which the pad lies. What is not exact about attitude, heights and pixels is carried through by
differences to a covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.helipad.detector import Detection
from zmav.vision.optics import Optics, euler_matrix
from zmav.vision.poses import Pose

Array = NDArray[np.float64]
TILT, HEADING, HEIGHT, PIXEL = math.radians(0.5), math.radians(2.0), 0.03, 0.5
"""standard deviations: of roll and pitch (rad), of the heading, of a height as a share of itself, and of a pixel"""
HEIGHT_M, TIME_S = 0.05, 0.02
"""more of a height (m), and of the attitude's time (s): a vehicle that turns fast is known less well"""
SHALLOW = 0.17
"""sine of the least angle between ray and plane (10 degrees): beyond, a metre of height is six of distance"""
AGREE = 1.35
"""how many times larger or smaller than it should be a symbol may be, before its size is believed over the height"""
BY_SIZE = 0.06
"""of a height that is told from the symbol's size: its standard deviation, as a share"""
STEP_PX = 5.0
"""to either side of a symbol's middle, in which directions and lengths on the ground are measured"""


@dataclass(frozen=True)
class Fix:
    """``pos`` m NED about the fleet's origin, ``offset`` from the vehicle; ``covariance`` m²: NN, NE, EE."""

    pos: tuple[float, float, float]
    offset: tuple[float, float, float]
    covariance: tuple[float, float, float]
    by_size: bool
    """the height that was told was wrong: the symbol's size was gone by"""


def attitude(optics: Optics, pose: Pose) -> Array:
    """(3, 3): vehicle's axes to NED; with a levelled gimbal the heading alone."""
    return euler_matrix(0.0, 0.0, pose.yaw) if optics.gimbal else euler_matrix(pose.roll, pose.pitch, pose.yaw)


def camera_height(optics: Optics, pose: Pose, plane: float) -> float:
    """m of the optical centre above the plane that is ``plane`` m down."""
    return plane - (pose.pos[2] + float((attitude(optics, pose) @ optics.offset)[2]))


def locate(optics: Optics, pose: Pose, pixel: tuple[float, float], plane: float) -> tuple[float, float] | None:
    """North and east (m) of what the pixel (u, v) sees on the plane ``plane`` m down; None above the horizon."""
    rotation = attitude(optics, pose)
    ray = rotation @ optics.to_vehicle(optics.rays(np.array([pixel])))[0]
    centre = np.array(pose.pos) + rotation @ optics.offset
    if ray[2] < SHALLOW or plane <= centre[2]:
        return None
    reach = (plane - centre[2]) / ray[2]
    return float(centre[0] + reach * ray[0]), float(centre[1] + reach * ray[1])


def pixel(optics: Optics, pose: Pose, north: float, east: float, plane: float) -> tuple[float, float] | None:
    """Where that place of the plane is seen, (u, v); None where it is not ahead. The inverse of :func:`locate`."""
    rotation = attitude(optics, pose)
    centre = np.array(pose.pos) + rotation @ optics.offset
    ray = optics.mount.T @ rotation.T @ (np.array([north, east, plane]) - centre)
    if ray[2] < SHALLOW * np.linalg.norm(ray):
        return None
    u, v = optics.pixels(ray[None])[0]
    return float(u), float(v)


def sized_plane(optics: Optics, pose: Pose, seen: Detection, symbol_m: float) -> float | None:
    """How far down (m) a level symbol of ``symbol_m`` metres is that is seen so large; its standard deviation is
    ``BY_SIZE`` of the camera's height above it. None above the horizon, and of no size.

    A leaning camera sees it foreshortened along some directions: a piece of its upright is measured on a plane 1 m
    below the camera.
    """
    centre = pose.pos[2] + float((attitude(optics, pose) @ optics.offset)[2])
    piece = _upright(optics, pose, seen, centre + 1.0)
    if piece is None or seen.scale_px <= 0.0:
        return None
    return centre + symbol_m * 2.0 * STEP_PX / seen.scale_px / math.hypot(*piece)


def fix(optics: Optics, pose: Pose, seen: Detection, symbol_m: float, plane: float) -> Fix | None:
    """Where the symbol of ``symbol_m`` metres is; ``plane``: how far down it should be, which is not believed where its
    size says otherwise. None above the horizon.
    """
    sized = sized_plane(optics, pose, seen, symbol_m)
    if sized is None:
        return None
    by_scale = camera_height(optics, pose, sized)
    by_plane = by_scale + plane - sized
    by_size = not (by_scale / AGREE < by_plane < by_scale * AGREE)
    height = HEIGHT * abs(by_plane) + HEIGHT_M
    if by_size:
        plane, height = sized, BY_SIZE * by_scale
    found = locate(optics, pose, (seen.u, seen.v), plane)
    if found is None:
        return None
    north, east = found
    tilt = TILT + TIME_S * pose.rate
    spread = np.zeros((2, 2))
    u, v = seen.u, seen.v
    changes = [
        (_turned(pose, roll=tilt), (u, v), plane),
        (_turned(pose, pitch=tilt), (u, v), plane),
        (_turned(pose, yaw=HEADING), (u, v), plane),
        (pose, (u + PIXEL, v), plane),
        (pose, (u, v + PIXEL), plane),
        (pose, (u, v), plane + height),
    ]
    for other, where, level in changes:
        if (moved := locate(optics, other, where, level)) is not None:
            off = np.array([moved[0] - north, moved[1] - east])
            spread += np.outer(off, off)
    offset = (north - pose.pos[0], east - pose.pos[1], plane - pose.pos[2])
    covariance = (float(spread[0, 0]), float(spread[0, 1]), float(spread[1, 1]))
    return Fix((north, east, plane), offset, covariance, by_size)


def bearing(optics: Optics, pose: Pose, seen: Detection, plane: float) -> float | None:
    """rad from north, modulo pi, of the symbol's upright on the plane ``plane`` m down."""
    upright = _upright(optics, pose, seen, plane)
    return None if upright is None else math.atan2(upright[1], upright[0]) % math.pi


def _upright(optics: Optics, pose: Pose, seen: Detection, plane: float) -> tuple[float, float] | None:
    """m north, east on the plane from ``STEP_PX`` below the symbol's middle, along its upright, to as many above it."""
    right, down = STEP_PX * math.sin(seen.heading), -STEP_PX * math.cos(seen.heading)
    ends = [(seen.u + side * right, seen.v + side * down) for side in (1.0, -1.0)]
    there, back = (locate(optics, pose, end, plane) for end in ends)
    return None if there is None or back is None else (there[0] - back[0], there[1] - back[1])


def _turned(pose: Pose, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Pose:
    return Pose(pose.t, pose.pos, pose.roll + roll, pose.pitch + pitch, pose.yaw + yaw, pose.rate)
