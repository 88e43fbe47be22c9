"""How a person says a channel's conditions: ``rate = "2 Mbit/s"``, ``delay = "20 ms"``, ``queue = "64 kB"``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import msgspec

from mesh.lab.channel import Conditions
from zmav.errors import BadConfig

_QUANTITY = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-zA-Z/]*)\s*")
_SCALE = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
_RATES = {f"{s}{unit}": v * bits for s, v in _SCALE.items() for unit, bits in (("bit/s", 1), ("b/s", 1), ("B/s", 8))}
_RATES |= _SCALE
_TIMES = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_SIZES = {f"{s}{unit}": v for s, v in _SCALE.items() for unit in ("", "B")}


class Ask(msgspec.Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """Conditions as far as they are said; see :class:`mesh.lab.channel.Conditions`."""

    up: bool | None = None
    delay: float | str | None = None
    """s, or with a unit: ``20 ms``"""
    jitter: float | str | None = None
    ordered: bool | None = None
    loss: float | str | None = None
    """share, or ``10 %``"""
    burst: float | None = None
    duplicate: float | str | None = None
    rate: float | str | None = None
    """bit/s, or with a unit: ``2 Mbit/s``, ``60 kB/s``, ``1M``; 0 or ``max``: no limit"""
    queue: float | str | None = None
    """bytes, or with a unit: ``64 kB``"""
    bucket: float | str | None = None


NAMES = tuple(Ask.__struct_fields__)


def conditions(base: Conditions, ask: Ask, where: str = "") -> Conditions:
    """``base`` with what is asked; raises :class:`BadConfig` that names the field, its value and what was expected."""
    said = {name: getattr(ask, name) for name in NAMES if getattr(ask, name) is not None}
    values: dict[str, Any] = {}
    for name, value in said.items():
        field = f"{where}.{name}" if where else name
        if name in ("delay", "jitter"):
            values[name] = _within(_quantity(value, _TIMES, field, "seconds, or such as '20 ms'"), 0, 3600, field)
        elif name in ("loss", "duplicate"):
            values[name] = _within(_share(value, field), 0, 1, field)
        elif name == "burst":
            values[name] = _within(float(value), 1, 1e6, field)
        elif name == "rate":
            rate = 0.0 if value == "max" else _quantity(value, _RATES, field, "bit/s, or such as '2 Mbit/s'")
            values[name] = _within(rate, 100, 1e12, field) if rate else None
        elif name in ("queue", "bucket"):
            values[name] = int(_within(_quantity(value, _SIZES, field, "bytes, or such as '64 kB'"), 0, 1e9, field))
        else:
            values[name] = value
    return msgspec.structs.replace(base, **values)


def check_ask(ask: Ask, where: str) -> None:
    """Raise :class:`BadConfig` for conditions that cannot be."""
    conditions(Conditions(), ask, where)


def ask_from(values: Mapping[str, Any]) -> Ask:
    """``{"loss": 0.2, "rate": "1M"}`` as an :class:`Ask`; raises :class:`BadConfig` naming the conditions there are."""
    for name in values:
        if name not in NAMES:
            expected = ", ".join(NAMES)
            raise BadConfig(f"no condition {name!r}; there are {expected}", field=name, value=name, expected=expected)
    try:
        return msgspec.convert(dict(values), Ask)
    except msgspec.ValidationError as e:
        what, _, place = str(e).partition(" - at `$.")
        field = place.strip("`")
        raise BadConfig(f"{field}: {what}", field=field, value=values.get(field), expected=what) from None


def _quantity(value: float | str, units: Mapping[str, float], field: str, expected: str) -> float:
    if not isinstance(value, str):
        return float(value)
    found = _QUANTITY.fullmatch(value)
    if found is None or found[2] not in units:
        raise BadConfig(f"{field} is {value!r}; expected {expected}", field=field, value=value, expected=expected)
    return float(found[1]) * units[found[2]]


def _share(value: float | str, field: str) -> float:
    if isinstance(value, str) and value.rstrip().endswith("%"):
        return _quantity(value.rstrip()[:-1], {"": 0.01}, field, "a share such as 0.1 or '10 %'")
    return _quantity(value, {"": 1.0}, field, "a share such as 0.1 or '10 %'")


def _within(value: float, least: float, most: float, field: str) -> float:
    if not least <= value <= most or math.isnan(value):
        expected = f"{least:g} to {most:g}"
        raise BadConfig(f"{field} is {value:g}; expected {expected}", field=field, value=value, expected=expected)
    return value
