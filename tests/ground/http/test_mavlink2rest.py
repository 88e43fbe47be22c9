"""mavlink2rest's face: every example of its documentation answered alike, and its faults mended."""

from __future__ import annotations

import json
import random
import socket
import threading
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from ground.http.restjson import document, frame_of, template
from ground.http.restws import RestSockets
from zmav import keys
from zmav.mavlink import decode, encode, load_dialect, parse_frame
from zmav.mavlink.frame import build_frame

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

MESSAGES = "/v1/mavlink/vehicles/1/components/1/messages"
HEARTBEAT: dict[str, Any] = {
    "type": "MAV_TYPE_QUADROTOR",
    "autopilot": "MAV_AUTOPILOT_ARDUPILOTMEGA",
    "base_mode": 81,
    "custom_mode": 4,
    "system_status": "MAV_STATE_ACTIVE",
}
ATTITUDE: dict[str, Any] = {
    "time_boot_ms": 87110407,
    "roll": 0.25,
    "pitch": 0.5,
    "yaw": -2.5,
    "rollspeed": 0,
    "pitchspeed": 0,
    "yawspeed": 0.5,
}
ARM: dict[str, Any] = {
    "header": {"system_id": 255, "component_id": 240, "sequence": 0},
    "message": {
        "type": "COMMAND_LONG",
        **{f"param{n}": float(n == 1) for n in range(1, 8)},
        "command": {"type": "MAV_CMD_COMPONENT_ARM_DISARM"},
        "target_system": 1,
        "target_component": 1,
        "confirmation": 1,
    },
}


def websocket(served: Served, query: str = "", path: str = "/v1/ws/mavlink") -> ClientConnection:
    return connect(f"ws://127.0.0.1:{served.port}{path}{query}", open_timeout=30.0)


def next_of(ws: ClientConnection) -> Any:
    return json.loads(ws.recv(30.0))


# Its documented examples, in order.


def test_get_all_messages(served: Served) -> None:
    served.hear("HEARTBEAT", **HEARTBEAT)
    served.hear("ATTITUDE", "quad2", 2, **ATTITUDE)
    tree = served.get("/v1/mavlink").json
    assert tree["vehicles"]["1"]["id"] == 1
    one = tree["vehicles"]["1"]["components"]["1"]
    assert (one["id"], one["messages"]["HEARTBEAT"]["message"]["type"]) == (1, "HEARTBEAT")
    assert "ATTITUDE" in tree["vehicles"]["2"]["components"]["1"]["messages"]
    assert served.get("/v1/mavlink/vehicles").json.keys() == tree["vehicles"].keys()


def test_get_attitude(served: Served) -> None:
    served.hear("ATTITUDE", **ATTITUDE)
    reply = served.get(f"{MESSAGES}/ATTITUDE")
    assert (reply.status, reply.headers["content-type"]) == (200, "application/json")
    assert reply.json["message"] == {"type": "ATTITUDE", **ATTITUDE}
    assert reply.text.startswith('{\n  "message": {\n    "pitch": 0.5,')  # pretty, and in the alphabet's order
    times = reply.json["status"]["time"]
    assert times.keys() == {"counter", "first_update", "frequency", "last_update"}
    assert datetime.fromisoformat(times["first_update"].replace("Z", "+00:00")) <= datetime.fromisoformat(
        times["last_update"].replace("Z", "+00:00")
    )


def test_get_the_time_of_the_last_attitude(served: Served) -> None:
    served.hear("ATTITUDE", **ATTITUDE)
    last = served.get(f"{MESSAGES}/ATTITUDE/status/time/last_update").json
    assert last == served.get(f"{MESSAGES}/ATTITUDE").json["status"]["time"]["last_update"]
    assert served.get(f"{MESSAGES}/ATTITUDE/message/roll").text == "0.25"


