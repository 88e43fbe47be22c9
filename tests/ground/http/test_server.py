"""What the server adds to uvicorn's for many WebSockets of one content."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping, Sequence
from typing import Any

import pytest
from websockets.frames import Frame, Opcode

from ground.http.restws import AT_ONCE, RestClient, Text
from ground.http.server import text_frame, write_of


@pytest.mark.parametrize("size", [0, 1, 125, 126, 65_535, 65_536])
def test_a_frame_is_what_the_protocol_says(size: int) -> None:
    data = b"x" * size
    assert text_frame(data) == Frame(Opcode.TEXT, data).serialize(mask=False)


def test_a_server_without_the_extension_writes_nothing_at_once() -> None:
    assert not write_of({"type": "websocket"})([text_frame(b"{}")])
    assert not write_of({"type": "websocket", "extensions": {}})([text_frame(b"{}")])


async def test_what_is_not_taken_at_once_waits_and_nothing_overtakes_it() -> None:
    texts = [Text(b"%d" % number, b"frame %d" % number) for number in range(2 * AT_ONCE + 5)]
    written: list[Sequence[bytes]] = []
    takes = [True, False, True]

    def write(frames: Sequence[bytes]) -> bool:
        if takes.pop(0):
            written.append(frames)
            return True
        return False

    client = RestClient(frozenset(), write)
    client.take(texts)
    assert written == [[text.frame for text in texts[:AT_ONCE]]]
    assert takes == [True]  # what comes behind what waits does not even ask
    sent: list[bytes] = []
    over = asyncio.Event()

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message["text"].encode())
        if len(sent) == len(texts) - AT_ONCE:
            over.set()

    sending = asyncio.create_task(client.send(send))
    await over.wait()
    sending.cancel()
    assert sent == [text.data for text in texts[AT_ONCE:]]
