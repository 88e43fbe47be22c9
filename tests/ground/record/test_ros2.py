"""An .mcap with what ROS 2 would have been told, read by other people's decoder."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from ground.record import mcapfile, schemas
from ground.record.cli import command
from zmav import wire
from zmav.errors import BadConfig
from zmav.mavlink import Dialect, encode

if TYPE_CHECKING:
    from tests.ground.record.conftest import Bench

    StartBench = Callable[..., Bench]

QUAD = "zmav/demo/quad-1"
NUMBERS = {"lat": 500000000, "lon": 80000000, "alt": 102_000, "relative_alt": 2_000, "vx": 100, "vy": 0, "vz": 0}


def state() -> bytes:
    return wire.encode(
        wire.VehicleState(
            t=time.time(),
            fleet="demo",
            name="quad-1",
            instance="x",
            sysid=1,
            compid=1,
            connected=True,
            armed=True,
            mode="GUIDED",
            autopilot="ardupilot",
            position=wire.GlobalPosition(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0, alt_rel=0.0),
            local=(10.0, 20.0, -5.0),
        )
    )


def read(path: Path) -> dict[str, list[Any]]:
    """What is decoded of each topic of ROS."""
    found: dict[str, list[Any]] = {}
    factory = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            decoder = factory.decoder_for(channel.message_encoding, schema)
            assert (decoder is not None) == (channel.message_encoding == schemas.CDR)
            if decoder is not None:
                assert channel.metadata[mcapfile.HOLDS] == schemas.DERIVED
                found.setdefault(channel.topic, []).append(decoder(message.data))
    return found


@pytest.fixture
def two(dialect: Dialect) -> dict[str, bytes]:
    attitude = encode(dialect, "ATTITUDE", {"rollspeed": 0.25}, sysid=1, compid=1, default=0)
    position = encode(dialect, "GLOBAL_POSITION_INT", NUMBERS, sysid=1, compid=1, default=0)
    return {"ATTITUDE": attitude, "GLOBAL_POSITION_INT": position}


def test_topics_of_ros_are_beside_what_came(bench: StartBench, two: dict[str, bytes]) -> None:
    one = bench(ros2=True)
    one.storage.put(f"{QUAD}/mav/rx/1/1/ATTITUDE", two["ATTITUDE"])  # nobody knows yet whose it is
    one.storage.put(f"{QUAD}/state", state())
    for message, frame in two.items():
        one.storage.put(f"{QUAD}/mav/rx/1/1/{message}", frame)
    one.storage.put(f"{QUAD}/mav/rx/1/1/ATTITUDE", b"\xfd spoilt")
    one.storage.close()
    (path,) = one.storage.session.glob("*.mcap")
    found = read(path)
    (odom,) = found["/quad_1/local_position/odom"]
    at = odom.pose.pose.position
    assert (at.x, at.y, at.z) == pytest.approx((20.0, 10.0, 7.0))
    assert (odom.header.frame_id, odom.child_frame_id) == ("demo", "quad_1/base_link")
    (moved,) = found["/tf"]
    assert moved.transforms[0].child_frame_id == "quad_1/base_link"
    (imu,) = found["/quad_1/imu/data"]
    assert imu.angular_velocity.x == 0.25
    (said,) = found["/quad_1/state"]
    assert (said.mode, said.armed, said.guided) == ("GUIDED", True, True)


def test_without_being_asked_there_are_none(bench: StartBench, two: dict[str, bytes]) -> None:
    one = bench()
    one.storage.put(f"{QUAD}/state", state())
    one.storage.put(f"{QUAD}/mav/rx/1/1/ATTITUDE", two["ATTITUDE"])
    one.storage.close()
    (path,) = one.storage.session.glob("*.mcap")
    assert read(path) == {}


def test_ros2_without_an_mcap_is_refused() -> None:
    result = CliRunner().invoke(command, ["--ros2", "--no-mcap"])
    assert isinstance(result.exception, BadConfig)
    assert "--no-mcap" in str(result.exception)
