"""Every format of a file that is read."""

from __future__ import annotations

import contextlib
import functools
import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from agents.camera.settings import Calibration
from agents.planner.model.plans import read_plan
from agents.planner.model.scene import read_scene
from ground.record import mcapfile, schemas
from ground.record.folder import is_whole
from ground.record.mcapfile import Mcap, repair
from ground.record.sources import Tlogs
from mesh.credentials.ledger import LEDGER, read_ledger
from mesh.lab.scenario import load_scenario
from tests.conftest import ROOT
from tests.fuzz.engine import Run, Target, pure
from tests.fuzz.targets.frames import frames, the_dialect
from zmav.config import load_fleet
from zmav.errors import BadInput
from zmav.formats import paramfile, plan, waypoints
from zmav.links.tlog import STAMP, TlogReader
from zmav.links.url import parse_url
from zmav.mavlink import load_dialect
from zmav.services.files.store import META, Store
from zmav.sim.camera.scene import load_scene


def filed(name: str, read: Callable[[Path], object]) -> Callable[[], contextlib.AbstractContextManager[Run]]:
    """``Target.open`` for what reads a file: each input lies there as ``name``."""

    @contextlib.contextmanager
    def opened() -> Iterator[Run]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name

            def run(data: bytes) -> None:
                path.unlink(missing_ok=True)  # to write over a file waits for the disk
                path.write_bytes(data)
                read(path)

            yield run

    return opened


def found_in(*places: str) -> Callable[[], Sequence[bytes]]:
    """Files of the tree, as examples."""
    return lambda: [path.read_bytes() for place in places for path in sorted(ROOT.glob(place))]


def params(data: bytes) -> None:
    """What was read can be written, and is then the same."""
    file = paramfile.read(data)
    again = paramfile.read(paramfile.write(file))
    assert sorted(again.params, key=repr) == sorted(file.params, key=repr), (again.params, file.params)


def plans(data: bytes) -> None:
    enums = the_dialect().enums
    plan.write(plan.read(data, enums), enums)


def rows(data: bytes) -> None:
    enums = the_dialect().enums
    waypoints.write(waypoints.read(data, enums), enums)


def tlog(data: bytes) -> None:
    reader = TlogReader(io.BytesIO(data))
    kept = sum(STAMP.size + len(frame) for _, frame in reader)
    assert kept + reader.skipped == len(data)


def tlogs() -> list[bytes]:
    made = [STAMP.pack(1_700_000_000_000_000 + 1000 * n) + frame for n, frame in enumerate(frames()[:5] * 3)]
    return [b"".join(made), b"".join(made[:6]) + b"\xfd\x09torn" + b"".join(made[6:])]


def replayed(path: Path) -> None:
    """As ``zmav replay`` reads it, and as one that was cut off is completed."""
    mcapfile.about(path)
    source = Mcap(path)
    with contextlib.suppress(BadInput):
        source.vehicles()
    with contextlib.suppress(BadInput):
        list(source.records())
    repair(path)
    assert is_whole(path)


