"""What rmw_zenoh's design says, held against other people's implementations of it."""

from __future__ import annotations

import re
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from zenoh_ros2_sdk import entity, keyexpr, utils
from zenoh_ros2_sdk.attachment import Attachment as TheirAttachment
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

from ground.ros2 import attachment, graph
from ground.ros2.attachment import Attachment
from ground.ros2.qos import LATCHED, RELIABLE, SENSOR, RosQos
from ground.ros2.types import INTERFACES, Types, known
from zmav.errors import BadInput

NODE = graph.Node(3, "f9980ee0495eaafb3e38f0d19e2eae12", 7, "/quad1", "zmav")
IMU = graph.Endpoint(NODE, 9, graph.PUBLISHER, "/quad1/imu/data", "sensor_msgs/msg/Imu", "RIHS01_ab", SENSOR)
MESSAGES = (
    "std_msgs/msg/String",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/BatteryState",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TwistStamped",
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/Log",
    "mavros_msgs/msg/State",
    "mavros_msgs/msg/ExtendedState",
    "mavros_msgs/msg/StatusText",
)


def test_tokens_and_keys_are_those_of_another_implementation() -> None:
    their: Any = entity  # its dataclasses are made by a decorator that tells mypy nothing
    theirs = their.NodeEntity(3, NODE.zid, 7, "zmav", "/quad1")
    assert NODE.token == keyexpr.node_liveliness_keyexpr(theirs)
    dds = utils.ros2_to_dds_type("sensor_msgs/msg/Imu")
    kind = entity.EntityKind.PUBLISHER
    end = their.EndpointEntity(theirs, 9, kind, "/quad1/imu/data", dds, "RIHS01_ab", SENSOR.encode())
    assert keyexpr.endpoint_liveliness_keyexpr(end) == IMU.token
    assert keyexpr.topic_keyexpr(3, "/quad1/imu/data", dds, "RIHS01_ab") == IMU.key


def test_a_service_of_the_design_document_is_read() -> None:
    token = (
        "@ros2_lv/2/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
        "example_interfaces::srv::dds_::AddTwoInts_/RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf303643588"
        "39c81a/::,10:,:,:,,"
    )
    found = graph.parse(token)
    assert found is not None
    assert (found.node.path, found.name, found.type) == (
        "/add_two_ints_server",
        "/add_two_ints",
        "example_interfaces/srv/AddTwoInts",
    )
    assert found.token == token


@pytest.mark.parametrize("qos", [RELIABLE, SENSOR, LATCHED, RosQos(depth=1)])
def test_qos_is_read_alike(qos: RosQos) -> None:
    theirs = QosProfile.decode(qos.encode())
    assert (theirs.reliability is QosReliability.RELIABLE) == qos.reliable
    assert (theirs.durability is QosDurability.TRANSIENT_LOCAL) == qos.transient_local
    assert theirs.history_depth == qos.depth
    assert theirs.encode() == qos.encode()
    assert RosQos.decode(theirs.encode()) == qos


def test_what_leaves_it_to_the_middleware_is_read() -> None:
    """RMW's numbers go on: 3 is unknown, 4 and 5 are the best available."""
    found = RosQos.decode("4:5:1,20:,:,:5,,")
    assert (found.reliable, found.transient_local, found.depth) == (True, False, 20)


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_have_33_bytes_and_are_read_alike(sequence: int, stamp: int, gid: bytes) -> None:
    data = Attachment(sequence, stamp, gid).encode()
    assert len(data) == 33 == attachment.SIZE
    theirs = TheirAttachment.from_bytes(data)
    assert (theirs.sequence_id, theirs.timestamp_ns, theirs.gid) == (sequence, stamp, gid)
    assert theirs.to_bytes() == data
    assert attachment.read(data) == (sequence, stamp, gid)


@given(st.binary(max_size=100))
def test_any_other_attachment_is_refused(data: bytes) -> None:
    if len(data) == 33 and data[16] == 16:
        attachment.read(data)
        return
    with pytest.raises(BadInput):
        attachment.read(data)


