"""JSON that travels under the keys: each type decoded, encoded again, and used by what reads it first."""

from __future__ import annotations

import contextlib
import functools
import json
import random
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
from msgspec import inspect

from agents.planner.live.checks import check_goal, check_obstacle
from ground.http.arguments import object_of
from ground.http.documents import document_of
from ground.record import schemas
from ground.record.part import Route, stamp
from mesh import linkstate
from tests.fuzz.engine import Target, pure
from tests.fuzz.targets.frames import the_dialect
from zmav import keys, wire
from zmav.config import Limits
from zmav.doctor.rules import of_state
from zmav.errors import BadInput
from zmav.services.authority import limits as limits_of
from zmav.services.authority.targets import resolve
from zmav.services.authority.trajectory import Segment
from zmav.trust.roster import HeldRoster
from zmav.wire import swarm

ORIGIN = wire.Origin(lat_deg=52.75, lon_deg=-1.25, alt_amsl=60.0)
NOW = 1_700_000_000.0


def _decoded(kind: type[msgspec.Struct], data: bytes) -> msgspec.Struct:
    if kind in (wire.LinkQuality, wire.NeighbourQuality):
        return wire.decode_link(data)
    if issubclass(kind, wire.Order):
        wire.refuse_repeated(data, kind.__name__)
    return wire.decode(data, kind, kind.__name__)


def take(data: bytes) -> None:
    """The first line names the type; where it names none, the length chooses."""
    name, _, body = data.partition(b"\n")
    kinds = _kinds()
    kind = kinds.get(name.decode("latin-1")) or kinds[sorted(kinds)[len(data) % len(kinds)]]
    value = _decoded(kind, body)
    _decoded(kind, wire.encode(value))
    use = USED.get(type(value))
    if use is not None:
        use(value)


def _fly(point: Any) -> None:
    target = resolve(point, ORIGIN)
    limits_of.check(target, None, Limits(speed=12.0, climb=3.0), None, None, flat=False)


def _setpoint(point: wire.Setpoint) -> None:
    if point.segment is None:
        _fly(point)
        return
    segment = Segment(point.segment, ORIGIN, NOW)
    segment.check(None, Limits(speed=12.0, climb=3.0), 60.0)
    for t in (segment.start - 1.0, (segment.start + segment.end) / 2, segment.end + 1.0):
        segment.at(t)


def _state(state: wire.VehicleState) -> None:
    schemas.location(state)
    of_state(state)
    document_of(keys.STATE.key("demo", "quad1"), NOW, wire.encode(state), "", the_dialect())


USED: dict[type, Callable[[Any], object]] = {
    wire.Setpoint: _setpoint,
    wire.GoTo: _fly,
    wire.VehicleState: _state,
    swarm.Submit: lambda order: check_goal(order.goal),
    swarm.Obstacle: check_obstacle,
    wire.Signals: schemas.of_signals,
}


@functools.cache
def _kinds() -> dict[str, type[msgspec.Struct]]:
    """Every payload there is, by its name."""
    found: dict[str, type[msgspec.Struct]] = {"HeldRoster": HeldRoster}
    for module in (wire, swarm):
        for name, each in vars(module).items():
            if isinstance(each, type) and issubclass(each, wire.Wire):
                found.setdefault(name, each)
    return found


def payloads() -> list[bytes]:
    """One of each type that is whole, and one that is as short as may be."""
    found = []
    for name, kind in _kinds().items():
        for whole in (True, False):
            found.append(name.encode() + b"\n" + json.dumps(example(kind, whole)).encode())
    segment = [{"t": NOW + t, "pos": [3.0 * t, 0.0, -8.0], "yaw": 0.1 * t} for t in range(4)]
    seconds = {"lease": "a", "seq": 1, "deadline": NOW + 9}
    for more in (
        {"segment": segment},
        {"pos": [1, 2, -3], "vel": [1, 0, 0]},
        {"attitude": [1, 0, 0, 0], "thrust": 0.5},
    ):
        found.append(b"Setpoint\n" + json.dumps({**seconds, **more}).encode())
    return found


def example(kind: type[msgspec.Struct], whole: bool) -> Any:
    """One of a type, with all its fields or with those that it must have, as JSON has it."""
    return _example(inspect.type_info(kind), whole)


def _example(kind: inspect.Type, whole: bool) -> Any:
    """A value of a type, as JSON has it."""
    match kind:
        case inspect.StructType():
            wanted = (f for f in kind.fields if whole or f.required)
            tag = {kind.tag_field: kind.tag} if kind.tag_field else {}
            return {**tag, **{f.encode_name: _example(f.type, whole) for f in wanted}}
        case inspect.UnionType():
            some = [each for each in kind.types if not isinstance(each, inspect.NoneType)]
            return _example(some[0], whole)
        case inspect.ListType() | inspect.VarTupleType():
            return [_example(kind.item_type, whole)] * (2 if whole else 0)
        case inspect.TupleType():
            return [_example(each, whole) for each in kind.item_types]
        case inspect.DictType():
            return {"a": _example(kind.value_type, whole)} if whole else {}
        case inspect.LiteralType():
            return kind.values[0]
        case inspect.FloatType() | inspect.IntType():
            return kind.ge if kind.ge is not None else 1
        case inspect.BoolType():
            return True
        case inspect.StrType():
            return "quad1"
        case _:
            return {"b": 2}


