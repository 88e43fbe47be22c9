"""Verbs that look: ls echo hz get, and what the Zenoh flags do."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from zmav import cli
from zmav.errors import BadConfig, BadInput, BadKey, BadMessage, NoSuchVehicle, Stale

if TYPE_CHECKING:
    from tests.cli.conftest import Here, Speaker, StartProcess, Vehicle
    from tests.conftest import Net

PATIENCE_S = 30.0


@pytest.fixture
def empty(net: Net, here: type[Here]) -> Here:
    """Verbs beside a router without any vehicle."""
    _, endpoint = net.router()
    return here("-e", endpoint)


# ls


def test_ls_shows_who_is_there(vehicle: Vehicle) -> None:
    told = vehicle.zmav("ls")
    for word in ("quad1", "copter", "ardupilot", "STABILIZE"):
        assert word in told.out
    assert re.search(r"[+-]\d+\.\dN [+-]\d+\.\dE", told.out), "where it stands"
    (row,) = vehicle.zmav("ls", "--json").lines
    assert (row["name"], row["kind"], row["mode"], row["armed"], row["present"]) == (
        "quad1",
        "copter",
        "STABILIZE",
        False,
        True,
    )
    assert row["battery"]["voltage"] == pytest.approx(12.6, abs=0.1)
    assert row["position"]["lat_deg"] == pytest.approx(-35.363, abs=0.01)
    assert 0.0 <= row["age"] < 2.0
    assert row["link_loss"] == 0.0
    assert [row["name"] for row in vehicle.zmav("ls", "--fleet", "*", "--json").lines] == ["quad1"]


def test_ls_of_nobody(empty: Here) -> None:
    told = empty("ls", "--wait", "0.2")
    assert told.out == ""
    assert "no vehicle in fleet 'demo' spoke within 0.2 s" in told.err


# echo


def test_echo_shows_fields_with_their_units(vehicle: Vehicle) -> None:
    told = vehicle.zmav("echo", "quad*/ATTITUDE", "-n", "2")
    assert told.out.count("zmav/demo/quad1/mav/rx/1/1/ATTITUDE  (1/1 seq ") == 2
    for line in ("  time_boot_ms: ", " ms\n", "  roll: ", " rad\n", "  yawspeed: ", " rad/s\n"):
        assert line in told.out
    told = vehicle.zmav("echo", "quad1/HEARTBEAT", "-n", "1")
    assert "  type: MAV_TYPE_QUADROTOR\n" in told.out


def test_echo_gives_json_to_scripts(vehicle: Vehicle) -> None:
    (line,) = vehicle.zmav("echo", "quad1/GLOBAL_POSITION_INT", "-n", "1", "--json").lines
    message = line["message"]
    assert (message["name"], message["sysid"], message["units"]["lat"]) == ("GLOBAL_POSITION_INT", 1, "degE7")
    (line,) = vehicle.zmav("echo", "quad1", "-n", "1", "--json").lines
    assert (line["key"], line["value"]["name"]) == ("zmav/demo/quad1/state", "quad1")
    assert line["t"] == pytest.approx(time.time(), abs=60.0)


def test_echo_takes_raw_key_expressions(vehicle: Vehicle) -> None:
    for expression in ("zmav/*/quad1/state", "zmav/demo/q*/state", "**/state"):
        (line,) = vehicle.zmav("echo", expression, "-n", "1", "--json").lines
        assert line["key"] == "zmav/demo/quad1/state"
    told = vehicle.zmav("echo", "quad1/link/*", "-n", "1")
    assert told.out.startswith("zmav/demo/quad1/link/autopilot\n")
    assert "  rx_frames: " in told.out


@pytest.mark.parametrize(
    ("key", "payload", "shown", "as_text"),
    [
        (
            "zmav/demo/@fleet/goal",
            b'{"n": 1.5, "in": {"a": null}}',
            {"value": {"n": 1.5, "in": {"a": None}}},
            "  n: 1.5",
        ),
        ("elsewhere/x", b"[1, 2]", {"value": [1, 2]}, "  [1, 2]"),
        ("elsewhere/y", b"\xff\x00", {"hex": "ff00"}, "  hex: ff00"),
        ("zmav/demo/quad1/mav/rx/1/1/ATTITUDE", b"junk", {"hex": "6a756e6b"}, "not a MAVLink frame"),
    ],
)
def test_echo_of_what_is_no_frame(
    speaker: Speaker, key: str, payload: bytes, shown: dict[str, Any], as_text: str
) -> None:
    publish, verb = speaker.say, speaker.zmav
    publish(key, payload)
    (line,) = verb("echo", f"**/{key}" if key.startswith("elsewhere") else key, "-n", "1", "--json").lines
    assert line["key"] == key
    assert {name: line[name] for name in shown} == shown
    assert as_text in verb("echo", f"**/{key}" if key.startswith("elsewhere") else key, "-n", "1").out


def test_echo_says_when_a_key_is_deleted(speaker: Speaker) -> None:
    speaker.say("zmav/demo/@fleet/goal", None)
    (line,) = speaker.zmav("echo", "zmav/demo/@fleet/goal", "-n", "1", "--json").lines
    assert line["deleted"] is True


def test_echo_refuses_at_once_what_cannot_be(vehicle: Vehicle) -> None:
    assert isinstance(vehicle.zmav.fails("echo", "quad1//x").error, BadKey)
    assert isinstance(vehicle.zmav.fails("echo", "quad1", "--dialect", "klingon").error, BadConfig)


def test_echo_ends_quietly_when_its_reader_has_seen_enough(start: StartProcess, vehicle: Vehicle) -> None:
    command = [sys.executable, "-m", "zmav", "echo", "quad1/ATTITUDE", "--json", "-e", vehicle.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as echo:
        assert echo.stdout is not None
        assert echo.stderr is not None
        assert '"ATTITUDE"' in echo.stdout.readline()
        echo.stdout.close()
        assert echo.wait(PATIENCE_S) == 0
        assert echo.stderr.read() == ""


def test_an_interrupt_ends_without_a_traceback(start: StartProcess, vehicle: Vehicle) -> None:
    echo = start("echo", "quad1", "-e", vehicle.endpoint)
    echo.expect("zmav/demo/quad1/state")
    assert echo.stop(2) == 130
    assert echo.stderr.strip() == ""


# hz


def test_hz(speaker: Speaker) -> None:
    publish, verb = speaker.say, speaker.zmav
    publish("zmav/demo/quad1/state", b"x" * 10)
    publish("zmav/demo/quad2/state", b"x" * 30)
    rows = verb("hz", "quad*", "--for", "1", "--json").lines
    assert [row["key"] for row in rows] == ["zmav/demo/quad1/state", "zmav/demo/quad2/state"]
    assert [row["mean_bytes"] for row in rows] == [10.0, 30.0]
    for row in rows:
        assert row["bytes_per_s"] == pytest.approx(row["count"] * row["mean_bytes"])
        assert row["count"] > 1
        assert 0.0 <= row["min_ms"] <= 1e3 / row["hz"] <= row["max_ms"]
    table = verb("hz", "zmav/**", "--for", "0.5").out
    assert table.split()[:7] == ["key", "count", "hz", "min_ms", "max_ms", "stdev_ms", "bytes_per_s"]


def test_hz_of_nothing(empty: Here) -> None:
    error = empty.fails("hz", "quad1", "--for", "0.2").error
    assert isinstance(error, Stale)
    assert "nothing was published on zmav/demo/quad1/state within 0.2 s" in str(error)


# get


def test_get(vehicle: Vehicle) -> None:
    (line,) = vehicle.zmav("get", "quad1", "--json").lines
    assert (line["key"], line["value"]["name"]) == ("zmav/demo/quad1/state", "quad1")
    (line,) = vehicle.zmav("get", "*/msg/HEARTBEAT", "--json").lines
    assert line["value"]["fields"]["type"] == "MAV_TYPE_QUADROTOR"
    assert '"name": "HEARTBEAT"' in vehicle.zmav("get", "quad1/msg/HEARTBEAT").out
    (line,) = vehicle.zmav("get", "@/*/router", "--json").lines
    assert line["value"]["locators"] == [vehicle.endpoint]
    (line,) = vehicle.zmav("get", "quad1/do/ping", "--value", "{}", "--json").lines
    assert line["value"]["status"] == "done"


def test_get_says_what_is_wrong(vehicle: Vehicle, empty: Here) -> None:
    assert "did you mean ATTITUDE" in str(vehicle.zmav.fails("get", "quad1/msg/ATITUDE").error)
    error = vehicle.zmav.fails("get", "quad1/do/takeoff", "--value", '{"alt": 5}').error
    assert isinstance(error, BadInput)
    assert error.detail["field"] == "alt"
    error = empty.fails("get", "quad1").error
    assert isinstance(error, NoSuchVehicle)
    assert "nobody answers on zmav/demo/quad1/state: 'zmav ls'" in str(error)


# Flags, errors, usage.


def test_the_zenoh_flags(vehicle: Vehicle, here: type[Here], tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"connect": {"endpoints": [vehicle.endpoint]}}))
    nobody = "tcp/127.0.0.1:1"
    for flags in (
        ("-e", nobody, "-e", vehicle.endpoint),
        ("--connect", vehicle.endpoint, "--mode", "client"),
        ("-m", "peer", "-l", "tcp/127.0.0.1:0", "-e", vehicle.endpoint),
        ("-m", "router", "-e", vehicle.endpoint),
        ("-c", str(file)),
        ("--config", str(file), "-m", "client"),
        ("--cfg", f"connect/endpoints:{json.dumps([vehicle.endpoint])}"),
    ):
        end = time.monotonic() + PATIENCE_S  # a busy machine may need more than one look
        while not (rows := here(*flags)("ls", "--json", "--wait", "0.5").lines):
            assert time.monotonic() < end, flags
        assert [row["name"] for row in rows] == ["quad1"], flags


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("-e", "loopback"), "<protocol>/<address>"),
        (("-c", "/no/such.json5"), "/no/such.json5"),
        (("--cfg", "mode"), "PATH:VALUE"),
    ],
)
def test_bad_zenoh_flags_are_named(here: type[Here], flags: tuple[str, ...], words: str) -> None:
    error = here(*flags).fails("ls").error
    assert isinstance(error, BadConfig)
    assert words in str(error)


def test_without_a_router_it_is_said_what_to_do(start: StartProcess, here: type[Here]) -> None:
    words = "no Zenoh router answers at tcp/127.0.0.1:1. Start one ('zmav up'"
    process = start("ls", "-e", "tcp/127.0.0.1:1")
    assert process.wait() == 1
    assert process.stdout == ""
    assert process.stderr.startswith(f"zmav: {words}")
    assert len(process.err) == 1
    told = here("-e", "tcp/127.0.0.1:1").fails("echo", "quad1")
    assert str(told.error).startswith(words)
    assert told.out == ""


def test_wrong_usage_ends_with_2(start: StartProcess) -> None:
    process = start()
    assert process.wait() == 2
    assert "Usage: " in process.stderr
    assert "Traceback" not in process.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["do", "quad1", "fly"],
        ["echo"],
        ["echo", "quad1", "-n", "0"],
        ["hz", "quad1", "--for", "0"],
        ["hz", "quad1", "--for", "inf"],
        ["get", "quad1", "--timeout", "nan"],
        ["mesh", "graph", "--timeout", "nan"],
        ["ls", "--wait", "nan"],
        ["ls", "--wait", "-1"],
        ["terrain", "load", "quad1", "--from", "srtm", "--radius", "nan"],
        ["replay", "--start", "inf"],
        ["goto", "quad1", "--at", "1", "2", "--alt", "nan"],
        ["goto", "quad1", "--to", "1,2,3", "--speed", "inf"],
        ["fly", "quad1", "--yaw", "nan"],
        ["fly", "quad1", "--rates", "0", "inf", "0", "--thrust", "0"],
        ["echo", "quad1/ATTITUDE", "--rate", "inf"],
        ["agent", "param", "set", "follower", "gain", "nan", "--vehicle", "quad1"],
        ["agent", "inject", "mine", "step", "--channel", "z", "--amplitude", "inf", "--vehicle", "quad1"],
        ["swarm", "takeoff", "quad1", "--alt", "nan"],
        ["swarm", "obstacle", "add", "tower", "--cylinder", "40,10", "--ttl", "inf"],
        ["sim", "step", "inf"],
        ["sim", "--spacing", "nan"],
        ["sim", "fault", "quad1", "gps-glitch", "--for", "inf"],
        ["ls", "--mode", "captain"],
        ["goto", "quad1"],
        ["goto", "quad1", "--to", "1,2,3", "--at", "1", "2"],
        ["goto", "quad1", "--at", "1", "2"],
        ["up", "--sysid", "300"],
        ["sim", "--copters", "251"],
        ["swarm", "swap"],
    ],
    ids=" ".join,
)
def test_wrong_usage_is_told(here: type[Here], arguments: list[str]) -> None:
    told = here().misused(*arguments)
    assert told.err.startswith("Usage: ")
    assert "Error: " in told.err


@pytest.mark.parametrize("digits", ["9" * 400, "1." + "9" * 400])
def test_an_amount_that_no_disk_has_is_wrong_usage(here: type[Here], digits: str) -> None:
    assert "is not a number with its unit, as in 1GB" in here().misused("record", "--keep-free", f"{digits}GB").err


@pytest.mark.parametrize("value", [400 * "1", 5000 * "1", 100_000 * "["], ids=["large", "huge", "deep"])
@pytest.mark.parametrize("verb", ["do quad1 takeoff alt_rel", "param set quad1 RTL_ALT"])
def test_a_value_that_no_order_has_is_named(here: type[Here], verb: str, value: str) -> None:
    *words, name = verb.split()
    told = here().fails(*words, f"{name}={value}")
    assert isinstance(told.error, BadInput)
    assert name in str(told.error)


def test_help_lists_every_verb(here: type[Here]) -> None:
    told = here()("--help")
    above = {
        "up",
        "demo",
        "hil",
        "router",
        "plan",
        "swarm",
        "mesh",
        "lab",
        "gcs",
        "http",
        "record",
        "replay",
        "ros2",
        "rtk",
        "view",
        "top",
        "tak",
        "traffic",
        "video",
    }
    above |= {"camera"}
    verbs = {*cli.VERBS, *above}
    assert len(verbs) == len(cli.VERBS) + len(above)
    listed = [line.split()[0] for line in told.out.partition("Commands:")[2].splitlines() if line.strip()]
    assert sorted(verbs) == listed
    assert here()("--version").out.startswith("zmav, version ")


def test_a_frame_of_another_dialect_is_read_with_it(vehicle: Vehicle) -> None:
    with pytest.raises(BadMessage):
        vehicle.zmav("send", "quad1", "NO_SUCH_MESSAGE")
    (line,) = vehicle.zmav("echo", "quad1/HEARTBEAT", "-n", "1", "--json", "--dialect", "common").lines
    assert line["message"]["fields"]["autopilot"] == "MAV_AUTOPILOT_ARDUPILOTMEGA"


# echo of what nobody publishes


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is silent is looked into soon."""
    monkeypatch.setattr("zmav.cli.echo.SILENT_S", 0.5)


