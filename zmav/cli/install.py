"""``zmav install``: deploy/install.sh, from what pip has installed."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import click

from zmav.shared import TREE, deploy

PACKAGES = ("zmav", "agents", "mesh", "ground")
BESIDE = ("pyproject.toml", "README.md", "LICENSE", "requirements.lock")


def lay_out(folder: Path) -> Path:
    """The tree that install.sh builds from, made in ``folder`` of what is installed; gives the script in it. The wheel
    that is built there is the one that was installed, byte for byte.
    """
    ours = deploy()
    shutil.copytree(ours, folder / "deploy", ignore=shutil.ignore_patterns("__pycache__"))
    for name in PACKAGES:
        shutil.copytree(TREE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in BESIDE:
        shutil.copy2(ours.parent / name, folder / name)
    return folder / "deploy" / "install.sh"


@click.command(
    "install", context_settings={"ignore_unknown_options": True, "help_option_names": []}, add_help_option=False
)
@click.argument("options", nargs=-1, type=click.UNPROCESSED)
def command(options: tuple[str, ...]) -> None:
    """Make this computer a vehicle's: 'sudo zmav install --name quad1', as 'sudo deploy/install.sh' of a clone does.

    'zmav install --help' lists the options; docs/install.md is the guide. It makes an environment of its own, of the
    version that says this, with packages as requirements.lock has them; the one it is started from is not needed then.
    """
    with tempfile.TemporaryDirectory(prefix="zmav-install-") as folder:
        script = lay_out(Path(folder))
        told = {**os.environ, "ZMAV_INSTALLER": "zmav install"}  # what it calls itself
        # Ctrl-C and a lost terminal reach the script, which knows when it may end: nobody kills it half switched.
        heard = [each for each in (signal.SIGINT, signal.SIGHUP) if signal.getsignal(each) is not signal.SIG_IGN]
        before = {each: signal.signal(each, lambda *_: None) for each in heard}
        try:
            done = subprocess.run(["bash", str(script), *options], env=told, check=False)
        finally:
            for each, handler in before.items():
                signal.signal(each, handler)
    sys.exit(done.returncode if done.returncode >= 0 else 128 - done.returncode)
