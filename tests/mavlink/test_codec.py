"""The codec by example: decode, describe, encode and what it refuses, targets, Packer."""

from __future__ import annotations

import json
import math
import sys
import threading
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zmav.errors import BadMessage
from zmav.mavlink import (
    Dialect,
    Frame,
    Packer,
    Splitter,
    decode,
    describe,
    encode,
    load_dialect,
    parse_frame,
    targets,
)

HEARTBEAT = {"type": 2, "autopilot": 3, "base_mode": 81, "custom_mode": 4, "system_status": 4}


def frame_of(dialect: Dialect, name: str, /, *, version: int = 2, **fields: Any) -> Frame:
    return parse_frame(Packer(dialect, 1, 1, version=version).pack(name, **fields), dialect)


def refused(dialect: Dialect, name: str, fields: Any, **header: int) -> dict[str, str]:
    with pytest.raises(BadMessage) as caught:
        encode(dialect, name, fields, **({"sysid": 1, "compid": 1} | header))
    bad: dict[str, str] = caught.value.detail["fields"]
    for field, why in bad.items():
        assert f"{field}: {why}" in str(caught.value)
    return bad


# --- decode


def test_fields_come_in_declared_order_with_zeros_put_back(dialect: Dialect) -> None:
    fields = decode(frame_of(dialect, "HEARTBEAT", type=2), dialect)
    assert list(fields.items()) == [
        ("type", 2),
        ("autopilot", 0),
        ("base_mode", 0),
        ("custom_mode", 0),
        ("system_status", 0),
        ("mavlink_version", 3),
    ]


def test_arrays_are_lists_and_chars_are_text(dialect: Dialect) -> None:
    battery = decode(frame_of(dialect, "BATTERY_STATUS", voltages=list(range(10))), dialect)
    assert battery["voltages"] == list(range(10))
    assert battery["voltages_ext"] == [0, 0, 0, 0]
    text = decode(frame_of(dialect, "STATUSTEXT", severity=6, text="Arm: Höhe"), dialect)
    assert text["text"] == "Arm: Höhe"


def test_text_ends_at_nul_and_bad_bytes_are_replaced(dialect: Dialect) -> None:
    frame = frame_of(dialect, "STATUSTEXT", severity=6, text=b"ab\xffc\0rest")
    text = decode(frame, dialect)["text"]
    assert text == "ab\ufffdc"
    again = encode(dialect, "STATUSTEXT", describe(frame, dialect).fields, sysid=1, compid=1)
    assert decode(parse_frame(again, dialect), dialect)["text"] == "ab?c"


def test_text_full_of_bad_bytes_still_fits_when_encoded_again(dialect: Dialect) -> None:
    frame = frame_of(dialect, "STATUSTEXT", severity=6, text=b"\xff" * 50)
    again = encode(dialect, "STATUSTEXT", describe(frame, dialect).fields, sysid=1, compid=1)
    assert decode(parse_frame(again, dialect), dialect)["text"] == "?" * 50


def test_mavlink_1_has_no_extensions(dialect: Dialect) -> None:
    frame = frame_of(dialect, "SYS_STATUS", version=1, load=500, voltage_battery=12000)
    fields = decode(frame, dialect)
    assert (fields["load"], fields["voltage_battery"]) == (500, 12000)
    assert fields["onboard_control_sensors_health_extended"] == 0


def test_newer_fields_at_the_end_are_left_alone(dialect: Dialect) -> None:
    from zmav.mavlink.frame import build_frame

    data = build_frame(dialect.message("HEARTBEAT"), bytes([4, 0, 0, 0, 2, 3, 81, 4, 3, 99, 98]), 1, 1, 0)
    assert decode(parse_frame(data, dialect), dialect) == HEARTBEAT | {"mavlink_version": 3}


def test_decode_of_an_unknown_message(dialect: Dialect) -> None:
    (frame,) = Splitter(dialect).feed(b"\xfd\x01\0\0\0\x01\x01\xea\xab\0\x07\0\0")
    with pytest.raises(BadMessage, match="no message 44010"):
        decode(frame, dialect)


