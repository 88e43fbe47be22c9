"""Colours and sizes, in one place."""

from __future__ import annotations

import colorsys
import re
import zlib

Colour = tuple[int, int, int, int]

GREY: Colour = (190, 194, 200, 255)
WHITE: Colour = (235, 238, 242, 255)
SETPOINT: Colour = (255, 255, 255, 230)
ERROR_LINE: Colour = (255, 70, 70, 230)
SEGMENT: Colour = (255, 255, 255, 120)
GRADES: dict[str, Colour] = {
    "good": (60, 210, 110, 255),
    "fair": (250, 205, 60, 255),
    "poor": (255, 120, 40, 255),
    "down": (230, 45, 60, 255),
    "unknown": (140, 145, 155, 255),
}
"""of mesh links, by :attr:`mesh.graph.Link.grade`"""
WIDTHS = {"good": 1.8, "fair": 1.5, "poor": 1.2, "down": 0.9, "unknown": 0.9}
"""of the same, in points of the screen: the better, the thicker"""
TOPICS: dict[str, Colour] = {
    "goal": (120, 255, 140, 255),
    "plan": (80, 220, 255, 220),
    "obstacle": (230, 110, 80, 150),
}


def points(width: float) -> float:
    """A radius in points of the screen, in Rerun's way: negative."""
    return -width


def colour(name: str) -> Colour:
    """A vehicle's own colour, by its name alone: alike in every viewer. Neighbouring numbers are far apart."""
    stem, number = re.match(r"(.*?)(\d*)\Z", name, re.DOTALL).groups()  # type: ignore[union-attr]
    start = (zlib.crc32(stem.encode("utf-8", "surrogatepass")) % 360) / 360
    hue = (start + 0.618034 * (int(number[-6:]) if number else 0)) % 1.0
    r, g, b = colorsys.hls_to_rgb(hue, 0.62, 0.85)
    return round(255 * r), round(255 * g), round(255 * b), 255


def darkened(shade: Colour, share: float = 0.5) -> Colour:
    """Lines of plots have no transparency, and the viewer's ground is black or white."""
    r, g, b, alpha = shade
    return int(share * r), int(share * g), int(share * b), alpha


def turned(shade: Colour, number: int) -> Colour:
    """The same for the second, the third ... of several that would be alike; the first one's is as it is."""
    hue, light, full = colorsys.rgb_to_hls(*(part / 255 for part in shade[:3]))
    r, g, b = colorsys.hls_to_rgb((hue + 0.618034 * number) % 1.0, light, full)
    return round(255 * r), round(255 * g), round(255 * b), shade[3]


def faded(shade: Colour, alpha: int) -> Colour:
    return (*shade[:3], alpha)