@pytest.mark.usefixtures("impatient")
def test_echo_of_nobody_says_who_is_there(vehicle: Vehicle) -> None:
    for key in ("quad9", "quad9/ATTITUDE", "x*/event"):
        error = vehicle.zmav.fails("echo", key).error
        assert isinstance(error, NoSuchVehicle)
        assert "present: quad1" in str(error)


@pytest.mark.usefixtures("impatient")
def test_echo_of_a_message_that_there_is_not_says_which_there_are(vehicle: Vehicle) -> None:
    for key in ("quad1/ATITUDE", "quad*/ATITUDE"):
        error = vehicle.zmav.fails("echo", key).error
        assert isinstance(error, BadMessage)
        assert "did you mean ATTITUDE" in str(error)


def test_echo_waits_for_what_may_come_and_says_what_does(vehicle: Vehicle, start: StartProcess) -> None:
    for key, words in (
        ("quad1/HIL_GPS", "quad1's autopilot sends ATTITUDE, "),
        ("ground/agent/x/status", "yet; Ctrl-C"),
    ):
        echo = start("echo", key, "-e", vehicle.endpoint)
        assert "nothing comes on zmav/demo/" in echo.expect(words)
        assert echo.stop(signal.SIGINT) == 130
        assert echo.stdout == ""
