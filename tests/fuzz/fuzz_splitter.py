"""Fuzz the splitter, and the codec behind it, with torn, spoilt and invented streams.

    python tests/fuzz/fuzz_splitter.py --seconds 10 --seed 1     (or --runs 5000; --hex BYTES tries one input again)

Where atheris is installed it chooses the inputs by coverage (--plain forbids it); otherwise valid frames are mutated at
random. Every input is held against what must be true of any stream; the first that fails is printed in hex.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import random
import sys
import time
from dataclasses import asdict
from typing import Any

import msgspec

from zmav.mavlink import Dialect, Frame, Packer, Splitter, describe, encode, load_dialect, parse_frame
from zmav.mavlink.checksum import checksum


def check(dialect: Dialect, data: bytes) -> None:
    """What must be true of any bytes; AssertionError (or whatever it raises) is a bug."""
    splitter = Splitter(dialect)
    frames = splitter.feed(data)
    counters = splitter.counters
    pending = len(splitter._partial)
    assert pending < 280
    assert counters.bytes == len(data)
    assert counters.frames == len(frames)
    assert counters.bytes == counters.garbage + pending + sum(len(frame.data) for frame in frames)
    assert counters.unknown == sum(not frame.verified for frame in frames)
    assert counters.lost == sum(source.lost for source in splitter.sources.values()) >= 0

    rng = random.Random(len(data) + sum(data))
    chopped = Splitter(dialect)
    again = [frame for part in chop(data, rng) for frame in chopped.feed(part)]
    assert again == frames
    assert asdict(chopped.counters) == asdict(counters)
    assert chopped.sources == splitter.sources

    place = 0
    for frame in frames:
        found = data.find(frame.data, place)
        assert found >= place
        place = found + len(frame.data)
        check_frame(dialect, frame)


def check_frame(dialect: Dialect, frame: Frame) -> None:
    assert parse_frame(frame.data, dialect) == frame
    shown = describe(frame, dialect)
    assert msgspec.json.decode(msgspec.json.encode(shown)) == msgspec.to_builtins(shown)
    assert shown.verified == frame.verified
    if frame.verified:
        data = encode(dialect, shown.name, shown.fields, sysid=shown.sysid, compid=shown.compid, seq=shown.seq)
        back = describe(parse_frame(data, dialect), dialect)
        assert back.fields == {name: value_as_encoded(value) for name, value in shown.fields.items()}


def value_as_encoded(value: Any) -> Any:
    """Bytes that were no text come back as question marks."""
    return value.replace("\ufffd", "?") if isinstance(value, str) else value


def chop(data: bytes, rng: random.Random) -> list[bytes]:
    parts = []
    place = 0
    while place < len(data):
        size = rng.choice([1, 2, 3, 11, 21, 60, 300])
        parts.append(data[place : place + size])
        place += size
    return parts


class Mutator:
    """Streams of frames, most of them with something wrong."""

    def __init__(self, dialect: Dialect, rng: random.Random) -> None:
        self.dialect = dialect
        self.rng = rng
        self.names = sorted(dialect.by_name)

    def stream(self) -> bytes:
        return b"".join(self.piece() for _ in range(self.rng.randint(1, 6)))

    def piece(self) -> bytes:
        kind = self.rng.random()
        if kind < 0.15:
            return self.rng.randbytes(self.rng.randint(0, 40))
        frame = self.frame()
        if kind < 0.4:
            return frame
        for _ in range(self.rng.randint(1, 3)):
            frame = self.spoil(frame)
        # Half of the spoilt ones get a right checksum again, so that they are not all turned away at the door.
        return self.repair(frame) if kind < 0.7 else frame

    def frame(self) -> bytes:
        message = self.dialect.by_name[self.rng.choice(self.names)]
        version = 1 if message.id < 256 and self.rng.random() < 0.3 else 2
        data = Packer(self.dialect, self.rng.randint(0, 3), 1, version=version).pack(message.name)
        header = 6 if version == 1 else 10
        payload = self.rng.randbytes(data[1] if version == 1 else self.rng.randint(0, message.max_length))
        return self.repair(bytes([data[0], len(payload)]) + data[2:header] + payload + b"\0\0")

    def spoil(self, frame: bytes) -> bytes:
        place = self.rng.randrange(len(frame) + 1)
        how = self.rng.randrange(5)
        if how == 0:
            return frame[:place]
        if how == 1:
            return frame[:place] + self.rng.randbytes(self.rng.randint(1, 4)) + frame[place:]
        if how == 2:
            return frame[:place] + frame[place + self.rng.randint(1, 4) :]
        value = self.rng.choice([0, 1, 2, 0xFD, 0xFE, 0xFF, self.rng.randrange(256)])
        return frame[:place] + bytes([value]) + frame[place + 1 :]

    def repair(self, frame: bytes) -> bytes:
        header = {0xFD: 10, 0xFE: 6}.get(frame[0], 0) if frame else 0
        if not header or len(frame) < header:
            return frame
        end = header + frame[1]
        body = frame[1:end].ljust(end - 1, b"\0")
        msgid = int.from_bytes(body[6:9], "little") if header == 10 else body[4]
        message = self.dialect.by_id.get(msgid)
        crc_extra = message.crc_extra if message else 0
        signature = bytes(13) if header == 10 and body[1] == 1 else b""
        return frame[:1] + body + checksum(body, crc_extra).to_bytes(2, "little") + signature


def run_plain(dialect: Dialect, seed: int, runs: int | None, seconds: float | None) -> int:
    """Mutate until the runs or the seconds are over; the number of inputs that were tried."""
    mutator = Mutator(dialect, random.Random(seed))
    ends = time.monotonic() + seconds if seconds is not None else None
    tried = 0
    while (runs is None or tried < runs) and (ends is None or time.monotonic() < ends):
        data = mutator.stream()
        try:
            check(dialect, data)
        except Exception:
            print(f"seed {seed}, input {tried}; try it again with --hex {data.hex()}", file=sys.stderr)
            raise
        tried += 1
    return tried


def run_atheris(dialect: Dialect, seed: int, runs: int | None, seconds: float | None) -> None:
    atheris = importlib.import_module("atheris")
    atheris.instrument_all()
    arguments = [sys.argv[0], f"-seed={seed}", "-max_len=2000"]
    if runs is not None:
        arguments.append(f"-runs={runs}")
    if seconds is not None:
        arguments.append(f"-max_total_time={max(1, round(seconds))}")

    def mutate(data: bytes, max_size: int, chosen: int) -> bytes:
        """Its own mutations, with frames among them: by chance alone it would meet no right checksum."""
        rng = random.Random(chosen)
        place = rng.randrange(len(data) + 1)
        if rng.random() < 0.3:
            data = data[:place] + Mutator(dialect, rng).piece() + data[place:]
        mutated: bytes = atheris.Mutate(data[:max_size], max_size)
        return mutated

    atheris.Setup(arguments, lambda data: check(dialect, data), custom_mutator=mutate)
    atheris.Fuzz()


def main() -> None:
    options = argparse.ArgumentParser(description="Fuzz the MAVLink splitter and codec.")
    options.add_argument("--seconds", type=float, help="stop after so long (default: 10, unless --runs is given)")
    options.add_argument("--runs", type=int, help="stop after so many inputs")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--plain", action="store_true", help="random mutation even where atheris is installed")
    options.add_argument("--hex", type=bytes.fromhex, help="try this one input, and nothing else")
    given = options.parse_args()
    dialect = load_dialect("ardupilotmega")
    seconds = 10.0 if given.seconds is None and given.runs is None else given.seconds
    if given.hex is not None:
        check(dialect, given.hex)
        print("nothing wrong with it")
    elif not given.plain and importlib.util.find_spec("atheris"):
        run_atheris(dialect, given.seed, given.runs, seconds)
    else:
        print(f"{run_plain(dialect, given.seed, given.runs, seconds)} inputs, nothing found (seed {given.seed})")


if __name__ == "__main__":
    main()
