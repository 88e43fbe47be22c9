"""The mission service as ArduPilot runs it: missions, fences and rally points, each with an upload of its own.

Items overwrite the list as they arrive; what an upload that breaks off has brought stays. The vehicle asks for each
item with MISSION_REQUEST, again after a second without an answer, and gives up after eight.
Protocol: https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots.items import MISSION, Item, ItemStore
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.items import Client, ItemPart, Upload, acknowledge, read_item, send_item

WARNING, INFO = 4, 6  # MAV_SEVERITY
_GUIDED, _CHANGE_ALT = 2, 3  # "current" of an item that is not for the list


class MissionProtocol(ItemPart):
    """Serves ``stores``; ``guided(item)`` takes an item that is to be flown at once."""

    REQUEST, ASK_AGAIN_S, GIVE_UP_S = "MISSION_REQUEST", 1.0, 8.0

    def __init__(self, node: Node, stores: Sequence[ItemStore], guided: Callable[[Item], MissionResult]) -> None:
        super().__init__(node, stores)
        self._guided = guided

    # ---- downloads

    def request_list(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if kind in self._uploads:
            acknowledge(client, MissionResult.DENIED, kind)
        else:
            client.reply("MISSION_COUNT", count=len(self.stores[kind]), mission_type=kind)

    def request_item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        if kind not in self.stores:
            return
        if as_int and kind in self._uploads:
            acknowledge(client, MissionResult.DENIED, kind)
            return
        item = self.stores[kind].read(msg["seq"])
        if isinstance(item, MissionResult):
            if as_int and item is MissionResult.INVALID_SEQUENCE:
                client.reply("MISSION_COUNT", count=len(self.stores[kind]), mission_type=kind)
            acknowledge(client, item, kind)
            return
        send_item(client, item, kind, as_int=as_int)

    # ---- uploads

    def count(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if not self._may_restart(client, kind):
            return
        store, count = self.stores[kind], msg["count"]
        if count > store.most:
            acknowledge(client, MissionResult.NO_SPACE, kind)
            self._node.say(WARNING, f"Only {store.most} items are supported")
            return
        result = store.open(count)
        if result is not MissionResult.ACCEPTED:
            acknowledge(client, result, kind)
        elif count == 0:
            self._complete(client, kind)
        else:
            self.begin(client, kind, count)

    def clear_all(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if kind not in self.stores:
            acknowledge(client, MissionResult.UNSUPPORTED, kind)
            return
        # A stranger is told twice: that the upload is another's, and that nothing was cleared.
        cleared = self._may_restart(client, kind) and self.stores[kind].clear()
        acknowledge(client, MissionResult.ACCEPTED if cleared else MissionResult.ERROR, kind)

    def item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        item = read_item(msg, as_int=as_int)
        if isinstance(item, MissionResult):
            acknowledge(client, item, kind)
        elif kind == MISSION and item.current in (_GUIDED, _CHANGE_ALT):
            acknowledge(client, self._guided(item), MISSION)
        elif kind not in self.stores:
            acknowledge(client, MissionResult.UNSUPPORTED, kind)
        elif kind not in self._uploads:
            acknowledge(client, MissionResult.ERROR, kind)
        else:
            self._take(client, kind, item)

    def _take(self, client: Client, kind: int, item: Item) -> None:
        upload, store = self._uploads[kind], self.stores[kind]
        # Answers go to the link of the upload, no matter who sent the item.
        client = Client(upload.client.channel, client.sender)
        if item.seq != upload.next:
            acknowledge(client, MissionResult.INVALID_SEQUENCE, kind)
            return
        if client.sender != upload.client.sender:
            acknowledge(client, MissionResult.DENIED, kind)
            return
        # A mission grows as it comes; fences and points are put together first.
        fits = kind != MISSION or item.seq <= len(store)
        result = store.put(item, upload.last) if fits else MissionResult.ERROR
        if result is not MissionResult.ACCEPTED:
            acknowledge(client, result, kind)
            self.drop(kind)
            return
        upload.heard = self._node.brain.now
        upload.next += 1
        if upload.next > upload.last:
            del self._uploads[kind]
            self._complete(client, kind)
        else:
            self.ask(kind)

    def _may_restart(self, client: Client, kind: int) -> bool:
        """Nothing is coming in, or it comes from the one that asks now; ends it then."""
        upload = self._uploads.get(kind)
        if upload is None:
            return True
        if upload.client.sender != client.sender:
            acknowledge(client, MissionResult.DENIED, kind)
            return False
        self.drop(kind)
        return True

    def _complete(self, client: Client, kind: int) -> None:
        result = self.stores[kind].close()
        if kind == MISSION:
            client.channel.send("STATUSTEXT", severity=INFO, text="Flight plan received")
        acknowledge(client, result, kind)

    def gave_up(self, upload: Upload, kind: int) -> None:
        title = self.stores[kind].title
        upload.client.channel.send("STATUSTEXT", severity=WARNING, text=f"{title} upload timeout")
        acknowledge(upload.client, MissionResult.OPERATION_CANCELLED, kind)
