"""A service's folder of credentials is not its own to write: what it learns is kept in its state directory."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.config import Signing
from zmav.errors import BadConfig
from zmav.mavlink import Packer, load_dialect
from zmav.mavlink.signing import new_key, write_key
from zmav.onboard import Onboard, OnboardSettings
from zmav.trust.credentials import Credentials, roster_place

if TYPE_CHECKING:
    from tests.conftest import Net
    from tests.trust.conftest import Authority


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """As systemd says it to a service."""
    folder = tmp_path / "state"
    folder.mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", f"{folder}:/elsewhere")
    return folder


def test_the_newer_roster_counts_wherever_it_is(authority: Authority, state: Path) -> None:
    folder = authority.issue("quad1", "vehicle")
    kept = roster_place(folder)
    assert kept == state / "roster.json"
    first = Credentials.load(folder).roster.number
    kept.write_bytes(authority.roster())
    assert Credentials.load(folder).roster.number == first + 1
    (folder / "roster.json").write_bytes(authority.roster())
    assert Credentials.load(folder).roster.number == first + 2, "new credentials were carried here"


def test_what_is_kept_of_another_authority_or_is_no_roster_is_passed_over(
    authority: Authority, state: Path, tmp_path: Path
) -> None:
    folder = authority.issue("quad1", "vehicle")
    number = Credentials.load(folder).roster.number
    other = type(authority)(tmp_path / "other")
    other.number = 100
    for data in (other.roster(), b"{}", b""):
        roster_place(folder).write_bytes(data)
        assert Credentials.load(folder).roster.number == number
    (folder / "roster.json").write_bytes(other.roster())
    with pytest.raises(BadConfig):
        Credentials.load(folder)


def test_outside_a_service_it_is_the_folder_s_own(authority: Authority, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    folder = authority.issue("quad1", "vehicle")
    assert roster_place(folder) == folder / "roster.json"


def test_the_last_timestamp_of_a_signing_key_is_kept_there(state: Path, tmp_path: Path, net: Net) -> None:
    key = tmp_path / "quad1.key"
    write_key(key, new_key())
    settings = OnboardSettings(link="udpin:127.0.0.1:0", name="quad1", signing=Signing(key_file=str(key)))
    signing = Onboard(net.router()[0], settings).adapter.signing
    assert signing is not None
    with contextlib.closing(signing):
        signing.sign(Packer(load_dialect(), 1, 1).pack("HEARTBEAT", type=18))
    assert (state / "quad1.time").is_file() and not key.with_suffix(".time").exists()
