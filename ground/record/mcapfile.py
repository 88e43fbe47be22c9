"""One .mcap while it is written: topics with schemas as they come, chunks closed at every flush.

https://mcap.dev/spec. Compressed with zstd, which the mcap package brings. Each flush ends a chunk and its index, so a
file that was cut short reads up to its last flush, and :func:`repair` gives it its summary.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap import records as mcap_records
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, DataEnd, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from zstandard import ZstdError

from ground.record.decoder import is_frame
from ground.record.folder import MAGIC, Record, Tail, is_whole
from ground.record.schemas import ALL_FRAMES, AS_IT_CAME, Schema
from zmav import keys
from zmav.errors import BadInput
from zmav.mavlink import Dialect, load_dialect
from zmav.mavlink.frame import MAGIC_V2

HOLDS = "holds"
"""the metadatum of a topic that says so"""
KEY = "key"
"""the one that says on which key it came"""
MOST_TOPICS = 60_000
"""ids of topics have two bytes"""
CHUNK = 4 << 20
DAMAGE = (McapError, ZstdError, struct.error, ValueError, LookupError, OverflowError, MemoryError, RuntimeError)
"""what the mcap package raises for bytes that are no recording: it takes lengths and ids as they stand there"""
TORN = (EndOfFile, struct.error, ZstdError)
"""of these what it raises for a file that was cut short"""
ABOUT = "zmav"
"""name of the metadata at the beginning of a file"""


class McapFile:
    """OSError where it cannot be made; after one out of :meth:`flush` only :meth:`abandon` is left to be done."""

    def __init__(self, path: Path, about: dict[str, str]) -> None:
        self.path = path
        self._tail = Tail(path)
        self._writer = Writer(self._tail, chunk_size=CHUNK, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
        self._writer.start(library="zmav")
        self._writer.add_metadata(ABOUT, about)
        try:
            self._tail.flush()  # what follows is whole chunks
        except OSError:
            self._tail.close()
            path.unlink(missing_ok=True)
            raise
        self._schemas: dict[Schema, int] = {}
        self._topics: dict[str, int] = {}
        self._begin = self._tail.size

    def tell(self) -> int:
        return self._tail.tell()

    @property
    def fd(self) -> int:
        return self._tail.fd

    @property
    def gone(self) -> bool:
        return self._tail.gone

    def topic(self, name: str, encoding: str, holds: str, schema: Schema | None = None, key: str = "") -> int | None:
        """The topic's id, made where it is new; None where a file can hold no more. ``key``: if not ``name``."""
        found = self._topics.get(name)
        if found is None and len(self._topics) < MOST_TOPICS:
            number = 0
            if schema is not None:
                number = self._schemas.get(schema) or self._writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
                self._schemas[schema] = number
            found = self._writer.register_channel(name, encoding, number, {HOLDS: holds, KEY: key or name})
            self._topics[name] = found
        return found

    def add(self, topic: int, at: int, data: bytes, published: int) -> None:
        """``at`` and ``published`` are ns UTC: when it was recorded, and when its source says that it was sent."""
        self._writer.add_message(topic, at, data, published)

    def flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write the summary and close it; after an OSError the file is as if it had been cut short before."""
        try:
            self.flush()
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._tail.flush()
            os.fdatasync(self.fd)
        finally:
            self._tail.close()

    def abandon(self) -> bool:
        """Close it without what was not flushed and without its summary. False: that is nothing, so it is gone."""
        with contextlib.suppress(OSError):  # a disk that is read-only by now
            self._tail.close()
            if self._tail.size <= self._begin:
                self.path.unlink(missing_ok=True)
                return False
        return True


class Found(NamedTuple):
    """A recorded message with what its topic says of itself."""

    at: int
    key: str
    holds: str
    data: bytes


def read_forth(path: Path, since: int = 0) -> Iterator[Found]:
    """All that was recorded from a time on (ns UTC), in the order in which it came, whatever the clock did; of a
    file that was cut short as much as there is.

    Raises :class:`BadInput` for what is no .mcap or is damaged, OSError where it cannot be read.
    """
    with path.open("rb") as file, _reading(path):
        try:
            if is_whole(path):
                found = make_reader(file).iter_messages(starting_at=since, log_time_order=False)
            else:
                found = NonSeekingReader(file).iter_messages(log_time_order=False)
            for _, channel, message in found:
                if since <= message.log_time:
                    about = channel.metadata
                    yield Found(message.log_time, about.get(KEY, ""), about.get(HOLDS, ""), message.data)
        except TORN:
            return


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except InvalidMagic as e:
        raise BadInput(f"{path} is no .mcap", field="file", value=str(path), expected="a recording") from e
    except (OSError, *DAMAGE) as e:
        if isinstance(e, OSError) and e.errno != errno.EINVAL:  # which is a place that no file has
            raise
        text = f"{path} is damaged, and cannot be read any further ({str(e) or type(e).__name__})"
        raise BadInput(text, field="file", value=str(path), expected="a recording") from e


def about(path: Path) -> dict[str, str]:
    """What the recorder said of a file when it began it; empty where it said nothing."""
    with path.open("rb") as file, contextlib.suppress(*DAMAGE):
        for record in StreamReader(file).records:
            if isinstance(record, Metadata) and record.name == ABOUT:
                return record.metadata
            if isinstance(record, Message):
                break
    return {}


def last(path: Path) -> int | None:
    """When the last message of a whole file was recorded, ns UTC; None: the file does not say."""
    with path.open("rb") as file, _reading(path):
        summary = make_reader(file).get_summary() if is_whole(path) else None
        return summary.statistics.message_end_time if summary is not None and summary.statistics is not None else None


def topics(path: Path) -> list[str]:
    """Of a file, also of one that was cut short. Raises as :func:`read_forth` does."""
    found: dict[str, None] = {}
    with path.open("rb") as file, _reading(path), contextlib.suppress(*TORN):
        if is_whole(path) and (summary := make_reader(file).get_summary()) is not None:
            return [channel.topic for channel in summary.channels.values()]
        file.seek(0)
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                found[record.topic] = None
    return list(found)


class Mcap:
    """An .mcap of the recorder's; one that was cut short is played as far as it goes."""

    def __init__(self, path: Path) -> None:
        self._path, self.label = path, str(path)
        self._keys: dict[tuple[str, bytes], str] = {}
        self._dialect: Dialect | None = None

    def vehicles(self) -> list[str]:
        try:
            names = topics(self._path)
        except OSError as e:
            raise BadInput(f"cannot play {self._path}: {e}", field="file", expected="an .mcap of the recorder's") from e
        found = {topic.split("/")[2] for topic in names if topic.startswith(f"{keys.ROOT}/") and topic.count("/") > 2}
        return sorted(name for name in found if keys.NAME.match(name))

    def first(self) -> int | None:
        return next((record.at for record in self.records()), None)

    def last(self) -> int | None:
        return last(self._path) or max((record.at for record in self.records()), default=None)

    def records(self, since: int = 0) -> Iterator[Record]:
        for found in read_forth(self._path, since):
            if found.holds == AS_IT_CAME:
                yield Record(found.at, found.key, found.data)
            elif found.holds == ALL_FRAMES and is_frame(found.data):
                yield Record(found.at, self._key_of(found.key, found.data), found.data)

    def _key_of(self, topic: str, frame: bytes) -> str:
        """A vehicle's frames lie together: each came on the key that its header tells."""
        v2 = frame[0] == MAGIC_V2
        head = frame[5:10] if v2 else frame[3:6]
        found = self._keys.get((topic, head))
        if found is None:
            if self._dialect is None:
                self._dialect = load_dialect(about(self._path).get("dialect", "ardupilotmega"))
            msgid = int.from_bytes(head[2:], "little")
            found = f"{topic}/{head[0]}/{head[1]}/{self._dialect.name_of(msgid)}"
            self._keys[topic, head] = found
        return found


