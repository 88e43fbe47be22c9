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
    "setpoint": "Setpoints",
    "release": "Setpoints",
    **dict.fromkeys(("vehicles", "stream", "stop", "send", "last"), "Text"),
    **dict.fromkeys(("", "docs", "openapi.json", "metrics"), "Pages"),
}
"""a path's group, by all of it or by its first part; any other is mavlink2rest's"""
PATH = {
    "vehicle": "the vehicle's name, as in quad1",
    "verb": "the order",
    "key": "a key or a key expression: quad1, quad*/ATTITUDE, zmav/demo/quad1/link/*",
    "sys": "MAVLink system id",
    "comp": "MAVLink component id; 0: all of the system's",
    "message": "name of a MAVLink message",
    "name": "name of a MAVLink message",
}
"""parts of paths by their names"""

_HOLDER = Parameter("as", "a name for this caller, under which it holds the lease")
_STREAM = (
    Parameter("port", "UDP port to send to"),
    Parameter("msg", "messages, with commas between them; all without"),
    Parameter("hz", "how often, at most", NUMBER),
)
_POINT = (
    Parameter("n", "m north of the fleet's origin", {"type": "number"}),
    Parameter("e", "m east", {"type": "number"}),
    Parameter("d", "m down", {"type": "number"}),
    Parameter("yaw", "radians from north, clockwise", {"type": "number"}),
    _HOLDER,
)
QUERY: dict[str, tuple[Parameter, ...]] = {
    "/keys/{key}": (Parameter("timeout", "s to wait for answers", NUMBER),),
    "/stream/{sys}/{comp}": _STREAM,
    "/setpoint/{vehicle}": _POINT,
    "/release/{vehicle}": (_HOLDER,),
    "/ws": (
        Parameter("key", "key expression to subscribe to from the start; may be repeated"),
        Parameter("hz", "samples of a key a second, at most", NUMBER),
    ),
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
    ("post", "/keys/{key}"): {"content": {"application/json": {"schema": {"type": "object"}}}},
    ("post", "/do/{vehicle}/{verb}"): {
        "description": "the arguments of the order: see the orders one by one",
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
