"""The control socket: what a running simulator can be told, by one or many, well or badly; and whose socket it is."""

from __future__ import annotations

import json
import math
import os
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from zmav.errors import BadConfig, BadInput, LinkDown, PortInUse, TimedOut, ZmavError
from zmav.sim import VehicleSpec, World
from zmav.sim.listener import Listener
from zmav.sim.remote import Remote, control_directory, control_path, running

PATIENCE_S = 30.0


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty directory for control sockets."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "zmav-sim"


class Started(World):
    """A world that runs as ``zmav sim`` runs it, in a thread of the test's."""

    def begin(self, name: str) -> None:
        self.listener = Listener(control_path(name), self)
        self._running = threading.Thread(target=self.run)
        self._running.start()

    def join(self) -> None:
        self._running.join(PATIENCE_S)


@pytest.fixture
def start(runtime: Path) -> Iterator[Any]:
    """Starts worlds with a control socket of that name."""
    ran: list[Started] = []

    def start(name: str, **options: Any) -> Started:
        ran.append(Started([VehicleSpec(endpoints=())], **{"ready_s": 0.5, "speed": 10.0, **options}))
        ran[-1].begin(name)
        return ran[-1]

    yield start
    for world in ran:
        world.stop()
        world.join()
        world.listener.close()
        world.close()


def raw(path: Path, *lines: str) -> list[dict[str, Any]]:
    """The answers to lines, each as JSON."""
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(PATIENCE_S)
        link.connect(str(path))
        link.sendall("".join(line + "\n" for line in lines).encode())
        with link.makefile() as answers:
            return [json.loads(answers.readline()) for _ in lines]