# What reads JSON besides.


def answers(data: bytes) -> None:
    """Of routers, and of a vehicle's error."""
    links = linkstate.read({"ab": data, "cd": b'{"sessions": [{"peer": "ab", "whatami": "router"}]}'})
    linkstate.ways(links, "ab")
    str(wire.error_from(data))


def router_answers() -> list[bytes]:
    sessions = [{"peer": "cd", "whatami": "router"}, {"peer": "ef01", "whatami": "client"}]
    error = {"code": "refused", "message": "no", "detail": {"reasons": ["Arm: GPS"]}}
    return [json.dumps({"sessions": sessions, "zid": "ab"}).encode(), json.dumps(error).encode()]


def body(data: bytes) -> None:
    """Bodies of requests: arguments of an order, messages."""
    with contextlib.suppress(BadInput):
        object_of(data)


def body_texts() -> list[bytes]:
    return [
        b'{"header": {"system_id": 255}, "message": {"type": "HEARTBEAT", "base_mode": {"bits": 81}}}',
        b'{"alt_rel": 10, "id": "7", "nested": {"a": [1, -2.5e3, true, null]}}',
    ]


# Keys: what a token or a topic says by its name, and what is recorded under it.


def key(data: bytes) -> None:
    """The first line is the key, the rest what came on it."""
    name, _, payload = data.partition(b"\n")
    text = name.decode("utf-8", "replace")
    for number in _tokens(text):
        assert number is None or number > 0
    stamp(payload)
    route = Route(text, the_dialect())
    route.location(payload)
    route.schema(payload)
    keys.expression(text)


def _tokens(text: str) -> Iterator[float | None]:
    """Those who read tokens raise nothing at all: they are called by Zenoh."""
    from ground.feed import origin_of
    from zmav.services.rates.demand import demand_of

    if text.count("/") > 3:
        found = demand_of(text, the_dialect())
        yield found and found.hz
    origin_of(text)


def whole_keys() -> list[bytes]:
    state = wire.encode(wire.VehicleState(t=NOW, fleet="demo", name="quad1", instance="i"))
    about = {"role": "vehicle", "sys": 1, "autopilot": "ardupilot", "uid": "none", "instance": "a1"}
    return [
        keys.ALIVE.key("demo", "quad1", **about).encode() + b"\n",
        keys.WANT.key("demo", "quad1", msg="ATTITUDE", hz=5, instance="a1").encode() + b"\n",
        keys.WANT.key("demo", "quad1", msg="UNKNOWN_410", hz=0.5, instance="a1").encode() + b"\n",
        keys.RX.key("demo", "quad1", sys=1, comp=1, msg="ATTITUDE").encode() + b"\n\xfd\x00",
        keys.STATE.key("demo", "quad1").encode() + b"\n" + state,
        keys.EVENT.key("demo", "quad1").encode() + b'\n{"t": 1, "kind": "mode", "severity": "info", "text": "LAND"}',
        keys.FLEET.key("demo", topic="origin").encode() + b'\n{"lat_deg": 1, "lon_deg": 2, "alt_amsl": 3}',
        b"quad*/ATTITUDE\n",
    ]


def json_words(rng: random.Random, data: bytes) -> bytes | None:
    """A value of a JSON text becomes one of another type, so that decoders get past the syntax."""
    head, mark, body = data.partition(b"\n") if data[:1] != b"{" else (b"", b"", data)
    try:
        value = json.loads(body)
        places = list(_places(value))
        if not places:
            return None
        holder, place = rng.choice(places)
        if rng.random() < 0.1:
            del holder[place]
        else:
            holder[place] = rng.choice((*NEW, *(holder[place],) * 2, holder))
        return head + mark + json.dumps(value).encode()
    except (ValueError, RecursionError):
        return None


NEW: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1,
    1e308,
    -1e308,
    5e-324,
    float("nan"),
    float("inf"),
    2**63,
    -(2**63) - 1,
    2**64,
    "",
    "quad1",
    "*",
    "\ud800",
    "a" * 300,
    "٣",
    [],
    {},
    [[]],
    {"": 1},
    [1, 2, 3],
    [0.0] * 50,
    [None] * 3,
    1_700_000_001.0,
)


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    for place in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield value, place
        yield from _places(value[place])


TARGETS = (
    Target("payloads", pure(take), payloads, 6000, json_words),
    Target("answers", pure(answers), router_answers, 2000, json_words),
    Target("bodies", pure(body), body_texts, 3000, json_words),
    Target("keys", pure(key), whole_keys, 3000, json_words),
)