def test_a_frame_nobody_checked_is_checked_by_the_dialect_that_can(dialect: Dialect) -> None:
    minimal = load_dialect("minimal")
    data = Packer(dialect, 1, 1).pack("ATTITUDE", roll=0.5)
    (frame,) = Splitter(minimal).feed(data)
    assert not frame.verified
    assert decode(frame, dialect)["roll"] == 0.5
    assert describe(frame, dialect).verified
    (spoilt,) = Splitter(minimal).feed(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(BadMessage, match="checksum"):
        decode(spoilt, dialect)
    shown = describe(spoilt, dialect)
    assert (shown.verified, list(shown.fields)) == (False, ["payload"])


# --- describe


def test_describe_names_enums_flags_and_units(dialect: Dialect) -> None:
    shown = describe(frame_of(dialect, "HEARTBEAT", type=2, base_mode=209, system_status=4), dialect)
    assert shown.fields["type"] == "MAV_TYPE_QUADROTOR"
    assert shown.fields["base_mode"] == (
        "MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | MAV_MODE_FLAG_STABILIZE_ENABLED"
        " | MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | MAV_MODE_FLAG_SAFETY_ARMED"
    )
    assert shown.fields["custom_mode"] == 0
    position = describe(frame_of(dialect, "GLOBAL_POSITION_INT", lat=-353632621), dialect)
    assert position.units["lat"] == "degE7"
    assert position.units["vx"] == "cm/s"
    assert "HEARTBEAT" not in position.units
    assert (position.name, position.id, position.sysid, position.compid) == ("GLOBAL_POSITION_INT", 33, 1, 1)
    assert (position.seq, position.signed, position.verified) == (0, False, True)


def test_values_without_a_name_stay_numbers(dialect: Dialect) -> None:
    fields = describe(frame_of(dialect, "HEARTBEAT", type=250, base_mode=0), dialect).fields
    assert (fields["type"], fields["base_mode"]) == (250, 0)


def test_flags_without_a_name_are_left_as_a_number(dialect: Dialect) -> None:
    unnamed = 1 << 9
    assert unnamed not in dialect.enums["MAV_POWER_STATUS"].values()
    assert describe(frame_of(dialect, "POWER_STATUS", flags=unnamed), dialect).fields["flags"] == unnamed
    both = describe(frame_of(dialect, "POWER_STATUS", flags=unnamed | 2), dialect).fields["flags"]
    assert both == "MAV_POWER_STATUS_SERVO_VALID | 512"
    assert decode(frame_of(dialect, "POWER_STATUS", flags=both), dialect)["flags"] == unnamed | 2


def test_nan_and_infinity_are_null_and_null_is_nan(dialect: Dialect) -> None:
    frame = frame_of(dialect, "ATTITUDE", roll=math.nan, pitch=math.inf, yaw=1.5)
    shown = describe(frame, dialect)
    assert (shown.fields["roll"], shown.fields["pitch"], shown.fields["yaw"]) == (None, None, 1.5)
    back = decode(parse_frame(encode(dialect, "ATTITUDE", shown.fields, sysid=1, compid=1), dialect), dialect)
    assert math.isnan(back["roll"])
    assert math.isnan(back["pitch"])
    assert json.loads(msgspec.json.encode(shown))["fields"]["roll"] is None


def test_describe_of_an_unknown_message(dialect: Dialect) -> None:
    (frame,) = Splitter(dialect).feed(b"\xfd\x02\0\0\x09\x05\x06\xea\xab\0\x07\xff\0\0")
    shown = describe(frame, dialect)
    assert (shown.name, shown.id, shown.sysid, shown.compid, shown.seq) == ("UNKNOWN_44010", 44010, 5, 6, 9)
    assert shown.fields == {"payload": "07ff"}
    assert not shown.verified


# --- encode


def test_encode_takes_numbers_names_and_flags(dialect: Dialect) -> None:
    by_name = {
        "type": "MAV_TYPE_QUADROTOR",
        "autopilot": "MAV_AUTOPILOT_ARDUPILOTMEGA",
        "base_mode": "MAV_MODE_FLAG_CUSTOM_MODE_ENABLED|MAV_MODE_FLAG_STABILIZE_ENABLED | 0x40",
        "custom_mode": 4.0,
        "system_status": "4",
    }
    expected = encode(dialect, "HEARTBEAT", HEARTBEAT, sysid=1, compid=1, seq=3)
    assert encode(dialect, "HEARTBEAT", by_name, sysid=1, compid=1, seq=3) == expected


def test_mavlink_version_need_not_be_given_but_may(dialect: Dialect) -> None:
    short = encode(dialect, "HEARTBEAT", HEARTBEAT, sysid=1, compid=1)
    assert encode(dialect, "HEARTBEAT", HEARTBEAT | {"mavlink_version": 3}, sysid=1, compid=1) == short
    assert decode(parse_frame(short, dialect), dialect)["mavlink_version"] == 3


def test_byte_arrays_may_be_short_and_bytes(dialect: Dialect) -> None:
    fields = {"target_network": 0, "target_system": 1, "target_component": 1}
    as_list = encode(dialect, "FILE_TRANSFER_PROTOCOL", fields | {"payload": [1, 2, 3]}, sysid=1, compid=1)
    as_bytes = encode(dialect, "FILE_TRANSFER_PROTOCOL", fields | {"payload": b"\1\2\3"}, sysid=1, compid=1)
    assert as_list == as_bytes
    assert decode(parse_frame(as_list, dialect), dialect)["payload"] == [1, 2, 3] + [0] * 248


def test_extensions_may_be_left_out(dialect: Dialect) -> None:
    ack = encode(dialect, "COMMAND_ACK", {"command": "MAV_CMD_NAV_LAND", "result": 0}, sysid=1, compid=1)
    assert decode(parse_frame(ack, dialect), dialect)["progress"] == 0


def test_every_bad_field_is_named_at_once(dialect: Dialect) -> None:
    bad = refused(
        dialect,
        "BATTERY_STATUS",
        {
            "id": -1,
            "battery_function": "MAV_BATTERY_FUNCTION_AL",
            "type": [],
            "temperature": 40000,
            "voltages": [1, 2, 3],
            "current_consumed": "many",
            "energy_consumed": 1.5,
            "battery_remaining": None,
            "voltages_ext": [0, 0, "x", 0],
            "colour": "red",
            "fault_bitmask": "MAV_BATTERY_FAULT_SPIKES | WRONG",
        },
    )
    assert bad == {
        "id": "-1 is out of range; expected an integer from 0 to 255",
        "battery_function": "'MAV_BATTERY_FUNCTION_AL' is no entry of MAV_BATTERY_FUNCTION"
        "; did you mean MAV_BATTERY_FUNCTION_ALL, MAV_BATTERY_FUNCTION_PAYLOAD, MAV_BATTERY_FUNCTION_AVIONICS?",
        "type": "[] is not an integer from 0 to 255 or an entry of MAV_BATTERY_TYPE",
        "temperature": "40000 is out of range; expected an integer from -32768 to 32767",
        "voltages": "3 elements; expected a list of 10 values, each an integer from 0 to 65535",
        "current_battery": "missing; expected an integer from -32768 to 32767",
        "current_consumed": "'many' is not an integer from -2147483648 to 2147483647",
        "energy_consumed": "1.5 is not an integer from -2147483648 to 2147483647",
        "battery_remaining": "None is not an integer from -128 to 127",
        "voltages_ext": "[2]: 'x' is not an integer from 0 to 65535",
        "colour": bad["colour"],
        "fault_bitmask": bad["fault_bitmask"],
    }
    assert bad["colour"].startswith("no such field; BATTERY_STATUS has id, battery_function, ")
    assert bad["fault_bitmask"].startswith("'WRONG' is no entry of MAV_BATTERY_FAULT")


def test_bad_text_floats_and_arrays(dialect: Dialect) -> None:
    assert refused(dialect, "STATUSTEXT", {"severity": 6, "text": "x" * 51}) == {
        "text": "51 bytes; expected text of at most 50 bytes"
    }
    assert refused(dialect, "STATUSTEXT", {"severity": 6, "text": 5}) == {"text": "5 is not text of at most 50 bytes"}
    attitude = {"time_boot_ms": 0, "roll": "left", "pitch": 1e39, "yaw": 10**400, "rollspeed": True}
    bad = refused(dialect, "ATTITUDE", attitude | {"pitchspeed": [1], "yawspeed": 0})
    assert bad["roll"] == "'left' is not a number or null"
    assert bad["pitch"] == "1e+39 is out of range of a float"
    assert "out of range of a float" in bad["yaw"]
    assert bad["rollspeed"] == "True is not a number or null"
    assert bad["pitchspeed"] == "[1] is not a number or null"
    assert set(bad) == {"roll", "pitch", "yaw", "rollspeed", "pitchspeed"}
    wheels = {"time_usec": 0, "count": 2, "distance": [0.0] * 17}
    assert refused(dialect, "WHEEL_DISTANCE", wheels) == {
        "distance": "17 elements; expected a list of 16 values, each a number or null"
    }
    assert (
        "not a list of up to 251 values"
        in refused(
            dialect,
            "FILE_TRANSFER_PROTOCOL",
            dict.fromkeys(("target_network", "target_system", "target_component"), 0) | {"payload": "text"},
        )["payload"]
    )


def test_names_are_refused_where_there_is_no_enum(dialect: Dialect) -> None:
    assert "custom_mode" in refused(dialect, "HEARTBEAT", HEARTBEAT | {"custom_mode": "GUIDED"})
    assert "type" in refused(dialect, "HEARTBEAT", HEARTBEAT | {"type": "MAV_TYPE_QUADROTOR | MAV_TYPE_GCS"})


@pytest.mark.parametrize(
    ("header", "field"),
    [
        ({"sysid": 256}, "sysid"),
        ({"sysid": -1}, "sysid"),
        ({"compid": True}, "compid"),
        ({"compid": 1.0}, "compid"),
        ({"seq": 256}, "seq"),
        ({"version": 3}, "version"),
    ],
)
def test_bad_header(dialect: Dialect, header: dict[str, Any], field: str) -> None:
    assert list(refused(dialect, "HEARTBEAT", HEARTBEAT, **header)) == [field]


def test_mavlink_1_carries_no_extension_and_no_large_id(dialect: Dialect) -> None:
    ack = {"command": 21, "result": 0}
    short = encode(dialect, "COMMAND_ACK", ack | {"progress": 0}, sysid=1, compid=1, version=1)
    assert short[:2] == b"\xfe\x03"
    assert refused(dialect, "COMMAND_ACK", ack | {"progress": 7}, version=1) == {
        "progress": "an extension field, which MAVLink 1 cannot carry"
    }
    wind = dict.fromkeys((field.name for field in dialect.message("WIND_COV").fields), 0)
    assert encode(dialect, "WIND_COV", wind, sysid=1, compid=1, version=1)[0] == 0xFE
    assert list(refused(dialect, "WHEEL_DISTANCE", {"time_usec": 0, "count": 0, "distance": [0] * 16}, version=1)) == [
        "version"
    ]


def test_unknown_message_suggests_names(dialect: Dialect) -> None:
    with pytest.raises(BadMessage, match="did you mean HEARTBEAT"):
        encode(dialect, "HEARTBEET", {}, sysid=1, compid=1)


@pytest.mark.parametrize("fields", [None, [], "text", 5])
def test_fields_of_the_wrong_shape(dialect: Dialect, fields: Any) -> None:
    with pytest.raises(BadMessage, match="HEARTBEAT: the fields are a"):
        encode(dialect, "HEARTBEAT", fields, sysid=1, compid=1)


# --- targets, Packer


def test_targets(dialect: Dialect) -> None:
    command = frame_of(dialect, "COMMAND_LONG", target_system=7, target_component=1, command=400)
    assert targets(command, dialect) == (7, 1)
    assert targets(frame_of(dialect, "COMMAND_LONG", version=1, target_system=7, target_component=9), dialect) == (7, 9)
    assert targets(frame_of(dialect, "MANUAL_CONTROL", target=5), dialect) == (5, 0)
    assert targets(frame_of(dialect, "SET_MODE", target_system=3, custom_mode=1), dialect) == (3, 0)
    assert targets(frame_of(dialect, "HEARTBEAT", type=2), dialect) == (0, 0)


def test_targets_among_the_zeros_left_out(dialect: Dialect) -> None:
    frame = frame_of(dialect, "PARAM_REQUEST_LIST")
    assert frame.payload == b"\0"
    assert targets(frame, dialect) == (0, 0)


def test_targets_of_an_unknown_message(dialect: Dialect) -> None:
    assert targets(Frame(b"\xfd\x01\0\0\0\x01\x01\xea\xab\0\x07\0\0", 44010, False), dialect) == (0, 0)


def test_targets_agree_with_the_decoded_fields_for_every_message(dialect: Dialect) -> None:
    for message in dialect.by_id.values():
        wanted = {
            name: number
            for name, number in (("target_system", 11), ("target_component", 22))
            if name in message.by_name and not message.by_name[name].length
        }
        frame = frame_of(dialect, message.name, **wanted)
        expected = (wanted.get("target_system", 0), wanted.get("target_component", 0))
        assert targets(frame, dialect) == expected, message.name


def test_packer_numbers_its_frames_and_defaults_to_zero(dialect: Dialect) -> None:
    packer = Packer(dialect, 9, 191)
    frames = [parse_frame(packer.pack("SYSTEM_TIME", time_boot_ms=k), dialect) for k in range(300)]
    assert [frame.seq for frame in frames] == [k & 0xFF for k in range(300)]
    assert {(frame.sysid, frame.compid) for frame in frames} == {(9, 191)}
    assert decode(frames[7], dialect) == {"time_unix_usec": 0, "time_boot_ms": 7}


def test_a_refused_message_uses_up_no_sequence_number(dialect: Dialect) -> None:
    packer = Packer(dialect, 9, 191)
    with pytest.raises(BadMessage):
        packer.pack("ATTITUDE", heading=3)
    assert parse_frame(packer.pack("ATTITUDE"), dialect).seq == 0


def test_packer_packs_fields_called_name_and_self(dialect: Dialect) -> None:
    data = Packer(dialect, 1, 1).pack("NAMED_VALUE_FLOAT", name="speed", value=2.5)
    assert decode(parse_frame(data, dialect), dialect) == {"time_boot_ms": 0, "name": "speed", "value": 2.5}


def test_packer_makes_the_frames_that_encode_makes(dialect: Dialect) -> None:
    """Messages of plain numbers go a quicker way, which must not show."""
    packer, quick = Packer(dialect, 7, 191), 0
    for message in dialect.by_id.values():
        numbers = {field.name: 3 + i for i, field in enumerate(message.fields) if not field.length}
        if message.max_length and len(numbers) == len(message.fields):
            seq, quick = quick & 255, quick + 1
            expected = encode(dialect, message.name, numbers, sysid=7, compid=191, seq=seq)
            assert packer.pack(message.name, **numbers) == expected
    assert quick > 100


@pytest.mark.parametrize("payload", [b"", b"\1\2\3", bytes(range(251)), [7] * 251, [1, 2]])
def test_packer_takes_bytes_as_encode_does(dialect: Dialect, payload: bytes | list[int]) -> None:
    fields = {"target_network": 0, "target_system": 1, "target_component": 1, "payload": payload}
    expected = encode(dialect, "FILE_TRANSFER_PROTOCOL", fields, sysid=7, compid=191)
    assert Packer(dialect, 7, 191).pack("FILE_TRANSFER_PROTOCOL", **fields) == expected


@pytest.mark.parametrize("name, payload", [("FILE_TRANSFER_PROTOCOL", bytes(252)), ("GPS_INJECT_DATA", bytes(111))])
def test_packer_refuses_too_many_bytes(dialect: Dialect, name: str, payload: bytes) -> None:
    field = "payload" if name == "FILE_TRANSFER_PROTOCOL" else "data"
    with pytest.raises(BadMessage) as caught:
        Packer(dialect, 1, 1).pack(name, **{field: payload})
    assert list(caught.value.detail["fields"]) == [field]


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"type": 256}, "type"),
        ({"type": 1.5}, "type"),
        ({"custom_mode": "GUIDED"}, "custom_mode"),
        ({"armed": 1}, "armed"),
        ({"base_mode": None}, "base_mode"),
    ],
)
def test_packer_refuses_what_encode_refuses(dialect: Dialect, fields: dict[str, Any], named: str) -> None:
    with pytest.raises(BadMessage) as caught:
        Packer(dialect, 1, 1).pack("HEARTBEAT", **fields)
    assert list(caught.value.detail["fields"]) == [named]


@pytest.fixture
def hasty_threads() -> Iterator[None]:
    """Threads that take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("hasty_threads")
def test_packer_may_be_used_by_many_threads(dialect: Dialect) -> None:
    packer = Packer(dialect, 1, 1)
    made: list[bytes] = []

    def work() -> None:
        for _ in range(32):
            made.append(packer.pack("HEARTBEAT"))

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(data[4] for data in made) == list(range(256))


# --- any JSON

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(name=st.sampled_from(["HEARTBEAT", "BATTERY_STATUS", "STATUSTEXT", "ATTITUDE"]), data=st.data())
@settings(max_examples=150)
def test_any_json_is_encoded_or_refused_by_name(name: str, data: st.DataObject) -> None:
    dialect = load_dialect()
    message = dialect.message(name)
    given_fields = data.draw(st.fixed_dictionaries({}, optional={field.name: json_values for field in message.fields}))
    try:
        frame = encode(dialect, name, given_fields, sysid=1, compid=1)
    except BadMessage as error:
        assert error.detail["fields"].keys() <= message.by_name.keys()
        assert error.detail["fields"]
    else:
        assert parse_frame(frame, dialect).verified
