"""MAVLink 2 signing: who knows the key may speak on a link, and nothing old can be played back.

https://mavlink.io/en/guide/message_signing.html. A signature is the link's id, a timestamp of 48 bits (10 µs since
2015) and the first 48 bits of SHA-256 over key, frame and those two. A timestamp is never used twice: the last one is
kept in a file, for a computer without a clock begins each day in the past.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import re
import secrets
import stat
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from zmav.errors import BadConfig, BadMessage
from zmav.mavlink.checksum import checksum
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frame import CHECKSUM, HEADER_V2, MAGIC_V2, SIGNATURE, SIGNED, Frame

KEY_BYTES = 32
EPOCH = 1_420_070_400
"""UTC seconds of 2015-01-01"""
TICKS = 100_000
"""a second's worth of timestamps"""
LAST = (1 << 48) - 1
"""the last timestamp that there is, in the year 2104"""
OLDEST_NEW = 60 * TICKS
"""how far behind our clock a stream not heard before may be"""
KEEP_EVERY = 10 * TICKS
MAX_STREAMS = 256
UNSIGNED_ALLOWED = frozenset({109, 166})
"""RADIO_STATUS and RADIO: a telemetry radio speaks without knowing any key"""
SETUP_SIGNING = 256
"""carries the key: it never leaves the link"""


@dataclass(slots=True)
class SigningCounters:
    """Frames that were not let through, by reason."""

    bad_signature: int = 0
    old_timestamp: int = 0
    unsigned: int = 0


def new_key() -> bytes:
    """A random key of 32 bytes."""
    return secrets.token_bytes(KEY_BYTES)


def write_key(path: str | Path, key: bytes) -> None:
    """Write a key as hexadecimal text that only its owner may read; raises :class:`BadConfig` where the file exists."""
    file = Path(path)
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise BadConfig(f"cannot write the key {file}: {error.strerror}", field="key", value=str(file)) from error
    with os.fdopen(descriptor, "w") as out:
        out.write(key.hex() + "\n")


def read_key(path: str | Path) -> bytes:
    """The key in a file: 64 hexadecimal digits, or ``passphrase:`` and words (SHA-256 of them, as ground stations make
    it).

    Raises :class:`BadConfig` for a file that others may read, or that holds no key; the message never shows its text.
    """
    file = Path(path)
    try:
        mode, raw = stat.S_IMODE(file.stat().st_mode), file.read_bytes()
    except OSError as error:
        raise BadConfig(f"cannot read the key {file}: {error.strerror}", field="key", value=str(file)) from error
    if os.name == "posix" and mode & 0o077:
        raise BadConfig(
            f"the key {file} can be read by others (mode {mode:o}): chmod 600 {file}",
            field="key",
            value=f"{mode:o}",
            expected="600",
        )
    key = _key_of(raw)
    if key is None:
        expected = "64 hexadecimal digits, or passphrase:WORDS"
        raise BadConfig(f"{file} holds no key; expected {expected}", field="key", value=str(file), expected=expected)
    return key


def _key_of(raw: bytes) -> bytes | None:
    text = raw.strip()
    if text.startswith(b"passphrase:"):
        words = text.partition(b":")[2].strip()
        return hashlib.sha256(words).digest() if words else None
    return bytes.fromhex(text.decode()) if re.fullmatch(rb"[0-9a-fA-F]{64}", text) else None


