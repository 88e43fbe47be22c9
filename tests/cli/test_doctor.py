"""``zmav doctor``: what is well is green; each trouble is red, in words, with what to do about it."""

from __future__ import annotations

import itertools
import json
import socket
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zenoh
from click.testing import CliRunner

from zmav import keys, wire
from zmav.cli.doctor import command
from zmav.doctor.computer import check_bits, check_packages
from zmav.doctor.survey import RouterReport, Survey
from zmav.doctor.vehicles import check_routers
from zmav.mavlink import encode, load_dialect

if TYPE_CHECKING:
    from tests.cli.conftest import Here, Patience, Speaker, StartProcess, Vehicle

STATE = keys.STATE.key("demo", "quad7")
LINK = keys.LINK.key("demo", "quad7", link="autopilot")


@pytest.fixture(autouse=True)
def impatient(patience: Patience) -> None:
    """Vehicles that do not answer are given up soon."""
    patience(0.3)


def findings(lines: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {line["subject"]: line for line in lines}


def bad(speaker: Speaker) -> dict[str, dict[str, Any]]:
    """What a doctor beside the speaker finds wrong."""
    told = speaker.zmav.fails("doctor", "--for", "0.4", "--json")
    return {subject: line for subject, line in findings(told.lines).items() if not line["ok"]}


def state(**changes: Any) -> bytes:
    """The state of a vehicle in order, but for ``changes``."""
    whole = wire.VehicleState(
        t=time.time(),
        fleet="demo",
        name="quad7",
        instance="x",
        connected=True,
        sysid=7,
        compid=1,
        autopilot="generic",
        kind="copter",
        mode="HOLD",
        armed=False,
        ready=True,
        link="up",
    )
    return wire.encode(msgspec.structs.replace(whole, **changes))


def test_all_is_well(vehicle: Vehicle) -> None:
    told = vehicle.zmav("doctor", "--for", "1.2")
    assert told.out.splitlines()[-1].startswith("all is well: ")
    assert "RED" not in told.out
    for words in ("ok  packages: python ", "ok  router quad1: ", "demo/quad1\n", "ok  presence: copter by ardupilot"):
        assert words in told.out
    found = findings(vehicle.zmav("doctor", "--for", "1.2", "--json").lines)
    assert all(line["ok"] for line in found.values())
    assert found.keys() >= {
        "demo/quad1 autopilot link",
        "demo/quad1 computer",
        "demo/quad1 readiness",
        "demo/quad1 clock",
    }
    assert vehicle.endpoint in found["router quad1"]["found"]
    assert "ready to arm" in found["demo/quad1 readiness"]["found"]


def test_without_a_router(start: StartProcess) -> None:
    doctor = start("doctor", "-e", "tcp/127.0.0.1:1")
    assert doctor.wait() == 1
    assert "RED router: no Zenoh router answers at tcp/127.0.0.1:1. Start one" in doctor.stdout
    assert doctor.out[-1].startswith("1 red, ")
    assert doctor.stderr == ""


def test_without_a_vehicle(speaker: Speaker) -> None:
    found = bad(speaker)
    assert list(found) == ["vehicles"]
    assert "zmav up" in found["vehicles"]["advice"]


@pytest.mark.parametrize(
    ("changes", "subject", "words", "advice"),
    [
        (
            {"connected": False, "sysid": None, "link": "down"},
            " presence",
            "no autopilot heard (link down)",
            "--link URL",
        ),
        ({"connected": False}, " presence", "autopilot silent (link up)", "baud"),
        ({"clash": "another vehicle is named quad7"}, " identity", "another vehicle is named quad7", "--name"),
        ({"ready": False, "not_ready": ["EKF has no position estimate"]}, " readiness", "EKF has no position", "GPS"),
    ],
    ids=["no autopilot", "silent", "clash", "not ready"],
)
def test_a_vehicle_in_trouble(speaker: Speaker, changes: dict[str, Any], subject: str, words: str, advice: str) -> None:
    speaker.say(STATE, lambda: state(**changes))
    found = bad(speaker)
    assert words in found[f"demo/quad7{subject}"]["found"]
    assert advice in found[f"demo/quad7{subject}"]["advice"]
    assert "it does not answer" in found["demo/quad7 clock"]["found"]
    assert len(found) == 2


def test_a_vehicle_of_which_there_is_only_a_token(speaker: Speaker) -> None:
    with speaker.session.liveliness().declare_token("zmav/demo/quad7/alive/vehicle/7/px4/-/x"):
        assert "its token is there, but no state was heard" in bad(speaker)["demo/quad7 presence"]["found"]


def test_a_vehicle_that_fell_silent(speaker: Speaker) -> None:
    began = time.monotonic()
    speaker.say(STATE, lambda: state() if time.monotonic() < began + 0.5 else b"")
    told = speaker.zmav.fails("doctor", "--for", "2.8", "--json")
    found = findings(told.lines)["demo/quad7 presence"]
    assert not found["ok"]
    assert found["found"].startswith("no state for ")


def qualities(**per_report: int) -> Iterator[bytes]:
    """Reports of a link on which so much is added to each counter every time."""
    for n in itertools.count():
        counts: dict[str, Any] = {name: each * n for name, each in per_report.items()}
        yield wire.encode(
            wire.LinkQuality(
                t=time.time(),
                name="autopilot",
                url="udpin:0.0.0.0:14550",
                state="up",
                age=0.0,
                rx_rate=50.0,
                rx_bytes_rate=2000.0,
                loss=0.0,
                rx_frames=100 * n,
                **counts,
            )
        )


@pytest.mark.parametrize(
    ("per_report", "words"),
    [
        ({"lost": 30}, "MAVLink loss 23%"),
        ({"bad_crc": 5}, "frames damaged"),
        ({"rx_dropped": 1}, "datagrams dropped by the kernel"),
        ({"lost": 1, "unknown": 50, "garbage": 10}, ""),
    ],
    ids=["loss", "crc", "dropped", "well"],
)
def test_a_link_in_trouble(speaker: Speaker, per_report: dict[str, int], words: str) -> None:
    reports = qualities(**per_report)
    speaker.say(STATE, state)
    speaker.say(LINK, lambda: next(reports))
    line = findings(speaker.zmav.fails("doctor", "--for", "0.4", "--json").lines)["demo/quad7 autopilot link"]
    assert line["ok"] is (not words)
    assert words in line["found"]
    assert bool(line["advice"]) is bool(words)


def test_a_link_whose_counters_begin_anew(speaker: Speaker) -> None:
    """Because its 'zmav up' has just started again."""
    before, after = itertools.islice(qualities(lost=9, bad_crc=9, rx_dropped=9), 500, None), qualities()
    asked: Any = speaker.session.declare_publisher(LINK)
    heard = itertools.count()
    speaker.say(STATE, state)
    speaker.say(LINK, lambda: next(after if asked.matching_status.matching and next(heard) > 2 else before))
    line = findings(speaker.zmav.fails("doctor", "--for", "0.4", "--json").lines)["demo/quad7 autopilot link"]
    assert line["ok"], line


@pytest.mark.parametrize(("off", "well"), [(0.0, True), (3.0, False), (-3600.0, False)])
def test_a_clock_that_is_off(speaker: Speaker, off: float, well: bool) -> None:
    def answer(query: zenoh.Query) -> None:
        with query:
            body = {"verb": "ping", "status": "done", "took": 0.0, "result": {"t": time.time() + off}}
            query.reply(query.key_expr, json.dumps(body))

    speaker.say(STATE, state)
    pings = speaker.session.declare_queryable(keys.DO.key("demo", "quad7", verb="ping"), answer)
    told = (speaker.zmav if well else speaker.zmav.fails)("doctor", "--for", "0.4", "--json")
    pings.undeclare()
    clock = findings(told.lines)["demo/quad7 clock"]
    assert clock["ok"] is well
    assert float(clock["found"].split()[0]) == pytest.approx(1e3 * off, abs=100.0)
    assert ("synchronise" in clock["advice"]) is not well


def test_parameters_that_leave_a_vehicle_flying_without_its_companion(vehicle: Vehicle) -> None:
    vehicle.zmav("param", "set", "quad1", "FS_GCS_ENABLE=0")
    told = vehicle.zmav.fails("doctor", "--for", "0.5", "--json")
    wrong = [line for line in told.lines if not line["ok"]]
    assert [line["subject"] for line in wrong] == ["demo/quad1 failsafe"]
    assert wrong[0]["found"].startswith("FS_GCS_ENABLE is 0: nothing happens")
    assert "zmav param set quad1 FS_GCS_ENABLE=" in wrong[0]["advice"]
    vehicle.zmav("param", "set", "quad1", "FS_GCS_ENABLE=1")
    told = vehicle.zmav("doctor", "--for", "0.5", "--json")
    said = [line for line in told.lines if line["subject"] == "demo/quad1 failsafe"]
    assert "what it does without its companion is set" in [line["found"] for line in said]
    assert any(line["found"].startswith("MAV_GCS_SYSID is 255") for line in said), "a recommendation is no trouble"


def test_routers_of_another_zenoh_and_routers_that_say_nothing() -> None:
    (found,) = check_routers(Survey(routers={"0123456789": RouterReport(version="0.9.0")}))
    assert (found.ok, found.subject) == (False, "router 01234567")
    assert "0.9.0" in found.found
    (found,) = check_routers(Survey())
    assert "adminspace" in found.advice


def test_a_package_that_is_missing() -> None:
    missing, rest = check_packages(("zmav", "no-such-package"))
    assert (missing.ok, missing.found) == (False, "not installed: no-such-package")
    assert rest.ok


def test_a_32_bit_system_is_the_first_line_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not [*check_bits()]
    monkeypatch.setattr(sys, "maxsize", 2**31 - 1)
    told = CliRunner().invoke(command, ["--link", "tcp:127.0.0.1:1", "--for", "0.1"]).output.splitlines()
    assert "RED" in told[1] and "64-bit only" in told[1], told


# A link without a router.


class Station:
    """Sends to a UDP port ten times a second whatever it is given."""

    def __init__(self, *messages: bytes) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            s.bind(("127.0.0.1", 0))
            self.url = f"udpin:127.0.0.1:{s.getsockname()[1]}"
        self._messages = messages
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._send)

    def __enter__(self) -> Station:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            while not self._over.wait(0.1):
                for message in self._messages:
                    s.sendto(message, ("127.0.0.1", int(self.url.rpartition(":")[2])))


