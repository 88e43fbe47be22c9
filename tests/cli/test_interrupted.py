"""Ctrl-C at the times at which no verb has it in hand: never a traceback."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

VERB = """
import atexit, os, signal, sys
import click
from zmav import cli
from zmav.errors import ZmavError

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

class Interrupting(ZmavError):
    def __str__(self):
        interrupt()
        return "words"

@click.command()
def verb():
    {verb}

cli.zmav = verb
cli.main()
"""


@pytest.mark.parametrize(
    ("verb", "code"),
    [
        ("interrupt()", 130),
        ("raise Interrupting('x')", 130),
        ("atexit.register(interrupt)", -signal.SIGINT),
    ],
    ids=["at work", "while its error is said", "at the exit"],
)
def test_a_verb_that_is_interrupted_shows_no_traceback(verb: str, code: int) -> None:
    done = subprocess.run([sys.executable, "-c", VERB.format(verb=verb)], capture_output=True, text=True, timeout=60)
    assert "Traceback" not in done.stderr
    assert done.returncode == code