def test_the_attachment_that_ended_a_process_of_another_is_refused() -> None:
    """Jazzy's rmw_zenoh 0.2.0 to 0.2.3 named its fields: 77 bytes."""
    named = b"".join(
        struct.pack("<Q", len(name)) + name + data
        for name, data in (
            (b"sequence_number", bytes(8)),
            (b"source_timestamp", bytes(8)),
            (b"source_gid", b"\x10" + bytes(16)),
        )
    )
    with pytest.raises(BadInput, match="33 bytes"):
        attachment.read(named)
    with pytest.raises(BadInput, match="none"):
        attachment.read(None)
    with pytest.raises(ValueError, match="16 bytes"):
        attachment.write(1, b"short")


def test_a_gid_is_the_128_bits_of_xxh3_little_endian() -> None:
    """The hash of nothing, as XXH3's own test has it: 99aa06d3014798d86001c324468d497f."""
    assert graph.gid_of("")[::-1].hex() == "99aa06d3014798d86001c324468d497f"
    assert IMU.gid == graph.gid_of(IMU.token)


@given(st.text(max_size=200) | st.lists(st.text(max_size=12), min_size=13, max_size=13).map("/".join))
def test_any_token_is_read_or_left(token: str) -> None:
    found = graph.parse(token)
    assert found is None or isinstance(found, graph.Endpoint)


@given(st.data())
def test_a_spoilt_token_is_read_or_left(data: st.DataObject) -> None:
    parts = IMU.token.split("/")
    place = data.draw(st.integers(0, len(parts) - 1))
    parts[place] = data.draw(st.text(max_size=30))
    graph.parse("/".join(parts))


@pytest.mark.parametrize(("ours", "theirs"), [("quad-1", "quad_1"), ("7up", "v_7up"), ("rover", "rover"), ("_a", "_a")])
def test_a_name_is_one_that_ros_takes(ours: str, theirs: str) -> None:
    assert graph.ros_name(ours) == theirs


def dependencies(name: str) -> tuple[str, dict[str, str]]:
    """A definition, and those of what it holds by their full names, from the text that a schema has."""
    first, *rest = known().definition(name).split("=" * 80 + "\nMSG: ")
    held = {}
    for each in rest:
        short, _, text = each.partition("\n")
        package, last = short.split("/")
        held[f"{package}/msg/{last}"] = text
    return first, held


@pytest.mark.parametrize("name", MESSAGES)
def test_hashes_are_those_of_another_implementation(name: str) -> None:
    text, held = dependencies(name)
    assert utils.get_type_hash(name, text, held) == known().hash(name)


def test_hashes_are_those_that_ros_gives() -> None:
    """As rmw_zenoh's design document has them."""
    types = Types()
    types.define("example_interfaces/srv/AddTwoInts_Request", "int64 a\nint64 b")
    types.define("example_interfaces/srv/AddTwoInts_Response", "int64 sum")
    message, service = types.hash("std_msgs/msg/String"), types.hash("example_interfaces/srv/AddTwoInts")
    assert message == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert service == "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"


# As several implementations of ROS 2's clients have them, beside which these were taken from Jazzy's own packages.
SERVICES = {
    "DescribeParameters": "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
    "GetParameterTypes": "da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
    "SetParameters": "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    "SetParametersAtomically": "0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
    "ListParameters": "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
}


@pytest.mark.parametrize("name", SERVICES)
def test_hashes_of_parameter_services_are_those_that_ros_gives(name: str) -> None:
    assert known().hash(f"rcl_interfaces/srv/{name}") == f"RIHS01_{SERVICES[name]}"


def test_a_cancel_has_the_hash_that_ros_installs() -> None:
    """As /opt/ros has it in action_msgs/srv/CancelGoal.json. hiroz 0.2.1 works out another."""
    digest = "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
    assert known().hash("action_msgs/srv/CancelGoal") == f"RIHS01_{digest}"


IDL = """
abstract any alias attribute bitfield bitmask bitset boolean case char component connector const consumes context custom
default double emits enum eventtype exception factory finder fixed float getraises home import in inout interface local
long manages map module multiple native object octet oneway out port porttype primarykey private provides public
publishes raises readonly sequence setraises short string struct supports switch truncatable typedef typeid typename
typeprefix union unsigned uses valuebase valuetype void wchar wstring
"""
"""its keywords"""


