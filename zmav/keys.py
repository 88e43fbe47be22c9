"""The channel registry: every key zmav uses, listed once.

The key space is the API. Access rules, the recorder, staleness checks and the key reference are derived from
:data:`CHANNELS`; nothing else in the tree spells a key out. ``{fleet}`` and ``{vehicle}`` are names matching
``[a-z0-9_-]+``; the chunk behind the vehicle says the direction or class, so that rules match at fixed places.
"""

from __future__ import annotations

import enum
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import zenoh

from zmav import wire
from zmav.errors import BadKey

ROOT = "zmav"
NAME = re.compile(r"[a-z0-9_-]+\Z")
NAMES = re.compile(r"[a-z0-9_*-]+\Z")
"""a pattern of names: ``*`` for any part"""
MESSAGE = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


class Qos(enum.Enum):
    """The four classes of service, and no more."""

    REALTIME = "realtime"
    MUST_ARRIVE = "must-arrive"
    LATEST_WINS = "latest-wins"
    BULK = "bulk"

    @property
    def priority(self) -> zenoh.Priority:
        return _PRIORITY[self]

    def options(self) -> dict[str, Any]:
        """Keyword arguments for ``declare_publisher``, ``put`` and ``get``: never a blocking put, never express."""
        return {"priority": self.priority, "congestion_control": zenoh.CongestionControl.DROP, "express": False}


_PRIORITY = {
    Qos.REALTIME: zenoh.Priority.REAL_TIME,
    Qos.MUST_ARRIVE: zenoh.Priority.INTERACTIVE_HIGH,
    Qos.LATEST_WINS: zenoh.Priority.DATA,
    Qos.BULK: zenoh.Priority.BACKGROUND,
}

VEHICLE, OPERATOR, PLANNER, VIEWER = "vehicle", "operator", "planner", "viewer"
REPLAY = "replay"
"""the role in the tokens of recorded vehicles, and the last word in the name of the fleets they are played in"""
AGENT = "agent"
"""a vehicle's own programs, which speak with its certificate, and about that vehicle only"""
ROUTER = "router"
"""the role in the token of a router without a vehicle"""
ANYONE = "anyone"
"""every member of the fleet"""
PROGRAMS = (AGENT, PLANNER, OPERATOR)
HOSTS = (VEHICLE, OPERATOR, PLANNER)
"""what has a router of its own"""
JSON = zenoh.Encoding.APPLICATION_JSON
RAW = zenoh.Encoding.ZENOH_BYTES  # the default encoding: costs no byte on the wire


@dataclass(frozen=True)
class Channel:
    """One line of the registry.

    ``path`` is what stands behind the vehicle, or, where it begins with an @, behind the fleet. ``kind`` is ``pub``
    (the vehicle publishes), ``put`` (others write), ``query`` (others ask), ``token`` (liveliness). ``writers`` are the
    roles that may put or ask (of ``do``, :data:`zmav.verbs.VERBS` says it verb by verb, of ``fleet``, :data:`TOPICS`
    topic by topic: see :mod:`zmav.trust.rights`); ``rate_hz`` is nominal; older than ``stale_after`` seconds is stale.
    ``proven``: the vehicle takes it with a proof of origin only, where it has credentials: see :mod:`zmav.trust.proof`.
    ``version``: of the payload; it moves where an older program would misread a newer one's, or a newer an older one's
    (one more field with a default is no such change). ``others``: payloads besides, such as what a query carries.
    ``answerers`` are the roles whose answers a member believes, signed by who answers; of other channels any answer is
    taken. ``repeated``: what a link loses is sent again; else nothing waits for it, which is better for what comes
    again soon (docs/qos.md).
    """

    name: str
    path: str
    payload: type | None = None
    kind: str = "pub"
    qos: Qos = Qos.LATEST_WINS
    writers: tuple[str, ...] = (VEHICLE,)
    encoding: zenoh.Encoding = JSON
    rate_hz: float | None = None
    stale_after: float | None = None
    recorded: bool = False
    proven: bool = False
    answerers: tuple[str, ...] = ()
    repeated: bool = True
    version: int = 1
    others: tuple[type, ...] = ()

    @cached_property
    def template(self) -> str:
        """What stands behind the root."""
        return f"{{fleet}}/{self.path}" if self.path.startswith("@") else f"{{fleet}}/{{vehicle}}/{self.path}"

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """Of its keys; made when first asked for, as all of them take a twentieth of a verb's start. A fleet and a
        vehicle are names, so that ``@fleet`` is nobody's; other parts may hold whatever a key may.
        """
        named = re.sub(r"{(fleet|vehicle)}", r"(?P<\1>[a-z0-9_-]+)", self.template)
        return re.compile(f"{ROOT}/" + re.sub(r"{(\w+)}", r"(?P<\1>[^/]+)", named) + r"\Z")

    def publishing(self) -> dict[str, Any]:
        """Keyword arguments for ``declare_publisher``."""
        lane = zenoh.Reliability.RELIABLE if self.repeated else zenoh.Reliability.BEST_EFFORT
        return {"encoding": self.encoding, "reliability": lane, **self.qos.options()}

    def key(self, fleet: str, vehicle: str = "", **chunks: object) -> str:
        """The key (or key expression, with ``*`` for any part) of this channel."""
        return f"{ROOT}/" + self.template.format(fleet=fleet, vehicle=vehicle, **chunks)


