"""``/openapi.json``: what the gateway serves, as OpenAPI 3.1, made of the application's routes and of the registry.

Paths, methods and summaries come from the routes and the docstrings of what answers them; orders and their arguments
from :data:`zmav.verbs.VERBS`; the tables here add what a route does not say of itself.
"""

from __future__ import annotations

import importlib.metadata
import inspect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from ground.http.documents import answer
from ground.http.gateway import Gateway
from ground.http.orders import GOALS
from ground.http.replay import Steer
from ground.http.setpoints import Point
from zmav import schemas, wire
from zmav.verbs import SWARM_VERBS, VERBS, Verb

REF = "#/components/schemas/{name}"
DO, SWARM = "/do/{vehicle}/{verb}", "/swarm/{verb}"
POINT = "/setpoint/{vehicle}"
TEXT: dict[str, Any] = {"type": "string"}
NUMBER: dict[str, Any] = {"type": "number", "exclusiveMinimum": 0}


TAGS = {
    "Key space": "every key by its name: asked, read live",
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
    "orders": "Orders",
    "mission": "Orders",
    "fleet": "Orders",
    "swarm": "Orders",
    "setpoint": "Setpoints",
    "release": "Setpoints",
    **dict.fromkeys(("vehicles", "stream", "stop", "send", "last"), "Text"),
    **dict.fromkeys(("", "docs", "openapi.json", "asyncapi.json", "metrics", "report", "static"), "Pages"),
    **dict.fromkeys(("tiles", "picture", "replay", "camera"), "Pages"),
}
"""a path's group, by all of it or by its first part; any other is mavlink2rest's"""
PATH = {
    "vehicle": "the vehicle's name, as in quad1",
    "agent": "the agent's name, as in ev1: what 'zmav agent run' was started with",
    "camera": "the camera's name, as in down: 'zmav agent list' shows it as camera-down",
    "verb": "the order",
    "key": "a key or a key expression: quad1, quad*/ATTITUDE, zmav/demo/quad1/link/*",
    "file": "a file of the pages",
    "z": "zoom of a tile",
    "x": "its column, from the west",
    "y": "its row, from the north",
    "sys": "MAVLink system id",
    "comp": "MAVLink component id; 0: all of the system's",
    "message": "name of a MAVLink message",
    "path": "vehicles/1/components/1/messages/ATTITUDE, and on to message/roll or status/time",
}
"""parts of paths by their names"""

_HOLDER = ("as", "a name for this caller, under which it holds the lease", TEXT)
_KIND = ("kind", "that kind alone: mission, fence, rally", TEXT)
_PORT = ("port", "UDP port to send to", {"type": "integer", "minimum": 1, "maximum": 65535})
QUERY: dict[str, tuple[tuple[str, str, dict[str, Any]], ...]] = {
    "/keys/{key}": (("timeout", "s to wait for answers", NUMBER),),
    "/stream/{sys}/{comp}": (
        _PORT,
        ("msg", "messages, with commas between them; all without", TEXT),
        ("hz", "how often, at most", NUMBER),
    ),
    "/stop/{sys}/{comp}": (_PORT,),
    "/setpoint/{vehicle}": (_HOLDER,),
    "/release/{vehicle}": (_HOLDER,),
    "/mission/read": (_KIND,),
    "/mission/upload": (("vehicles", "names or patterns, with commas between them", TEXT), _KIND),
    "/ws": (
        ("key", "key expression to subscribe to from the start; may be repeated", TEXT),
        ("hz", "samples of a key a second, at most", NUMBER),
    ),
    "/v1/helper/mavlink": (("name", "name of a MAVLink message", TEXT),),
    "/v1/ws/mavlink": (("filter", "regular expression that is found in the names of messages; all without", TEXT),),
}
"""query parameters by path: name, what it is, schema. A setpoint's are the fields of a :class:`Point`, too"""

