"""What is drawn, and what the keys make of it."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

import pytest
from rich.cells import cell_len

from ground.top.cli import Painter
from ground.top.report import NetworkReport, Report
from ground.top.screen import Ui, draw
from zmav import wire
from zmav.doctor.facts import AgentReport

if TYPE_CHECKING:
    from tests.ground.top.conftest import Make, MakeReport


def drawn(ui: Ui, report: Report, width: int = 120, height: int = 24) -> list[str]:
    """The screen's lines, each checked to fit."""
    lines = ["".join(text for text, _ in line) for line in draw(ui, report, width, height)]
    assert len(lines) <= height
    assert max(map(cell_len, lines)) <= width
    return lines


def fleet(make: Make, report: MakeReport, count: int) -> Report:
    return report(*(make(f"quad{i:02d}", sysid=i + 1, battery=0.9 - i / 100.0) for i in range(count)))


def selected(ui: Ui, report: Report) -> str | None:
    vehicle = ui.chosen(report)
    return vehicle.name if vehicle else None


def press(ui: Ui, report: Report, *keys: str) -> None:
    for key in keys:
        ui.press(key, report)


@pytest.mark.parametrize("width", [1, 20, 80, 100, 120, 160, 200, 300])
@pytest.mark.parametrize("height", [1, 5, 24, 60])
@pytest.mark.parametrize("count", [0, 1, 50])
def test_any_size_is_filled_and_not_left(make: Make, report: MakeReport, width: int, height: int, count: int) -> None:
    ui = Ui()
    drawn(ui, fleet(make, report, count), width, height)
    press(ui, fleet(make, report, count), "down", "enter", "/", "q")
    drawn(ui, fleet(make, report, count), width, height)


def test_eighty_columns_have_the_essential_ones(make: Make, report: MakeReport) -> None:
    found = report(make(why=(("bad", "battery 12%"),)))
    _, head, row, *_ = drawn(Ui(), found, 80)
    assert head.split() == ["vehicle", "is", "mode", "armed", "alt", "m/s", "batt", "age", "why"]
    assert row.split() == ["quad1", "BAD", "GUIDED", "ARMED", "10.0", "1.5", "90%", "0.2s", "battery", "12%"]


def test_two_hundred_columns_have_place_link_lease_and_event(make: Make, report: MakeReport) -> None:
    head = drawn(Ui(), report(make()), 200)[1]
    for name in ("latitude longitude", "gps", "msg/s", "loss", "rtt ms", "hops", "lease", "last event", "kind"):
        assert name in head


def test_a_lost_vehicle_is_unmistakable_without_colours(make: Make, report: MakeReport) -> None:
    gone = (("bad", "no state for 12s, and its token is gone"),)
    found = report(make("a"), make("b", why=gone, presence="gone", age=12.0), make("c", presence="stale", age=3.0))
    lines = draw(Ui(), found, 120, 24)
    words = ["".join(text for text, _ in line) for line in lines]
    assert "3 vehicles: 1 ok, 1 STALE, 1 GONE" in words[0]
    assert words[3].split()[:2] == ["b", "GONE"]
    assert "no state for 12s" in words[3]
    assert words[4].split()[:2] == ["c", "STALE"]
    styles = {text.strip(): style for text, style in lines[3]}
    assert (styles["b"], styles["GONE"], styles["12s"]) == ("dim", "bold red", "bold red")


def test_several_fleets_are_told_apart(make: Make, report: MakeReport) -> None:
    ui, found = Ui(), report(make("quad1", fleet="alpha"), make("quad1", fleet="beta"))
    _, head, one, two, *_ = drawn(ui, found, 80)
    assert head.split()[:3] == ["vehicle", "fleet", "is"]
    assert (one.split()[:2], two.split()[:2]) == (["quad1", "alpha"], ["quad1", "beta"])
    press(ui, found, "end")
    assert ui.selected == ("beta", "quad1")


def test_a_lost_router_is_said_first(make: Make, report: MakeReport) -> None:
    found = report(make())
    assert "NO ROUTER" not in drawn(Ui(), found, 80)[0]
    found.router = False
    assert "NO ROUTER: nothing can be heard" in drawn(Ui(), found, 80)[0]


def test_fifty_vehicles_scroll_with_the_selection(make: Make, report: MakeReport) -> None:
    ui, found = Ui(), fleet(make, report, 50)
    lines = drawn(ui, found, 80, 24)
    assert "0 more above, 30 below" in lines[-2]
    press(ui, found, "end")
    lines = drawn(ui, found, 80, 24)
    assert "30 more above, 0 below" in lines[-2]
    assert any(line.startswith(">quad49") for line in lines)
    press(ui, found, "pageup", "up")
    name = selected(ui, found)
    assert name == "quad28"
    assert any(line.startswith(f">{name}") for line in drawn(ui, found, 80, 24))


