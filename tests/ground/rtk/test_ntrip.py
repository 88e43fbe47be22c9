"""NTRIP: pygnssutils' caster as the peer, and casters that hang, lie and send garbage."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import os
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from ground.rtk.ntrip import MOST_GARBAGE, Chunks, Ended, NtripSource
from ground.rtk.options import Caster as Where
from ground.rtk.options import Fixed
from tests.ground.rtk.casters import CHUNKED, MOUNTPOINT, STREAM, Caster, hangs, hostile, repeats, sends
from tests.rtcm import base_at, message, satellites

EPOCH = base_at() + satellites(1074) + message(1087, size=200)


class Told:
    """What a source brought and said."""

    def __init__(self) -> None:
        self.data, self.states = b"", list[tuple[str, str]]()

    async def until(self, true: Callable[[], bool], what: str, within: float = 20.0) -> None:
        end = time.monotonic() + within
        while not true():
            assert time.monotonic() < end, f"no {what}: {len(self.data)} bytes, {self.states[-5:]}"
            await asyncio.sleep(0.02)

    async def lost(self, words: str, within: float = 30.0) -> None:
        await self.until(lambda: any(s == "lost" and words in t for s, t in self.states), f"loss {words!r}", within)


@contextlib.asynccontextmanager
async def source(
    port: int,
    at: Fixed | None = None,
    mountpoint: str = MOUNTPOINT,
    password: str = "secret",
    patience: Mapping[str, float] | None = None,
    **more: object,
) -> AsyncIterator[Told]:
    told = Told()
    where = Where(host="127.0.0.1", port=port, mountpoint=mountpoint, user="me", password=password, **more)  # type: ignore[arg-type]

    def take(messages: object) -> None:
        told.data += b"".join(each.data for each in messages)  # type: ignore[attr-defined]

    one = NtripSource(
        where, take, lambda state, text: told.states.append((state, text)), None if at is None else lambda: at
    )
    for name, seconds in (patience or {}).items():
        setattr(one, name, seconds)
    task = asyncio.create_task(one.run())
    try:
        yield told
    finally:
        task.cancel()
        await asyncio.wait({task})


@pytest.fixture
def pem(tmp_path: Path) -> Path:
    """A certificate of localhost's own with its key, as pygnssutils' caster wants it."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "localhost")])
    now = datetime.datetime.now(datetime.timezone.utc)
    builder = x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
    builder = builder.not_valid_before(now - datetime.timedelta(1)).not_valid_after(now + datetime.timedelta(1))
    certificate = builder.add_extension(x509.BasicConstraints(True, None), critical=True).sign(key, hashes.SHA256())
    form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    path = tmp_path / "caster.pem"
    path.write_bytes(key.private_bytes(*form) + certificate.public_bytes(serialization.Encoding.PEM))
    return path


@pytest.fixture
def caster(request: pytest.FixtureRequest, pem: Path) -> Iterator[Caster]:
    version, tls = request.param
    one = Caster(version, pem if tls else None)
    yield one
    one.close()


@pytest.mark.parametrize(
    "caster", [("1.0", False), ("2.0", False), ("2.0", True)], indirect=True, ids=["v1", "v2", "tls"]
)
async def test_corrections_come_byte_for_byte(caster: Caster, pem: Path, request: pytest.FixtureRequest) -> None:
    version, tls = request.node.callspec.params["caster"]
    async with source(caster.port, version=version, tls=tls, ca=str(pem) if tls else None) as told:
        await told.until(lambda: caster.clients == 1, "client")
        await asyncio.sleep(0.3)
        for _ in range(3):
            caster.send(EPOCH)
        await told.until(lambda: told.data == EPOCH * 3, "corrections")
    assert ("streaming", f"from {'ntrips' if tls else 'ntrip'}://127.0.0.1:{caster.port}/{MOUNTPOINT}") in told.states


@pytest.mark.parametrize("caster", [("2.0", False)], indirect=True)
async def test_a_wrong_password_and_a_wrong_mountpoint_are_told(caster: Caster) -> None:
    async with source(caster.port, password="wrong") as told:
        await told.lost("refused: user or password is wrong (401); again in 60 s")
    async with source(caster.port, mountpoint="elsewhere") as told:
        await told.lost(f"no mountpoint 'elsewhere': it has {MOUNTPOINT}; again in 60 s")


async def test_a_certificate_that_nobody_signed_is_refused(pem: Path) -> None:
    caster = Caster("2.0", pem)
    async with source(caster.port, tls=True) as told:
        await told.lost("certificate", 20.0)
    caster.close()


async def test_bytes_that_come_with_the_head_are_not_lost() -> None:
    for head in (STREAM, b"ICY 200 OK\r\n\r\n", b"ICY 200 OK\r\n"):
        with hostile(sends(head + EPOCH, then=hangs)) as one:
            async with source(one.port) as told:
                await told.until(lambda told=told: told.data == EPOCH, f"corrections after {head!r}")  # type: ignore[misc]


