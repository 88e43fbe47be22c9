"""Clocks that disagree: what makes safe passes all the same, nothing old does, and a vehicle is believed again."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

from tests.services.conftest import GUIDED, LAND, STABILIZE
from tests.trust.conftest import StartGuarded
from tests.trust.test_gate import ARM, PING, GateBench, gates
from zmav import wire
from zmav.errors import Forbidden
from zmav.trust.gate import CHALLENGED, PANIC
from zmav.trust.proof import WINDOW
from zmav.trust.roster import read_signed

if TYPE_CHECKING:
    from tests.trust.conftest import Authority, Guarded
    from zmav.trust.credentials import Credentials

__all__ = ["gates"]  # the fixture, for the tests here

LANDING = "zmav/demo/quad1/do/land"
HOUR = 3600.0


def challenge(gates: GateBench, by: Credentials, key: str = LANDING, off: float = HOUR) -> bytes:
    """What the gate gives to who is off by so many seconds."""
    with pytest.raises(Forbidden) as e:
        gates.check(gates.proof(by, key, now=gates.utc + off), key)
    assert e.value.detail["reason"] == "clock"
    return bytes.fromhex(str(e.value.detail["challenge"]))


@pytest.mark.parametrize("off", [HOUR, -HOUR, -1e9])
@pytest.mark.parametrize("verb", PANIC)
def test_who_answers_the_challenge_needs_no_clock(gates: GateBench, verb: str, off: float) -> None:
    op, key = gates.authority.member("op", "operator"), f"zmav/demo/quad1/do/{verb}"
    gates.check(gates.proof(op))
    answers = challenge(gates, op, key, off)
    proof = gates.proof(op, key, now=gates.utc + off, answers=answers)
    assert gates.check(proof, key).name == "op"
    assert gates.reason(proof, key) == "replayed"


def test_who_changes_the_epoch_again_and_again_shuts_no_landing_out(gates: GateBench) -> None:
    """A planner's orders from the future void all proofs: what makes safe answers a challenge, which they do not."""
    op, planner = gates.authority.member("op", "operator"), gates.authority.member("p", "planner")
    goto = "zmav/demo/quad1/do/goto"

    def void() -> None:
        before = gates.gate.epoch
        assert gates.reason(gates.proof(planner, goto, now=gates.utc + HOUR), goto) == "clock"
        assert gates.gate.epoch != before

    late = gates.proof(op, LANDING)
    void()
    with pytest.raises(Forbidden) as e:
        gates.check(late, LANDING)
    assert e.value.detail["reason"] == "epoch"
    proof = gates.proof(op, LANDING, answers=bytes.fromhex(str(e.value.detail["challenge"])))
    void()
    assert gates.check(proof, LANDING).name == "op"


def test_a_challenge_is_for_one_member_one_order_and_half_a_minute(gates: GateBench) -> None:
    op, other = gates.authority.member("op", "operator"), gates.authority.member("other", "operator")
    answers, late = challenge(gates, op), gates.utc + HOUR

    def proof(by: Credentials, key: str) -> bytes:
        return gates.proof(by, key, now=late, answers=answers)

    assert gates.reason(proof(other, LANDING), LANDING) == "clock"
    assert gates.reason(proof(op, LANDING.replace("land", "rtl")), LANDING.replace("land", "rtl")) == "clock"
    assert gates.reason(proof(op, LANDING), LANDING, b"{ }") == "signature"
    for _ in range(1000):  # anyone who asks for many takes nobody's away
        challenge(gates, other)
    gates.now += CHALLENGED
    gates.check(proof(op, LANDING), LANDING)
    gates.now += CHALLENGED
    assert gates.reason(proof(op, LANDING), LANDING) == "clock"


@pytest.mark.parametrize("years", [-20, 20])
def test_a_vehicle_whose_clock_is_years_off_halts_for_whom_it_knows(gates: GateBench, years: int) -> None:
    """No certificate is in force by such a clock."""
    op, other, off = gates.authority.member("op", "operator"), gates.authority.member("other", "operator"), years * 3e7
    gates.check(gates.proof(op))
    gates.utc += off
    for by, key in ((op, LANDING), (other, LANDING), (op, ARM)):
        proof = gates.proof(by, key, now=gates.utc - off, answers=challenge(gates, by, off=-off))
        if (by, key) == (op, LANDING):
            gates.check(proof, key)
        else:
            assert gates.reason(proof, key) in ("expired", "clock")


