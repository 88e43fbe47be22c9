"""A camera for the gateway's tests: sends pictures while somebody reads them, as ``zmav camera run`` does."""

from __future__ import annotations

import threading
import time
from typing import Any

import cv2
import numpy as np
import zenoh

from zmav import keys, wire
from zmav.vision.chunks import split
from zmav.vision.opencv import encode

RED = (40, 40, 200)
"""BGR"""


class FakeCamera:
    """Lives in a thread until it is closed. ``size``: width and height of its pictures, which are one colour."""

    def __init__(
        self,
        session: zenoh.Session,
        vehicle: str = "quad1",
        camera: str = "down",
        *,
        hz: float = 10.0,
        size: tuple[int, int] = (320, 240),
        noise: bool = False,
    ) -> None:
        self.hz, self.size, self.camera = hz, size, camera
        self.state, self.text = "sending", "320x240"
        """of its status"""
        self.sends, self.speaks, self.looks = True, True, True
        """pictures; its status; what was found in each picture"""
        self.found: list[wire.Detection] = []
        self.sent = 0
        self.reports: set[str] = set()
        """who told how the pictures came"""
        self._session = session
        self._place = {"fleet": "demo", "vehicle": vehicle}
        self._jpeg = self._painted(noise)
        self._frames = session.declare_publisher(self._key(keys.FRAME), **keys.FRAME.publishing())
        self._info = session.declare_queryable(self._key(keys.CAMERA), self._answer)
        reports = keys.FRAME_REPORT.key(**self._place, camera=camera, reader="*")
        self._listener = session.declare_subscriber(reports, lambda sample: self.reports.add(str(sample.key_expr)))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        held: tuple[Any, ...] = (self._frames, self._info, self._listener)
        for each in held:
            each.undeclare()

    @property
    def length(self) -> int:
        """Bytes of each picture."""
        return len(self._jpeg)

    @property
    def watched(self) -> bool:
        """Somebody reads its pictures."""
        status: Any = self._frames.matching_status
        return bool(status.matching)

    def _key(self, channel: keys.Channel) -> str:
        return channel.key(**self._place, camera=self.camera)

    def _painted(self, noise: bool) -> bytes:
        width, height = self.size
        image = np.full((height, width, 3), RED, dtype=np.uint8)
        if noise:  # which is worth its bytes
            image = np.random.default_rng(1).integers(0, 255, (height, width, 3), dtype=np.uint8)
        cv2.circle(image, (20, 20), 10, (255, 255, 255), -1)
        return encode(image, 80)

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            width, height = self.size
            info = wire.CameraInfo(
                t=time.time(),
                camera=self.camera,
                width=width,
                height=height,
                focal=(260.0, 260.0),
                center=(width / 2, height / 2),
                rate_hz=self.hz,
            )
            query.reply(str(query.key_expr), wire.encode(info))

    def _run(self) -> None:
        told = 0.0
        while not self._stop.wait(1.0 / self.hz):
            if self.speaks and time.monotonic() - told > 0.3:
                told = time.monotonic()
                key = keys.AGENT_STATUS.key(**self._place, agent=f"camera-{self.camera}")
                about = wire.AgentStatus(t=time.time(), agent=f"camera-{self.camera}", state=self.state, text=self.text)
                self._session.put(key, wire.encode(about))
            if self.sends and self.watched:
                self._send()

    def _send(self) -> None:
        t, (width, height) = time.time(), self.size
        for chunk in split(self._jpeg, sender=7, seq=self.sent, t=t, size=self.size):
            self._frames.put(chunk)
        if self.looks:
            seen = wire.Detections(
                t=t,
                camera=self.camera,
                seq=self.sent,
                width=width,
                height=height,
                detector="helipad",
                took=0.01,
                delay=0.02,
                found=self.found,
            )
            self._session.put(self._key(keys.DETECTION), wire.encode(seen))
        self.sent += 1
