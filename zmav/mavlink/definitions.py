"""Read message definitions: from pymavlink's generated modules, or from a user's XML by pymavlink's generator.

Nothing is written anywhere, nothing is printed, and no environment variable is set: pymavlink's switches that work by
those are not needed for the tables alone.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import re
import struct
import xml.etree.ElementTree as ET
import xml.parsers.expat
from pathlib import Path
from typing import Any

from zmav.errors import BadConfig
from zmav.mavlink.dialect import Field, MessageType

_DIALECTS = "pymavlink.dialects.v20"
_MAX_PAYLOAD = 255
_MAX_ID = (1 << 24) - 1

Enums = dict[str, dict[str, int]]


def read_named(name: str) -> tuple[list[MessageType], Enums]:
    """Messages and enums of the dialect pymavlink calls ``name``; raises :class:`BadConfig` where it has none such."""
    known = re.fullmatch(r"[A-Za-z]\w*", name) and importlib.util.find_spec(f"{_DIALECTS}.{name}")
    if not known:
        raise BadConfig(
            f"no dialect called {name!r}",
            field="dialect",
            value=name,
            expected="ardupilotmega, common, development, another dialect of pymavlink, or the path of an XML file",
        )
    module = importlib.import_module(f"{_DIALECTS}.{name}")
    bitmasks = {enum for enum, entries in module.enums.items() if getattr(entries, "bitmask", False)}
    enums = {enum: _entries(enum, entries) for enum, entries in module.enums.items()}
    return [_from_class(cls, bitmasks) for cls in module.mavlink_map.values()], enums


def _entries(enum: str, entries: dict[int, Any]) -> dict[str, int]:
    # The generator adds an entry X_ENUM_END, which is no part of the protocol.
    return {entry.name: value for value, entry in entries.items() if entry.name != f"{enum}_ENUM_END"}


def _from_class(cls: Any, bitmasks: set[str]) -> MessageType:
    # The generated constructor gives defaults to extension fields and to nothing else, and they come last. (The tests
    # hold this against crc_extra, which covers exactly the fields that are not extensions.)
    extensions = len(cls.__init__.__defaults__ or ())
    first_extension = len(cls.fieldnames) - extensions
    lengths = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    fields = []
    for index, (name, ctype) in enumerate(zip(cls.fieldnames, cls.fieldtypes, strict=True)):
        enum = cls.fieldenums_by_name.get(name, "")
        fields.append(
            Field(
                name=name,
                type=ctype,
                length=lengths[name],
                units=cls.fieldunits_by_name.get(name, ""),
                enum=enum,
                bitmask=cls.fielddisplays_by_name.get(name) == "bitmask" or enum in bitmasks,
                extension=index >= first_extension,
            )
        )
    return MessageType.build(cls.id, cls.msgname, cls.crc_extra, fields, list(cls.ordered_fieldnames))


def read_xml(path: Path) -> tuple[list[MessageType], Enums]:
    """Messages and enums of an XML file and of all it includes; raises :class:`BadConfig` naming file and fault."""
    from pymavlink.generator import mavparse

    said = io.StringIO()
    # The generator reports by print(): what it says is the reason of an error, and otherwise nobody's business.
    with contextlib.redirect_stdout(said):
        files = _with_includes(path, mavparse)
        # Before files' enums are merged: an extension of an enum need not repeat that it holds flags.
        bitmasks = {enum.name for file in files for enum in file.enum if enum.bitmask}
        try:
            if mavparse.check_duplicates(files):
                raise _bad(path, _last_error(said.getvalue()))
            return _tables(path, files, bitmasks)
        except (LookupError, ValueError, TypeError, AttributeError, struct.error) as error:
            # The generator takes much for granted, and a wrong file makes it stumble in many ways.
            raise _bad(path, f"{type(error).__name__}: {error}") from error


def read_trees(path: Path) -> list[ET.Element]:
    """The XML of a file and of all it includes; raises :class:`BadConfig` where one cannot be read."""
    roots: dict[Path, ET.Element] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop(0)
        if file not in roots:
            try:
                roots[file] = ET.parse(file).getroot()
            except (OSError, ET.ParseError) as error:
                raise _bad(file, str(error)) from error
            waiting += [_find_include(file, (each.text or "").strip()) for each in roots[file].iter("include")]
    return list(roots.values())


def shipped_xml(name: str) -> Path:
    """The XML file behind pymavlink's dialect of that name."""
    return _shipped(f"{name}.xml") or Path(f"{name}.xml")


