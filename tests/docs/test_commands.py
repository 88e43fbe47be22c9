"""Every command in README.md and docs/*.md: what it names is there, and it runs, or a table says why not here."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

import click
import pytest

from agents.controllers.inject import Inject, Kind, check
from agents.planner.solve.jit import compiled
from agents.planner.solve.warm import warm
from tests.agents.planner.generate import as_json, swap_circle
from tests.docs.commands import PAGES, ROOT, Command, all_commands, faults, verbs_in_prose, words_of
from tests.docs.pages import COMING, NOT_RUN, PARTS, QUAD, SWARM
from tests.docs.stage import Stage, namespaced

COMMANDS = all_commands()


def fits(pattern: str, command: Command) -> bool:
    return any(re.fullmatch(pattern, text) for text in (command.text, f"{command.page}: {command.text}"))


def not_run(command: Command) -> str | None:
    """Why a command is not run here; None where it is."""
    return next((why for pattern, why in NOT_RUN.items() if fits(pattern, command)), None)


def to_run(page: str) -> list[Command]:
    return [command for command in COMMANDS if command.page == page and not_run(command) is None]


def test_every_command_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Verbs, options and their values, make's targets, files of the tree; the reader's own files need not be there."""
    monkeypatch.setattr(click.Path, "convert", lambda self, value, param, ctx: value)
    assert len(COMMANDS) > 100, "the pages' commands are not found"
    wrong = [f"{command}\n    {fault}" for command in COMMANDS for fault in faults(command, COMING)]
    assert not wrong, "\n" + "\n".join(wrong)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("zmav nosuch", "No such command"),
        ("zmav ls --nosuch", "No such option"),
        ("zmav hz quad1 --for soon", "not a valid float"),
        ("zmav ls && zmav fly", "Missing argument"),
        ("make nosuch", "no target"),
        ("zmav plan deploy/nosuch.json", "not in the tree"),
    ],
)
def test_a_command_that_cannot_be_is_named(text: str, words: str) -> None:
    assert words in " ".join(faults(Command("page.md", 1, text)))


def test_every_verb_in_the_prose_is_there() -> None:
    wrong = [fault for page in PAGES for fault in verbs_in_prose(page, COMING)]
    assert not wrong, "\n" + "\n".join(wrong)


def test_every_command_is_run_or_told_of() -> None:
    lost = [str(command) for command in COMMANDS if command.page not in PARTS and not_run(command) is None]
    assert not lost, (
        "\nthese are neither run nor is it said why not. In tests/docs/pages.py, give the page its parts in PARTS "
        "(then they are run), or the command a line with a reason in NOT_RUN:\n" + "\n".join(lost)
    )


def test_no_reason_is_given_for_what_no_page_says() -> None:
    dead = [pattern for pattern in NOT_RUN if not any(fits(pattern, command) for command in COMMANDS)]
    assert not dead, f"no document has these any more; take them out of NOT_RUN: {dead}"
    for page, parts in PARTS.items():
        assert to_run(page), f"{page} has nothing that is run: take it out of PARTS"
        for part in parts:
            assert any(command.text.startswith(part.at) for command in to_run(page)) or not part.at, (
                f"{page}: no command that is run begins with {part.at!r}: mend PARTS"
            )


def test_what_a_reason_names_is_there() -> None:
    named = [path for why in NOT_RUN.values() for path in re.findall(r"tests/[\w/]+(?:\.py)?", why)]
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_what_is_injected_has_its_channel_in_what_is_followed() -> None:
    """After 'engage' that is a place."""
    found = [words for command in COMMANDS for words in words_of(command.text) if words[1:3] == ["agent", "inject"]]
    assert {command.page for command in COMMANDS if "agent inject" in command.text} >= {"README.md"}
    for words in found:
        given = {name: words[words.index(f"--{name}") + 1] for name in ("channel", "amplitude")}
        kind, amplitude = cast(Kind, words[4]), float(given["amplitude"])
        check(Inject(kind=kind, channel=given["channel"], amplitude=amplitude, seconds=3.0), "position")


