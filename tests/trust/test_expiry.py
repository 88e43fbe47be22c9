"""The end of a certificate: said before it comes, and no reason to lose sight of who is in the air."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from tests.trust.conftest import DAY, Authority
from zmav import keys
from zmav.errors import Forbidden
from zmav.trust.certificate import warn_of_end
from zmav.trust.gate import Gate
from zmav.trust.member import Member
from zmav.trust.proof import Signer

STATE = keys.STATE.key("demo", "quad1")


@pytest.mark.parametrize(("ends", "words"), [(40, None), (29, "in 29 days"), (1, "in 24.0 hours"), (-0.5, "ended")])
async def test_it_is_said_when_it_is_near(tmp_path: Path, ends: float, words: str | None) -> None:
    certificate = Authority(tmp_path).strange("quad1", "vehicle", ends=ends * DAY).certificate
    said: list[str] = []
    task = asyncio.create_task(warn_of_end(certificate, said.append))
    await asyncio.sleep(0)
    assert not task.done()
    task.cancel()
    assert [words in text for text in said] == [True] if words else said == []


@pytest.mark.parametrize(("ends", "believed"), [(-0.9, True), (-1.1, False)])
def test_what_a_vehicle_says_is_believed_a_day_longer_and_orders_are_not(
    tmp_path: Path, ends: float, believed: bool
) -> None:
    authority = Authority(tmp_path)
    quad1, op = (
        authority.strange("quad1", "vehicle", begins=-2 * DAY, ends=ends * DAY),
        authority.member("op", "operator"),
    )
    attachment = Signer(quad1).sign(STATE, b"{}", introduce=True)
    if believed:
        Member(op).judge(STATE, b"{}", attachment, {})
    else:
        with pytest.raises(Forbidden, match="expired"):
            Member(op).judge(STATE, b"{}", attachment, {})
    with pytest.raises(Forbidden, match="expired"):
        Gate(authority.member("quad2", "vehicle")).learn(quad1.certificate.der)