def heartbeat(sysid: int, mav_type: int, autopilot: int, seq: int = 0) -> bytes:
    fields = {"type": mav_type, "autopilot": autopilot, "base_mode": 0, "custom_mode": 0, "system_status": 3}
    return encode(load_dialect(), "HEARTBEAT", fields, sysid=sysid, compid=1, seq=seq)


def test_a_link_that_is_well(vehicle: Vehicle, here: type[Here]) -> None:
    url = vehicle.world.urls[0]
    found = findings(here()("doctor", "--link", url, "--for", "1.5", "--json").lines)
    assert found["link"]["found"].startswith(f"{url}: connected")
    assert "(0 unknown), 0 lost, 0 damaged" in found["traffic"]["found"]
    assert found["system 1/1"]["found"] == "ardupilot copter"


@pytest.mark.parametrize(
    ("messages", "subject", "words"),
    [
        ((), "link", "listening"),
        ((b"login: ",), "traffic", "no MAVLink in them"),
        ((heartbeat(255, 6, 8),), "autopilot", "none among what is heard"),
    ],
    ids=["silence", "noise", "ground station"],
)
def test_a_link_on_which_there_is_no_autopilot(
    here: type[Here], messages: tuple[bytes, ...], subject: str, words: str
) -> None:
    with Station(*messages) as station:
        told = here().fails("doctor", "--link", station.url, "--for", "0.6", "--json")
    line = findings(told.lines)[subject]
    assert not line["ok"]
    assert words in line["found"]
    assert line["advice"]


