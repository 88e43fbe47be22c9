"""``/openapi.json``: what the gateway serves, as OpenAPI 3.1, made of the application's routes and of the registry.

Paths, methods and summaries come from the routes and the docstrings of what answers them; orders and their arguments
from :data:`zmav.verbs.VERBS`; :mod:`ground.http.described` adds what a route does not say of itself.
"""

from __future__ import annotations

import importlib.metadata
import inspect
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from ground.http.described import BODIES, GROUP, PATH, QUERY, TAGS, Parameter
from ground.http.documents import answer
from ground.http.gateway import Gateway
from ground.http.setpoints import Point
from zmav import wire
from zmav.verbs import VERBS, Verb

REF = "#/components/schemas/{name}"
DO = "/do/{vehicle}/{verb}"


class Error(wire.Wire, kw_only=True):
    """What went wrong: ``kind`` for programs, ``text`` for people; more is named beside them."""

    kind: str
    text: str


class ErrorAnswer(wire.Wire, kw_only=True):
    error: Error


def routes(gateway: Gateway) -> list[BaseRoute]:
    async def openapi(request: Request) -> Response:
        """This description, for programs (OpenAPI 3.1)."""
        return answer(document(request.app.routes))

    return [Route("/openapi.json", openapi, methods=["GET"])]


def document(routes: Iterable[BaseRoute]) -> dict[str, Any]:
    """The OpenAPI document of these routes."""
    kinds: Sequence[type[wire.Wire]] = (*(verb.args for verb in VERBS.values()), Point, wire.Outcome, ErrorAnswer)
    _, components = msgspec.json.schema_components(kinds, ref_template=REF)
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
        "paths": _paths(routes),
        "components": {
            "schemas": components,
            "securitySchemes": {
                "bearer": {"type": "http", "scheme": "bearer"},
                "token": {"type": "apiKey", "in": "query", "name": "token"},
            },
        },
        "security": [{}, {"bearer": []}, {"token": []}],
    }


def _paths(routes: Iterable[BaseRoute]) -> dict[str, dict[str, Any]]:
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
        names = [_parameter(Parameter("vehicle", PATH["vehicle"]), "path")]
        paths |= {DO.replace("{verb}", verb.name): {"post": _order(verb, names)} for verb in VERBS.values()}
    return paths


def _operation(path: str, endpoint: Any, method: str, names: Sequence[str]) -> dict[str, Any]:
    said = (inspect.getdoc(endpoint) or "").replace("``", "")
    summary, _, more = said.partition("\n\n")
    operation: dict[str, Any] = {
        "summary": " ".join(summary.split()),
        "operationId": "_".join([method, *(part.strip("{}.").replace(".", "_") for part in path.split("/") if part)]),
        "tags": [GROUP.get(path, GROUP.get(path.split("/")[1], "mavlink2rest"))],
        "parameters": [_parameter(Parameter(name, PATH.get(name, name)), "path") for name in names],
        "responses": {"200": {"description": "done"}, "default": _error()},
    }
    operation["parameters"] += [_parameter(each, "query") for each in QUERY.get(path, ())]
    if more:
        operation["description"] = " ".join(more.split())
    if (method, path) in BODIES:
        operation["requestBody"] = BODIES[method, path]
    return operation


def _order(verb: Verb, names: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "summary": verb.doc,
        "operationId": f"do_{verb.name}",
        "tags": ["Orders"],
        "parameters": names,
        "requestBody": _body(verb.args),
        "responses": {
            "200": {"description": "how it ended", "content": _json({"$ref": REF.format(name="Outcome")})},
            "default": _error(),
        },
        "x-access": verb.access.value,
        "x-writers": list(verb.writers),
    }


def _parameter(parameter: Parameter, where: str) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "in": where,
        "required": where == "path",
        "description": parameter.doc,
        "schema": parameter.schema,
    }


def _body(kind: type[wire.Wire]) -> dict[str, Any]:
    return {"content": _json({"$ref": REF.format(name=kind.__name__)})}


def _json(schema: dict[str, Any]) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}


def _error() -> dict[str, Any]:
    return {"description": "not done, and why", "content": _json({"$ref": REF.format(name="ErrorAnswer")})}
