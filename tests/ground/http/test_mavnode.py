"""The MAVNode face: what MATLAB's urlread gets."""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from ground.feed import Origin
from ground.http.reply import Failure
from ground.http.streams import MOST, FrameStream, FrameStreams, Wish
from tests.waiting import wait_until
from zmav import keys, wire
from zmav.mavlink import decode, load_dialect, parse_frame

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

ATTITUDE: dict[str, Any] = {
    "time_boot_ms": 5,
    "roll": 0.25,
    "pitch": -0.5,
    "yaw": 1.0,
    "rollspeed": 0.0,
    "pitchspeed": 0.0,
    "yawspeed": 0.0,
}


@pytest.fixture
def ear() -> Iterator[socket.socket]:
    """A UDP socket as a script has one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(30.0)
        yield sock


def test_vehicles_are_a_line_each(served: Served) -> None:
    reply = served.get("/vehicles")
    assert reply.status == 200
    assert reply.headers["content-type"].startswith("text/plain")
    assert reply.text.splitlines() == ["quad1 1 1 ardupilot copter GUIDED 0", "quad2 2 1 ardupilot copter GUIDED 0"]


def test_what_a_vehicle_says_makes_no_line_of_its_own(serve: Serve) -> None:
    served = serve()
    served.vehicle("quad1")
    about: dict[str, Any] = {
        "t": time.time(),
        "fleet": "demo",
        "name": "quad1",
        "instance": "quad11",
        "connected": True,
    }
    evil = "LOITER\nquad9 9 1 ardupilot copter\x0bGUIDED 1"
    served.session.put(keys.STATE.key("demo", "quad1"), wire.encode(wire.VehicleState(sysid=1, mode=evil, **about)))
    wait_until(lambda: "LOITER" in served.get("/vehicles").text, "the mode")
    assert len(served.get("/vehicles").text.splitlines()) == 1
    served.hear("STATUSTEXT", severity=6, text="one\rage 0\x0btwo", id=0, chunk_seq=0)
    assert "text one age 0 two" in served.get("/last/1/1/STATUSTEXT").text.splitlines()


def test_the_last_message_as_text(served: Served) -> None:
    served.hear("ATTITUDE", **ATTITUDE)
    lines = dict(line.split(" ", 1) for line in served.get("/last/1/1/ATTITUDE").text.splitlines())
    assert float(lines.pop("age")) >= 0.0
    assert lines == {name: f"{value:g}" for name, value in ATTITUDE.items()}


def test_arrays_enums_text_and_nan_of_a_last_message(served: Served) -> None:
    fields = {"time_usec": 1, "controls": [0.5, *[0.0] * 7], "mode": "MAV_MODE_PREFLIGHT", "nav_mode": 7}
    served.hear(
        "HIL_CONTROLS",
        roll_ailerons=None,
        pitch_elevator=0,
        yaw_rudder=0,
        throttle=0,
        aux1=0,
        aux2=0,
        aux3=0,
        aux4=0,
        mode="MAV_MODE_PREFLIGHT",
        nav_mode=7,
        time_usec=1,
    )
    text = served.get("/last/1/1/HIL_CONTROLS").text
    assert "\nroll_ailerons nan\n" in text
    assert f"\nmode {fields['mode']}\n" in text
    served.hear(
        "ATTITUDE_QUATERNION_COV",
        time_usec=1,
        q=[1, 0, 0, 0],
        rollspeed=0,
        pitchspeed=0,
        yawspeed=0,
        covariance=[0.5] * 9,
    )
    assert "\nq 1 0 0 0\n" in served.get("/last/1/1/ATTITUDE_QUATERNION_COV").text


def test_a_message_nobody_heard_says_what_there_is(served: Served) -> None:
    served.hear("ATTITUDE", **ATTITUDE)
    reply = served.get("/last/1/1/NOSUCH")
    assert reply.status == 404
    assert reply.text.startswith("no NOSUCH was heard of 1/1; there are ATTITUDE")
    assert reply.text.count("\n") == 1
    assert "1 (quad1), 2 (quad2)" in served.get("/last/9/1/ATTITUDE").text


def test_asking_for_a_message_has_the_autopilot_send_it(served: Served) -> None:
    wanted = keys.WANT.key("demo", "quad2", msg="VFR_HUD", hz="*", instance="*")
    assert served.get("/last/2/1/VFR_HUD").status == 404  # nobody sends it: this is no autopilot
    tokens = [str(reply.ok.key_expr) for reply in served.session.liveliness().get(wanted) if reply.ok]
    assert len(tokens) == 1
    assert tokens[0].split("/")[5] == "4"
    served.hear("HEARTBEAT", "quad2", 2, type=2, autopilot=3, base_mode=0, custom_mode=0, system_status=4)
    assert served.get("/last/2/1/HEARTBEAT").status == 200
    any_ = keys.WANT.key("demo", "quad2", msg="HEARTBEAT", hz="*", instance="*")
    assert not list(served.session.liveliness().get(any_))  # it comes by itself, and no faster for us


@pytest.mark.parametrize(
    ("path", "status", "said"),
    [
        ("/last/x/1/ATTITUDE", 400, "sys is 'x'"),
        ("/last/256/1/ATTITUDE", 400, "sys is '256'"),
        ("/last/1.5/1/ATTITUDE", 400, "sys is '1.5'"),
        ("/last/1/-1/ATTITUDE", 400, "comp is '-1'"),
        ("/last/1/1", 404, "there is no /last/1/1"),
        ("/stream/1/1?hz=0", 400, "hz is '0'"),
        ("/stream/1/1?hz=nan", 400, "hz is 'nan'"),
        ("/stream/1/1?port=70000", 400, "port is '70000'"),
        ("/stream/1/1?rate=5", 400, "no such parameter: 'rate'"),
        ("/stream/1/1?msg=NOSUCH", 400, "no message 'NOSUCH'"),
        ("/stream/9/1", 404, "no vehicle has system id 9; there are 1 (quad1), 2 (quad2)"),
        ("/stop/2/77", 404, "no stream of 2/77"),
        ("/send/1/1/NOSUCH", 404, "no message 'NOSUCH'"),
        ("/send/9/1/SET_MODE?base_mode=1&custom_mode=4", 404, "no vehicle has system id 9"),
    ],
)
def test_what_is_wrong_is_a_line_of_text(served: Served, path: str, status: int, said: str) -> None:
    reply = served.get(path)
    assert (reply.status, reply.headers["content-type"].split(";")[0]) == (status, "text/plain")
    assert said in reply.text
    assert reply.text.count("\n") == 1


def test_a_message_is_sent(served: Served) -> None:
    reply = served.get("/send/1/1/SET_MODE", base_mode="MAV_MODE_GUIDED_DISARMED", custom_mode=4)
    assert (reply.status, reply.text) == (200, "SET_MODE sent to quad1 (18 bytes)\n")
    ((key, data),) = served.sent(1)
    assert key == "zmav/demo/quad1/mav/tx/1/1/SET_MODE"
    frame = parse_frame(data, load_dialect())
    assert decode(frame, load_dialect()) == {"target_system": 1, "base_mode": 88, "custom_mode": 4}
    assert (frame.sysid, frame.compid) == (255, 190)


def test_numbers_and_arrays_are_sent(served: Served) -> None:
    reply = served.get(
        "/send/2/1/SET_ATTITUDE_TARGET",
        time_boot_ms="0x10",
        type_mask="128.0",
        q="1,0,0,0",
        body_roll_rate="nan",
        body_pitch_rate="0",
        body_yaw_rate="-1e-3",
        thrust=".5",
    )
    assert reply.status == 200, reply.text
    ((key, data),) = served.sent(1)
    assert key == "zmav/demo/quad2/mav/tx/2/1/SET_ATTITUDE_TARGET"
    fields = decode(parse_frame(data, load_dialect()), load_dialect())
    assert (fields["time_boot_ms"], fields["type_mask"], fields["q"]) == (16, 128, [1, 0, 0, 0])
    assert fields["body_roll_rate"] != fields["body_roll_rate"]


def test_what_has_no_target_goes_to_the_vehicle_asked_for(served: Served) -> None:
    assert served.get("/send/2/1/SYSTEM_TIME", time_unix_usec=5, time_boot_ms=6).status == 200
    assert served.sent(1)[0][0] == "zmav/demo/quad2/mav/tx/2/1/SYSTEM_TIME"


def test_every_fault_of_a_send_is_named(served: Served) -> None:
    reply = served.get("/send/1/1/SET_ATTITUDE_TARGET")
    missing = "time_boot_ms, type_mask, q, body_roll_rate, body_pitch_rate, body_yaw_rate, thrust"
    assert (reply.status, reply.text) == (400, f"SET_ATTITUDE_TARGET was not sent; missing: {missing}\n")
    reply = served.get("/send/1/1/SET_MODE", base_mode="NO_MODE", custom_mode=-1, colour="red")
    assert reply.status == 400
    assert all(said in reply.text for said in ("colour: no such field", "base_mode: 'NO_MODE'", "custom_mode: -1"))
    assert "given twice" in served.get("/send/1/1/SET_MODE?base_mode=1&base_mode=2&custom_mode=1").text
    other = served.get("/send/1/1/SET_MODE", base_mode=1, custom_mode=1, target_system=2)
    assert (other.status, other.text) == (400, "target_system is 2, but it was to go to 1/1\n")
    served.get("/send/1/1/SYSTEM_TIME", time_unix_usec=5, time_boot_ms=6)
    assert [key.rpartition("/")[2] for key, _ in served.sent(1)] == ["SYSTEM_TIME"]  # and none of those above


def test_a_vehicle_s_refusal_is_the_answer(served: Served) -> None:
    key = "zmav/demo/quad1/mav/tx/1/1/SET_MODE"

    def refuse(_: object) -> None:
        event = wire.Event(t=0.0, kind="refused", severity="warning", text=f"frame on {key} refused: a clash")
        served.session.put(keys.EVENT.key("demo", "quad1"), wire.encode(event))

    listener = served.session.declare_subscriber(key, refuse)
    reply = served.get("/send/1/1/SET_MODE", base_mode=1, custom_mode=4)
    listener.undeclare()
    assert reply.status == 409
    assert reply.text == f"quad1: frame on {key} refused: a clash\n"
    served.sent(1)


def test_refusals_of_many_frames_are_heard_by_one_subscription(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    served = serve()
    for name, sysid in (("quad1", 1), ("quad2", 2)):
        served.vehicle(name, sysid)
    made, subscribe = list[str](), served.gateway.client.subscribe

    def counted(key: str, *args: Any, **more: Any) -> Any:
        made.append(key)
        return subscribe(key, *args, **more)

    def refuse(sample: zenoh.Sample) -> None:
        event = wire.Event(
            t=0.0, kind="refused", severity="warning", text=f"frame on {sample.key_expr} refused: a clash"
        )
        served.session.put(keys.EVENT.key("demo", "quad1"), wire.encode(event))

    monkeypatch.setattr(served.gateway.client, "subscribe", counted)
    listener = served.session.declare_subscriber("zmav/demo/quad1/mav/tx/1/1/SET_MODE", refuse)
    with ThreadPoolExecutor(6) as pool:
        paths = [f"/send/{1 + number % 2}/1/SET_MODE?base_mode=1&custom_mode=4" for number in range(6)]
        statuses = [reply.status for reply in pool.map(served.get, paths)]
    listener.undeclare()
    assert statuses == [409, 200] * 3
    assert len(made) == 1


def test_two_vehicles_with_one_id_get_nothing(serve: Serve) -> None:
    served = serve()
    served.vehicle("left", 7)
    served.vehicle("right", 7)
    for path in ("/send/7/1/SET_MODE?base_mode=1&custom_mode=4", "/stream/7/1"):
        reply = served.get(path)
        assert reply.status == 409
        assert "demo/left and demo/right share system id 7" in reply.text
    assert not served.tx


def test_a_vehicle_that_is_gone_is_said_to_be(serve: Serve) -> None:
    served = serve()
    served.vehicle("quad1", 1, present=False)  # its state was heard; no token says that it still is
    served.until(lambda: not served.gateway.client.vehicle("quad1").present, "silence for longer than a state's limit")
    assert served.get("/vehicles").text == "quad1 1 1 ardupilot copter - -\n"
    reply = served.get("/send/1/1/SET_MODE", base_mode=1, custom_mode=4)
    assert reply.status == 504
    assert re.match(r"quad1 was last heard \d+\.\d s ago", reply.text)
    assert not served.tx


def test_a_stream_carries_frames_untouched_until_it_is_stopped(served: Served, ear: socket.socket) -> None:
    port = ear.getsockname()[1]
    assert served.get("/stream/1/1", port=port).text == f"{port}\n"
    frames = [served.hear("ATTITUDE", **ATTITUDE), served.hear("SYSTEM_TIME", time_unix_usec=1, time_boot_ms=2)]
    served.hear("ATTITUDE", "quad2", 2, **ATTITUDE)
    served.hear("ATTITUDE", compid=2, **ATTITUDE)
    frames.append(served.hear("ATTITUDE", **ATTITUDE))
    assert [ear.recv(2048) for _ in frames] == frames
    assert served.get("/stop/1/1", port=port).text == "1 stopped\n"
    served.hear("ATTITUDE", **ATTITUDE)
    assert served.get("/stream/1/0", port=port, msg="SYSTEM_TIME").status == 200
    served.hear("ATTITUDE", **ATTITUDE)
    last = served.hear("SYSTEM_TIME", compid=9, time_unix_usec=1, time_boot_ms=2)
    assert ear.recv(2048) == last  # nothing came between
    assert served.get("/stop/1/0").status == 200


def test_a_stream_s_port_is_free_and_stays_the_same(served: Served) -> None:
    port = int(served.get("/stream/2/1").text)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", port))
        sock.settimeout(30.0)
        assert int(served.get("/stream/2/1").text) == port
        assert int(served.get("/stream/2/5").text) != port
        frame = served.hear("ATTITUDE", "quad2", 2, **ATTITUDE)
        assert sock.recv(2048) == frame
    assert served.get("/stop/2/0").text == "2 stopped\n"


def test_a_rate_cap_leaves_out_what_comes_too_soon(served: Served, ear: socket.socket) -> None:
    port = ear.getsockname()[1]
    served.get("/stream/1/1", port=port, hz=0.1)
    frames = [served.hear("ATTITUDE", **{**ATTITUDE, "time_boot_ms": number}) for number in range(1, 31)]
    last = served.hear("SYSTEM_TIME", time_unix_usec=1, time_boot_ms=2)
    assert [ear.recv(2048), ear.recv(2048)] == [frames[0], last]
    served.get("/stop/1/1", port=port)


def test_a_stream_that_is_wished_without_a_rate_meanwhile_takes_the_frame(ear: socket.socket) -> None:
    stream = FrameStream(Wish(1, 0, ("ATTITUDE",), hz=5.0), *ear.getsockname())

    class Asked(str):
        """A name that is looked at just when the stream is asked for again, on another thread."""

        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            stream.wish = Wish(1, 0)
            return super().__eq__(other)

    stream.on_frame(Origin("demo", "quad1", 1, 1, Asked("ATTITUDE"), "key"), b"frame")
    assert ear.recv(100) == b"frame"
    stream.close()


def test_a_stream_that_nobody_receives_ends(serve: Serve) -> None:
    served = serve(stream_timeout=0.2)
    served.vehicle("quad1", 1)
    port = int(served.get("/stream/1/1").text)
    deadline = time.monotonic() + 30.0
    while served.get("/stop/1/9").text != "no stream of 1/9 goes to 127.0.0.1; there are none\n":
        served.hear("ATTITUDE", **ATTITUDE)  # each is refused by the kernel: the port is nobody's
        assert time.monotonic() < deadline
    assert int(served.get("/stream/1/1", port=port).text) == port


def test_streams_are_so_many_and_no_more(served: Served) -> None:
    async def fill() -> int:
        streams = FrameStreams(served.gateway)
        try:
            for port in range(MOST):
                streams.start("127.0.0.1", Wish(1, 1), 20000 + port)
            with pytest.raises(Failure, match="there are 64 streams already"):
                streams.start("127.0.0.1", Wish(1, 1), 30000)
            return len(streams)
        finally:
            streams.close()

    assert served.call(fill()) == MOST