def test_get_a_message_s_structure(served: Served) -> None:
    floats = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.0)
    assert served.get("/v1/helper/mavlink?name=ATTITUDE").json == {
        "header": {"system_id": 255, "component_id": 0, "sequence": 0},
        "message": {"type": "ATTITUDE", "time_boot_ms": 0, **floats},
    }
    command = served.get("/v1/helper/mavlink?name=COMMAND_LONG").json["message"]
    assert list(command)[:2] == ["type", "param1"]
    assert command["command"] == {"type": "MAV_CMD_NAV_WAYPOINT"}
    assert (command["param7"], command["confirmation"], type(command["param1"])) == (0.0, 0, float)
    heartbeat = served.get("/v1/helper/mavlink?name=HEARTBEAT").json["message"]
    assert heartbeat["mavtype"] == {"type": "MAV_TYPE_GENERIC"}
    assert heartbeat["autopilot"] == {"type": "MAV_AUTOPILOT_GENERIC"}
    assert heartbeat["system_status"] == {"type": "MAV_STATE_UNINIT"}
    assert heartbeat["base_mode"].startswith("MAV_MODE_FLAG_")
    assert (heartbeat["mavlink_version"], heartbeat["custom_mode"]) == (3, 0)


@pytest.mark.parametrize("param1", [1.0, 0.0])
def test_arm_and_disarm(served: Served, param1: float) -> None:
    body = {**ARM, "message": {**ARM["message"], "param1": param1}}
    reply = served.post("/v1/mavlink", body, Content_Type="application/json")
    assert (reply.status, reply.body) == (200, b"")
    ((key, data),) = served.sent(1)
    assert key == "zmav/demo/quad1/mav/tx/1/1/COMMAND_LONG"
    frame = parse_frame(data, load_dialect())
    fields = decode(frame, load_dialect())
    assert (frame.sysid, frame.compid, fields["command"], fields["param1"]) == (255, 240, 400, param1)


def test_the_websocket_s_filter(served: Served) -> None:
    with websocket(served, "?filter=RC_.*") as ws:
        raw: dict[str, Any] = {f"chan{n}_raw": 1500 for n in range(1, 19)}
        with_rssi: dict[str, Any] = {"time_boot_ms": 3122812, "chancount": 16, "rssi": 0}
        until_read(served, ws)
        served.hear("ATTITUDE", **ATTITUDE)
        frame = served.hear("RC_CHANNELS", **with_rssi, **raw)
        came = next_of(ws)
    sequence = parse_frame(frame, load_dialect()).seq
    assert came["header"] == {"system_id": 1, "component_id": 1, "sequence": sequence}
    assert came["message"] == {"type": "RC_CHANNELS", **with_rssi, **raw}


def test_info_and_the_other_prefixes(served: Served) -> None:
    info = served.get("/info").json
    assert info["version"] == 0
    assert info["service"].keys() == {"name", "version", "sha", "build_date", "authors"}
    served.hear("HEARTBEAT", **HEARTBEAT)
    for prefix in ("", "/v1", "/mavlink2rest", "/mavlink2rest/v1"):
        path = f"{prefix}/mavlink/vehicles/1/components/1/messages/HEARTBEAT/message/mavlink_version"
        assert served.get(path).text == "3"
        assert served.get(f"{prefix}/helper/mavlink?name=ATTITUDE").status == 200
        with websocket(served, path=f"{prefix}/ws/mavlink") as ws:
            until_read(served, ws)


# Shapes.


def test_enums_flags_and_mavtype(served: Served) -> None:
    served.hear("HEARTBEAT", **HEARTBEAT)
    message = served.get(f"{MESSAGES}/HEARTBEAT/message").json
    assert message["mavtype"] == {"type": "MAV_TYPE_QUADROTOR"}
    assert message["system_status"] == {"type": "MAV_STATE_ACTIVE"}
    assert set(message["base_mode"].split(" | ")) == {
        f"MAV_MODE_FLAG_{name}_ENABLED" for name in ("CUSTOM_MODE", "STABILIZE", "MANUAL_INPUT")
    }
    served.hear("HEARTBEAT", **{**HEARTBEAT, "type": 250, "base_mode": 0})
    message = served.get(f"{MESSAGES}/HEARTBEAT/message").json
    assert (message["mavtype"], message["base_mode"]) == ({"type": 250}, "")


