"""What there is to see of a fault."""

from __future__ import annotations

from typing import Any

import msgspec


class FaultStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One fault that is on: simulated seconds when it began and when it ends by itself (None: it does not)."""

    vehicle: str
    kind: str
    parameters: dict[str, Any]
    since_s: float
    until_s: float | None
