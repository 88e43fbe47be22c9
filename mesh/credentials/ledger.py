"""The authority's ledger: every certificate it signed and what became of it. The roster is made from it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec

from mesh.credentials import files
from zmav.errors import BadConfig
from zmav.trust.certificate import Role
from zmav.trust.roster import Member, Roster

LEDGER = "ledger.json"
Time = Annotated[float, msgspec.Meta(ge=0.0, le=253_000_000_000.0)]
"""UTC seconds, before the year 10000"""
REMEMBERED = 30 * 86_400.0
"""s that the roster goes on naming a certificate after its end: some clock may be that late"""


class Entry(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, frozen=True):
    """One certificate."""

    name: str
    role: Role
    serial: str
    """hexadecimal"""
    fingerprint: str
    """hexadecimal"""
    not_before: Time
    not_after: Time
    revoked: Time | None = None
    """None: it is not"""

    def in_force(self, now: float) -> bool:
        return self.revoked is None and now <= self.not_after


class IssuedCertificates(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, frozen=True):
    """All of them, oldest first."""

    fleet: str
    number: int = 0
    """the roster's: counts up with every change"""
    t: Time = 0.0
    """of the last change: a number's roster is the same, whenever it is signed"""
    entries: list[Entry] = []

    def current(self, name: str, now: float) -> Entry | None:
        """The newest certificate of ``name`` that is in force; None where there is none."""
        return next((e for e in reversed(self.entries) if e.name == name and e.in_force(now)), None)

    def names(self) -> list[str]:
        return sorted({entry.name for entry in self.entries})

    def with_entry(self, entry: Entry, now: float) -> IssuedCertificates:
        return msgspec.structs.replace(self, number=self.number + 1, t=now, entries=[*self.entries, entry])

    def without(self, name: str, now: float) -> IssuedCertificates:
        """All certificates of ``name`` revoked at ``now``."""
        entries = [
            msgspec.structs.replace(e, revoked=now) if e.name == name and e.in_force(now) else e for e in self.entries
        ]
        return msgspec.structs.replace(self, number=self.number + 1, t=now, entries=entries)

    def roster(self, now: float) -> Roster:
        """What members need to know of it."""
        told = [e for e in self.entries if now <= e.not_after + REMEMBERED]
        return Roster(
            fleet=self.fleet,
            number=self.number,
            t=self.t,
            members=[
                Member(name=e.name, role=e.role.value, fingerprint=e.fingerprint, not_after=e.not_after)
                for e in told
                if e.revoked is None
            ],
            revoked=[e.fingerprint for e in told if e.revoked is not None],
        )

    def encode(self) -> bytes:
        """As the file holds it."""
        return msgspec.json.format(msgspec.json.encode(self))

    def write(self, folder: Path) -> None:
        files.write(folder / LEDGER, self.encode(), files.SECRET)


def read_ledger(folder: Path) -> IssuedCertificates:
    """Of an authority's folder; raises :class:`BadConfig` where there is none, or no good one."""
    path = folder / LEDGER
    try:
        return msgspec.json.decode(path.read_bytes(), type=IssuedCertificates)
    except OSError as e:
        text = f"{folder} is not an authority's folder: cannot read {path}: {e.strerror}; 'zmav mesh ca init' makes one"
        raise BadConfig(text, field="ca", value=str(folder), expected="an authority's folder") from e
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        text = f"{path} is damaged: {e}; put your copy of this folder in its place"
        raise BadConfig(text, field="ca", value=str(path), expected="a ledger") from e
