"""A newer roster at a vehicle: whom the fleet has turned out commands no more."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from zmav.errors import Forbidden
from zmav.trust.roster import Roster, read_signed

if TYPE_CHECKING:
    from tests.trust.conftest import Guarded, StartGuarded


def newer(g: Guarded) -> Roster:
    return read_signed(g.authority.roster()).open(g.authority.certificate, "demo")


async def test_the_lease_of_who_was_turned_out_ends_at_once(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    async with g.client("swap", "planner") as z:
        vehicle, member = z.vehicle("quad1"), z.member
        assert member is not None
        certificate = member.credentials.certificate
        async with vehicle.lease("alice", ttl=30.0):
            g.vehicle.take_roster(newer(g))
            assert g.vehicle.leases.holder == "alice", "it was admitted later than that roster was signed"
            again = {"name": "swap", "role": "planner", "fingerprint": "00" * 8, "not_after": certificate.not_after}
            g.authority.members.append(again)  # the name was given again, with another key
            g.authority.revoked.append(certificate.fingerprint.hex())
            g.vehicle.take_roster(newer(g))
            assert g.vehicle.leases.holder is None
            await g.b.event("lease of alice ended: the fleet turned swap out", kind="lease")
            with pytest.raises(Forbidden, match="revoked"):
                await vehicle.ping()
