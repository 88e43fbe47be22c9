"""The gate by itself, with clocks of the test's own: each reason for a refusal, and what a flood may cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest

from tests.trust.conftest import Authority
from zmav.errors import Forbidden
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.gate import Gate, Origin, ProofRefused
from zmav.trust.proof import ANSWERED, MOST, UNINTRODUCED, WINDOW, Proof, Signer
from zmav.trust.roster import read_signed
from zmav.trust.seal import TAG
from zmav.trust.verify import FORGERIES, STRANGERS

PING, ARM, SET, LAND = (f"zmav/demo/quad1/do/{verb}" for verb in ("ping", "arm", "param_set", "land"))


@dataclass
class GateBench:
    """A gate, and clocks that stand still."""

    authority: Authority
    utc: float = 0.0
    now: float = 1000.0
    refused: list[Forbidden] = field(default_factory=list)

    def __post_init__(self) -> None:
        own = self.own = self.authority.member("quad1", "vehicle")
        self.utc = own.certificate.not_after - 43200.0
        self.gate = Gate(own, lambda: self.utc, lambda: self.now)
        self.gate.bus.on(ProofRefused, lambda told: self.refused.append(told.error))

    def proof(self, by: Credentials, key: str = PING, payload: bytes = b"{}", **more: Any) -> bytes:
        given = {"introduce": True, "answers": self.gate.epoch, "now": self.utc, **more}
        return Signer(by).sign(key, payload, **given)

    def check(self, attachment: bytes | None, key: str = PING, payload: bytes = b"{}") -> Origin:
        return self.gate.check(key, payload, attachment)

    def reason(self, attachment: bytes | None, key: str = PING, payload: bytes = b"{}") -> str:
        """Why it is refused; it is counted and told, too."""
        with pytest.raises(Forbidden) as e:
            self.check(attachment, key, payload)
        assert self.refused[-1] is e.value
        reason = str(e.value.detail["reason"])
        assert self.gate.counts[reason] == sum(r.detail["reason"] == reason for r in self.refused)
        return reason


@pytest.fixture
def gates(authority: Authority) -> GateBench:
    return GateBench(authority)


def test_who_it_is_from(gates: GateBench) -> None:
    assert gates.check(gates.proof(gates.authority.member("op", "operator"))) == Origin("op", Role.OPERATOR)
    own = Credentials.load(gates.authority.folder / "quad1")
    assert gates.check(gates.proof(own, ARM), ARM) == Origin("quad1", Role.VEHICLE)
    assert (gates.refused, gates.gate.counts) == ([], {})


def test_no_proof_and_none_of_ours(gates: GateBench) -> None:
    good = gates.proof(gates.authority.member("op", "operator"))
    assert gates.reason(None) == "unsigned"
    for data in (b"", b"{}", good[:97], b"\0" + good[1:], bytes([1, 2]) + good[2:], good + b" " * MOST, bytes(100_000)):
        assert gates.reason(data) == "malformed"
    gates.check(good)


def test_another_key_or_payload(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    assert gates.reason(gates.proof(op), ARM) == "signature"
    assert gates.reason(gates.proof(op), PING.replace("quad1", "quad2")) == "signature"
    assert gates.reason(gates.proof(op), payload=b"{ }") == "signature"


def test_each_proof_is_good_once(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    proof = gates.proof(op)
    gates.check(proof)
    assert gates.reason(proof) == "replayed"
    gates.check(gates.proof(op))
    gates.utc += WINDOW - 1.0
    gates.now += WINDOW - 1.0
    assert gates.reason(proof) == "replayed"
    gates.utc += 2.0
    gates.now += 2.0
    assert gates.reason(proof) == "clock"


def test_one_from_the_future_is_remembered_for_as_long_as_it_is_good(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    proof = gates.proof(op, now=gates.utc + WINDOW - 0.1)
    gates.check(proof)
    for _ in range(6):
        gates.utc += WINDOW / 3 - 0.1
        gates.now += WINDOW / 3 - 0.1
        gates.check(gates.proof(op))
        assert gates.reason(proof) == "replayed"


@pytest.mark.parametrize(("offset", "words"), [(-31.5, "31.5 s old"), (31.5, "31.5 s ahead"), (-4e8, "s old")])
def test_old_and_future(gates: GateBench, offset: float, words: str) -> None:
    op = gates.authority.member("op", "operator")
    gates.check(gates.proof(op, now=gates.utc + (29.0 if offset > 0 else -29.0)))
    assert gates.reason(gates.proof(op, now=gates.utc + offset)) == "clock"
    assert words in gates.refused[-1].message
    assert gates.refused[-1].detail["offset"] == pytest.approx(offset, abs=0.11)


def test_what_an_earlier_start_was_told_is_not_told_again(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    earlier = gates.proof(op, ARM)
    gates.check(earlier, ARM)
    again = Gate(Credentials.load(gates.authority.folder / "quad1"), lambda: gates.utc, lambda: gates.now)
    with pytest.raises(Forbidden, match="not for this start of quad1's agent") as e:
        again.check(ARM, b"{}", earlier)
    assert e.value.detail == {"reason": "epoch", "gate": again.epoch.hex()}
    again.check(ARM, b"{}", gates.proof(op, ARM, answers=again.epoch))


def test_certificates_that_are_not_believed(gates: GateBench, tmp_path_factory: pytest.TempPathFactory) -> None:
    rogue = Authority(tmp_path_factory.mktemp("rogue"))
    unknown = rogue.member("op", "operator")
    foreign = gates.authority.strange("foreign", "operator", fleet="other")
    late = gates.authority.strange("late", "operator", ends=-60.0)
    early = gates.authority.strange("early", "operator", begins=80_000.0)
    assert gates.reason(gates.proof(unknown)) == "stranger"
    assert gates.reason(gates.proof(foreign)) == "fleet"
    assert gates.reason(gates.proof(late)) == "expired"
    assert gates.reason(gates.proof(early)) == "expired"
    assert not any(gates.gate.known(member.certificate.fingerprint) for member in (unknown, foreign, late, early))


def test_it_ends_while_it_is_known(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    gates.check(gates.proof(op))
    gates.utc = op.certificate.not_after + 1.0
    assert gates.reason(gates.proof(op)) == "expired"
    assert "renew it with 'zmav mesh ca renew'" in gates.refused[-1].message


def test_another_members_certificate_beside_ones_own_signature(gates: GateBench) -> None:
    op, viewer = gates.authority.member("op", "operator"), gates.authority.member("eye", "viewer")
    stolen = Credentials(viewer.folder, viewer.authority, op.certificate, viewer.key, viewer.roster)
    assert gates.reason(gates.proof(stolen)) == "signature"
    mixed = gates.proof(viewer, introduce=False)
    assert gates.reason(bytes([1, 1]) + mixed[2:] + op.certificate.der) == "malformed"


def test_a_newer_roster_turns_a_member_out_at_once(gates: GateBench) -> None:
    op, other = gates.authority.member("op", "operator"), gates.authority.member("op2", "operator")
    gates.check(gates.proof(op))
    gates.authority.revoked.append(op.certificate.fingerprint.hex())
    newer = read_signed(gates.authority.roster()).open(gates.authority.certificate, "demo")
    gates.gate.roster = newer
    assert gates.reason(gates.proof(op)) == "revoked"
    gates.check(gates.proof(other))
    older = op.roster
    assert older.number < newer.number
    gates.gate.roster = older
    assert gates.gate.roster is newer
    assert gates.reason(gates.proof(op)) == "revoked"


def test_roles(gates: GateBench) -> None:
    planner, viewer = gates.authority.member("swap", "planner"), gates.authority.member("eye", "viewer")
    quad2 = gates.authority.member("quad2", "vehicle")
    gates.check(gates.proof(planner, ARM), ARM)
    gates.check(gates.proof(viewer))
    for by, key, who in (
        (planner, SET, "swap (planner)"),
        (viewer, ARM, "eye (viewer)"),
        (quad2, ARM, "quad2 (vehicle)"),
    ):
        assert gates.reason(gates.proof(by, key), key) == "role"
        assert who in gates.refused[-1].message
    assert "allowed: operator" in gates.refused[0].message


def test_a_certificate_is_brought_once(gates: GateBench) -> None:
    op = gates.authority.member("op", "operator")
    assert gates.reason(gates.proof(op, introduce=False)) == "unknown"
    gates.check(gates.proof(op))
    gates.check(gates.proof(op, introduce=False))


def test_forgeries_in_a_known_name_cost_so_many_checks_a_second(
    gates: GateBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    op, other = gates.authority.member("op", "operator"), gates.authority.member("op2", "operator")
    gates.check(gates.proof(op))
    checked = 0
    is_of = Proof.is_of

    def counted(self: Proof, *what: Any) -> bool:
        nonlocal checked
        checked += 1
        return is_of(self, *what)

    monkeypatch.setattr(Proof, "is_of", counted)
    forged = gates.proof(op, ARM)
    flood = int(FORGERIES) + 200
    reasons = [gates.reason(forged) for _ in range(flood)]
    assert checked == FORGERIES
    assert reasons.count("busy") == 200
    gates.check(gates.proof(other))
    assert gates.reason(gates.proof(op)) == "busy"
    gates.now += 0.1
    gates.check(gates.proof(op))


def test_who_forges_a_members_name_shuts_out_no_order_with_its_tag(gates: GateBench) -> None:
    op, own = gates.authority.member("op", "operator"), gates.own
    gates.check(gates.proof(op))
    overheard = gates.proof(op, LAND, to=own.certificate)
    other = gates.proof(gates.authority.member("op2", "operator"), LAND, to=own.certificate)
    forged = gates.proof(op, ARM)  # for another key than it is put on
    tag = other[UNINTRODUCED : UNINTRODUCED + TAG]
    flood = [forged, overheard, overheard[:UNINTRODUCED] + tag + overheard[UNINTRODUCED + TAG :], forged[:-1] + b"x"]
    reasons = {gates.reason(flood[number % 4]) for number in range(4 * int(FORGERIES))}
    assert reasons == {"signature", "busy"}
    assert gates.reason(gates.proof(op)) == "busy"
    for key in (LAND, ARM):
        gates.check(gates.proof(op, key, to=own.certificate), key)
    gates.check(overheard, LAND)


def test_an_answer_is_never_an_order_nor_an_order_an_answer(gates: GateBench) -> None:
    """An operator's program answers where it could order: anyone who chose its challenge has it sign no order."""
    op, asked = gates.authority.member("op", "operator"), gates.gate.epoch
    answer, order = gates.proof(op, LAND, context=ANSWERED), gates.proof(op, LAND)
    assert gates.reason(answer, LAND) == "signature"
    with pytest.raises(Forbidden, match="the signature is not op's"):
        gates.gate.verify_answer(LAND, b"{}", order, asked)
    gates.check(order, LAND)
    assert gates.gate.verify_answer(LAND, b"{}", answer, asked)[1].name == "op"


