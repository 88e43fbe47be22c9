"""deploy/install.sh, run for real in a copy of this computer that is thrown away: nothing outside of it changes.

An overlay of the root file system in a mount namespace of its own. systemd does not run in it: docs/install.md tells
what was seen where it did.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
SCRIPT = ROOT / "deploy" / "install.sh"
PATIENCE_S = 280.0
NEEDED = ("unshare", "mount", "chroot", "useradd", "runuser", "flock", "systemctl")

ENTER = """
set -e
mount -t tmpfs tmpfs "$TOP"
mkdir "$TOP/upper" "$TOP/work" "$TOP/root"
mount -t overlay overlay -o "lowerdir=/,upperdir=$TOP/upper,workdir=$TOP/work" "$TOP/root"
mount --rbind /dev "$TOP/root/dev"
mount -t proc proc "$TOP/root/proc"
mount -t tmpfs tmpfs "$TOP/root/run"
mount -t tmpfs -o mode=1777 tmpfs "$TOP/root/tmp"
mkdir "$TOP/root/run/lock"
mkdir -p "$TOP/root$TREE"
mount --bind "$TREE" "$TOP/root$TREE"
names=$(cat /etc/resolv.conf 2>/dev/null || true)
rm -f "$TOP/root/etc/resolv.conf"
printf '%s\\n' "$names" >"$TOP/root/etc/resolv.conf"
(cd "$TOP/upper" && find . | sort) >"$TOP/before"
exec_in() { chroot "$TOP/root" /bin/bash -c "$1"; }
"""
"""What makes the copy; $TOP is an empty folder, $TREE the project's."""


def script(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(SCRIPT), *arguments], capture_output=True, text=True, check=False, timeout=PATIENCE_S)


def test_bash_can_read_it() -> None:
    assert subprocess.run(["bash", "-n", str(SCRIPT)], check=False).returncode == 0
    if shutil.which("shellcheck"):
        done = subprocess.run(["shellcheck", str(SCRIPT)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


def test_a_healthy_upgrade_removes_all_that_one_cut_short_has_left(tmp_path: Path) -> None:
    """The settings it would have taken back, too, in which the keys are: whatever it makes in its folder by mktemp."""
    text = SCRIPT.read_text(encoding="utf-8")
    (line,) = re.findall(r"^ *(find \"\$OPT\" .* -exec rm -rf .*)$", text, re.MULTILINE)
    left = [name.replace("XXXXXX", "a1b2c3") for name in re.findall(r'mktemp -d "\$OPT/([^"]+)"', text)]
    assert len(left) >= 2
    for name in (*left, "env-old", "env-new"):
        (tmp_path / name).mkdir()
    settings = {**os.environ, "OPT": str(tmp_path), "NEW": str(tmp_path / "env-new")}
    subprocess.run(["bash", "-c", line], check=True, env=settings)
    assert [each.name for each in tmp_path.iterdir()] == ["env-new"]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--nonsense"], 2, "there is no option --nonsense"),
        (["--name"], 1, "--name wants a value"),
        (["--purge"], 1, "--purge goes with --uninstall"),
        (["--help"], 0, "--agent-credentials DIR"),
    ],
)
def test_wrong_usage_is_told(arguments: list[str], code: int, words: str) -> None:
    done = script(*arguments)
    assert done.returncode == code
    assert words in done.stdout + done.stderr


@pytest.mark.skipif(os.geteuid() == 0, reason="runs as root")
@pytest.mark.parametrize("arguments", [[], ["--check"], ["--uninstall"]])
def test_it_needs_root_and_says_so(arguments: list[str]) -> None:
    done = script(*arguments)
    assert done.returncode == 1
    assert "needs root: sudo " in done.stderr


@pytest.fixture
def in_32_bit(tmp_path: Path) -> dict[str, str]:
    """An environment in which the system says that it is a 32-bit one, whatever its kernel."""
    real = shutil.which("getconf")
    assert real is not None
    fake = tmp_path / "bin" / "getconf"
    fake.parent.mkdir()
    fake.write_text(f'#!/bin/sh\n[ "$1" != LONG_BIT ] || {{ echo 32; exit; }}\nexec {real} "$@"\n')
    fake.chmod(0o755)
    return {**os.environ, "PATH": f"{fake.parent}:{os.environ['PATH']}"}


