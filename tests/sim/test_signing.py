"""Signing with the simulated autopilot: set up by the verb, then only who has the key flies it; pymavlink agrees."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner
from pymavlink import mavutil

from zmav import keys
from zmav.cli import signing, zmav
from zmav.config import Signing as SigningTable
from zmav.errors import BadConfig, Refused
from zmav.mavlink import Packer, load_dialect
from zmav.mavlink.signing import new_key, write_key
from zmav.sim import World

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

TWO_LINKS = ("tcp:127.0.0.1:0", "tcp:127.0.0.1:0")


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    write_key(tmp_path / "quad1.key", new_key())
    return tmp_path / "quad1.key"


def setup(url: str, *more: str) -> str:
    result = CliRunner().invoke(zmav, ["signing", "setup", "--link", url, *more], catch_exceptions=True)
    if isinstance(result.exception, Exception):
        raise result.exception
    return result.output


async def test_only_who_has_the_key_is_heard_and_obeyed(net: Net, onboard: StartOnboard, key_file: Path) -> None:
    with World(endpoint=TWO_LINKS, ready_s=0.5) as world:
        cable, radio = world.vehicles[0].urls
        held = mavutil.mavlink_connection(cable, source_system=255)  # it stays the first link
        assert held.wait_heartbeat(timeout=30)
        assert "has the key" in setup(radio, "--key", str(key_file))

        session, endpoint = net.router()
        ground = net.ground(endpoint)
        states, events, links = (ground.samples(c, link="*") for c in (keys.STATE, keys.EVENT, keys.LINK))
        vehicle = await onboard(session, radio, signing=SigningTable(key_file=str(key_file)))
        await states.object(lambda s: s["connected"] and s["ready"], "a connected vehicle that is ready")
        assert (await ground.do("arm")).result == {"armed": True}

        dialect = load_dialect()
        frame = Packer(dialect, 255, 190).pack("SET_MODE", target_system=1, base_mode=1, custom_mode=6)
        ground.put(keys.TX, frame, sys=1, comp=0, msg="SET_MODE")
        await events.object(lambda e: "it is not signed, and this link signs" in e["text"], "refusal of the unsigned")
        secret = Packer(dialect, 255, 190).pack("SETUP_SIGNING", target_system=1, secret_key=[1] * 32)
        while not any("holds a key" in e["text"] for e in events.objects()):  # one refusal a second is said
            ground.put(keys.TX, secret, sys=1, comp=0, msg="SETUP_SIGNING")
            await states.object(lambda s: s["connected"], "a moment", after=len(states.items))
        assert (await links.object(lambda link: link["rx_frames"] > 0, "a link"))["bad_signature"] == 0
        await onboard.close(vehicle)

        write_key(key_file.with_name("other.key"), new_key())
        table = SigningTable(key_file=str(key_file.with_name("other.key")))
        deaf = await onboard(session, radio, name="quad2", signing=table)
        links = net.ground(endpoint, "quad2").samples(keys.LINK, link="*")
        await links.object(lambda link: link["bad_signature"] > 3, "frames of a wrong key")
        assert deaf.identity.source is None
        held.close()


async def test_what_others_put_is_signed_where_that_is_asked_for(
    net: Net, onboard: StartOnboard, key_file: Path
) -> None:
    with World(endpoint=TWO_LINKS, ready_s=0.5) as world:
        cable, radio = world.vehicles[0].urls
        held = mavutil.mavlink_connection(cable, source_system=255)
        assert held.wait_heartbeat(timeout=30)
        setup(radio, "--key", str(key_file))
        session, endpoint = net.router()
        ground = net.ground(endpoint)
        states = ground.samples(keys.STATE)
        await onboard(session, radio, signing=SigningTable(key_file=str(key_file), sign_forwarded=True))
        await states.object(lambda s: s["connected"], "a connected vehicle")
        frame = Packer(load_dialect(), 255, 190).pack("SET_MODE", target_system=1, base_mode=1, custom_mode=9)
        ground.put(keys.TX, frame, sys=1, comp=0, msg="SET_MODE")
        await states.object(lambda s: s["mode"] == "LAND", "mode LAND")
        held.close()


def test_pymavlink_talks_to_it_with_the_key_and_not_without(key_file: Path) -> None:
    key = bytes.fromhex(key_file.read_text())
    with World(endpoint=TWO_LINKS, ready_s=0.5) as world:
        cable, radio = world.vehicles[0].urls
        held = mavutil.mavlink_connection(cable, source_system=255)
        assert held.wait_heartbeat(timeout=30)
        setup(radio, "--key", str(key_file))
        with_key = mavutil.mavlink_connection(radio, source_system=255)
        with_key.setup_signing(key, sign_outgoing=True)
        assert with_key.wait_heartbeat(timeout=30).get_signed()
        with_key.param_fetch_one("RTL_ALT")
        assert with_key.recv_match(type="PARAM_VALUE", blocking=True, timeout=30)
        without = mavutil.mavlink_connection(radio, source_system=255)
        without.param_fetch_one("RTL_ALT")
        with_key.param_fetch_one("RTL_ALT")
        assert with_key.recv_match(type="PARAM_VALUE", blocking=True, timeout=30)
        assert without.recv_match(type="PARAM_VALUE", blocking=True, timeout=1) is None
        for each in (held, with_key, without):
            each.close()


def test_setup_ends_signing_too_and_an_armed_vehicle_takes_no_key(
    key_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with World(endpoint=TWO_LINKS[0], ready_s=0.5) as world:
        (url,) = world.urls
        assert "has the key" in setup(url, "--key", str(key_file))
        assert "signs no more" in setup(url, "--key", str(key_file), "--off")
        copter = world.vehicles[0].copter
        world.wait_for(lambda: copter.position_ok)
        assert world.call(lambda: copter.arm(forced=True))
        monkeypatch.setattr(signing, "PATIENCE", 2.0)
        with pytest.raises(Refused, match="only while disarmed"):
            setup(url, "--key", str(key_file))


async def test_a_key_that_cannot_be_used_is_said_before_anything_runs(
    net: Net, onboard: StartOnboard, key_file: Path
) -> None:
    session, _ = net.router()
    key_file.chmod(0o644)
    with pytest.raises(BadConfig, match="chmod 600"):
        await onboard(session, "udpin:127.0.0.1:0", signing=SigningTable(key_file=str(key_file)))
