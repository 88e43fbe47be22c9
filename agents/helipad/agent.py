"""``zmav agent run helipad --vehicle quad1``: looks for the pad in a camera's pictures and says where it is.

On board or on the ground alike: pictures, attitude and place come by the key space, and so do the sights go.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import statistics
import time
from collections import deque
from typing import Any, ClassVar

import msgspec
import zenoh

import zmav
from agents.helipad import Detection, Detector
from agents.helipad.geolocate import BY_SIZE, bearing, camera_height, fix, pixel, sized_plane
from agents.helipad.level import PadLevel
from agents.helipad.tracks import Place, Tracks
from zmav import geo, keys, wire
from zmav.agent import Tunable
from zmav.errors import BadInput, ZmavError
from zmav.vision.optics import Optics
from zmav.vision.poses import Pose, Poses
from zmav.vision.reader import Picture, Reader, camera_info
from zmav.vision.threads import one_thread
from zmav.waiting import together, within

ASK_AGAIN = 1.0
"""s between two questions to a camera that does not answer"""
SILENCE = 3.0
"""s without a picture after which that is said"""
WAIT = 0.25
"""s that a picture waits for the attitude of its time"""
DOUBT = 5
"""one of so many pictures with nothing in them is searched at other heights than the one that is known, too; and one of
so many in which something was found for other pads than that one
"""
SIZES, APART = 4, 0.5
"""of pictures for which there are detectors; heights of the symbol within which two sights are one"""
STALE = 1.0
"""s for which what carries the pad is carried on with its velocity"""
ATTITUDE_HZ, POSITION_HZ = 30.0, 10.0
"""at which the autopilot is asked for them"""
RECENT = 50
"""pictures of which delays and times are told"""


class HelipadSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fixed while it runs."""

    camera: str = "down"
    symbol_m: float = 0.25
    """height of the symbol"""
    target: str = ""
    """the vehicle that carries the pad, whose height is the pad's; empty: the pad is on the ground, as our home is"""
    deck_m: float = 0.0
    """m of the pad above that vehicle's reference point, or above the ground"""


