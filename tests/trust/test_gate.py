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
class Desk:
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
def desk(authority: Authority) -> Desk:
    return Desk(authority)


def test_who_it_is_from(desk: Desk) -> None:
    assert desk.check(desk.proof(desk.authority.member("op", "operator"))) == Origin("op", Role.OPERATOR)
    own = Credentials.load(desk.authority.folder / "quad1")
    assert desk.check(desk.proof(own, ARM), ARM) == Origin("quad1", Role.VEHICLE)
    assert (desk.refused, desk.gate.counts) == ([], {})


def test_no_proof_and_none_of_ours(desk: Desk) -> None:
    good = desk.proof(desk.authority.member("op", "operator"))
    assert desk.reason(None) == "unsigned"
    for data in (b"", b"{}", good[:97], b"\0" + good[1:], bytes([1, 2]) + good[2:], good + b" " * MOST, bytes(100_000)):
        assert desk.reason(data) == "malformed"
    desk.check(good)


def test_another_key_or_payload(desk: Desk) -> None:
    op = desk.authority.member("op", "operator")
    assert desk.reason(desk.proof(op), ARM) == "signature"
    assert desk.reason(desk.proof(op), PING.replace("quad1", "quad2")) == "signature"
    assert desk.reason(desk.proof(op), payload=b"{ }") == "signature"


def test_each_proof_is_good_once(desk: Desk) -> None:
    op = desk.authority.member("op", "operator")
    proof = desk.proof(op)
    desk.check(proof)
    assert desk.reason(proof) == "replayed"
    desk.check(desk.proof(op))
    desk.utc += WINDOW - 1.0
    desk.now += WINDOW - 1.0
    assert desk.reason(proof) == "replayed"
    desk.utc += 2.0
    desk.now += 2.0
    assert desk.reason(proof) == "clock"


def test_one_from_the_future_is_remembered_for_as_long_as_it_is_good(desk: Desk) -> None:
    op = desk.authority.member("op", "operator")
    proof = desk.proof(op, now=desk.utc + WINDOW - 0.1)
    desk.check(proof)
    for _ in range(6):
        desk.utc += WINDOW / 3 - 0.1
        desk.now += WINDOW / 3 - 0.1
        desk.check(desk.proof(op))
        assert desk.reason(proof) == "replayed"


@pytest.mark.parametrize(("offset", "words"), [(-31.5, "31.5 s old"), (31.5, "31.5 s ahead"), (-4e8, "s old")])
def test_old_and_future(desk: Desk, offset: float, words: str) -> None:
    op = desk.authority.member("op", "operator")
    desk.check(desk.proof(op, now=desk.utc + (29.0 if offset > 0 else -29.0)))
    assert desk.reason(desk.proof(op, now=desk.utc + offset)) == "clock"
    assert words in desk.refused[-1].message
    assert desk.refused[-1].detail["offset"] == pytest.approx(offset, abs=0.11)


def test_what_an_earlier_start_was_told_is_not_told_again(desk: Desk) -> None:
    op = desk.authority.member("op", "operator")
    earlier = desk.proof(op, ARM)
    desk.check(earlier, ARM)
    again = Gate(Credentials.load(desk.authority.folder / "quad1"), lambda: desk.utc, lambda: desk.now)
    with pytest.raises(Forbidden, match="not for this start of quad1's agent") as e:
        again.check(ARM, b"{}", earlier)
    assert e.value.detail == {"reason": "epoch", "gate": again.epoch.hex()}
    again.check(ARM, b"{}", desk.proof(op, ARM, answers=again.epoch))


def test_certificates_that_are_not_believed(desk: Desk, tmp_path_factory: pytest.TempPathFactory) -> None:
    rogue = Authority(tmp_path_factory.mktemp("rogue"))
    unknown = rogue.member("op", "operator")
    foreign = desk.authority.strange("foreign", "operator", fleet="other")
    late = desk.authority.strange("late", "operator", ends=-60.0)
    early = desk.authority.strange("early", "operator", begins=80_000.0)
    assert desk.reason(desk.proof(unknown)) == "stranger"
    assert desk.reason(desk.proof(foreign)) == "fleet"
    assert desk.reason(desk.proof(late)) == "expired"
    assert desk.reason(desk.proof(early)) == "expired"
    assert not any(desk.gate.known(member.certificate.fingerprint) for member in (unknown, foreign, late, early))


