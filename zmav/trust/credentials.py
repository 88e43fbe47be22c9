"""A member's folder: what ``zmav mesh ca issue`` wrote for it.

``ca.pem`` the authority's certificate, ``cert.pem`` the member's own, ``key.pem`` its private key, which only its owner
may read, ``roster.json`` the newest roster seen. The folder is named by ``--credentials`` or ``$ZMAV_CREDENTIALS``. A
service of systemd keeps newer rosters in its own state directory.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zmav.errors import BadConfig
from zmav.systemd import state_directory
from zmav.trust.certificate import Certificate, Role
from zmav.trust.roster import Roster, SignedRoster, read_signed

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

CA, CERT, KEY, ROSTER = "ca.pem", "cert.pem", "key.pem", "roster.json"


@dataclass(frozen=True)
class Credentials:
    """One member's, read and checked."""

    folder: Path
    authority: x509.Certificate
    certificate: Certificate
    key: Ed25519PrivateKey
    roster: Roster

    @classmethod
    def load(cls, folder: str | Path, now: float | None = None) -> Credentials:
        """Read a folder; raises :class:`BadConfig` naming the file, for a certificate that is not valid now, too."""
        from cryptography.hazmat.primitives import serialization

        folder = Path(folder).expanduser()
        authority = read_certificate(folder / CA, _bytes(folder / CA))
        found = read_certificate(folder / CERT, _bytes(folder / CERT))
        certificate = Certificate.read(found.public_bytes(serialization.Encoding.DER))
        certificate.check(authority, time.time() if now is None else now)
        key = read_key(folder / KEY, _bytes(folder / KEY))
        if key.public_key() != certificate.key:
            raise BadConfig(f"{folder / KEY} is not the key of {folder / CERT}", field="key", value=str(folder / KEY))
        roster = newest_roster(folder, authority, certificate.fleet).open(authority, certificate.fleet)
        return cls(folder, authority, certificate, key, roster)

    @property
    def name(self) -> str:
        return self.certificate.name

    @property
    def role(self) -> Role:
        return self.certificate.role

    @property
    def fleet(self) -> str:
        return self.certificate.fleet

    def zenoh(self) -> dict[str, Any]:
        """Zenoh's configuration of mutual TLS, for ``tls/`` and ``quic/``, by path.

        Endpoints are named by address, so the other's name is not compared with it: the authority signs members only.
        """
        cert, key = str(self.folder / CERT), str(self.folder / KEY)
        return {
            "transport/link/tls/root_ca_certificate": str(self.folder / CA),
            "transport/link/tls/listen_certificate": cert,
            "transport/link/tls/listen_private_key": key,
            "transport/link/tls/connect_certificate": cert,
            "transport/link/tls/connect_private_key": key,
            "transport/link/tls/enable_mtls": True,
            "transport/link/tls/verify_name_on_connect": False,
        }


def roster_place(folder: Path) -> Path:
    """Where a newer roster is kept: a service's folder of credentials is not its own to write."""
    return (state_directory() or folder) / ROSTER


def newest_roster(folder: Path, authority: x509.Certificate, fleet: str) -> SignedRoster:
    """The one in the folder, or that which was kept since where it is newer; raises :class:`BadConfig`."""
    found, kept = read_signed(_bytes(folder / ROSTER)), roster_place(folder)
    with contextlib.suppress(BadConfig):  # none is kept yet, or one of another authority, before this folder came
        later = read_signed(_bytes(kept))
        if later.open(authority, fleet).number > found.open(authority, fleet).number:
            return later
    return found


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        text = f"cannot read {path}: {e.strerror}; 'zmav mesh ca issue' makes such a folder"
        raise BadConfig(text, field="credentials", value=str(path), expected="a file") from e


def read_certificate(path: Path, pem: bytes, field: str = "credentials") -> x509.Certificate:
    """What ``path`` holds; raises :class:`BadConfig` that names ``field``."""
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(pem)
    except ValueError as e:
        raise BadConfig(f"{path} is not a certificate: {e}", field=field, value=str(path)) from e


def read_key(
    path: Path, pem: bytes, field: str = "credentials", passphrase: Callable[[], bytes] | None = None
) -> Ed25519PrivateKey:
    """What ``path`` holds, which only its owner may read; ``passphrase`` is asked where it is encrypted."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    if path.stat().st_mode & 0o077:
        text = f"{path} can be read by others than its owner: chmod 600 {path}"
        raise BadConfig(text, field=field, value=str(path), expected="mode 0600")
    secret = passphrase() if passphrase is not None and b"ENCRYPTED" in pem else None
    try:
        key = serialization.load_pem_private_key(pem, password=secret)
    except (ValueError, TypeError) as e:
        why = "the passphrase is wrong, or it is damaged" if secret is not None else str(e)
        raise BadConfig(f"{path} cannot be opened: {why}", field=field, value=str(path)) from e
    if not isinstance(key, Ed25519PrivateKey):
        raise BadConfig(f"{path} is not an Ed25519 key", field=field, value=str(path), expected="Ed25519")
    return key


def own_credentials(folder: str, fleet: str) -> Credentials:
    """Raises :class:`BadConfig` for those of another fleet: nobody here would be believed, nor believe us."""
    found = Credentials.load(folder)
    if fleet not in ("*", found.fleet):
        text = f"the credentials in {folder} are for the fleet {found.fleet}: say --fleet {found.fleet}, not {fleet}"
        raise BadConfig(text, field="fleet", value=fleet, expected=found.fleet)
    return found
