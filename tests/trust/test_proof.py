"""The attachment: what is in it, and that nothing in it, or beside it, can be changed."""

from __future__ import annotations

import struct
import time
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.trust.conftest import Authority
from zmav.errors import Forbidden
from zmav.trust import proof
from zmav.trust.certificate import fingerprint
from zmav.trust.credentials import Credentials
from zmav.trust.proof import Signer
from zmav.trust.verify import Verifier

KEY, PAYLOAD = "zmav/demo/quad1/do/ping", b'{"id": "x"}'


class Signed(NamedTuple):
    by: Credentials
    verifier: Verifier
    attachment: bytes


@pytest.fixture
def signed(authority: Authority) -> Signed:
    by = authority.member("op", "operator")
    return Signed(by, Verifier.of(by), Signer(by).sign(KEY, PAYLOAD, introduce=True))


def test_what_is_in_it(signed: Signed) -> None:
    version, flags, micros, nonce, name, answers = struct.unpack_from(">BBQ8s8s8s", signed.attachment)
    assert (version, flags, answers) == (1, 1, bytes(8))
    assert abs(micros / 1e6 - time.time()) < 10.0
    assert name == signed.by.certificate.fingerprint
    assert signed.attachment[98:] == signed.by.certificate.der
    assert len(signed.attachment) < 700
    again = Signer(signed.by).sign(KEY, PAYLOAD)
    assert len(again) == 98
    assert again[10:18] != nonce


def test_its_times_go_on_where_the_clock_goes_back(signed: Signed, monkeypatch: pytest.MonkeyPatch) -> None:
    signer, clock = Signer(signed.by), iter((1e9, 1e9, 1e9 - 50.0, 1e9 + 1.0, 1e9 - 3600.0, 1e9 - 3599.0))
    monkeypatch.setattr(time, "time", lambda: next(clock))
    times = [proof.read(signer.sign(KEY, PAYLOAD)).t for _ in range(6)]
    assert times[:4] == sorted(set(times[:4]))
    assert times[3:] == [1e9 + 1.0, 1e9 - 3600.0, 1e9 - 3599.0]


def test_it_says_who(signed: Signed) -> None:
    found, certificate = signed.verifier.verify(KEY, PAYLOAD, signed.attachment)
    assert (certificate.name, certificate.role.value) == ("op", "operator")
    assert abs(found.t - time.time()) < 10.0


def test_nothing_can_be_changed(signed: Signed) -> None:
    signed.verifier.verify(KEY, PAYLOAD, signed.attachment)
    for at in range(98):
        changed = bytearray(signed.attachment)
        changed[at] ^= 1
        with pytest.raises(Forbidden):
            signed.verifier.verify(KEY, PAYLOAD, bytes(changed))
    for key, payload in (
        ("zmav/demo/quad2/do/ping", PAYLOAD),
        ("zmav/demo/quad1/do/arm", PAYLOAD),
        (KEY, b""),
        (KEY, PAYLOAD + b" "),
        (KEY[:-1], b"g" + PAYLOAD),
    ):
        with pytest.raises(Forbidden) as e:
            signed.verifier.verify(key, payload, signed.attachment)
        assert e.value.detail["reason"] == "signature"


def test_every_cut_of_it_is_refused(signed: Signed) -> None:
    for length in range(len(signed.attachment)):
        with pytest.raises(Forbidden):
            Verifier.of(signed.by).verify(KEY, PAYLOAD, signed.attachment[:length])


@pytest.fixture(scope="module")
def verifier(tmp_path_factory: pytest.TempPathFactory) -> Verifier:
    return Verifier.of(Authority(tmp_path_factory.mktemp("authority")).member("op", "operator"))


@given(der=st.binary(min_size=1, max_size=500), rest=st.binary(min_size=96, max_size=96))
def test_any_certificate_is_refused(verifier: Verifier, der: bytes, rest: bytes) -> None:
    """The hard way in: a well-formed proof that names the certificate it brings."""
    found = proof.read(bytes([1, 1]) + rest[:16] + fingerprint(der) + rest[24:] + der)
    assert (found.certificate, found.fingerprint) == (der, fingerprint(der))
    with pytest.raises(Forbidden) as e:
        verifier.learn(found.certificate)
    assert e.value.detail["reason"] == "stranger"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Signed:
    by = Authority(tmp_path_factory.mktemp("whole")).member("op", "operator")
    verifier = Verifier.of(by)
    verifier.learn(by.certificate.der)
    return Signed(by, verifier, b"")


@given(st.data())
def test_no_change_of_a_certificate_is_believed(whole: Signed, data: st.DataObject) -> None:
    good = whole.by.certificate.der
    at = data.draw(st.integers(0, len(good) - 1))
    changed = bytearray(good)
    changed[at] = data.draw(st.integers(0, 255).filter(lambda byte: byte != good[at]))
    with pytest.raises(Forbidden) as e:
        whole.verifier.learn(bytes(changed))
    assert e.value.detail["reason"] == "stranger"
