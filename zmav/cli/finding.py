"""What ``zmav doctor`` tells, a line at a time."""

from __future__ import annotations

import msgspec


class Finding(msgspec.Struct, frozen=True):
    """One line: is it well, what was looked at, what was found, and what to do where it is not well."""

    ok: bool
    subject: str
    found: str
    advice: str = ""