@pytest.mark.parametrize("arguments", [[], ["--name", "quad1"]])
def test_a_32_bit_system_is_told_in_the_first_line(arguments: list[str], in_32_bit: dict[str, str]) -> None:
    done = subprocess.run([SCRIPT, *arguments], capture_output=True, text=True, env=in_32_bit, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("install.sh: 64-bit only: ")


@pytest.mark.parametrize("target", ["demo", "test", "check"])
def test_make_tells_it_too_and_makes_no_environment(target: str, in_32_bit: dict[str, str], tmp_path: Path) -> None:
    tree = tmp_path / "tree"
    tree.mkdir()
    for name in ("Makefile", "pyproject.toml", "requirements.lock"):
        shutil.copy(ROOT / name, tree)
    command = ["make", "-C", str(tree), "--no-print-directory", target]
    done = subprocess.run(command, capture_output=True, text=True, env=in_32_bit, check=False, timeout=60)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("==> 64-bit only: ")
    assert not (tree / ".venv").exists()


def test_a_32_bit_python_will_not_do(tmp_path: Path) -> None:
    """A program of 32 bits runs on a system of 64, too."""
    fake = tmp_path / "python3"
    fake.write_text(f'#!/bin/sh\nexec {sys.executable} -c "import sys; sys.maxsize = 2**31 - 1; $2"\n')
    fake.chmod(0o755)
    shutil.copy(ROOT / "Makefile", tmp_path)
    command = ["make", "-C", str(tmp_path), ".venv/.made", f"PYTHON={fake}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert f"{fake} (Python " in done.stderr and "32-bit program, and zmav is 64-bit only" in done.stderr
    find = (
        f"sed '/^DO=do_install/,$d' {SCRIPT} >{tmp_path}/functions; . {tmp_path}/functions; PYTHON={fake} find_python"
    )
    done = subprocess.run(["bash", "-c", find], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert "zmav needs a 64-bit Python" in done.stderr


def usable_python() -> str | None:
    """A Python that has venv, and that a service's user can run."""
    for each in (Path(sys.base_prefix) / "bin" / "python3", Path("/usr/bin/python3"), Path("/usr/local/bin/python3")):
        code = "import ensurepip, venv, sys; sys.exit(sys.version_info < (3, 10))"
        try:
            subprocess.run([each, "-c", code], user=65534, group=65534, extra_groups=[], cwd="/", check=True)
        except (OSError, subprocess.CalledProcessError):
            continue
        return str(each)
    return None


class Copy:
    """Runs commands in the copy, all in one go."""

    def __init__(self, top: Path) -> None:
        self.top = top

    def run(self, text: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "TOP": str(self.top), "TREE": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
        return subprocess.run(
            ["unshare", "--mount", "--propagation", "private", "bash", "-c", ENTER + text],
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE_S,
            env=environment,
        )


@pytest.fixture
def copy(tmp_path: Path) -> Iterator[Copy]:
    if os.geteuid() != 0:
        pytest.skip("needs root")
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing:
        pytest.skip(f"there is no {', '.join(missing)} here")
    made = Copy(tmp_path)
    tried = made.run("exec_in true")
    if tried.returncode != 0:
        pytest.skip(f"no overlay of / can be made here: {tried.stderr.strip()}")
    yield made


INSTALL = """
say() { echo "## $1"; }
run() { say "$1"; shift; (cd / && exec_in "$*") 2>&1 && echo "rc 0" || echo "rc $?"; }
run install "$TREE/deploy/install.sh --python $PYTHON --name rover1 --fleet alpha --link tcp:127.0.0.1:5760"
run modes "cd /etc/zmav && stat -c '%n %U %G %a' . vehicle.toml vehicle.env agents.d credentials agent-credentials"
inside="find -H /opt/zmav ! -user root; ls -A /opt/zmav | grep -vE '^(env-|current)'"
run owners "$inside; ls -d /run/*/zmav* /run/zmav* 2>&-"
run users "id -nG zmav; id -nG zmav-agent; getent passwd zmav zmav-agent"
run linked "readlink /usr/local/bin/zmav; readlink /opt/zmav/current; ls /etc/systemd/system/multi-user.target.wants"
run program "zmav --version && cd / && runuser -u zmav -- zmav agent about ev1"
run compiled "find /opt/zmav/current/lib/python3*/site-packages/zmav -name '*.pyc' | wc -l"
run check "$TREE/deploy/install.sh --check"
run agent "zmav agent install ev1 -o rate_hz=100 && cat /etc/zmav/agents.d/ev1.toml"
run bad "echo 'link = 1' >>/etc/zmav/vehicle.toml; $TREE/deploy/install.sh --check"
run uninstall "$TREE/deploy/install.sh --uninstall"
run kept "stat -c '%n %U %a' /etc/zmav /etc/zmav/credentials; ls /etc/zmav/agents.d; getent passwd zmav"
run purge "$TREE/deploy/install.sh --uninstall --purge"
say left
(cd "$TOP/upper" && find . | sort) | diff "$TOP/before" - | sed -n 's/^> //p'
"""
OTHERS = tuple(f"./etc/{name}" for name in ("passwd", "group", "shadow", "gshadow", "subuid", "subgid", ".pwd.lock"))
"""what useradd and userdel write to, with their copies of the state before"""


@pytest.mark.slow
@pytest.mark.timeout(300)  # 15 s where nothing else wants the processors
def test_it_installs_and_leaves_nothing(copy: Copy) -> None:
    python = usable_python()
    if python is None:
        pytest.skip("no Python here that has venv and that other users can run")
    done = copy.run(f"PYTHON={python}\n{INSTALL}")
    parts = dict(part.split("\n", 1) for part in done.stdout.split("## ")[1:])
    assert len(parts) == 14, done.stdout + done.stderr

    def told(step: str, code: int = 0) -> list[str]:
        *lines, last = parts[step].rstrip("\n").split("\n")
        assert last == f"rc {code}", parts[step]
        return lines

    assert "systemd does not run here" in parts["install"]
    assert "is installed for rover1" in told("install")[-2]
    assert told("modes") == [
        ". root root 755",
        "vehicle.toml root root 644",
        "vehicle.env root root 644",
        "agents.d root root 755",
        "credentials root zmav 750",
        "agent-credentials root zmav-agent 750",
    ]
    # Nothing is left that another than root built or may write to, and no lock where anybody may put a link.
    assert told("owners", 2) == ["/run/zmav-install"]
    users = told("users")
    assert "dialout" in users[0].split()
    assert "dialout" not in users[1].split()  # the autopilot's port is not theirs
    assert all(line.endswith("/usr/sbin/nologin") for line in users[2:])
    linked = told("linked")
    assert linked[0] == "/opt/zmav/current/bin/zmav"
    assert linked[1].startswith("/opt/zmav/env-")
    assert "zmav-vehicle.service" in linked
    assert told("program")[0].startswith("zmav, version ")
    assert int(told("compiled")[0]) > 100
    assert told("check")
    assert 'agent = "ev1"' in told("agent")
    assert any(line.startswith("WRONG /etc/zmav/vehicle.toml has rover1: zmav mesh config") for line in told("bad", 1))
    told("uninstall")
    assert told("kept", 2)[:3] == ["/etc/zmav root 755", "/etc/zmav/credentials root 750", "ev1.toml"]
    told("purge")
    # What was there before and is noted here was written to: useradd's and userdel's files, and folders.
    new = [line for line in parts["left"].splitlines() if not (Path("/") / line).exists()]
    assert [line for line in new if "/.cache" not in line and not line.startswith(OTHERS)] == []


PUT = """
say() { echo "## $1"; }
run() { say "$1"; shift; (cd / && exec_in "$*") 2>&1 && echo "rc 0" || echo "rc $?"; }
# The functions of the installer, and nothing that it does by itself.
sed '/^DO=do_install/,$d' "$TREE/deploy/install.sh" >"$TOP/root/tmp/functions.sh"
exec_in 'useradd --system --user-group zmav; mkdir -p /etc/zmav/credentials /tmp/made; cd /tmp/made
    for each in ca.pem cert.pem key.pem roster.json; do echo "new $each" >$each; done
    echo precious >/etc/precious; chown zmav:zmav /etc/zmav/credentials'
put="source /tmp/functions.sh; put_credentials /tmp/made /etc/zmav/credentials zmav"
exec_in 'runuser -u zmav -- ln -s /etc/precious /etc/zmav/credentials/cert.pem'
run linked "$put"
run spared "cat /etc/precious; stat -c %U:%a /etc/precious"
exec_in 'rm /etc/zmav/credentials/cert.pem; echo old >/etc/zmav/credentials/cert.pem'
run put "$put"
run there "cd /etc/zmav/credentials; stat -c '%n %U %G %a' . *; cat cert.pem key.pem; runuser -u zmav -- cat key.pem"
run shut "runuser -u zmav -- sh -c 'echo x >/etc/zmav/credentials/x; rm -f /etc/zmav/credentials/cert.pem'"
run folder "mv /etc/zmav/credentials /etc/away; ln -s /etc/away /etc/zmav/credentials; $put"
"""


def test_credentials_are_written_where_nobody_else_can_put_a_link(copy: Copy) -> None:
    """A link of the service's user there once had root write over whatever it pointed at."""
    done = copy.run(PUT)
    parts = {part.split("\n", 1)[0]: part.split("\n")[1:-1] for part in done.stdout.split("## ")[1:]}
    assert len(parts) == 6, done.stdout + done.stderr
    assert "cert.pem is no plain file of its own" in parts["linked"][0] and parts["linked"][-1] == "rc 1"
    assert parts["spared"] == ["precious", "root:644", "rc 0"]
    assert parts["put"] == ["rc 0"]
    files = [f"{name} zmav zmav 400" for name in ("ca.pem", "cert.pem", "key.pem", "roster.json")]
    assert parts["there"] == [". root zmav 750", *files, "new cert.pem", "new key.pem", "new key.pem", "rc 0"]
    assert parts["shut"][-1] == "rc 1" and all("Permission denied" in line for line in parts["shut"][:-1])
    assert "is a link" in parts["folder"][0] and parts["folder"][-1] == "rc 1"