def test_it_ends_while_it_is_known(desk: Desk) -> None:
    op = desk.authority.member("op", "operator")
    desk.check(desk.proof(op))
    desk.utc = op.certificate.not_after + 1.0
    assert desk.reason(desk.proof(op)) == "expired"
    assert "renew it with 'zmav mesh ca renew'" in desk.refused[-1].message


def test_another_members_certificate_beside_ones_own_signature(desk: Desk) -> None:
    op, viewer = desk.authority.member("op", "operator"), desk.authority.member("eye", "viewer")
    stolen = Credentials(viewer.folder, viewer.authority, op.certificate, viewer.key, viewer.roster)
    assert desk.reason(desk.proof(stolen)) == "signature"
    mixed = desk.proof(viewer, introduce=False)
    assert desk.reason(bytes([1, 1]) + mixed[2:] + op.certificate.der) == "malformed"


def test_a_newer_roster_turns_a_member_out_at_once(desk: Desk) -> None:
    op, other = desk.authority.member("op", "operator"), desk.authority.member("op2", "operator")
    desk.check(desk.proof(op))
    desk.authority.revoked.append(op.certificate.fingerprint.hex())
    newer = read_signed(desk.authority.roster()).open(desk.authority.certificate, "demo")
    desk.gate.roster = newer
    assert desk.reason(desk.proof(op)) == "revoked"
    desk.check(desk.proof(other))
    older = op.roster
    assert older.number < newer.number
    desk.gate.roster = older
    assert desk.gate.roster is newer
    assert desk.reason(desk.proof(op)) == "revoked"


def test_roles(desk: Desk) -> None:
    planner, viewer = desk.authority.member("swap", "planner"), desk.authority.member("eye", "viewer")
    quad2 = desk.authority.member("quad2", "vehicle")
    desk.check(desk.proof(planner, ARM), ARM)
    desk.check(desk.proof(viewer))
    for by, key, who in (
        (planner, SET, "swap (planner)"),
        (viewer, ARM, "eye (viewer)"),
        (quad2, ARM, "quad2 (vehicle)"),
    ):
        assert desk.reason(desk.proof(by, key), key) == "role"
        assert who in desk.refused[-1].message
    assert "allowed: operator" in desk.refused[0].message


def test_a_certificate_is_brought_once(desk: Desk) -> None:
    op = desk.authority.member("op", "operator")
    assert desk.reason(desk.proof(op, introduce=False)) == "unknown"
    desk.check(desk.proof(op))
    desk.check(desk.proof(op, introduce=False))


