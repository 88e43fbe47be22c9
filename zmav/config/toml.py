"""Values as TOML has them, each in one line: Python reads that format, and does not write it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import msgspec

from zmav.errors import BadInput


def toml_value(value: Any) -> str:
    """A key (quoted) or a value; tables stand within braces. Raises :class:`BadInput` for None, which TOML lacks."""
    value = msgspec.to_builtins(value)
    if value is None:
        raise BadInput("null is no value of a setting", field="option", value=None, expected="a value")
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml_value(str(key))} = {toml_value(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML writes the rest as JSON does
