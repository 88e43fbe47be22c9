"""One commander at a time: a time-limited lease, renewed by use."""

from __future__ import annotations

import secrets
import time
from typing import Any

from zmav import wire
from zmav.errors import BadInput, NotHolder
from zmav.services.events import Events

MAX_TTL = 60.0


class Leases:
    """A vehicle's lease. Lives on the event loop."""

    def __init__(self, vehicle: str, events: Events) -> None:
        self._vehicle, self._events = vehicle, events
        self._token = ""
        self._holder = ""
        self._ttl = 0.0
        self._expires = 0.0

    @property
    def holder(self) -> str | None:
        return self._holder if self._token else None

    async def take(self, args: wire.TakeLease, report: object = None) -> dict[str, Any]:
        """Grant or renew; raises :class:`NotHolder` while another holds it (a namesake without the token included)."""
        if not args.holder:
            raise BadInput("a lease needs a holder's name", field="holder", value=args.holder, expected="a name")
        if not 0.1 <= args.ttl <= MAX_TTL:
            expected = f"0.1 to {MAX_TTL:.0f} s"
            raise BadInput(f"a lease needs a ttl from {expected}", field="ttl", value=args.ttl, expected=expected)
        self.tick()
        if self._token and args.lease != self._token:
            raise self._held()
        if not self._token:
            self._token, self._holder = secrets.token_hex(8), args.holder
            self._events.emit("lease", "info", f"{args.holder} commands", holder=args.holder)
        self._ttl = args.ttl
        self.renew()
        return {"lease": self._token, "holder": self._holder, "ttl": self._ttl}

    async def drop(self, args: wire.DropLease, report: object = None) -> dict[str, Any]:
        self.require(args.lease)
        self._end(f"{self._holder} gave the lease back")
        return {}

    def revoke(self, why: str) -> None:
        """Take the lease from whoever holds it."""
        if self._token:
            self._end(f"lease of {self._holder} revoked: {why}", "warning")

    def holds(self, token: str) -> bool:
        """``token`` is the lease in force, or none is."""
        return token == self._token

    def allow(self, token: str) -> None:
        """Raise :class:`NotHolder` where somebody else commands; with no lease given out, an order needs none."""
        self.tick()
        if self._token and token != self._token:
            raise self._held()

    def require(self, token: str) -> None:
        """Raise :class:`NotHolder` unless ``token`` is the lease in force, and renew it."""
        self.tick()
        if not self._token or token != self._token:
            raise self._held()
        self.renew()

    def renew(self) -> None:
        self._expires = time.monotonic() + self._ttl

    def tick(self) -> None:
        if self._token and time.monotonic() > self._expires:
            self._end(f"lease of {self._holder} ran out", "warning")

    def info(self) -> wire.LeaseInfo | None:
        if not self._token:
            return None
        return wire.LeaseInfo(holder=self._holder, expires=time.time() + self._expires - time.monotonic())

    def _held(self) -> NotHolder:
        if not self._token:
            return NotHolder(f"no such lease on {self._vehicle}: ask for one with do/lease", vehicle=self._vehicle)
        left = self._expires - time.monotonic()
        return NotHolder(
            f"{self._holder} commands {self._vehicle} (for {left:.1f} s more unless renewed); hold, land and disarm "
            "are open to everybody and end its lease",
            vehicle=self._vehicle,
            holder=self._holder,
        )

    def _end(self, text: str, severity: wire.Severity = "info") -> None:
        self._events.emit("lease", severity, text, holder=self._holder)
        self._token = self._holder = ""
