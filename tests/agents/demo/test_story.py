"""The demo fleets as files: every one is whole, every verb in it is one, and what is wrong in a file is named."""

from __future__ import annotations

import shlex
from pathlib import Path

import click
import msgspec
import pytest

from agents.demo.cli import stack_options
from agents.demo.story import Demo, check_extras, demos, find, load, on_stacks
from zmav.cli import zmav
from zmav.errors import BadConfig
from zmav.sim.fleetfile import load_simulated

NAMES = ("fifty", "follow", "formation", "line", "lost-link", "mixed", "prototype", "swap")
FLEET = """
[origin]
lat_deg = 0.0
lon_deg = 0.0
alt_amsl = 0.0
[vehicles.a]
link = "tcp:127.0.0.1:5760"
[vehicles.b]
link = "tcp:127.0.0.1:5770"
[demo]
title = "two"
"""


def verbs(demo: Demo) -> list[str]:
    return [command for step in demo.story.steps for command in (step.run, step.start) if command]


def test_they_are_all_there() -> None:
    assert tuple(demo.path.stem for demo in demos()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_its_vehicles_are_simulated_and_its_verbs_are_verbs(name: str) -> None:
    demo = find(name)
    assert [spec.name for spec in load_simulated(demo.path).vehicles] == demo.vehicles
    assert verbs(demo)
    for command in verbs(demo):
        parse(shlex.split(command)[1:])


def parse(words: list[str]) -> None:
    """As the command line does, but nothing is done; click raises what is wrong."""
    command: click.Command = zmav
    context = zmav.make_context("zmav", list(words))
    while isinstance(command, click.Group):
        name, found, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        assert found is not None
        assert name is not None
        command, context = found, found.make_context(name, rest, parent=context)


@pytest.mark.parametrize("name", NAMES)
def test_it_says_which_extras_its_verbs_need(name: str) -> None:
    """The Makefile installs those, and no others."""
    demo = find(name)
    planners = [verb for verb in verbs(demo) if verb.startswith("zmav swarm planner")]
    interpreted = ["interpreted" for verb in planners if "--interpret" in verb]
    planned = [verb for verb in planners if "--interpret" not in verb]
    seen = [verb for verb in verbs(demo) if "camera" in verb or "helipad" in verb]
    assert list(demo.story.needs) == [*interpreted, *(["planner"] if planned else []), *(["vision"] if seen else [])]


def test_an_extra_that_is_missing_is_said_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    check_extras(find("lost-link"))
    for name, extra in (("line", "interpreted"), ("swap", "planner"), ("follow", "vision")):
        with pytest.raises(BadConfig, match=rf"the demo {name} needs \w+: pip install 'zmav\[{extra}\]'"):
            check_extras(find(name))


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "demo.toml"
    path.write_text(FLEET + text)
    return path


RUN = '[[demo.steps]]\nrun = "zmav ls"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "missing required field `steps`"),
        ('[[demo.steps]]\nrun = "ls"\n', "demo.steps[0].run is 'ls'; expected zmav and a verb"),
        ('[[demo.steps]]\nrun = "zmav ls"\npause = 1.0\n', "demo.steps[0] is 'run and pause'"),
        ("[[demo.steps]]\n", "demo.steps[0] is 'nothing'"),
        ("[[demo.steps]]\npause = 0.0\n", "demo.steps[0].pause"),
        ("[[demo.steps]]\nflight = 1\n", "unknown field `flight`"),
        ('[[demo.steps]]\nrun = "zmav ls"\non = "c"\n', "demo.steps[0].on is 'c'; expected one of a, b, ground"),
        ('[[demo.steps]]\ncut = [["a", "b"]]\n', "demo.steps[0].cut is 'a - b'; expected two names that are linked"),
        ('[[demo.steps]]\nstop = "planner"\n', "demo.steps[0].stop is 'planner'; expected what was started: nothing"),
        ('[[demo.steps]]\nwait = { vehicles = ["c*"] }\n', "demo.steps[0].wait.vehicles is ('c*',)"),
        ('[[demo.steps]]\npause = 1.0\nuntil = "x"\n', "demo.steps[0].until is 'x'; expected a step with start"),
    ],
)
def test_what_is_wrong_is_named_with_its_file(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(BadConfig) as caught:
        load(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_fleet_without_a_story_and_a_name_that_is_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET.replace('[demo]\ntitle = "two"\n', ""))
    with pytest.raises(BadConfig, match=r"no table \[demo\]"):
        load(path)
    with pytest.raises(BadConfig, match=r"no demo is called 'swop'; there are fifty, follow, formation, line"):
        find("swop")
    with pytest.raises(BadConfig, match=r"nowhere\.toml"):
        find(str(tmp_path / "nowhere.toml"))


@pytest.mark.parametrize(
    ("links", "relays"),
    [
        ('"star"', (0, 0)),
        ('"line"', (0, 1)),
    ],
)
def test_relays_are_counted(tmp_path: Path, links: str, relays: tuple[int, int]) -> None:
    demo = load(written(tmp_path, f"links = {links}\n{RUN}"))
    assert (demo.relays("a"), demo.relays("b")) == relays


def test_only_links_that_a_step_cuts_are_laid_through_a_relay() -> None:
    assert find("lost-link").cuttable() == {frozenset(("quad1", "quad2"))}
    assert find("line").cuttable() == set()


def test_what_the_simulator_is_told_of_real_stacks() -> None:
    """Exact receivers: what a single one is off by would have them meet."""
    assert stack_options(find("line"), None, None) == ()
    assert stack_options(find("swap"), None, "/px4") == ("--px4", "/px4", "--noise", "rtk")
    both = ("--ardupilot", "/a", "--px4", "/px4", "--noise", "rtk")
    assert stack_options(find("mixed"), "/a", "/px4") == both
    assert stack_options(find("fifty"), "/a", None)[:2] == ("--ardupilot", "/a")
    with pytest.raises(BadConfig, match="fifty has 50 copters, and PX4s that are started have links for 10"):
        stack_options(find("fifty"), None, "/px4")


def test_what_no_stack_can_fly_is_refused_before_anything_starts() -> None:
    for ardupilot in (None, "/a"):
        with pytest.raises(BadConfig, match=r"hex1 of prototype is a hexarotor.*without --px4"):
            stack_options(find("prototype"), ardupilot, "/px4")
    line = find("line")
    hexa = msgspec.structs.replace(line.fleet.vehicles["quad2"], sim={"airframe": "hexa"})
    fleet = msgspec.structs.replace(line.fleet, vehicles={**line.fleet.vehicles, "quad2": hexa})
    with pytest.raises(BadConfig, match="quad2 of line is a hexarotor"):
        stack_options(msgspec.structs.replace(line, fleet=fleet), None, "/px4")
    assert stack_options(find("follow"), "/a", "/px4")[:4] == ("--ardupilot", "/a", "--px4", "/px4")


def test_real_stacks_are_given_room_and_time() -> None:
    demo = find("mixed")
    loose = on_stacks(demo)
    assert loose.story.ready == 2.0 * demo.story.ready
    assert [step.within for step in loose.story.steps] == [2.0 * step.within for step in demo.story.steps]
    changed = [b.start for a, b in zip(demo.story.steps, loose.story.steps, strict=True) if a.start != b.start]
    assert changed == ["zmav swarm planner --margin 1 --tracking 1 --margin 1.4"]
    for command in verbs(loose):
        parse(shlex.split(command)[1:])
