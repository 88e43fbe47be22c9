"""Dialects: what pymavlink's tables become, and a user's own XML."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from zmav.errors import BadConfig, BadMessage
from zmav.mavlink import (
    Dialect,
    Field,
    MessageType,
    Packer,
    Splitter,
    decode,
    describe,
    encode,
    load_dialect,
    parse_frame,
)
from zmav.mavlink.checksum import crc
from zmav.mavlink.definitions import with_additions


def crc_extra(message: MessageType) -> int:
    """By the definition: over the name and the fields that are no extensions, in wire order."""
    text = f"{message.name} ".encode()
    for field in message.wire_fields:
        if not field.extension:
            text += f"{field.type} {field.name} ".encode() + (bytes([field.length]) if field.length else b"")
    return (crc(text) & 0xFF) ^ (crc(text) >> 8)


@pytest.mark.parametrize("name", ["ardupilotmega", "common", "development", "minimal"])
def test_extension_fields_are_told_from_base_fields(name: str) -> None:
    """crc_extra covers exactly the base fields, which proves which ones they are, and their order."""
    for message in load_dialect(name).by_id.values():
        assert crc_extra(message) == message.crc_extra, message.name
        assert message.max_length == message.struct.size <= 255
        assert {field.name for field in message.wire_fields} == set(message.by_name)
        if not any(field.extension for field in message.fields):
            assert message.base_length == message.max_length


def test_what_a_message_knows(dialect: Dialect) -> None:
    status = dialect.message("SYS_STATUS")
    assert (status.id, status.crc_extra, status.base_length, status.max_length) == (1, 124, 31, 43)
    assert status.fields[3] == Field("load", "uint16_t", 0, "d%", "", False, False)
    assert status.by_name["onboard_control_sensors_present"].bitmask
    assert status.by_name["onboard_control_sensors_health_extended"].extension
    battery = dialect.message("BATTERY_STATUS")
    assert battery.by_name["voltages"] == Field("voltages", "uint16_t", 10, "mV", "", False, False)
    assert battery.by_name["voltages_ext"].extension
    command = dialect.message(76)
    assert (command.name, command.target_system, command.target_component) == ("COMMAND_LONG", 30, 31)
    assert dialect.message("MANUAL_CONTROL").target_system == 10
    assert dialect.message("HEARTBEAT").target_system is None


PX4S_OWN = {
    8: "LINK_NODE_STATUS",
    380: "TIME_ESTIMATE_TO_TARGET",
    410: "EVENT",
    411: "CURRENT_EVENT_SEQUENCE",
    412: "REQUEST_EVENT",
    413: "RESPONSE_EVENT_ERROR",
    435: "AVAILABLE_MODES",
    436: "CURRENT_MODE",
}


@pytest.mark.parametrize("name", ["ardupilotmega", "common", "development"])
def test_messages_of_px4_that_pymavlink_lacks_have_their_names(name: str) -> None:
    """Their layouts are proven by :func:`test_extension_fields_are_told_from_base_fields`."""
    dialect = load_dialect(name)
    assert {msgid: dialect.name_of(msgid) for msgid in PX4S_OWN} == PX4S_OWN
    offboard = {"standard_mode": 0, "custom_mode": 50593792, "intended_custom_mode": 6 << 16}
    sent = encode(dialect, "CURRENT_MODE", offboard, sysid=1, compid=1)
    assert decode(parse_frame(sent, dialect), dialect) == offboard
    event = dialect.message("EVENT")
    assert [field.name for field in event.fields][:3] == ["destination_component", "destination_system", "id"]
    assert [field.name for field in event.wire_fields][:3] == ["id", "event_time_boot_ms", "sequence"]


@pytest.mark.parametrize(("number", "name"), [(410, "BREW"), (44001, "CURRENT_MODE")])
def test_a_dialect_that_means_something_else_by_them_is_refused(number: int, name: str) -> None:
    own = MessageType.build(number, name, 7, [Field("cup", "uint8_t")], ["cup"])
    with pytest.raises(BadConfig, match="is defined in common"):
        with_additions([own])


def test_flags_with_names_for_none_and_for_several() -> None:
    flags = {"BREW_FLAG_MILK": 1, "BREW_FLAG_SUGAR": 2, "BREW_FLAG_RUM": 4, "BREW_FLAG_USUAL": 3, "BREW_FLAG_BLACK": 0}
    field = Field("flags", "uint16_t", enum="BREW_FLAG", bitmask=True)
    dialect = Dialect.build("own", "", [MessageType.build(44000, "BREW", 7, [field], ["flags"])], {"BREW_FLAG": flags})
    packer, splitter = Packer(dialect, 1, 1), Splitter(dialect)
    shown = [describe(splitter.feed(packer.pack("BREW", flags=k))[0], dialect).fields["flags"] for k in (0, 3, 7, 13)]
    assert shown == [
        "BREW_FLAG_BLACK",
        "BREW_FLAG_USUAL",
        "BREW_FLAG_MILK | BREW_FLAG_SUGAR | BREW_FLAG_RUM",
        "BREW_FLAG_MILK | BREW_FLAG_RUM | 8",
    ]
    data = [packer.pack("BREW", flags=text) for text in (*shown, "BREW_FLAG_USUAL | 4")]
    assert [decode(splitter.feed(frame)[0], dialect)["flags"] for frame in data] == [0, 3, 7, 13, 7]


def test_names_and_values(dialect: Dialect) -> None:
    assert dialect.name_of(0) == "HEARTBEAT"
    assert dialect.name_of(44000) == "UNKNOWN_44000"
    assert dialect.value("MAV_TYPE", "MAV_TYPE_QUADROTOR") == 2
    assert dialect.enum_name("MAV_TYPE", 2) == "MAV_TYPE_QUADROTOR"
    assert dialect.enum_name("MAV_TYPE", 250) is None
    assert dialect.enum_name("NO_ENUM", 1) is None
    assert not any(name.endswith("_ENUM_END") for entries in dialect.enums.values() for name in entries)


def test_unknown_names_are_refused_with_suggestions(dialect: Dialect) -> None:
    with pytest.raises(BadMessage, match="did you mean ATTITUDE") as caught:
        dialect.message("attitud")
    assert caught.value.detail["value"] == "attitud"
    with pytest.raises(BadMessage, match=r"no message 44000$"):
        dialect.message(44000)
    with pytest.raises(BadMessage, match=r"no message \[\]"):
        dialect.message([])  # type: ignore[arg-type]
    with pytest.raises(BadMessage, match="did you mean MAV_TYPE_QUADROTOR"):
        dialect.value("MAV_TYPE", "MAV_TYPE_QUADROTER")
    with pytest.raises(BadMessage, match="did you mean MAV_TYPE"):
        dialect.value("MAV_TYP", "X")


def test_dialects_are_loaded_once() -> None:
    assert load_dialect("common") is load_dialect("common")
    assert load_dialect() is load_dialect("ardupilotmega")


def test_a_dialects_repr_is_short(dialect: Dialect) -> None:
    assert repr(dialect).startswith("<Dialect ardupilotmega: ")
    assert repr(dialect.message(0)) == "<MessageType HEARTBEAT (0)>"


@pytest.mark.parametrize("name", ["", "arducopter", "__init__", "..common", "common;", "os"])
def test_unknown_dialect(name: str) -> None:
    with pytest.raises(BadConfig) as caught:
        load_dialect(name)
    assert repr(name) in str(caught.value)
    assert "ardupilotmega" in caught.value.detail["expected"]


def run_python(code: str) -> None:
    """In a process of its own, where nothing was loaded before; it must say nothing."""
    root = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": root}, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_pymavlink_is_imported_only_for_a_dialect_and_the_environment_stays() -> None:
    run_python(
        "import os, sys; before = dict(os.environ); import zmav.mavlink; assert 'pymavlink' not in sys.modules;"
        "zmav.mavlink.load_dialect(); assert 'pymavlink' in sys.modules; assert dict(os.environ) == before"
    )


def test_no_message_class_of_pymavlinks_stays() -> None:
    run_python(
        "import gc, zmav.mavlink; zmav.mavlink.load_dialect(); gc.collect();"
        "names = {each.__name__ for each in gc.get_objects() if isinstance(each, type)};"
        "left = {name for name in names if name.startswith('MAVLink_')};"
        "assert left <= {'MAVLink_message', 'MAVLink_header'}, left"
    )


def test_a_module_that_somebody_else_imported_is_left_alone() -> None:
    run_python(
        "from pymavlink.dialects.v20 import ardupilotmega as theirs; import zmav.mavlink; zmav.mavlink.load_dialect();"
        "assert theirs.MAVLink_heartbeat_message.id == 0"
    )
