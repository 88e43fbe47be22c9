"""Give a .mcap that was cut short the end it lacks, in its place: its last whole chunk's index, and its summary.

Only what is torn, at the very end, is cut off; nothing before it is written again. What follows is what the writer
would have written: the same records by the same library. https://mcap.dev/spec#summary-section
"""

from __future__ import annotations

import fcntl
import io
import os
import struct
import zlib
from collections import defaultdict
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from ground.record.folder import is_whole
from ground.record.mcapfile import DAMAGE
from zmav.errors import BadInput

_HEAD = struct.Struct("<BQ")
"""of a record: what it is, and how long"""
_MESSAGE = struct.Struct("<HIQ")
"""how a message begins: channel, sequence, time of recording"""


class Repaired(NamedTuple):
    """What was found and done."""

    messages: int
    cut: int
    """bytes that were cut off"""
    whole: bool
    """it had its summary: nothing was done"""


def repair(path: Path) -> Repaired:
    """Complete ``path``. :class:`BadInput` for what is no .mcap; OSError where it cannot be read, a recorder still
    writes it, or the disk is full: then it is as it was, but for its torn end.
    """
    if is_whole(path):
        return Repaired(0, 0, whole=True)
    with path.open("r+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as e:
            raise OSError(e.errno, "a recorder still writes it") from e
        found = _Found(file)
        file.seek(found.end)
        file.truncate()
        try:
            file.write(found.rest())
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            os.ftruncate(file.fileno(), found.end)
            raise
    return Repaired(found.statistics.message_count, found.size - found.end, whole=False)


class _Found:
    """What a file without a summary holds; ``end`` is where its last whole record does."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = file.seek(0, os.SEEK_END)
        file.seek(0)
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            text = f"{getattr(file, 'name', 'it')} is no .mcap: it does not begin like one"
            raise BadInput(text, field="file", expected="an .mcap")
        self.end = len(MCAP0_MAGIC)
        self.statistics = Statistics(
            attachment_count=0,
            channel_count=0,
            channel_message_counts=defaultdict(int),
            chunk_count=0,
            message_count=0,
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=0,
        )
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._indices: dict[int, MessageIndex] = {}
        """of the last chunk's messages"""
        self._indices_end = 0
        self._read_all()
        self._last_chunk_begins_the_end()

    def _read_all(self) -> None:
        while True:
            self._file.seek(self.end)
            head = self._file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                return
            opcode, length = _HEAD.unpack(head)
            after = self.end + _HEAD.size + length
            if after > self.size or opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            try:
                self._take(opcode, length)
            except DAMAGE:
                return  # bytes that are no record of its kind: what follows cannot be trusted
            self.end = after

    def _take(self, opcode: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            self._chunk(Chunk.read(self._stream(length)), length)
        elif opcode == Opcode.SCHEMA:
            self._schema(Schema.read(self._stream(length)))
        elif opcode == Opcode.CHANNEL:
            self._channel(Channel.read(self._stream(length)))
        elif opcode == Opcode.METADATA:
            name = Metadata.read(self._stream(length)).name
            self._metadata.append(MetadataIndex(length=_HEAD.size + length, name=name, offset=self.end))
            self.statistics.metadata_count += 1
        elif opcode == Opcode.MESSAGE_INDEX and self._chunks:
            channel = MessageIndex.read(self._stream(length)).channel_id
            chunk = self._chunks[-1]
            chunk.message_index_offsets[channel] = self.end
            chunk.message_index_length += _HEAD.size + length

    def _stream(self, length: int) -> ReadDataStream:
        return ReadDataStream(io.BytesIO(self._file.read(length)))

    def _schema(self, schema: Schema) -> None:
        self._schemas[schema.id] = schema

    def _channel(self, channel: Channel) -> None:
        self._channels[channel.id] = channel

    def _chunk(self, chunk: Chunk, length: int) -> None:
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        data = stream.read(size)
        indices: dict[int, MessageIndex] = {}
        at = 0
        while at + _HEAD.size <= len(data):
            opcode, record = _HEAD.unpack_from(data, at)
            body = at + _HEAD.size
            if opcode == Opcode.MESSAGE:
                channel, _, time = _MESSAGE.unpack_from(data, body)
                index = indices.get(channel) or indices.setdefault(channel, MessageIndex(channel, []))
                index.records.append((time, at))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                inner = ReadDataStream(io.BytesIO(data[body : body + record]))
                if opcode == Opcode.SCHEMA:
                    self._schema(Schema.read(inner))
                else:
                    self._channel(Channel.read(inner))
            at = body + record
        self._count(indices)
        self._indices = indices
        self._indices_end = self.end + _HEAD.size + length
        self._chunks.append(
            ChunkIndex(
                chunk_length=_HEAD.size + length,
                chunk_start_offset=self.end,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def _count(self, indices: dict[int, MessageIndex]) -> None:
        counts = self.statistics
        for channel, index in indices.items():
            times = [time for time, _ in index.records]
            first, last = min(times), max(times)
            counts.message_start_time = min(counts.message_start_time, first) if counts.message_count else first
            counts.message_end_time = max(counts.message_end_time, last)
            counts.message_count += len(times)
            counts.channel_message_counts[channel] += len(times)

    def _last_chunk_begins_the_end(self) -> None:
        """The last chunk's index may be torn: it is written again."""
        if self._chunks and len(self._chunks[-1].message_index_offsets) < len(self._indices):
            self.end = self._indices_end
        else:
            self._indices = {}

    def rest(self) -> bytes:
        """What the file lacks from ``end``."""
        out = RecordBuilder()
        if self._indices:
            chunk = self._chunks[-1]
            chunk.message_index_offsets = {}
            for channel, index in self._indices.items():
                chunk.message_index_offsets[channel] = self.end + out.count
                index.write(out)
            chunk.message_index_length = out.count
        DataEnd(0).write(out)
        start = self.end + out.count
        summary = self._summary(start)
        footer = RecordBuilder()
        Footer(summary_offset_start=summary.offsets_at, summary_start=start, summary_crc=summary.crc).write(footer)
        return b"".join((_bytes(out), summary.data, _bytes(footer), MCAP0_MAGIC))

    def _summary(self, start: int) -> _Summary:
        counts = self.statistics
        counts.schema_count, counts.channel_count = len(self._schemas), len(self._channels)
        counts.chunk_count = len(self._chunks)
        groups = (
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [counts]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        out, offsets = RecordBuilder(), list[SummaryOffset]()
        for opcode, records in groups:
            at = out.count
            for record in records:
                record.write(out)
            if out.count > at:
                offsets.append(SummaryOffset(group_opcode=opcode, group_start=start + at, group_length=out.count - at))
        offsets_at = start + out.count
        for offset in offsets:
            offset.write(out)
        data = _bytes(out)
        # The footer's own fields are part of what its checksum is of.
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_at), zlib.crc32(data))
        return _Summary(data, offsets_at, crc)


def _bytes(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]


class _Summary(NamedTuple):
    data: bytes
    offsets_at: int
    crc: int
