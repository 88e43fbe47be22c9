"""``python -m tests.bench.controllers``: each measurement's arithmetic against known data, and one quick run."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from agents.controllers import Reference, State
from agents.controllers.loops.parts import GRAVITY
from tests.bench.controllers import clock, cpu, flight, links, report, tracking
from tests.bench.controllers.__main__ import chosen
from tests.bench.controllers.echo import HANGS, IS_NOT_FINITE, RAISES, Echo
from tests.bench.controllers.fake import Stick, stick_of
from tests.bench.controllers.handback import Back
from tests.bench.controllers.links import Sample
from tests.bench.controllers.processes import children, cpu_seconds
from tests.bench.controllers.spread import effects, spread
from tests.bench.controllers.trip import Trip
from zmav.children import Children
from zmav.errors import BadInput, Stale, ZmavError


def samples(gaps: list[float], sent: float = 0.004, size: int = 48) -> list[Sample]:
    at = np.cumsum([100.0, *gaps])
    return [Sample(float(t), 7.0 + sent * k, size, 40 + k) for k, t in enumerate(at)]


# Links.


def test_an_even_stream_has_no_jitter() -> None:
    found = links.stream(samples([0.004] * 500), 250.0, True)
    assert found.count == 501 and found.lost == 0
    assert found.hz == pytest.approx(250.0) and found.kbps == pytest.approx(96.0)
    assert found.jitter_ms == pytest.approx(0.0, abs=1e-6) and found.late_ms == pytest.approx(0.0, abs=1e-6)


def test_jitter_is_that_of_rfc_3550() -> None:
    """With a transit that alternates by D, J comes to D; one late packet alone adds D / 16 twice, a little decayed."""
    assert links.jitter(samples([0.005, 0.003] * 200)) == pytest.approx(0.001, rel=1e-6)
    once = links.jitter(samples([0.004, 0.006, 0.002]))
    assert once == pytest.approx(0.002 / 16 * (1 + 15 / 16))


def test_jitter_knows_when_a_packet_was_sent() -> None:
    assert links.jitter(samples([0.02] * 50, sent=0.02)) == pytest.approx(0.0, abs=1e-9)


def test_the_late_percentile_is_off_the_nominal_interval() -> None:
    gaps = [0.004] * 95 + [0.009] * 5
    assert links.stream(samples(gaps), 250.0, False).late_ms == pytest.approx(5.0)


def test_what_is_lost_is_counted_by_numbers() -> None:
    assert links.lost([250, 251, 255, 0, 1, 3], 256) == 3 + 1
    assert links.lost([5, 6, 9, 8, 10]) == 1, "7 is missing; 8 came late, but came"
    assert links.lost([]) == 0


def test_a_stream_of_one_is_none() -> None:
    with pytest.raises(Stale, match="250 Hz"):
        links.stream(samples([]), 250.0, False)


# The round trip.


def test_each_move_has_the_first_that_shows_it() -> None:
    moved = [Stick(1.0, 1501), Stick(1.02, 1502), Stick(1.04, 1503)]
    seen = [Stick(0.9, 1501), Stick(1.001, 1501), Stick(1.021, 1501), Stick(1.025, 1502), Stick(1.03, 1502)]
    assert effects(moved, seen) == pytest.approx([0.001, 0.005])


def test_a_stick_that_comes_again_later_is_no_effect() -> None:
    assert effects([Stick(1.0, 1501)], [Stick(9.0, 1501)]) == []


def test_a_spread_is_in_microseconds() -> None:
    found = spread(k * 1e-6 for k in range(1, 102))
    assert found.count == 101 and len(found.times) == 101
    assert [found.median, found.mean, found.p99, found.most] == pytest.approx([51.0, 51.0, 100.0, 101.0])


@pytest.mark.parametrize("pwm", [1300, 1499, 1500, 1501, 1700])
def test_the_controllers_output_tells_the_stick(pwm: int) -> None:
    full = math.radians(220.0)
    rates = np.array([np.float32((pwm - 1500) / 500.0 * full), 0.0, 0.0])
    output = Echo().update(State(), Reference("rates", rates=rates))
    assert stick_of(float(output.rates[0]), full) == pwm


def test_the_echo_fails_as_it_is_told_and_on_a_full_stick_only(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr("tests.bench.controllers.echo.time.sleep", slept.append)
    echo, away, reference = Echo(), State(sticks=np.array([0.0, 0.0, 0.5, 1.0])), Reference("rates")
    echo.tune("fails", RAISES)
    assert np.isfinite(echo.update(State(), reference).rates).all()
    with pytest.raises(RuntimeError):
        echo.update(away, reference)
    echo.tune("fails", HANGS)
    echo.update(away, reference)
    assert slept and slept[0] > 1.0
    echo.tune("fails", IS_NOT_FINITE)
    assert math.isnan(echo.update(away, reference).rates[0]) and np.isfinite(reference.rates).all()


def test_a_spread_of_nothing_is_none() -> None:
    with pytest.raises(Stale):
        spread([])


# Clock, processor.


def test_the_ratio_of_two_clocks() -> None:
    theirs = [12.0 + 0.02 * k for k in range(200)]
    assert clock.ratio([3.0 + 1.0001 * (t - 12.0) for t in theirs], theirs) == pytest.approx(1.0001, abs=1e-9)


def test_processor_time_is_told_by_name() -> None:
    assert cpu.percent({"a": 1.0, "b": 0.0}, {"a": 1.5, "b": 2.0}, 10.0) == {"a": pytest.approx(5), "b": 20.0}
    assert cpu.Cpu({}, 2000, 1, 8.0, 0.0).missed == 0.0005 and cpu.Cpu({}, 0, 0, 8.0, 0.0).missed == 0.0


def test_a_busy_process_uses_the_processor() -> None:
    work = "import sys, time\nwhile time.process_time() < 0.3: pass\nprint(flush=True)\nsys.stdin.read()"
    process = subprocess.Popen([sys.executable, "-c", work], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with process:
        assert process.stdout is not None
        process.stdout.readline()
        assert cpu_seconds(process.pid) >= 0.25
        assert process.pid in children(os.getpid())
        process.communicate()
    assert cpu_seconds(process.pid) == 0.0, "it is gone"


# Tracking.


def test_the_lemniscate_is_one_smooth_motion_from_rest_to_rest() -> None:
    seconds, centre = 30.0, np.array([1.0, 2.0, -10.0])
    times = np.arange(0.0, seconds, 1e-3)
    points = [flight.lemniscate(float(t), seconds, centre) for t in times]
    pos, vel, acc = (np.array([each[k] for each in points]) for k in range(3))
    assert np.allclose(np.diff(pos, axis=0) * 1e3, 0.5 * (vel[1:] + vel[:-1]), atol=1e-3)
    assert np.allclose(np.diff(vel, axis=0) * 1e3, 0.5 * (acc[1:] + acc[:-1]), atol=2e-2)
    for t in (0.0, seconds):
        end = flight.lemniscate(t, seconds, centre)
        assert np.allclose(end[0], centre, atol=1e-6) and np.allclose(end[1], 0.0, atol=1e-6)
    assert 4.0 < np.linalg.norm(vel, axis=1).max() < 6.0 and 4.0 < np.linalg.norm(acc, axis=1).max() < 8.0


def test_the_segment_is_the_lemniscate() -> None:
    points = flight.segment(1000.0, 20.0, np.zeros(3), 0.3)
    middle = points[len(points) // 3]
    pos, vel, _ = flight.lemniscate(middle.t - 1000.0, 20.0, np.zeros(3))
    assert middle.pos == pytest.approx(tuple(pos), abs=1e-6) and middle.vel == pytest.approx(tuple(vel), abs=1e-6)
    assert points[0].t == 1000.0 and points[-1].t == 1020.0 and {point.yaw for point in points} == {0.3}


def test_the_attitude_for_an_acceleration_points_the_thrust() -> None:
    acc, yaw = np.array([3.0, -2.0, 1.0]), 0.7
    state = State(q=tracking.attitude_for(acc, yaw))
    up = -state.rotation[:, 2]
    wanted = acc - np.array([0.0, 0.0, GRAVITY])
    assert up == pytest.approx(wanted / np.linalg.norm(wanted), abs=1e-9)
    assert state.yaw == pytest.approx(yaw, abs=1e-9)
    assert tracking.angle(state.q, -state.q) == pytest.approx(0.0, abs=1e-6), "both say the same attitude"


def test_tracking_errors_of_a_known_flight() -> None:
    """Always 0.3 m north of its place and upright: the error, and the tilt that it does not have."""
    seconds, centre = 20.0, np.array([0.0, 0.0, -10.0])
    level = np.array([1.0, 0.0, 0.0, 0.0])
    rows, tilts = [], []
    for t in np.arange(-2.0, seconds + 2.0, 0.004):
        pos, _, acc = flight.lemniscate(float(t), seconds, centre)
        rows.append((500.0 + float(t), pos + np.array([0.3, 0.0, 0.0]), level))
        if flight.BUILD_UP <= t <= seconds:
            tilts.append(math.degrees(math.atan2(math.hypot(acc[0], acc[1]), GRAVITY)))
    found = tracking.errors(rows, 500.0, seconds, centre, 0.0)
    assert found.rms == pytest.approx(0.3) and found.peak == pytest.approx(0.3)
    assert found.attitude_deg == pytest.approx(float(np.sqrt(np.mean(np.square(tilts)))), rel=0.02)
    assert found.times[0] >= flight.BUILD_UP and len(found.times) == len(found.distances) == len(found.places)
    with pytest.raises(Stale, match="nothing was heard"):
        tracking.errors(rows, 0.0, seconds, centre, 0.0)


# What is said of it.


def known() -> report.Report:
    """A report with something of everything."""
    times = spread([0.0009, 0.001, 0.0011])
    stream = links.stream(samples([0.004] * 9 + [0.005]), 250.0, True)
    flown = tracking.Errors(0.2, 0.5, 4.0, [3.0, 4.0], [0.1, 0.2], [(0.0, 1.0), (1.0, 0.0)])
    return report.Report(
        t=0.0,
        processors=2,
        loads={"links": (0.5, 0.75)},
        links=links.Links({links.SETPOINTS: stream, "RC_CHANNELS": stream}, 20.0, 1785, 3, 1.25),
        trip=Trip(times, times, times, times, times, spread([0.003])),
        handback={"hangs": Back(spread([0.034]), spread([-0.001]))},
        clock=clock.Clock([1.000001], [0.9999], [1.0], 5.0),
        cpu=cpu.Cpu({"supervisor": 16.5}, 15000, 6, 60.0, 1.5),
        tracking=tracking.Tracking({"px4": flown, "ev2": flown}, {"px4": {"text": "40 m in 50 s"}}),
        failed={"nothing": "was wrong"},
    )


def test_the_table_says_it_all() -> None:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(report.table(known()))
    text = capture.get()
    for part in (
        "lost 3 of 1785",
        "1.25 Mb/s",
        "load 0.5 to 0.8 on 2",
        "median 1000, mean 1000",
        "2000 µs on the mean",
        "worst 34.0 ms",
        "+1 ppm",
        "-100 ppm",
        "16.5 %",
        "6 of 15000 (0.040 %)",
        "1.00 of px4's",
        "40 m in 50 s",
        "failed: was wrong",
    ):
        assert part in text, f"{part!r} is not in:\n{text}"


def test_what_is_saved_can_be_read_again(tmp_path: Path) -> None:
    saved = report.save(known(), tmp_path / "out")
    assert {path.name for path in saved} == {
        "bench.json",
        "links.png",
        "trip.png",
        "clock.png",
        "tracking.png",
    }
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in saved if path.suffix == ".png")
    told = json.loads(saved[0].read_text())
    assert told["links"]["frames_lost"] == 3 and told["trip"]["back"]["times"] == [900.0, 1000.0, 1100.0]


def test_only_what_is_asked_for() -> None:
    assert chosen(None) == ("links", "trip", "clock", "cpu", "tracking")
    assert chosen("trip, links") == ("links", "trip")
    with pytest.raises(BadInput, match="no measurement 'speed'"):
        chosen("speed")


# What is started ends.


def test_processes_end_with_an_error(tmp_path: Path) -> None:
    pid = 0
    with pytest.raises(KeyboardInterrupt), Children() as processes:
        pid = processes.start("router", "router", "-l", "tcp/127.0.0.1:0").pid
        processes.check()
        raise KeyboardInterrupt
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_one_that_ends_early_is_said_with_its_last_words() -> None:
    with Children() as processes:
        pid = processes.start("router", "no-such-verb").pid
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        with pytest.raises(ZmavError, match=r"router ended with 2(.|\n)*no-such-verb"):
            processes.check()


def zmavs(token: str) -> list[int]:
    """The processes that name ``token`` on their command lines."""
    found = []
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if token in each.read_text():
                found.append(int(each.parent.name))
        except OSError:
            continue
    return found


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_quick_run(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.bench.controllers"]
    given = ["--only", "links,trip", "--quick", "-o", str(tmp_path)]
    done = subprocess.run([*command, *given], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads((tmp_path / "bench.json").read_text())
    streams = told["links"]["streams"]
    assert {"ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "RC_CHANNELS", "setpoints", "signals"} == set(streams)
    assert all(each["count"] > 10 for each in streams.values())
    assert told["trip"]["back"]["count"] > 10
    assert told["trip"]["back"]["median"] > told["trip"]["radio"]["median"] > 0.0
    assert len(told["handback"]) == 5 and all(each["told"]["count"] == 1 for each in told["handback"].values())
    assert "stick to output" in done.stdout and (tmp_path / "trip.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_whoever_is_interrupted_leaves_nothing_behind(number: int, tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "TMPDIR": str(tmp_path),
    }  # its folder is on the simulator's and the agent's command lines
    command = [sys.executable, "-m", "tests.bench.controllers", "--only", "links"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, env=environment)
    with process:
        try:
            while len(zmavs(str(tmp_path))) < 2:
                assert process.poll() is None
            process.send_signal(number)
            process.communicate(timeout=60)
        finally:
            process.kill()
    assert zmavs(str(tmp_path)) == []
    assert list(tmp_path.iterdir()) == []