def test_forgeries_in_a_known_name_cost_so_many_checks_a_second(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    op, other = desk.authority.member("op", "operator"), desk.authority.member("op2", "operator")
    desk.check(desk.proof(op))
    checked = 0
    is_of = Proof.is_of

    def counted(self: Proof, *what: Any) -> bool:
        nonlocal checked
        checked += 1
        return is_of(self, *what)

    monkeypatch.setattr(Proof, "is_of", counted)
    forged = desk.proof(op, ARM)
    flood = int(FORGERIES) + 200
    reasons = [desk.reason(forged) for _ in range(flood)]
    assert checked == FORGERIES
    assert reasons.count("busy") == 200
    desk.check(desk.proof(other))
    assert desk.reason(desk.proof(op)) == "busy"
    desk.now += 0.1
    desk.check(desk.proof(op))


def test_who_forges_a_members_name_shuts_out_no_order_with_its_tag(desk: Desk) -> None:
    op, own = desk.authority.member("op", "operator"), desk.own
    desk.check(desk.proof(op))
    overheard = desk.proof(op, LAND, to=own.certificate)
    other = desk.proof(desk.authority.member("op2", "operator"), LAND, to=own.certificate)
    forged = desk.proof(op, ARM)  # for another key than it is put on
    tag = other[UNINTRODUCED : UNINTRODUCED + TAG]
    flood = [forged, overheard, overheard[:UNINTRODUCED] + tag + overheard[UNINTRODUCED + TAG :], forged[:-1] + b"x"]
    reasons = {desk.reason(flood[number % 4]) for number in range(4 * int(FORGERIES))}
    assert reasons == {"signature", "busy"}
    assert desk.reason(desk.proof(op)) == "busy"
    for key in (LAND, ARM):
        desk.check(desk.proof(op, key, to=own.certificate), key)
    desk.check(overheard, LAND)


def test_an_answer_is_never_an_order_nor_an_order_an_answer(desk: Desk) -> None:
    """An operator's program answers where it could order: anyone who chose its challenge has it sign no order."""
    op, asked = desk.authority.member("op", "operator"), desk.gate.epoch
    answer, order = desk.proof(op, LAND, context=ANSWERED), desk.proof(op, LAND)
    assert desk.reason(answer, LAND) == "signature"
    with pytest.raises(Forbidden, match="the signature is not op's"):
        desk.gate.verify_answer(LAND, b"{}", order, asked)
    desk.check(order, LAND)
    assert desk.gate.verify_answer(LAND, b"{}", answer, asked)[1].name == "op"


def test_strangers_cost_so_many_checks_a_second_and_shut_no_member_out(
    desk: Desk, tmp_path_factory: pytest.TempPathFactory
) -> None:
    rogue = Authority(tmp_path_factory.mktemp("rogue")).member("op", "operator")
    reasons = [desk.reason(desk.proof(rogue)) for _ in range(int(STRANGERS) + 30)]
    assert (reasons.count("stranger"), reasons.count("busy")) == (STRANGERS, 30)
    op = desk.authority.member("op", "operator")
    assert desk.reason(desk.proof(op)) == "busy"  # it is not on the roster that the vehicle has
    member = {"name": "op", "role": "operator", "fingerprint": op.certificate.fingerprint.hex(), "not_after": 0.0}
    desk.authority.members.append(member)
    desk.gate.roster = read_signed(desk.authority.roster()).open(desk.authority.certificate, "demo")
    desk.check(desk.proof(op))


def test_certificates_are_remembered_up_to_a_number(desk: Desk) -> None:
    assert desk.gate.most_known > 100
    desk.gate.most_known = 3
    members = [desk.authority.member(f"op{n}", "operator") for n in range(5)]
    for one in members:
        desk.check(desk.proof(one))
    assert [desk.gate.known(one.certificate.fingerprint) is not None for one in members] == [False] * 2 + [True] * 3
    assert desk.reason(desk.proof(members[0], introduce=False)) == "unknown"


def test_proofs_are_remembered_up_to_a_number(desk: Desk) -> None:
    desk.gate.most_used = 3
    op, other = desk.authority.member("op", "operator"), desk.authority.member("op2", "operator")
    for _ in range(3):
        desk.check(desk.proof(op))
    assert desk.reason(desk.proof(op)) == "busy"
    desk.check(desk.proof(other))
    desk.utc += 2 * WINDOW + 6.0
    desk.now += 2 * WINDOW + 6.0
    for _ in range(3):  # those before are forgotten
        desk.check(desk.proof(op))
    assert desk.reason(desk.proof(op)) == "busy"


def test_a_members_own_frames_leave_its_panic_orders_room(desk: Desk) -> None:
    desk.gate.most_used = 3
    op, frame, land = (
        desk.authority.member("op", "operator"),
        "zmav/demo/quad1/mav/tx/1/1/PING",
        "zmav/demo/quad1/do/land",
    )
    for _ in range(3):
        desk.check(desk.proof(op, frame), frame)
    assert desk.reason(desk.proof(op, frame), key=frame) == "busy"
    proof = desk.proof(op, land)
    desk.check(proof, land)
    assert desk.reason(proof, key=land) == "replayed"


@pytest.mark.parametrize(("back", "reason"), [(3.0, "replayed"), (3600.0, "epoch")])
def test_what_was_heard_is_worth_nothing_again_when_the_clock_is_set_back(desk: Desk, back: float, reason: str) -> None:
    op = desk.authority.member("op", "operator")
    heard = desk.proof(op, now=desk.utc + WINDOW)
    desk.check(heard)
    desk.now += back + 2 * WINDOW
    desk.utc += 2 * WINDOW
    assert desk.reason(heard) == reason
    desk.check(desk.proof(op))


def test_a_revocation_of_nothing_turns_nobody_out(desk: Desk) -> None:
    desk.authority.revoked.append("not hexadecimal")
    desk.gate.roster = read_signed(desk.authority.roster()).open(desk.authority.certificate, "demo")
    desk.check(desk.proof(desk.authority.member("op", "operator")))
