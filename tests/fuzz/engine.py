"""A fuzzer of one page: mutations of known inputs, by a seed, until something raises what it must not.

A target takes bytes and may raise :class:`~zmav.errors.ZmavError`, and nothing else: whatever comes from outside is
refused with a typed error or is taken. Its inputs are its own examples, which its module makes, and the files under
``corpus/<target>``: what was found once, and what a mutation hardly comes by.
"""

from __future__ import annotations

import hashlib
import random
import re
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from zmav.errors import ZmavError

CORPUS = Path(__file__).with_name("corpus")
LONGEST = 65_536
"""bytes of an input"""
TOKENS = (
    b"0",
    b"-1",
    b"1e999",
    b"-1e308",
    b"1e-320",
    b"NaN",
    b"Infinity",
    b"9" * 5001,
    b"0." + b"1" * 400,
    b"-0.0",
    b"18446744073709551616",
    b"9223372036854775807",
    b"-9223372036854775809",
    b"4294967296",
    b"2147483648",
    b"65536",
    b"256",
    b"null",
    b"true",
    b'""',
    b"[]",
    b"{}",
    b"[" * 1500,
    b'{"a":' * 1500,
    b'"\\ud800"',
    b"\xff\xfe",
    b"\x00",
    b"\xc3\x28",
    b"\n",
    b"\r\n",
    b"\t",
    b",",
    b":",
    b'"',
    b"'",
    b"{",
    b"}",
    b"=",
    b"#",
    b"/",
    b"..",
    b"*",
    b"@",
    b"%00",
    "٣²½".encode(),
    "\u2028".encode(),
    b" " * 300,
    b"A" * 300,
)
"""what readers of text and of numbers stumble over"""
EXTREMES = (0, 1, 0x7F, 0x80, 0xFE, 0xFF)
_NUMBER = re.compile(rb"-?[0-9]+(?:\.[0-9]+)?")
_WORD = re.compile(rb'"[^"\n]*"|[^\s,:={}\[\]"]+')

Run = Callable[[bytes], object]


@dataclass(frozen=True)
class Target:
    """``open`` gives what takes an input, for as long as it lasts; ``quick``: inputs in ``make test``."""

    name: str
    open: Callable[[], AbstractContextManager[Run]]
    examples: Callable[[], Sequence[bytes]]
    quick: int = 2000
    mutate: Callable[[random.Random, bytes], bytes | None] = field(default=lambda rng, data: None)
    """a mutation of the target's own; None leaves it to the engine"""

    def corpus(self) -> list[bytes]:
        """What its folder holds, by name."""
        return [path.read_bytes() for path in sorted((CORPUS / self.name).glob("*")) if path.is_file()]

    def keep(self, data: bytes) -> Path:
        """Save an input in its folder, for good."""
        folder = CORPUS / self.name
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / hashlib.sha256(data).hexdigest()[:12]
        path.write_bytes(data)
        return path


def pure(run: Run) -> Callable[[], AbstractContextManager[Run]]:
    """``Target.open`` for a function that needs nothing to be there."""
    return lambda: nullcontext(run)


class Found(Exception):
    """An input that broke its target; the cause is what it raised."""

    def __init__(self, target: Target, seed: int, number: int, data: bytes, error: BaseException) -> None:
        super().__init__(f"{target.name}: {error!r} at input {number} of seed {seed}: {data[:300]!r}")
        self.target, self.data, self.error = target, data, error


class Tried(NamedTuple):
    inputs: int
    taken: int
    """of those, without an error"""


def attempt(run: Run, data: bytes) -> bool:
    """True where it was taken, False where it was refused as it should be; raises what else comes."""
    try:
        run(data)
    except ZmavError:
        return False
    return True