def _tables(path: Path, files: list[Any], bitmasks: set[str]) -> tuple[list[MessageType], Enums]:
    enums = {
        enum.name: {entry.name: entry.value for entry in enum.entry if not entry.end_marker}
        for file in files
        for enum in file.enum
    }
    messages = []
    for file in files:
        for message in file.message:
            if not message.fields:
                raise _bad(Path(file.filename), f"message {message.name} has no fields")
            if message.wire_length > _MAX_PAYLOAD:
                raise _bad(Path(file.filename), f"message {message.name} is longer than {_MAX_PAYLOAD} bytes")
            if not 0 <= message.id <= _MAX_ID:
                raise _bad(Path(file.filename), f"message {message.name}: id {message.id} does not fit 24 bits")
            messages.append(_from_xml(message, bitmasks))
    if not messages:
        raise _bad(path, "it defines no message")
    return messages, enums


def _from_xml(message: Any, bitmasks: set[str]) -> MessageType:
    base = message.base_fields()
    fields = [
        Field(
            name=f.name,
            type=f.type,
            length=f.array_length,
            units=f.units.strip("[]"),
            enum=f.enum,
            bitmask=f.display == "bitmask" or f.enum in bitmasks,
            extension=index >= base,
        )
        for index, f in enumerate(message.fields)
    ]
    return MessageType.build(message.id, message.name, message.crc_extra, fields, list(message.ordered_fieldnames))


def _with_includes(path: Path, mavparse: Any) -> list[Any]:
    """The file and all it includes, parsed, each once; includes are sought beside their includer, then in pymavlink."""
    parsed: dict[Path, Any] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop(0)
        if file in parsed:
            continue
        parsed[file] = _parse(file, mavparse)
        for name in parsed[file].include:
            waiting.append(_find_include(file, name.strip()))
    return list(parsed.values())


def _find_include(includer: Path, name: str) -> Path:
    beside = (includer.parent / name).resolve()
    if beside.is_file():
        return beside
    shipped = _shipped(Path(name).name)
    if shipped is not None:
        return shipped
    raise _bad(includer, f"it includes {name!r}, which is neither beside it nor among pymavlink's dialects")


def _shipped(name: str) -> Path | None:
    """The file of that name among pymavlink's dialects."""
    package = importlib.util.find_spec(_DIALECTS)
    for folder in (package.submodule_search_locations or []) if package else []:
        file = Path(folder) / name
        if file.is_file():
            return file.resolve()
    return None


_ARRAY_LENGTH = re.compile(r"(25[0-5]|2[0-4]\d|1\d\d|[1-9]\d?)\]")
_ENUM_VALUE = re.compile(r" *(0x[0-9a-fA-F]{1,16}|0|[1-9][0-9]{0,19}|2\*\*[0-9]|2\*\*[1-6][0-9]) *")


def _parse(path: Path, mavparse: Any) -> Any:
    try:
        _check_numbers(path, ET.parse(path).getroot())
        return mavparse.MAVXML(str(path), mavparse.PROTOCOL_2_0)
    except OSError as error:
        raise _bad(path, str(error.strerror or error)) from error
    except (ET.ParseError, xml.parsers.expat.ExpatError) as error:
        raise _bad(path, f"not well-formed XML: {error}") from error
    except mavparse.MAVParseError as error:
        raise _bad(path, str(error)) from error
    except (AssertionError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise _bad(path, f"{type(error).__name__}: {error}") from error


def _check_numbers(path: Path, root: ET.Element) -> None:
    """Refuse what the generator would take too lightly."""
    if root.tag != "mavlink":
        raise _bad(path, f"its root element is <{root.tag}>, not <mavlink>")
    for entry in root.iter("entry"):
        # The generator hands this to eval(): let nothing through but the number the schema allows.
        value = entry.get("value")
        if value is not None and not _ENUM_VALUE.fullmatch(value):
            raise _bad(path, f"enum entry {entry.get('name')} has value {value!r}, which is no number")
    for field in root.iter("field"):
        ctype, bracket, length = field.get("type", "").partition("[")
        if bracket and not _ARRAY_LENGTH.fullmatch(length):
            raise _bad(path, f"field {field.get('name')} is a {ctype}[{length}: arrays have 1 to 255 elements")


def _last_error(said: str) -> str:
    errors = re.findall(r"ERROR: (.*)", said, re.DOTALL)
    return " ".join(errors[-1].split()) if errors else "the generator refused it"


def _bad(path: Path, reason: str) -> BadConfig:
    return BadConfig(
        f"dialect file {path}: {reason}", field="dialect", value=str(path), expected="a MAVLink XML file", reason=reason
    )