_put = partial(Channel, kind="put")
_asked = partial(Channel, kind="query", qos=Qos.MUST_ARRIVE, writers=(ANYONE,))
_token = partial(Channel, kind="token", qos=Qos.MUST_ARRIVE, writers=(ANYONE,))
_pictures = partial(Channel, qos=Qos.BULK, writers=(VEHICLE, AGENT), encoding=RAW, stale_after=1.0, repeated=False)
_watched = partial(_put, payload=wire.FrameReport, writers=(ANYONE,), rate_hz=2.0, stale_after=3.0, repeated=False)

RX = Channel("rx", "mav/rx/{sys}/{comp}/{msg}", encoding=RAW, recorded=True)
"""raw MAVLink frame, as it came from the vehicle"""
TX = _put("tx", "mav/tx/{sys}/{comp}/{msg}", writers=(OPERATOR,), encoding=RAW, recorded=True, proven=True)
"""raw MAVLink frame for the vehicle; sys and comp are the target"""
STATE = Channel("state", "state", wire.VehicleState, rate_hz=5.0, stale_after=2.0, recorded=True, repeated=False)
"""what the vehicle is and does; also its heartbeat of presence; answers queries too"""
EVENT = Channel("event", "event", wire.Event, qos=Qos.MUST_ARRIVE, recorded=True)
"""status text, mode, failsafe step, lease, refusals; cached and recovered"""
MSG = _asked("msg", "msg/{msg}", wire.LastMessage, answerers=(VEHICLE,))
"""the last such message, decoded, with its age"""
DO = _asked(
    "do",
    "do/{verb}",
    wire.Outcome,
    writers=(OPERATOR, PLANNER, AGENT, VIEWER),
    recorded=True,
    proven=True,
    answerers=(VEHICLE,),
)
"""a command: JSON arguments in, JSON outcome or error out"""
SETPOINT = _put(
    "setpoint",
    "setpoint/{agent}",
    wire.Setpoint,
    qos=Qos.REALTIME,
    writers=PROGRAMS,
    rate_hz=10.0,
    stale_after=0.5,
    recorded=True,
    repeated=False,
)
"""one point of an outer-loop command stream"""
BODY = _asked("body", "body", wire.swarm.BodyReport, answerers=(VEHICLE,))
"""how much room the vehicle needs and what it can do, for planners"""
BEACON = Channel("beacon", "beacon", wire.swarm.Beacon, rate_hz=1.0, stale_after=1.5, repeated=False)
"""in flight: where the vehicle is about to be, for its neighbours' last resort against a collision"""
SCHEMA = _asked("schema", "schema/{schema}")
"""JSON Schema of a payload, by its name as in docs/keys.md; under ``asyncapi`` the whole of this key space"""
HOST = _asked("host", "host", wire.HostReport)
"""how the host's computer is: versions, disks, memory, load, heat, power, what keeps its clock"""
PARAMS = _asked("params", "param", wire.ParamTable, answerers=(VEHICLE,), others=(wire.ParamQuery,))
"""the whole parameter set, from the vehicle's cache; unchanged sets cost a line"""
PARAM = _asked("param", "param/{param}", wire.Param, answerers=(VEHICLE,))
"""one parameter, from the vehicle's cache"""
MISSION = _asked("mission", "mission/{kind}", wire.Mission, answerers=(VEHICLE,))
"""mission, fence or rally points, from the vehicle's cache"""
TERRAIN = _asked("terrain", "terrain", wire.TerrainReport, answerers=(VEHICLE,))
"""what the vehicle knows of the ground, and what its autopilot still wants of it"""
FILE = _asked("file", "file/{file}", wire.StoredFile)
"""a file or log fetched from the autopilot: what it is"""
FILE_CHUNK = _asked("file_chunk", "file/{file}/{offset}", qos=Qos.BULK, encoding=RAW, others=(wire.FileQuery,))
"""its bytes: ask for offset * with a FileQuery, answered by chunks under their offsets"""
RATES = _asked("rates", "rates", wire.RateTable)
"""message statistics: what comes, what was asked for, what is shed"""
WANT = _token("want", "want/{msg}/{hz}/{instance}")
"""liveliness token of a reader who wants a message at a rate in Hz"""
HOLDER = _token("holder", "holder/{holder}/{instance}", writers=PROGRAMS)
"""liveliness token of who holds a lease: when it goes, the lease ends"""
LINK = Channel(
    "link",
    "link/{link}",
    wire.LinkQuality,
    writers=HOSTS,
    rate_hz=1.0,
    stale_after=5.0,
    recorded=True,
    others=(wire.NeighbourQuality,),
)
"""quality of one link: the autopilot's, or to a neighbour (a NeighbourQuality); answers queries too"""
PROBE = Channel("probe", "@probe/{to}/{vehicle}", writers=HOSTS, encoding=RAW, rate_hz=4.0, repeated=False)
"""one router's small probes of another by its id; behind an @, so that nobody's wildcard carries them on"""
AGENT_STATUS = Channel(
    "agent_status",
    "agent/{agent}/status",
    wire.AgentStatus,
    writers=PROGRAMS,
    rate_hz=1.0,
    stale_after=5.0,
    recorded=True,
)
"""what an agent does"""
AGENT_DO = _asked(
    "agent_do",
    "agent/{agent}/do/{verb}",
    wire.Outcome,
    writers=PROGRAMS,
    recorded=True,
    proven=True,
    answerers=PROGRAMS,
)
"""an order to an agent that runs for the vehicle, wherever it runs"""
AGENT_PARAM = Channel("agent_param", "agent/{agent}/param/{param}", wire.TunableInfo, writers=PROGRAMS, recorded=True)
"""a parameter of an agent when it changes; answers queries too"""
AGENT_OUT = Channel(
    "agent_out",
    "agent/{agent}/out/{topic}",
    wire.Signals,
    writers=PROGRAMS,
    rate_hz=50.0,
    stale_after=1.0,
    recorded=True,
    repeated=False,
)
"""numbers that an agent streams: references, errors, integrators, outputs"""
SLOT = _token("slot", "slot/{target}/{slot}/{since}/{instance}", writers=PROGRAMS)
"""liveliness token: the vehicle keeps a place relative to a target, since when (UTC ms); the first has it"""
FRAME = _pictures("camera_frame", "camera/{camera}/frame")
"""pictures as JPEG in chunks of at most 1.1 kB, each with its place in the picture and the time of exposure"""
CAMERA = _asked("camera", "camera/{camera}/info", wire.CameraInfo)
"""the camera's lens, mount, size and rate"""
FRAME_REPORT = _watched("frame_report", "camera/{camera}/report/{reader}")
"""what comes of the pictures at a reader, whose link they are adapted to"""
VIDEO = _pictures("camera_video", "camera/{camera}/video")
"""H.264 as the camera encodes it: access units in chunks of at most 1.1 kB (docs/video.md)"""
VIDEO_INFO = _asked("camera_stream", "camera/{camera}/stream", wire.VideoInfo)
"""the video's size, rate and source"""
VIDEO_REPORT = _watched("video_report", "camera/{camera}/watcher/{reader}")
"""what comes of the video at a reader, and whether it waits for a key frame"""
DETECTION = Channel(
    "camera_detection",
    "camera/{camera}/detection",
    wire.Detections,
    writers=(AGENT, OPERATOR, PLANNER),
    rate_hz=15.0,
    stale_after=0.5,
    recorded=True,
    repeated=False,
)
"""what was found in each picture, and where that is"""
ALIVE = _token("alive", "alive/{role}/{sys}/{autopilot}/{uid}/{instance}")
"""liveliness token of a vehicle, agent or ground node"""
CERTIFICATE = _asked("certificate", "certificate", encoding=RAW)
"""the vehicle's certificate (DER), by which what it signs is told from what others say of it"""
BENCH = _asked(
    "bench",
    "bench/order/{order}",
    wire.BenchReport,
    writers=(OPERATOR,),
    proven=True,
    others=(wire.BenchOrder, wire.BenchStop),
)
"""start or stop this host's part in measuring the network"""
BENCH_REPORT = _asked("bench_report", "bench/report/{run}", wire.BenchReport, others=(wire.BenchQuery,))
"""what a host has measured in a run"""
BENCH_PING = _asked("bench_ping", "bench/ping", wire.Pong)
"""answered at once: which host it is, and its clocks"""
BENCH_FLOW = Channel("bench_flow", "bench/flow/{run}", qos=Qos.BULK, writers=HOSTS, encoding=RAW)
"""the datagrams of a measurement, in the class that is measured"""
RTCM = _put(
    "rtcm",
    "@fleet/rtcm",
    qos=Qos.REALTIME,
    writers=(OPERATOR,),
    encoding=RAW,
    rate_hz=1.0,
    stale_after=5.0,
    repeated=False,
)
"""corrections for GNSS receivers, once for the whole fleet: messages of RTCM 3 behind a header (zmav/corrections.py)"""
TRAFFIC = _put(
    "traffic",
    "@fleet/traffic",
    wire.Traffic,
    writers=(OPERATOR, VEHICLE),
    rate_hz=1.0,
    stale_after=5.0,
    recorded=True,
    repeated=False,
)
"""aircraft that are not of the fleet, by feeds on the ground and by receivers of autopilots: the nearest, bounded"""
FLEET = Channel("fleet", "@fleet/{topic}", writers=(OPERATOR, PLANNER), recorded=True)
"""fleet-wide topics: origin, goal, charge, plan, obstacle, order, roster"""
SWARM = _asked(
    "swarm", "swarm/{verb}", wire.Outcome, writers=(OPERATOR, PLANNER), recorded=True, proven=True, answerers=PROGRAMS
)
"""an order for several vehicles at once, to the planner in charge (the vehicle here is its host)"""
OBSTACLE = Channel("obstacle", "@obstacle/{name}", wire.swarm.Obstacle, writers=(OPERATOR, PLANNER), recorded=True)
"""something to keep clear of, by anyone who knows of it; said again before its ttl is over"""
HISTORY = _asked("history", "history/{of}/{what}", wire.History, others=(wire.HistoryQuery,))
"""what a recorder (the vehicle here is its host) knows of another's state, events or messages, now or then"""

