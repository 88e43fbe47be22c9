"""``POST /camera/{vehicle}/{camera}/webrtc``: a camera's video to a browser, by WebRTC (aiortc), as the camera
encoded it.

The browser's offer comes in, our answer goes out, and the packets then go from here to it directly. Each camera is read
once for all who watch. Nothing here decodes what a vehicle sends: it is cut into RTP packets (RFC 6184), after
:func:`zmav.vision.video.nal_units` has found that it can be.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
from collections.abc import Callable
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from ground.http.gateway import Gateway
from ground.http.reply import Failure
from ground.http.sharing import Pool, Shared
from zmav import keys
from zmav.errors import BadInput, VehicleError, missing_extra
from zmav.vision.video import Packets, Unit, Units, VideoReader, video_info
from zmav.waiting import within

LONGEST_SDP = 64_000
"""characters of an offer"""
MOST_CANDIDATES = 50
"""addresses of a browser, to each of which we send when it has offered them"""
CONNECT_S = 15.0
"""s for an answer to become a connection"""
ASKED = "_send_keyframe"
"""what aiortc's sender calls for a key frame"""
Counted = Callable[[str], contextlib.AbstractContextManager[None]]
logger = logging.getLogger(__name__)


class Offer(msgspec.Struct, forbid_unknown_fields=True):
    """What a browser's RTCPeerConnection.createOffer() gave."""

    sdp: str
    type: str


class Watched(Shared[VideoReader]):
    """Its units are handed on by the reader itself."""

    kind = VideoReader


class Viewer:
    """One browser. ``run`` lasts as long as it watches."""

    def __init__(self, offer: Offer, units: Units, reader: VideoReader) -> None:
        self._offer, self._units, self._reader = offer, units, reader
        self._over = asyncio.Event()
        self._connected = asyncio.Event()
        self._peer: Any = None
        self.sent = 0

    async def answer(self) -> dict[str, str]:
        """Raises :class:`Failure` for what is no offer to take H.264, or not that alone."""
        import aiortc

        own = aiortc.RTCConfiguration(iceServers=[])  # nobody outside is asked who we are
        self._peer = peer = aiortc.RTCPeerConnection(own)
        peer.add_listener("connectionstatechange", self._on_state)
        try:
            offer = aiortc.RTCSessionDescription(self._offer.sdp, self._offer.type)
            sender = peer.addTrack(_track(self._next))
            can = aiortc.RTCRtpSender.getCapabilities("video").codecs
            (transceiver,) = peer.getTransceivers()
            transceiver.direction = "sendonly"  # what a browser would send is neither taken nor decoded
            transceiver.setCodecPreferences([each for each in can if each.mimeType == "video/H264"])
            await peer.setRemoteDescription(offer)
            if len(peer.getTransceivers()) != 1 or peer.sctp is not None:
                raise ValueError("an offer to take one video and nothing else is expected")
            await peer.setLocalDescription(await peer.createAnswer())
            # A browser that lost something asks for a key frame (PLI); aiortc would ask its own encoder, and has none.
            setattr(sender, ASKED, self._reader.ask)
        except BaseException as e:
            await self.close()
            if not isinstance(e, Exception):
                raise
            # Of aiortc, which has no error of its own for what is no SDP.
            raise Failure(400, "bad_input", f"that offer cannot be answered: {str(e) or type(e).__name__}") from e
        return {"sdp": peer.localDescription.sdp, "type": peer.localDescription.type}

    async def run(self) -> None:
        """Until the browser goes, or does not come."""
        try:
            with contextlib.suppress(asyncio.TimeoutError):
                await within(CONNECT_S, self._connected.wait())
                await self._over.wait()
        finally:
            await self.close()

    async def close(self) -> None:
        self._over.set()
        self._units.end()
        if self._peer is not None:
            await self._peer.close()

    def _on_state(self) -> None:
        state = self._peer.connectionState
        if state == "connected":
            self._connected.set()
        elif state in ("failed", "closed"):
            self._connected.set()
            self._over.set()

    async def _next(self) -> Unit:
        unit = await self._units.get()
        self.sent += 1
        return unit


