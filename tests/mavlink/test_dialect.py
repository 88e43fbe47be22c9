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

OWN = """<?xml version="1.0"?>
<mavlink>
  <include>common.xml</include>
  <enums>
    <enum name="BREW_STATE"><entry name="BREW_COLD"/><entry value="7" name="BREW_HOT"/></enum>
    <enum name="BREW_FLAG" bitmask="true">
      <entry value="1" name="BREW_FLAG_MILK"/><entry value="0x2" name="BREW_FLAG_SUGAR"/>
      <entry value="2**2" name="BREW_FLAG_RUM"/><entry value="3" name="BREW_FLAG_USUAL"/>
      <entry value="0" name="BREW_FLAG_BLACK"/>
    </enum>
  </enums>
  <messages>
    <message id="44000" name="BREW">
      <description>The coffee on board.</description>
      <field type="uint8_t" name="target_system">who</field>
      <field type="uint8_t" name="state" enum="BREW_STATE">state</field>
      <field type="uint16_t" name="flags" enum="BREW_FLAG">what is in it</field>
      <field type="float[2]" name="level" units="cm">levels</field>
      <field type="char[8]" name="cup">its name</field>
      <extensions/>
      <field type="uint32_t" name="age" units="ms">age</field>
    </message>
  </messages>
</mavlink>
"""


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


@pytest.mark.parametrize("name", ["ardupilotmega", "common", "development"])
def test_the_generated_module_and_the_xml_say_the_same(name: str) -> None:
    import pymavlink.dialects.v20 as shipped

    xml = Path(shipped.__path__[0]) / f"{name}.xml"
    if not xml.exists():
        pytest.skip("this pymavlink comes without its XML files")
    generated, read = load_dialect(name), load_dialect(str(xml))
    assert generated.enums == read.enums
    assert generated.by_id.keys() == read.by_id.keys()
    for msgid, message in generated.by_id.items():
        other = read.by_id[msgid]
        assert (message.name, message.crc_extra, message.fields, message.wire_fields) == (
            other.name,
            other.crc_extra,
            other.fields,
            other.wire_fields,
        )


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
def test_a_file_that_means_something_else_by_them_is_refused(tmp_path: Path, number: int, name: str) -> None:
    message = f'<message id="{number}" name="{name}"><field type="uint8_t" name="cup">it</field></message>'
    path = write(tmp_path, f"<mavlink><messages>{message}</messages></mavlink>")
    with pytest.raises(BadConfig, match="is defined in common"):
        load_dialect(path)


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


def test_pymavlink_is_imported_only_for_a_dialect_and_the_environment_stays() -> None:
    code = (
        "import os, sys; before = dict(os.environ); import zmav.mavlink; assert 'pymavlink' not in sys.modules;"
        "zmav.mavlink.load_dialect(); assert 'pymavlink' in sys.modules; assert dict(os.environ) == before"
    )
    root = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": root}, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# --- a user's own XML


def write(folder: Path, text: str, name: str = "own.xml") -> str:
    path = folder / name
    path.write_text(text)
    return str(path)


def test_own_message(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, OWN)
    dialect = load_dialect(path)
    assert dialect.name == "own"
    assert dialect.message("HEARTBEAT").id == 0  # common.xml is not beside it, but pymavlink has it
    brew = dialect.message("BREW")
    assert (brew.id, brew.target_system, brew.base_length, brew.max_length) == (44000, 10, 20, 24)
    assert crc_extra(brew) == brew.crc_extra
    assert brew.by_name["level"] == Field("level", "float", 2, "cm", "", False, False)
    assert brew.by_name["flags"].bitmask
    assert not brew.by_name["state"].bitmask
    assert [field.name for field in brew.fields if field.extension] == ["age"]
    assert dialect.enums["BREW_STATE"] == {"BREW_COLD": 1, "BREW_HOT": 7}
    fields = {"target_system": 3, "state": "BREW_HOT", "flags": "BREW_FLAG_MILK | BREW_FLAG_RUM", "cup": "mug"}
    data = encode(dialect, "BREW", fields | {"level": [1.5, 2], "age": 7}, sysid=1, compid=1)
    (frame,) = Splitter(dialect).feed(data)
    assert frame.verified
    shown = describe(frame, dialect)
    assert shown.fields == fields | {"level": [1.5, 2.0], "age": 7}
    assert shown.units == {"level": "cm", "age": "ms"}
    # Nothing is left behind, and nothing was said.
    assert [entry.name for entry in tmp_path.iterdir()] == ["own.xml"]
    assert capfd.readouterr() == ("", "")


def test_flags_with_names_for_none_and_for_several(tmp_path: Path) -> None:
    dialect = load_dialect(write(tmp_path, OWN))
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


def test_own_message_is_what_pymavlinks_generator_makes_of_it(tmp_path: Path) -> None:
    """The generated Python of the same XML is the independent judge."""
    import importlib.util

    from pymavlink.generator import mavgen, mavparse

    path = write(tmp_path, OWN.replace("<include>common.xml</include>", ""))
    output = tmp_path / "generated.py"
    options = mavgen.Opts(str(output), mavparse.PROTOCOL_2_0, language="Python3", validate=False)
    assert mavgen.mavgen(options, [path])
    spec = importlib.util.spec_from_file_location("generated", output)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    dialect = load_dialect(path)
    data = Packer(dialect, 1, 1).pack("BREW", state=7, flags=5, level=[1.5, -2.0], cup="mug", age=9)
    read = module.MAVLink(None).parse_char(data)
    assert read.to_dict() == {"mavpackettype": "BREW"} | decode(Splitter(dialect).feed(data)[0], dialect)


