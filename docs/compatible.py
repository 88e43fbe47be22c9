"""What an older zmav would misread: docs/asyncapi.json as it is stored, against what the code gives now.

A change that is no more than one more field with a default (or one more channel) passes. Any other one has to move the
``version`` that the channel or the order declares.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

Document = Mapping[str, Any]
WORDS = ("title", "description")
"""of a schema, that a program does not read"""
MISSING = object()


def breaks(before: Document, now: Document) -> Iterator[str]:
    """Each change that needs another version, in words."""
    for name, channel in before["channels"].items():
        new = now["channels"].get(name)
        if new is None or new["address"] != channel["address"]:
            yield f"{name}: {channel['address']} is gone"
        elif new["x-version"] < channel["x-version"]:
            yield f"{name}: its version went back to {new['x-version']}"
        elif new["x-version"] == channel["x-version"]:
            for message in channel["messages"]:
                found = list(_message(message, new, before, now))
                yield from (f"{name} version {new['x-version']}: {text}" for text in found)


def _message(name: str, channel: Document, before: Document, now: Document) -> Iterator[str]:
    if name not in channel["messages"]:
        yield f"carries no {name} any more"
        return
    old, new = (each["components"]["messages"][name]["payload"] for each in (before, now))
    yield from _Comparison(before, now).schema(old, new, name)


class _Comparison:
    def __init__(self, before: Document, now: Document) -> None:
        self._before, self._now = before["components"]["schemas"], now["components"]["schemas"]
        self._seen: set[tuple[str, str]] = set()
        """pairs that are being compared: schemas may refer to themselves"""

    def schema(self, old: Any, new: Any, where: str) -> Iterator[str]:
        """The changes between two schemas, or two values in them."""
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            if "$ref" in old and "$ref" in new:
                yield from self._referred(str(old["$ref"]), str(new["$ref"]), where)
                return
            if "properties" in old and "properties" in new:
                yield from self._fields(old, new, where)
                old, new = ({k: v for k, v in each.items() if k not in FIELDS} for each in (old, new))
            for name in dict.fromkeys([*old, *new]):
                if name not in WORDS:
                    at = f"{where}.{name}"
                    yield from self.schema(old.get(name, MISSING), new.get(name, MISSING), at)
        elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
            for number, (one, other) in enumerate(zip(old, new, strict=True)):
                yield from self.schema(one, other, f"{where}[{number}]")
        elif old != new:
            yield f"{where} was {_shown(old)}, is {_shown(new)}"

    def _referred(self, old: str, new: str, where: str) -> Iterator[str]:
        first, second = old.rpartition("/")[2], new.rpartition("/")[2]
        if (first, second) not in self._seen:
            self._seen.add((first, second))
            yield from self.schema(self._before[first], self._now[second], where)

    def _fields(self, old: Document, new: Document, where: str) -> Iterator[str]:
        required = set(new.get("required", ()))
        for name, schema in old["properties"].items():
            if name not in new["properties"]:
                yield f"{where}.{name} is gone"
            else:
                yield from self.schema(schema, new["properties"][name], f"{where}.{name}")
        for name in sorted(required - set(old.get("required", ()))):
            yield f"{where}.{name} is required, and was not"
        # Who reads it may rely on what was always there.
        for name in sorted(set(old.get("required", ())) - required):
            if name in new["properties"] and old.get("additionalProperties", True):
                yield f"{where}.{name} is not always there, and was"


FIELDS = ("properties", "required")


def _shown(value: Any) -> str:
    return "nothing" if value is MISSING else repr(value)
