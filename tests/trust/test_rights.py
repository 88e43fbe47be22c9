"""What each role may, by the registry; the whole table is walked, so that a new channel or verb is judged, too."""

from __future__ import annotations

import pytest

from zmav import keys
from zmav.errors import Forbidden
from zmav.trust.certificate import Role
from zmav.trust.rights import may, writers
from zmav.verbs import SWARM_VERBS, VERBS, Access

CONFIGURES = {
    "command",
    "reboot",
    "param_set",
    "param_load",
    "file_put",
    "file_remove",
    "file_mkdir",
    "file_rmdir",
    "log_erase",
    "revoke",
    "servo",
    "mission_upload",
    "mission_clear",
    "terrain_put",
    "terrain_clear",
    "gimbal_point",
    "gimbal_turn",
    "gimbal_release",
}
LOOKS = {"ping", "file_list", "log_list", "gimbal_status"}


def allowed(who: Role, name: str, channel: keys.Channel, /, **parts: str) -> bool:
    try:
        may(who, name, channel, {"fleet": "demo", "vehicle": "quad1", **parts})
    except Forbidden as e:
        assert e.detail["reason"] == "role"
        assert name in e.message
        return False
    return True


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_orders(verb: str) -> None:
    assert allowed(Role.OPERATOR, "op", keys.DO, verb=verb)
    assert allowed(Role.PLANNER, "swap", keys.DO, verb=verb) == (verb not in CONFIGURES)
    assert allowed(Role.VEHICLE, "quad1", keys.DO, verb=verb) == (verb not in CONFIGURES)
    assert allowed(Role.VEHICLE, "quad2", keys.DO, verb=verb) is False
    assert allowed(Role.VIEWER, "eye", keys.DO, verb=verb) == (verb in LOOKS)
    if verb in LOOKS:
        assert VERBS[verb].access is Access.READ


@pytest.mark.parametrize("verb", sorted(SWARM_VERBS))
def test_orders_to_the_planner(verb: str) -> None:
    looks = verb in {"preview", "status"}
    for role, who in ((Role.OPERATOR, "op"), (Role.PLANNER, "swap")):
        assert allowed(role, who, keys.SWARM, verb=verb, vehicle="ground")
    for role, who in ((Role.VEHICLE, "quad1"), (Role.VIEWER, "eye")):
        assert allowed(role, who, keys.SWARM, verb=verb, vehicle="ground") == looks
    assert (SWARM_VERBS[verb].access is Access.READ) == looks


def test_an_order_that_does_not_exist_is_answered_by_which_there_are() -> None:
    assert allowed(Role.VIEWER, "eye", keys.DO, verb="somersault")


@pytest.mark.parametrize("name", sorted(keys.CHANNELS))
def test_a_viewer_changes_nothing(name: str) -> None:
    channel = keys.CHANNELS[name]
    verb = "submit" if channel is keys.SWARM else "land"
    parts = {"verb": verb, "topic": "goal", "role": "viewer", "vehicle": "eye"}
    assert allowed(Role.VIEWER, "eye", channel, **parts) == (channel.writers == (keys.ANYONE,))
    moves = channel in (keys.SETPOINT, keys.TX, keys.HOLDER, keys.DO, keys.FLEET, keys.AGENT_STATUS)
    assert not (moves and allowed(Role.VIEWER, "quad1", channel, **parts))


@pytest.mark.parametrize(
    "channel", [c for c in keys.CHANNELS.values() if c.writers == (keys.VEHICLE,)], ids=lambda c: str(c.name)
)
def test_only_a_vehicle_speaks_for_itself(channel: keys.Channel) -> None:
    assert allowed(Role.VEHICLE, "quad1", channel)
    for role, who in (
        (Role.VEHICLE, "quad2"),
        (Role.OPERATOR, "quad1"),
        (Role.PLANNER, "quad1"),
        (Role.VIEWER, "quad1"),
    ):
        assert not allowed(role, who, channel)


@pytest.mark.parametrize("channel", [keys.SETPOINT, keys.HOLDER, keys.AGENT_STATUS], ids=lambda c: str(c.name))
def test_who_flies(channel: keys.Channel) -> None:
    assert all(allowed(role, "x", channel) for role in (Role.OPERATOR, Role.PLANNER))
    assert allowed(Role.VEHICLE, "quad1", channel)
    assert not allowed(Role.VEHICLE, "quad2", channel)


def test_frames_are_the_operators() -> None:
    assert allowed(Role.OPERATOR, "op", keys.TX)
    for role, name in ((Role.PLANNER, "op"), (Role.VEHICLE, "quad1"), (Role.VIEWER, "op")):
        assert not allowed(role, name, keys.TX)


def test_what_the_whole_fleet_shares() -> None:
    for topic in ("origin", "goal", "plan", "obstacle", "anything"):
        assert allowed(Role.PLANNER, "swap", keys.FLEET, topic=topic)
        assert not allowed(Role.VEHICLE, "quad1", keys.FLEET, topic=topic)
    assert all(allowed(role, "x", keys.FLEET, topic=keys.ROSTER) for role in Role)
    assert writers(keys.FLEET, {"topic": keys.ROSTER}) == (keys.ANYONE,)


def test_nobody_is_alive_under_anothers_name() -> None:
    assert allowed(Role.OPERATOR, "op", keys.ALIVE, vehicle="op", role="router")
    assert not allowed(Role.OPERATOR, "op", keys.ALIVE, vehicle="op", role=keys.VEHICLE)
    assert not allowed(Role.OPERATOR, "op", keys.ALIVE, vehicle="quad1", role="router")
    assert allowed(Role.VEHICLE, "quad1", keys.ALIVE, role=keys.VEHICLE)
    assert not allowed(Role.VEHICLE, "quad2", keys.ALIVE, role=keys.VEHICLE)


def test_each_proven_channel_is_of_one_vehicle() -> None:
    proven = {channel.name for channel in keys.CHANNELS.values() if channel.proven}
    assert proven >= {"do", "tx"}
    assert all("{vehicle}" in keys.CHANNELS[name].template for name in proven)