def test_what_moves_it_is_given_no_challenge(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    answers = challenge(gates, op)
    for key in (ARM, PING):
        with pytest.raises(Forbidden) as e:
            gates.check(gates.proof(op, key, now=gates.utc + HOUR), key)
        assert e.value.detail["reason"] == "clock" and "challenge" not in e.value.detail
        assert gates.reason(gates.proof(op, key, now=gates.utc + HOUR, answers=answers), key) == "clock"


@pytest.mark.parametrize("key", [LANDING, ARM])
def test_what_was_refused_as_early_is_not_good_when_its_time_comes(gates: GateBench, key: str) -> None:
    """Anyone who relays has it, and could play it an hour later."""
    op = gates.authority.member("op", "operator")
    early = gates.proof(op, key, now=gates.utc + HOUR)
    assert gates.reason(early, key) == "clock"
    gates.utc += HOUR
    gates.now += HOUR
    assert gates.reason(early, key) == "epoch"


def test_what_was_refused_as_late_is_never_good(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    late = gates.proof(op, LANDING, now=gates.utc - HOUR)
    assert gates.reason(late, LANDING) == "clock"
    gates.utc -= HOUR  # the vehicle's clock is set back
    assert gates.reason(late, LANDING) == "epoch"


def test_nobody_without_a_say_voids_proofs(gates: GateBench) -> None:
    epoch = gates.gate.epoch
    eye, op = gates.authority.member("eye", "viewer"), gates.authority.member("op", "operator")
    gates.reason(gates.proof(eye, now=gates.utc + HOUR))
    forged = bytearray(gates.proof(op, now=gates.utc + HOUR))
    forged[40] ^= 1
    gates.reason(bytes(forged))
    other = gates.authority.member("quad2", "vehicle")  # relays, and orders nothing of us
    gates.reason(gates.proof(other, LANDING, now=gates.utc + HOUR), LANDING)
    assert gates.gate.epoch == epoch


def test_a_challenge_makes_nobody_an_operator(gates: GateBench, authority: Authority) -> None:
    eye, revoked = authority.member("eye", "viewer"), authority.member("out", "operator")
    gates.check(gates.proof(revoked))
    assert gates.reason(gates.proof(eye, LANDING, answers=challenge(gates, eye)), LANDING) == "role"
    authority.revoked = [revoked.certificate.fingerprint.hex()]
    gates.gate.roster = read_signed(authority.roster()).open(authority.certificate, "demo")
    assert gates.reason(gates.proof(revoked, LANDING, answers=challenge(gates, revoked)), LANDING) == "revoked"


@pytest.mark.parametrize("off", [HOUR, -HOUR])
async def test_a_vehicle_whose_clock_is_off_takes_what_makes_safe(guarded: StartGuarded, off: float) -> None:
    g: Guarded = await guarded()
    assert g.vehicle.gate is not None
    await g.b.flying()
    async with g.client("op", "operator") as z:
        vehicle = z.vehicle("quad1")
        g.vehicle.gate.utc = lambda: time.time() + off
        with pytest.raises(Forbidden, match="set the clock that is off"):
            await vehicle.set_mode("STABILIZE")
        await vehicle.order("hold", wire.Order())
        landing = asyncio.create_task(vehicle.land())
        await g.b.peer.until(lambda: g.b.peer.mode == LAND, "the landing")
        g.b.peer.armed = False
        await landing
        g.vehicle.gate.utc = time.time
        await vehicle.set_mode("GUIDED")
    assert g.b.peer.mode == GUIDED


async def test_who_halts_it_with_a_clock_that_is_ahead_moves_it_when_that_is_right(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    await g.b.flying()
    op, hold, mode = g.authority.member("op", "operator"), g.key(verb="hold"), g.key(verb="set_mode")
    early = time.time() + HOUR
    with pytest.raises(Forbidden) as e:
        await g.ask(g.proof(op, hold, b"{}", now=early), key=hold)
    answers = bytes.fromhex(str(e.value.detail["challenge"]))
    await g.ask(g.proof(op, hold, b"{}", now=early, answers=answers), key=hold)
    order = b'{"mode": "STABILIZE"}'
    await g.ask(g.proof(op, mode, order), order, mode)
    assert g.b.peer.mode == STABILIZE


@pytest.mark.parametrize("off", [HOUR, -HOUR])
async def test_a_vehicle_whose_clock_was_set_is_believed_again(guarded: StartGuarded, off: float) -> None:
    """It answers a challenge with its time; what was recorded before stays unbelieved."""
    g: Guarded = await guarded()
    recorded: list[tuple[str, bytes, bytes]] = []

    def record(sample: object) -> None:
        recorded.append((str(sample.key_expr), sample.payload.to_bytes(), sample.attachment.to_bytes()))  # type: ignore[attr-defined]

    tap = g.b.ground.session.declare_subscriber("zmav/demo/quad1/state", record)
    async with g.client("eye", "viewer") as z:
        assert z.member is not None
        while not recorded:
            await z.news(1.0)
        tap.undeclare()
        z.member.verifier.utc = lambda: time.time() + off
        g.b.peer.mode = GUIDED
        await z.vehicle("quad1").wait_until(lambda s: s.mode == "GUIDED", 30.0)
        assert z.member.counts["clock"] >= 1
        key, payload, attachment = recorded[0]
        before = z.member.counts["replayed"]
        g.b.ground.session.put(key, payload, attachment=attachment)
        while z.member.counts["replayed"] == before:
            await z.news(1.0)
        assert z.vehicle("quad1").state.mode == "GUIDED"
        z.member.verifier.utc = time.time
        g.b.peer.mode = STABILIZE
        await z.vehicle("quad1").wait_until(lambda s: s.mode == "STABILIZE", 30.0)


def test_the_window_is_longer_than_a_challenge_is_good() -> None:
    """Who answers one a second time is known by his nonce."""
    assert 2 * CHALLENGED <= 2 * WINDOW