class Repaired(NamedTuple):
    """What was found and done."""

    messages: int
    whole: bool
    """it had its summary: nothing was done"""


def repair(path: Path) -> Repaired:
    """Complete ``path``: beside it for a while, and then in its place. :class:`BadInput` for what is no .mcap; OSError
    where it cannot be read, a recorder still writes it, or the disk is full: then it is as it was.
    """
    if is_whole(path):
        return Repaired(0, whole=True)
    new = path.with_name(f"{path.name}.new")
    with path.open("r+b") as file:  # not "rb": NFS locks only what is open for writing
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as e:
            raise OSError(e.errno, "a recorder still writes it") from e
        if file.read(len(MAGIC)) != MAGIC:
            raise BadInput(f"{path} is no .mcap: it does not begin like one", field="file", expected="an .mcap")
        file.seek(0)
        try:
            with new.open("wb") as out:
                messages = _copy(file, out)
                out.flush()
                os.fsync(out.fileno())
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)
    return Repaired(messages, whole=False)


def _copy(file: BinaryIO, out: BinaryIO) -> int:
    """How many messages there were up to the first bytes that are no record of their kind: what follows them cannot be
    trusted.
    """
    writer = Writer(out, chunk_size=CHUNK, compression=CompressionType.ZSTD)
    writer.start(library="zmav")
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    messages = 0
    records = StreamReader(file, validate_crcs=True).records
    while True:
        try:
            record = next(records)
            if isinstance(record, DataEnd):
                break
            if isinstance(record, mcap_records.Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                about = record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                channels[record.id] = writer.register_channel(*about)
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Message):
                channel, data = channels[record.channel_id], record.data
                writer.add_message(channel, record.log_time, data, record.publish_time, record.sequence)
                messages += 1
        except (StopIteration, *DAMAGE):
            break
    writer.finish()  # type: ignore[no-untyped-call]
    return messages
