"""The codec for the public zenoh command: frames to JSON and back, JSON as it is, and nothing that raises."""

from __future__ import annotations

import json
from importlib.metadata import entry_points

import pytest

from zmav import keys
from zmav.errors import BadMessage
from zmav.mavlink import decode, encode, load_dialect, parse_frame
from zmav.zenoh_codec import decode as to_text
from zmav.zenoh_codec import encode_text

RX = keys.RX.key("demo", "quad1", sys=1, comp=1, msg="ATTITUDE")
TX = keys.TX.key("demo", "quad1", sys=1, comp=1, msg="SET_MODE")
ANGLES = {"time_boot_ms": 5, "roll": 0.5, "pitch": 0, "yaw": -1, "rollspeed": 0, "pitchspeed": 0, "yawspeed": None}


def test_zenoh_cli_finds_it() -> None:
    for group, function in (("decoders", to_text), ("encoders", encode_text)):
        (point,) = entry_points(group=f"zenoh_cli.codecs.{group}", name="mavlink")
        assert point.load() is function


def test_a_frame_is_shown_with_names_and_units() -> None:
    frame = encode(load_dialect(), "ATTITUDE", ANGLES, sysid=1, compid=1, seq=9)
    for key in (RX, RX.replace("/rx/", "/tx/")):
        shown = json.loads(to_text(key, frame))
        assert (shown["name"], shown["seq"], shown["verified"]) == ("ATTITUDE", 9, True)
        assert (shown["fields"]["roll"], shown["fields"]["yawspeed"], shown["units"]["roll"]) == (0.5, None, "rad")


def test_a_message_nobody_knows_is_shown_in_hexadecimal_digits() -> None:
    unknown = bytes.fromhex("fd02000007010160ea00abcd1234")
    shown = json.loads(to_text(RX.replace("ATTITUDE", "UNKNOWN_60000"), unknown))
    assert (shown["name"], shown["fields"], shown["verified"]) == ("UNKNOWN_60000", {"payload": "abcd"}, False)


@pytest.mark.parametrize("text", ['{"t": 1.5, "é": [null, true]}', "[]", '"words"', "7"])
def test_json_passes_through_on_one_line(text: str) -> None:
    shown = to_text("zmav/demo/quad1/state", json.dumps(json.loads(text), indent=2).encode())
    assert "\n" not in shown
    assert json.loads(shown) == json.loads(text)


def test_what_is_neither_is_shown_as_it_is() -> None:
    assert json.loads(to_text("zmav/demo/quad1/camera/x/frame", b"\xff\xd8")) == {"hex": "ffd8"}
    assert json.loads(to_text(RX, b"\xfdjunk"))["hex"] == "fd6a756e6b"
    assert "not a MAVLink frame" in json.loads(to_text(RX, b""))["error"]


def test_it_never_raises_for_bottomless_json() -> None:
    assert json.loads(to_text("zmav/demo/quad1/state", b"[" * 100_000))["hex"].startswith("5b5b")


def test_fields_become_a_frame_named_and_addressed_by_the_key() -> None:
    dialect = load_dialect()
    frame = parse_frame(encode_text(TX, '{"base_mode": "MAV_MODE_STABILIZE_DISARMED", "custom_mode": 4}'), dialect)
    assert (frame.sysid, frame.compid, dialect.name_of(frame.msgid)) == (255, 190, "SET_MODE")
    assert decode(frame, dialect) == {"target_system": 1, "base_mode": 80, "custom_mode": 4}
    other = parse_frame(encode_text(TX, '{"base_mode": 1, "custom_mode": 4, "target_system": 2}'), dialect)
    assert decode(other, dialect)["target_system"] == 2


@pytest.mark.parametrize(
    ("key", "text", "words"),
    [
        (TX, "{", "JSON object"),
        (TX, "[1]", "JSON object"),
        (TX, '{"base_mode": 1}', "custom_mode: missing"),
        (TX, '{"base_mode": 1, "custom_mode": "four"}', "custom_mode"),
        (TX.replace("SET_MODE", "SETMODE"), "{}", "did you mean SET_MODE"),
        (TX.replace("/1/1/", "/x/1/"), "{}", "numbers in the key"),
    ],
)
def test_bad_fields_are_named(key: str, text: str, words: str) -> None:
    with pytest.raises(BadMessage, match=words):
        encode_text(key, text)


def test_other_text_is_put_as_it_is() -> None:
    assert encode_text("zmav/demo/@fleet/goal", '{"é": 1}') == '{"é": 1}'.encode()