def test_text_arrays_and_nan(served: Served) -> None:
    served.hear("STATUSTEXT", severity="MAV_SEVERITY_INFO", text="hello")
    assert served.get(f"{MESSAGES}/STATUSTEXT/message/text").json == "hello"
    served.hear(
        "ATTITUDE_QUATERNION_COV",
        time_usec=1,
        q=[1, 0, 0, 0],
        rollspeed=None,
        pitchspeed=0,
        yawspeed=0,
        covariance=[0.5] * 9,
    )
    path = f"{MESSAGES}/ATTITUDE_QUATERNION_COV/message"
    assert served.get(f"{path}/q").json == [1, 0, 0, 0]
    assert served.get(f"{path}/q/0").json == 1
    assert served.get(f"{path}/q/4").status == 404
    nothing = served.get(f"{path}/rollspeed")
    assert (nothing.status, nothing.text) == (200, "null")


def test_the_counter_starts_at_one_and_the_frequency_is_an_average(served: Served) -> None:
    for count in (1, 2, 3):
        served.hear("HWSTATUS", compid=7, Vcc=5000, I2Cerr=0)
        times = served.get("/v1/mavlink/vehicles/1/components/7/messages/HWSTATUS/status/time").json
        assert times["counter"] == count
        assert (times["frequency"] > 0) == (count > 1)


def test_every_message_s_template_can_be_sent_and_read(served: Served) -> None:
    dialect = load_dialect()
    for name in dialect.by_name:
        given = json.loads(json.dumps(template(name, dialect, (255, 0))))
        frame = parse_frame(frame_of(given, dialect, (255, 0), served.gateway.next_seq), dialect)
        assert json.loads(json.dumps(document(frame, dialect)))["message"] == given["message"], name


def test_every_message_can_be_shown_whatever_its_bytes() -> None:
    dialect, chance = load_dialect(), random.Random(3)
    for kind in dialect.by_id.values():
        for payload in (b"\xff" * kind.max_length, b"\x80" * kind.max_length, chance.randbytes(kind.max_length)):
            frame = parse_frame(build_frame(kind, payload, 1, 1, 0), dialect)
            shown = json.loads(msgspec.json.encode(document(frame, dialect)))["message"]
            assert len(shown) == len(kind.fields) + 1, kind.name


# What is wrong.


@pytest.mark.parametrize(
    "path",
    [
        "/v1/mavlink/nix",
        "/v1/mavlink/vehicles/9",
        "/v1/mavlink/vehicles/x/components",
        f"{MESSAGES}/NOSUCH",
        f"{MESSAGES}/HEARTBEAT/message/nix",
        f"{MESSAGES}/HEARTBEAT/message/mavtype/type/more",
        f"{MESSAGES}/%00",
        "/v1/mavlink/vehicles/1/components/1/messages/HEARTBEAT/message/../../status",
        "/v1/helper/nix",
    ],
)
def test_a_missing_path_is_404_in_json(served: Served, path: str) -> None:
    served.hear("HEARTBEAT", **HEARTBEAT)
    reply = served.get(path)
    assert reply.status in (400, 404) if "%00" in path else reply.status == 404
    assert isinstance(reply.json, str)


