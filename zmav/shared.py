"""The folder ``deploy``, which is in the tree and, in an installation from a wheel, among its data files."""

from __future__ import annotations

from importlib.metadata import files
from pathlib import Path

from zmav.errors import BadConfig

TREE = Path(__file__).resolve().parent.parent
MARK = "share/zmav/deploy/install.sh"
"""where a wheel puts it, behind the environment's own folder: pyproject.toml says so"""


def deploy() -> Path:
    """Where it is; what stands beside it are pyproject.toml, requirements.lock, README.md and LICENSE. Raises
    :class:`BadConfig` where there is none.
    """
    if (TREE / "deploy" / "install.sh").is_file():
        return TREE / "deploy"
    for each in files("zmav") or ():
        if each.as_posix().endswith(MARK):
            return Path(str(each.locate())).resolve().parent
    text = "zmav's data files (share/zmav) are not installed here: install its wheel with pip, or use a clone"
    raise BadConfig(text, field="deploy", value=str(TREE), expected="share/zmav/deploy")