def test_includes_beside_the_file_come_first(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    write(tmp_path / "parts", "<mavlink><include>../base.xml</include></mavlink>", "middle.xml")
    base = '<message id="1" name="ONE"><field type="uint8_t" name="a">x</field></message>'
    write(tmp_path, f"<mavlink><include>parts/middle.xml</include><messages>{base}</messages></mavlink>", "base.xml")
    path = write(tmp_path, "<mavlink><include>\n  parts/middle.xml </include><include>base.xml</include></mavlink>")
    assert load_dialect(path).by_name.keys() - PX4S_OWN.values() == {"ONE"}


def test_an_included_enum_may_be_extended(tmp_path: Path) -> None:
    field = '<message id="1" name="ONE"><field type="uint8_t" name="a" enum="F">x</field></message>'
    flags = '<enum name="F" bitmask="true"><entry name="F_A" value="1"/></enum>'
    write(tmp_path, f"<mavlink><enums>{flags}</enums><messages>{field}</messages></mavlink>", "base.xml")
    more = '<enum name="F"><entry name="F_B" value="8"/></enum>'
    path = write(tmp_path, f"<mavlink><include>base.xml</include><enums>{more}</enums></mavlink>")
    dialect = load_dialect(path)
    assert dialect.enums["F"] == {"F_A": 1, "F_B": 8}
    assert dialect.message("ONE").by_name["a"].bitmask


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = write(tmp_path, OWN)
    first = load_dialect(path)
    assert load_dialect(path) is first
    write(tmp_path, OWN.replace("BREW", "TEA"))
    os.utime(path, ns=(1, 1))
    assert "TEA" in load_dialect(path).by_name


def test_a_dialect_may_be_named_by_a_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, OWN)
    monkeypatch.chdir(tmp_path)
    assert "BREW" in load_dialect("own.xml").by_name
    assert "BREW" in load_dialect("./own.xml").by_name


def message(inside: str, attributes: str = 'id="44001" name="MINE"') -> str:
    return f"<mavlink><messages><message {attributes}>{inside}</message></messages></mavlink>"


def enum(inside: str) -> str:
    return f'<mavlink><enums><enum name="E">{inside}</enum></enums></mavlink>'


FIELD = '<field type="uint8_t" name="a">x</field>'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not well-formed XML: no element found"),
        ("<mavlink><messages></mavlink>", "not well-formed XML: mismatched tag"),
        ("<html></html>", "its root element is <html>, not <mavlink>"),
        ("<mavlink/>", "it defines no message"),
        ("<mavlink><include>nowhere.xml</include></mavlink>", "it includes 'nowhere.xml', which is neither beside it"),
        (message(""), "message MINE has no fields"),
        (message(FIELD, 'name="MINE"'), 'missing message "id"'),
        (message(FIELD, 'id="many" name="MINE"'), "invalid literal for int"),
        (message(FIELD, 'id="16777216" name="MINE"'), "MINE: id 16777216 does not fit 24 bits"),
        (message(FIELD, 'id="-1" name="MINE"'), "MINE: id -1 does not fit 24 bits"),
        (message('<field type="uint9_t" name="a">x</field>'), "unknown type 'uint9_t'"),
        (message('<field type="uint8_t[x]" name="a">x</field>'), "field a is a uint8_t[x]: arrays have 1 to 255"),
        (message('<field type="uint8_t[0]" name="a">x</field>'), "field a is a uint8_t[0]: arrays have 1 to 255"),
        (message('<field type="uint8_t[256]" name="a">x</field>'), "field a is a uint8_t[256]: arrays have 1 to 255"),
        (message('<field type="uint8_t[3" name="a">x</field>'), "field a is a uint8_t[3: arrays have 1 to 255"),
        (message('<field type="double[32]" name="a">x</field>'), "message MINE is longer than 255 bytes"),
        (message(FIELD * 2), "Duplicate field a in message MINE"),
        (message(FIELD + "</message>" + '<message id="44001" name="OTHER">' + FIELD), "Duplicate message id 44001"),
        (message(FIELD + "</message>" + '<message id="44002" name="MINE">' + FIELD), "Duplicate message name MINE"),
        (enum(""), "IndexError"),
        (enum('<entry name="A" value="1"/><entry name="B" value="1"/>'), "Duplicate enum values"),
        (enum('<entry name="A" value="one"/>'), "enum entry A has value 'one', which is no number"),
    ],
)
def test_a_bad_xml_is_refused_by_name(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str, reason: str
) -> None:
    path = write(tmp_path, text)
    with pytest.raises(BadConfig) as caught:
        load_dialect(path)
    assert path in str(caught.value)
    assert reason in str(caught.value)
    assert caught.value.detail["value"] == path
    assert capfd.readouterr() == ("", "")


def test_a_bad_include_is_the_one_named(tmp_path: Path) -> None:
    other = write(tmp_path, "<mavlink>", "other.xml")
    with pytest.raises(BadConfig, match="not well-formed") as caught:
        load_dialect(write(tmp_path, "<mavlink><include>other.xml</include></mavlink>"))
    assert caught.value.detail["value"] == other


def test_an_entrys_value_is_never_run(tmp_path: Path) -> None:
    """The generator hands it to eval()."""
    trap = tmp_path / "trap"
    entry = f'<entry name="A" value="open(&apos;{trap}&apos;, &apos;w&apos;) and 1"/>'
    with pytest.raises(BadConfig, match="enum entry A has value"):
        load_dialect(write(tmp_path, f'<mavlink><enums><enum name="E">{entry}</enum></enums></mavlink>'))
    assert not trap.exists()


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match=r"missing\.xml: No such file"):
        load_dialect(str(tmp_path / "missing.xml"))
    with pytest.raises(BadConfig, match="Is a directory"):
        load_dialect(str(tmp_path))
