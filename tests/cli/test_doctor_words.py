"""What ``zmav doctor`` makes of what a fleet says: the ways between routers, ids, versions, agents, and who never
answers; how the page is laid out; and that the guide names every line."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec
import pytest
import zenoh

from tests.cli.test_doctor import findings, state
from zmav import keys, wire
from zmav.doctor import survey, topics, vehicles
from zmav.doctor.air import RemoteId
from zmav.doctor.facts import AgentReport
from zmav.doctor.findings import Finding, Level
from zmav.doctor.page import page
from zmav.doctor.survey import Survey
from zmav.doctor.words import MOST, clean

if TYPE_CHECKING:
    from tests.cli.conftest import Patience, Speaker

ROW = re.compile(r"^\| (?!line )([^|]+?) \|(?:[^|]+\|){3}$", re.MULTILINE)
Said = dict[tuple[str, str], wire.NeighbourQuality]


@pytest.fixture(autouse=True)
def impatient(patience: Patience) -> None:
    """Vehicles that do not answer are given up soon."""
    patience(0.3)


# Ways between routers.


def quality(name: str, **changes: Any) -> wire.NeighbourQuality:
    whole = wire.NeighbourQuality(
        t=0.0,
        name=name,
        router="aa",
        peer="bb",
        url="udp/1",
        state="up",
        age=0.1,
        rtt=0.004,
        loss_in=0.0,
        loss_out=0.0,
        cost=100,
    )
    return msgspec.structs.replace(whole, **changes)


@pytest.mark.parametrize(
    ("here", "there", "level", "words"),
    [
        ({}, {}, Level.OK, "of 2: d/a - d/b: up, 0% lost, round trip 4.0 ms"),
        ({"loss_in": 0.06}, {}, Level.ADVICE, "up, 6% lost"),
        ({"loss_in": None}, {"loss_out": 0.25}, Level.RED, "up, 25% lost"),
        ({"cost": 3000}, {}, Level.ADVICE, "up"),
        ({"cost": 15_000, "rtt": 0.3}, {"rtt": 0.2}, Level.RED, "up, 0% lost, round trip 250.0 ms"),
        ({"state": "silent", "age": 4.0}, {}, Level.RED, "silent"),
        (
            {"state": "silent", "age": None},
            {"age": None},
            Level.ADVICE,
            "silent, 0% lost, round trip 4.0 ms, nothing mea",
        ),
        ({}, {"state": "down"}, Level.RED, "down, 0% lost, round trip 4.0 ms, within the last minute"),
    ],
)
def test_a_way_by_the_worse_of_its_ends(here: dict[str, Any], there: dict[str, Any], level: Level, words: str) -> None:
    said: Said = {
        ("d/a", "d/b"): quality("b", **here),
        ("d/b", "d/a"): quality("a", **there),
        ("d/b", "d/c"): quality("c", rtt=0.001, loss_in=0.0),
    }
    (line,) = vehicles.check_ways(Survey(neighbours=said))
    assert line.level is level
    assert words in line.found
    assert line.who == ("" if level is Level.OK else "d/a - d/b")
    assert bool(line.advice) is (level is not Level.OK)


# Vehicles that are said by a speaker.


def told(speaker: Speaker, *arguments: str) -> dict[str, dict[str, Any]]:
    """What a doctor beside the speaker says of a fleet that is not well: nobody answers its questions."""
    return findings(speaker.zmav.fails("doctor", "--for", "0.4", "--json", *arguments).lines)


def test_unequal_firmware_and_equal_system_ids(speaker: Speaker) -> None:
    speaker.say(keys.STATE.key("demo", "quad7"), lambda: state(firmware="4.6.0", uid="1"))
    speaker.say(keys.STATE.key("demo", "quad8"), lambda: state(name="quad8", firmware="4.7.0", uid="2"))
    speaker.say(keys.STATE.key("demo", "quad9"), lambda: state(name="quad9", firmware="4.7.0", sysid=9))
    found = told(speaker)
    assert (found["system ids"]["level"], found["firmware"]["level"]) == ("red", "advice")
    assert found["system ids"]["found"] == "demo/quad7, demo/quad8 all have 7"
    assert found["firmware"]["found"] == "generic copter: 4.6.0: quad7; 4.7.0: quad8, quad9"


def test_one_autopilot_that_two_companions_hear_is_no_clash(speaker: Speaker) -> None:
    speaker.say(keys.STATE.key("demo", "quad7"), lambda: state(uid="1"))
    speaker.say(keys.STATE.key("demo", "quad8"), lambda: state(name="quad8", uid="1"))
    assert "system ids" not in told(speaker)


def test_a_system_id_that_is_not_the_files(speaker: Speaker, tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text('[vehicles.quad7]\nlink = "udpin::1"\nsysid = 5\n[vehicles.quad8]\nlink = "udpin::1"\n')
    speaker.say(keys.STATE.key("demo", "quad7"), state)
    found = told(speaker, "--file", str(file))
    assert found["system ids"]["found"].startswith("demo/quad7 is 7, and vehicles.quad7.sysid of the fleet file 5")
    assert (found["vehicles"]["level"], found["vehicles"]["found"]) == ("red", "not heard: quad8")
    found = told(speaker, "--file", str(file), "--name", "quad7")
    assert found["vehicles"]["level"] == "advice", "the others may be elsewhere"
    assert "left to 'zmav up', which hears the autopilot" in found["link"]["found"]


@pytest.mark.parametrize(
    ("changes", "subject", "level", "words"),
    [
        ({"battery": wire.Battery(remaining=0.2)}, "battery", "advice", "battery 20%"),
        ({"battery": wire.Battery(remaining=0.0)}, "battery", "red", "battery 0%"),
        ({"battery": wire.Battery(remaining=0.9)}, "battery", "ok", "90% left"),
        (
            {"clock": wire.ClockInfo(boot_t=0.0, error_s=0.0, gps_offset_s=-30.0)},
            "clock",
            "red",
            "clock 30.0 s off GPS",
        ),
        ({"connected": False}, "computer", "advice", "tells nothing of itself"),
        ({"ready": False}, "readiness", "red", "it does not say why"),
    ],
)
def test_a_vehicle(speaker: Speaker, changes: dict[str, Any], subject: str, level: str, words: str) -> None:
    speaker.say(keys.STATE.key("demo", "quad7"), lambda: state(**changes))
    lines = speaker.zmav.fails("doctor", "--for", "0.4", "--json").lines
    found = [(line["level"], line["found"]) for line in lines if line["subject"] == f"demo/quad7 {subject}"]
    assert any(each == level and words in text for each, text in found), found


def test_an_agent_that_speaks_and_two_of_one_name(speaker: Speaker) -> None:
    status = wire.AgentStatus(t=0.0, agent="follower", state="waiting", text="no helipad in sight")
    speaker.say(keys.AGENT_STATUS.key("demo", "quad7", agent="follower"), wire.encode(status))
    token = {"role": "planner", "sys": 0, "autopilot": "planner", "uid": "-"}
    one, two = (keys.ALIVE.key("demo", "ground", instance=each, **token) for each in "ab")
    with speaker.session.liveliness().declare_token(one), speaker.session.liveliness().declare_token(two):
        found = told(speaker)
    assert found["agents"]["found"] == "demo/quad7 follower: waiting, no helipad in sight"
    assert found["names"]["found"] == "2 of the role planner are named demo/ground"


def test_ground_that_an_autopilot_asks_for() -> None:
    whole = wire.TerrainReport(pieces=["S36E149-38-09"], missing=[], faults={}, answered=9, pending=0, loaded=504)
    wanting = msgspec.structs.replace(whole, missing=["S36E149-38-10"], pending=40)
    torn = msgspec.structs.replace(whole, pieces=[], faults={"S36E149-38-09": "no square"})
    none = wire.TerrainReport(pieces=[], missing=[], faults={}, answered=0)
    told = {"a": whole, "b": wanting, "c": torn, "d": none, "e": None}
    lines = list(vehicles.check_terrain(Survey(terrain=told)))
    assert [(line.who, line.level) for line in lines] == [("a", Level.OK), ("b", Level.ADVICE), ("c", Level.RED)]
    assert "S36E149-38-10" in lines[1].found
    assert "no square" in lines[2].found


@pytest.mark.parametrize("state", ["failed", "Error", "lost", "aborted"])
def test_an_agent_that_failed(state: str) -> None:
    """As bad as for 'zmav top', and more so than one that only says nothing."""
    status = wire.AgentStatus(t=0.0, agent="follower", state=state, text="no helipad in sight")
    for age, silent in ((1.0, ""), (7.0, ", silent for 7 s")):
        (line,) = vehicles.check_agents(Survey(agents=[AgentReport.of("demo", "quad7", status, age)]))
        assert (line.level, line.found) == (Level.RED, f"demo/quad7 follower: {state}, no helipad in sight{silent}")
        assert "journalctl -u zmav-agent@" in line.advice


def test_an_agent_that_fell_silent() -> None:
    status = wire.AgentStatus(t=0.0, agent="follower", state="idle")
    (line,) = vehicles.check_agents(Survey(agents=[AgentReport.of("demo", "quad7", status, 7.0)]))
    assert (line.level, line.found) == (Level.RED, "demo/quad7 follower: idle, silent for 7 s")


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b'{"versions": {"zmav": "99.1", "eclipse-zenoh": "1.0.0"}, "new": 1}', "99.1: demo/quad7"),
        (b"{", "tells nothing that can be read here: host: not JSON"),
    ],
    ids=["newer", "nonsense"],
)
def test_a_host_whose_report_is_not_known_here(speaker: Speaker, payload: bytes, words: str) -> None:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(keys.HOST.key("demo", "quad7"), payload)

    speaker.say(keys.STATE.key("demo", "quad7"), state)
    host = speaker.session.declare_queryable(keys.HOST.key("demo", "quad7"), answer)
    said = json.dumps(list(told(speaker).values()))
    host.undeclare()
    assert words in said


def test_whoever_never_answers_holds_nobody_up(
    speaker: Speaker, patience: Patience, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(survey, "PART_S", 0.5)
    patience(1000.0)
    held: list[zenoh.Query] = []
    over = threading.Event()

    def never(query: zenoh.Query) -> None:
        if not over.is_set():
            held.append(query)

    speaker.say(keys.STATE.key("demo", "quad7"), state)
    asked = [speaker.session.declare_queryable(key, never) for key in ("zmav/demo/quad7/**", "@/beef/router")]
    found = speaker.zmav.fails("doctor", "--for", "0.4", "--json").lines
    over.set()
    for query in held:
        query.drop()
    for each in asked:
        each.undeclare()
    late = {line["found"].partition(":")[0] for line in found if line["topic"] == "doctor"}
    assert late >= {"clocks", "hosts", "routers"}
    assert held, "nothing was asked"
    assert findings(found)["demo/quad7 presence"]["ok"], "what came is told"


def test_a_check_that_fails_ends_no_other() -> None:
    def check_that(seen: Survey) -> Iterator[Finding]:
        raise ValueError("of all things")

    one, two = vehicles.examine(Survey(), (check_that, vehicles.check_fleet))
    assert "the check of that failed: ValueError('of all things')" in one.found
    assert (one.level, two.topic) == (Level.RED, "vehicles")


# The page.


def test_one_page_for_many_hosts() -> None:
    told = [topics.PACKAGES.well("all of them")]
    for n in range(30):
        who = f"demo/quad{n:02}"
        told += [topics.PRESENCE.well("here", who), topics.TIME.advise("nothing keeps the clock", "chrony", who)]
    told += [topics.CLOCK.wrong("+9 s", "set it", "demo/quad07"), topics.VEHICLES.well("30 present")]
    lines = [click.unstyle(line) for line in page(told)]
    assert len(lines) < 20
    assert lines.count("demo/quad07") == 1
    assert "  RED clock: +9 s" in lines
    assert any(line.startswith("  ... time at demo/quad00, ") and "and 24 more" in line for line in lines)
    assert any("nothing else at demo/quad00, " in line and "and 23 more" in line for line in lines)
    assert lines[-1] == "1 red, 32 ok, 30 to consider"
    assert not any("nothing else" in line for line in page(told[:5]))


def test_what_others_say_cannot_hurt_a_terminal() -> None:
    line = topics.READINESS.wrong("\x1b[2J\r\n" + "x" * 10_000, "\x07", "demo/a\x9bb")
    text = "\n".join(page([line]))
    assert not re.search(r"[\x00-\x09\x0b-\x1a\x1c-\x1f\x7f-\x9f]", text)
    assert "\x1b[2J" not in text
    assert len(clean("x" * 10_000)) == MOST
    document = line.document()
    assert document["subject"] == "demo/a?b readiness"
    assert len(document["found"]) <= MOST


# The guide.


def test_the_guide_has_every_line(root: Path) -> None:
    """Under the heading of its group, and no other lines."""
    chapters = (
        (root / "docs" / "doctor.md").read_text().partition("## Every line")[2].partition("\n## ")[0].split("### ")
    )
    told = {(chapter.partition("\n")[0].lower(), name) for chapter in chapters for name in ROW.findall(chapter)}
    assert told == {(topic.group.lower(), topic.name) for topic in topics.TOPICS}
    assert len(told) == len(topics.TOPICS)


def test_every_topic_is_told_by_some_check(root: Path) -> None:
    source = "".join(path.read_text() for path in (root / "zmav" / "doctor").glob("*.py") if path.name != "topics.py")
    names = [name for name, value in vars(topics).items() if isinstance(value, topics.Topic)]
    assert len(names) == len(topics.TOPICS)
    assert [name for name in names if f"topics.{name}" not in source] == []


def test_feeds_of_traffic_and_modules_for_remote_identification() -> None:
    agents = [
        AgentReport(name="traffic", fleet="demo", host=host, state=state, text=text, age=1.0, stale=False)
        for host, state, text in (
            ("a", "in-charge", "2 aircraft told of"),
            ("b", "partly", "sbs:pi:30003: refused"),
            ("c", "silent", "no aircraft is heard"),
            ("d", "lost", "sbs:pi:30003: refused"),
        )
    ]
    good = RemoteId("DID_ENABLE", "MAV_ODID_ARM_STATUS_GOOD_TO_ARM", age=0.5)
    told = {
        "demo/none": RemoteId(),
        "demo/good": good,
        "demo/missing": RemoteId("DID_ENABLE"),
        "demo/silent": msgspec.structs.replace(good, age=60.0),
        "demo/not": RemoteId(None, "MAV_ODID_ARM_STATUS_PRE_ARM_FAIL_GENERIC", "no operator location", 0.5),
    }
    found = list(vehicles.check_air(Survey(agents=agents, remote_ids=told)))
    assert [(each.who, each.level, each.found) for each in found] == [
        ("demo/good", Level.OK, "its module is heard, and ready to arm"),
        ("demo/missing", Level.RED, "DID_ENABLE asks for it, and no module is heard"),
        ("demo/silent", Level.RED, "its module is silent for 60 s"),
        ("demo/not", Level.RED, "its module is not ready to arm: no operator location"),
        ("", Level.OK, "demo/a: 2 aircraft told of"),
        ("", Level.ADVICE, "demo/b: sbs:pi:30003: refused"),
        ("", Level.ADVICE, "demo/c: no aircraft is heard"),
    ]
