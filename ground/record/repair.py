"""Give a .mcap that was cut short the end it lacks: what is whole of it is written again, with a summary."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Channel, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from ground.record.folder import MAGIC, is_whole
from ground.record.mcapfile import CHUNK, DAMAGE
from zmav.errors import BadInput


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
    with path.open("rb") as file:
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
            if isinstance(record, Schema) and record.id not in schemas:
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
