"""The mission service as PX4 runs it: one transfer at a time, items asked for again soon, and a number for each list.

Protocol: https://mavlink.io/en/services/mission.html. The vehicle asks for an item again every quarter of a second, and
gives up after five seconds; the list that was there stays then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots.items import ALL, Item
from zmav.sim.autopilots.px4.items import Px4Items
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.items import Client, ItemPart, Upload, acknowledge, read_item, send_item

_CRITICAL = 2


class Px4MissionProtocol(ItemPart):
    """Serves ``stores``; ``changed()`` tells of a new list."""

    REQUEST, ASK_AGAIN_S, GIVE_UP_S = "MISSION_REQUEST_INT", 0.25, 5.0

    def __init__(self, node: Node, stores: Sequence[Px4Items], changed: Callable[[], None]) -> None:
        super().__init__(node, stores)
        self._lists = {store.kind: store for store in stores}
        self._changed = changed

    # ---- downloads

    def request_list(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if self._uploads:
            acknowledge(client, MissionResult.ERROR, kind)
        else:
            items = self._lists[kind]
            client.reply("MISSION_COUNT", count=len(items), mission_type=kind, opaque_id=items.opaque_id)

    def request_item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        found = self._lists[kind].read(msg["seq"]) if kind in self._lists else MissionResult.UNSUPPORTED
        if isinstance(found, Item):
            send_item(client, found, kind, as_int=as_int)
        else:
            acknowledge(client, found, kind)

    # ---- uploads

    def count(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if self._uploads and not self._of(client, kind):
            self._node.say(_CRITICAL, "Mission upload busy, already receiving seq 0\t")
            acknowledge(client, MissionResult.ERROR, kind)
            return
        result = self._lists[kind].open(msg["count"])
        if result is not MissionResult.ACCEPTED:
            acknowledge(client, result, kind)
        elif msg["count"] == 0:
            self._finish(client, kind)
        else:
            self.begin(client, kind, msg["count"])

    def item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        if not self._of(client, kind):
            acknowledge(client, MissionResult.ERROR, kind)
            return
        upload = self._uploads[kind]
        upload.heard = self._node.brain.now
        if msg["seq"] != upload.next:
            self.ask(kind)  # lost, or twice: the right one, please
            return
        item = read_item(msg, as_int=as_int)
        result = item if isinstance(item, MissionResult) else self._lists[kind].put(item, upload.last)
        if result is not MissionResult.ACCEPTED:
            self.drop(kind)
            acknowledge(client, result, kind)
            return
        upload.next += 1
        if upload.next <= upload.last:
            self.ask(kind)
        else:
            del self._uploads[kind]
            self._finish(upload.client, kind)

    def clear_all(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if self._uploads:
            acknowledge(client, MissionResult.ERROR, kind)
            return
        for each in self._lists.values() if kind == ALL else filter(None, [self._lists.get(kind)]):
            each.clear()
        self._changed()
        acknowledge(
            client, MissionResult.ACCEPTED if kind == ALL or kind in self._lists else MissionResult.UNSUPPORTED, kind
        )

    def ack(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        """A client that breaks its upload off."""
        for each in [each for each in self._uploads if self._of(client, each)]:
            self.drop(each)

    def _of(self, client: Client, kind: int) -> bool:
        """What comes in is that kind of list, from that client."""
        return kind in self._uploads and self._uploads[kind].client.sender == client.sender

    def _finish(self, client: Client, kind: int) -> None:
        result = self._lists[kind].close()
        self._changed()
        acknowledge(client, result, kind, opaque_id=self._lists[kind].opaque_id)

    def gave_up(self, upload: Upload, kind: int) -> None:
        self._node.say(_CRITICAL, "Operation timeout\t")