@functools.cache
def mcaps() -> list[bytes]:
    """A recording of two flushes; the same cut short; and one that holds what is no frame."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        file = mcapfile.McapFile(path, {"dialect": "ardupilotmega"})
        all_frames = file.topic("zmav/demo/quad1/mav/rx", schemas.FRAMES, schemas.ALL_FRAMES)
        state = file.topic("zmav/demo/quad1/state", schemas.JSON, schemas.AS_IT_CAME)
        assert all_frames is not None and state is not None
        for number, frame in enumerate([*frames()[:3], b"", b"\xfd"]):
            file.add(all_frames, 1_700_000_000_000_000_000 + number, frame, 1)
            file.add(state, 1_700_000_000_000_000_000 + number, b'{"t": 1}', 1)
            file.flush()
        short = path.read_bytes()
        file.finish()
        return [path.read_bytes(), short]


def fleet_files() -> list[bytes]:
    return [*found_in("deploy/fleets/*.toml", "deploy/demos/l*.toml")(), FLEET]


FLEET = b"""fleet = "alpha"
origin = {lat_deg = 52.756, lon_deg = -1.246, alt_amsl = 60.0}
[failsafe]
hold_after = 0.4
action = "land"
[geofence]
polygon = [[52.75, -1.25], [52.76, -1.25], [52.76, -1.24]]
radius = 300.0
ceiling = 60.0
[limits]
speed = 12.0
[vehicles.quad1]
link = "/dev/ttyAMA0,921600"
sysid = 7
listen = ["tcp/127.0.0.1:7447", "udp/10.77.0.1:7447?rel=1;mixed_rel=1"]
pilot_switch = {channel = 7, high = 2100}
"""
PARAMS = b"""# Onboard parameters for Vehicle 1
#
# Stack: ArduPilot
# Vehicle-Id Component-Id Name Value Type
1\t1\tRTL_ALT\t1500.0\t9
1\t1\tSYSID_THISMAV\t1\t2
1\t1\tNAN_ONE\tnan\t9
"""
PLANNER = b"#NOTE: ArduCopter\nRTL_ALT,1500\nLOG_BITMASK 0xB26EF # all\nWPNAV_SPEED\t5.5e2\nNAN_ONE nan\n"
WAYPOINTS = b"""QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t-35.363262\t149.165237\t584.09\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t10\t1
2\t0\t3\t16\t2.5\t0\t0\tnan\t-35.3631\t149.1652\t12.5\t0
3\t0\t2\t177\t1\t3\t0\t0\t0\t0\t0\t1
"""
PLAN = b"""{"fileType": "Plan", "version": 1, "groundStation": "QGroundControl",
"geoFence": {"circles": [{"circle": {"center": [47.3, 8.5], "radius": 90}, "inclusion": true, "version": 1}],
"polygons": [{"inclusion": false, "polygon": [[47.1, 8.1], [47.2, 8.1], [47.2, 8.2]], "version": 1}], "version": 2},
"rallyPoints": {"points": [[47.3, 8.5, 30]], "version": 2},
"mission": {"cruiseSpeed": 15, "firmwareType": 12, "hoverSpeed": 5, "vehicleType": 2, "version": 2,
"plannedHomePosition": [47.3977, 8.5456, 488.1], "items": [
{"autoContinue": true, "command": 22, "doJumpId": 1, "frame": 3, "params": [0, 0, 0, null, 47.39, 8.54, 50],
"type": "SimpleItem"},
{"type": "ComplexItem", "complexItemType": "survey", "angle": 90, "TransectStyleComplexItem": {"version": 1, "Items": [
{"autoContinue": true, "command": 16, "doJumpId": 2, "frame": 3, "params": [0, 0, 0, null, 47.4, 8.6, 50],
"type": "SimpleItem"}]}},
{"autoContinue": true, "command": 177, "doJumpId": 3, "frame": 2, "params": [1, 2, 0, 0, 0, 0, 0], "type": "SimpleItem"}
]}}"""
SCENE = b"""{"vehicles": [
{"id": "q1", "type": "copter", "start": [0, 0, 5], "goal": [20, 0, 5], "radius": 0.6, "vmax": 5, "amax": 2},
{"id": "p1", "type": "plane", "start": [5, 0, 20], "goal": [0, 5, 20], "radius": 1, "vmax": 20, "amax": 4, "vmin": 12,
"start_heading_deg": 90}],
"obstacles": [{"type": "box", "min": [8, -2, 0], "max": [10, 2, 20]},
{"type": "cylinder", "center": [4, 4], "radius": 1.5, "floor": 0, "ceiling": 12},
{"type": "no_fly", "polygon": [[30, 30], [32, 30], [32, 32]], "floor": 0, "ceiling": 30, "name": "yard"}],
"bounds": {"min": [-50, -50, 0], "max": [50, 50, 40]},
"geofence": {"polygon": [[-49, -49], [49, -49], [49, 49], [-49, 49]], "floor": 0, "ceiling": 39}}"""
MOTIONS = b"""{"status": "ok", "planning_time_s": 0.5, "trajectories": {"q1": [[0, 0, 0, -5], [2.5, 10, 0, -5]]},
"error": {"code": "invalid_scene", "ids": ["q1"], "message": "no"}}"""
LEDGER_FILE = b"""{"fleet": "alpha", "number": 3, "t": 1.7e9, "entries": [{"name": "quad1", "role": "vehicle",
"fingerprint": "00112233445566ff", "not_before": 1.7e9, "not_after": 1.8e9, "serial": "7"}]}"""
META_FILE = b'{"origin": "/a.bin", "identity": "x", "size": 3, "missing": [[0, 3]], "t": 1.7e9}'
CALIBRATION = b"""width = 640
height = 480
focal = [500.0, 500.0]
center = [320.0, 240.0]
distortion = [0.1, -0.05, 0.0, 0.0, 0.0]
"""
URLS = (
    b"/dev/ttyACM0,57600",
    b"udpin:0.0.0.0:14550",
    b"tcp:[::1]:5760",
    b"udpout:10.0.0.2:14550?local=14551",
    b"serial:/dev/ttyUSB0:auto?rtscts",
)

TARGETS = (
    Target("mcap", filed("a.mcap", replayed), mcaps, 500),
    Target("tlog", pure(tlog), tlogs, 1000),
    Target("params", pure(params), lambda: [PARAMS, PLANNER], 3000),
    Target("plan", pure(plans), lambda: [PLAN]),
    Target("waypoints", pure(rows), lambda: [WAYPOINTS], 3000),
    Target("fleet", filed("fleet.toml", load_fleet), fleet_files, 700),
    Target("lab", filed("lab.toml", load_scenario), found_in("deploy/labs/*.toml"), 700),
    Target("scene", filed("scene.json", read_scene), lambda: [SCENE], 700),
    Target("plan_of_motion", filed("plan.json", read_plan), lambda: [MOTIONS], 700),
    Target("ledger", filed(LEDGER, lambda path: read_ledger(path.parent)), lambda: [LEDGER_FILE], 700),
    Target("tlog_played", filed("quad1.001.tlog", lambda path: list(Tlogs("quad1", [path]).records())), tlogs, 300),
    Target("dialect_name", pure(lambda data: load_dialect(data.decode("utf-8", "replace"))), lambda: [b"common"], 300),
    Target("stored", filed(f"a{META}", lambda path: Store(path.parent).files), lambda: [META_FILE], 700),
    Target("calibration", filed("a.toml", Calibration.load), lambda: [CALIBRATION], 700),
    Target("camera_scene", filed("s.toml", load_scene), found_in("deploy/demos/scenes/*.toml"), 500),
    Target("link_url", pure(lambda data: str(parse_url(data.decode("latin-1")))), lambda: URLS, 3000),
)