class Helipad(zmav.Agent):
    """Finds a letter H in the pictures of the vehicle's camera, and says where on the ground it is,
    how sure that is, and how old.
    """

    name = "helipad"
    settings_type = HelipadSettings
    tunables: ClassVar = {
        "score": Tunable(0.0, 0.0, 1.0, "", "least score that is told of"),
        "most_hz": Tunable(50.0, 0.5, 200.0, "Hz", "pictures looked at"),
        "shift": Tunable(0.0, -0.5, 0.5, "s", "later than it says that a picture was taken, where the camera is wrong"),
    }

    def __init__(self, *args: Any, **rest: Any) -> None:
        super().__init__(*args, **rest)
        self.poses = Poses()
        self._detectors: dict[tuple[int, int], tuple[Detector, Detector, Optics]] = {}
        self._info: wire.CameraInfo | None = None
        self._last: Detection | None = None
        self._tracks = Tracks(self.settings.symbol_m)
        self._level = PadLevel()
        self._said_by = ""
        """the vehicle whose height the pad's level is said by; empty: our own home's"""
        self._delays: deque[float] = deque(maxlen=RECENT)
        self._took: deque[float] = deque(maxlen=RECENT)
        self._looked = self._seen = 0
        self._missed = 0
        """pictures in a row in which nothing was found"""
        self._sights: zenoh.Publisher | None = None

    async def run(self) -> None:
        """Until cancelled."""
        one_thread()
        key = keys.DETECTION.key(self.vehicle.fleet, self.vehicle.name, camera=self.settings.camera)
        self._sights = self.z.session.declare_publisher(key, **keys.DETECTION.publishing())
        try:
            await together(self._turns(), self._places(), self._watch())
        finally:
            self._sights.undeclare()

    async def _watch(self) -> None:
        async with Reader(self.z, self.vehicle.name, self.settings.camera, name=self.name) as pictures:
            self._info = await self._ask()
            await self._look(pictures)

    async def _ask(self) -> wire.CameraInfo:
        while True:
            try:
                return await camera_info(self.z, self.vehicle.name, self.settings.camera)
            except ZmavError as e:
                self.status("waiting", e.message)
            await asyncio.sleep(ASK_AGAIN)

    async def _look(self, pictures: Reader) -> None:
        due, silent, before = 0.0, False, b""
        while True:
            try:
                picture = await within(SILENCE, pictures.get())
            except asyncio.TimeoutError:
                silent = True
                self.status("blind", f"no picture of {self.settings.camera} for {SILENCE:g} s", **self._figures())
                continue
            if silent:  # it may be another camera by now
                silent, self._info = False, await self._ask()
                self._detectors.clear()
                self._level = PadLevel()
            if picture.jpeg == before:  # no two exposures are alike to the bit: what is seen in it is where it was then
                self.status("blind", f"{self.settings.camera} sends one picture again and again", **self._figures())
                continue
            before = picture.jpeg
            now = time.monotonic()
            if now < due:
                continue
            due = max(due + 1.0 / self["most_hz"], now)
            picture = picture._replace(t=picture.t + self["shift"])
            pose = await self._pose(picture.t)
            try:
                sight = await asyncio.to_thread(self._work, picture, pose)
            except BadInput as e:
                self.status("blind", e.message, **self._figures())
                continue
            self._tell(sight, pose)

    async def _pose(self, t: float) -> Pose | None:
        """Of the picture's time; waited for a little while the attitude of then is still on its way."""
        until = time.monotonic() + WAIT
        while (pose := self.poses.at(t)) is None and time.monotonic() < until:
            await asyncio.sleep(0.01)
        return pose

    # In a thread: OpenCV lets go of the interpreter.

    def _work(self, picture: Picture, pose: Pose | None) -> wire.Detections:
        begun = time.perf_counter()
        image = picture.decode()
        height, width = image.shape[:2]
        detector, doubting, optics = self._detector(width, height)
        said = self._plane()
        plane = None if said is None else self._level.at(picture.t, said)
        hint = _hint(optics, pose, plane)
        level = pose is None or optics.gimbal
        roll, pitch = (0.0, 0.0) if level or pose is None else (pose.roll, pose.pitch)
        found = detector.sights(image, hint, roll, pitch, near=self._last) if self._last is not None else []
        if not any(each.sure for each in found):
            # Whether the height is wrong is asked now and then: that search takes several times as long.
            doubts = hint is None or self._missed % DOUBT == DOUBT - 1
            also = self._wanted(optics, pose, plane, picture.t)
            found = (doubting if doubts else detector).sights(image, hint, roll, pitch, also=also)
        elif self._looked % DOUBT == 0:
            # Every other time by what is said: what was learned may be of something else.
            supposed = hint if self._looked // DOUBT % 2 == 0 else _hint(optics, pose, said)
            others = detector.sights(image, supposed, roll, pitch)
            found += [each for each in others if _another(each.detection, found[0].detection)]
        carrier = self._carrier(picture.t)
        places = [_place(self._located(each.detection, optics, pose, plane), carrier) for each in found]
        told = self._tracks.told(picture.t, list(zip(found, places, strict=True)))
        self._last = told[0].detection if told else None
        if told and found[told[0].number].sure and pose is not None and said is not None:
            self._learn(picture.t, told[0].detection, optics, pose, said)
            plane = self._level.at(picture.t, said)
        self._missed = 0 if told else self._missed + 1
        took = time.perf_counter() - begun
        own = self.settings
        return wire.Detections(
            t=picture.t,
            camera=own.camera,
            seq=picture.seq,
            width=width,
            height=height,
            detector=self.name,
            took=took,
            delay=time.time() - picture.t,
            found=[
                msgspec.structs.replace(
                    self._located(each.detection, optics, pose, plane), pictures=each.pictures, span=each.span
                )
                for each in told
                if each.detection.score >= self["score"]
            ],
        )

    def _learn(self, t: float, seen: Detection, optics: Optics, pose: Pose, said: float) -> None:
        """The pad's level from its size."""
        sized = sized_plane(optics, pose, seen, self.settings.symbol_m)
        if sized is not None:
            self._level.learn(t, said, sized, BY_SIZE * camera_height(optics, pose, sized))

    def _wanted(self, optics: Optics, pose: Pose | None, plane: float | None, t: float) -> list[tuple[float, float]]:
        """Pixels where something doubtful was seen before."""
        if pose is None or plane is None:
            return []
        north, east = self._carrier(t)
        seen = [pixel(optics, pose, each.north + north, each.east + east, plane) for each in self._tracks.wanted]
        return [each for each in seen if each is not None]

    def _carrier(self, t: float) -> tuple[float, float]:
        """North and east (m) of what carries the pad at ``t``; of one that is not heard now, nothing."""
        state = self.z.vehicle(self.settings.target).last_state if self.settings.target else None
        if state is None or state.local is None or state.velocity is None or abs(t - state.t) > STALE:
            return 0.0, 0.0
        return state.local[0] + (t - state.t) * state.velocity[0], state.local[1] + (t - state.t) * state.velocity[1]

    def _detector(self, width: int, height: int) -> tuple[Detector, Detector, Optics]:
        """For pictures of this size, as a camera on a narrow link sends smaller ones: one that believes the height that
        it is told, and one that does not.
        """
        known = self._detectors.get((width, height))
        if known is None:
            assert self._info is not None
            if len(self._detectors) >= SIZES:
                self._detectors.clear()
            optics = Optics.of(self._info).scaled(width, height)
            trusting, doubting = (
                Detector(optics.matrix, self.settings.symbol_m, distortion=optics.distortion, trust_height=trusts)
                for trusts in (True, False)
            )
            known = self._detectors[width, height] = (trusting, doubting, optics)
            self._last = None
        return known

    def _located(self, each: Detection, optics: Optics, pose: Pose | None, plane: float | None) -> wire.Detection:
        told = wire.Detection(
            symbol="H",
            u=each.u,
            v=each.v,
            scale_px=each.scale_px,
            heading=each.heading,
            score=each.score,
        )
        if pose is None:
            return told
        level = plane if plane is not None else pose.pos[2] + 1e-3  # nothing known: its size says how far it is
        place = fix(optics, pose, each, self.settings.symbol_m, level)
        if place is None:
            return told
        yaw = bearing(optics, pose, each, place.pos[2])
        told = msgspec.structs.replace(told, pos=place.pos, offset=place.offset, covariance=place.covariance, yaw=yaw)
        return self._on_earth(told, pose)

    def _on_earth(self, told: wire.Detection, pose: Pose) -> wire.Detection:
        """Latitude and longitude, by what the vehicle itself says of both its places."""
        state = self.vehicle.last_state
        if state is None or state.position is None or state.local is None or told.pos is None:
            return told
        off = (told.pos[0] - state.local[0], told.pos[1] - state.local[1], told.pos[2] - state.local[2])
        lat, lon, _ = geo.to_global(state.position, off)
        return msgspec.structs.replace(told, lat_deg=lat, lon_deg=lon)

    def _plane(self) -> float | None:
        """How far down the pad is said to be, m; None: not known."""
        own = self.settings
        if own.target:
            state = self.z.vehicle(own.target).last_state
            if state is not None and state.local is not None:  # old, too: it is a height
                self._said(own.target)
                return state.local[2] - float(own.deck_m)
        state = self.vehicle.last_state
        if state is None or state.local is None or state.position is None:
            return None
        self._said("")
        return state.local[2] + state.position.alt_rel - float(own.deck_m)

    def _said(self, by: str) -> None:
        """What was learned of another's word is forgotten."""
        if by != self._said_by:
            self._said_by, self._level = by, PadLevel()

    # What is said.

    def _tell(self, sight: wire.Detections, pose: Pose | None) -> None:
        self._looked += 1
        self._seen += bool(sight.found)
        sight = msgspec.structs.replace(sight, delay=time.time() - sight.t)
        self._delays.append(sight.delay)
        self._took.append(sight.took)
        if self._sights is not None:
            self.z.put(keys.DETECTION, str(self._sights.key_expr), sight, publisher=self._sights)
        state, text = "looks", "nothing"
        if pose is None:
            text = "sees pictures, but not the vehicle's attitude and place of their time"
        elif sight.found:
            state, text = "sees", f"{sight.found[0].symbol}, score {sight.found[0].score:.2f}"
        self.status(state, text, **self._figures())

    def _figures(self) -> dict[str, Any]:
        found: dict[str, Any] = {"pictures": self._looked, "with": self._seen}
        if self._delays:
            found["delay_ms"] = round(1e3 * statistics.median(self._delays), 1)
            found["took_ms"] = round(1e3 * statistics.median(self._took), 2)
        return found

    # What is heard.

    async def _turns(self) -> None:
        async with self.vehicle.stream("ATTITUDE", depth=100, hz=ATTITUDE_HZ) as attitudes:
            async for message in attitudes:
                if not self.vehicle.is_autopilot(message.sysid, message.compid):
                    continue  # on a shared radio others are heard, too
                fields = message.fields
                with contextlib.suppress(TypeError, KeyError):
                    turns = float(fields["roll"]), float(fields["pitch"]), float(fields["yaw"])
                    self.poses.turned(self.vehicle.time_of(fields), *turns)

    async def _places(self) -> None:
        """From its states, and between them from its positions, which come more often."""
        async with self.vehicle.places(POSITION_HZ, depth=50) as places:
            async for place in places:
                self.poses.was(place.t, place.pos, place.vel)


def _place(there: wire.Detection, carrier: tuple[float, float]) -> Place | None:
    """For the tracks, by what carries the pad."""
    if there.pos is None or there.covariance is None or there.yaw is None:
        return None
    deviation = math.sqrt(there.covariance[0] + there.covariance[2])
    return Place(there.pos[0] - carrier[0], there.pos[1] - carrier[1], deviation, there.yaw)


def _hint(optics: Optics, pose: Pose | None, plane: float | None) -> float | None:
    """m of the camera above the pad that the detector is told."""
    height = None if pose is None or plane is None else camera_height(optics, pose, plane)
    return height if height is not None and height > 0.1 else None


def _another(one: Detection, known: Detection) -> bool:
    return math.hypot(one.u - known.u, one.v - known.v) > APART * max(one.scale_px, known.scale_px)
