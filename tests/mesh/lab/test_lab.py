"""A lab as its users have it: simulated vehicles behind routers, seen from outside."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

import zmav
from mesh.lab.lab import Lab
from mesh.lab.network import LabError
from tests.mesh.lab.conftest import StartLab, scenario
from tests.waiting import until
from zmav.errors import BadConfig, TimedOut

pytestmark = pytest.mark.root

PATIENCE_S = 60.0
PAIR: dict[str, Any] = {
    "hosts": {"h1": {"program": "none"}, "h2": {"program": "none"}},
    "media": [{"kind": "link", "between": ["h1", "h2"], "interface": "eth0"}],
}


async def test_a_vehicle_is_seen_through_the_lab_and_not_while_its_link_is_cut(start_lab: StartLab) -> None:
    lab = await start_lab(
        hosts={"ground": {"neighbours": ["quad1"]}, "quad1": {"vehicle": "copter", "neighbours": ["ground"]}},
        media=[{"kind": "link", "between": ["ground", "quad1"], "delay": "5 ms"}],
        credentials=True,
        fleet={"fleet": "alpha"},
    )
    await lab.ready()
    async with zmav.open(fleet=lab.fleet, connect=[await lab.endpoint("ground")]) as z:
        (quad,) = await z.wait_for("quad1", timeout=PATIENCE_S)
        assert lab.counters("ground-1")[1].arrived > 0
        lab.cut("ground-1")
        await until(lambda: quad.age is not None and quad.age > 2.0 and not quad.present, "silence")
        lab.heal("ground-1")
        await until(lambda: quad.age is not None and quad.age < 1.0 and quad.present, "the vehicle again")
        done = await lab.run_in("quad1", sys.executable, "-m", "zmav", "ls", "--json")
        assert '"quad1"' in done.stdout, done.stderr
        assert lab.failed is not None
        assert not lab.failed.done()


async def test_programs_run_in_hosts(start_lab: StartLab) -> None:
    lab = await start_lab(**PAIR)
    done = await lab.run_in("h2", "sh", "-c", "cat /proc/net/dev; echo $ZMAV_FLEET; exit 3")
    assert done.returncode == 3
    assert "eth0:" in done.stdout
    assert done.stdout.split()[-1] == "lab"
    with pytest.raises(TimedOut, match=r"took longer than 0\.2 s"):
        await lab.run_in("h2", "sleep", "1000", timeout=0.2)
    with pytest.raises(FileNotFoundError):
        await lab.run_in("h2", "no-such-program")
    with pytest.raises(BadConfig, match="no host 'h9'"):
        await lab.run_in("h9", "true")


async def test_files_are_gone_with_the_lab(start_lab: StartLab) -> None:
    lab = await start_lab(**PAIR)
    assert (lab.directory / "fleet.toml").exists()
    assert lab.directory.stat().st_mode & 0o077 == 0
    await lab.__aexit__(None, None, None)
    assert not lab.directory.exists()
    with pytest.raises(LabError, match="relay has died"):
        lab.cut("1-2")


async def test_a_directory_that_is_there_is_nobody_elses(able: None, tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="File exists; expected a directory that is not there yet"):
        async with Lab(scenario(**PAIR), tmp_path):
            pass
    assert tmp_path.exists()


async def test_a_program_that_cannot_run_is_told_with_its_last_words(start_lab: StartLab) -> None:
    lab = await start_lab(hosts={"h1": {"arguments": ["--no-such-option"]}})
    with pytest.raises(LabError, match=r"(?s)h1 has ended with code 2; it said:.*--no-such-option"):
        await lab.ready()


async def test_who_gives_up_waiting_leaves_nothing_behind(start_lab: StartLab) -> None:
    lab = await start_lab(**PAIR)
    before = asyncio.all_tasks()
    waiting = asyncio.ensure_future(lab.ready("h1", "h2"))
    await until(lambda: len(asyncio.all_tasks()) >= len(before) + 3, "both are looked for")
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    assert asyncio.all_tasks() == before
    assert lab.environment("h1")["ZMAV_CREDENTIALS"] == ""  # never the caller's own


async def test_ready_has_its_patience(start_lab: StartLab) -> None:
    lab = await start_lab(hosts={"h1": {"program": "none"}})
    with pytest.raises(TimedOut, match=r"the routers of h1 are not up within 0\.1 s"):
        await lab.ready("h1", timeout=0.1)
    with pytest.raises(BadConfig, match="no host 'h9'"):
        await lab.ready("h9")
