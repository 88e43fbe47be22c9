"""The base of agents: heard, asked and tuned through a real router, and started from the command line's table."""

from __future__ import annotations

import asyncio
import contextlib
import math
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import msgspec
import pytest
from click.testing import CliRunner

import zmav
from zmav import keys, wire
from zmav.agent import Tunable
from zmav.cli.agent import command, find, own_lines, resolve
from zmav.client import Answer
from zmav.errors import BadConfig, BadInput, BadKey, Clash, Refused, TimedOut
from zmav.verbs import Access, Verb

if TYPE_CHECKING:
    from tests.conftest import Net, Samples


class Count(wire.Order, kw_only=True):
    to: int


class Counter(zmav.Agent):
    """Counts when it is told to."""

    name = "counter"
    tunables: ClassVar = {"gain": Tunable(1.0, 0.0, 5.0, "1/s", "how fast")}
    verbs: ClassVar = {"count": Verb("count", Count, Access.CHANGE, "count up to a number")}

    async def run(self) -> None:
        self.status("waiting")
        await asyncio.Event().wait()

    async def on_count(self, args: Count, report: Any, origin: object) -> dict[str, Any]:
        if args.to < 0:
            raise Refused("it counts upwards only", field="to")
        self.status("counting", f"to {args.to}", to=args.to)
        return {"counted": args.to}


class Scene(NamedTuple):
    agent: Counter
    quad: zmav.Vehicle
    said: Samples
    z: zmav.Client
    """of who asks"""


@pytest.fixture
async def scene(net: Net) -> AsyncIterator[Scene]:
    """An agent and who asks it, each a client of the router."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, zmav.open(connect=[endpoint]) as mine:
        from tests.conftest import Samples

        said = Samples(z.session, "zmav/demo/quad1/agent/counter/status")
        async with Counter(mine, "quad1") as agent:
            running = asyncio.create_task(agent.run())
            await said.until(lambda: any(s["state"] == "waiting" for s in said.objects()), "status")
            assert isinstance(agent, Counter)
            yield Scene(agent, z.vehicle("quad1"), said, z)
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await running


async def test_it_is_asked_and_says_what_it_does(scene: Scene) -> None:
    # No vehicle speaks here: what answers is the agent alone.
    assert await ask(scene, "count", {"to": 7}) == {"counted": 7}
    await scene.said.until(lambda: scene.said.objects()[-1]["state"] == "counting", "news")
    last = scene.said.objects()[-1]
    assert (last["text"], last["detail"]["to"], last["detail"]["params"]) == ("to 7", 7, {"gain": 1.0})
    with pytest.raises(Refused, match="upwards"):
        await ask(scene, "count", {"to": -1})
    with pytest.raises(BadInput, match="count, params, set"):
        await ask(scene, "sing", {})
    with pytest.raises(BadInput, match="to"):
        await ask(scene, "count", {"to": "many"})


async def test_it_is_tuned_within_its_bounds(scene: Scene) -> None:
    assert await ask(scene, "set", {"name": "gain", "value": 2.5}) == {"name": "gain", "value": 2.5, "before": 1.0}
    assert scene.agent["gain"] == 2.5
    for name, value, words in (("gain", 5.1, "0 to 5 1/s"), ("gain", float("inf"), "gain"), ("mass", 1.0, "no param")):
        with pytest.raises(BadInput, match=words):
            scene.agent.tune(name, value)
    with pytest.raises(BadInput, match="expected 0 to 5"):
        await ask(scene, "set", {"name": "gain", "value": -1.0})
    assert scene.agent["gain"] == 2.5
    found = await ask(scene, "params", {})
    assert msgspec.convert(found["gain"], wire.TunableInfo).value == 2.5
    await scene.said.until(lambda: scene.said.objects()[-1]["detail"]["events"] != [], "the change in its status")
    assert "gain is 2.5, was 1" in scene.said.objects()[-1]["detail"]["events"][0]["text"]


async def test_a_vehicle_without_that_agent_says_how_to_start_one(scene: Scene) -> None:
    scene.quad.give_up, scene.quad.ask_again = 0.3, 0.2
    here = keys.ALIVE.key("demo", "quad1", role=keys.VEHICLE, sys=1, autopilot="px4", uid="-", instance="x")
    token = scene.z.session.liveliness().declare_token(here)
    while not scene.quad.present:
        await scene.z.news(1.0)
    assert (await scene.quad.tell("counter", "count", to=3))["counted"] == 3
    with pytest.raises(TimedOut, match="zmav agent run follower --vehicle quad1"):
        await scene.quad.tell("follower", "follow")
    token.undeclare()


async def test_a_second_one_of_its_name_is_refused_while_the_first_one_runs(net: Net) -> None:
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as one, zmav.open(connect=[endpoint]) as other:
        async with Counter(one, "quad1"):
            with pytest.raises(Clash, match="counter runs for quad1 already"):
                await Counter(other, "quad1").__aenter__()
            async with Counter(other, "quad2"):
                pass
        async with Counter(other, "quad1"):
            pass


async def test_its_last_word_is_that_it_has_ended(net: Net) -> None:
    from tests.conftest import Samples

    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, zmav.open(connect=[endpoint]) as mine:
        said = Samples(z.session, "zmav/demo/quad1/agent/*/status")
        async with Counter(mine, "quad1"):
            await said.until(lambda: len(said.items) > 0, "status")
        await said.until(lambda: said.objects()[-1]["state"] == "ended", "end")


def test_what_there_is_not_is_named() -> None:
    with pytest.raises(BadInput, match="no agent 'nonsense'"):
        find("nonsense")
    result = CliRunner().invoke(command, ["run", "nonsense", "--vehicle", "quad1"])
    assert isinstance(result.exception, BadInput)


MINE = """
import asyncio
import zmav