@pytest.mark.parametrize("path", sorted((INTERFACES / "zmav_msgs").glob("*/*.*")), ids=lambda path: path.name)
def test_our_own_package_has_names_that_rosidl_takes(path: Any) -> None:
    """It makes IDL of them first, whose words no field may have."""
    assert re.fullmatch(r"[A-Z][A-Za-z0-9]*", path.stem)
    lines = [line for line in path.read_text().splitlines() if line and line[0] != "#" and line != "---"]
    for kind, _, name in (line.partition(" ") for line in lines):
        if "=" in name:
            assert re.fullmatch(r"[A-Z][A-Z_]*=\d+", name)
        else:
            assert re.fullmatch(r"[a-z]([a-z0-9_]?[a-z0-9])*", name), name
            assert name not in IDL.split(), f"{kind} {name}"


# The SDK takes no bounded sequence (FloatingPointRange[<=1]), which one of them has.
OTHERS = [path for path in sorted(INTERFACES.glob("*/srv/*.srv")) if path.stem != "DescribeParameters"]


@pytest.mark.parametrize("path", OTHERS, ids=lambda path: path.stem)
def test_services_hashes_are_those_of_another_implementation(path: Any) -> None:
    name = f"{path.parts[-3]}/srv/{path.stem}"
    request, answer = f"\n{path.read_text()}".split("\n---\n")
    held: dict[str, str] = {}
    package = path.parts[-3]
    for line in f"{request}\n{answer}".splitlines():
        kind = line.partition(" ")[0].removesuffix("[]")
        full = kind.replace("/", "/msg/") if "/" in kind else f"{package}/msg/{kind}"
        if kind[:1].isupper() or "/" in kind:
            text, more = dependencies(full)
            held |= {full: text, **more}
    filler = "uint8 structure_needs_at_least_one_member"
    theirs = utils.compute_service_type_hash(name, request.strip() or filler, answer, held)
    assert known().hash(name) == theirs


@pytest.mark.parametrize("name", MESSAGES)
def test_another_decoder_reads_what_we_write(name: str) -> None:
    types = known()
    message = types.make(name)
    _fill(message, iter(range(1, 10_000)))
    theirs = generate_dynamic(name, types.definition(name))[name](types.encode(message, name))
    assert _plain(theirs) == _plain(message)


def _fill(message: Any, numbers: Any) -> None:
    """Every field another value."""
    for field in message.__dataclass_fields__:
        value = getattr(message, field)
        if field == "__msgtype__" or field.isupper():
            continue
        if hasattr(value, "__dataclass_fields__"):
            _fill(value, numbers)
        elif isinstance(value, str):
            setattr(message, field, f"text {next(numbers)}")
        elif isinstance(value, bool):
            setattr(message, field, bool(next(numbers) % 2))
        elif isinstance(value, (int, float)):
            setattr(message, field, type(value)(next(numbers) % 100))
        elif hasattr(value, "dtype"):
            value[:] = [next(numbers) % 100 for _ in value]


def _plain(message: Any) -> Any:
    names = getattr(message, "__slots__", None) or getattr(message, "__dataclass_fields__", None)
    if names and not isinstance(message, str):
        return {name: _plain(getattr(message, name)) for name in names if name[0] != "_" and not name.isupper()}
    if hasattr(message, "__iter__") and not isinstance(message, str):
        return [_plain(each) for each in message]
    return message


@given(st.binary(max_size=400), st.sampled_from([*MESSAGES, "rcl_interfaces/srv/SetParameters_Request"]))
def test_any_bytes_are_a_message_or_refused(data: bytes, name: str) -> None:
    for each in (data, b"\x00\x01\x00\x00" + data):
        try:
            known().decode(each, name)
        except BadInput as e:
            assert e.detail["field"] == name


@given(st.data())
def test_a_spoilt_message_is_a_message_or_refused(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(MESSAGES))
    message = known().make(name)
    _fill(message, iter(range(1, 10_000)))
    spoilt = bytearray(known().encode(message, name))
    for place in data.draw(st.lists(st.integers(0, len(spoilt) - 1), max_size=8)):
        spoilt[place] = data.draw(st.integers(0, 255))
    try:
        known().decode(bytes(spoilt), name)
    except BadInput:
        return


def test_too_much_is_not_read() -> None:
    with pytest.raises(BadInput, match="too much"):
        known().decode(bytes(2 << 20), "std_msgs/msg/String")


def test_a_field_that_is_none_is_a_mistake_of_ours() -> None:
    with pytest.raises(TypeError, match="no colour"):
        known().make("std_msgs/msg/String", colour=1)
