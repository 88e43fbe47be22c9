"""Codec: from a frame to named values and back.

Three faces, from plain to convenient: :func:`decode` gives numbers, :func:`describe` what a person or JSON wants to see
(enum names, units), :func:`encode` takes either. Serialization: https://mavlink.io/en/guide/serialization.html

Text (char arrays) is UTF-8 up to the first NUL. Bytes that are no UTF-8 become U+FFFD, which encodes as "?": for such
text, and for bytes after a NUL, the way there and back is not the identity. NaN and infinities are None in
:func:`describe`, because JSON has no word for them; None encodes as NaN.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Mapping
from typing import Any

import msgspec

from zmav.errors import BadMessage
from zmav.mavlink import values
from zmav.mavlink.dialect import Dialect, Field, MessageType
from zmav.mavlink.frame import HEADER_V1, HEADER_V2, MAGIC_V2, Frame, build_frame, parse_frame

_MAVLINK_VERSION = 3
"""What HEARTBEAT.mavlink_version holds, in MAVLink 1 and 2 alike."""


class MavMessage(msgspec.Struct):
    """A message for people and JSON: enum entries by name, flags as "A | B", NaN and infinities as None.

    ``units`` has an entry for every field that has units. ``seq`` is the frame's sequence number, ``verified`` whether
    its checksum was checked.
    """

    name: str
    id: int
    sysid: int
    compid: int
    seq: int
    signed: bool
    verified: bool
    fields: dict[str, Any]
    units: dict[str, str]


def decode(frame: Frame, dialect: Dialect) -> dict[str, Any]:
    """The frame's fields in declared order: numbers, lists of numbers, strings for char arrays, units as on the wire.

    Fields that the frame does not carry (zeros left out, extensions in MAVLink 1) are zero. Raises :class:`BadMessage`
    where the dialect lacks the message, or has another definition of it than the sender.
    """
    message = dialect.by_id.get(frame.msgid)
    if message is None:
        raise BadMessage(
            f"dialect {dialect.name} has no message {frame.msgid}",
            field="msgid",
            value=frame.msgid,
            expected=f"a message of dialect {dialect.name}",
        )
    if not frame.verified:
        # Its splitter had another dialect, and could not check what this one can.
        parse_frame(frame.data, dialect)
    return unpack(message, frame.payload)


def unpack(message: MessageType, payload: bytes) -> dict[str, Any]:
    """The fields of a payload, as :func:`decode` gives them."""
    size = message.max_length
    raw = message.struct.unpack(payload[:size].ljust(size, b"\0"))
    if message.order is not None:
        return dict(zip(message.by_name, message.order(raw), strict=True))
    found: dict[str, Any] = {}
    index = 0
    for field in message.wire_fields:
        if field.type == "char":
            found[field.name] = values.text(raw[index])
            index += 1
        elif field.length:
            found[field.name] = list(raw[index : index + field.length])
            index += field.length
        else:
            found[field.name] = raw[index]
            index += 1
    return {field.name: found[field.name] for field in message.fields}


def describe(frame: Frame, dialect: Dialect) -> MavMessage:
    """The frame as a :class:`MavMessage`. Never raises: what cannot be decoded has one field, ``payload``, in hex."""
    units: dict[str, str] = {}
    verified = True
    try:
        plain = decode(frame, dialect)
    except BadMessage:
        fields: dict[str, Any] = {"payload": frame.payload.hex()}
        verified = False
    else:
        message = dialect.by_id[frame.msgid]
        fields, units = _shown(message, plain, dialect), dict(message.units)
    return MavMessage(
        name=dialect.name_of(frame.msgid),
        id=frame.msgid,
        sysid=frame.sysid,
        compid=frame.compid,
        seq=frame.seq,
        signed=frame.signed,
        verified=verified,
        fields=fields,
        units=units,
    )


def _shown(message: MessageType, plain: dict[str, Any], dialect: Dialect) -> dict[str, Any]:
    """Decoded fields as JSON has them; few of them are anything else than they were."""
    for name, value in plain.items():
        if isinstance(value, (float, list)):
            plain[name] = values.to_json(message.by_name[name], value, dialect)
    for field in message.enum_fields:
        if not field.length:
            plain[field.name] = values.to_json(field, plain[field.name], dialect)
    return plain


def encode(
    dialect: Dialect,
    name: str,
    fields: Mapping[str, Any],
    *,
    sysid: int,
    compid: int,
    seq: int = 0,
    version: int = 2,
    default: int | None = None,
) -> bytes:
    """The unsigned frame of message ``name`` with these ``fields``, as bytes.

    Every base field must be given (but for HEARTBEAT's mavlink_version) unless there is a ``default``, 0; extension
    fields may be left out, which means zero, and do not exist in MAVLink ``version`` 1. Taken are numbers, enum entries
    by name, flags as "A | B | 64", lists, strings for char arrays, and None for NaN. uint8_t and int8_t arrays may be
    shorter than the field (zeros follow), and a uint8_t array may be bytes. Raises one :class:`BadMessage` whose
    ``detail["fields"]`` maps every bad field to what was expected.
    """
    message = dialect.message(name)
    if not isinstance(fields, Mapping):
        raise BadMessage(
            f"{message.name}: the fields are a {type(fields).__name__}",
            field="fields",
            value=fields,
            expected="an object with a value by each field's name",
        )
    bad = _bad_header(message, sysid, compid, seq, version)
    for unknown in fields:
        if unknown not in message.by_name:
            bad[str(unknown)] = f"no such field; {message.name} has {', '.join(message.by_name)}"
    flat: list[Any] = []
    for field in message.wire_fields:
        try:
            flat += _field_values(field, fields, dialect, version, default)
        except ValueError as error:
            bad[field.name] = str(error)
    if bad:
        listed = "; ".join(f"{field}: {why}" for field, why in bad.items())
        raise BadMessage(f"{message.name} cannot be encoded: {listed}", fields=bad)
    payload = message.struct.pack(*flat)
    if version == 1:
        payload = payload[: message.base_length]
    return build_frame(message, payload, sysid, compid, seq, version)


def _field_values(
    field: Field, given: Mapping[str, Any], dialect: Dialect, version: int, default: int | None
) -> list[Any]:
    if field.name not in given:
        if field.name == "mavlink_version":  # not the caller's to give: the definition says so
            return [_MAVLINK_VERSION]
        if default is None and not field.extension:
            raise ValueError(f"missing; expected {values.expected(field)}")
        return values.zeros(field)
    packed = values.from_json(field, given[field.name], dialect)
    if version == 1 and field.extension and any(v not in (0, b"") for v in packed):
        raise ValueError("an extension field, which MAVLink 1 cannot carry")
    return packed


def _bad_header(message: MessageType, sysid: int, compid: int, seq: int, version: int) -> dict[str, str]:
    bad = {
        name: f"{value!r} is not an integer from 0 to 255"
        for name, value in (("sysid", sysid), ("compid", compid), ("seq", seq))
        if type(value) is not int or not 0 <= value <= 255
    }
    if version not in (1, 2):
        bad["version"] = f"{version!r} is not 1 or 2"
    elif version == 1 and message.id > 255:
        bad["version"] = f"MAVLink 1 cannot carry message id {message.id}: it has one byte for it"
    return bad


def targets(frame: Frame, dialect: Dialect) -> tuple[int, int]:
    """(target_system, target_component) of the frame; 0, which means everybody, where the message has no such field."""
    message = dialect.by_id.get(frame.msgid)
    if message is None:
        return (0, 0)
    return (_byte(frame, message.target_system), _byte(frame, message.target_component))


def _byte(frame: Frame, offset: int | None) -> int:
    if offset is None or offset >= frame.data[1]:  # absent from the message, or among the zeros left out
        return 0
    return frame.data[(HEADER_V2 if frame.data[0] == MAGIC_V2 else HEADER_V1) + offset]


class Packer:
    """Makes one component's frames, with its sequence numbers; for zmav's own code, and any thread may call it.

    Unlike with :func:`encode`, any field left out is zero.
    """

    def __init__(self, dialect: Dialect, sysid: int, compid: int, *, version: int = 2) -> None:
        self.dialect = dialect
        self.sysid = sysid
        self.compid = compid
        self.version = version
        self._seq = 0
        self._lock = threading.Lock()
        self._plans: dict[str, _Plan] = {}

    def restart(self) -> None:
        """Count from 0 again."""
        with self._lock:
            self._seq = 0

    def pack(self, name: str, /, **fields: Any) -> bytes:
        """The next frame. Raises :class:`BadMessage` as :func:`encode` does; that uses up no sequence number."""
        with self._lock:
            head = {"sysid": self.sysid, "compid": self.compid, "seq": self._seq, "version": self.version}
            data = self._pack_fast(name, fields) or encode(self.dialect, name, fields, **head, default=0)
            self._seq = (self._seq + 1) & 0xFF
        return data

    def _pack_fast(self, name: str, fields: dict[str, Any]) -> bytes | None:
        """The fast path: numbers, whole arrays of numbers, bytes and plain text. None: :func:`encode` will do it, or
        say what is wrong with it.
        """
        if self.version != 2:
            return None
        plan = self._plans.get(name)
        if plan is None:
            plan = self._plans[name] = _Plan(self.dialect.message(name))
        given = {**plan.zeros, **fields}
        if len(given) != len(plan.zeros):
            return None
        try:
            payload = plan.message.struct.pack(*(plan.flat(given) if plan.sizes else given.values()))
        except (struct.error, OverflowError, TypeError, ValueError):
            return None
        return build_frame(plan.message, payload, self.sysid, self.compid, self._seq)


class _Plan:
    """How a message is packed: what its fields are where they are not given, in the payload's order, and where it has
    arrays or texts the length of each field (0: a single number, negative: a text's), and which are arrays of bytes.
    """

    def __init__(self, message: MessageType) -> None:
        self.message = message
        self.zeros: dict[str, Any] = {}
        sizes = []
        self.octets = tuple(field.type == "uint8_t" for field in message.wire_fields)
        for field in message.wire_fields:
            text = field.type == "char"
            size = -(field.length or 1) if text else field.length
            sizes.append(size)
            zero: Any = "" if text else [0] * size if size else 0
            self.zeros[field.name] = _MAVLINK_VERSION if field.name == "mavlink_version" else zero
        self.sizes = tuple(sizes) if any(sizes) else ()

    def flat(self, given: dict[str, Any]) -> list[Any]:
        """The arguments for struct; ValueError for what takes more care."""
        found: list[Any] = []
        for value, size, octets in zip(given.values(), self.sizes, self.octets, strict=True):
            if size == 0:
                found.append(value)
            elif octets and type(value) is bytes and len(value) <= size:
                found += value.ljust(size, b"\0")
            elif size > 0:
                if type(value) is not list or len(value) != size:
                    raise ValueError
                found += value
            elif type(value) is str and value.isascii() and len(value) <= -size:
                found.append(value.encode("ascii"))
            else:
                raise ValueError
        return found