async def test_a_head_and_chunks_in_pieces() -> None:
    data = b"".join(b"%x\r\n%s\r\n" % (len(part), part) for part in (EPOCH[:7], EPOCH[7:50], EPOCH[50:]))
    pieces = [
        *(CHUNKED[at : at + 9] for at in range(0, len(CHUNKED), 9)),
        *(data[at : at + 31] for at in range(0, len(data), 31)),
    ]
    with hostile(sends(*pieces, pause=0.002, then=hangs)) as one:
        async with source(one.port) as told:
            await told.until(lambda: told.data == EPOCH, "corrections")


async def test_the_caster_is_told_where_the_rover_is() -> None:
    with hostile(sends(STREAM, EPOCH, then=hangs)) as one:
        async with source(one.port, at=Fixed(-35.363262, 149.165237, 584.0)) as told:
            await told.until(lambda: told.data == EPOCH, "corrections")
        (request,) = one.requests
    assert b"Ntrip-GGA: $GPGGA," in request
    assert b",3521.7957" in request and b",S,14909.9142" in request
    assert b"GET /pygnssutils" in request or MOUNTPOINT.encode() in request
    assert b"Ntrip-Version: Ntrip/2.0" in request


async def test_a_caster_that_ends_is_called_again() -> None:
    with hostile(sends(STREAM + EPOCH)) as one:
        async with source(one.port) as told:
            await told.until(lambda: len(told.data) >= 2 * len(EPOCH), "second try", 15.0)
            await told.lost("it ended the stream; again in")


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda connection: None, "it ended the connection without a reply"),
        (repeats(b"x" * 4096), "no reply to the request"),
        (repeats(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n" + b"x" * 4096), "a page without end"),
        (sends(b"HTTP/1.1 banana\r\n\r\n"), "banana"),
        (sends(b"HTTP/1.1 503 Busy\r\n\r\n"), "refused: Connection failed 503"),
        (sends(CHUNKED, b"ffffffffffffffff\r\n", then=repeats(os.urandom(4096))), "no RTCM 3"),
        (sends(CHUNKED, b"-5\r\n", then=hangs), "lies about the length"),
        (sends(CHUNKED, b"zz" * 100, then=hangs), "lies about the length"),
        (sends(STREAM, then=repeats(b"\xd3\x03\xff" * 1000)), "no RTCM 3"),
        (sends(STREAM, then=repeats(b"$" * 4096)), "no RTCM 3"),
        (sends(STREAM, then=repeats(os.urandom(65536))), "no RTCM 3"),
    ],
    ids=[
        "closes",
        "no-head",
        "page",
        "status",
        "busy",
        "long-chunk",
        "negative",
        "no-number",
        "beginnings",
        "nmea",
        "noise",
    ],
)
async def test_a_hostile_caster_is_left_and_called_later(act: Callable[[object], object], words: str) -> None:
    """Within bounds of time, memory and processor, and with the reason in words."""
    with hostile(act) as one:
        began, used = time.monotonic(), time.process_time()
        async with source(one.port) as told:
            await told.lost(words)
        assert not told.data
        assert time.monotonic() - began < 25.0
        assert time.process_time() - used < 5.0


@pytest.mark.parametrize(
    "act", [hangs, sends(b"HTTP/1.1 200", then=hangs), sends(STREAM, then=hangs)], ids=["at-once", "head", "stream"]
)
async def test_a_caster_that_hangs_is_left(act: Callable[[object], object]) -> None:
    with hostile(act) as one:
        used = time.process_time()
        async with source(one.port, patience={"head": 1.0, "silence": 1.5}) as told:
            await told.lost("")
        assert time.process_time() - used < 2.0


async def test_one_that_never_comes_to_its_first_message_is_left() -> None:
    """Its TLS comes in single bytes, each before a read would time out."""

    def trickles(connection: socket.socket) -> None:
        for byte in b"\x16\x03\x03\x40\x00" + bytes(1000):
            connection.sendall(bytes((byte,)))
            time.sleep(0.2)

    with hostile(trickles) as one:
        async with source(one.port, tls=True, patience={"longest": 2.0}) as told:
            await told.lost("nothing within 2 s; again in", 15.0)


async def test_an_end_comes_at_once_whatever_the_caster_sends() -> None:
    for act in (sends(STREAM, then=repeats(b"$" * 4096)), hangs):
        with hostile(act) as one:
            async with source(one.port) as told:
                await told.until(lambda one=one: bool(one.requests), "request")  # type: ignore[misc]
                await asyncio.sleep(0.2)
                began = time.monotonic()
            assert time.monotonic() - began < 0.5


class TestChunks:
    pytestmark = pytest.mark.unit

    @pytest.mark.parametrize("step", [1, 2, 3, 1000])
    def test_whatever_the_pieces(self, step: int) -> None:
        data = b"5;name=x\r\nhello\r\n1\r\n!\r\n"
        chunks = Chunks()
        assert b"".join(chunks.feed(data[at : at + step]) for at in range(0, len(data), step)) == b"hello!"
        with pytest.raises(Ended, match="ended"):
            chunks.feed(b"0\r\n\r\n")

    def test_a_chunk_keeps_nothing(self) -> None:
        chunks = Chunks()
        chunks.feed(b"ffffffffff\r\n")
        assert all(chunks.feed(bytes(1000)) == bytes(1000) for _ in range(MOST_GARBAGE // 1000))