OBJECT: dict[str, Any] = {"type": "object"}
JSON, FORM = "application/json", "application/x-www-form-urlencoded"
BODIES: dict[tuple[str, str], tuple[str, dict[str, dict[str, Any]]]] = {
    ("post", "/v1/mavlink"): ("a message as the helper gives it", {JSON: {**OBJECT, "required": ["message"]}}),
    ("post", "/do/{vehicle}/{verb}"): (
        "the arguments of the order: see the orders one by one",
        {JSON: OBJECT, FORM: OBJECT},
    ),
    ("post", "/fleet/{verb}"): (
        "vehicles (a list of names or patterns; * is all), id and wait, and the order's arguments",
        {JSON: {**OBJECT, "required": ["vehicles"]}},
    ),
    ("post", "/swarm/{verb}"): (
        "the arguments of that verb of zmav swarm: goal for submit and preview, an id for cancel, obstacle; of a "
        "kind of goal its fields, preview (true: only shown), when (now or queue)",
        {JSON: OBJECT},
    ),
    ("post", "/agent/{vehicle}/{agent}/{verb}"): (
        "its arguments: name and value for set, none for params; others as the agent itself says",
        {JSON: OBJECT, FORM: OBJECT},
    ),
    ("post", "/mission/read"): ("the file", {"text/plain": TEXT, JSON: OBJECT}),
    ("post", "/mission/upload"): ("the file", {"text/plain": TEXT, JSON: OBJECT}),
    ("post", "/replay"): ("what changes", {JSON: {"$ref": REF.format(name="Steer")}}),
    ("post", "/setpoint/{vehicle}"): ("", {JSON: {"$ref": "#/components/schemas/Point"}}),
}
"""bodies by method and path: what they are, schemas by their type"""


class Error(wire.Wire, kw_only=True):
    """What went wrong: ``kind`` for programs, ``text`` for people; more is named beside them."""

    kind: str
    text: str


class ErrorAnswer(wire.Wire, kw_only=True):
    error: Error


Schemas = Mapping[type[wire.Wire], dict[str, Any]]


def routes(gateway: Gateway) -> list[BaseRoute]:
    async def openapi(request: Request) -> Response:
        """This description, for programs (OpenAPI 3.1)."""
        return answer(document(request.app.routes))

    async def asyncapi(request: Request) -> Response:
        """The key space itself, for programs (AsyncAPI 3.0), with the JSON Schema of every payload."""
        return answer(schemas.asyncapi())

    return [Route("/openapi.json", openapi, methods=["GET"]), Route("/asyncapi.json", asyncapi, methods=["GET"])]


def document(routes: Iterable[BaseRoute]) -> dict[str, Any]:
    """The OpenAPI document of these routes."""
    orders = (verb.args for verb in (*VERBS.values(), *SWARM_VERBS.values()))
    kinds: Sequence[type[wire.Wire]] = (*orders, *GOALS.values(), Point, Steer, wire.Outcome, ErrorAnswer)
    references, components = msgspec.json.schema_components(kinds, ref_template=REF)
    schemas = dict(zip(kinds, references, strict=True))
    for loose in ("Error", "ErrorAnswer"):
        components[loose].pop("additionalProperties", None)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "zmav: one key space for a whole swarm, over HTTP",
            "version": importlib.metadata.version("zmav"),
            "description": "Errors are JSON with a kind and a text; under /stream, /stop, /send, /last and /vehicles "
            "text, and under mavlink2rest's paths a JSON string. envelope=1, with any request, puts its answer and its "
            "status into JSON that is answered with 200.",
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "tags": [{"name": name, "description": text} for name, text in TAGS.items()],
        "paths": _paths(routes, schemas),
        "components": {
            "schemas": components,
            "securitySchemes": {
                "bearer": {"type": "http", "scheme": "bearer"},
                "token": {"type": "apiKey", "in": "query", "name": "token"},
            },
        },
        "security": [{}, {"bearer": []}, {"token": []}],
    }


