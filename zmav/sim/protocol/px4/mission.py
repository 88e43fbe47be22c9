"""The mission service as PX4 runs it: one transfer at a time, items asked for again soon, and a number for each list.

Protocol: https://mavlink.io/en/services/mission.html. The vehicle asks for an item again every quarter of a second, and
gives up after five seconds; the list that was there stays then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from zmav.sim.autopilots.items import ALL, Item, Result
from zmav.sim.autopilots.px4.items import Px4Items
from zmav.sim.protocol.channel import Channel
from zmav.sim.protocol.items import Client, ItemPart, acknowledge, read_item, send_item

RETRY_S = 0.25
TIMEOUT_S = 5.0
_CRITICAL = 2


class _Upload(msgspec.Struct):
    client: Client
    kind: int
    count: int
    next: int
    heard: float
    asked: float


class Px4MissionProtocol(ItemPart):
    """Serves ``stores``; ``say(severity, text)`` speaks to ground stations, ``changed(kind)`` tells of a new list."""

    def __init__(
        self,
        stores: Sequence[Px4Items],
        say: Callable[[int, str], None],
        now: Callable[[], float],
        changed: Callable[[], None],
    ) -> None:
        super().__init__(stores)
        self._lists = {store.kind: store for store in stores}
        self._say = say
        self._now = now
        self._changed = changed
        self._upload: _Upload | None = None

    # ---- downloads

    def request_list(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if self._upload is not None:
            acknowledge(client, Result.ERROR, kind)
        else:
            items = self._lists[kind]
            client.reply("MISSION_COUNT", count=len(items), mission_type=kind, opaque_id=items.opaque_id)

    def request_item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        found = self._lists[kind].read(msg["seq"]) if kind in self._lists else Result.UNSUPPORTED
        if isinstance(found, Item):
            send_item(client, found, kind, as_int=as_int)
        else:
            acknowledge(client, found, kind)

    # ---- uploads

    def count(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        upload = self._upload
        if upload is not None and (upload.client.sender != client.sender or upload.kind != kind):
            self._say(_CRITICAL, "Mission upload busy, already receiving seq 0\t")
            acknowledge(client, Result.ERROR, kind)
            return
        result = self._lists[kind].open(msg["count"])
        if result is not Result.ACCEPTED:
            acknowledge(client, result, kind)
        elif msg["count"] == 0:
            self._finish(client, kind)
        else:
            self._upload = _Upload(client, kind, msg["count"], 0, self._now(), self._now())
            self._ask(self._upload)

    def item(self, client: Client, kind: int, msg: dict[str, Any], *, as_int: bool) -> None:
        upload = self._upload
        if upload is None or upload.client.sender != client.sender or upload.kind != kind:
            acknowledge(client, Result.ERROR, kind)
            return
        upload.heard = self._now()
        if msg["seq"] != upload.next:
            self._ask(upload)  # lost, or twice: the right one, please
            return
        item = read_item(msg, as_int=as_int)
        result = item if isinstance(item, Result) else self._lists[kind].put(item, upload.count - 1)
        if result is not Result.ACCEPTED:
            self._drop()
            acknowledge(client, result, kind)
            return
        upload.next += 1
        if upload.next < upload.count:
            self._ask(upload)
        else:
            self._upload = None
            self._finish(upload.client, kind)

    def write_partial(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        acknowledge(client, Result.UNSUPPORTED, kind)

    def clear_all(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        if self._upload is not None:
            acknowledge(client, Result.ERROR, kind)
            return
        for each in self._lists.values() if kind == ALL else filter(None, [self._lists.get(kind)]):
            each.clear()
        self._changed()
        acknowledge(client, Result.ACCEPTED if kind == ALL or kind in self._lists else Result.UNSUPPORTED, kind)

    def ack(self, client: Client, kind: int, msg: dict[str, Any]) -> None:
        """A client that breaks its upload off."""
        if self._upload is not None and self._upload.client.sender == client.sender:
            self._drop()

    def _finish(self, client: Client, kind: int) -> None:
        result = self._lists[kind].close()
        self._changed()
        acknowledge(client, result, kind, opaque_id=self._lists[kind].opaque_id)

    def _ask(self, upload: _Upload) -> None:
        upload.asked = self._now()
        upload.client.reply("MISSION_REQUEST_INT", seq=upload.next, mission_type=upload.kind)

    def _drop(self) -> None:
        if self._upload is not None:
            self._lists[self._upload.kind].abandon()
            self._upload = None

    # ---- by itself

    def tick(self, now: float) -> None:
        upload = self._upload
        if upload is None:
            return
        if now - upload.heard > TIMEOUT_S:
            self._drop()
            self._say(_CRITICAL, "Operation timeout\t")
        elif now - upload.asked >= RETRY_S:
            self._ask(upload)

    def closed(self, channel: Channel) -> None:
        if self._upload is not None and self._upload.client.channel is channel:
            self._drop()
