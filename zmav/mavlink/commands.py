"""What a MAV_CMD's seven parameters mean: labels, units, enums and ranges, from the dialect's XML.

pymavlink's generated modules keep only the descriptions, so the message definitions that lie beside them are read, and
only when somebody names a command. Schema: https://mavlink.io/en/guide/xml_schema.html#param
"""

from __future__ import annotations

import functools
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import msgspec

from zmav.errors import BadInput, did_you_mean
from zmav.mavlink import definitions
from zmav.mavlink.dialect import Dialect

PARAMS = 7
_NUMBERED = re.compile(r"param([1-7])")


class CommandParam(msgspec.Struct, frozen=True):
    """One parameter. ``label`` is "" where the definition gives none; ``default`` is sent where it is not given."""

    index: int
    label: str = ""
    units: str = ""
    enum: str = ""
    minimum: float | None = None
    maximum: float | None = None
    default: float = 0.0
    reserved: bool = False

    def __str__(self) -> str:
        words = [f"param{self.index}", self.label and repr(self.label), self.units and f"[{self.units}]", self.enum]
        return " ".join(filter(None, words))


class CommandType(msgspec.Struct, frozen=True):
    """A MAV_CMD: its number, and its parameters 1 to 7. ``has_location``: 5 to 7 are latitude, longitude, altitude."""

    name: str
    id: int
    has_location: bool
    params: tuple[CommandParam, ...]

    def fill(self, given: Mapping[str, float | str | None], dialect: Dialect) -> tuple[float, ...]:
        """param1 to param7 from labels or numbers; an enum's entry may stand for a number, None for NaN.

        Raises :class:`BadInput` that names every fault and the parameters there are.
        """
        values, faults = [param.default for param in self.params], []
        for name, value in given.items():
            param = self._find(name)
            if param is None:
                faults.append(f"it has no parameter {name!r}")
            elif param.reserved:
                faults.append(f"param{param.index} is reserved")
            else:
                number, fault = _number(param, value, dialect)
                values[param.index - 1] = number
                faults += [f"{name}: {fault}"] if fault else []
        if faults:
            known = ", ".join(str(param) for param in self.params if not param.reserved) or "none"
            raise BadInput(
                f"{self.name}: {'; '.join(faults)}. Its parameters: {known}",
                field="params",
                value=dict(given),
                expected=known,
            )
        return tuple(values)

    def _find(self, name: str) -> CommandParam | None:
        numbered = _NUMBERED.fullmatch(name.lower())
        if numbered:
            return self.params[int(numbered[1]) - 1]
        found = [param for param in self.params if param.label and _plain(param.label) == _plain(name)]
        return found[0] if found else None


def _plain(label: str) -> str:
    return re.sub(r"[^a-z0-9]", "", label.lower())


def _number(param: CommandParam, value: float | str | None, dialect: Dialect) -> tuple[float, str]:
    """The number to send, and what is wrong with it or ""."""
    if value is None:
        return math.nan, ""
    if isinstance(value, str):
        entries = dialect.enums.get(param.enum, {})
        total = 0
        for name in (part.strip().upper() for part in value.split("|")):
            entry = entries.get(name, entries.get(f"{param.enum}_{name}"))
            if entry is None:
                return 0.0, f"{name!r} is no entry of {param.enum or 'any enum'}{did_you_mean(name, entries)}"
            total |= entry
        return float(total), ""
    if not math.isfinite(value):
        return 0.0, f"{value} is not finite (null stands for NaN)"
    if param.minimum is not None and value < param.minimum:
        return 0.0, f"{value:g} is below {param.minimum:g}"
    if param.maximum is not None and value > param.maximum:
        return 0.0, f"{value:g} is above {param.maximum:g}"
    return float(value), ""


def command_type(dialect: Dialect, name: str) -> CommandType:
    """The command of that name, in any case and with or without ``MAV_CMD_``; :class:`BadInput` names close ones."""
    known = _load(dialect.source)
    full = name.upper() if name.upper().startswith("MAV_CMD_") else f"MAV_CMD_{name.upper()}"
    found = known.get(full)
    if found is None:
        text = f"dialect {dialect.name} has no command {name!r}{did_you_mean(full, known, n=4, cutoff=0.5)}"
        raise BadInput(text, field="command", value=name, expected="a MAV_CMD")
    return found


@functools.lru_cache(maxsize=8)
def _load(source: str) -> dict[str, CommandType]:
    """Every command of an XML file and of what it includes."""
    found: dict[str, CommandType] = {}
    for root in definitions.read_trees(Path(source)):
        for enum in root.iter("enum"):
            if enum.get("name") == "MAV_CMD":
                for entry in enum.iter("entry"):
                    command = _command(entry)
                    found[command.name] = command
    return found


def _command(entry: ET.Element) -> CommandType:
    params = {int(p.get("index", 0)): _param(p) for p in entry.iter("param")}
    return CommandType(
        name=entry.get("name", ""),
        id=int(entry.get("value", "0"), 0),
        has_location=entry.get("hasLocation") == "true",
        params=tuple(params.get(i, CommandParam(i)) for i in range(1, PARAMS + 1)),
    )


def _param(p: ET.Element) -> CommandParam:
    default = p.get("default")
    return CommandParam(
        index=int(p.get("index", 0)),
        label=p.get("label", ""),
        units=p.get("units", ""),
        enum=p.get("enum", ""),
        minimum=_maybe(p.get("minValue")),
        maximum=_maybe(p.get("maxValue")),
        default=float(default) if default is not None else 0.0,
        reserved=p.get("reserved") == "true",
    )


def _maybe(text: str | None) -> float | None:
    return None if text is None else float(text)
