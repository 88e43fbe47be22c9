"""How a process lives on when nobody reads what it says."""

from __future__ import annotations

import os
import sys

import pytest

from zmav.process import say


def test_what_nobody_reads_ends_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    say("a line")
    assert capsys.readouterr().err == "a line\n"
    reader, writer = os.pipe()
    os.close(reader)
    stream = os.fdopen(writer, "w", buffering=1)
    monkeypatch.setattr(sys, "stderr", stream)
    with pytest.raises(BrokenPipeError):
        print("a line", file=stream)
    say("a line")
    os.close(writer)
    say("a line")
    monkeypatch.undo()
    with pytest.raises(OSError, match="Bad file descriptor"):
        stream.close()
