"""Up from crowded pads and down onto them: who goes when, how high, and where to, so that nobody meets.

Vehicles go up and down in columns. Two columns nearer than the vehicles need are used one after another, and those
who wait hover at heights one above the other: up the highest goes first, down the lowest. What leads over the ground
is a plan of the solver's. Wire frames (NED) are named so; places of :class:`PlanTo` are ENU.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from agents.planner.goals.steps import Loiter, Orders, PlanTo, Step, VehicleOrder, VehicleView
from agents.planner.live import frames
from agents.planner.model.problem import Floats
from agents.planner.solve.loiter import STEADY, Circling, loiter_slots
from zmav.errors import BadInput, Refused, Unsupported
from zmav.wire import Vector
from zmav.wire.swarm import Corner

WANDER = 0.5
"""m by which a vehicle in a column or at a hover may be off"""
APPROACH = 8.0
"""m above the ground of the lowest hover before a landing"""
SKY = 500.0
"""m above the origin: as high as planes are stacked"""
Free = Callable[[Vector, float], bool]
"""is told a place (NED) and a radius: whether it is clear of all obstacles, and inside"""
Approach = Callable[[Vector], float]
"""is told a landing place (NED): m above it of the lowest hover before the landing"""


def keep_of(a: VehicleView, b: VehicleView) -> float:
    """m between two centres, with what both may be off."""
    return a.body.radius + b.body.radius + 2.0 * WANDER


def stacked(
    views: Sequence[VehicleView], places: Sequence[Vector], downwash: float, planned: bool = False
) -> list[float]:
    """Metres to lift each of the places (NED), so that one too near another over the ground is above or below.

    The lowest stays; heights grow by what the downwash metric asks for. What places may be off across is no reason to
    be higher than two need that are right above each other, but where a plan is to end there (``planned``): none is
    made to goals that are nearer than all the room that it makes.
    """
    lifts = [0.0] * len(views)
    done: list[int] = []
    for i in sorted(range(len(views)), key=lambda k: -places[k][2]):
        height = -places[i][2]
        for j in sorted(done, key=lambda k: lifts[k] - places[k][2]):
            flat, keep = math.dist(places[i][:2], places[j][:2]), keep_of(views[i], views[j])
            if flat < keep:
                across = 0.0 if planned else views[i].room + views[j].room
                gap = downwash * math.sqrt((keep - across) ** 2 - max(0.0, flat - across) ** 2)
                other = lifts[j] - places[j][2]
                if abs(height - other) < gap:
                    height = other + gap
        lifts[i] = height + places[i][2]
        done.append(i)
    return lifts


def takeoff(views: Sequence[VehicleView], height: float, downwash: float, free: Free) -> list[Step]:
    """Everybody to ``height`` m above the place they stand on.

    Columns too near each other: the highest of a stack first; then all move to places apart at the height wanted.
    Raises :class:`Unsupported` for what cannot fly, :class:`Refused` for what flies already.
    """
    _check_flies(views, "take off")
    flying = [view.name for view in views if view.airborne]
    if flying:
        raise Refused(f"{', '.join(flying)} fly already", vehicles=flying)
    hover = [_lifted(view.pos_ned, height) for view in views]
    lifts = stacked(views, hover, downwash)
    tops = [_lifted(place, lift) for place, lift in zip(hover, lifts, strict=True)]
    order = sorted(range(len(views)), key=lambda i: (not views[i].hovers, tops[i][2]))
    orders: list[VehicleOrder] = []
    number: dict[int, int] = {}
    for i in order:
        after = tuple(number[j] for j in number if _in_the_way(views[i], hover[i], views[j], hover[j]))
        number[i] = len(orders)
        orders.append(VehicleOrder(views[i].name, "takeoff", {"alt_rel": round(height + lifts[i], 2)}, after))
    steps: list[Step] = [Orders(tuple(orders), f"taking off to {height:.0f} m")]
    lifted = [i for i in range(len(views)) if views[i].hovers]
    if any(lifts[i] > 0.0 for i in lifted):
        movers = [views[i] for i in lifted]
        places = spread(movers, [hover[i] for i in lifted], downwash, free, field="height")
        steps.append(PlanTo(tuple(v.name for v in movers), _enu(places), False, "moving apart after takeoff"))
    return steps


def _in_the_way(a: VehicleView, place_a: Vector, b: VehicleView, place_b: Vector) -> bool:
    """Whether two columns are too near each other to be used at once; planes have the sky for themselves."""
    if not (a.hovers and b.hovers):
        return True
    return math.dist(place_a[:2], place_b[:2]) < keep_of(a, b)


def land(
    views: Sequence[VehicleView], at: Sequence[Corner], downwash: float, free: Free, approach: Approach
) -> list[Step]:
    """Onto the places ``at``, whichever gets which, or below each, or where there is room near by. Who stands on the
    ground has landed: it is told to where its motors still run.

    Raises :class:`Unsupported` for planes and for what does not fly, :class:`Refused` for places where somebody stands
    on the ground, and :class:`BadInput` for places that are too few, or none that are free.
    """
    _check_flies(views, "land")
    winged = [view.name for view in views if not view.hovers]
    if winged:
        text = f"{', '.join(winged)} cannot land on a spot: give a landing as a mission, or have them return"
        raise Unsupported(text, vehicles=winged)
    down = [view for view in views if not view.airborne]
    if at and down:
        names = [view.name for view in down]
        raise Refused(
            f"{', '.join(names)}: on the ground, and a place to land on is flown to: take off", vehicles=names
        )
    stopping = tuple(VehicleOrder(view.name, "land") for view in down if view.armed)
    steps: list[Step] = [Orders(stopping, "disarming on the ground")] if stopping else []
    views = [view for view in views if view.airborne]
    if not views:
        return steps
    ground = [view.floor for view in views]
    if not at:
        below = [(view.pos_ned[0], view.pos_ned[1], floor) for view, floor in zip(views, ground, strict=True)]
        apart = spread(views, below, math.inf, free, field="at")
        return steps + down_to(views, apart, downwash, approach)
    if len(at) != len(views):
        text = f"{len(at)} places to land for {len(views)} vehicles"
        raise BadInput(text, field="at", value=len(at), expected=f"{len(views)}, or none")
    spots = [(float(n), float(e), min(ground)) for n, e in at]  # as high as the highest ground, which is the least down
    for i, j in combinations(range(len(spots)), 2):
        keep = sum(sorted(view.body.radius for view in views)[-2:])
        if math.dist(spots[i], spots[j]) < keep:
            text = f"at[{i}] and at[{j}] are {math.dist(spots[i], spots[j]):.1f} m apart"
            raise BadInput(text, field="at", value=[list(at[i]), list(at[j])], expected=f"{keep:.1f} m or more")
    nearest = _assigned(views, spots)
    return down_to(views, [spots[k] for k in nearest], downwash, approach)


def home(views: Sequence[VehicleView], downwash: float, approach: Approach) -> list[Step]:
    """Each to where it took off, and down there: those whose pads are near each other one after another.

    Planes circle above their homes, at heights of their own; rovers drive there. Raises :class:`Refused` for a vehicle
    whose home is not known.
    """
    lost = [view.name for view in views if view.home_ned is None and (view.flies or view.armed)]
    if lost:
        raise Refused(f"the home of {', '.join(lost)} is not known", vehicles=lost)
    steps: list[Step] = []
    flying = [view for view in views if view.flies and view.hovers and view.airborne]
    driving = [view for view in views if not view.flies and view.home_ned is not None]
    planes = [view for view in views if not view.hovers and view.airborne]
    if planes:
        steps.append(circles(planes, [view.home_ned or view.pos_ned for view in planes], downwash))
    if flying:
        spots = [view.home_ned or view.pos_ned for view in flying]
        steps += down_to(flying, spots, downwash, approach, driving)
    elif driving:
        steps.append(PlanTo(_names(driving), _enu([v.home_ned or v.pos_ned for v in driving]), True, "driving home"))
    return steps


def circles(planes: Sequence[VehicleView], places: Sequence[Vector], downwash: float) -> Loiter:
    """Planes to circles about places (NED), as high as each is now or as high as the place is, whichever is higher."""
    wanted = [
        Circling(v.name, v.body, v.pos_ned, (place[0], place[1], min(v.pos_ned[2], place[2])))
        for v, place in zip(planes, places, strict=True)
    ]
    lowest = min(-plane.pos_ned[2] for plane in wanted)
    found = loiter_slots(wanted, min(lowest, 4.0 * STEADY), SKY, downwash)
    return Loiter(tuple(found), "circling at heights of their own")


def down_to(
    views: Sequence[VehicleView],
    spots: Sequence[Vector],
    downwash: float,
    approach: Approach,
    driving: Sequence[VehicleView] = (),
) -> list[Step]:
    """Each to a hover above its spot (NED), and down: of those above each other the lowest first."""
    hover = [_lifted(spot, approach(spot)) for spot in spots]
    lifts = stacked(views, hover, downwash, planned=True)
    tops = [_lifted(place, lift) for place, lift in zip(hover, lifts, strict=True)]
    places = [*tops, *(view.home_ned or view.pos_ned for view in driving)]
    plan = PlanTo(_names([*views, *driving]), _enu(places), True, "to the places above where they land")
    orders: list[VehicleOrder] = []
    number: dict[int, int] = {}
    for i in sorted(range(len(views)), key=lambda k: -tops[k][2]):
        after = tuple(number[j] for j in number if _in_the_way(views[i], spots[i], views[j], spots[j]))
        number[i] = len(orders)
        orders.append(VehicleOrder(views[i].name, "land", {}, after))
    return [plan, Orders(tuple(orders), f"landing {len(views)}")]


def spread(
    views: Sequence[VehicleView], places: Sequence[Vector], downwash: float, free: Free, *, field: str
) -> list[Vector]:
    """Places near those given, clear, and so far from each other as the vehicles need; most stay where they are.

    ``downwash`` inf: heights do not count, the columns shall be apart. Raises :class:`BadInput` where there is no room.
    """
    taken: list[Vector] = []
    for i, place in enumerate(places):
        widest = max((keep_of(views[i], other) for other in views), default=1.0)

        def fits(candidate: Vector, i: int = i) -> bool:
            apart = all(
                _scaled(candidate, other, downwash) >= keep_of(views[i], views[k]) for k, other in enumerate(taken)
            )
            return apart and free(candidate, views[i].body.radius)

        found = next((candidate for candidate in rings(place, 0.55 * widest) if fits(candidate)), None)
        if found is None:
            text = f"there is no free place for {views[i].name} near {place[0]:.1f}, {place[1]:.1f}"
            raise BadInput(text, field=field, value=list(place), expected="room")
        taken.append(found)
    return taken


def rings(place: Vector, step: float) -> list[Vector]:
    """The place and rings of others around it, nearest first."""
    found = [
        (place[0] + k * step * math.cos(math.tau * n / (6 * k)), place[1] + k * step * math.sin(math.tau * n / (6 * k)))
        for k in range(1, 25)
        for n in range(6 * k)
    ]
    return [place, *((north, east, place[2]) for north, east in found)]


def _scaled(a: Vector, b: Vector, downwash: float) -> float:
    return math.hypot(math.dist(a[:2], b[:2]), (a[2] - b[2]) / downwash)


def _assigned(views: Sequence[VehicleView], spots: Sequence[Vector]) -> list[int]:
    """Which spot each gets: so that the ways over the ground, squared, are least together."""
    from scipy.optimize import linear_sum_assignment

    cost = [[math.dist(view.pos_ned[:2], spot[:2]) ** 2 for spot in spots] for view in views]
    return [int(k) for k in linear_sum_assignment(np.array(cost))[1]]


def _check_flies(views: Sequence[VehicleView], what: str) -> None:
    grounded = [view.name for view in views if not view.flies]
    if grounded:
        raise Unsupported(f"{', '.join(grounded)} cannot {what}: they do not fly", vehicles=grounded)


def _names(views: Sequence[VehicleView]) -> tuple[str, ...]:
    return tuple(view.name for view in views)


def _lifted(place: Vector, metres: float) -> Vector:
    return (place[0], place[1], place[2] - metres)


def _enu(places: Sequence[Vector]) -> Floats:
    return frames.enu_array(np.array(places, dtype=np.float64).reshape(-1, 3))
