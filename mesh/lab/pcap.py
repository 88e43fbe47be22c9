"""Write Ethernet frames as a pcap file, which Wireshark and tcpdump read.

The classic format with nanoseconds: https://www.tcpdump.org/manpages/pcap-savefile.5.html
"""

from __future__ import annotations

import os
import struct
import time

_MAGIC_NS, _VERSION, _LONGEST, _ETHERNET = 0xA1B2_3C4D, (2, 4), 65_535, 1


class Capture:
    """A file under way; raises :class:`OSError` where it cannot be written.

    A pipe is written to as long as its reader keeps up, and never waited for: frames of the whole lab would wait, too.
    """

    def __init__(self, path: str) -> None:
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
        self._file = os.fdopen(fd, "wb")  # open until close()
        self._file.write(struct.pack("<IHHiIII", _MAGIC_NS, *_VERSION, 0, 0, _LONGEST, _ETHERNET))
        self._file.flush()
        self._epoch = time.time() - time.monotonic()
        self.failed: str | None = None
        """why nothing more is written"""

    def add(self, frame: bytes, now: float) -> None:
        """One frame, at ``now`` of :func:`time.monotonic`."""
        if self.failed is not None:
            return
        seconds, part = divmod(int((self._epoch + now) * 1e9), 1_000_000_000)
        try:
            self._file.write(struct.pack("<IIII", seconds, part, len(frame), len(frame)) + frame)
        except OSError as e:  # a full disk ends the capture and not the lab
            self.failed = e.strerror

    def close(self) -> None:
        try:
            self._file.close()
        except OSError as e:
            self.failed = self.failed or e.strerror
