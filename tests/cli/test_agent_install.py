"""``zmav agent install`` and the verbs beside it, as far as they go without a systemd of their own to command."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from zmav import systemd
from zmav.cli import installed
from zmav.errors import BadConfig, BadInput

if TYPE_CHECKING:
    from tests.cli.conftest import Here

AGENT = """
import asyncio
import msgspec
import zmav

class Settings(msgspec.Struct, forbid_unknown_fields=True):
    colour: str = "red"

class Blinker(zmav.Agent):
    name = "blinker"
    settings_type = Settings

    async def run(self):
        await asyncio.Event().wait()
"""
HOSTILE = ("../x", "a/b", "a b", "-x", "--now", "a@b", "a.service", "A", "a\n", "ü", ".", "x" * 65)


def other_user() -> str:
    """As root, a file is loaded as another user: nobody, where that one can run this Python at all."""
    if os.geteuid() != 0:
        return "not asked for"
    them = pwd.getpwnam("nobody")
    command = [sys.executable, "-c", "import zmav.cli.agent"]
    try:
        subprocess.run(command, user=them.pw_uid, group=them.pw_gid, extra_groups=[], cwd="/", check=True)
    except (OSError, subprocess.CalledProcessError):
        return "root"
    return "nobody"


@pytest.fixture
def etc(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An /etc/zmav as deploy/install.sh makes it, on a computer without systemd."""
    top = Path(tempfile.mkdtemp(prefix="zmav-test-"))  # not tmp_path, which nobody but root could look into
    top.chmod(0o755)
    etc, unit = top / "etc", top / "zmav-agent@.service"
    (etc / "agents.d").mkdir(parents=True)
    for folder in (etc, etc / "agents.d"):
        folder.chmod(0o755)
    unit.touch()
    (etc / "vehicle.env").write_text("# comment\nZMAV_NAME=rover1\n")
    (etc / "vehicle.toml").write_text('fleet = "alpha"\n[vehicles.rover1]\nlink = "tcp:127.0.0.1:9"\n')
    monkeypatch.setattr(installed, "ETC", etc)
    monkeypatch.setattr(installed, "UNIT", unit)
    monkeypatch.setattr(installed, "USER", other_user())
    monkeypatch.setattr(sys, "dont_write_bytecode", False)  # and what it was before, at the end
    monkeypatch.setattr(systemd, "RUNS", top / "none")
    monkeypatch.setenv("PATH", str(top))  # no systemctl: this computer's own is not to be touched
    yield etc
    shutil.rmtree(top)


@pytest.fixture
def blinker(etc: Path) -> Path:
    path = etc.parent / "blinker.py"
    path.write_text(AGENT)
    return path


def files(etc: Path) -> list[str]:
    return sorted(path.name for path in (etc / "agents.d").iterdir())


def test_a_file_is_copied_with_its_settings(here: type[Here], etc: Path, blinker: Path) -> None:
    told = here()("agent", "install", str(blinker), "-o", "colour=blue", "--set", "gain=2.5")
    assert "blinker is installed: " in told.out
    assert "for alpha/rover1" in told.out
    assert "zmav agent serve blinker" in told.err
    assert files(etc) == ["blinker.py", "blinker.toml"]
    assert (etc / "agents.d" / "blinker.py").read_text() == AGENT
    found = installed.read("blinker")
    assert found == installed.Installed(
        agent="blinker.py", vehicle="rover1", fleet="alpha", options={"colour": "blue"}, set={"gain": 2.5}
    )
    assert found.what() == str(etc / "agents.d" / "blinker.py")
    here()("agent", "serve", "blinker", "--check")
    told = here()("agent", "install", str(blinker), "--as", "two", "--vehicle", "quad2", "--fleet", "beta")
    assert (installed.read("two").vehicle, installed.read("two").fleet) == ("quad2", "beta")
    assert installed.names() == ["blinker", "two"]
    assert "blinker is removed" in here()("agent", "remove", "blinker").out
    assert files(etc) == ["two.py", "two.toml"]


