"""ROS's messages: their definitions, their hashes (REP-2016's RIHS01), and CDR.

Types of ROS 2 Jazzy are those of ``rosbags``; others are in ``interfaces``, as ROS writes them: MAVROS's, the services
that rosbags lacks, and our own, which that folder has as a package to build.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from zmav.errors import BadInput

INTERFACES = Path(__file__).parent / "interfaces"
LARGEST = 1 << 16
"""bytes of a message or a request that is read: reading more would hold up others' orders"""
LONGEST = 100_000
"""elements of a sequence in it"""
FILLER = "structure_needs_at_least_one_member"
"""the field that rosidl gives a type which has none"""
_EVENT = "service_msgs/msg/ServiceEventInfo"
_GOAL = "unique_identifier_msgs/UUID goal_id\n"


class Types:
    """All types that are spoken here. Thread-safe once made: messages are plain objects, with fields as in ROS."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._store.max_sequence_length = LONGEST
        # Its definition says char, which rosidl makes a uint8 before it is hashed; rosbags does not.
        constants, fields = self._store.fielddefs[_EVENT]
        gid: Any = ("client_gid", (Nodetype.ARRAY, ((Nodetype.BASE, ("uint8", 0)), 16)))
        self._store.fielddefs[_EVENT] = (constants, [gid if each[0] == gid[0] else each for each in fields])
        self._hashes: dict[str, str] = {}
        for path in sorted(INTERFACES.glob("*/*/*.*")):
            package, kind, name = path.parts[-3], path.parts[-2], path.stem
            for full, text in _texts(f"{package}/{kind}/{name}", path.read_text(encoding="utf-8")):
                self.define(full, text)

    def define(self, name: str, text: str) -> None:
        """Take in a definition. rosbags takes messages only: a part of a service or action is one by another name."""
        package, *_, last = name.split("/")
        (definition,) = get_types_from_msg(text, f"{package}/msg/{last}").values()
        constants, fields = definition
        self._store.register({name: (constants, fields or [(FILLER, (Nodetype.BASE, ("uint8", 0)))])})

    def hash(self, name: str) -> str:
        """``RIHS01_`` and 64 hexadecimal digits, of a message or of a service."""
        if name not in self._hashes:
            if f"{name}_Request" in self._store.fielddefs:
                self._define_service(name)
            self._hashes[name] = self._store.hash_rihs01(name)
        return self._hashes[name]

    def make(self, name: str, /, **fields: Any) -> Any:
        """A message; fields that are not given are zero, or empty."""
        given = {
            field: fields.pop(field) if field in fields else self._zero(kind) for field, kind in self._fields(name)
        }
        if fields:
            raise TypeError(f"{name} has no {', '.join(fields)}")
        return self._store.types[name](**given)

    def fitting(self, name: str, /, **fields: Any) -> Any:
        """A message of those ``fields`` that its type has: one outcome fits answers of many types."""
        has = {field for field, _ in self._fields(name)}
        return self.make(name, **{field: value for field, value in fields.items() if field in has})

    def encode(self, message: Any, name: str) -> bytes:
        return bytes(self._store.serialize_cdr(message, name))

    def decode(self, data: bytes, name: str) -> Any:
        """Raises :class:`BadInput` for what is no such message: anybody sends anything."""
        if len(data) > LARGEST:
            raise BadInput(
                f"{len(data)} bytes are too much for {name}", field=name, expected=f"at most {LARGEST} bytes"
            )
        try:
            return self._store.deserialize_cdr(data, name)
        except Exception as e:  # generated code: what it raises for spoilt bytes is not said anywhere
            raise BadInput(f"no {name}: {e}", field=name, value=data[:16].hex(), expected=f"CDR of {name}") from None

    def definition(self, name: str) -> str:
        """A message's definition and those of what it holds, as ``ros2msg`` schemas have them."""
        return self._store.generate_msgdef(name, ros_version=2)[0]

    def _fields(self, name: str) -> list[tuple[str, Any]]:
        return list(self._store.fielddefs[name][1])

    def _zero(self, kind: Any) -> Any:
        what, of = kind
        if what == Nodetype.BASE:
            return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(of[0], 0)
        if what == Nodetype.NAME:
            return self.make(of)
        (inner, element), count = of
        count = count if what == Nodetype.ARRAY else 0
        if inner == Nodetype.BASE and element[0] != "string":
            return _array(element[0], count)
        return [self._zero((inner, element)) for _ in range(count)]

    def _define_service(self, name: str) -> None:
        """The type whose hash a service has: of its request, its answer, and the event of both."""
        named = {part: (Nodetype.NAME, f"{name}_{part}") for part in ("Request", "Response", "Event")}
        info: Any = ("info", (Nodetype.NAME, _EVENT))
        once: Any = [(part.lower(), (Nodetype.SEQUENCE, (named[part], 1))) for part in ("Request", "Response")]
        parts: Any = [(f"{part.lower()}_message", kind) for part, kind in named.items()]
        self._store.fielddefs[f"{name}_Event"] = ([], [info, *once])
        self._store.fielddefs[name] = ([], parts)


@lru_cache(maxsize=1)
def known() -> Types:
    """The types, made once in a process: they take a tenth of a second."""
    return Types()


def _array(kind: str, count: int) -> Any:
    return np.zeros(count, dtype=np.uint8 if kind in ("octet", "byte", "char") else kind)


def _texts(name: str, text: str) -> Iterator[tuple[str, str]]:
    """The messages that a definition stands for."""
    parts = [part.strip("\n") for part in f"\n{text}".split("\n---\n")]
    if "/srv/" in name:
        yield from zip((f"{name}_Request", f"{name}_Response"), parts, strict=True)
    elif "/action/" in name:
        yield from zip((f"{name}_Goal", f"{name}_Result", f"{name}_Feedback"), parts, strict=True)
        yield f"{name}_SendGoal_Request", f"{_GOAL}{name}_Goal goal"
        yield f"{name}_SendGoal_Response", "bool accepted\nbuiltin_interfaces/Time stamp"
        yield f"{name}_GetResult_Request", _GOAL
        yield f"{name}_GetResult_Response", f"int8 status\n{name}_Result result"
        yield f"{name}_FeedbackMessage", f"{_GOAL}{name}_Feedback feedback"
    else:
        yield name, text
