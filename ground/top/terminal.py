"""The terminal while the monitor has it: full screen, keys as they are pressed, given back however it ends."""

from __future__ import annotations

import asyncio
import codecs
import contextlib
import os
import signal
import termios
import tty
from collections.abc import Callable

ENTER = "\x1b[?1049h\x1b[?25l\x1b[2J"
"""the other screen, no cursor, empty"""
LEAVE = "\x1b[0m\x1b[?25h\x1b[?1049l"


SEQUENCES = {
    "[A": "up",
    "[B": "down",
    "OA": "up",
    "OB": "down",
    "[H": "home",
    "[F": "end",
    "OH": "home",
    "OF": "end",
    "[1~": "home",
    "[4~": "end",
    "[7~": "home",
    "[8~": "end",
    "[5~": "pageup",
    "[6~": "pagedown",
}
PLAIN = {"\r": "enter", "\n": "enter", "\x7f": "backspace", "\b": "backspace"}
LONGEST = 16
"""characters of a sequence that is not known, after which it is none"""


class Keyboard:
    """``feed(bytes)`` gives names (``up``, ``enter``, ``esc``...) and printable characters; others are left out.

    A terminal sends the bytes of one key at once, so an escape at the end of what was read is the escape key itself.
    """

    def __init__(self) -> None:
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")

    def feed(self, data: bytes) -> list[str]:
        text = self._decoder.decode(data)
        keys: list[str] = []
        at = 0
        while at < len(text):
            if text[at] == "\x1b":
                key, at = _escaped(text, at + 1)
            else:
                key, at = PLAIN.get(text[at], text[at]), at + 1
            if key in PLAIN.values() or len(key) > 1 or (key and key.isprintable()):
                keys.append(key)
        return keys


def _escaped(text: str, at: int) -> tuple[str, int]:
    """The key whose sequence begins behind an escape, and where the next one begins."""
    if at == len(text) or text[at] not in "[O":
        return "esc", at
    end = at + 1
    while end < len(text) and end - at < LONGEST and not ("@" <= text[end] <= "~"):
        end += 1
    return SEQUENCES.get(text[at : end + 1], ""), end + 1


def _path(fd: int) -> str:
    try:
        return os.ttyname(fd)
    except OSError:  # in some containers its name is that of a file which is not there
        return "/dev/tty"


class Terminal:
    """``async with Terminal(fd, on_key, on_resize) as terminal: terminal.show(text)``; on the event loop, main thread.

    What a slow or stopped terminal (Ctrl-S, a bad ssh) does not take at once waits, and frames that come meanwhile are
    left out: nothing else waits for it. Ctrl-Z gives it back, and ``fg`` takes it again.
    """

    def __init__(self, fd: int, on_key: Callable[[str], None], on_resize: Callable[[], None]) -> None:
        self._on_key, self._on_resize = on_key, on_resize
        self._path = _path(fd)
        self._keyboard = Keyboard()
        self._fd = -1
        self._before: list[object] = []
        self._pending = b""

    async def __aenter__(self) -> Terminal:
        # Opened again: whether it blocks is then ours alone, and not that of every program with the same terminal.
        self._fd = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._before = termios.tcgetattr(self._fd)
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGWINCH, self._on_resize)
        loop.add_signal_handler(signal.SIGTSTP, self._suspend)
        self._take()
        return self

    async def __aexit__(self, *_: object) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGWINCH, signal.SIGTSTP):
            loop.remove_signal_handler(number)
        self._give_back()
        os.close(self._fd)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and lines."""
        columns, lines = os.get_terminal_size(self._fd)
        return max(columns, 1), max(lines, 1)

    def show(self, text: str) -> bool:
        """One frame: it takes the place of what is on the screen. False: the terminal has not taken the one before."""
        if self._pending:
            return False
        self._pending = text.encode()
        self._write_on()
        return True

    def _write_on(self) -> None:
        loop = asyncio.get_running_loop()
        with contextlib.suppress(OSError):  # the terminal is gone: SIGHUP follows
            with contextlib.suppress(BlockingIOError):
                while self._pending:
                    self._pending = self._pending[os.write(self._fd, self._pending) :]
            if self._pending:
                loop.add_writer(self._fd, self._write_on)
            else:
                loop.remove_writer(self._fd)

    def _take(self) -> None:
        tty.setcbreak(self._fd, termios.TCSADRAIN)
        self._pending = b""
        self.show(ENTER)
        asyncio.get_running_loop().add_reader(self._fd, self._read)

    def _give_back(self) -> None:
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._fd)
        loop.remove_writer(self._fd)
        self._pending = b""
        with contextlib.suppress(OSError, termios.error):  # it may be gone: nobody is left to give it to
            flowing = termios.tcgetattr(self._fd)
            flowing[0] &= ~termios.IXON  # output that a Ctrl-S has stopped goes on
            termios.tcsetattr(self._fd, termios.TCSANOW, flowing)
            with contextlib.suppress(BlockingIOError):
                os.write(self._fd, LEAVE.encode())
            termios.tcsetattr(self._fd, termios.TCSANOW, self._before)  # type: ignore[arg-type]

    def _suspend(self) -> None:
        """Ctrl-Z: stop as any program does, and go on here when the shell says so."""
        self._give_back()
        loop = asyncio.get_running_loop()
        loop.remove_signal_handler(signal.SIGTSTP)  # which restores what the signal does by itself
        os.kill(os.getpid(), signal.SIGTSTP)
        loop.add_signal_handler(signal.SIGTSTP, self._suspend)
        self._take()
        self._on_resize()

    def _read(self) -> None:
        try:
            data = os.read(self._fd, 1024)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:  # hung up
            asyncio.get_running_loop().remove_reader(self._fd)
            return
        for key in self._keyboard.feed(data):
            self._on_key(key)