def test_strangers_cost_so_many_checks_a_second_and_shut_no_member_out(
    gates: GateBench, tmp_path_factory: pytest.TempPathFactory
) -> None:
    rogue = Authority(tmp_path_factory.mktemp("rogue")).member("op", "operator")
    reasons = [gates.reason(gates.proof(rogue)) for _ in range(int(STRANGERS) + 30)]
    assert (reasons.count("stranger"), reasons.count("busy")) == (STRANGERS, 30)
    op = gates.authority.member("op", "operator")
    assert gates.reason(gates.proof(op)) == "busy"  # it is not on the roster that the vehicle has
    member = {"name": "op", "role": "operator", "fingerprint": op.certificate.fingerprint.hex(), "not_after": 0.0}
    gates.authority.members.append(member)
    gates.gate.roster = read_signed(gates.authority.roster()).open(gates.authority.certificate, "demo")
    gates.check(gates.proof(op))


def test_certificates_are_remembered_up_to_a_number(gates: GateBench) -> None:
    assert gates.gate.most_known > 100
    gates.gate.most_known = 3
    members = [gates.authority.member(f"op{n}", "operator") for n in range(5)]
    for one in members:
        gates.check(gates.proof(one))
    assert [gates.gate.known(one.certificate.fingerprint) is not None for one in members] == [False] * 2 + [True] * 3
    assert gates.reason(gates.proof(members[0], introduce=False)) == "unknown"


