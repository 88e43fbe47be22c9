"""A user's own flight stacks: found in a build tree, or as the program itself; how each is started; and one that runs
in a directory of its own, watched, until it is ended with the simulator.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import NamedTuple

from zmav import guard
from zmav.errors import BadConfig
from zmav.hil.craft import Craft
from zmav.sim.geo import Position

LOG = "output.log"
LAST_LINES, LAST_BYTES = 10, 4096


class Program:
    """``command`` run in ``directory``, with ``extra`` in its environment; what it says goes to ``output.log`` there.

    It is a process group of its own, so that a Ctrl-C at the terminal reaches the simulator alone, and it is killed by
    the kernel when the thread that started it ends: one that does nothing else than wait for it. Raises
    :class:`BadConfig` where it cannot be started.
    """

    def __init__(self, command: Sequence[str], directory: Path, extra: Mapping[str, str]) -> None:
        self.command = list(command)
        self.log = directory / LOG
        started: Future[subprocess.Popen[bytes]] = Future()
        keeper = threading.Thread(
            target=self._keep, args=(directory, extra, started), name="zmav-sim-program", daemon=True
        )
        keeper.start()
        try:
            self._process = started.result()
        except OSError as error:
            text = f"{command[0]} cannot be started in {directory}: {error.strerror}"
            raise BadConfig(text, field="program", value=command[0], expected="a program that runs") from error

    def _keep(self, directory: Path, extra: Mapping[str, str], started: Future[subprocess.Popen[bytes]]) -> None:
        """Start it, and stay until it has ended."""
        keep = [sys.executable, "-I", "-S", guard.__file__, str(os.getpid())]
        try:
            directory.mkdir(parents=True, exist_ok=True)
            with self.log.open("wb") as log:
                process = subprocess.Popen(
                    [*keep, *self.command],
                    cwd=directory,
                    env={**os.environ, **extra},
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
        except Exception as error:
            started.set_exception(error)
            return
        started.set_result(process)
        process.wait()

    @property
    def pid(self) -> int:
        return self._process.pid

    def ended(self) -> str | None:
        """How it ended; None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"

    def last_lines(self) -> str:
        """The end of what it said."""
        try:
            with self.log.open("rb") as log:
                log.seek(max(self.log.stat().st_size - LAST_BYTES, 0))
                text = log.read().decode("utf-8", "replace")
        except OSError:
            return ""
        return "\n".join(text.splitlines()[-LAST_LINES:])

    def ask(self) -> None:
        """Ask it, and what it started, to end."""
        self._signal(signal.SIGTERM)

    def stop(self, grace_s: float) -> None:
        """Kill it unless it ends within that time; returns when it has ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(grace_s)
        self._signal(signal.SIGKILL)  # whatever of its group is left
        self._process.wait()

    def _signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)


ARDUPILOT_PLACES = ("", "bin", "build/sitl/bin")
PX4_PLACES = ("", "bin", "build/px4_sitl_default/bin")
ARDUPILOT_PROGRAMS = ("arducopter", "ardurover", "arduplane")
PX4_LAST_ONBOARD = 9  # of PX4's onboard links that has a port of its own
OWN_PARAMS = "frame.parm"


class Job(NamedTuple):
    """How a flight stack is started, and where it is reached then."""

    command: list[str]
    environment: dict[str, str]
    urls: tuple[str, ...]


def find_ardupilot(path: Path, program: str) -> Path:
    """The binary ``program`` at ``path``, which is that itself, or the source or build tree that holds it.
    :class:`BadConfig` says where it was looked for.
    """
    if path.is_file() and path.name in ARDUPILOT_PROGRAMS and path.name != program:
        raise _missing(path, program, f"{path} is {path.name}")
    return _find(path, program, ARDUPILOT_PLACES, "./waf configure --board sitl && ./waf")


def find_px4(path: Path) -> Path:
    """The binary ``px4``, likewise; beside its directory there is ``etc``, whose scripts start it."""
    binary = _find(path, "px4", PX4_PLACES, "make px4_sitl_default")
    if not _px4_etc(binary).is_dir():
        raise _missing(path, "px4", f"there is {binary}, but not {_px4_etc(binary)}, by which it starts")
    return binary


def _px4_etc(binary: Path) -> Path:
    return binary.resolve().parent.parent / "etc"


def _find(path: Path, program: str, places: Sequence[str], build: str) -> Path:
    path = path.expanduser().absolute()
    if path.is_dir():
        candidates = [path / place / program for place in places]
        found = next((each for each in candidates if each.is_file()), None)
        if found is None:
            looked = ", ".join(str(each) for each in candidates)
            raise _missing(path, program, f"there is none of {looked}. Is it built ({build})?")
        path = found
    if not path.is_file():
        raise _missing(path, program, f"there is no {path}")
    if not os.access(path, os.X_OK):
        raise _missing(path, program, f"{path} may not be executed")
    return path


def _missing(path: Path, program: str, why: str) -> BadConfig:
    expected = f"{program}, or a tree that holds it"
    return BadConfig(f"no {program}: {why}", field="program", value=str(path), expected=expected)


def _above(binary: Path, folder: str) -> Path | None:
    """The nearest directory above ``binary`` that has ``folder``."""
    return next((each for each in binary.resolve().parents if (each / folder).is_dir()), None)


def ardupilot_job(
    binary: Path,
    craft: Craft,
    *,
    instance: int,
    sysid: int,
    home: Position,
    heading_deg: float,
    directory: Path,
    port: int,
    speed: float,
) -> Job:
    """Start it as instance ``-I``: MAVLink at TCP 5760+10*i, parameters from the tree's defaults where they are found,
    then from the file ``frame.parm`` in ``directory``, which is written here. ``port``: where our physics answer.
    """
    tree = _above(binary, "Tools/autotest")
    found = [tree / "Tools/autotest" / name for name in craft.defaults] if tree else []
    own = directory / OWN_PARAMS
    try:
        directory.mkdir(parents=True, exist_ok=True)
        own.write_text("".join(f"{name} {value:g}\n" for name, value in craft.params.items()), encoding="ascii")
    except OSError as error:
        text, expected = f"{own} cannot be written: {error.strerror}", "a directory that may be written to"
        raise BadConfig(text, field="directory", value=str(directory), expected=expected) from error
    defaults = [*(each for each in found if each.is_file()), own]
    command = [
        str(binary),
        *("--model", "JSON:127.0.0.1", "--sim-port-out", str(port)),
        *("--speedup", f"{speed:g}"),
        *("--home", f"{home.lat_deg:.7f},{home.lon_deg:.7f},{home.alt_amsl_m:.2f},{heading_deg % 360.0:g}"),
        *("--sysid", str(sysid)),
        f"-I{instance}",
        *("--defaults", ",".join(map(str, defaults))),
        *("--serial0", "tcp:0"),
    ]
    return Job(command, {}, (f"tcp:127.0.0.1:{5760 + 10 * instance}",))


def px4_job(
    binary: Path,
    craft: Craft,
    *,
    instance: int,
    sysid: int,
    home: Position,
    heading_deg: float,
    speed: float,
) -> Job:
    """Start it as instance ``-i``: MAVLink at UDP 14540+i and 14550. As a daemon (``-d``) it wants no terminal; it
    links ``etc`` into the directory that it is started in, and keeps its parameters and logs there.

    What its start scripts would take for another simulator is blanked, as a shell may have it set. Source: PX4,
    platforms/posix/src/px4/common/main.cpp, and in ROMFS/px4fmu_common/init.d-posix rcS and px4-rc.simulator.
    """
    if sysid != instance + 1:  # rcS sets it so, after what the environment says
        text = (
            f"PX4 of instance {instance} has system id {instance + 1}, not {sysid}: give it that, or another instance"
        )
        raise BadConfig(text, field="sysid", value=sysid, expected=str(instance + 1))
    command = [str(binary.resolve()), "-i", str(instance), "-d", str(_px4_etc(binary))]
    environment = {
        "PX4_SIM_MODEL": "none_iris",
        "PX4_SYS_AUTOSTART": str(craft.px4_airframe),
        "PX4_SIMULATOR": "",
        "PX4_SIM_HOSTNAME": "",
        "PX4_SIM_HOST_ADDR": "127.0.0.1",
        **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in craft.px4_params.items()},
        "PX4_SIM_SPEED_FACTOR": f"{speed:g}",
        "PX4_HOME_LAT": f"{home.lat_deg:.7f}",
        "PX4_HOME_LON": f"{home.lon_deg:.7f}",
        "PX4_HOME_ALT": f"{home.alt_amsl_m:.2f}",
        "PX4_HOME_YAW": f"{heading_deg % 360.0:g}",
    }
    port = 14540 + min(instance, PX4_LAST_ONBOARD)
    return Job(command, environment, (f"udpin:127.0.0.1:{port}",))