CHANNELS: dict[str, Channel] = {c.name: c for c in vars().copy().values() if isinstance(c, Channel)}
VEHICLES_OWN = tuple(c for c in CHANNELS.values() if c.kind == "pub" and c.writers == (VEHICLE,))
"""what vehicles alone publish: under any other name it is believed of nobody"""
IsVehicle = Callable[[str, str], bool]
"""``is_vehicle(fleet, name)``: whether that is a vehicle, as far as anybody can tell"""
ROSTER = "roster"
"""the fleet's topic on which the authority's roster travels"""
ORDERED = "order"
"""the fleet's topic on which gateways say what they were told to do"""
TOPICS: dict[str, tuple[str, ...]] = {
    "origin": (OPERATOR, PLANNER),
    "goal": (OPERATOR, PLANNER),
    "charge": (OPERATOR, PLANNER),
    "plan": (OPERATOR, PLANNER),
    "obstacle": (OPERATOR, PLANNER),
    ORDERED: (OPERATOR, PLANNER),
    ROSTER: (ANYONE,),  # anyone who passes it on: only the authority can sign one
}
"""who may put which of the fleet's topics; others are as the channel says"""
TOPIC_PAYLOADS: dict[str, type] = {
    "origin": wire.Origin,
    "goal": wire.swarm.Book,
    "charge": wire.swarm.Charge,
    "plan": wire.swarm.PlanReport,
    "obstacle": wire.swarm.ObstacleMap,
    ORDERED: wire.OrderLine,
}
"""what they carry; of the roster :mod:`zmav.trust.roster` says it"""