class TestWords:
    def test_the_clock_obeys(self, start: Any) -> None:
        world = start("one")
        with Remote() as sim:
            paused = sim.pause()
            assert paused.paused
            assert sim.status().time_s == paused.time_s
            stepped = sim.step(2.5)
            assert stepped.time_s == pytest.approx(paused.time_s + 2.5)
            assert stepped.paused
            assert sim.speed(0.0).speed is None
            assert sim.speed(20.0).speed == 20.0
            assert not sim.resume().paused
        world.wait_for(lambda: world.time_s > stepped.time_s + 1.0)

    def test_the_status_is_the_worlds(self, start: Any) -> None:
        world = start("one", speed=4.0)
        with Remote() as sim:
            sim.pause()
            assert sim.status() == world.status()
            assert (sim.status().speed, sim.status().vehicles[0].name) == (4.0, "quad1")

    def test_the_pilots_hands_are_told_by_the_numbers_of_channels(self, start: Any) -> None:
        world = start("one")
        with Remote() as sim:
            sim.pilot("quad1", None, {7: 1900})
        brain = world.vehicles[0].brain
        assert brain.pilot.pwm[6] == 1900

    def test_a_pause_ends_a_step(self, start: Any) -> None:
        start("one", speed=1.0)
        with Remote() as stepper, Remote() as sim:
            found: list[float] = []
            waiting = threading.Thread(target=lambda: found.append(stepper.step(3600.0).time_s))
            waiting.start()
            while sim.status().time_s < 0.2:
                pass
            assert sim.pause().time_s < 60.0
            waiting.join(PATIENCE_S)
            assert found[0] < 60.0

    def test_a_step_for_another_ends_a_step(self, start: Any) -> None:
        """And what the first asks for next is done as well, though it comes while the second's begins."""
        world = start("one", speed=1.0)
        (path,) = running()
        with socket.socket(socket.AF_UNIX) as link, Remote() as sim:
            link.settimeout(PATIENCE_S)
            link.connect(str(path))
            link.sendall(b'{"verb":"step","args":{"seconds":3600}}\n{"verb":"step","args":{"seconds":0.5}}\n')
            while not world.call(lambda: world.pacer.stepping):
                pass
            assert sim.step(0.5).time_s < 60.0
            with link.makefile() as answers:
                assert [json.loads(answers.readline())["result"]["time_s"] < 60.0 for _ in range(2)] == [True, True]

    def test_a_pause_is_one_at_once(self, start: Any) -> None:
        start("one", speed=1000.0)
        with Remote() as sim:
            for _ in range(20):
                assert sim.pause().time_s == sim.status().time_s
                sim.resume()

    def test_the_end_ends_a_step_and_the_connection(self, start: Any) -> None:
        world = start("one", speed=1.0)
        with Remote() as stepper, Remote() as sim:
            errors: list[BaseException] = []

            def step() -> None:
                try:
                    stepper.step(3600.0)
                except ZmavError as e:
                    errors.append(e)

            waiting = threading.Thread(target=step)
            waiting.start()
            while not sim.call("status")["time_s"]:
                pass
            sim.stop()
            world.join()
            world.listener.close()  # hangs up on everybody
            waiting.join(PATIENCE_S)
        assert isinstance(errors[0], TimedOut | LinkDown)
        with pytest.raises(LinkDown, match="no simulator runs"):
            Remote()

    @pytest.mark.parametrize(
        ("verb", "args", "words"),
        [
            ("dance", {}, "no request 'dance'; there are"),
            ("speed", {}, "missing required field `times`"),
            ("speed", {"times": "fast"}, "Expected `float`, got `str`"),
            ("speed", {"times": -1.0}, r"expected 0\.001 to"),
            ("speed", {"times": 1e-9}, r"expected 0\.001 to"),
            ("fault", {"vehicle": "quad1", "kind": "motor", "parameters": {"kind": 1}}, "no parameter 'kind'"),
            ("pause", {"now": 1}, "unknown field `now`"),
            ("step", {"seconds": 0.0}, "expected 0.01 to 1000000"),
            ("step", {"seconds": -5.0}, "expected 0.01 to 1000000"),
        ],
    )
    def test_bad_words_are_named(self, start: Any, verb: str, args: dict[str, Any], words: str) -> None:
        start("one")
        with Remote() as sim:
            with pytest.raises(BadInput, match=words):
                sim.call(verb, **args)
            assert sim.status().vehicles  # nothing has come of it

    def test_garbage_is_answered(self, start: Any) -> None:
        start("one")
        (path,) = running()
        answers = raw(path, "hello", "[]", '{"verb": 5}', '{"verb": "status", "x": 1}', '{"verb": "pause"}')
        assert [a.get("error", {}).get("code") for a in answers] == ["bad_input"] * 4 + [None]

    def test_a_line_without_end_is_hung_up_on(self, start: Any) -> None:
        start("one")
        (path,) = running()
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(PATIENCE_S)
            link.connect(str(path))
            with pytest.raises(ConnectionError):
                for _ in range(64):
                    link.sendall(b"x" * 65536)
        assert raw(path, '{"verb": "pause"}')[0]["result"]["paused"]

    def test_a_heap_of_lines_is_gone_through_swiftly(self, start: Any) -> None:
        """It comes while a step is under way, and is looked at after that."""
        world = start("one", speed=math.inf)
        (path,) = running()
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(PATIENCE_S)
            link.connect(str(path))
            world.pause()
            link.sendall(b'{"verb":"step","args":{"seconds":5}}\n' + b"\n" * 1_000_000 + b'{"verb":"pause"}\n')
            with link.makefile() as answers:
                assert ["result" in json.loads(answers.readline()) for _ in range(2)] == [True, True]

    def test_one_that_never_reads_holds_nobody_up(self, start: Any) -> None:
        world = start("one")
        (path,) = running()
        with socket.socket(socket.AF_UNIX) as deaf:
            deaf.connect(str(path))
            deaf.setblocking(False)
            with pytest.raises(BlockingIOError):
                while True:
                    deaf.send(b'{"verb": "status"}\n' * 100)
            before = world.time_s
            world.wait_for(lambda: world.time_s > before + 1.0)
            assert raw(path, '{"verb": "pause"}')[0]["result"]["paused"]
            # Whatever it has asked for is answered once it reads.
            deaf.settimeout(PATIENCE_S)
            with deaf.makefile() as answers:
                for _ in range(2000):
                    assert "result" in json.loads(answers.readline())

    def test_a_defect_in_answering_is_an_answer(self, start: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        world = start("one")

        def fail() -> None:
            raise RuntimeError("a defect")

        monkeypatch.setattr(world, "status", fail)
        with Remote() as sim:
            with pytest.raises(ZmavError, match="a defect"):
                sim.status()
            monkeypatch.undo()
            assert world.status().vehicles


class TestPlace:
    def test_only_the_owner_may(self, start: Any, runtime: Path) -> None:
        start("one")
        assert [stat.S_IMODE(p.stat().st_mode) for p in (runtime, runtime / "one.sock")] == [0o700, 0o600]

    def test_it_goes_with_the_world(self, runtime: Path) -> None:
        listener = Listener(control_path("one"), World(endpoint="tcp:0"))
        assert running() == [runtime / "one.sock"]
        listener.close()
        assert list(runtime.iterdir()) == []

    def test_without_a_name_it_is_called_after_the_process(self, runtime: Path) -> None:
        assert control_path() == runtime / f"{os.getpid()}.sock"
        assert control_path("/tmp/x.sock") == Path("/tmp/x.sock")

    def test_of_two_one_must_be_named(self, start: Any) -> None:
        start("one", speed=2.0)
        start("two", speed=3.0)
        with pytest.raises(BadConfig, match=r"several simulators run: .*\(one, two\)"):
            Remote()
        with Remote("one") as first, Remote("two") as second:
            assert (first.status().speed, second.status().speed) == (2.0, 3.0)

    def test_two_cannot_have_one_name(self, start: Any) -> None:
        start("one")
        world = World(endpoint="tcp:0")
        with pytest.raises(PortInUse, match=r"another simulator has the control socket .*one\.sock"):
            Listener(control_path("one"), world)
        world.close()
        assert [path.stem for path in running()] == ["one"]  # the first one's is left alone

    def test_what_a_killed_one_left_is_replaced(self, runtime: Path, start: Any) -> None:
        control_directory()
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(runtime / "one.sock"))
        assert running() == []
        with pytest.raises(LinkDown, match="no simulator listens"):
            Remote("one")
        start("one")
        assert len(running()) == 1

    def test_many_that_start_at_once_get_one_each(self, runtime: Path) -> None:
        """All want what a killed one has left: one gets it."""
        control_directory()
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(runtime / "one.sock"))
        world = World(endpoint="tcp:0")
        listeners: list[Listener] = []
        refused: list[PortInUse] = []
        together = threading.Barrier(8)

        def begin() -> None:
            together.wait()
            try:
                listeners.append(Listener(control_path("one"), world))
            except PortInUse as e:
                refused.append(e)

        threads = [threading.Thread(target=begin) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert (len(listeners), len(refused)) == (1, 7)
        listeners[0].close()
        world.close()
        assert not (runtime / "one.sock").exists()

    def test_other_things_are_left_alone(self, tmp_path: Path, runtime: Path) -> None:
        (tmp_path / "notes").write_text("mine")
        for path, words in ((tmp_path / "notes", "is no socket"), (tmp_path / "no" / "x", "No such file")):
            world = World(endpoint="tcp:0")
            with pytest.raises(BadConfig, match=words):
                Listener(path, world)
            world.close()
        with pytest.raises(BadConfig, match="too long"):
            control_path("/tmp/" + "x" * 120)
        with pytest.raises(BadConfig, match="empty"):
            control_path("")

    def test_a_directory_that_others_may_write_to_is_not_used(self, runtime: Path) -> None:
        control_directory().chmod(0o777)
        with pytest.raises(BadConfig, match="not a directory of yours alone"):
            control_path("one")
        runtime.rmdir()
        runtime.symlink_to("/tmp")
        with pytest.raises(BadConfig, match="not a directory of yours alone"):
            control_path("one")
