"""The fleet's authority: a key that signs members' certificates and the roster, and never leaves its folder.

The folder holds ``ca.pem``, ``ca-key.pem`` (its owner's only, best encrypted), ``ledger.json`` and ``roster.json``, and
by default the members' folders under ``members``. It belongs on a computer that does not fly.
"""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from mesh.credentials import certify, files
from mesh.credentials.certify import day
from mesh.credentials.ledger import LEDGER, Entry, IssuedCertificates, read_ledger
from zmav import keys, wire
from zmav.errors import BadConfig, BadInput
from zmav.trust import credentials
from zmav.trust.certificate import SOON, Certificate, Role
from zmav.trust.roster import Roster, SignedRoster

CA_KEY, MEMBERS = "ca-key.pem", "members"
DAYS = 365
"""of a member's, unless said otherwise"""

Passphrase = Callable[[], bytes]


class Authority:
    """An opened authority. Every change is on the disk, and in a new roster, when its method returns."""

    def __init__(self, folder: Path, certificate: x509.Certificate, key: Ed25519PrivateKey) -> None:
        self.folder, self.certificate, self._key = folder, certificate, key

    @classmethod
    def create(cls, folder: str | Path, fleet: str, passphrase: bytes | None = None) -> Authority:
        """A new one, its key encrypted where there is a ``passphrase``.

        Raises :class:`BadConfig` where the folder is there already.
        """
        folder = Path(folder)
        keys.check_name(fleet, "fleet")
        key = Ed25519PrivateKey.generate()
        certificate = certify.self_signed(key, fleet)
        ledger = IssuedCertificates(fleet=fleet, t=time.time())
        made = cls(folder, certificate, key)
        contents = {
            credentials.CA: (_pem(certificate), files.PUBLIC),
            CA_KEY: (_key_pem(key, passphrase), files.SECRET),
            LEDGER: (ledger.encode(), files.SECRET),
            credentials.ROSTER: (msgspec.json.encode(made._signed(ledger.roster(time.time()))), files.PUBLIC),
        }
        files.write_folder(folder, contents)
        return made

    @classmethod
    def open(cls, folder: str | Path, passphrase: Passphrase) -> Authority:
        """The one of a folder; ``passphrase`` is asked where its key is encrypted. Raises :class:`BadConfig`."""
        folder = Path(folder)
        read_ledger(folder)
        try:
            public, private = ((folder / name).read_bytes() for name in (credentials.CA, CA_KEY))
        except OSError as e:
            text = f"cannot read {e.filename}: {e.strerror}"
            raise BadConfig(text, field="ca", value=str(e.filename), expected="a file") from e
        certificate = credentials.read_certificate(folder / credentials.CA, public, "ca")
        key = credentials.read_key(folder / CA_KEY, private, "ca", passphrase)
        if key.public_key() != certificate.public_key():
            text = f"{folder / CA_KEY} is not the key of {folder / credentials.CA}"
            raise BadConfig(text, field="ca", value=str(folder / CA_KEY), expected="the authority's key")
        return cls(folder, certificate, key)

    @property
    def ledger(self) -> IssuedCertificates:
        return read_ledger(self.folder)

    def issue(
        self, name: str, role: Role, days: float = DAYS, out: str | Path | None = None, *, again: bool = False
    ) -> Path:
        """A new member: its folder. Raises :class:`BadConfig` where the name has a certificate in force, or, unless
        ``again``, one that was revoked and has not ended: doors know members by name, and would open to both.
        """
        keys.check_name(name)
        now = time.time()
        with files.locked(self.folder):
            ledger = self.ledger
            if current := ledger.current(name, now):
                text = f"{name} has a certificate until {day(current.not_after)}: renew it, or revoke it first"
                raise BadConfig(text, field="name", value=name, expected="a name without one")
            turned_out = [e for e in ledger.entries if e.name == name and now <= e.not_after]
            if turned_out and not again:
                until = day(max(e.not_after for e in turned_out))
                text = (
                    f"a certificate of {name} was revoked, and would end {until}: routers know members by their names, "
                    "and would let its holder in again. Take another name; or say --again, where its key is known "
                    "to be destroyed"
                )
                raise BadConfig(text, field="name", value=name, expected="a name that was not revoked")
            return self._sign(ledger, name, role, days, self._folder_of(name, out), replace=False)

    def renew(self, name: str, days: float = DAYS, out: str | Path | None = None) -> Path:
        """A new key and certificate for a member; the old one stays good until its end. Raises :class:`BadConfig`
        for a name without a certificate in force.
        """
        now = time.time()
        with files.locked(self.folder):
            ledger = self.ledger
            # One that has ended may be renewed; one that was revoked is not.
            known = [e for e in ledger.entries if e.name == name and e.revoked is None]
            if not known or (ledger.current(name, now) is None and _revoked_lately(ledger, name, now)):
                expected = ", ".join(n for n in ledger.names() if ledger.current(n, now)) or "none"
                text = f"{name} has no certificate to renew; there are {expected}"
                raise BadConfig(text, field="name", value=name, expected=expected)
            return self._sign(ledger, name, known[-1].role, days, self._folder_of(name, out), replace=True)

    def revoke(self, name: str) -> list[Entry]:
        """Turn a member out: all its certificates that are in force. Raises :class:`BadConfig` where there is none."""
        now = time.time()
        with files.locked(self.folder):
            ledger = self.ledger
            gone = [e for e in ledger.entries if e.name == name and e.in_force(now)]
            if not gone:
                expected = ", ".join(n for n in ledger.names() if ledger.current(n, now)) or "none"
                text = f"{name} has no certificate in force; there are {expected}"
                raise BadConfig(text, field="name", value=name, expected=expected)
            self._keep(ledger.without(name, now))
            return gone

    def ending(self, within: float = SOON) -> list[str]:
        """Names whose newest certificate in force ends within so many seconds."""
        ledger, now = self.ledger, time.time()
        newest = {name: ledger.current(name, now) for name in ledger.names()}
        return [name for name, entry in newest.items() if entry is not None and entry.not_after - now <= within]

    def roster(self) -> SignedRoster:
        """The newest, signed."""
        return self._signed(self.ledger.roster(time.time()))

    def refresh(self, *folders: Path) -> None:
        """Put the newest roster into members' folders, by default those under ``members``: who starts with an older one
        hears of it from others, and starts again. Raises :class:`BadConfig` at the end for what cannot be written.
        """
        faults: list[BadConfig] = []
        with files.locked(self.folder):
            signed = msgspec.json.encode(self.roster())
            for folder in folders or sorted(
                p.parent for p in (self.folder / MEMBERS).glob(f"[!.]*/{credentials.CERT}")
            ):
                try:
                    files.write(folder / credentials.ROSTER, signed)
                except BadConfig as e:
                    text = f"{e}: mend that, then 'zmav mesh ca renew --all' brings the roster there"
                    faults.append(BadConfig(text, **e.detail))
        if faults:
            raise together(faults)

    def _folder_of(self, name: str, out: str | Path | None) -> Path:
        return Path(out) if out is not None else self.folder / MEMBERS / name

    def _sign(
        self, ledger: IssuedCertificates, name: str, role: Role, days: float, folder: Path, *, replace: bool
    ) -> Path:
        key = Ed25519PrivateKey.generate()
        certificate = certify.member(self.certificate, self._key, key.public_key(), ledger.fleet, name, role, days)
        read = Certificate.read(certificate.public_bytes(serialization.Encoding.DER))
        entry = Entry(
            name=name,
            role=role,
            serial=f"{read.serial:x}",
            fingerprint=read.fingerprint.hex(),
            not_before=read.not_before,
            not_after=read.not_after,
        )
        ledger = ledger.with_entry(entry, time.time())
        contents = {
            credentials.CA: (_pem(self.certificate), files.PUBLIC),
            credentials.CERT: (_pem(certificate), files.PUBLIC),
            credentials.KEY: (_key_pem(key, None), files.SECRET),
            credentials.ROSTER: (msgspec.json.encode(self._signed(ledger.roster(time.time()))), files.PUBLIC),
        }
        files.check_place(folder, contents, replace=replace)
        if replace:
            _check_same(folder, name)
        self._keep(ledger)  # first: a certificate that the ledger does not know could not be revoked
        files.write_folder(folder, contents, replace=replace)
        return folder

    def _keep(self, ledger: IssuedCertificates) -> None:
        ledger.write(self.folder)
        files.write(self.folder / credentials.ROSTER, msgspec.json.encode(self._signed(ledger.roster(time.time()))))

    def _signed(self, roster: Roster) -> SignedRoster:
        text = wire.encode(roster)
        return SignedRoster(roster=text.decode(), signature=base64.b64encode(self._key.sign(text)).decode())


def together(faults: Sequence[BadConfig]) -> BadConfig:
    """All of them, as one."""
    return BadConfig("; ".join(map(str, faults)), **faults[0].detail)


def _check_same(folder: Path, name: str) -> None:
    """Raise :class:`BadConfig` where ``folder`` is another member's; a damaged one may be replaced."""
    try:
        found = x509.load_pem_x509_certificate((folder / credentials.CERT).read_bytes())
        theirs = Certificate.read(found.public_bytes(serialization.Encoding.DER)).name
    except (OSError, ValueError, BadInput):
        return
    if theirs != name:
        text = f"{folder} is the folder of {theirs}, and is not replaced by that of {name}: name another with --out"
        raise BadConfig(text, field="out", value=str(folder), expected=f"a folder of {name}")


def _revoked_lately(ledger: IssuedCertificates, name: str, now: float) -> bool:
    return any(e.name == name and e.revoked is not None and now <= e.not_after for e in ledger.entries)


def _key_pem(key: Ed25519PrivateKey, passphrase: bytes | None) -> bytes:
    encryption: serialization.KeySerializationEncryption = (
        serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption()
    )
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)