def proven(channel: Channel, parts: Mapping[str, str]) -> bool:
    """What is put or asked there needs a proof of origin, where the fleet has credentials. Rosters bring their own."""
    return channel.proven or told_to_all(channel, parts)


def told_to_all(channel: Channel, parts: Mapping[str, str]) -> bool:
    """It says to every planner where vehicles fly and what is in their way, or to vehicles what their receivers go by:
    each listener judges who said it.
    """
    return channel in (OBSTACLE, RTCM, TRAFFIC) or (channel is FLEET and parts["topic"] != ROSTER)


def check_name(name: str, field: str = "name") -> str:
    """``name`` itself where it may stand in a key; raises :class:`BadKey` otherwise."""
    if not NAME.match(name):
        text = f"{field} {name!r} cannot stand in a key: use lower-case letters, digits, '_' and '-'"
        raise BadKey(text, field=field, value=name, expected="[a-z0-9_-]+")
    return name


def anything(fleet: str, name: str) -> bool:
    """:data:`IsVehicle` without credentials, where nobody can tell."""
    return True


def is_replay(fleet: str) -> bool:
    """What this fleet's vehicles say was recorded: they hear no orders. See :func:`replay_of`."""
    return fleet == REPLAY or fleet.endswith(f"-{REPLAY}")


