"""What every table of the fleet file is, how its faults are said, and how a value is written as TOML has it."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from zmav.errors import BadConfig, BadInput


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


def toml_document(tables: Mapping[str, Any]) -> str:
    """Each value on a line of its own, tables in tables within braces. Raises as :func:`toml_value`."""
    lines = []
    for key, value in tables.items():
        if isinstance(value, Mapping):
            lines += [f"{toml_value(key)}.{toml_value(name)} = {toml_value(inner)}" for name, inner in value.items()]
        else:
            lines.append(f"{toml_value(key)} = {toml_value(value)}")
    return "\n".join(lines) + "\n"


T = TypeVar("T")
Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class Table(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, frozen=True):
    """Base of the tables: strict, and never changed once read."""


def convert(tables: Any, kind: type[T], boundless: tuple[str, ...] = ()) -> T:
    """What a TOML file holds as a ``kind``; a fault names its field with every table on the way there by its name.

    ``boundless``: how the fields end that may be infinite. Raises :class:`msgspec.ValidationError`, and
    :class:`BadConfig` for what is no number.
    """
    _check_numbers(tables, "", boundless)
    try:
        return msgspec.convert(tables, kind)
    except msgspec.ValidationError as e:
        raise msgspec.ValidationError(_named(tables, kind, str(e))) from None


def _check_numbers(value: Any, field: str, boundless: tuple[str, ...]) -> None:
    """Refuse NaN and infinities, which TOML has, in their own words: comparisons would call them too large or small."""
    if isinstance(value, float) and not math.isfinite(value):
        if math.isinf(value) and (field.endswith(boundless) or "sim" in field.split(".")):
            return  # the simulator judges its own tables
        said = "not a number (nan)" if math.isnan(value) else f"infinite ({value})"
        raise BadConfig.wrong(field, str(value), "a number", f"{field} is {said}")
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in items:
        _check_numbers(each, f"{field}[{key}]" if isinstance(key, int) else f"{field}.{key}".lstrip("."), boundless)


def _named(tables: Any, kind: type, fault: str) -> str:
    """``fault`` with names for msgspec's ``[...]``: the entry that alone has the same fault."""
    words, mark, where = fault.partition(" - at `$")
    while "[...]" in where:
        before, _, after = where.partition("[...]")
        way = [int(part[1:-1]) if part[0] == "[" else part for part in re.findall(r"\[\d+\]|[^.[\]]+", before)]
        entries = functools.reduce(lambda table, step: table[step], way, tables)
        for name in entries:
            try:
                msgspec.convert(_only(tables, way, name), kind)
            except msgspec.ValidationError as e:
                if str(e) == fault:
                    where, tables = f"{before}.{name}{after}", _only(tables, way, name)
                    break
        else:
            break
    return f"{words}{mark}{where}"


def _only(tables: Any, way: list[Any], name: str) -> Any:
    """The same with a single entry, ``name``, in the table that stands ``way`` below it."""
    if not way:
        return {name: tables[name]}
    copy = list(tables) if isinstance(tables, list) else dict(tables)
    copy[way[0]] = _only(copy[way[0]], way[1:], name)
    return copy


@contextlib.contextmanager
def reading(path: str | Path, what: str) -> Iterator[None]:
    """While a TOML file is read and checked, each fault becomes a :class:`BadConfig` that names file and field."""
    try:
        yield
    except OSError as e:
        raise BadConfig(f"cannot read {what} {path}: {e.strerror}", field="file", value=str(path)) from e
    except msgspec.ValidationError as e:
        expected, _, where = str(e).partition(" - at `$")
        field = where.strip("`").lstrip(".") or "the file"
        raise BadConfig(f"{path}: {expected} (at {field})", field=field, expected=expected) from None
    except BadInput as e:
        raise BadConfig(f"{path}: {e}", **e.detail) from None
    except (ValueError, RecursionError) as e:
        raise BadConfig(f"{path} is not TOML: {e}", field="file", value=str(path), expected="TOML") from e
