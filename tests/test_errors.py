"""The tree of errors: codes, and what crosses the wire."""

from __future__ import annotations

import re
import sys
from typing import Any

import pytest

from zmav import errors, wire
from zmav.errors import BadConfig, ZmavError, from_code, needs


def tree(cls: type[ZmavError] = ZmavError) -> list[type[ZmavError]]:
    subs = [sub for sub in cls.__subclasses__() if sub.__module__ == errors.__name__]
    return [cls, *(each for sub in subs for each in tree(sub))]


def test_each_class_has_a_code_of_its_own() -> None:
    codes = [cls.code for cls in tree()]
    assert len(codes) == 19
    assert len(set(codes)) == len(codes)


def test_the_picture_in_the_docstring_is_the_tree() -> None:
    drawn = re.findall(r"^    [\s│├└─]*([A-Z]\w+)", errors.__doc__ or "", re.MULTILINE)
    assert drawn == [cls.__name__ for cls in tree()]


@pytest.mark.parametrize("cls", tree(), ids=lambda cls: cls.__name__)
def test_an_error_crosses_the_wire_as_it_was(cls: type[ZmavError]) -> None:
    sent = cls("the mode is LAND", vehicle="quad1", value=3, reasons=["Arm: Need Position Estimate"])
    got = wire.error_from(wire.error_body(sent))
    assert type(got) is cls
    assert (got.message, got.detail, str(got)) == (sent.message, sent.detail, "the mode is LAND")


def test_the_error_of_a_newer_peer_is_still_one() -> None:
    got = from_code("struck_by_lightning", "gone", {"where": "tail"})
    assert type(got) is ZmavError
    assert (got.message, got.detail) == ("gone", {"where": "tail"})


@pytest.mark.parametrize("name", ["message", "self", "code", "detail", "args"])
def test_a_detail_may_have_any_name(name: str) -> None:
    got = from_code("stale", "gone", {name: 1})
    assert (got.message, got.detail, got.code) == ("gone", {name: 1}, "stale")


@pytest.mark.parametrize(
    ("detail", "arrives"),
    [
        ({"value": float("nan")}, {"value": None}),
        ({"value": {1, 2}.__class__}, {"value": "<class 'set'>"}),
        ({"value": b"\x01\x02"}, {"value": "AQI="}),
        ({"value": (1.0, 2.0)}, {"value": [1.0, 2.0]}),
    ],
)
def test_a_detail_may_hold_anything(detail: dict[str, Any], arrives: dict[str, Any]) -> None:
    assert wire.error_from(wire.error_body(ZmavError("x", **detail))).detail == arrives


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xfe",
        b"no such thing",
        b"[]",
        b'{"code":1,"message":"x"}',
        b'{"code":"stale"}',
        b'{"code":"stale","message":"\xff"}',
        b'{"code":"stale","message":"x","detail":{"a":' + b"[" * 100_000,
    ],
    ids=range(8),
)
def test_a_reply_that_is_no_error_body_is_told_as_it_is(data: bytes) -> None:
    got = wire.error_from(data)
    assert type(got) is ZmavError
    assert got.message == (data[:80].decode("utf-8", "replace") or "an error without a text")


def test_a_module_s_own_kind_of_an_error_crosses_as_what_it_is_a_kind_of() -> None:
    class Unheard(errors.TimedOut):
        pass

    assert type(errors.from_code(Unheard.code, "nothing came")) is errors.TimedOut


def test_an_extra_that_is_missing_is_named_with_how_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    needs("a map", "ground", "json", "re")
    for missing in ("zmav_has_no_such_module", "zmav.no_such.module"):
        with pytest.raises(BadConfig) as caught:
            needs("a map", "ground", "json", missing, "re")
        assert str(caught.value).startswith("a map needs zmav")
        assert str(caught.value).endswith(": pip install 'zmav[ground]'")
        assert caught.value.detail["expected"] == "zmav[ground]"
    monkeypatch.setitem(sys.modules, "json", None)
    with pytest.raises(BadConfig, match=r"a map needs json: pip install 'zmav\[vision\]', or in a clone 'make vision'"):
        needs("a map", "vision", "json")