def _paths(routes: Iterable[BaseRoute], schemas: Schemas) -> dict[str, dict[str, Any]]:
    paths: dict[str, dict[str, Any]] = {}
    for route in routes:
        if not getattr(route, "include_in_schema", True):
            continue  # another name of one that is listed
        if isinstance(route, Route):
            for method in sorted((route.methods or set()) - {"HEAD", "OPTIONS"}):
                operation = _operation(route.path_format, route.endpoint, method.lower(), list(route.param_convertors))
                paths.setdefault(route.path_format, {})[method.lower()] = operation
        elif isinstance(route, WebSocketRoute):
            operation = _operation(route.path_format, route.endpoint, "get", list(route.param_convertors))
            operation["responses"] = {"101": {"description": "a WebSocket from here on"}, "default": _error()}
            paths.setdefault(route.path_format, {})["get"] = operation
    if DO in paths:
        names = [_parameter("vehicle", PATH["vehicle"], TEXT, "path")]
        paths |= _orders(DO, VERBS.values(), names, schemas)
    if SWARM in paths:
        paths |= _orders(SWARM, _planner_verbs(), [], schemas)
    return paths


def _planner_verbs() -> Iterator[Verb]:
    yield from SWARM_VERBS.values()
    for name, kind in GOALS.items():
        doc = " ".join((kind.__doc__ or name).split("\n\n")[0].replace("``", "").split())
        yield Verb(name, kind, SWARM_VERBS["submit"].access, doc, SWARM_VERBS["submit"].writers)


def _operation(path: str, endpoint: Any, method: str, names: Sequence[str]) -> dict[str, Any]:
    said = (inspect.getdoc(endpoint) or "").replace("``", "")
    summary, _, more = said.partition("\n\n")
    operation: dict[str, Any] = {
        "summary": " ".join(summary.split()),
        "operationId": "_".join([method, *(part.strip("{}.").replace(".", "_") for part in path.split("/") if part)]),
        "tags": [GROUP.get(path, GROUP.get(path.split("/")[1], "mavlink2rest"))],
        "parameters": [_parameter(name, PATH.get(name, name), TEXT, "path") for name in names],
        "responses": {"200": {"description": "done"}, "default": _error()},
    }
    operation["parameters"] += [_parameter(*each, "query") for each in QUERY.get(path, ())]
    if path == POINT:
        fields = msgspec.json.schema(Point)["$defs"]["Point"]["properties"]
        docs = {name: schema.pop("description", name) for name, schema in fields.items()}
        operation["parameters"] += [_parameter(name, docs[name], fields[name], "query") for name in fields]
    if more:
        operation["description"] = " ".join(more.split())
    if (method, path) in BODIES:
        about, schemas = BODIES[method, path]
        content = {kind: {"schema": schema} for kind, schema in schemas.items()}
        operation["requestBody"] = {"content": content, **({"description": about} if about else {})}
    return operation


def _orders(
    path: str, verbs: Iterable[Verb], names: list[dict[str, Any]], schemas: Schemas
) -> dict[str, dict[str, Any]]:
    group = path.split("/")[1]
    return {path.replace("{verb}", each.name): {"post": _order(group, each, names, schemas)} for each in verbs}


def _order(group: str, verb: Verb, names: list[dict[str, Any]], schemas: Schemas) -> dict[str, Any]:
    return {
        "summary": verb.doc,
        "operationId": f"{group}_{verb.name}",
        "tags": ["Orders"],
        "parameters": names,
        "requestBody": {"content": _json(schemas[verb.args])},
        "responses": {
            "200": {"description": "how it ended", "content": _json({"$ref": REF.format(name="Outcome")})},
            "default": _error(),
        },
        "x-access": verb.access.value,
        "x-writers": list(verb.writers),
    }


def _parameter(name: str, doc: str, schema: dict[str, Any], where: str) -> dict[str, Any]:
    return {"name": name, "in": where, "required": where == "path", "description": doc, "schema": schema}


def _json(schema: dict[str, Any]) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}


def _error() -> dict[str, Any]:
    return {"description": "not done, and why", "content": _json({"$ref": REF.format(name="ErrorAnswer")})}
