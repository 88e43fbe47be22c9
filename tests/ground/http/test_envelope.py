"""Answers in an envelope: for clients that are shown the body of a good answer only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served


def opened(served: Served, path: str, **headers: str) -> dict[str, Any]:
    reply = served.request("GET", path, **headers)
    assert (reply.status, reply.headers["content-type"]) == (200, "application/json")
    found: dict[str, Any] = reply.json
    assert set(found) == {"ok", "status", "body"}
    return found


@pytest.mark.parametrize("path", ["/vehicles", "/v1/mavlink", "/keys/quad1/param/X?timeout=0.1"])
def test_the_answer_is_the_same_inside(served: Served, path: str) -> None:
    plain = served.request("GET", path)
    inside = opened(served, path + ("&" if "?" in path else "?") + "envelope=1")
    assert inside["status"] == plain.status
    assert inside["ok"] is (plain.status < 400)
    is_json = plain.headers["content-type"].startswith("application/json")
    assert inside["body"] == (plain.json if is_json else plain.text)


def test_errors_of_every_face_are_told(served: Served) -> None:
    text = opened(served, "/last/1/1/ATTITUDE?envelope=1")
    assert (text["ok"], text["status"]) == (False, 404)
    assert text["body"].count("\n") == 1
    keyed = opened(served, "/do/quad1/dance?envelope=1")
    assert (keyed["ok"], keyed["status"], keyed["body"]["error"]["kind"]) == (False, 400, "bad_key")
    assert opened(served, "/nosuch?envelope=1")["body"]["error"]["kind"] == "not_found"


def test_the_guard_stands_behind_it(served: Served) -> None:
    strange = opened(served, "/vehicles?envelope=1", Host="elsewhere.example")
    assert (strange["ok"], strange["status"]) == (False, 421)
    across = opened(served, "/do/quad1/hold?envelope=1", Origin="http://elsewhere.example")
    assert (across["ok"], across["status"]) == (False, 403)


def test_anything_else_is_no_wish_for_one(served: Served) -> None:
    reply = served.request("GET", "/vehicles?envelope=2")
    assert reply.status == 400
    assert "envelope" in reply.text