def test_a_filter_is_typed_kept_and_cleared(make: Make, report: MakeReport) -> None:
    found = report(make("quad1"), make("quad2", presence="stale"), make("rover1", kind="rover"))
    ui = Ui()
    press(ui, found, "/", *"stalex", "backspace")
    assert "filter: stale_" in drawn(ui, found)[-1]
    press(ui, found, "enter")
    assert [v.name for v in ui.rows(found)] == ["quad2"]
    assert "1 shown" in drawn(ui, found)[0]
    press(ui, found, "/", "esc")
    assert len(ui.rows(found)) == 3
    press(ui, found, "/", *"rover copter", "enter")
    assert "no vehicle matches" in "".join(drawn(ui, found))
    press(ui, found, "esc")
    assert not ui.over and len(ui.rows(found)) == 3


def test_while_a_filter_is_typed_q_is_a_letter(report: MakeReport) -> None:
    ui = Ui()
    press(ui, report(), "/", "q", "enter")
    assert (ui.over, ui.filter) == (False, "q")
    press(ui, report(), "q")
    assert ui.over


def test_details_tell_in_full_what_the_table_cuts(make: Make, report: MakeReport) -> None:
    words = "lease of planner ended 12s ago: gone, " * 5
    agent = AgentReport(name="follower", fleet="demo", host="quad1", state="track", text="4 m", age=8.0, stale=True)
    ui, found = Ui(), report(make(why=(("warn", words.strip()),)), make("quad2"), agents=(agent,))
    press(ui, found, "down", "enter")
    text = "\n".join(drawn(ui, found, 80, 40))
    for part in (
        "-- quad1 ---",
        "why        warn: lease of planner",
        "follower SILENT, last track: 4 m",
        "3.0s ago  info: mode",
    ):
        assert part in text
    assert text.count("lease of") == 6  # the row's, and those of long reasons that go on in the next line
    press(ui, found, "esc")
    assert "-- quad1" not in "\n".join(drawn(ui, found, 80, 40))


def test_the_selection_follows_its_vehicle(make: Make, report: MakeReport) -> None:
    ui, found = Ui(), fleet(make, report, 5)
    press(ui, found, "down", "down")
    more = report(make("copter1"), *found.vehicles)
    assert selected(ui, more) == "quad01"
    press(ui, more, "up", "up")
    assert selected(ui, more) == "copter1"


def test_agents_of_no_vehicle_and_silent_ones_are_above(make: Make, report: MakeReport) -> None:
    agents = (
        AgentReport(name="planner", fleet="demo", host="ground", state="swap", text="leg 2", age=0.4, stale=False),
        AgentReport(name="follower", fleet="demo", host="quad1", state="track", text="", age=0.4, stale=False),
        AgentReport(name="pad", fleet="demo", host="quad1", state="find", text="", age=7.0, stale=True),
    )
    assert drawn(Ui(), report(make(), agents=agents))[1] == (
        "agents: planner@ground swap: leg 2, pad@quad1 find SILENT for 7.0s"
    )


EVIL = "\x1b]0;pwned\x07\x1b[2J[bold red]\u202e\r\n"


def test_no_word_of_the_network_moves_the_cursor_or_is_markup(make: Make, report: MakeReport) -> None:
    evil = AgentReport(name="x", fleet="demo", host=EVIL, state=EVIL, text=EVIL, age=1.0, stale=False)
    network = NetworkReport(rtt=None, hops=1, way=[EVIL, EVIL], complete=False, weakest=None)
    found = report(
        make(EVIL, why=(("bad", EVIL),), mode=EVIL, kind=EVIL, autopilot=EVIL, network=network, firmware=EVIL),
        agents=(evil,),
    )
    ui = Ui()
    press(ui, found, "down", "enter")
    for width in (80, 250):
        frame = Painter().paint(draw(ui, found, width, 40), width)
        ours = re.sub(r"\x1b\[([0-9;]*m|K|H)|\r\n", "", frame)
        assert ours.isprintable()
        assert "[bold red]" in ours


def test_without_colours_words_remain(make: Make, report: MakeReport, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = draw(Ui(), report(make(presence="stale", age=3.0)), 120, 24)
    monkeypatch.setitem(os.environ, "TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\x1b[1;31mSTALE" in Painter().paint(lines, 120)
    monkeypatch.setenv("NO_COLOR", "1")
    plain = Painter().paint(lines, 120)
    assert "\x1b[1mSTALE" in plain
    assert not re.search(r"\x1b\[[0-9;]*3[0-7]", plain)


def test_the_age_of_corrections_is_shown_where_there_are_some(make: Make, report: MakeReport) -> None:
    assert "rtcm" not in drawn(Ui(), report(make()), 200)[1]
    some = wire.CorrectionsInfo(age=2.4, source="gs")
    _, head, first, second, *_ = drawn(Ui(), report(make("a", corrections=some), make("b")), 200)
    at = head.index("rtcm") + len("rtcm")
    assert first[:at].endswith("2.4s")
    assert second[:at].endswith("-")
