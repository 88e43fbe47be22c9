"""Users' own flight stacks: found, started, watched and ended. Their place is taken by a protocol peer that flies."""

from __future__ import annotations

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.hil.conftest import MakeWorld, hil_world, peer_params
from tests.waiting import wait_until
from zmav.cli.sim.run import flown_by, stack_vehicles
from zmav.errors import BadConfig
from zmav.hil.ardupilot import JsonVehicle
from zmav.hil.binaries import Job, ardupilot_job, find_ardupilot, find_px4, px4_job
from zmav.hil.craft import craft
from zmav.hil.px4 import Px4Vehicle
from zmav.sim import Home, VehicleSpec, World
from zmav.sim.dynamics.airframe import airframe
from zmav.sim.geo import Position
from zmav.sim.spec import Stack, airframe_of


def flown(tree: Path, name: str | None = None, directory: Path | None = None, **stack: Any) -> VehicleSpec:
    kept = str(directory) if directory else None
    return VehicleSpec(name=name, stack=Stack(program=str(tree), port=0, directory=kept, **stack))


def only(world: World) -> JsonVehicle:
    vehicle = world.externals.vehicles[0]
    assert isinstance(vehicle, JsonVehicle)
    return vehicle


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


def started(directory: Path) -> Any:
    return json.loads((directory / "started.json").read_text(encoding="ascii"))


class TestFlight:
    def test_programs_of_a_tree_fly_one_a_vehicle(self, make_world: MakeWorld, tree: Path, tmp_path: Path) -> None:
        peer_params(tree, PEER_RATE=200)
        home = Home(47.0, 8.0, 400.0, 90.0)
        world = make_world(
            flown(tree, directory=tmp_path, instance=7), flown(tree, directory=tmp_path, instance=8), home=home
        )
        wait_until(lambda: all(v.ned_m[2] < -4.0 for v in world.status().vehicles))
        first, second = started(tmp_path / "quad1"), started(tmp_path / "quad2")
        assert Path(first["cwd"]) == tmp_path / "quad1"
        argv = first["argv"]
        assert argv[argv.index("--home") + 1] == "47.0000000,8.0000000,400.00,90"
        assert argv[argv.index("--sysid") + 1] == "1"
        assert "-I7" in argv and "-I8" in second["argv"]
        assert second["argv"][second["argv"].index("--sysid") + 1] == "2"
        # Ten metres to the east of the first: its home is its own start.
        assert second["argv"][second["argv"].index("--home") + 1].startswith("47.0000000,8.00013")
        assert [v.url for v in world.status().vehicles] == ["tcp:127.0.0.1:5830", "tcp:127.0.0.1:5840"]

    def test_the_frame_is_told_after_the_trees_own_defaults(
        self, make_world: MakeWorld, tree: Path, tmp_path: Path
    ) -> None:
        peer_params(tree, PEER_RATE=123, FRAME_CLASS=99)
        make_world(flown(tree, directory=tmp_path))
        log = tmp_path / "quad1/output.log"
        wait_until(lambda: b"starts with" in log.read_bytes())
        assert "'PEER_RATE': 123.0, 'FRAME_CLASS': 1.0" in log.read_text()

    def test_files_nobody_keeps_are_gone_at_the_end(self, make_world: MakeWorld, tree: Path) -> None:
        world = make_world(flown(tree))
        wait_until(lambda: world.status().vehicles[0].mode == "external")
        directory = Path(f"/proc/{world.externals.pids()['quad1']}/cwd").readlink()
        assert directory.is_dir()
        world.close()
        assert not directory.exists()


