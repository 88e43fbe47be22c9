"""A MAVProxy session, as a person has it: what is typed, and what it says. It knows nothing of zmav."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

PATIENCE_S = 50.0


class MavProxy:
    """Started with nothing of the user's own, no start scripts, no old logs; the end of its input ends it.

    ``master`` is its link, ``modules`` what it loads: best without consoles and maps, which need a screen, and without
    what asks the network for terrain. ``options`` are more of its own.
    """

    def __init__(self, folder: Path, master: str, modules: str, *options: str) -> None:
        self.said = ""
        self._changed = threading.Condition()
        env = {**os.environ, "HOME": str(folder), "PYTHONUNBUFFERED": "1", "TERM": "dumb"}
        command = [sys.executable, str(Path(sys.executable).with_name("mavproxy.py"))]
        command += [f"--master={master}", f"--default-modules={modules}", f"--state-basedir={folder}", *options]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=folder,
            env=env,
            text=True,
            bufsize=1,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self.said += line
                self._changed.notify_all()

    def type(self, text: str, answer: str = "") -> str:
        """Type one line; gives the first match of ``answer`` (a pattern) in what comes after."""
        assert self.process.stdin is not None
        before = len(self.said)
        self.process.stdin.write(text + "\n")
        return self.hears(answer, before) if answer else ""

    def hears(self, answer: str, before: int = 0) -> str:
        pattern = re.compile(answer)
        with self._changed:
            self._changed.wait_for(lambda: pattern.search(self.said, before), PATIENCE_S)
            found = pattern.search(self.said, before)
        assert found is not None, f"MAVProxy never said {answer!r}; it said:\n{self.said[before:][-1500:]}"
        return found.group(0)

    def set_param(self, name: str, value: float) -> None:
        """Set it, and look until MAVProxy has heard of it itself."""
        self.type(f"param set {name} {value}")
        deadline = time.monotonic() + PATIENCE_S
        while float((shown := self.type(f"param show {name}", rf"{name} +[\d.]+")).split()[-1]) != value:
            assert time.monotonic() < deadline, f"MAVProxy shows {shown}"
            time.sleep(0.05)

    def close(self) -> None:
        assert self.process.stdin is not None
        try:
            self.process.stdin.close()
            self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            self.process.wait()
            self._reader.join(PATIENCE_S)
