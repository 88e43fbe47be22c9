"""The public ``zenoh`` command (zenoh-cli), as anybody has it: the same tree, and readable JSON.

Its ``get`` and ``liveliness get`` end by themselves; ``subscribe`` runs until it is interrupted.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.cli.conftest import Process, StartProcess, Vehicle

pytest.importorskip("zenoh_cli")
Zenoh = Callable[..., "Process"]


@pytest.fixture
def zenoh_cli(start: StartProcess, vehicle: Vehicle) -> Zenoh:
    """Start it as a client of the vehicle's router."""

    def run(*arguments: str) -> Process:
        return start("--mode", "client", "--connect", vehicle.endpoint, *arguments, program="zenoh_cli")

    return run


def first_line(zenoh_cli: Zenoh, key: str, decoder: str) -> Any:
    process = zenoh_cli("subscribe", "-k", key, "--decoder", decoder)
    line = process.expect("{")
    assert process.stop(signal.SIGINT) == 0
    assert process.stderr == ""
    return json.loads(line)


def test_the_tokens_of_who_is_there(zenoh_cli: Zenoh) -> None:
    process = zenoh_cli("liveliness", "get", "-k", "zmav/**")
    assert process.wait() == 0
    (token,) = [json.loads(line) for line in process.out]
    assert token["status"] == "ALIVE"
    assert token["key"].startswith("zmav/demo/quad1/alive/vehicle/1/ardupilot/")


@pytest.mark.parametrize("decoder", ["text", "json", "mavlink"])
def test_what_can_be_asked(zenoh_cli: Zenoh, decoder: str) -> None:
    process = zenoh_cli("get", "-s", "zmav/**", "--decoder", decoder, "--line", "{key} {value}")
    assert process.wait() == 0
    found = dict(line.split(" ", 1) for line in process.out)
    assert json.loads(found["zmav/demo/quad1/state"])["name"] == "quad1"
    attitude = json.loads(found["zmav/demo/quad1/msg/ATTITUDE"])
    assert attitude["fields"].keys() >= {"roll", "pitch", "yaw"}
    kinds = {key.split("/")[3] for key in found}
    assert {"state", "msg", "rates", "link"} <= kinds
    assert kinds <= {
        "state",
        "msg",
        "rates",
        "link",
        "body",
        "host",
        "param",
        "mission",
        "file",
        "terrain",
    }  # as caches fill


def test_an_order_given_with_it(zenoh_cli: Zenoh) -> None:
    process = zenoh_cli("get", "-s", "zmav/demo/quad1/do/ping", "--decoder", "json")
    assert process.wait() == 0
    assert json.loads(process.stdout)["status"] == "done"
    process = zenoh_cli("get", "-s", "zmav/demo/quad1/do/takeoff", "-v", '{"alt_rel": 5}', "--decoder", "json")
    assert process.wait() == 0
    assert '"code":"refused"' in process.stderr
    assert "arm it first" in process.stderr


def test_what_is_published(zenoh_cli: Zenoh) -> None:
    state = first_line(zenoh_cli, "zmav/demo/quad1/state", "json")
    assert (state["name"], state["autopilot"]) == ("quad1", "ardupilot")
    link = first_line(zenoh_cli, "zmav/*/*/link/*", "text")
    assert link["state"] == "up"


def test_frames_are_read_by_zmavs_codec(zenoh_cli: Zenoh) -> None:
    shown = first_line(zenoh_cli, "zmav/demo/*/mav/rx/*/*/GLOBAL_POSITION_INT", "mavlink")
    assert (shown["name"], shown["sysid"], shown["units"]["lat"]) == ("GLOBAL_POSITION_INT", 1, "degE7")
    assert shown["fields"]["lat"] / 1e7 == pytest.approx(-35.363, abs=0.01)


def test_one_decoder_reads_everything_there_is(zenoh_cli: Zenoh) -> None:
    process = zenoh_cli("subscribe", "-k", "zmav/**", "--decoder", "mavlink", "--line", "{key} {value}")
    for words in ("/state ", "/mav/rx/1/1/HEARTBEAT ", "/mav/rx/1/1/ATTITUDE ", "/link/autopilot "):
        process.expect(words)
    assert process.stop(signal.SIGINT) == 0
    for line in (line for line in process.out if line.startswith("zmav/")):  # Zenoh's own log goes there, too
        key, value = line.split(" ", 1)
        assert "error" not in json.loads(value), key


def test_a_message_is_put_with_zmavs_codec(zenoh_cli: Zenoh, vehicle: Vehicle) -> None:
    key = "zmav/demo/quad1/mav/tx/1/1/SET_MODE"
    for name, number in (("LOITER", 5), ("STABILIZE", 0)):
        fields = json.dumps({"base_mode": 1, "custom_mode": number})
        process = zenoh_cli("put", "-k", key, "--encoder", "mavlink", "-v", fields)
        assert process.wait() == 0
        vehicle.until(lambda s, name=name: s.mode == name)  # type: ignore[misc]
