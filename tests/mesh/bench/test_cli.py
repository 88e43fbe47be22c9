"""``zmav mesh bench``: what a person and a script get of it."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from typing import Any

import pytest
from click.testing import CliRunner

import zmav
from mesh.bench.flow import Flow, Stream
from mesh.cli import bench as verb
from tests.conftest import PATIENCE_S
from tests.mesh.bench.conftest import Start, idle
from zmav.errors import BadInput
from zmav.session import SessionSettings
from zmav.waiting import within
from zmav.wire.bench import BenchClock, BenchInterval, BenchReport, Spread

KINDS: list[tuple[str, dict[str, Any], list[str]]] = [
    ("rtt", {"seconds": 0.3}, ["quad1 > quad2: realtime, 64 B, 50 Hz", "0/15"]),
    ("stream", {"seconds": 0.2, "hz": 50.0}, ["quad1 > quad2", "one way", "(0 %)"]),
    ("recover", {"seconds": 0.2, "hz": 5.0}, ["silences of 1.00 s", "no outage longer than 1.00 s"]),
]


async def test_each_kind_is_told_in_words(line: Start, capsys: pytest.CaptureFixture[str]) -> None:
    made, _ = await line("quad1", "quad2")
    settings = SessionSettings(connect=[made.endpoints["quad1"]])
    for kind, more, said in KINDS:
        async with zmav.open(fleet="demo", settings=settings) as z:
            await verb.measure(z, "quad1", "quad2", kind, verb.wanted(kind, **more))
        printed = capsys.readouterr().out
        for words in said:
            assert words in printed, printed
        await asyncio.gather(*map(idle, made.responders.values()))


async def test_ctrl_c_shows_the_totals_and_ends_it_on_the_hosts(line: Start) -> None:
    made, _ = await line("quad1", "quad2")
    command = ["mesh", "bench", "quad1", "quad2", "--seconds", "600", "--hz", "20", "-e", made.endpoints["quad1"]]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "zmav", *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    for _ in range(3):  # what is measured, the table's head, the first second
        first = (await within(PATIENCE_S, process.stdout.readline())).decode()
    assert "0.0-1.0 s" in first
    process.send_signal(signal.SIGINT)
    out, err = await within(PATIENCE_S, process.communicate())
    assert (process.returncode, err) == (0, b"")
    assert "quad1 sent" in out.decode()
    assert all(responder.busy is None or responder.busy.over for responder in made.responders.values())


async def test_json_holds_each_second_and_the_whole(line: Start, capsys: pytest.CaptureFixture[str]) -> None:
    made, _ = await line("quad1", "quad2")
    stream = verb.wanted("stream", seconds=1.0, hz=50.0, size=100)
    async with zmav.open(fleet="demo", connect=[made.endpoints["quad1"]]) as z:
        await verb.measure(z, "quad1", "quad2", "stream", stream, as_json=True)
    *intervals, flow = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert [each["interval"]["received"] for each in intervals] == [each["received"] for each in flow["intervals"]]
    assert flow["total"]["received"] == flow["sender"]["sent"]
    assert abs(flow["sender"]["clock"]["offset"]) <= flow["sender"]["clock"]["within"]


@pytest.mark.parametrize("arguments", [["--rate", "fast"], ["--rate", "1k", "--hz", "5"]])
def test_what_cannot_be_is_said(arguments: list[str]) -> None:
    given = dict(zip((a.strip("-") for a in arguments[::2]), arguments[1::2], strict=True))
    hz = float(given["hz"]) if "hz" in given else None
    with pytest.raises(BadInput) as caught:
        verb.wanted("stream", rate=given["rate"], hz=hz)
    assert caught.value.detail["field"] == "rate"


def test_numbers_that_no_stream_has_are_refused_at_once() -> None:
    wrong = [("--size", "0"), ("--size", "1000000"), ("--seconds", "1e9"), ("--hz", "0")]
    for option, value in (*wrong, *((name, number) for name in ("--hz", "--seconds") for number in ("nan", "inf"))):
        found = CliRunner().invoke(verb.command, ["a", "b", option, value])
        assert found.exit_code == 2, found.output
        assert f"Invalid value for '{option}'" in found.output


def test_the_table_is_that_of_iperf() -> None:
    """Ten datagrams of a thousand bytes in a second, of twelve that were sent; the target's clock is 5 s ahead."""
    transit = Spread(count=10, min=5.01, median=5.02, p95=5.03, p99=5.04, max=5.05)
    total = BenchInterval(
        start=0.0,
        end=1.0,
        bytes=10_000,
        received=10,
        expected=12,
        jitter=0.0015,
        transit=transit,
    )
    clock = BenchClock(offset=5.0, within=0.004, utc_offset=0.0)
    report = BenchReport(run="r", host="quad1", role="send", state="done", clock=clock)
    flow = Flow(stream=Stream(), source="quad1", target="quad2", sender=report, receiver=report)
    words = verb.interval_line(flow, total).split()
    assert words == [
        "0.0-1.0",
        "s",
        "10.00",
        "kB",
        "80.00",
        "kbit/s",
        "1.50",
        "ms",
        "2/12",
        "(17",
        "%)",
        "20.00",
        "ms",
    ]
