"""/openapi.json: every route and nothing else, in the form that OpenAPI 3.1 asks for.

https://spec.openapis.org/oas/v3.1.0
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from starlette.routing import Match, Route, WebSocketRoute

from ground.http.app import make_app
from ground.http.openapi import BODIES, QUERY
from ground.http.setpoints import Point
from zmav.verbs import VERBS

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served

METHODS = {"get", "put", "post", "delete", "options", "head", "patch", "trace"}
OPERATION = {
    "summary",
    "description",
    "operationId",
    "tags",
    "parameters",
    "requestBody",
    "responses",
    "x-access",
    "x-writers",
}
TEXT_OR_EMPTY = {"string", "number", "integer", "boolean", "object", "array", "null"}


@pytest.fixture(scope="module")
def document(served: Served) -> dict[str, Any]:
    reply = served.get("/openapi.json")
    assert (reply.status, reply.headers["content-type"]) == (200, "application/json")
    found: dict[str, Any] = reply.json
    return found


@pytest.fixture(scope="module")
def routes(served: Served) -> list[Any]:
    async def make() -> list[Any]:
        return make_app(served.gateway).routes

    return served.call(make())


def operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, item in document["paths"].items():
        for method, operation in item.items():
            yield path, method, operation


def test_every_route_is_described(document: dict[str, Any], routes: list[Any]) -> None:
    assert len(routes) > 15
    for route in routes:
        assert isinstance(route, (Route, WebSocketRoute)), f"{route} is no route of a kind that is described"
        methods = (route.methods or set()) - {"HEAD"} if isinstance(route, Route) else {"GET"}
        if not getattr(route, "include_in_schema", True):
            continue  # another name of one that is
        for method in methods:
            operation = document["paths"].get(route.path_format, {}).get(method.lower())
            assert operation, f"{method} {route.path_format} is not described"
            assert operation["summary"], f"{method} {route.path_format} does not say what it is for"


def test_everything_described_is_there(document: dict[str, Any], routes: list[Any]) -> None:
    for path, method, operation in operations(document):
        is_socket = "101" in operation["responses"]
        scope: dict[str, Any] = {
            "type": "websocket" if is_socket else "http",
            "method": method.upper(),
            "path": re.sub(r"{\w+}", "1", path),
            "path_params": {},
        }
        assert any(route.matches(scope)[0] is Match.FULL for route in routes), f"{method} {path} leads nowhere"


def test_what_is_added_is_of_routes_that_are_there(document: dict[str, Any]) -> None:
    assert not [path for path in QUERY if path not in document["paths"]]
    assert not [where for where in BODIES if where[0] not in document["paths"].get(where[1], {})]


def test_the_parameters_of_a_point_are_a_point_s(document: dict[str, Any]) -> None:
    given = {each["name"] for each in document["paths"]["/setpoint/{vehicle}"]["get"]["parameters"]}
    assert given == {"vehicle", "as", *Point.__struct_fields__}


def test_every_order_has_its_arguments(document: dict[str, Any]) -> None:
    for verb in VERBS.values():
        operation = document["paths"][f"/do/{{vehicle}}/{verb.name}"]["post"]
        schema = operation["requestBody"]["content"]["application/json"]["schema"]
        properties = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]["properties"]
        assert list(properties) == list(verb.args.__struct_fields__)
        assert operation["summary"] == verb.doc


def test_it_is_an_openapi_document(document: dict[str, Any]) -> None:
    assert document["openapi"] == "3.1.0"
    assert {"title", "version"} <= set(document["info"])
    assert set(document) <= {"openapi", "info", "tags", "paths", "components", "security"}
    tags = [tag["name"] for tag in document["tags"]]
    ids = [operation["operationId"] for _, _, operation in operations(document)]
    assert len(set(ids)) == len(ids)
    for path, method, operation in operations(document):
        where = f"{method} {path}"
        assert path.startswith("/"), where
        assert method in METHODS, where
        assert set(operation) <= OPERATION, where
        assert set(operation["tags"]) <= set(tags), where
        _check_parameters(where, path, operation["parameters"])
        for status, response in operation["responses"].items():
            assert re.fullmatch(r"[1-5]\d\d|default", status), where
            assert response["description"], where
        if "requestBody" in operation:
            assert operation["requestBody"]["content"], where
    schemes = document["components"]["securitySchemes"]
    assert all(name in schemes for each in document["security"] for name in each)


def _check_parameters(where: str, path: str, parameters: list[dict[str, Any]]) -> None:
    named = [(each["name"], each["in"]) for each in parameters]
    assert len(set(named)) == len(named), where
    assert {name for name, place in named if place == "path"} == set(re.findall(r"{(\w+)}", path)), where
    for each in parameters:
        assert each["in"] in ("path", "query"), where
        assert each["required"] is (each["in"] == "path"), where
        assert each["description"], where
        assert isinstance(each["schema"], dict), where


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    seen: set[str] = set()

    def walk(node: Any) -> None:
        if isinstance(node, dict):
            if "$ref" in node:
                head, _, name = node["$ref"].rpartition("/")
                assert head == "#/components/schemas"
                assert name in schemas, f"{name} is not among the schemas"
                seen.add(name)
            if isinstance(node.get("type"), str) and "in" not in node:
                assert node["type"] in TEXT_OR_EMPTY | {"http", "apiKey"}
            for part in node.values():
                walk(part)
        elif isinstance(node, list):
            for part in node:
                walk(part)

    walk(document)
    assert seen == set(schemas), "a schema that nothing refers to"