class Lines(NamedTuple):
    """What is run from a fresh start to the next, beside what runs already: each line with where it stands."""

    on: tuple[str, ...]
    lines: list[tuple[str, str]]
    alone: bool


def fresh_starts(page: str) -> Iterator[Lines]:
    """A page's commands and what must run before them, cut where nothing of what came before runs any more."""
    parts, found = list(PARTS[page]), Lines((), [], False)
    for command in to_run(page):
        while parts and command.text.startswith(parts[0].at):
            part = parts.pop(0)
            if part.fresh:
                if found.lines:
                    yield found
                found = Lines(part.on, [], part.alone)
            found.lines.extend((line, f"{page}: before {command.text!r}") for line in part.before)
        found.lines.append((command.text, str(command)))
    yield found


STARTS = [(f"{page}-{number}", lines) for page in PARTS for number, lines in enumerate(fresh_starts(page), 1)]
STARTS.sort(key=lambda start: start[1].on, reverse=True)  # beside the same programs: one after another


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    if why := namespaced():
        pytest.skip(why)
    with Stage() as stage:
        yield stage


@pytest.mark.parametrize(
    "start", [pytest.param(lines, id=name, marks=[pytest.mark.alone] * lines.alone) for name, lines in STARTS]
)
@pytest.mark.timeout(300)
def test_the_commands_of_a_page_run(stage: Stage, start: Lines, tmp_path: Path) -> None:
    planned = re.compile(r"zmav (plan|swarm planner)\b")
    if any(map(planned.match, (*start.on, *dict(start.lines)))) and not compiled():
        warm()  # which takes minutes
    files(tmp_path)
    with stage.part(tmp_path, start.on):
        for line, where in start.lines:
            stage.run(line, where)


def test_what_the_readme_has_its_reader_start_is_there_though_it_runs_already() -> None:
    """Its commands run beside those programs: none would fail where a line that starts one is missing."""
    quad, swarm = (
        [line for line, _ in lines.lines]
        for on in (QUAD, SWARM)
        for lines in [next(lines for name, lines in STARTS if name.startswith("README.md-") and lines.on == on)]
    )
    assert [line for line in quad if line.startswith(("zmav sim", "zmav up"))] == list(QUAD)
    assert quad.index(QUAD[-1]) < quad.index("zmav ls")
    assert swarm[0] == SWARM[-1]


def test_what_does_not_run_is_said(stage: Stage, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="no Zenoh router answers"), stage.part(tmp_path):
        stage.run("zmav ls", "page.md:1: zmav ls")


def simple(number: int, command: int, lat: float, lon: float, alt: float) -> dict[str, Any]:
    params = [0, 0, 0, None, lat, lon, alt]
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "doJumpId": number,
        "frame": 3,
        "params": params,
    }


def plan() -> dict[str, Any]:
    """A mission of a few seconds from where the copter is, as QGroundControl saves it."""
    items = [simple(1, 22, -35.363261, 149.165230, 10), simple(2, 16, -35.36320, 149.165230, 10)]
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "cruiseSpeed": 15,
            "firmwareType": 3,
            "globalPlanAltitudeMode": 1,
            "hoverSpeed": 5,
            "items": items,
            "plannedHomePosition": [-35.363261, 149.165230, 584.09],
            "vehicleType": 2,
            "version": 2,
        },
    }


def files(folder: Path) -> None:
    """What a reader of the pages would have."""
    (folder / "survey.plan").write_text(json.dumps(plan()))
    shutil.copy(ROOT / "deploy" / "fleets" / "lan.toml", folder / "fleet.toml")
    (folder / "scene.json").write_text(json.dumps(as_json(swap_circle(3))))
    for name, text in programs():
        (folder / name).write_text(text)


def programs() -> Iterator[tuple[str, str]]:
    """The whole programs that a page shows, each under the name in its first line: ``# blinker.py``."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        for body in re.findall(r"```python\n(# (\w+\.py)\b.*?)```", page.read_text("utf-8"), re.DOTALL):
            yield body[1], body[0]
