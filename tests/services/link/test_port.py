"""What an intake hands to an event loop that has no time."""

from __future__ import annotations

import asyncio
import threading

from zmav.services.link.port import one_waits


async def test_the_newest_is_looked_at_once_a_busy_loop_has_time() -> None:
    seen, looked = list[int](), asyncio.Event()

    def look(what: int) -> None:
        seen.append(what)
        looked.set()

    put = one_waits(asyncio.get_running_loop(), look)
    intake = threading.Thread(target=lambda: [put(number) for number in (1, 2)])
    intake.start()
    intake.join()  # in the loop's thread: it is busy until the second has waited long enough
    await asyncio.wait_for(looked.wait(), 10.0)
    put(3)
    while len(seen) < 2:
        await asyncio.sleep(0)
    assert seen == [2, 3]
