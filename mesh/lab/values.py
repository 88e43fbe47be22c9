"""How a person says a channel's conditions: ``rate = "2 Mbit/s"``, ``delay = "20 ms"``, ``queue = "64 kB"``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import msgspec

from mesh.lab.channel import Conditions
from zmav.errors import BadConfig

_QUANTITY = re.compile(r"\s*(-?\d+(?:\.\d*)?|\.\d+)\s*([a-zA-Z/%]*)\s*")
_SCALE = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
_RATES = {f"{s}{unit}": v * bits for s, v in _SCALE.items() for unit, bits in (("bit/s", 1), ("b/s", 1), ("B/s", 8))}
_TIMES = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_SIZES = {f"{s}{unit}": v for s, v in _SCALE.items() for unit in ("", "B")}
_KINDS: dict[str, tuple[Mapping[str, float], float, float, str]] = {
    "delay": (_TIMES, 0, 3600, "seconds, or such as '20 ms'"),
    "jitter": (_TIMES, 0, 3600, "seconds, or such as '20 ms'"),
    "loss": ({"": 1.0, "%": 0.01}, 0, 1, "a share such as 0.1 or '10 %'"),
    "burst": ({"": 1.0}, 1, 1e6, "a number of frames"),
    "rate": (_RATES | _SCALE, 100, 1e12, "bit/s, or such as '2 Mbit/s'"),
    "queue": (_SIZES, 0, 1e9, "bytes, or such as '64 kB'"),
}
"""units, the least and the greatest value, and what to expect in words"""


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
    rate: float | str | None = None
    """bit/s, or with a unit: ``2 Mbit/s``, ``60 kB/s``, ``1M``; 0 or ``max``: no limit"""
    queue: float | str | None = None
    """bytes, or with a unit: ``64 kB``"""


NAMES = tuple(Ask.__struct_fields__)


def conditions(base: Conditions, ask: Ask, where: str = "") -> Conditions:
    """``base`` with what is asked; raises :class:`BadConfig` that names the field, its value and what was expected."""
    values: dict[str, Any] = {}
    for name in NAMES:
        value = getattr(ask, name)
        if value is None:
            continue
        if name in _KINDS:
            value = None if name == "rate" and value in ("max", 0) else _number(name, value, where)
        values[name] = int(value) if name == "queue" else value
    return msgspec.structs.replace(base, **values)


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


def _number(name: str, given: float | str, where: str) -> float:
    field, (units, least, most, expected) = f"{where}.{name}" if where else name, _KINDS[name]
    value = given
    if isinstance(value, str):
        found = _QUANTITY.fullmatch(value)
        if found is None or found[2] not in units:
            raise BadConfig.wrong(field, given, expected, f"{field} is {given!r}")
        value = float(found[1]) * units[found[2]]
    if not least <= value <= most or math.isnan(value):
        expected = f"{least:g} to {most:g}"
        raise BadConfig.wrong(field, value, expected, f"{field} is {value:g}")
    return float(value)
