"""The study's own parts: who is linked with whom, what is counted, what is fitted, and one small run of all."""

from __future__ import annotations

import json
import socket
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

from tests.bench.scale.__main__ import command
from tests.bench.scale.fit import COSTS, Cost, fit
from tests.bench.scale.group import GroupMember, GroupStates
from tests.bench.scale.meter import HEADERS, Meter
from tests.bench.scale.report import report
from tests.bench.scale.shorten import MOST_BYTES, parts
from tests.bench.scale.study import Run, Shape
from tests.bench.scale.topology import TOPOLOGIES, links
from zmav import wire
from zmav.cli.common import console


@pytest.mark.parametrize("kind", TOPOLOGIES)
@pytest.mark.parametrize("count", [1, 2, 5, 30])
def test_every_router_reaches_the_first(kind: Any, count: int) -> None:
    chosen = links(kind, count)
    assert len(chosen) == count
    assert chosen[0] == []
    assert all(others and all(0 <= j < i for j in others) for i, others in enumerate(chosen) if i)


def test_the_shapes() -> None:
    assert links("line", 4) == [[], [0], [1], [2]]
    assert links("star", 4) == [[], [0], [0], [0]]
    assert links("tree", 6) == [[], [0], [0], [0], [0], [1]]
    assert links("grid", 4) == [[], [0], [0], [2, 1]]


def test_the_meter_passes_and_counts() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as us,
    ):
        far.bind(("127.0.0.1", 0))
        far.settimeout(10.0)
        us.settimeout(10.0)
        with Meter(far.getsockname()[1]) as meter:
            us.sendto(b"x" * 100, ("127.0.0.1", meter.port))
            data, source = far.recvfrom(1000)
            far.sendto(b"y" * 30, source)
            assert (data, us.recv(1000)) == (b"x" * 100, b"y" * 30)
            assert (meter.up, meter.down) == (100 + HEADERS, 30 + HEADERS)


def a_run(vehicles: int, groups: int = 0, **values: Any) -> Run:
    shape = Shape(vehicles=vehicles, routers=2, groups=groups)
    rest = {name: 1 for name in Run.__struct_fields__ if name not in ("shape", *values)}
    return Run(shape=shape, **rest, **values)


def test_a_line_is_found_and_its_misses_are_said() -> None:
    bytes_of = Cost("x", "kB", 1e-3, lambda run: run.sync_bytes)
    line = fit([a_run(n, sync_bytes=5000 + 900 * n) for n in (10, 100, 1000)], bytes_of)
    assert line is not None
    assert line.fixed == pytest.approx(5.0)
    assert line.each == pytest.approx(0.9)
    assert line.worst == pytest.approx(0.0, abs=1e-9)
    assert line.reaches(95.0) == pytest.approx(100.0)
    assert fit([a_run(10), a_run(10)], bytes_of) is None
    bent = fit([a_run(10, sync_bytes=1000), a_run(20, sync_bytes=2000), a_run(30, sync_bytes=6000)], bytes_of)
    assert bent is not None
    assert bent.worst > 0.2


def test_a_group_is_cut_where_a_datagram_ends() -> None:
    members = [GroupMember(name=f"v{i}", age=0.1, lat_deg=-35.3632612, lon_deg=149.165) for i in range(500)]
    said = list(parts("g", 1.0, members))
    assert max(map(len, said)) < MOST_BYTES + 200
    read = [wire.decode(part, GroupStates, "part") for part in said]
    assert [member for part in read for member in part.vehicles] == members
    assert [(part.part, part.parts) for part in read] == [(i, len(read)) for i in range(len(read))]
    assert [wire.decode(part, GroupStates, "part").vehicles for part in parts("g", 1.0, [])] == [[]]


def test_a_small_fleet_is_measured_flat_and_in_groups() -> None:
    arguments = ["--routers", "2", "--seconds", "1", "--groups", "2", "--json"]
    result = CliRunner().invoke(command, ["4", *arguments], catch_exceptions=False)
    flat, grouped = (msgspec.convert(json.loads(line), Run) for line in result.stdout.splitlines())
    assert (flat.shape.groups, grouped.shape.groups) == (0, 2)
    assert (flat.known, flat.ask_answers, flat.history_answers, flat.ping_lost) == (4, 4, 4, 0)
    assert (grouped.known, grouped.ask_answers, grouped.history_answers, grouped.ping_lost) == (4, 0, 0, 0)
    assert flat.states > 0.0
    assert grouped.states == 0.0
    assert min(flat.raw, grouped.raw) > 0.0
    out = console()
    with out.capture() as captured:
        out.print(report([flat, grouped]))
    assert "flat and in groups" in captured.get()
    assert {cost.name for cost in COSTS if cost.of(grouped) is None} == {"query of every state"}
