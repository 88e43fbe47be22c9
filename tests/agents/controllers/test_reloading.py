"""Processes of controllers without a vehicle: what users write wrongly, and what must go on whatever they do."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from agents.controllers import Controller
from agents.controllers.packets import Answer, pack_cycle
from agents.controllers.reloading import ControllerReloader
from agents.controllers.types import LEVELS, Reference, State, Trim
from agents.controllers.worker import Loaded, Worker, WorkerEvents
from zmav.cli.agent import resolve
from zmav.errors import BadConfig, ZmavError
from zmav.waiting import on_loop

IN_FORCE, LOOKING_ON = 1, 0
GOOD = """
import os, threading, time
import numpy as np
from agents.controllers import Controller, RatesThrust, parameter

class Mine(Controller):
    level = "attitude"
    kp = parameter(6.0, 0.0, 20.0)
    # more

    def __init__(self, tuned=None):
        super().__init__(tuned)
        self.kept = 0.0
        # made

    def reset(self, state, reference, trim):
        self.kept = 0.0
        # reset

    def update(self, state, reference):
        self.kept += 1.0
        # update
        self.signal(kept=self.kept, kp=self.kp)
        return RatesThrust(np.zeros(3), 0.5)
"""


def changed(**places: str) -> str:
    """The good class with a line more at each place."""
    text = GOOD
    for place, line in places.items():
        indent = "    " if place == "more" else "        "
        text = text.replace(f"{indent}# {place}\n", f"{indent}{line}\n")
    return text


class Bench:
    """A reloader, who flies by it, and what its processes say."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.flies: list[Worker | None] = []
        self.answers: asyncio.Queue[Answer] = asyncio.Queue()
        self.failed: asyncio.Queue[str] = asyncio.Queue()
        self.because: asyncio.Queue[str] = asyncio.Queue()
        loop = asyncio.get_running_loop()
        answered, failed, because = (
            on_loop(loop, lambda worker, said, queue=queue: queue.put_nowait(said))
            for queue in (self.answers, self.failed, self.because)
        )
        self.shop = ControllerReloader(
            str(path), self.flies.append, lambda loaded: self.agree(loaded), WorkerEvents(answered, failed, because)
        )

    def agree(self, loaded: Loaded) -> None:
        """As the supervisor would."""

    async def load(self, text: str, **values: float) -> None:
        self.path.write_text(text)
        await self.shop.load(values)

    def send(self, phase: int = IN_FORCE) -> None:
        assert self.shop.worker is not None
        assert self.shop.worker.send(pack_cycle(1, phase, State(), Reference(LEVELS[0]), Trim()))

    async def cycle(self, phase: int = IN_FORCE) -> dict[str, float]:
        """Its signals after one."""
        self.send(phase)
        answer = await asyncio.wait_for(self.answers.get(), 30.0)
        assert self.shop.worker is not None
        return dict(zip(self.shop.worker.names, answer.signals, strict=True))


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    bench = Bench(tmp_path / "mine.py")
    try:
        yield bench
    finally:
        bench.shop.close()


async def test_a_class_loaded_in_place_of_a_dead_one_is_reset_before_it_flies(bench: Bench) -> None:
    await bench.load(changed(reset="self.kept = 100.0"))
    assert (await bench.cycle())["kept"] == 101.0
    assert (await bench.cycle())["kept"] == 102.0


async def test_what_was_refused_leaves_no_process_and_the_next_is_loaded(bench: Bench) -> None:
    await bench.load(GOOD)

    def disagree(loaded: Loaded) -> None:
        raise KeyError("planted")

    bench.agree = disagree  # type: ignore[method-assign]
    for _ in range(3):
        with pytest.raises(KeyError):
            await bench.load(GOOD)
    del bench.agree
    await bench.load(GOOD, kp=7.0)
    assert (await bench.cycle())["kp"] == 7.0
    assert len(children()) == 1


async def test_many_reloads_leave_nothing_behind(bench: Bench) -> None:
    await bench.load(GOOD)
    await bench.load(GOOD)
    before = len(list(Path("/proc/self/fd").iterdir())), len(children())
    for _ in range(4):
        await bench.load(GOOD)
        with pytest.raises(BadConfig):
            await bench.load("1 / 0")
    assert (len(list(Path("/proc/self/fd").iterdir())), len(children())) == before


async def test_the_processes_that_a_class_starts_end_with_it(bench: Bench) -> None:
    started = "import subprocess; self.other = subprocess.Popen(['sleep', '600'])"
    await bench.load(changed(made=started, update="self.signal(pid=self.other.pid)"))
    other = int((await bench.cycle())["pid"])
    assert Path(f"/proc/{other}").exists()
    bench.shop.close()
    for _ in range(1000):
        if not Path(f"/proc/{other}").exists() or "\nState:\tZ" in Path(f"/proc/{other}/status").read_text():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("what it started goes on")


async def test_a_reset_that_fails_for_a_while_is_no_silence(bench: Bench) -> None:
    await bench.load(changed(more="times = 0", reset="self.times += 1; assert self.times in (1, 5), 'planted'"))
    bench.send(LOOKING_ON)
    for _ in range(3):  # the first of them is said
        await bench.cycle(LOOKING_ON)
    assert "planted" in await asyncio.wait_for(bench.because.get(), 30.0)
    await bench.cycle(LOOKING_ON)


