"""A short run of every target by a seed, its corpus first; and proof that a fault would be found."""

from __future__ import annotations

import logging
import random
from pathlib import Path

import pytest

from tests.fuzz import engine
from tests.fuzz.engine import Found, Target, fuzz, mutated, pure
from tests.fuzz.targets import TARGETS
from tests.fuzz.targets.frames import stream, the_dialect
from tests.fuzz.targets.live import watched
from zmav import wire
from zmav.errors import BadInput
from zmav.mavlink import Splitter

SEED = 22
FEW = 500


@pytest.mark.parametrize("name", TARGETS)
def test_nothing_but_typed_errors(name: str) -> None:
    tried = fuzz(TARGETS[name], SEED, inputs=TARGETS[name].quick)
    assert tried.inputs > TARGETS[name].quick
    assert tried.taken > 0, "its examples are not taken: nothing behind the first check is tried"


def test_every_folder_of_the_corpus_is_a_target_s() -> None:
    assert {folder.name for folder in engine.CORPUS.iterdir()} <= set(TARGETS)


def test_a_fault_is_found_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that trusts a length."""

    def careless(data: bytes) -> None:
        if data[:1] != b"L":
            raise BadInput("it begins otherwise")
        _ = data[2:][data[1]]

    monkeypatch.setattr(engine, "CORPUS", tmp_path)
    target = Target("careless", pure(careless), lambda: [b"L\x01ab"])
    with pytest.raises(Found, match=f"seed {SEED}") as found:
        fuzz(target, SEED, inputs=FEW)
    assert isinstance(found.value.error, IndexError)
    with pytest.raises(Found) as again:
        fuzz(target, SEED, inputs=FEW)
    assert again.value.data == found.value.data, "a seed says what is tried"
    target.keep(found.value.data)
    with pytest.raises(Found) as kept:
        fuzz(target, SEED + 1, inputs=0)
    assert kept.value.data == found.value.data


def test_streams_are_worth_something() -> None:
    """The mutations reach every verdict of the splitter."""
    target, rng, splitter = TARGETS["frames"], random.Random(5), Splitter(the_dialect())
    known = target.examples()
    assert target.mutate is stream
    for _ in range(FEW):
        splitter.feed(mutated(target, rng, known))
    counters = splitter.counters
    assert counters.frames > FEW / 2
    assert min(counters.unknown, counters.bad_crc, counters.bad_length, counters.bad_flags, counters.lost) > 0


def test_of_what_is_logged_our_errors_count_and_nobody_else_s() -> None:
    with watched() as faults:
        logging.getLogger("somelibrary").error("of its own")
        logging.getLogger().error("of a test before")
        faults.check()
        logging.getLogger("ground.http.server").error("ours")
        with pytest.raises(AssertionError, match="ours"):
            faults.check()
        try:
            wire.decode(b"?", wire.Order, "here")
        except BadInput:
            logging.getLogger("asyncio").exception("in a callback")
        with pytest.raises(AssertionError, match="in a callback"):
            faults.check()


def test_a_splitter_that_forgets_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that forgets a torn frame depends on the chopping."""

    class Forgetful(Splitter):
        def feed(self, data: bytes):  # type: ignore[no-untyped-def]
            frames = super().feed(data)
            self.partial = b""
            return frames

    monkeypatch.setattr("tests.fuzz.targets.frames.Splitter", Forgetful)
    with pytest.raises(Found) as found:
        fuzz(TARGETS["frames"], SEED, inputs=FEW)
    assert isinstance(found.value.error, AssertionError)
