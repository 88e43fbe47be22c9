"""How a verb's process ends: with its code, whatever Zenoh's threads still do."""

from __future__ import annotations

import subprocess
import sys

import pytest

VERB = """
import atexit, sys, threading
import click
from zmav import cli
from zmav.direct import direct
from zmav.process import free_port
from zmav.session import SessionSettings, open_session

left = []

@click.command()
def verb():
    at = f"tcp/127.0.0.1:{{free_port()}}"
    router = open_session(SessionSettings(mode="router", listen=[at]))
    client = open_session(SessionSettings(connect=[at]))
    heard = threading.Event()

    def take(sample):
        heard.set()
        client.put("a", b"again")  # so that messages come while the process ends

    left.extend((router, client, router.declare_subscriber("a", direct(take))))
    while not heard.wait(0.05):
        client.put("a", b"first")
    atexit.register(lambda: print("at the exit"))
    print("done", end=" ")
    {end}

cli.zmav = verb
cli.main()
"""


@pytest.mark.parametrize(
    ("end", "code", "words"),
    [
        ("pass", 0, ""),
        ("sys.exit(3)", 3, ""),
        ("sys.exit('why')", 1, "why\n"),
        ("raise ValueError('a defect')", 1, "ValueError: a defect\n"),
    ],
    ids=["done", "code", "words", "defect"],
)
def test_a_verb_ends_with_its_code_while_zenoh_s_threads_bring_messages(end: str, code: int, words: str) -> None:
    """The interpreter's own end is aborted by them, in every second run or so."""
    for _ in range(4):
        done = subprocess.run([sys.executable, "-c", VERB.format(end=end)], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stdout) == (code, "done at the exit\n"), done.stderr
        assert done.stderr.endswith(words)
