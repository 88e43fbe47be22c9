"""Arguments and outcome of ``do/{verb}``: the orders that move, arm and configure a vehicle."""

from __future__ import annotations

from typing import Any, Literal

from zmav.wire.base import Told, Vector, Wire

UNKNOWN = "unknown"
"""the reason of a refusal to tell what became of an order that has not come"""
OTHER = "other"
"""the reason of a refusal by the one of two of one name that is not meant"""
DISARMED = "disarmed"
"""the reason of a refusal by a vehicle that flies nowhere"""


class Order(Wire, kw_only=True):
    """Base of all ``do/*`` arguments.

    With an ``id`` the order is done once however often it is sent, and answered within ``wait`` seconds with status
    "running" where it takes longer: ask again with the same id. Without one, the answer is the end of it.
    """

    id: str = ""
    """any text of up to 64 characters, new for each order: sent again with it, the order is not done again, and the
    answer says how far it is. Without one it comes at the end, for which Zenoh's own timeout may be too short"""
    wait: float = 0.5
    """s for an answer, of an order with an ``id``: "running" then, where it has not ended"""
    lease: str = ""
    """the one that is held, by its id"""
    uid: str = ""
    """of the autopilot that is meant, where two vehicles have one name: the other leaves the order alone"""
    given: float = 0.0
    """UTC seconds by its giver's clock: sent again, it is no newer than it was; 0: given when it was signed"""


class Again(Wire, kw_only=True):
    """In place of the arguments of an order too large to be sent twice: what became of the one with the id ``again``.

    Refused, with the reason "unknown", where that has not come.
    """

    again: str
    wait: float = 0.5


class Forced(Order, kw_only=True):
    """Base of the orders that lead a vehicle somewhere."""

    force: bool = False
    """an operator's: beyond the bounds that are only usual, not beyond those that the fleet file declares"""


class Arm(Order, kw_only=True):
    ready_timeout: float = 60.0
    """seconds to wait for the autopilot to be ready; 0: try at once"""


class Takeoff(Forced, kw_only=True):
    alt_rel: float
    """m above home"""


class GoTo(Forced, kw_only=True):
    """Fly to a point; ``frame`` and fields as in :class:`Setpoint`. Done when within ``tolerance`` metres of it."""

    frame: Literal["ned", "global"] = "ned"
    pos: Vector | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl: float | None = None
    alt_rel: float | None = None
    yaw: float | None = None
    tolerance: float = 1.0
    timeout: float = 300.0
    arrive: bool = True
    """False: done as soon as the autopilot has the target"""
    speed: float | None = None
    """m/s over the ground; given, or a radius, it goes there by the autopilot's own DO_REPOSITION"""
    radius: float | None = None
    """m of a plane's circle there; negative: counter-clockwise; None: the autopilot's own"""


class SetMode(Forced, kw_only=True):
    mode: str


class TakeLease(Order, kw_only=True):
    """``do/lease``: grant or renew. A higher priority takes it from a lower one; equals wait."""

    holder: str
    ttl: float = 3.0
    """seconds; every setpoint and order under the lease renews it"""
    priority: int = 0
    """0 to 100"""
    instance: str = ""
    """the last part of the holder's liveliness token: when that token goes, the lease ends at once"""
    router: str = ""
    """Zenoh id of the holder's router: where a link by datagrams lies between, the lease outlasts the token until its
    time, until another asks for it, or until the router is heard without the token
    """
    key: str = ""
    """the holder's X25519 public key (64 hexadecimal digits), where the vehicle asks for proofs of origin: see
    :mod:`zmav.trust.seal`; the answer carries the vehicle's. A renewal needs none"""


class DropLease(Order, kw_only=True):
    pass


class Outcome(Told, kw_only=True):
    """Reply to ``do/*``."""

    verb: str
    status: Literal["done", "running"]
    took: float
    """seconds since the order was first heard"""
    result: dict[str, Any] = {}


class OrderLine(Told, kw_only=True):
    """``@fleet/order``: an order that was given through a gateway, for the record."""

    t: float
    """when it had ended, or was under way"""
    who: str
    """what the caller calls himself, else the gateway's member; empty: not known"""
    source: str
    """address of his computer"""
    verb: str
    """``do/takeoff``, ``fleet/rtl``, ``swarm/submit``..."""
    vehicles: list[str] = []
    """names or patterns, as they were given; empty: all, or the planner's"""
    args: str = ""
    """JSON, cut off where it is long"""
    outcome: str
    """done, running, or why not"""
    took: float = 0.0
    """s"""
    more: int = 0
    """so many like it, since the last that was told, were not told one by one"""


class RunCommand(Forced, kw_only=True):
    """Any MAV_CMD by its name, with its parameters by name or by number.

    ``params`` holds the dialect's own labels (``{"Pitch": 0.2}``) or ``param1`` to ``param7``; enumerated parameters
    take the entry's name; None is NaN. ``frame`` (a MAV_FRAME's name) sends it as COMMAND_INT: param5 and param6 are
    then degrees.

    Refused is what its own verb would refuse. So are DO_SET_STANDARD_MODE (``set_mode`` enters a mode by its name) and
    DO_AUX_FUNCTION of a function that arms, disarms or flies the mission (ArduPilot: 16, 41, 81, 99, 153, 154, 165).
    """

    command: str
    params: dict[str, float | str | None] = {}
    frame: str | None = None


class SetServo(Order, kw_only=True):
    """DO_SET_SERVO: one output to a PWM in µs. On PX4 DO_SET_ACTUATOR takes its place."""

    output: int
    pwm: int


class CameraTrigger(Order, kw_only=True):
    """DO_SET_CAM_TRIGG_DIST: a picture at once, and another each time the vehicle has come so far over the ground.

    Given under a lease, it ends with that lease.
    """

    distance: float
    """m, 0.1 to 1000; 0: no more pictures"""


class TurnGimbal(Order, kw_only=True):
    """``do/gimbal_turn``: to angles in rad; without a ``pitch`` back to where it looks without orders (neutral)."""

    pitch: float | None = None
    """up from the horizon"""
    yaw: float = 0.0
    """to the right of the nose, and it turns with the vehicle; with ``lock`` from north"""
    lock: bool = False
    take: bool = False
    """its control also from somebody else who has it, such as a ground station"""


class PointGimbal(Order, kw_only=True):
    """``do/gimbal_point``: at a place, or at another vehicle of the fleet, until the next order to the gimbal. One of
    ``pos``, ``vehicle`` and ``lat_deg`` with ``lon_deg``; of the height above home 0 is taken where none is given.
    """

    pos: Vector | None = None
    """m, NED about the fleet's origin"""
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl: float | None = None
    alt_rel: float | None = None
    vehicle: str = ""
    take: bool = False


class RevokeLease(Order, kw_only=True):
    """An operator takes the lease from anyone who holds it."""

    reason: str = ""