class TestEnds:
    def test_one_that_dies_is_said_and_the_others_fly_on(
        self, make_world: MakeWorld, tree: Path, tmp_path: Path
    ) -> None:
        other = tmp_path / "other"
        shutil.copytree(tree, other)
        peer_params(other, PEER_DIES=50)
        peer_params(tree, PEER_RATE=200)
        world = make_world(flown(other, "doomed"), flown(tree, "other"))
        wait_until(lambda: world.status().vehicles[1].ned_m[2] < -4.0)
        wait_until(lambda: any("doomed" in note and "exit status 3" in note for note in world.externals.notes))
        (said,) = [note for note in world.externals.notes if "has ended" in note]
        assert "peer dies as it was told" in said
        doomed, other_one = world.status().vehicles
        assert (doomed.mode, doomed.armed, doomed.failed) == ("ended", False, "exit status 3")
        assert (other_one.mode, other_one.failed) == ("external", None)

    def test_they_end_with_the_world(self, make_world: MakeWorld, tree: Path) -> None:
        world = make_world(flown(tree), flown(tree))
        wait_until(lambda: all(v.mode == "external" for v in world.status().vehicles))
        pids = list(world.externals.pids().values())
        assert all(alive(pid) for pid in pids)
        world.close()
        assert not any(alive(pid) for pid in pids)

    def test_one_that_will_not_end_is_killed(self, make_world: MakeWorld, tree: Path, tmp_path: Path) -> None:
        binary = tree / "build/sitl/bin/arducopter"
        binary.write_text("#!/bin/sh\ntrap '' TERM\necho deaf > ready\nwhile :; do sleep 0.1; done\n")
        world = make_world(flown(tree, directory=tmp_path))
        wait_until(lambda: (tmp_path / "quad1/ready").exists())
        pid = world.externals.pids()["quad1"]
        world.close()
        assert not alive(pid)

    def test_they_outlive_the_thread_that_opened_the_world(self, tree: Path) -> None:
        world = hil_world([flown(tree)], speed=float("inf"), epoch_s=0.0)
        try:
            opened, over = threading.Event(), threading.Event()

            def start() -> None:
                world.start()
                opened.set()
                over.wait()

            starter = threading.Thread(target=start)
            starter.start()
            opened.wait()
            wait_until(lambda: world.status().vehicles[0].mode == "external")  # it is to be killed with its parent
            over.set()
            starter.join()
            frames = only(world).protocol.frames
            wait_until(lambda: only(world).protocol.frames > frames + 500)
            assert world.externals.pids()
        finally:
            over.set()
            world.close()

    def test_they_end_with_a_simulator_that_is_killed(self, tree: Path, tmp_path: Path) -> None:
        code = (
            "import sys, time\n"
            "from zmav.hil.externals import Externals\n"
            "from zmav.sim import VehicleSpec, World\n"
            "from zmav.sim.spec import Stack\n"
            f"stack = Stack(program={str(tree)!r}, port=0, directory={str(tmp_path)!r})\n"
            "with World([VehicleSpec(stack=stack)], externals=Externals, epoch_s=0.0):\n"
            "    time.sleep(60)\n"
        )
        simulator = subprocess.Popen([sys.executable, "-c", code])
        try:
            file = tmp_path / "quad1/started.json"
            wait_until(lambda: file.exists() and file.read_text())
            pid = started(tmp_path / "quad1")["pid"]
            assert alive(pid)
        finally:
            simulator.send_signal(signal.SIGKILL)
            simulator.wait()
        wait_until(lambda: not alive(pid))


