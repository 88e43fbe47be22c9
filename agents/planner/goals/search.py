"""Search of a polygon by several vehicles: parts by what each can do, lanes over each part, and what they will see.

The polygon is cut across one axis into one part for each vehicle, in the order in which they stand along it. All parts
take the same time: sweeping, turning, the way there and the way back; nobody gets more than its endurance. Cuts along
the lanes and across them are both tried, for several directions of the lanes; the quickest split is taken. ENU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely import affinity

from agents.planner.goals.dealing import Dealer, Ground, Part, Sweeper
from agents.planner.model.scene import Box as SceneBox
from agents.planner.model.scene import Corner, NoFly, Obstacle, Scene, extent_of
from zmav.errors import BadInput

SPARE = 0.3
"""m more than the radius that lanes keep from obstacles"""
DIRECTIONS = 2
"""of lanes that are looked at closely"""


@dataclass(frozen=True)
class Split:
    """A search dealt out."""

    parts: tuple[Part, ...]
    covered: float
    """the share of what is wanted that will be seen, exactly"""
    text: str


def ground(polygon: Sequence[Corner], scene: Scene, heights: tuple[float, float], radius: float) -> Ground:
    """The polygon (ENU) less what stands in it between the lowest and the highest sweep.

    Raises :class:`BadInput` for a polygon that is none, and for one that lies wholly where nobody may be.
    """
    shape = shapely.Polygon(polygon) if len(polygon) > 2 else shapely.Polygon()
    if not shape.is_valid or shape.area <= 0.0:
        text = "search: the polygon crosses itself or has no area" if len(polygon) > 2 else "search: needs 3 corners"
        raise BadInput(text, field="polygon", value=len(polygon), expected="a simple polygon of three corners or more")
    low, high = heights
    bounds = scene.bounds
    room = shapely.box(bounds.min[0], bounds.min[1], bounds.max[0], bounds.max[1])
    if scene.geofence is not None:
        fence = scene.geofence
        if low < fence.floor or high > fence.ceiling:
            text = f"search: heights of {low:g} to {high:g} m are outside the geofence's {fence.floor:g}"
            text += f" to {fence.ceiling:g} m"
            raise BadInput(text, field="height", value=low, expected=f"{fence.floor:g} to {fence.ceiling:g} m")
        room = room.intersection(shapely.Polygon(fence.polygon))
    reach = radius + SPARE
    extents = [(each, *extent_of(each)) for each in scene.obstacles]
    there = [each for each, below, above in extents if below[2] - reach < high and above[2] + reach > low]
    solid = shapely.union_all([footprint(each) for each in there])
    wanted = shape.intersection(room).difference(solid)
    free = room.difference(shapely.buffer(solid, reach, quad_segs=4, join_style="mitre") if there else solid)
    free = _part_with(free, wanted)
    wanted = wanted.intersection(free.buffer(2.0 * reach))
    if wanted.is_empty or free.is_empty or wanted.area < 1.0:
        text = "search: the whole polygon is out of bounds or inside obstacles at that height"
        raise BadInput(text, field="polygon", value=round(shape.area), expected="a polygon with room to fly in")
    return Ground(wanted, free)


def _part_with(free: Any, wanted: Any) -> Any:
    """Of areas that hang together, the one in which most of what is wanted lies: the others cannot be reached."""
    pieces = shapely.get_parts(free)
    if len(pieces) < 2:
        return free
    return pieces[int(np.argmax(shapely.area(shapely.intersection(pieces, wanted))))]


def footprint(obstacle: Obstacle) -> Any:
    if isinstance(obstacle, SceneBox):
        return shapely.box(*obstacle.min[:2], *obstacle.max[:2])
    if isinstance(obstacle, NoFly):
        return shapely.Polygon(obstacle.polygon).buffer(0.0)
    return shapely.Point(obstacle.center).buffer(obstacle.radius, quad_segs=16)


def split(area: Ground, sweepers: Sequence[Sweeper], overlap: float, course: float | None) -> Split:
    """Deal the ground out so that the last is done as early as can be found.

    ``overlap``: share of a lane's width seen twice, from 0 to below 1. ``course``: of the lanes, rad counter-clockwise
    from east; None: the best of a few. Raises :class:`BadInput` where nobody can see anything.
    """
    if not 0.0 <= overlap < 0.95:
        text = f"search: an overlap of {overlap} is no share"
        raise BadInput(text, field="overlap", value=overlap, expected="0 to 0.9")
    courses = [course] if course is not None else directions(area.wanted, sweepers, overlap)
    best: tuple[tuple[float, float], list[Part]] | None = None
    for angle in courses:
        dealer = Dealer(area, sweepers, overlap, angle)
        for along in (False, True):
            if (parts := dealer.deal(along)) is not None:
                rank = dealer.rank(parts)
                best = (rank, parts) if best is None or rank < best[0] else best
    if best is None or not any(len(part.path) for part in best[1]):
        text = "search: no vehicle gets to the polygon and back within its endurance, with room there for its turns"
        expected = "more endurance, a nearer polygon, or more room around it"
        raise BadInput(text, field="vehicles", value=len(sweepers), expected=expected)
    return _report(area, best[1])


def _report(area: Ground, parts: list[Part]) -> Split:
    seen = shapely.union_all([part.seen(area.free) for part in parts])
    covered = float(seen.intersection(area.wanted).area / area.wanted.area)
    longest = max(part.seconds for part in parts)
    text = f"{area.wanted.area:.0f} m² in {longest:.0f} s, {100.0 * covered:.1f} % seen"
    dealt = sum(part.area.area for part in parts if len(part.path)) / area.wanted.area
    if dealt < 0.995:
        text += f": endurance suffices for {100.0 * dealt:.0f} % of it"
    return Split(tuple(parts), covered, text)


def directions(wanted: Any, sweepers: Sequence[Sweeper], overlap: float) -> list[float]:
    """Courses of lanes, the one with the fewest turns first: along edges of the polygon or of its hull (the width of a
    convex polygon is least square to one of its edges, Houle and Toussaint 1988).
    """
    width = float(np.mean([sweeper.width for sweeper in sweepers])) * (1.0 - overlap)
    rings = [piece.exterior for piece in shapely.get_parts(wanted)] + [wanted.convex_hull.exterior]
    found: dict[float, float] = {}
    for ring in rings:
        edges = np.diff(shapely.get_coordinates(shapely.simplify(ring, 0.5)), axis=0)
        for dx, dy in edges:
            if math.hypot(dx, dy) > width:
                found.setdefault(round(math.atan2(dy, dx) % math.pi, 3), 0.0)
    for angle in found:
        turned = affinity.rotate(wanted, -angle, origin=(0.0, 0.0), use_radians=True)
        left, bottom, right, top = turned.bounds
        lows = np.arange(bottom, top, max(width, (top - bottom) / 200.0))
        strips = shapely.intersection(turned, shapely.box(left, lows, right, lows + width))
        found[angle] = float(shapely.get_num_geometries(strips).sum())
    return sorted(found, key=lambda angle: (found[angle], angle))[:DIRECTIONS] or [0.0]
