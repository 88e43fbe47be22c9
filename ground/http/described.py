"""What the routes do not say of themselves, for :mod:`ground.http.openapi`: parameters and bodies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

TEXT: dict[str, Any] = {"type": "string"}
NUMBER: dict[str, Any] = {"type": "number", "exclusiveMinimum": 0}
ANY: dict[str, Any] = {}


@dataclass(frozen=True)
class Parameter:
    name: str
    doc: str
    schema: dict[str, Any] = field(default_factory=lambda: TEXT)


TAGS = {
    "Key space": "every key by its name: asked, written, read live",
    "Orders": "do this; the answer is how it ended",
    "Setpoints": "streams for scripts, under a lease that the gateway holds",
    "Text": "for what can GET text and no more, such as MATLAB's urlread",
    "mavlink2rest": "the interface of mavlink2rest",
    "Pages": "for people and for monitoring",
}
"""groups of paths, in the order in which they are shown"""
GROUP = {
    "keys": "Key space",
    "/ws": "Key space",
    "do": "Orders",
    "agent": "Orders",
    "fleet": "Orders",
    "setpoint": "Setpoints",
    "release": "Setpoints",
    **dict.fromkeys(("vehicles", "stream", "stop", "send", "last"), "Text"),
    **dict.fromkeys(("", "docs", "openapi.json", "metrics"), "Pages"),
}
"""a path's group, by all of it or by its first part; any other is mavlink2rest's"""
PATH = {
    "vehicle": "the vehicle's name, as in quad1",
    "agent": "the agent's name, as in ev1: what 'zmav agent run' was started with",
    "verb": "the order",
    "key": "a key or a key expression: quad1, quad*/ATTITUDE, zmav/demo/quad1/link/*",
    "sys": "MAVLink system id",
    "comp": "MAVLink component id; 0: all of the system's",
    "message": "name of a MAVLink message",
    "path": "vehicles/1/components/1/messages/ATTITUDE, and on to message/roll or status/time",
}
"""parts of paths by their names"""

_HOLDER = Parameter("as", "a name for this caller, under which it holds the lease")
_PORT = Parameter("port", "UDP port to send to", {"type": "integer", "minimum": 1, "maximum": 65535})
_STREAM = (
    _PORT,
    Parameter("msg", "messages, with commas between them; all without"),
    Parameter("hz", "how often, at most", NUMBER),
)
_PLACE = ("lat_deg", "lon_deg", "alt_amsl", "alt_rel")
_POINT = (
    Parameter("n", "m north of the fleet's origin", {"type": "number"}),
    Parameter("e", "m east", {"type": "number"}),
    Parameter("d", "m down", {"type": "number"}),
    *(Parameter(name, "instead of n, e and d", {"type": "number"}) for name in _PLACE),
    *(Parameter(name, "three numbers in brackets: [0,0,-6], m, north, east, down") for name in ("pos", "vel", "acc")),
    Parameter("yaw", "radians from north, clockwise", {"type": "number"}),
    Parameter("yaw_rate", "radians a second", {"type": "number"}),
    Parameter("valid", "s for which it may be flown, at most 1.5", NUMBER),
    Parameter("priority", "of the lease, 0 to 100", {"type": "integer", "minimum": 0, "maximum": 100}),
    _HOLDER,
)
QUERY: dict[str, tuple[Parameter, ...]] = {
    "/keys/{key}": (Parameter("timeout", "s to wait for answers", NUMBER),),
    "/stream/{sys}/{comp}": _STREAM,
    "/stop/{sys}/{comp}": (_PORT,),
    "/setpoint/{vehicle}": _POINT,
    "/release/{vehicle}": (_HOLDER,),
    "/ws": (
        Parameter("key", "key expression to subscribe to from the start; may be repeated"),
        Parameter("hz", "samples of a key a second, at most", NUMBER),
    ),
    "/v1/helper/mavlink": (Parameter("name", "name of a MAVLink message"),),
    "/v1/ws/mavlink": (Parameter("filter", "regular expression that is found in the names of messages; all without"),),
}
"""query parameters by path"""

_JSON_OR_BYTES = {
    "content": {
        "application/json": {"schema": ANY},
        "application/octet-stream": {"schema": {"description": "a raw MAVLink frame"}},
    }
}
BODIES: dict[tuple[str, str], dict[str, Any]] = {
    ("put", "/keys/{key}"): _JSON_OR_BYTES,
    ("post", "/v1/mavlink"): {
        "description": "a message as the helper gives it; JSON5 is taken",
        "content": {"application/json": {"schema": {"type": "object", "required": ["message"]}}},
    },
    ("post", "/keys/{key}"): {"content": {"application/json": {"schema": {"type": "object"}}}},
    ("post", "/do/{vehicle}/{verb}"): {
        "description": "the arguments of the order: see the orders one by one",
        "content": {
            "application/json": {"schema": {"type": "object"}},
            "application/x-www-form-urlencoded": {"schema": {"type": "object"}},
        },
    },
    ("post", "/fleet/{verb}"): {
        "description": "vehicles (a list of names or patterns; all without), id and wait, and the order's arguments",
        "content": {"application/json": {"schema": {"type": "object"}}},
    },
    ("post", "/agent/{vehicle}/{agent}/{verb}"): {
        "description": "its arguments: name and value for set, none for params; others as the agent itself says",
        "content": {
            "application/json": {"schema": {"type": "object"}},
            "application/x-www-form-urlencoded": {"schema": {"type": "object"}},
        },
    },
    ("post", "/setpoint/{vehicle}"): {
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Point"}}}
    },
}
"""bodies by method and path"""