def test_a_link_with_two_autopilots_and_damaged_frames(here: type[Here]) -> None:
    good = heartbeat(1, 2, 3)
    broken = good[:-1] + bytes([good[-1] ^ 1])
    with Station(good, heartbeat(2, 1, 12), broken) as station:
        told = here().fails("doctor", "--link", station.url, "--for", "0.8", "--json")
    found = findings(told.lines)
    assert (found["system 1/1"]["found"], found["system 2/1"]["found"]) == ("ardupilot copter", "px4 plane")
    assert "--sysid" in found["autopilot"]["found"]
    assert not found["traffic"]["ok"]


@pytest.mark.parametrize(("mav_type", "autopilot", "well"), [(2, 3, False), (6, 8, True)], ids=["its own", "another's"])
def test_losses_count_where_they_are_the_autopilots_own(
    here: type[Here], mav_type: int, autopilot: int, well: bool
) -> None:
    """An autopilot passes on only some of what others say: gaps in their numbers are no loss of this link."""
    gaps = [heartbeat(9, mav_type, autopilot, seq) for seq in range(0, 250, 5)]
    with Station(heartbeat(1, 2, 3), *gaps) as station:
        told = (here() if well else here().fails)("doctor", "--link", station.url, "--for", "0.6", "--json")
    traffic = findings(told.lines)["traffic"]
    assert traffic["ok"] is well
    assert (" 0 lost," in traffic["found"]) is well


def test_a_link_that_loses_some_is_told_of_and_is_no_fault(here: type[Here]) -> None:
    """By the thresholds of the rules that 'zmav top' shows: from 5 % amber, from 20 % red."""
    some = [heartbeat(9, 2, 3, seq) for seq in range(250) if seq % 12]
    with Station(heartbeat(1, 2, 3), *some) as station:
        traffic = findings(here()("doctor", "--link", station.url, "--for", "0.6", "--json").lines)["traffic"]
    assert (traffic["level"], traffic["ok"]) == ("advice", True)
    assert traffic["advice"]


@pytest.mark.parametrize(
    ("url", "words"), [("pigeon:coop", "link: "), ("tcp:127.0.0.1:1", "link: "), ("/dev/no-such-tty,57600", "device: ")]
)
def test_a_link_that_does_not_open(here: type[Here], url: str, words: str) -> None:
    told = here().fails("doctor", "--link", url, "--for", "0.2")
    assert f"RED {words}" in told.out
