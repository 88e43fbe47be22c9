"""Draws the demos' pictures for the documents, by flying them: 'python deploy/demos/pictures.py' (some minutes)."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"
PICTURES = {"swap": "tracks.gif", "lost-link": "tracks.png", "follow": "tracks.png"}
"""demo -> which of its pictures"""


def main() -> int:
    for name, picture in PICTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "zmav", "demo", name, "--headless", "--out", folder]
            code = subprocess.run([*command, *(["--animation"] if picture.endswith(".gif") else [])]).returncode
            if code != 0:
                return code
            shutil.copyfile(Path(folder) / picture, DOCS / f"demo-{name}{Path(picture).suffix}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
