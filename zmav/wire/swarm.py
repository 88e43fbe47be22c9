"""The swarm: what the planning agent is asked (``{host}/swarm/{verb}``), and what it says of goals and plans.

Places are metres NED about the fleet's origin. A goal says what is to become true of some vehicles, not how.
"""

from __future__ import annotations

from typing import Literal

from zmav.wire.base import Told, Vector, Wire
from zmav.wire.orders import Order

Corner = tuple[float, float]
"""m north and east of the fleet's origin"""
Shape = Literal["line", "vee", "column", "circle", "grid", "custom"]


class Body(Wire, kw_only=True):
    """What a vehicle can do and how much room it needs; a planner reads it of every vehicle (``body``)."""

    radius: float
    """m: nothing else comes nearer to its centre; two vehicles keep the sum of theirs"""
    speed: float
    """m/s at most"""
    accel: float
    """m/s² at most, in any direction"""
    climb: float
    """m/s"""
    descend: float
    """m/s"""
    min_speed: float = 0.0
    """m/s: a plane's, which never hovers"""
    turn_radius: float = 0.0
    """m, at its speed; 0: it turns where it stands"""
    sweep_width: float = 10.0
    """m of ground that it sees on one pass"""
    endurance: float = 900.0
    """s of flight left to plan with, full"""
    reserve: float = 0.2
    """share of its battery with which it is to be on the ground again"""
    position_error: float | None = None
    """m across, one standard deviation, that it may be off where it says; None: by what its autopilot says"""


class BodyReport(Wire, kw_only=True):
    """Reply to ``body``."""

    kind: str | None
    """copter, plane, rover...; None: its autopilot was not heard yet"""
    body: Body
    declared: bool
    """by the fleet file; False: what is usual for the kind"""
    returns_after: float | None = None
    """s after its segment's end from which a way home may begin; None: it flies none (``return`` of the fleet file)"""


class SegmentInfo(Told, kw_only=True):
    """The committed trajectory that a vehicle flies, or has flown last under this lease."""

    lease: int
    """the lease's number"""
    seq: int
    """of the setpoint that brought it"""
    start: float
    """UTC seconds by the vehicle's clock; so are ``rests`` and ``end``"""
    rests: float
    """from then on it stays where it is"""
    end: float
    home: float | None = None
    """when the way home begins that it flies by itself if nothing else comes; None: it has none"""


class Beacon(Told, kw_only=True):
    """What a vehicle in flight tells its neighbours, so that they move aside by themselves: metres and m/s NED."""

    t: float
    pos: Vector
    vel: Vector
    radius: float
    ahead: list[Vector] = []
    """where what it flies has it in 1, 2, 3 and 4 s; empty: it goes on as it does"""


# Goals.


class GoTo(Wire, kw_only=True, tag_field="kind", tag="goto"):
    """Each vehicle to a place; ``labelled``: the first to the first; else the planner says who goes where."""

    vehicles: list[str]
    to: list[Vector]
    labelled: bool = True
    tight: bool = False
    """make no room for what the vehicles' positions may be off"""


class Formation(Wire, kw_only=True, tag_field="kind", tag="formation"):
    """Stand, and move, in a shape about a centre; a shape that does not fit through a gate is squeezed and restored."""

    vehicles: list[str]
    shape: Shape
    at: Vector
    """the shape's centre (its leader's place: line, vee, column)"""
    heading: float = 0.0
    """rad clockwise from north that the shape looks to"""
    spacing: float = 5.0
    """m between neighbours"""
    points: list[Vector] = []
    """custom: forward, right, down of the centre; one for each vehicle"""
    via: list[Vector] = []
    """the centre's way to ``at``, kept in shape"""
    labelled: bool = False
    """the first vehicle gets the first place; else the planner assigns them"""
    tight: bool = False
    """make no room for what the vehicles' positions may be off"""


class Follow(Wire, kw_only=True, tag_field="kind", tag="follow"):
    """Keep a place beside something that moves, until it is cancelled: a vehicle, or a published obstacle."""

    vehicles: list[str]
    leader: str
    """a vehicle's or an obstacle's name"""
    offsets: list[Vector] = []
    """north, east, down of the leader, one a vehicle; empty: south of it, staggered, at its height"""
    on_lost: Literal["hold", "return", "land"] = "hold"
    """when the leader was not heard for ``lost_after`` s"""
    lost_after: float = 3.0


class Search(Wire, kw_only=True, tag_field="kind", tag="search"):
    """Sweep a polygon, split between the vehicles by what each can do."""

    vehicles: list[str]
    polygon: list[Corner]
    height: float
    """m above the fleet's origin"""
    above_ground: bool = False
    """``height`` counts from the ground below, which the lanes follow: the planner must know it"""
    angle: float | None = None
    """rad clockwise from north of the lanes; None: the planner's choice"""
    overlap: float = 0.1
    """share of a lane's width seen twice"""
    lanes: list[list[Vector]] = []
    """what is left of a search that was dealt out before: each one's way over it (NED), in place of lanes of its own"""