def test_a_named_one_takes_the_place_of_a_file(here: type[Here], etc: Path, blinker: Path) -> None:
    here()("agent", "install", str(blinker), "--as", "ev1")
    told = here()("agent", "install", "ev1", "-o", "rate_hz=100")
    assert "installed again" in told.out
    assert files(etc) == ["ev1.toml"]
    assert installed.read("ev1").options == {"rate_hz": 100}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1", "one class derived from Controller"),
        ("import nonsense_that_is_not_there", "nonsense_that_is_not_there"),
        (AGENT.replace("class Settings", "class Settings("), "SyntaxError"),
        (AGENT + "\nclass Second(Blinker):\n    name = 'second'\n", "Blinker, Second"),
        (AGENT + "\nraise SystemExit(3)\n", "ended with 3"),
        (AGENT + "\nimport os\nos.write(2, b'\\xff no camera')\nos._exit(1)\n", "no camera"),
    ],
    ids=["no agent", "import", "syntax", "two", "exit", "no text"],
)
def test_a_file_that_does_not_load_is_refused(
    here: type[Here], etc: Path, blinker: Path, text: str, words: str
) -> None:
    blinker.write_text(text)
    with pytest.raises(BadConfig, match="blinker cannot be installed") as refused:
        here()("agent", "install", str(blinker))
    assert words in str(refused.value)
    assert str(etc) not in str(refused.value)  # where it lay for the trial is nobody's business
    assert files(etc) == []


def test_settings_and_names_that_there_are_not_are_refused(here: type[Here], etc: Path, blinker: Path) -> None:
    for arguments in ((str(blinker), "-o", "size=3"), ("nonsense",), ("ev1", "-o", "nonsense=1")):
        with pytest.raises(BadConfig, match="cannot be installed"):
            here()("agent", "install", *arguments)
    with pytest.raises(BadConfig, match="No such file"):
        here()("agent", "install", str(blinker.with_name("other.py")))
    assert files(etc) == []


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_are_refused(here: type[Here], etc: Path, blinker: Path, name: str) -> None:
    with pytest.raises(BadInput, match="cannot name an installed agent"):
        here()("agent", "install", str(blinker), f"--as={name}")
    for verb in ("remove", "serve"):
        with pytest.raises(BadInput, match="cannot name an installed agent"):
            here()("agent", verb, "--", name)
    with pytest.raises(BadInput, match="cannot name an installed agent"):
        installed.unit(name)
    assert files(etc) == []


def test_a_hostile_file_name_is_refused_too(here: type[Here], etc: Path, blinker: Path) -> None:
    path = blinker.rename(blinker.with_name("my agent; reboot.py"))
    with pytest.raises(BadInput, match="cannot name an installed agent"):
        here()("agent", "install", str(path))


@pytest.mark.parametrize("agent", ["../evil.py", "/tmp/evil.py"])
def test_settings_that_lead_elsewhere_are_refused(here: type[Here], etc: Path, agent: str) -> None:
    (etc / "agents.d" / "evil.toml").write_text(f'agent = "{agent}"\nvehicle = "quad1"\n')
    with pytest.raises(BadConfig, match="beside the settings"):
        here()("agent", "serve", "evil")
    with pytest.raises(BadInput, match="no agent 'evil2' is installed; there are: evil"):
        here()("agent", "serve", "evil2")


@pytest.mark.parametrize(
    "value",
    [
        1,
        -2.5,
        True,
        "",
        'a "quoted" \\ text',
        "two\nlines\ttab",
        "\x7f\x01",
        "ü 漢 🚁",
        [1, 2],
        [],
        {"a b": [{"c": "d"}]},
    ],
)
def test_settings_are_read_as_they_were_written(etc: Path, value: Any) -> None:
    given = installed.Installed(agent="x", vehicle="quad1", options={"value": value, "odd name = [x]": 1})
    (etc / "agents.d" / "x.toml").write_text(given.text(), encoding="utf-8")
    assert installed.read("x") == given


def test_list_shows_what_is_installed_before_what_is_heard(
    here: type[Here], etc: Path, blinker: Path, net: Any
) -> None:
    here()("agent", "install", str(blinker))
    (etc / "agents.d" / "broken.toml").write_text("agent = 1\n")
    _, endpoint = net.router()
    told = here("-e", endpoint)("agent", "list", "--for", "0.1")
    lines = told.out.splitlines()
    assert lines[1].split()[:3] == ["blinker", "rover1", "blinker.py"]
    assert "systemd does not run here" in lines[1]
    assert lines[2].startswith("broken")
    rows = here("-e", endpoint)("agent", "list", "--for", "0.1", "--json").lines
    assert [row["installed"] for row in rows] == ["blinker", "broken"]


def test_without_the_unit_it_says_what_makes_it(here: type[Here], etc: Path, blinker: Path) -> None:
    installed.UNIT.unlink()
    with pytest.raises(BadConfig, match=r"sudo deploy/install\.sh"):
        here()("agent", "install", str(blinker))
    assert files(etc) == []
