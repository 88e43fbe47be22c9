"""The key space: what people type, what keys mean, and what is no key."""

from __future__ import annotations

from string import Formatter

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from zmav import keys
from zmav.errors import BadKey


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("quad1", "zmav/demo/quad1/state"),
        ("quad1/", "zmav/demo/quad1/state"),
        ("*", "zmav/demo/*/state"),
        ("quad*", "zmav/demo/quad$*/state"),
        ("quad1/ATTITUDE", "zmav/demo/quad1/mav/rx/*/*/ATTITUDE"),
        ("quad*/ATTITUDE", "zmav/demo/quad$*/mav/rx/*/*/ATTITUDE"),
        ("*/GPS*", "zmav/demo/*/mav/rx/*/*/GPS$*"),
        ("quad1/UNKNOWN_410", "zmav/demo/quad1/mav/rx/*/*/UNKNOWN_410"),
        ("quad1/*", "zmav/demo/quad1/*"),
        ("quad1/**", "zmav/demo/quad1/**"),
        ("quad1/event", "zmav/demo/quad1/event"),
        ("quad1/link/*", "zmav/demo/quad1/link/*"),
        ("quad1/msg/ATTITUDE", "zmav/demo/quad1/msg/ATTITUDE"),
        ("q*d*/ATTITUDE", "zmav/demo/q$*d$*/mav/rx/*/*/ATTITUDE"),
        ("q$*/event", "zmav/demo/q$*/event"),
        ("zmav", "zmav/demo/zmav/state"),
        ("zmav/**", "zmav/**"),
        ("zmav/other/q*/state", "zmav/other/q$*/state"),
        ("zmav/**/**", "zmav/**"),
        ("**", "**"),
        ("**/ATTITUDE", "**/ATTITUDE"),
        ("@/*/router", "@/*/router"),
    ],
)
def test_what_a_person_types(typed: str, meant: str) -> None:
    assert keys.expression(typed, "demo") == meant


@pytest.mark.parametrize(
    "typed", ["", "/", "/quad1", "quad1//state", "zmav/", "zmav//x", "a$b", "qu?d1", "q#", "quad1/a?b=c", "\udcff", "$"]
)
def test_what_is_no_key_expression_is_named(typed: str) -> None:
    with pytest.raises(BadKey) as caught:
        keys.expression(typed, "demo")
    assert caught.value.detail["field"] == "key"
    assert "key expression" in caught.value.message
    assert ".rs" not in caught.value.message


@given(st.text(max_size=40))
def test_any_text_is_a_key_expression_or_named(typed: str) -> None:
    try:
        meant = keys.expression(typed, "demo")
    except BadKey:
        return
    assert str(zenoh.KeyExpr(meant)) == meant


@pytest.mark.parametrize(
    ("key", "channel", "parts"),
    [
        ("zmav/demo/quad1/mav/rx/1/1/ATTITUDE", "rx", {"sys": "1", "comp": "1", "msg": "ATTITUDE"}),
        ("zmav/demo/quad1/mav/tx/0/190/SET_MODE", "tx", {"sys": "0", "comp": "190", "msg": "SET_MODE"}),
        ("zmav/demo/quad1/state", "state", {}),
        ("zmav/demo/quad1/event", "event", {}),
        ("zmav/demo/quad1/msg/ATTITUDE", "msg", {"msg": "ATTITUDE"}),
        ("zmav/demo/quad1/do/arm", "do", {"verb": "arm"}),
        ("zmav/demo/quad1/setpoint/planner", "setpoint", {"agent": "planner"}),
        ("zmav/demo/quad1/link/autopilot", "link", {"link": "autopilot"}),
        ("zmav/demo/ground/agent/planner/status", "agent_status", {"agent": "planner"}),
    ],
)
def test_what_a_key_belongs_to(key: str, channel: str, parts: dict[str, str]) -> None:
    found, got = keys.match(key)
    assert found.name == channel
    vehicle = key.split("/")[2]
    assert got == {"fleet": "demo", "vehicle": vehicle, **parts}
    assert found.key(**got) == key