async def test_a_tune_of_its_own_that_fails_is_told_and_nothing_ends(bench: Bench) -> None:
    own = "def tune(self, name, value):\n        assert value < 10.0, 'planted'\n        super().tune(name, value)"
    await bench.load(changed(more=own))
    assert bench.shop.worker is not None
    bench.shop.worker.tune("kp", 12.0)
    assert "planted" in await asyncio.wait_for(bench.because.get(), 30.0)
    assert (await bench.cycle())["kp"] == 6.0


WRONG = (
    (changed(update="self.signal(map=np.zeros(20_000))"), "signals are too many"),
    (changed(update="raise ValueError('x' * 1_000_000)"), "ValueError: xxx"),
    (changed(more="signals = parameter(1.0, 0.0, 2.0)"), "Mine.signals is"),
    (changed(more="reset = parameter(1.0, 0.0, 2.0)").replace("def reset", "def other"), "Mine.reset is"),
    (GOOD.replace('level = "attitude"', "level = parameter(1.0, 0.0, 2.0)"), "Mine.level is"),
    (GOOD.replace("parameter(6.0", "parameter(float('nan')"), "mine.py:8: .*default"),
    (GOOD.replace("parameter(6.0", "parameter(60.0"), "mine.py:8: .*default"),
    (GOOD.replace("parameter(6.0", "parameter('six'"), "mine.py:8: ValueError"),
    ("import sys; sys.exit()", "SystemExit"),
    ("import os; os._exit(5)", "exit status 5"),
    ("", "expected one class derived from Controller"),
    (GOOD + GOOD.replace("Mine", "Other"), "Mine, Other"),
    (GOOD.replace('level = "attitude"', "pass"), "with a level and an update; there are: Mine"),
    (GOOD.replace("def update", "def updates"), "with a level and an update; there are: Mine"),
)
"""texts, and what is said of each"""


async def test_what_is_wrong_is_said_in_words_and_what_flew_before_goes_on(bench: Bench) -> None:
    await bench.load(GOOD)
    for number, (text, why) in enumerate(WRONG):
        with pytest.raises(BadConfig, match=why):
            await bench.load(text)
        assert (await bench.cycle())["kept"] == number + 1.0, why


def test_a_class_without_an_update_cannot_be_made() -> None:
    with pytest.raises(TypeError, match="update"):
        type("Idle", (Controller,), {"level": "rates"})()


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace("parameter(6.0, 0.0, 20.0)", "parameter(np.float32(6.0), np.int64(0), np.float64(20.0))"),
        changed(made="self.lock, self.file = threading.Lock(), open(os.devnull)"),
        changed(made="threading.Thread(target=time.sleep, args=(600.0,), daemon=True).start()"),
        changed(update="print('words ' * 10_000)"),
        changed(update="state.pos += 1.0; reference.pos *= np.nan; state.q[:] = 0.0"),
        changed(update="return RatesThrust([np.float32(0), 0, np.int64(0)], np.float32(0.5))").replace(
            "self.kept += 1.0", "self.kept += 1.0; self.signal(kept=self.kept, kp=np.float32(6.0))"
        ),
    ],
)
async def test_what_is_no_mistake_flies(bench: Bench, text: str) -> None:
    await bench.load(text)
    signals = await bench.cycle()
    assert (signals["kept"], signals["kp"]) == (1.0, 6.0)
    assert math.isclose((await bench.cycle())["kept"], 2.0)


async def test_a_file_that_is_gone_or_a_directory(bench: Bench) -> None:
    await bench.load(GOOD)
    bench.path.unlink()
    with pytest.raises(BadConfig, match="there is no file"):
        await bench.shop.load({})
    bench.path.mkdir()
    with pytest.raises(BadConfig, match="there is no file"):
        await bench.shop.load({})
    bench.path.rmdir()
    await bench.load(GOOD)


async def test_a_file_that_is_no_text_is_said_to_be_none(bench: Bench) -> None:
    bench.path.write_bytes(b"x = '\xff'\nclass Mine: pass\n")
    _, given = resolve(str(bench.path))
    assert given == {"controller": str(bench.path)}
    with pytest.raises(BadConfig, match=r"(?i)utf-8"):
        await bench.shop.load({})


async def test_nothing_is_loaded_any_more_once_it_is_closed(bench: Bench) -> None:
    bench.path.write_text(changed(more="time.sleep(600.0)"))
    loading = asyncio.create_task(bench.shop.load({}))
    while not children():
        await asyncio.sleep(0.01)
    bench.shop.close()
    assert children() == []
    loading.cancel()
    await asyncio.gather(loading, return_exceptions=True)
    with pytest.raises(ZmavError, match="ends"):
        await bench.shop.load({})
    assert children() == []


def test_a_loop_without_an_end_does_not_outlive_a_supervisor_that_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "stuck.py"
    path.write_text("print('stuck', flush=True)\nwhile True:\n    pass\n")
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [sys.executable, "-m", "agents.controllers.host", str(theirs.fileno())]
    with subprocess.Popen(command, pass_fds=[theirs.fileno()], stdout=subprocess.PIPE) as process:
        try:
            theirs.close()
            ours.send(b'j{"load": {"what": "%s", "tuned": {}}}' % str(path).encode())
            assert process.stdout is not None
            assert process.stdout.readline() == b"stuck\n"
            ours.close()
            assert process.wait(30.0) == 0
        finally:
            process.kill()


def children() -> list[str]:
    """Processes that this one has started and that have not ended."""
    found = []
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):
            found += (task / "children").read_text().split()
    return found
