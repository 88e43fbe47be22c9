"""Units of video to a file or to another program, as they are: MPEG-TS, or RTP with what describes it (SDP)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from urllib.parse import urlsplit

from zmav.errors import BadInput
from zmav.vision.video import Packets, Unit, pyav

PATIENCE_US = 5_000_000
"""for who is to take it by TCP"""
FORMATS = {"udp": "mpegts", "tcp": "mpegts", "rtp": "rtp"}
DATAGRAM = 1316
"""bytes: seven packets of MPEG-TS, as every player takes them"""


class Muxer:
    """``where``: a file's name, or ``udp://``, ``tcp://`` or ``rtp://HOST:PORT``. Raises :class:`BadInput` where it
    cannot be written; so does :meth:`add`. It blocks: a thread's.
    """

    def __init__(self, where: str, first: Unit) -> None:
        self._av, self._packets, self._where = pyav(), Packets(), where
        scheme = urlsplit(where).scheme if "://" in where else ""
        # PyAV hands options to the format only: those of a protocol go with the address.
        more = {"udp": f"pkt_size={DATAGRAM}", "tcp": f"timeout={PATIENCE_US}"}.get(scheme)
        url = f"{where}{'&' if '?' in where else '?'}{more}" if more else where
        own = {"flush_packets": "1", **({"payload_type": "96"} if scheme == "rtp" else {})}
        with self._writing():
            self._out = self._av.open(url, "w", format=FORMATS.get(scheme, "mpegts"), options=own)
            self._stream = self._out.add_mux_stream("h264", rate=30, width=first.width, height=first.height)
            self._out.start_encoding()  # writes the header: where nobody can write is found now

    def add(self, unit: Unit) -> None:
        packet = self._packets.of(unit)
        packet.stream = self._stream
        with self._writing():
            self._out.mux(packet)

    def close(self) -> None:
        """Raises :class:`BadInput` where the end could not be written."""
        with self._writing():
            self._out.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (self._av.FFmpegError, OSError, ValueError) as e:
            raise BadInput(f"{self._where}: {e}", field="to", value=self._where, expected="a place to write to") from e


def sdp(where: str) -> str:
    """What a player reads to play ``rtp://HOST:PORT`` (RFC 8866, RFC 6184). The parameter sets come with the video.
    Raises :class:`BadInput` where there is no such address.
    """
    try:
        parts = urlsplit(where)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port:
        raise BadInput(f"{where!r} is no rtp://HOST:PORT", field="to", value=where, expected="rtp://HOST:PORT")
    family = "IP6" if ":" in host else "IP4"
    lines = (
        "v=0",
        f"o=- 0 0 IN {family} {host}",
        "s=zmav",
        f"c=IN {family} {host}",
        "t=0 0",
        f"m=video {port} RTP/AVP 96",
        "a=rtpmap:96 H264/90000",
        "a=fmtp:96 packetization-mode=1",
    )
    return "\r\n".join(lines) + "\r\n"