def test_an_unknown_name_has_no_structure(served: Served) -> None:
    reply = served.get("/v1/helper/mavlink?name=NOSUCH")
    assert (reply.status, reply.json) == (404, "Invalid message name.")
    assert served.get("/v1/helper/mavlink").status == 400


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"", "not a JSON object"),
        (b"\xff\xfe", "not a JSON object"),
        (b"[" * 100_000, "not a JSON object"),
        (b"[]", "not a JSON object"),
        (b'{"message": 5}', "expected"),
        (b'{"message": 5, "message": 6}', "message is given twice"),
        (b'{"message": {"type": "SYSTEM_TIME", "type": "SET_MODE"}}', "type"),
        (b'{"message": {}}', "has no type"),
        (b'{"message": {"type": "NOSUCH"}}', "no message 'NOSUCH'"),
        (b'{"message": {"type": "HEARTBEAT"}}', "mavtype: missing"),
        (b'{"header": {"system_id": 256}, "message": {"type": "SYSTEM_TIME"}}', "256"),
        (b'{"header": {"system_id": true}, "message": {"type": "SYSTEM_TIME"}}', "True"),
        (b'{"header": {"colour": 1}, "message": {"type": "SYSTEM_TIME"}}', "no colour"),
        (b'{"message": {"type": "SYSTEM_TIME", "time_unix_usec": {"a": 1}, "time_boot_ms": 1e99}}', "time_boot_ms"),
        (b'{"message": {"type": "SET_MODE", "target_system": 9, "base_mode": 1, "custom_mode": 1}}', "system id 9"),
    ],
)
def test_a_bad_post_is_404_with_its_reason(served: Served, body: bytes, said: str) -> None:
    reply = served.post("/v1/mavlink", body)
    assert reply.status == 404
    assert said in reply.json
    assert not served.tx


def test_a_message_without_a_target_goes_to_every_vehicle(served: Served) -> None:
    message = {"type": "SYSTEM_TIME", "time_unix_usec": 5, "time_boot_ms": 6}
    assert served.post("/v1/mavlink", {"header": {"component_id": 1}, "message": message}).status == 200
    sent = served.sent(2)
    assert sorted(key.split("/")[2] for key, _ in sent) == ["quad1", "quad2"]
    assert {parse_frame(data, load_dialect()).compid for _, data in sent} == {1}


def test_bits_as_older_versions_had_them_are_taken(served: Served) -> None:
    message = {**served.get("/v1/helper/mavlink?name=HEARTBEAT").json["message"], "base_mode": {"bits": 128}}
    assert served.post("/v1/mavlink", {"message": message}).status == 200
    assert {decode(parse_frame(data, load_dialect()), load_dialect())["base_mode"] for _, data in served.sent(2)} == {
        128
    }


# The WebSocket.


def until_read(served: Served, ws: ClientConnection) -> None:
    """Wait until the gateway has taken the client in: it answers, and what is heard from then on is sent."""
    ws.send("hello?")
    assert str(ws.recv(30.0)).startswith("Could not convert input message.")


def test_a_websocket_sends_too(served: Served) -> None:
    with websocket(served, "?filter=SEND_ONLY") as ws:
        ws.send(json.dumps(ARM))
        assert ws.recv(30.0) == f"Ok({len(served.sent(1)[0][1])})"
        ws.send(json.dumps({**ARM, "message": {**ARM["message"], "target_system": 9}}))
        assert str(ws.recv(30.0)).startswith("Err(no vehicle has system id 9")
        ws.send(b"\x00\xff")  # no text: nobody's message
        ws.send(r'{"header": {"\ud800": 1}, "message": {"type": "HEARTBEAT"}}')
        assert "not a JSON object" in str(ws.recv(30.0))
        ws.send("[" * 5000)
        assert "not a JSON object" in str(ws.recv(30.0))


def test_without_a_filter_everything_comes(served: Served) -> None:
    with websocket(served) as ws:
        until_read(served, ws)
        served.hear("HEARTBEAT", **HEARTBEAT)
        served.hear("ATTITUDE", **{**ATTITUDE, "roll": None})
        served.hear_raw("zmav/demo/quad1/mav/rx/1/1/ATTITUDE", b"\xfd no frame")
        served.hear_raw("zmav/demo/quad1/mav/rx/1/1/UNKNOWN_410", b"\xfd no frame")
        served.hear("HEARTBEAT", "quad2", 2, **HEARTBEAT)
        came = [next_of(ws) for _ in range(3)]
    assert [each["message"]["type"] for each in came] == ["HEARTBEAT", "ATTITUDE", "HEARTBEAT"]
    assert came[1]["message"]["roll"] is None
    assert came[2]["header"]["system_id"] == 2
    served.hear("ATTITUDE", **ATTITUDE)