def fuzz(target: Target, seed: int, inputs: int | None = None, seconds: float | None = None) -> Tried:
    """Try the corpus and the examples as they are, and then mutations of these; raises :class:`Found`.

    ``inputs``: mutations; ``seconds``: of this process's CPU.
    """
    known = [*target.examples(), *target.corpus()]
    assert known, f"{target.name} has no examples"
    rng = random.Random(f"{target.name} {seed}")
    ends = None if seconds is None else time.process_time() + seconds
    number = taken = 0
    with target.open() as run:
        while (inputs is None or number < inputs + len(known)) and (ends is None or time.process_time() < ends):
            data = known[number] if number < len(known) else mutated(target, rng, known)
            try:
                taken += attempt(run, data)
            except Exception as e:
                raise Found(target, seed, number, data, e) from e
            number += 1
    return Tried(number, taken)


def shrunk(target: Target, data: bytes, error: BaseException) -> bytes:
    """As little of an input as raises the same kind of error."""
    with target.open() as run:
        size = len(data) // 2
        while size:
            for at in range(0, len(data), size):
                less = data[:at] + data[at + size :]
                try:
                    attempt(run, less)
                except type(error):
                    data = less
                    break
                except Exception:
                    continue
            else:
                size //= 2
    return data


def mutated(target: Target, rng: random.Random, known: Sequence[bytes]) -> bytes:
    """One to four mutations, one after the other."""
    data = rng.choice(known)
    for _ in range(rng.choice((1, 1, 2, 4))):
        own = target.mutate(rng, data) if rng.random() < 0.5 else None
        data = rng.choice(MUTATIONS)(rng, data, rng.choice(known)) if own is None else own
    return data[:LONGEST]


def _flip(rng: random.Random, data: bytes, _: bytes) -> bytes:
    out = bytearray(data)
    for _times in range(rng.choice((1, 1, 3, 8))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _overwrite(rng: random.Random, data: bytes, _: bytes) -> bytes:
    """A field of one to eight bytes gets an extreme value: a length, a count, an offset."""
    at, size = _place(rng, data), rng.choice((1, 2, 4, 8))
    value = bytes([rng.choice(EXTREMES)]) * size if rng.random() < 0.7 else rng.randbytes(size)
    return data[:at] + value + data[at + size :]


def _cut(rng: random.Random, data: bytes, _: bytes) -> bytes:
    return data[: _place(rng, data)] if rng.random() < 0.5 else data[_place(rng, data) :]


def _take_out(rng: random.Random, data: bytes, _: bytes) -> bytes:
    at = _place(rng, data)
    return data[:at] + data[at + rng.choice((1, 2, 8, 40)) :]


def _repeat(rng: random.Random, data: bytes, _: bytes) -> bytes:
    at, size = _place(rng, data), rng.choice((1, 4, 16, 100))
    return data[:at] + data[at : at + size] * rng.choice((2, 3, 30)) + data[at + size :]


def _splice(rng: random.Random, data: bytes, other: bytes) -> bytes:
    return data[: _place(rng, data)] + other[_place(rng, other) :]


def _insert(rng: random.Random, data: bytes, _: bytes) -> bytes:
    at = _place(rng, data)
    return data[:at] + (rng.choice(TOKENS) if rng.random() < 0.8 else rng.randbytes(rng.choice((1, 4, 30)))) + data[at:]


def _renumber(rng: random.Random, data: bytes, _: bytes) -> bytes:
    return _exchange(rng, data, _NUMBER)


def _reword(rng: random.Random, data: bytes, _: bytes) -> bytes:
    return _exchange(rng, data, _WORD)


def _exchange(rng: random.Random, data: bytes, what: re.Pattern[bytes]) -> bytes:
    """One number or word of a text becomes another, of the text's own or out of the ordinary."""
    found = list(what.finditer(data[:LONGEST]))
    if not found:
        return data
    gone = rng.choice(found)
    new = rng.choice(TOKENS) if rng.random() < 0.6 else rng.choice(found)[0]
    return data[: gone.start()] + new + data[gone.end() :]


def _place(rng: random.Random, data: bytes) -> int:
    return rng.randrange(len(data) + 1)


MUTATIONS = (_flip, _overwrite, _cut, _take_out, _repeat, _splice, _insert, _renumber, _reword)