class Survey(Search, kw_only=True, tag_field="kind", tag="survey"):
    """Photograph a polygon from above for a map: a search whose lanes follow from the camera. ``height`` counts from
    each one's home.
    """

    camera: tuple[float, float]
    """m of ground in a picture from 1 m above, across the way and along it: sensor over focal length"""
    overlap: float = 0.65
    """share of a picture that the lane beside it shows again"""
    front: float = 0.75
    """share of a picture that the next one along the way shows again"""
    pixels: int = 0
    """of a picture, across the way; 0: not known"""
    trigger: bool = False
    """each one's autopilot triggers its camera by distance over the lanes"""


class TakeOff(Wire, kw_only=True, tag_field="kind", tag="takeoff"):
    """Up from wherever they stand, in an order in which nobody meets."""

    vehicles: list[str]
    height: float
    """m above each one's home"""


class Land(Wire, kw_only=True, tag_field="kind", tag="land"):
    vehicles: list[str]
    at: list[Corner] = []
    """one a vehicle, whichever gets it; empty: below where each is, or where there is room"""


class Return(Wire, kw_only=True, tag_field="kind", tag="return"):
    """Home, each to where it took off, and land there."""

    vehicles: list[str]


class Hold(Wire, kw_only=True, tag_field="kind", tag="hold"):
    vehicles: list[str]


Goal = GoTo | Formation | Follow | Search | Survey | TakeOff | Land | Return | Hold

GoalState = Literal["queued", "planning", "flying", "paused", "done", "failed", "cancelled"]


class GoalEntry(Wire, kw_only=True):
    """A goal in the planner's book."""

    id: str
    goal: Goal
    state: GoalState
    t: float
    """when it was given"""
    by: str = ""
    """the member that gave it, where that is proven"""
    text: str = ""
    """what is going on, in words"""
    progress: float = 0.0
    """0 to 1"""
    makespan: float | None = None
    """s, of the plan being flown"""
    clearance: float | None = None
    """m: the least distance between two vehicles in it, less their radii"""
    landing: dict[str, float] = {}
    """while it goes on: share of its battery with which each is reckoned to land if it goes home after it"""


# Obstacles.


class Box(Wire, kw_only=True, tag_field="shape", tag="box"):
    """Opposite corners, NED."""

    low: Vector
    high: Vector


class Cylinder(Wire, kw_only=True, tag_field="shape", tag="cylinder"):
    center: Corner
    radius: float
    floor: float
    """m above the fleet's origin"""
    ceiling: float


class NoFly(Wire, kw_only=True, tag_field="shape", tag="no_fly"):
    polygon: list[Corner]
    floor: float
    ceiling: float


class Geofence(Wire, kw_only=True, tag_field="shape", tag="geofence"):
    """Vehicles stay inside; one at a time."""

    polygon: list[Corner]
    floor: float
    ceiling: float


class Ball(Wire, kw_only=True, tag_field="shape", tag="ball"):
    """Something that moves: where it was at ``t``, and how fast it goes."""

    center: Vector
    radius: float
    velocity: Vector = (0.0, 0.0, 0.0)


class Obstacle(Wire, kw_only=True):
    """Put on ``@obstacle/{name}`` by anyone who knows of it, or given to the planner with ``swarm/obstacle``."""

    name: str
    t: float
    what: Box | Cylinder | NoFly | Geofence | Ball | None
    """None: it is gone"""
    ttl: float | None = None
    """s after which it is forgotten unless said again; None: never"""


class Book(Wire, kw_only=True):
    """``@fleet/goal``: all that the planner in charge was asked; a standby takes over from it."""

    t: float
    planner: str
    instance: str
    term: int
    """counts the planners that were in charge, one after another: the higher one is"""
    paused: bool = False
    obstacles: int = 0
    """how many it keeps clear of: who takes over with fewer flies nothing"""
    goals: list[GoalEntry] = []


class Charge(Wire, kw_only=True):
    """``@fleet/charge``: who is in charge, several times a second and small: its book may be lost more often."""

    t: float
    planner: str
    instance: str
    term: int


class PlanReport(Wire, kw_only=True):
    """``@fleet/plan``: what is being flown, thinned out for people and viewers."""

    t: float
    planner: str
    goal: str
    start: float
    """UTC seconds"""
    makespan: float
    clearance: float | None
    tracks: dict[str, list[tuple[float, float, float, float]]]
    """by vehicle: s from the start, north, east, down"""


class ObstacleMap(Wire, kw_only=True):
    """``@fleet/obstacle``: all that the planner in charge keeps clear of."""

    t: float
    planner: str
    instance: str
    """of that planner: one that was just started again under its name may know of nothing"""
    obstacles: list[Obstacle]


# What the planner is asked.


class Submit(Order, kw_only=True):
    """``swarm/submit``. Done when it is in the book; the goal goes on by itself."""

    goal: Goal
    when: Literal["now", "queue"] = "now"
    """now: in the place of what its vehicles do; queue: after it"""


class Preview(Order, kw_only=True):
    """``swarm/preview``: what would be flown from here; nothing is."""

    goal: Goal


class GoalId(Order, kw_only=True):
    goal: str = ""
    """a goal's id; empty: all of them"""


class GiveObstacle(Order, kw_only=True):
    obstacle: Obstacle