def test_the_fleets_own_topics_belong_to_no_vehicle() -> None:
    for topic in ("origin", "state", "event"):
        channel, parts = keys.match(f"zmav/demo/@fleet/{topic}")
        assert (channel.name, parts) == ("fleet", {"fleet": "demo", "topic": topic})


def test_a_token_is_read_back_as_it_was_written() -> None:
    says = {"role": "vehicle", "sys": "7", "autopilot": "px4", "uid": "00ff", "instance": "a1"}
    channel, parts = keys.match(keys.ALIVE.key("demo", "quad1", **says))
    assert channel is keys.ALIVE
    assert parts == {"fleet": "demo", "vehicle": "quad1", **says}


@pytest.mark.parametrize(
    "key",
    [
        "",
        "zmav",
        "zmav/demo/quad1",
        "zmav/demo/quad1/mav/rx/1/1",
        "zmav/demo/quad1/mav/rx/1/1/ATTITUDE/more",
        "zmav/demo/Quad1/state",
        "zmav/demo/qu ad/state",
        "zmav/demo/../state",
        "zmav//quad1/state",
        "zmav/demo/quad1/state\n",
        "xzmav/demo/quad1/state",
        "@/1234/router",
    ],
)
def test_foreign_keys_are_named(key: str) -> None:
    with pytest.raises(BadKey) as caught:
        keys.match(key)
    assert caught.value.detail["value"] == key


@given(st.text())
def test_matching_never_fails_otherwise(key: str) -> None:
    for text in (key, f"zmav/{key}", f"zmav/demo/{key}/state"):
        try:
            channel, parts = keys.match(text)
        except BadKey:
            continue
        assert channel.key(**parts) == text


@pytest.mark.parametrize("name", ["quad1", "a", "0", "north-2_b"])
def test_names(name: str) -> None:
    assert keys.check_name(name) == name


@pytest.mark.parametrize("name", ["", "Quad1", "quad 1", "a/b", "*", "a$*", "@fleet", "quad1\n", "é", "٣", "a.b"])
def test_bad_names_say_what_is_allowed(name: str) -> None:
    with pytest.raises(BadKey) as caught:
        keys.check_name(name, "vehicle")
    assert caught.value.detail == {"field": "vehicle", "value": name, "expected": "[a-z0-9_-]+"}
    assert "vehicle" in caught.value.message


def test_message_names() -> None:
    for name in ("ATTITUDE", "UNKNOWN_410", "GPS2_RAW", "custom_Message"):
        assert keys.check_message(name) == name
    for name in ("", "*", "ATT*", "A/B", "4", "_A", "ATTITUDE\n", "A B"):
        with pytest.raises(BadKey):
            keys.check_message(name)


def test_every_channel_is_of_the_four_classes_and_never_blocks() -> None:
    for channel in keys.CHANNELS.values():
        options = channel.qos.options()
        assert options["congestion_control"] == zenoh.CongestionControl.DROP, channel.name
        assert options["express"] is False, channel.name
    assert keys.SETPOINT.qos.priority == zenoh.Priority.REAL_TIME
    assert keys.RX.qos.priority == keys.STATE.qos.priority == zenoh.Priority.DATA


def test_links_repeat_all_but_what_comes_again_soon() -> None:
    lanes = {name: channel.publishing()["reliability"] for name, channel in keys.CHANNELS.items()}
    once = {name for name, lane in lanes.items() if lane == zenoh.Reliability.BEST_EFFORT}
    assert once == {
        "state",
        "beacon",
        "setpoint",
        "probe",
        "rtcm",
        "traffic",
        "agent_out",
        "camera_frame",
        "camera_video",
        "video_report",
        "frame_report",
        "camera_detection",
    }
    for name in once - {"camera_frame", "camera_video"}:
        assert (keys.CHANNELS[name].rate_hz or 0.0) >= 1.0, name


def test_no_two_channels_share_a_key() -> None:
    samples = {
        channel.name: channel.key(**{part: "x" for _, part, _, _ in Formatter().parse(channel.template) if part})
        for channel in keys.CHANNELS.values()
    }
    assert {name: keys.match(key)[0].name for name, key in samples.items()} == {name: name for name in samples}