class SigningClock:
    """Timestamps that only grow, also from one start of the program to the next. Any thread may ask."""

    def __init__(self, state: Path | None = None, now: Callable[[], float] = time.time) -> None:
        self._state, self._now = state, now
        self._lock = threading.Lock()
        self._last = self._read()
        self._writer: threading.Thread | None = None
        self._kept = -KEEP_EVERY  # so that the first one is kept at once: a start may be short

    def next(self) -> int:
        """A timestamp above all before it; at the end of its 48 bits, where no honest clock comes, it stays."""
        with self._lock:
            self._last = min(max(self._last + 1, self._ticks()), LAST)
            self._keep()
            return self._last

    def heard(self, timestamp: int) -> None:
        """A peer that we trust is ahead: never be behind it."""
        with self._lock:
            self._last = max(self._last, timestamp)

    @property
    def last(self) -> int:
        """The newest of those used and heard, or of our clock."""
        return max(self._last, self._ticks())

    def _ticks(self) -> int:
        return max(int((self._now() - EPOCH) * TICKS), 0)

    def _read(self) -> int:
        """The last one kept, and all that may have been used since."""
        if self._state is None:
            return 0
        try:
            return int(self._state.read_text()) + KEEP_EVERY
        except (OSError, ValueError):
            return 0  # the first start, or a file cut short by a power failure: then the clock must do

    def _keep(self) -> None:
        if self._state is None or self._last - self._kept < KEEP_EVERY:
            return
        self._kept = self._last
        # In a thread of its own: a card that stalls must not delay the frame that is to be signed.
        before, args = self._writer, (self._state, self._last)
        self._writer = threading.Thread(target=lambda: self._write(before, *args), daemon=True)
        self._writer.start()

    def close(self) -> None:
        """Wait until what is to be kept is kept."""
        if self._writer is not None:
            self._writer.join(1.0)

    @staticmethod
    def _write(before: threading.Thread | None, state: Path, last: int) -> None:
        if before is not None:
            before.join()
        with contextlib.suppress(OSError):  # a full disk must not stop the flight; the clock goes on
            part = state.with_suffix(".part")
            part.write_text(str(last))
            part.replace(state)


class Signing:
    """One link's signing: signs what goes out, judges what comes in. Any thread may use it.

    ``unsigned`` "accept": frames without a signature pass; "refuse": only those of a telemetry radio do.
    """

    def __init__(
        self,
        key: bytes,
        dialect: Dialect,
        *,
        link_id: int = 0,
        clock: SigningClock | None = None,
        unsigned: str = "refuse",
    ) -> None:
        self._key, self._dialect, self._link_id = key, dialect, link_id
        self._clock = clock or SigningClock()
        self._accept_unsigned = unsigned == "accept"
        self._streams: dict[tuple[int, int, int], int] = {}
        self.counters = SigningCounters()

    def close(self) -> None:
        """The link is closed."""
        self._clock.close()

    def sign(self, data: bytes) -> bytes:
        """An unsigned MAVLink 2 frame, signed; raises :class:`BadMessage` for what cannot be."""
        if data[0] != MAGIC_V2:
            raise BadMessage("a MAVLink 1 frame cannot be signed", field="frame", expected="MAVLink 2")
        message = self._dialect.by_id.get(int.from_bytes(data[7:10], "little"))
        if message is None:
            raise BadMessage("a message the dialect lacks cannot be signed", field="frame", expected="a known message")
        body = bytes((data[1], data[2] | SIGNED)) + data[3 : HEADER_V2 + data[1]]
        frame = bytes((MAGIC_V2,)) + body + checksum(body, message.crc_extra).to_bytes(CHECKSUM, "little")
        frame += bytes((self._link_id,)) + self._clock.next().to_bytes(6, "little")
        return frame + self._digest(frame)

    def accepts(self, frame: Frame) -> bool:
        """Whether a frame may pass; one that may not is counted."""
        if not frame.signed:
            if self._accept_unsigned or frame.msgid in UNSIGNED_ALLOWED:
                return True
            self.counters.unsigned += 1
            return False
        data = frame.data
        if not hmac.compare_digest(data[-6:], self._digest(data[:-6])):
            self.counters.bad_signature += 1
            return False
        link_id, timestamp = data[-SIGNATURE], int.from_bytes(data[-12:-6], "little")
        stream = (frame.sysid, frame.compid, link_id)
        last = self._streams.get(stream)
        oldest = self._clock.last - OLDEST_NEW if last is None else last + 1
        if timestamp < oldest or (last is None and len(self._streams) >= MAX_STREAMS):
            self.counters.old_timestamp += 1
            return False
        self._streams[stream] = timestamp
        self._clock.heard(timestamp)
        return True

    def _digest(self, signed_part: bytes) -> bytes:
        return hashlib.sha256(self._key + signed_part).digest()[:6]
