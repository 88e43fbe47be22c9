"""What every table of the fleet file is, and how its faults are said."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec

from zmav.errors import BadConfig, BadInput

Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class Table(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, frozen=True):
    """Base of the tables: strict, and never changed once read."""


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
    except ValueError as e:
        raise BadConfig(f"{path} is not TOML: {e}", field="file", value=str(path), expected="TOML") from e
