"""Load a dialect by name or from a file, once; reading the definitions waits for the first use."""

from __future__ import annotations

import functools
from pathlib import Path

from zmav.errors import BadConfig
from zmav.mavlink.dialect import Dialect


def load_dialect(name_or_path: str = "ardupilotmega") -> Dialect:
    """A dialect by pymavlink's name ("ardupilotmega", "common", "development" ...) or from an XML file ("/path/x.xml").

    Loaded once and then kept; an XML file is read again when it has changed. Raises :class:`BadConfig` naming what is
    wrong: no such dialect, no such file, a file it includes is missing, or what the XML says is not a dialect.
    """
    if not name_or_path.lower().endswith(".xml") and "/" not in name_or_path:
        return _load_named(name_or_path)
    try:
        path = Path(name_or_path).expanduser()
        changed = path.stat().st_mtime_ns
    except (OSError, RuntimeError, ValueError) as error:  # no such user's home, or a NUL in the name
        raise BadConfig(
            f"dialect file {name_or_path}: {getattr(error, 'strerror', '') or error}",
            field="dialect",
            value=name_or_path,
            expected="a readable MAVLink XML file",
        ) from error
    return _load_xml(str(path.resolve()), changed)


@functools.lru_cache(maxsize=16)
def _load_named(name: str) -> Dialect:
    from zmav.mavlink import additions, definitions  # pymavlink is slow to import: only who needs a dialect pays for it

    messages, enums = definitions.read_named(name)
    return Dialect.build(name, str(definitions.shipped_xml(name)), additions.with_additions(messages), enums)


@functools.lru_cache(maxsize=16)
def _load_xml(path: str, _changed: int) -> Dialect:
    from zmav.mavlink import additions, definitions

    messages, enums = definitions.read_xml(Path(path))
    return Dialect.build(Path(path).stem, path, additions.with_additions(messages), enums)