def _track(following: Any) -> Any:
    """A track whose frames are encoded already: aiortc packs them into RTP and decodes nothing."""
    from aiortc.mediastreams import MediaStreamError, MediaStreamTrack

    class Passed(MediaStreamTrack):
        kind = "video"

        async def recv(self) -> Any:
            try:
                return packets.of(await following())
            except EOFError:
                raise MediaStreamError from None

    packets = Packets()
    return Passed()


class Video(Pool[Watched]):
    """Every camera whose video somebody watches, and who does."""

    def __init__(self, gateway: Gateway, counted: Counted) -> None:
        super().__init__(functools.partial(Watched, gateway.client))
        self._client, self._counted = gateway.client, counted
        self.viewers: dict[asyncio.Task[None], Viewer] = {}
        self._sent = 0
        gateway.at_end(self._close)

    async def watch(self, request: Request) -> Response:
        """A camera's video, live, by WebRTC: a browser's offer to take one video of H.264 in, the answer out.

        ``{"sdp": ..., "type": "offer"}`` as RTCPeerConnection.createOffer() gives it. Whoever may see the pictures may.
        """
        try:
            import aiortc  # noqa: F401  (whether it is there)
        except ImportError as e:
            raise Failure(501, "unsupported", missing_extra("video in the browser", "aiortc", "video").message) from e
        vehicle = keys.check_name(request.path_params["vehicle"], "vehicle")
        camera = keys.check_name(request.path_params["camera"], "camera")
        try:
            offer = msgspec.json.decode(await request.body(), type=Offer)
        except msgspec.DecodeError as e:
            raise BadInput(f"no offer: {e}", field="body", expected='{"sdp": ..., "type": "offer"}') from e
        too_long = len(offer.sdp) > LONGEST_SDP or offer.sdp.count("a=candidate:") > MOST_CANDIDATES
        # aiortc would make a transceiver, and what belongs to it, for each of its media.
        if offer.type != "offer" or too_long or sum(line.startswith("m=") for line in offer.sdp.splitlines()) > 1:
            expected = f"an offer of one video, {LONGEST_SDP} characters and {MOST_CANDIDATES} candidates at most"
            raise BadInput("no offer", field="type", value=offer.type, expected=expected)
        counted = contextlib.ExitStack()
        counted.enter_context(self._counted(request.client.host if request.client else ""))
        with counted:
            try:
                await video_info(self._client, vehicle, camera)
            except VehicleError as e:
                raise Failure(404, "not_found", e.message) from e
            shared = counted.enter_context(self.shared(vehicle, camera))
            viewer = Viewer(offer, counted.enter_context(shared.reader.units()), shared.reader)
            answer = await viewer.answer()
            task = asyncio.create_task(self._run(viewer, counted.pop_all()))
        self.viewers[task] = viewer
        task.add_done_callback(self._forget)
        return JSONResponse(answer, headers={"cache-control": "no-store"})

    @property
    def sent(self) -> int:
        """Units, to all viewers."""
        return self._sent + sum(viewer.sent for viewer in self.viewers.values())

    async def _run(self, viewer: Viewer, counted: contextlib.ExitStack) -> None:
        with counted:
            await viewer.run()

    def _forget(self, task: asyncio.Task[None]) -> None:
        self._sent += self.viewers.pop(task).sent
        if not task.cancelled() and task.exception() is not None:
            logger.error("error while sending video", exc_info=task.exception())

    def _close(self) -> None:
        for task in tuple(self.viewers):
            task.cancel()


def routes(gateway: Gateway, counted: Counted) -> list[BaseRoute]:
    """``counted``: what bounds how many look at cameras, by their addresses."""
    video = Video(gateway, counted)
    gateway.figures.update(video_viewers=lambda: len(video.viewers), video_units=lambda: video.sent)
    return [Route("/camera/{vehicle}/{camera}/webrtc", video.watch, methods=["POST"])]
