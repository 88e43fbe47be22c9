"""MAVProxy, MAVSDK and a pymavlink script at one bridge over five vehicles, at the same time: real stations, as their
users start them, which know nothing of zmav.
"""

from __future__ import annotations

import collections
import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from tests.ground.gcs.fleet import Fleet
from tests.mavproxy import PATIENCE_S, MavProxy
from zmav.mavlink import Splitter, decode, load_dialect, targets
from zmav.mavlink.paramvalue import ParamEncoding, value_of
from zmav.sim import VehicleSpec

pytest.importorskip("mavsdk", reason="MAVSDK has no wheel for this machine")
pytest.importorskip("MAVProxy", reason="MAVProxy is not installed (it is in the dev extra)")

HERE = Path(__file__).parent
COPTER, ROVER, PX4, OTHER_COPTER, OTHER_PX4 = 1, 2, 3, 4, 5
EVERY = (COPTER, ROVER, PX4, OTHER_COPTER, OTHER_PX4)
CHANGED = {COPTER: ("WPNAV_SPEED", 750.0), PX4: ("MPC_XY_CRUISE", 7.25)}
NEWS = {(number, name) for number, (name, _) in CHANGED.items()} | {(COPTER, "MIS_TOTAL"), (OTHER_COPTER, "MIS_TOTAL")}
"""what is said again because it changes; ArduPilot counts a mission's items in a parameter"""
MAVPROXY_ID, SCRIPT_ID = 252, 253
# Without consoles and maps, which need a screen; without ftp, it asks for parameters one by one as older stations do.
MODULES = "wp,rally,fence,param,cmdlong,misc,link"


@pytest.fixture
def fleet() -> Iterator[Fleet]:
    kinds = ("arducopter", "ardurover", "px4", "arducopter", "px4")
    with Fleet([VehicleSpec(autopilot=kind) for kind in kinds], speed=1.0) as fleet:
        yield fleet


def mavproxy(fleet: Fleet, folder: Path) -> dict[str, Any]:
    """Two vehicles' parameters, a mission up and down, a parameter set, as a person types it."""
    master = f"tcp:{fleet.tcp[0]}:{fleet.tcp[1]}"
    session = MavProxy(folder, master, MODULES, f"--source-system={MAVPROXY_ID}", f"--target-system={COPTER}")
    try:
        session.hears(rf"Detected vehicle {COPTER}:1")
        session.hears(rf"Received {len(fleet.params(COPTER))} parameters")
        rows = ["QGC WPL 110", "0\t1\t0\t16\t0\t0\t0\t0\t-35.363261\t149.16523\t584\t1"]
        rows += [f"{i}\t0\t3\t16\t0\t0\t0\t0\t{-35.362 + i * 1e-4:.7f}\t149.162\t21\t1" for i in range(1, 9)]
        (folder / "mission.txt").write_text("\n".join(rows) + "\n")
        session.type("wp load mission.txt", r"MISSION_ACK: TYPE_MISSION: ACCEPTED")
        session.type("wp save back.txt", r"Saved 9 waypoints")
        name, value = CHANGED[COPTER]
        session.set_param(name, value)
        session.type(f"param save {folder / 'one.parm'}", r"Saved \d+ parameters to \S+one.parm")
        session.type(f"vehicle {ROVER}", rf"Set vehicle {ROVER}")
        session.hears(rf"Received {len(fleet.params(ROVER))} parameters")
        session.type(f"param save {folder / 'two.parm'}", r"Saved \d+ parameters to \S+two.parm")
    finally:
        session.close()
    back = [line.split() for line in (folder / "back.txt").read_text().splitlines()[1:]]
    return {
        "params": {COPTER: read_parm(folder / "one.parm"), ROVER: read_parm(folder / "two.parm")},
        "back": [(round(float(row[8]) * 1e7), round(float(row[9]) * 1e7), float(row[10])) for row in back],
    }


def read_parm(path: Path) -> dict[str, float]:
    rows = (line.split() for line in path.read_text().splitlines())
    return {row[0]: float(row[1]) for row in rows if len(row) >= 2 and not row[0].startswith("#")}


