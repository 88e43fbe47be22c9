"""``zmav agent install`` and the verbs beside it: agents that systemd runs on this computer.

Each is ``NAME.toml`` in ``/etc/zmav/agents.d``, and ``NAME.py`` beside it where it is a file of its own; the unit
``zmav-agent@NAME`` runs 'zmav agent serve NAME'. ``deploy/install.sh`` makes the folder, the unit and its user.
"""

from __future__ import annotations

import os
import pwd
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import click
import msgspec

from zmav import systemd
from zmav.cli.common import assignments, dump, show_table
from zmav.config import load_fleet
from zmav.config.table import Table, reading, toml_value
from zmav.errors import BadConfig, BadInput
from zmav.keys import check_name

ETC = Path("/etc/zmav")
UNIT = Path("/etc/systemd/system/zmav-agent@.service")
USER = "zmav-agent"
NAME = re.compile(r"[a-z0-9_][a-z0-9_-]{0,63}\Z")
"""no path, no other unit, no option of systemctl"""
LOADS = 120.0
"""s that loading it may take, on a slow computer too"""
UNREADY = "'sudo deploy/install.sh' of a clone makes it ready, or 'sudo zmav install'"


class Installed(Table, frozen=True):
    """What stands in ``NAME.toml``."""

    agent: str
    """an agent's or a controller's name, or a Python file beside this one"""
    vehicle: str
    fleet: str = "demo"
    options: dict[str, Any] = {}  # noqa: RUF012 (msgspec copies it)
    set: dict[str, float] = {}  # noqa: RUF012
    """parameters to begin with"""

    def what(self, directory: str | None = None) -> str:
        """As 'zmav agent run' takes it."""
        return str(folder(directory) / self.agent) if self.agent.endswith(".py") else self.agent

    def text(self) -> str:
        """As TOML. JSON's values are TOML's, but for null, which no option needs, and tables."""
        lines = ["# 'zmav agent install' wrote this; after a change: systemctl restart zmav-agent@NAME"]
        lines += [f"{name} = {toml_value(getattr(self, name))}" for name in ("agent", "vehicle", "fleet")]
        for name, table in (("options", self.options), ("set", self.set)):
            lines += [f"\n[{name}]", *(f"{toml_value(key)} = {toml_value(value)}" for key, value in table.items())]
        return "\n".join(lines) + "\n"


def folder(directory: str | None = None) -> Path:
    """Where agents are installed."""
    return Path(directory) if directory else ETC / "agents.d"


def check(name: str) -> str:
    """``name`` itself where it can be an installed agent's; raises :class:`BadInput`: it names files and a unit."""
    if not NAME.match(name):
        text = f"{name!r} cannot name an installed agent: use lower-case letters, digits, '_' and '-', 64 at most"
        raise BadInput(text, field="name", value=name, expected=NAME.pattern)
    return name


def read(name: str, directory: str | None = None) -> Installed:
    """The settings of one; raises :class:`BadInput` where there is none, :class:`BadConfig` for a bad one."""
    path = folder(directory) / f"{check(name)}.toml"
    if not path.is_file():
        known = ", ".join(names(directory)) or "none"
        raise BadInput(f"no agent {name!r} is installed; there are: {known}", field="name", value=name, expected=known)
    with reading(path, "the agent's settings"):
        found = msgspec.toml.decode(path.read_bytes(), type=Installed)
        check_name(found.vehicle, "vehicle")
        check_name(found.fleet, "fleet")
        if "/" in found.agent:
            text = f"agent is {found.agent!r}; expected a name, or a file beside the settings"
            raise BadConfig(text, field="agent", value=found.agent, expected="no path")
    return found


def names(directory: str | None = None) -> list[str]:
    """The installed agents'."""
    found = folder(directory).glob("*.toml") if folder(directory).is_dir() else ()
    return sorted(path.stem for path in found if NAME.match(path.stem))


@click.command("install")
@click.argument("what", metavar="FILE|NAME")
@click.option("--as", "name", help="What to call it here.  [default: the file's name, or NAME]")
@click.option("--vehicle", help="The vehicle that it runs for.  [default: this computer's]")
@click.option("--fleet", help="Its fleet.  [default: this computer's]")
@click.option("-o", "--option", "options", multiple=True, metavar="NAME=VALUE", help="A setting (repeatable).")
@click.option("--set", "tuned", multiple=True, metavar="NAME=VALUE", help="A parameter to begin with (repeatable).")
def install(
    what: str,
    name: str | None,
    vehicle: str | None,
    fleet: str | None,
    options: tuple[str, ...],
    tuned: tuple[str, ...],
) -> None:
    """Have systemd run an agent from now on: 'sudo zmav agent install my_agent.py', 'sudo zmav agent install follower'.

    A file is copied. It is loaded once, as the user that it will run as, and refused where it holds no agent, or does
    not take the settings. One of the same name is replaced.
    """
    is_file = what.endswith(".py")
    name = check(name or (Path(what).stem if is_file else what))
    where = folder()
    if not (UNIT.is_file() and where.is_dir()):
        lacking = where if UNIT.is_file() else UNIT
        raise BadConfig(f"there is no {lacking}: {UNREADY}", field="unit", value=str(lacking), expected="a unit")
    _need_root(where)
    own = Installed(
        agent=f"{name}.py" if is_file else what,
        vehicle=check_name(vehicle or vehicle_here(), "vehicle"),
        fleet=check_name(fleet or _fleet(), "fleet"),
        options=assignments(options),
        set=assignments(tuned),
    )
    stage = Path(tempfile.mkdtemp(prefix=".new-", dir=where))
    try:
        stage.chmod(0o755)
        if is_file:
            with reading(what, "agent"):
                _write(stage / own.agent, Path(what).read_bytes())
        _write(stage / f"{name}.toml", own.text().encode())
        read(name, str(stage))
        _try(name, stage)
        replaced = (where / f"{name}.toml").exists()
        for path in stage.iterdir():
            if path.is_file():
                path.replace(where / path.name)
        if not is_file:
            (where / f"{name}.py").unlink(missing_ok=True)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    _systemctl("enable", name)
    click.echo(f"{name} is installed{' again' if replaced else ''}: {where / name}.toml, for {own.fleet}/{own.vehicle}")
    if systemd.runs():
        _systemctl("reset-failed", name, quiet=True)
        _systemctl("restart", name)
        click.echo(f"{unit(name)} is {_state(name)}")
    else:
        click.echo(f"systemd does not run here, so it was not started; 'zmav agent serve {name}' runs it", err=True)


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    path.chmod(0o644)