def replay_of(fleet: str) -> str:
    """The fleet in which recordings of ``fleet`` are played: never its own, where they would be taken for vehicles."""
    return fleet if is_replay(fleet) else f"{fleet}-{REPLAY}"


def hears(listening: str, key: str) -> bool:
    """Whether who listens to (or asks) a key expression is meant by what came on ``key``: of a recording only who names
    its fleet is. Vehicles that are flown and those that were flown never come together.
    """
    return is_replay(_fleet_of(listening)) or not is_replay(_fleet_of(key))


def _fleet_of(key: str) -> str:
    """The chunk after the root; empty where there is none."""
    root, _, rest = key.partition("/")
    return rest.partition("/")[0] if root == ROOT else ""


def check_message(name: str) -> str:
    """``name`` itself where it can be a MAVLink message's or ``UNKNOWN_44000``; raises :class:`BadKey` otherwise."""
    if not MESSAGE.match(name):
        text = f"{name!r} cannot be a message's name: they are like ATTITUDE or GPS_RAW_INT"
        raise BadKey(text, field="msg", value=name, expected="[A-Za-z][A-Za-z0-9_]*")
    return name


def match(key: str) -> tuple[Channel, dict[str, str]]:
    """The channel a concrete key belongs to, and its parts by name; raises :class:`BadKey` for a foreign key."""
    for channel in CHANNELS.values():
        found = channel.pattern.match(key)
        if found:
            return channel, found.groupdict()
    raise BadKey(f"{key!r} is not a zmav key", field="key", value=key, expected=f"{ROOT}/<fleet>/<vehicle>/...")


def answerers(key: str) -> tuple[str, ...]:
    """Whose answers are believed on a key; empty where anybody's are, and for key expressions with a wildcard."""
    try:
        return () if "*" in key else match(key)[0].answerers
    except BadKey:
        return ()


def expression(text: str, fleet: str = "*") -> str:
    """A key expression from what a person types.

    ``zmav/...`` and ``@...`` are taken as they are. Otherwise the first chunk names vehicles and the rest a channel:
    ``quad1`` is its state, ``quad*/ATTITUDE`` a message of several vehicles, ``quad1/link/*`` anything below a vehicle.
    A shell-like ``*`` inside a chunk is put in Zenoh's way (``quad$*``). Raises :class:`BadKey` naming the fault.
    """
    if not text.startswith((ROOT + "/", "@", "**")):
        vehicle, _, rest = text.partition("/")
        if not rest:
            rest = "state"
        elif "/" not in rest and re.match(r"[A-Z0-9_*]+\Z", rest) and rest not in ("*", "**"):
            rest = f"mav/rx/*/*/{rest}"
        text = f"{ROOT}/{fleet}/{vehicle}/{rest}"
    chunks = [c if c in ("*", "**") else re.sub(r"(?<!\$)\*+", "$*", c) for c in text.split("/")]
    try:
        return str(zenoh.KeyExpr.autocanonize("/".join(chunks)))
    except (zenoh.ZError, UnicodeError) as e:
        why = str(e).partition(" at /")[0]  # the rest is a place in Zenoh's sources
        raise BadKey(
            f"{text!r} is not a key expression: {why}", field="key", value=text, expected="VEHICLE/MESSAGE or zmav/..."
        ) from e
