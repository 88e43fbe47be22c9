"""All kinds of faults by name, with their parameters and bounds; made from Python values or from a person's words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from zmav.errors import BadInput
from zmav.sim.faults import body, links, sensors
from zmav.sim.faults.base import Fault

KINDS: Mapping[str, type[Fault]] = {
    kind.KIND: kind
    for kind in (
        links.LinkCut,
        links.LinkLoss,
        sensors.GpsLoss,
        sensors.GpsGlitch,
        sensors.CorrectionsLoss,
        sensors.CorrectionsJump,
        sensors.CorrectionsForeign,
        sensors.CompassError,
        sensors.BaroError,
        sensors.RangefinderError,
        sensors.ImuError,
        sensors.PitotLoss,
        body.MotorFailure,
        body.BatteryCollapse,
        body.RcLoss,
        body.Frozen,
        body.Reboot,
        body.CameraBlackout,
        body.GimbalFault,
    )
}
_WORDS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def parameters(fault: type[Fault]) -> dict[str, str]:
    """What a kind can be given, by name, and what each may be."""
    found = msgspec.inspect.type_info(fault)
    assert isinstance(found, msgspec.inspect.StructType)
    return {field.encode_name: _expected(field.type) for field in found.fields}


def _expected(kind: msgspec.inspect.Type) -> str:
    if isinstance(kind, msgspec.inspect.BoolType):
        return "true or false"
    if isinstance(kind, msgspec.inspect.LiteralType):
        return ", ".join(map(str, kind.values))
    if isinstance(kind, (msgspec.inspect.FloatType, msgspec.inspect.IntType)):
        return f"{kind.ge:g} to {kind.le:g}"
    return "text"


def make_fault(kind: str, values: Mapping[str, Any]) -> Fault:
    """The fault of that kind with those parameters. :class:`BadInput` names what is not known or out of bounds."""
    if kind not in KINDS:
        expected = ", ".join(KINDS)
        raise BadInput(f"no fault {kind!r}; there are {expected}", field="kind", value=kind, expected=expected)
    known = parameters(KINDS[kind])
    for name, value in values.items():
        if name not in known:
            expected = ", ".join(known) or "none"
            raise BadInput(
                f"{kind} has no parameter {name!r}; it has {expected}", field=name, value=value, expected=expected
            )
    for name, value in values.items():
        try:
            if isinstance(value, float) and not math.isfinite(value):
                raise msgspec.ValidationError
            msgspec.convert({name: value}, KINDS[kind])
        except msgspec.ValidationError:
            raise BadInput.wrong(name, value, known[name], f"{kind}: {name} is {value!r}") from None
    return msgspec.convert(dict(values), KINDS[kind])


def values_from_words(words: Sequence[str]) -> dict[str, Any]:
    """``name=value`` words as values; :class:`BadInput` for any other word."""
    values: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or not name:
            raise BadInput.wrong("parameter", word, "NAME=VALUE", f"{word!r} is no parameter")
        values[name.replace("-", "_")] = _value(text)
    return values


def _value(text: str) -> Any:
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
