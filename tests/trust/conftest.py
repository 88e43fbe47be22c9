"""An authority as ``zmav mesh ca`` is one, for certificates that it would not issue, and a vehicle behind its gate."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import datetime
import json
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.x509.oid import NameOID

import zmav
from tests.services.conftest import bench, peer  # noqa: F401  (fixtures)
from zmav import keys, wire
from zmav.client import Client
from zmav.onboard import Onboard
from zmav.session import SessionSettings
from zmav.trust.certificate import Certificate
from zmav.trust.credentials import Credentials
from zmav.trust.proof import Signer
from zmav.vehicle.lease import Lease

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench

DAY = 86400.0


class Authority:
    """Signs whatever it is told to; members' folders lie under ``folder``."""

    def __init__(self, folder: Path, fleet: str = "demo") -> None:
        self.folder, self.fleet, self.key = folder, fleet, Ed25519PrivateKey.generate()
        self._subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"authority of {fleet}")])
        now = time.time()
        self.certificate = self._sign(self._subject, self.key, now - DAY, now + DAY, ca=True)
        self.number = 0
        self.revoked: list[str] = []
        self.members: list[dict[str, Any]] = []

    def issue(
        self,
        name: str,
        role: str,
        *,
        fleet: str | None = None,
        begins: float = -DAY,
        ends: float = DAY,
        folder: str | None = None,
    ) -> Path:
        """A member's folder. ``begins``, ``ends``: seconds from now."""
        key, now = Ed25519PrivateKey.generate(), time.time()
        parts = ((NameOID.COMMON_NAME, name), (NameOID.ORGANIZATION_NAME, fleet or self.fleet))
        subject = x509.Name(
            [x509.NameAttribute(oid, text) for oid, text in (*parts, (NameOID.ORGANIZATIONAL_UNIT_NAME, role))]
        )
        made = self._sign(subject, key, now + begins, now + ends)
        to = self.folder / (folder or name)
        to.mkdir(parents=True)
        (to / "ca.pem").write_bytes(self.certificate.public_bytes(serialization.Encoding.PEM))
        (to / "cert.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
        secret = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        (to / "key.pem").write_bytes(key.private_bytes(serialization.Encoding.PEM, *secret))
        (to / "key.pem").chmod(0o600)
        (to / "roster.json").write_bytes(self.roster(fleet))
        return to

    def member(self, name: str, role: str, **more: Any) -> Credentials:
        """Issued and read."""
        return Credentials.load(self.issue(name, role, **more))

    def strange(self, name: str, role: str, **more: Any) -> Credentials:
        """As :meth:`member`, for a certificate that :meth:`Credentials.load` would refuse."""
        folder = self.issue(name, role, **more)
        found = x509.load_pem_x509_certificate((folder / "cert.pem").read_bytes())
        key = serialization.load_pem_private_key((folder / "key.pem").read_bytes(), None)
        assert isinstance(key, Ed25519PrivateKey)
        certificate = Certificate.read(found.public_bytes(serialization.Encoding.DER))
        good = self.member(f"{name}-good", role, folder=f"{folder.name}-good")
        return Credentials(folder, self.certificate, certificate, key, good.roster)

    def roster(self, fleet: str | None = None) -> bytes:
        """A newer one each time, signed."""
        self.number += 1
        content = {"fleet": fleet or self.fleet, "number": self.number, "t": time.time()}
        content.update(members=self.members, revoked=self.revoked)
        text = json.dumps(content)
        signature = base64.b64encode(self.key.sign(text.encode())).decode()
        return json.dumps({"roster": text, "signature": signature}).encode()

    def _sign(
        self, subject: x509.Name, key: Ed25519PrivateKey, begins: float, ends: float, ca: bool = False
    ) -> x509.Certificate:
        begin, end = (datetime.datetime.fromtimestamp(t, datetime.timezone.utc) for t in (begins, ends))
        builder = x509.CertificateBuilder(self._subject, subject, key.public_key(), x509.random_serial_number())
        builder = builder.not_valid_before(begin).not_valid_after(end)
        return builder.add_extension(x509.BasicConstraints(ca, None), critical=True).sign(self.key, None)


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path / "members")


def secret_of(lease: Lease) -> bytes:
    """What its setpoints are sealed with: the vehicle and its holder alone have it, and no caller is told."""
    return lease._secret


class Guarded(NamedTuple):
    """A vehicle with credentials on the bench, and the authority of its fleet."""

    b: Bench
    authority: Authority
    settings: dict[str, Any]

    @property
    def vehicle(self) -> Onboard:
        return self.b.vehicle

    def key(self, channel: keys.Channel = keys.DO, **chunks: object) -> str:
        return channel.key("demo", "quad1", **({"verb": "ping"} if channel is keys.DO and not chunks else chunks))

    def proof(self, by: Credentials, key: str, payload: bytes, **more: Any) -> bytes:
        """A proof as a client makes it: introduced, and for this start of the vehicle's agent."""
        assert self.vehicle.gate is not None
        given = {"introduce": True, "answers": self.vehicle.gate.epoch, **more}
        return Signer(by).sign(key, payload, **given)

    async def ask(self, attachment: bytes | None, payload: bytes = b"{}", key: str = "") -> wire.Outcome:
        """A ``do/ping`` (or another order) with an attachment of one's own; raises what the vehicle refuses it by."""
        replies = await asyncio.to_thread(
            lambda: list(
                self.b.ground.session.get(key or self.key(), payload=payload, attachment=attachment, timeout=20.0)
            )
        )
        (reply,) = replies
        if reply.ok is None:
            assert reply.err is not None
            raise wire.error_from(reply.err.payload.to_bytes())
        return wire.decode(reply.ok.payload.to_bytes(), wire.Outcome, "outcome")

    @contextlib.asynccontextmanager
    async def client(self, name: str, role: str, **more: Any) -> AsyncIterator[Client]:
        """A member's client that knows the vehicle."""
        folder = self.authority.folder / name
        if not folder.exists():
            self.authority.issue(name, role, **more)
        settings = SessionSettings(connect=[self.b.endpoint], credentials=str(folder))
        async with zmav.open(settings=settings) as z:
            await z.wait_for("quad1", timeout=30.0)
            yield z


StartGuarded = Callable[..., Any]


@pytest.fixture
async def guarded(bench: StartBench, authority: Authority) -> StartGuarded:  # noqa: F811
    """Put a vehicle with credentials on the bench: ``await guarded(**settings)``, its autopilot known."""

    async def start(**settings: Any) -> Guarded:
        settings = {"credentials": str(authority.issue("quad1", "vehicle")), **settings}
        return Guarded(await (await bench(settings=settings)).connected(), authority, settings)

    return start
