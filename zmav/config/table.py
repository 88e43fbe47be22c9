"""What every table of the fleet file is."""

from __future__ import annotations

from typing import Annotated

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class Table(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, frozen=True):
    """Base of the tables: strict, and never changed once read."""