def test_a_filter_that_names_a_message_asks_for_it(served: Served) -> None:
    asked, wanted = threading.Event(), keys.WANT.key("*", "*", msg="AHRS2", hz="*", instance="*")
    heard = served.session.liveliness().declare_subscriber(wanted, lambda sample: asked.set())
    with websocket(served, "?filter=^AHRS2$|NOSUCH"):
        assert asked.wait(30.0)
    heard.undeclare()


@pytest.mark.parametrize(
    "bad",
    [
        "(",
        "*",
        "a" * 501,
        "(([A-Z_])%2B)%2Bx$",
        "a{99999999999}",
        "A|" * 200 + "(",
        "^.*|" * 99 + "*",
        "[z-a]",
        ".*A.*B.*",
        "(A|A)(A|A)(A|A)",
    ],
)
def test_a_bad_filter_is_refused(served: Served, bad: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        websocket(served, f"?filter={bad}")
    assert refused.value.response.status_code == 400
    assert "filter" in json.loads(refused.value.response.body or b"")


def test_a_filter_may_have_groups_and_sets(served: Served) -> None:
    with websocket(served, "?filter=^(RC|AHRS).*[0-9]$") as ws:
        until_read(served, ws)
        served.hear("ATTITUDE", **ATTITUDE)
        served.hear("AHRS3", roll=0, pitch=0, yaw=0, altitude=0, lat=0, lng=0, v1=0, v2=0, v3=0, v4=0)
        assert next_of(ws)["message"]["type"] == "AHRS3"


@pytest.fixture
def flood(serve: Serve) -> Iterator[Served]:
    served = serve(stalled=1.0)
    served.vehicle("quad1", 1)
    yield served


def test_who_does_not_read_is_cut_off_and_nobody_waits(flood: Served) -> None:
    texts = {"severity": "MAV_SEVERITY_INFO", "text": "x" * 50}
    frame = encode(load_dialect(), "STATUSTEXT", texts, sysid=1, compid=1)
    key = keys.RX.key("demo", "quad1", sys=1, comp=1, msg="STATUSTEXT")
    sockets: RestSockets = flood.face("/v1/ws/mavlink")
    url = f"ws://127.0.0.1:{flood.port}/v1/ws/mavlink?filter=STATUSTEXT"
    with (
        small_socket(flood.port) as silent,
        connect(url, sock=silent, max_queue=1, close_timeout=0.1, ping_interval=None),
        websocket(flood, "?filter=HEARTBEAT") as other,
    ):
        flood.until(lambda: len(sockets) == 2, "two clients")
        flood.linked(key)
        while sockets.dropped == 0:
            for _ in range(500):
                flood.session.put(key, frame)
            flood.hear("HEARTBEAT", **HEARTBEAT)
            assert next_of(other)["message"]["type"] == "HEARTBEAT"
        flood.until(lambda: len(sockets) == 1, "end of the one that does not read")
        peer = silent.getsockname()[1]
        flood.until(lambda: not held(flood.port, peer), "end of its connection, though it still reads nothing")


def held(port: int, peer: int) -> bool:
    """The kernel still keeps what was sent from ``port`` to ``peer``."""
    ends = [line.split()[1:3] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return any((int(ours[9:], 16), int(theirs[9:], 16)) == (port, peer) for ours, theirs in ends)


def small_socket(port: int) -> socket.socket:
    """Connected, with little room for what is not read."""
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.connect(("127.0.0.1", port))
    return sock