def test_proofs_are_remembered_up_to_a_number(gates: GateBench) -> None:
    gates.gate.most_used = 3
    op, other = gates.authority.member("op", "operator"), gates.authority.member("op2", "operator")
    for _ in range(3):
        gates.check(gates.proof(op))
    assert gates.reason(gates.proof(op)) == "busy"
    gates.check(gates.proof(other))
    gates.utc += 2 * WINDOW + 6.0
    gates.now += 2 * WINDOW + 6.0
    for _ in range(3):  # those before are forgotten
        gates.check(gates.proof(op))
    assert gates.reason(gates.proof(op)) == "busy"


def test_a_members_own_frames_leave_its_panic_orders_room(gates: GateBench) -> None:
    gates.gate.most_used = 3
    op, frame, land = (
        gates.authority.member("op", "operator"),
        "zmav/demo/quad1/mav/tx/1/1/PING",
        "zmav/demo/quad1/do/land",
    )
    for _ in range(3):
        gates.check(gates.proof(op, frame), frame)
    assert gates.reason(gates.proof(op, frame), key=frame) == "busy"
    proof = gates.proof(op, land)
    gates.check(proof, land)
    assert gates.reason(proof, key=land) == "replayed"


@pytest.mark.parametrize(("back", "reason"), [(3.0, "replayed"), (3600.0, "epoch")])
def test_what_was_heard_is_worth_nothing_again_when_the_clock_is_set_back(
    gates: GateBench, back: float, reason: str
) -> None:
    op = gates.authority.member("op", "operator")
    heard = gates.proof(op, now=gates.utc + WINDOW)
    gates.check(heard)
    gates.now += back + 2 * WINDOW
    gates.utc += 2 * WINDOW
    assert gates.reason(heard) == reason
    gates.check(gates.proof(op))


def test_a_revocation_of_nothing_turns_nobody_out(gates: GateBench) -> None:
    gates.authority.revoked.append("not hexadecimal")
    gates.gate.roster = read_signed(gates.authority.roster()).open(gates.authority.certificate, "demo")
    gates.check(gates.proof(gates.authority.member("op", "operator")))
