"""What the mission services of all autopilots share: items in and out of messages, and answers to who asked.

Protocol: https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import msgspec

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots.items import LOCATED, Item, ItemStore, check_place
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Answer, Channel, Part, Sender

_E7 = 1e7
_INT32 = 2**31 - 1
# Of a message, and what an item calls it; but for the place, which is degrees in one of the two messages.
_FIELDS = {name: name for name in ("seq", "frame", "command", "current", "autocontinue", "z")}
_FIELDS |= {f"param{i}": f"p{i}" for i in range(1, 5)}


class Client(msgspec.Struct, frozen=True):
    """Who takes part in a transfer: a system and component, behind one link."""

    channel: Channel
    sender: Sender

    def reply(self, name: str, **fields: Any) -> None:
        self.channel.send(name, target_system=self.sender[0], target_component=self.sender[1], **fields)


class Upload(msgspec.Struct):
    """One that comes in: the ``next`` item that is asked for, and the ``last``; when something was heard and asked."""

    client: Client
    next: int
    last: int
    heard: float
    asked: float


Service = Callable[[Client, int, dict[str, Any]], None]
"""Answers a client about the kind of list that its message names"""


class ItemPart(Part):
    """A mission service over some lists of items; subclasses are the autopilots' ways with it."""

    REQUEST: ClassVar[str]
    """how it asks for an item"""
    ASK_AGAIN_S: ClassVar[float]
    GIVE_UP_S: ClassVar[float]

    def __init__(self, node: Node, stores: Sequence[ItemStore]) -> None:
        self._node = node
        self.stores = {store.kind: store for store in stores}
        self._uploads: dict[int, Upload] = {}

    def answers(self) -> Mapping[str, Answer]:
        return {
            "MISSION_REQUEST_LIST": self._known(self.request_list),
            "MISSION_REQUEST": _read(lambda *asked: self.request_item(*asked, as_int=False)),
            "MISSION_REQUEST_INT": _read(lambda *asked: self.request_item(*asked, as_int=True)),
            "MISSION_COUNT": self._known(self.count),
            "MISSION_ITEM": _read(lambda *asked: self.item(*asked, as_int=False)),
            "MISSION_ITEM_INT": _read(lambda *asked: self.item(*asked, as_int=True)),
            "MISSION_WRITE_PARTIAL_LIST": _read(
                lambda client, kind, msg: acknowledge(client, MissionResult.UNSUPPORTED, kind)
            ),
            "MISSION_CLEAR_ALL": _read(self.clear_all),
            "MISSION_ACK": _read(self.ack),
        }

    def _known(self, service: Service) -> Answer:
        """Unsupported is a kind of list that there is not."""

        def check(client: Client, kind: int, msg: dict[str, Any]) -> None:
            if kind in self.stores:
                service(client, kind, msg)
            else:
                acknowledge(client, MissionResult.UNSUPPORTED, kind)

        return _read(check)

    @abstractmethod
    def request_list(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        """Somebody wants to know how many items there are."""

    @abstractmethod
    def request_item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        """Somebody wants one of them; ``kind`` may be unknown."""

    @abstractmethod
    def count(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        """Somebody wants to upload so many."""

    @abstractmethod
    def item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        """One of them arrives; ``kind`` may be unknown."""

    @abstractmethod
    def clear_all(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        """Somebody wants them gone; ``kind`` may be unknown."""

    @abstractmethod
    def gave_up(self, upload: Upload, kind: int) -> None:
        """An upload broke off: say so."""

    def begin(self, client: Client, kind: int, count: int) -> None:
        """Ask for the items of a new list, one after the other."""
        now = self._node.brain.now
        self._uploads[kind] = Upload(client, 0, count - 1, now, now)
        self.ask(kind)

    def ask(self, kind: int) -> None:
        upload = self._uploads[kind]
        upload.asked = self._node.brain.now
        upload.client.reply(self.REQUEST, seq=upload.next, mission_type=kind)

    def drop(self, kind: int) -> None:
        """End an upload; what it has brought is the list's affair."""
        del self._uploads[kind]
        self.stores[kind].abandon()

    def tick(self, now: float) -> None:
        for kind, upload in list(self._uploads.items()):
            if now - upload.heard > self.GIVE_UP_S:
                self.drop(kind)
                self.gave_up(upload, kind)
            elif now - upload.asked >= self.ASK_AGAIN_S:
                self.ask(kind)

    def closed(self, channel: Channel) -> None:
        for kind in [kind for kind, upload in self._uploads.items() if upload.client.channel is channel]:
            self.drop(kind)

    def ack(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        """A client ends a transfer; not every autopilot cares."""


def _read(service: Service) -> Answer:
    return lambda channel, msg, sender: service(Client(channel, sender), msg["mission_type"], msg)


def acknowledge(client: Client, result: int, kind: int, **more: Any) -> None:
    client.reply("MISSION_ACK", type=int(result), mission_type=kind, **more)


def send_item(client: Client, item: Item, kind: int, *, as_int: bool) -> None:
    """An item as MISSION_ITEM_INT, or as MISSION_ITEM with degrees in single precision."""
    fields = item_fields(item, kind)
    if not as_int and item.command in LOCATED:
        fields |= {"x": item.x / _E7, "y": item.y / _E7}
    client.reply("MISSION_ITEM_INT" if as_int else "MISSION_ITEM", **fields)


def item_fields(item: Item, kind: int) -> dict[str, Any]:
    """As a MISSION_ITEM_INT has them."""
    own = {field: getattr(item, name) for field, name in _FIELDS.items()}
    return {**own, "x": item.x, "y": item.y, "mission_type": kind}


def read_item(msg: dict[str, Any], *, as_int: bool) -> Item | MissionResult:
    """The item of a message; of a MISSION_ITEM the place is brought to degrees times 1e7."""
    item = Item(**{name: msg[field] for field, name in _FIELDS.items()})
    if as_int:
        return msgspec.structs.replace(item, x=msg["x"], y=msg["y"])
    scale = _E7 if item.command in LOCATED else 1.0
    x, y = msg["x"] * scale, msg["y"] * scale
    if not (math.isfinite(x) and math.isfinite(y)):
        return MissionResult.INVALID_PARAM5_X if not math.isfinite(x) else MissionResult.INVALID_PARAM6_Y
    placed = msgspec.structs.replace(item, x=_int32(x), y=_int32(y))
    bad = check_place(placed) if scale != 1.0 else MissionResult.ACCEPTED
    return placed if bad is MissionResult.ACCEPTED else bad


def _int32(value: float) -> int:
    return int(min(max(value, -_INT32), _INT32))