def _try(name: str, stage: Path) -> None:
    """Load it in a process of its own, as the user that it will run as: what a file does when loaded, root does not."""
    command = [sys.executable, "-m", "zmav", "agent", "serve", name, "--check", "--directory", str(stage)]
    who: dict[str, Any] = {}
    if os.geteuid() == 0:
        try:
            them = pwd.getpwnam(USER)
        except KeyError:
            text = f"there is no user {USER}: {UNREADY}"
            raise BadConfig(text, field="user", value=USER, expected="a user") from None
        who = {"user": them.pw_uid, "group": them.pw_gid, "extra_groups": []}
    environment = {"PATH": os.environ.get("PATH", os.defpath), "HOME": "/", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd="/", env=environment, capture_output=True, errors="replace", check=False, timeout=LOADS, **who
        )
    except subprocess.TimeoutExpired:
        text = f"{name} cannot be installed: it was not loaded within {LOADS:g} s"
        raise BadConfig(text, field="name", value=name, expected="an agent") from None
    if done.returncode != 0:
        said = done.stderr.strip().replace(f"{stage}/", "").removeprefix("zmav: ")
        text = f"{name} cannot be installed: {said or f'its process ended with {done.returncode}'}"
        raise BadConfig(text, field="name", value=name, expected="an agent")


def vehicle_here(option: str = "--vehicle") -> str:
    """This computer's, as its service is started; ``option`` names another."""
    path = ETC / "vehicle.env"
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith("ZMAV_NAME="):
                return line.partition("=")[2].strip("\"' ")
    raise BadConfig(f"give {option}: no vehicle's service is installed here", field="vehicle", expected="a name")


def _fleet() -> str:
    path = ETC / "vehicle.toml"
    return load_fleet(path).fleet if path.is_file() else "demo"


@click.command("remove")
@click.argument("name")
def remove(name: str) -> None:
    """Stop an installed agent and take it away."""
    read(name)
    _need_root(folder())
    _systemctl("disable", name)
    if systemd.runs():
        _systemctl("stop", name)
        _systemctl("reset-failed", name, quiet=True)
    for suffix in (".toml", ".py"):
        (folder() / f"{name}{suffix}").unlink(missing_ok=True)
    click.echo(f"{name} is removed")


def show(as_json: bool) -> None:
    """Print the installed agents and their units' states, where there are any."""
    rows = []
    for name in names():
        state = _state(name) if systemd.runs() else "not looked after: systemd does not run here"
        try:
            rows.append((name, read(name).vehicle, read(name).agent, state))
        except BadConfig as e:
            rows.append((name, "-", "-", str(e)))
    if as_json:
        for name, vehicle, agent, state in rows:
            click.echo(dump({"installed": name, "vehicle": vehicle, "agent": agent, "unit": state}))
    elif rows:
        show_table(("installed", "vehicle", "agent", "unit"), rows)
        click.echo()


def unit(name: str) -> str:
    """The unit that runs it."""
    return f"zmav-agent@{check(name)}.service"


def _state(name: str) -> str:
    """In words: ``active (running), 2 restarts``."""
    asked = ["show", "--property=ActiveState,SubState,NRestarts", unit(name)]
    done = subprocess.run(["systemctl", *asked], capture_output=True, text=True, check=False)
    found = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    state = f"{found.get('ActiveState', 'unknown')} ({found.get('SubState', '?')})"
    restarts = found.get("NRestarts", "0")
    return state if restarts == "0" else f"{state}, {restarts} restarts"


def _systemctl(verb: str, name: str, *, quiet: bool = False) -> None:
    program = shutil.which("systemctl")
    if program is None:
        return
    done = subprocess.run([program, verb, unit(name)], capture_output=True, text=True, check=False)
    if done.returncode != 0 and not quiet:
        why = done.stderr.strip().partition("\n")[0]
        text = f"systemctl {verb} {unit(name)} failed: {why}; 'journalctl -u {unit(name)}' shows what it said"
        raise BadConfig(text, field="unit", value=unit(name), expected="done")


def _need_root(where: Path) -> None:
    if not os.access(where, os.W_OK):
        text = f"you may not write to {where}: say it with sudo"
        raise BadConfig(text, field="directory", value=str(where), expected="root")


VERBS = (install, remove)