class TestFinding:
    def test_a_program_is_found_by_itself_and_in_its_trees(self, tree: Path) -> None:
        binary = tree / "build/sitl/bin/arducopter"
        for path in (binary, tree, tree / "build/sitl", tree / "build/sitl/bin"):
            assert find_ardupilot(path, "arducopter") == binary

    def test_px4_too(self, tmp_path: Path) -> None:
        binary = tmp_path / "build/px4_sitl_default/bin/px4"
        binary.parent.mkdir(parents=True)
        binary.write_text("#!/bin/sh\n")
        binary.chmod(0o755)
        with pytest.raises(BadConfig, match="etc, by which it starts"):
            find_px4(binary)
        (tmp_path / "build/px4_sitl_default/etc").mkdir()
        for path in (tmp_path, tmp_path / "build/px4_sitl_default", binary):
            assert find_px4(path) == binary
        link = tmp_path / "px4-1.16"
        link.symlink_to(binary)
        assert self.job(find_px4(link)).command[0] == str(binary)

    def job(self, binary: Path, frame: str = "sih") -> Job:
        return px4_job(
            binary,
            craft(frame),
            instance=3,
            sysid=4,
            home=Position(47.0, 8.0, 400.0),
            heading_deg=-90.0,
            speed=2.0,
        )

    def test_what_is_missing_is_said_before_anything_is_opened(self, tree: Path, tmp_path: Path) -> None:
        with pytest.raises(BadConfig, match=r"arduplane.*build/sitl/bin/arduplane.*waf"):
            find_ardupilot(tree, "arduplane")
        with pytest.raises(BadConfig, match=r"no px4: .*make px4_sitl_default"):
            find_px4(tmp_path)
        with pytest.raises(BadConfig, match="there is no"):
            hil_world([flown(tmp_path / "nowhere")])
        with pytest.raises(BadConfig, match="is ardurover"):
            find_ardupilot(tree / "build/sitl/bin/ardurover", "arducopter")

    def test_a_directory_that_cannot_be_made_is_said(self, tree: Path, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("")
        with pytest.raises(BadConfig, match=r"cannot be written: Not a directory"):
            ardupilot_job(
                tree / "build/sitl/bin/arducopter",
                craft("quad"),
                instance=0,
                sysid=1,
                home=Position(47.0, 8.0, 400.0),
                heading_deg=0.0,
                directory=tmp_path / "file" / "quad1",
                port=9002,
                speed=1.0,
            )

    def test_a_file_that_may_not_be_executed_is_said(self, tree: Path) -> None:
        binary = tree / "build/sitl/bin/arducopter"
        binary.chmod(stat.S_IRUSR)
        with pytest.raises(BadConfig, match="may not be executed"):
            find_ardupilot(tree, "arducopter")

    def test_a_program_that_cannot_run_is_said_with_its_reason(self, make_world: MakeWorld, tree: Path) -> None:
        (tree / "build/sitl/bin/arducopter").write_text("#!/no/such/interpreter\n")
        world = make_world(flown(tree))
        wait_until(lambda: any("has ended" in note for note in world.externals.notes))
        assert any("No such file" in note for note in world.externals.notes)

    def test_px4_is_started_with_its_instance_and_home(self, tmp_path: Path) -> None:
        job = self.job(tmp_path / "bin/px4")
        assert job.command == [str(tmp_path / "bin/px4"), "-i", "3", "-d", str(tmp_path / "etc")]
        assert job.urls == ("udpin:127.0.0.1:14543",)
        told = job.environment
        assert (told["PX4_SIM_MODEL"], told["PX4_SYS_AUTOSTART"]) == ("none_iris", "10016")
        assert (told["PX4_HOME_LAT"], told["PX4_HOME_ALT"], told["PX4_HOME_YAW"]) == ("47.0000000", "400.00", "270")
        assert (told["PX4_SIM_SPEED_FACTOR"], told["PX4_SIM_HOST_ADDR"]) == ("2", "127.0.0.1")
        # Whatever the shell has: another simulator would be started, or another computer asked.
        assert (told["PX4_SIMULATOR"], told["PX4_SIM_HOSTNAME"]) == ("", "")
        places = [(told[f"PX4_PARAM_CA_ROTOR{i}_PX"], told[f"PX4_PARAM_CA_ROTOR{i}_PY"]) for i in range(4)]
        assert places == [("0.2", "0.2"), ("-0.2", "-0.2"), ("0.2", "-0.2"), ("-0.2", "0.2")]

    def test_px4_is_told_of_a_body_that_is_not_its_own(self, tmp_path: Path) -> None:
        told = self.job(tmp_path / "bin/px4", "quad").environment
        rotors = airframe("quad").rotors
        for i, actuator in enumerate(craft("quad").px4):
            place = (told[f"PX4_PARAM_CA_ROTOR{actuator}_PX"], told[f"PX4_PARAM_CA_ROTOR{actuator}_PY"])
            assert place == (f"{rotors[i].forward_m:g}", f"{rotors[i].right_m:g}")
            # The frame that it takes this for has its first two rotors turn one way, and the others the other.
            assert (rotors[i].spin > 0) == (actuator < 2)
        # Its curve makes a throttle of a share of thrust: so what hovers is told as such a share.
        hover = airframe("quad").hover_share
        assert float(told["PX4_PARAM_THR_MDL_FAC"]) == airframe("quad").thrust_expo
        assert float(told["PX4_PARAM_MPC_THR_HOVER"]) == pytest.approx(hover, abs=0.005)
        assert float(told["PX4_PARAM_MC_ROLLRATE_K"]) < 1.0

    def test_a_directory_that_is_kept_may_be_flown_with_another_body(self, tmp_path: Path) -> None:
        quad, sih = (self.job(tmp_path / "bin/px4", frame).environment for frame in ("quad", "sih"))
        assert quad.keys() == sih.keys()
        assert (sih["PX4_PARAM_THR_MDL_FAC"], sih["PX4_PARAM_MC_ROLLRATE_K"]) == ("0", "1")

    def test_a_px4s_system_id_is_its_instance_and_one(self, tmp_path: Path) -> None:
        # Its start script sets it so, whatever the environment says.
        binary = tmp_path / "px4/bin/px4"
        binary.parent.mkdir(parents=True)
        (tmp_path / "px4/etc").mkdir()
        binary.write_text('#!/bin/sh\necho "$*" > argv\necho "$PX4_SYS_AUTOSTART" > autostart\nexec sleep 60\n')
        binary.chmod(0o755)
        stack = Stack(program=str(binary), directory=str(tmp_path))
        world = hil_world([VehicleSpec(), VehicleSpec(autopilot="px4", name="p", stack=stack)], endpoint="tcp:0")
        try:
            world.open()
            wait_until(lambda: (tmp_path / "p/autostart").exists() and (tmp_path / "p/autostart").read_text())
            assert (tmp_path / "p/argv").read_text() == f"-i 1 -d {tmp_path / 'px4/etc'}\n"
            vehicle = world.externals.vehicles[0]
            assert isinstance(vehicle, Px4Vehicle)
            assert (vehicle.sysid, vehicle.port, vehicle.urls) == (2, 4561, ("udpin:127.0.0.1:14541",))
        finally:
            world.close()
        stack = Stack(program=str(binary), instance=5)
        world = hil_world([VehicleSpec(autopilot="px4", stack=stack)])
        try:
            with pytest.raises(BadConfig, match="system id 6, not 1"):
                world.open()
        finally:
            world.close()

    def test_px4_is_started_for_no_hexarotor(self) -> None:
        spec = VehicleSpec(name="hex1", autopilot="px4", airframe="hexa", stack=Stack(program="/px4"))
        with pytest.raises(BadConfig, match="hex1: no PX4 is started for the body 'hexa'"):
            hil_world([VehicleSpec(), spec])


NOTHING: dict[str, Any] = {"px4": (), "ardupilot": None, "devices": (), "keep": None}


class TestOptions:
    def vehicles(self, given: dict[str, Any], **counts: int) -> tuple[list[VehicleSpec], dict[str, int]]:
        all_counts = {"copter": 0, "hexa": 0, "rover": 0, "plane": 0, **counts}
        return stack_vehicles(all_counts, {**NOTHING, **given}), all_counts

    def test_a_number_of_px4s_is_of_embedded_ones_and_a_path_flies_them(self) -> None:
        assert self.vehicles({"px4": ("2",)}) == ([], {"copter": 0, "hexa": 0, "rover": 0, "plane": 0, "px4": 2})
        specs, counts = self.vehicles({"px4": ("/px4", "3")})
        assert counts["px4"] == 0
        assert [(s.autopilot, s.stack and s.stack.program) for s in specs] == [("px4", "/px4")] * 3
        assert len(self.vehicles({"px4": ("/px4",)})[0]) == 1

    def test_an_ardupilot_flies_what_is_counted_and_else_what_it_is_for(self) -> None:
        specs, counts = self.vehicles({"ardupilot": "/a", "keep": "/k"}, copter=2, rover=1)
        assert [(s.autopilot, s.stack and s.stack.program, s.stack and s.stack.directory) for s in specs] == [
            ("arducopter", "/a", "/k"),
            ("arducopter", "/a", "/k"),
            ("ardurover", "/a", "/k"),
        ]
        assert not any(counts.values())
        assert [s.autopilot for s in self.vehicles({"ardupilot": "/a/ardurover"})[0]] == ["ardurover"]

    def test_a_px4_flies_a_fleet_s_px4s_and_where_it_has_none_its_copters(self) -> None:
        copter = VehicleSpec(name="a", sysid=4, start_ned_m=(1.0, 2.0, 0.0), params={"WPNAV_SPEED": 300.0})
        rover, px4 = VehicleSpec(name="r", autopilot="ardurover"), VehicleSpec(name="p", autopilot="px4")
        found, left = flown_by([copter, rover], {**NOTHING, "px4": ("/px4",)})
        assert [(s.name, s.autopilot, s.stack and s.stack.program) for s in found] == [
            ("a", "px4", "/px4"),
            ("r", "ardurover", None),
        ]
        assert (found[0].sysid, found[0].start_ned_m, found[0].params) == (4, (1.0, 2.0, 0.0), {})
        assert found[0].airframe == "quad", "the same body under another autopilot"
        assert left["px4"] == ()
        found, _ = flown_by([copter, rover], {**NOTHING, "px4": ("/px4",), "ardupilot": "/a"})
        assert [s.stack and s.stack.program for s in found] == ["/px4", "/a"]
        found, _ = flown_by([copter, px4], {**NOTHING, "px4": ("/px4",)})
        assert [(s.autopilot, s.stack is not None) for s in found] == [("arducopter", False), ("px4", True)]
        assert airframe_of(found[1]) == "sih", "PX4's own, where the file has a PX4"
        with pytest.raises(BadConfig, match="--px4 /px4"):
            flown_by([rover], {**NOTHING, "px4": ("/px4",)})

    def test_the_world_s_noise_is_theirs_but_never_none(self) -> None:
        for asked, theirs in (("none", "typical"), ("rtk", "rtk")):
            world = hil_world([VehicleSpec(stack=Stack())], noise=asked)
            try:
                assert world.externals.vehicles[0].plant.sensors.noise.name == theirs
            finally:
                world.close()

    def test_others_connect_by_a_serial_line(self) -> None:
        (spec,), _ = self.vehicles({"devices": ("/dev/ttyACM0",)})
        assert (spec.autopilot, spec.stack and spec.stack.device) == ("px4", "/dev/ttyACM0")

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"px4": ("/a", "/b")}, "one path"),
            ({"px4": ("900",)}, "at most"),
        ],
    )
    def test_what_makes_no_sense_is_said(self, given: dict[str, Any], message: str) -> None:
        with pytest.raises(BadConfig, match=message):
            self.vehicles(given)

    def test_the_command_line_says_what_is_missing(self, tmp_path: Path) -> None:
        from zmav.cli.sim import command

        result = CliRunner().invoke(command, ["--ardupilot", str(tmp_path)])
        assert isinstance(result.exception, BadConfig)
        assert "build/sitl/bin/arducopter" in str(result.exception)


def test_a_world_alone_does_not_know_what_flies_a_stack() -> None:
    with pytest.raises(BadConfig, match="quad1 has a flight stack of its own; expected externals="):
        World([VehicleSpec(stack=Stack(port=0))])