class Mine(zmav.Agent):
    name = "mine"

    async def run(self):
        await asyncio.Event().wait()
"""


def test_a_file_that_holds_an_agent_is_one(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(MINE)
    kind, given = resolve(str(path))
    assert (kind.name, given) == ("mine", {})
    about = CliRunner().invoke(command, ["about", str(path)])
    assert about.exit_code == 0


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (MINE + MINE.replace("Mine", "Other"), "expected one class"),
        (MINE.replace('    name = "mine"\n', ""), "with a name"),
        (MINE + "raise OSError('no disk')\n", r"mine\.py\", line \d+, in <module>\n.*\nOSError: no disk"),
        (MINE + "def (:\n", "SyntaxError"),
    ],
    ids=["two", "nameless", "raises", "broken"],
)
def test_a_file_that_holds_no_one_agent_says_why(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(BadConfig, match=why):
        resolve(str(path))


def test_a_mistake_without_a_line_of_the_agents_own_is_shown_whole(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="elsewhere") as caught:
        raise ValueError("elsewhere")
    assert "test_agent.py" in own_lines(caught.value, str(tmp_path / "mine.py"))


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match=r"mine\.py"):
        resolve(str(tmp_path / "mine.py"))


def test_any_other_file_and_the_installed_controllers_are_for_the_supervisor(tmp_path: Path) -> None:
    path = tmp_path / "kp.py"
    path.write_text("raise RuntimeError('this is not run here')\n")
    kind, given = resolve(str(path))
    assert (kind.name, given) == ("controller", {"controller": str(path)})
    kind, given = resolve("ev2")
    assert (kind.name, given) == ("controller", {"controller": "ev2"})


async def test_parameters_are_keys_and_others_can_be_declared(scene: Scene) -> None:
    from tests.conftest import Samples

    z = scene.z
    key = keys.AGENT_PARAM.key("demo", "quad1", agent="counter", param="*")
    (answer,) = await z.ask(key)
    assert isinstance(answer, Answer)
    assert answer.key.endswith("agent/counter/param/gain")
    assert wire.decode(answer.payload, wire.TunableInfo, "param").unit == "1/s"
    heard = Samples(z.session, key)
    await ask(scene, "set", {"name": "gain", "value": 2.0})
    await heard.until(lambda: bool(heard.items), "the change")
    assert heard.objects()[-1]["value"] == 2.0
    scene.agent.declare({"gain": Tunable(1.0, 0.0, 1.5), "more": Tunable(7.0, 0.0, 9.0)})
    assert (scene.agent["gain"], scene.agent["more"]) == (1.0, 7.0), "2 is beyond what it may be now"
    scene.agent.tune("more", 8.0)
    scene.agent.declare({"more": Tunable(7.0, 0.0, 9.0)})
    assert scene.agent["more"] == 8.0


async def ask(scene: Scene, verb: str, args: dict[str, Any]) -> dict[str, Any]:
    key = keys.AGENT_DO.key("demo", "quad1", agent="counter", verb=verb)
    z = scene.z
    answers = await z.ask(key, msgspec.json.encode(args), timeout=10.0, channel=keys.AGENT_DO)
    (answer,) = answers
    if isinstance(answer, zmav.ZmavError):
        raise answer
    return wire.decode(answer.payload, wire.Outcome, "reply").result


async def test_a_topic_of_its_own_is_heard(scene: Scene) -> None:
    async with scene.z.subscribe("quad1/agent/counter/out/wind") as samples:
        while True:
            scene.agent.publish("wind", {"north": 1.5, "east": math.nan}, t=5.0)
            with contextlib.suppress(asyncio.TimeoutError):
                sample = await asyncio.wait_for(samples.get(), 0.2)
                break
    assert wire.decode(sample.payload.to_bytes(), wire.Signals, "out") == wire.Signals(t=5.0, values={"north": 1.5})
    with pytest.raises(BadKey, match="topic 'Wind Speed' cannot stand in a key"):
        scene.agent.publish("Wind Speed", {})
    for wrong in (5.0, [1.0], {"north": "hard"}, {"north": None}):
        with pytest.raises(BadInput, match=r"what is published is .*; expected numbers by their names"):
            scene.agent.publish("wind", wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("        self.helper()\n\n    def helper(self):\n        return {}['x']\n", "KeyError: 'x'"),
        ("        await self.vehicle.hold(wrong=1)\n", "TypeError: "),
    ],
    ids=["its own", "through the library"],
)
def test_a_mistake_is_said_from_its_own_line_on(net: Net, tmp_path: Path, text: str, said: str) -> None:
    path, (_, endpoint) = tmp_path / "mine.py", net.router()
    path.write_text(MINE.replace("        await asyncio.Event().wait()\n", text))
    run = ["-m", "zmav", "agent", "run", str(path), "--vehicle", "quad1", "-e", endpoint]
    done = subprocess.run([sys.executable, *run], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    (start,) = [i for i, line in enumerate(done.stderr.splitlines()) if line == "zmav: mine failed:"]
    first, second, *_, last = done.stderr.splitlines()[start + 1 :]
    assert first == "Traceback (most recent call last):"
    assert second.endswith(", in run") and str(path) in second
    assert last.startswith(said)


def test_a_topic_that_is_published_wrongly_is_said_with_its_line(net: Net, tmp_path: Path) -> None:
    path, (_, endpoint) = tmp_path / "mine.py", net.router()
    path.write_text(MINE.replace("await asyncio.Event().wait()", "self.publish('my topic', {})"))
    run = ["-m", "zmav", "agent", "run", str(path), "--vehicle", "quad1", "-e", endpoint]
    done = subprocess.run([sys.executable, *run], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    (said,) = [line for line in done.stderr.splitlines() if line.startswith("zmav: ")]
    assert said.startswith("zmav: topic 'my topic' cannot stand in a key")
    assert said.endswith(f"({path}, line 9)")


def test_of_an_agent_of_ours_what_was_given_wrongly_is_said_without_its_line(net: Net) -> None:
    _, endpoint = net.router()
    run = ["-m", "zmav", "agent", "run", "follower", "--vehicle", "quad1", "--set", "nosuch=1", "-e", endpoint]
    done = subprocess.run([sys.executable, *run], capture_output=True, text=True, timeout=60)
    (said,) = [line for line in done.stderr.splitlines() if line.startswith("zmav: ")]
    assert "no parameter 'nosuch'" in said and ".py" not in said
