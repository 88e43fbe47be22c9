"""Read message definitions from the Python modules that pymavlink's generator makes: its own, or a user's.

They are imported on first use, because that is slow. Nothing is written anywhere, nothing is printed, and no
environment variable is set: pymavlink's switches that work by those are not needed for the tables alone.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any

from zmav.errors import BadConfig
from zmav.mavlink.additions import with_additions
from zmav.mavlink.dialect import Dialect, Field, MessageType

_DIALECTS = "pymavlink.dialects.v20"
EXPECTED = "ardupilotmega, common, development, another dialect of pymavlink, or a module that its mavgen made (own.py)"

Enums = dict[str, dict[str, int]]


def load_dialect(name_or_path: str = "ardupilotmega") -> Dialect:
    """A dialect by pymavlink's name ("ardupilotmega", "common", "development" ...) or from a Python module that its
    generator made of your own XML ("/path/own.py"; where own.xml lies beside it, its commands are known as well).

    Loaded once and then kept. Raises :class:`BadConfig` naming what is wrong.
    """
    return _load(name_or_path)


@functools.lru_cache(maxsize=16)
def _load(given: str) -> Dialect:
    path = Path(given)
    own = path.suffix == ".py"
    messages, enums = _read(_module_at(path) if own else _module_named(given))
    beside = path.with_suffix(".xml")
    source = beside if own and beside.is_file() else shipped_xml("ardupilotmega" if own else given)
    return Dialect.build(path.stem if own else given, str(source), with_additions(messages), enums)


def _module_named(name: str) -> ModuleType:
    """The module of the dialect that pymavlink calls ``name``; raises :class:`BadConfig` where it has none such."""
    if not (re.fullmatch(r"[A-Za-z]\w*", name) and importlib.util.find_spec(f"{_DIALECTS}.{name}")):
        raise BadConfig(f"no dialect called {name!r}", field="dialect", value=name, expected=EXPECTED)
    return importlib.import_module(f"{_DIALECTS}.{name}")


def _module_at(path: Path) -> ModuleType:
    """A module that ``mavgen --lang Python3 --wire-protocol 2.0`` made of a user's XML; raises :class:`BadConfig`."""
    spec = importlib.util.spec_from_file_location(f"zmav_dialect_{path.stem}", path)
    try:
        assert spec is not None and spec.loader is not None  # its name ends with .py
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        _ = module.mavlink_map, module.enums
    except Exception as error:  # what a file holds that is no such module may fail in any way
        reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise _bad(path, reason) from error
    return module


def _read(module: Any) -> tuple[list[MessageType], Enums]:
    """Messages and enums of a generated module."""
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


def _bad(path: Path, reason: str) -> BadConfig:
    return BadConfig(
        f"dialect file {path}: {reason}", field="dialect", value=str(path), expected=EXPECTED, reason=reason
    )
