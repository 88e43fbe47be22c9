"""Cameras and what is seen in their pictures.

A pixel (u, v) counts from the *centre* of the upper left one, u to the right and v down. Camera axes are OpenCV's: x to
the right of the picture, y down in it, z along the optical axis.
"""

from __future__ import annotations

from zmav.wire.base import Told, Vector


class CameraInfo(Told, kw_only=True):
    """What a picture's rays are made of: a pinhole with OpenCV's distortion, and how it is mounted."""

    t: float
    camera: str
    width: int
    height: int
    """pixels of the pictures that are sent"""
    focal: tuple[float, float]
    """fx, fy, in pixels of those"""
    center: tuple[float, float]
    """cx, cy"""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3"""
    mount: Vector = (0.0, 0.0, 0.0)
    """roll, pitch, yaw (rad) of the mount in the vehicle's axes, from straight down with the picture's upper edge
    toward the nose; pitch pi/2 looks ahead"""
    offset: Vector = (0.0, 0.0, 0.0)
    """m forward, right and down of the vehicle's reference point"""
    gimbal: bool = False
    """levelled: of the vehicle's attitude only the heading counts"""
    rate_hz: float
    """of pictures sent now"""
    quality: int = 0
    """of JPEG, 1 to 100"""
    source: str = ""
    """where they come from, in words"""


class FrameReport(Told, kw_only=True):
    """A reader's word on what comes of a camera's pictures; by it they are made fewer, smaller or better."""

    t: float
    seq: int
    """of the last picture that came whole"""
    whole: int
    """pictures that came whole since the last report"""
    torn: int
    """and those of which something was lost"""
    delay: float | None = None
    """s from shutter to reader, the median since the last report"""
    rate_bytes: float = 0.0
    """B/s that came"""
    most_bytes: float | None = None
    """B/s that this reader's link has for pictures; None: not known"""
    waits: bool = False
    """of video: for a key frame, without which it can show nothing"""


class VideoInfo(Told, kw_only=True):
    """A camera's video as it is sent now: H.264, passed through."""

    t: float
    camera: str
    width: int
    height: int
    """pixels; 0: nothing came of the camera yet"""
    rate_hz: float
    """access units a second, as the camera gives them"""
    rate_bytes: float
    """B/s, as the camera gives them"""
    stream: int
    streams: int
    """the one that is sent, from 1 on, of so many: the first has most bytes"""
    key_frames_only: bool = False
    """the link does not carry the whole stream"""
    lost: str = ""
    """why nothing comes of the camera at present"""
    source: str = ""
    """where it comes from, in words"""


class Detection(Told, kw_only=True):
    """A symbol in a picture and, where the vehicle's place and attitude are known, on the ground."""

    symbol: str
    u: float
    v: float
    """px: its centre"""
    scale_px: float
    """height of the symbol in the picture"""
    heading: float
    """rad, clockwise from the picture's upper edge, in [0, pi): a letter H looks the same upside down"""
    score: float
    """0 to 1"""
    pos: Vector | None = None
    """m NED about the fleet's origin"""
    offset: Vector | None = None
    """m north, east and down from the vehicle"""
    lat_deg: float | None = None
    lon_deg: float | None = None
    covariance: tuple[float, float, float] | None = None
    """m²: north-north, north-east, east-east"""
    yaw: float | None = None
    """rad from north, modulo pi"""
    pictures: int = 1
    """that it rests on: where one alone is doubtful, three or more of the last five"""
    span: float = 0.0
    """s from the first of these to this one"""


class Detections(Told, kw_only=True):
    """All that was found in one picture; an empty list says that there was nothing."""

    t: float
    """UTC seconds at the middle of the exposure"""
    camera: str
    seq: int
    width: int
    height: int
    detector: str
    """who looked: an agent's name and its host's"""
    took: float
    """s of looking"""
    delay: float
    """s from shutter to this word"""
    found: list[Detection] = []