def script(name: str, *arguments: str) -> dict[str, Any]:
    """Run a station to its end; what it found."""
    ended = subprocess.run(
        [sys.executable, str(HERE / name), *arguments], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert ended.returncode == 0, f"{name} ended with {ended.returncode}; it said:\n{ended.stdout}\n{ended.stderr}"
    return dict(json.loads(ended.stdout.splitlines()[-1]))


def numbers(fleet: Fleet, number: int, raws: dict[str, str]) -> dict[str, Any]:
    """The values in PARAM_VALUEs."""
    table = fleet.run(fleet.vehicle(number).params.list())
    types, encoding = {param.name: param.type for param in table.params}, ParamEncoding(table.encoding)
    return {name: value_of(bytes.fromhex(raw), types[name], encoding) for name, raw in raws.items()}


def assert_all_of(fleet: Fleet, number: int, got: dict[str, Any]) -> None:
    """Every parameter is there, and as the vehicle has it."""
    held = fleet.params(number)
    assert got.keys() == held.keys()
    changing = {name for other, name in NEWS if other == number}  # read before or after
    wrong = {
        name: (got[name], value)
        for name, value in held.items()
        if name not in changing and got[name] != pytest.approx(value, rel=1e-6, abs=1e-6)
    }
    assert not wrong


def places(fleet: Fleet, number: int) -> list[tuple[int, int, float]]:
    """The mission that is on the autopilot itself, without home."""
    items = fleet.run(fleet.vehicle(number).missions.download()).items
    return [(round(i.x * 1e7), round(i.y * 1e7), round(i.z, 3)) for i in items if i.command == "MAV_CMD_NAV_WAYPOINT"]


def index_of(fleet: Fleet, number: int, name: str) -> int:
    return [param.name for param in fleet.run(fleet.vehicle(number).params.list()).params].index(name)


def test_all_parameters_a_mission_each_and_no_cross_talk(fleet: Fleet, tmp_path: Path) -> None:
    where, vehicles = f"{fleet.tcp[0]}:{fleet.tcp[1]}", ",".join(map(str, EVERY))
    name, value = CHANGED[PX4]
    with ThreadPoolExecutor() as pool:
        shell = pool.submit(mavproxy, fleet, tmp_path)
        sdk = pool.submit(
            script,
            "mavsdk_station.py",
            f"udpout://127.0.0.1:{fleet.udp[1]}",
            f"{PX4},{OTHER_COPTER}",
            str(PX4),
            f"{name}={value}",
        )
        plain = pool.submit(script, "pymavlink_station.py", f"tcp:{where}", str(SCRIPT_ID), vehicles, str(OTHER_COPTER))
        typed, called, scripted = shell.result(), sdk.result(), plain.result()

    for number in EVERY:
        assert_all_of(fleet, number, numbers(fleet, number, scripted["params"][str(number)]))
    for number in (PX4, OTHER_COPTER):
        assert_all_of(fleet, number, called["params"][str(number)])
    for number in (COPTER, ROVER):
        assert_all_of(fleet, number, typed["params"][number])
    for number, (name, value) in CHANGED.items():
        assert fleet.params(number)[name] == value
    assert typed["params"][COPTER]["WPNAV_SPEED"] == CHANGED[COPTER][1]
    assert called["set"] == CHANGED[PX4][1]

    assert [seq for seq, *_ in scripted["back"]] == list(range(7))
    assert scripted["back"][1:] == scripted["sent"][1:]  # its first is where the autopilot has home
    assert places(fleet, OTHER_COPTER) == [tuple(place) for _, *place in scripted["sent"][1:]]
    drawn = [pytest.approx((round((-35.362 + i * 1e-4) * 1e7), 1491620000, 21.0), abs=1.5) for i in range(1, 9)]
    assert places(fleet, COPTER) == drawn  # MAVProxy cuts off where it should round
    assert typed["back"][1:] == drawn
    assert called["back"] == [pytest.approx(place, abs=1e-6) for place in called["sent"]]
    assert places(fleet, PX4) == [(round(lat * 1e7), round(lon * 1e7), alt) for lat, lon, alt in called["sent"]]
    assert (places(fleet, ROVER), places(fleet, OTHER_PX4)) == ([], [])

    assert scripted["foreign"] == []
    news = [["PARAM_VALUE", number, index_of(fleet, number, name)] for number, name in NEWS]
    assert [each for each in scripted["twice"] if each[:3] not in news] == []
    assert_nothing_foreign_nor_twice(fleet, tmp_path / "mav.tlog")


def assert_nothing_foreign_nor_twice(fleet: Fleet, log: Path) -> None:
    """In all that came to MAVProxy, which writes it down, with what it asked for."""
    dialect = load_dialect()
    got: collections.Counter[tuple[int, str]] = collections.Counter()
    lists: collections.Counter[int] = collections.Counter()
    asked: collections.Counter[tuple[int, str]] = collections.Counter()
    names = {number: list(fleet.params(number)) for number in EVERY}
    for frame in Splitter(dialect).feed(log.read_bytes()):
        name, (target, _) = dialect.name_of(frame.msgid), targets(frame, dialect)
        if frame.sysid != MAVPROXY_ID:
            assert frame.sysid in EVERY
            assert target in (0, MAVPROXY_ID), f"{name} from {frame.sysid} to {target}"
        if name == "PARAM_VALUE":
            got[frame.sysid, decode(frame, dialect)["param_id"]] += 1
        elif name == "PARAM_REQUEST_LIST":
            lists[target] += 1
        elif name in ("PARAM_REQUEST_READ", "PARAM_SET"):
            fields = decode(frame, dialect)
            index = fields.get("param_index", -1)
            asked[target, names[target][index] if index >= 0 else fields["param_id"]] += 1
    too_many = {key: n for key, n in got.items() if n > lists[key[0]] + asked[key] and key not in NEWS}
    assert not too_many, (too_many, lists, asked)
