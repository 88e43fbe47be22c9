"""Waiting with a limit: a result, a timeout, an error, and a cancellation that is never swallowed."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from zmav.waiting import in_thread, together, within


async def test_a_result_an_error_and_a_timeout() -> None:
    async def give() -> int:
        await asyncio.sleep(0)
        return 7

    async def fail() -> None:
        raise KeyError("x")

    assert await within(30.0, give()) == 7
    with pytest.raises(KeyError):
        await within(30.0, fail())
    for seconds in (0.01, 0.0, -1.0):
        with pytest.raises(asyncio.TimeoutError):
            await within(seconds, asyncio.Event().wait())


async def test_what_is_there_already_needs_no_time() -> None:
    queue: asyncio.Queue[int] = asyncio.Queue()
    queue.put_nowait(3)
    assert await within(0.0, queue.get()) == 3


async def test_what_takes_too_long_is_cancelled() -> None:
    ended = asyncio.Event()

    async def linger() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()

    with pytest.raises(asyncio.TimeoutError):
        await within(0.01, linger())
    await ended.wait()
    task = asyncio.create_task(within(30.0, linger()))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    ended.clear()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await ended.wait()


@pytest.mark.parametrize("turns", range(6))
async def test_a_cancellation_at_the_same_moment_as_the_result_is_one(turns: int) -> None:
    """Whichever turn of the loop it falls on: who was told to end ends, unless it had ended before."""
    event = asyncio.Event()
    task = asyncio.create_task(within(30.0, event.wait()))
    for _ in range(3):
        await asyncio.sleep(0)
    event.set()
    for _ in range(turns):
        await asyncio.sleep(0)
    if task.cancel():
        with pytest.raises(asyncio.CancelledError):
            await task
    else:
        assert await task is True


async def test_together_ends_together() -> None:
    ended: list[str] = []

    async def linger(name: str) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            ended.append(name)

    async def fail() -> None:
        await asyncio.sleep(0)
        raise KeyError("x")

    await together()
    await together(asyncio.sleep(0), asyncio.sleep(0))
    with pytest.raises(KeyError):
        await together(linger("a"), fail(), linger("b"))
    assert sorted(ended) == ["a", "b"]
    task = asyncio.create_task(together(linger("c"), linger("d")))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert sorted(ended) == ["a", "b", "c", "d"]


async def test_what_is_closed_in_a_thread_is_closed_though_we_are_cancelled_before_one_is_free() -> None:
    free, closed = threading.Event(), threading.Event()
    loop = asyncio.get_running_loop()
    loop.set_default_executor(ThreadPoolExecutor(1))
    loop.run_in_executor(None, free.wait)
    closing = asyncio.ensure_future(in_thread(closed.set))
    await asyncio.sleep(0)
    closing.cancel()
    await asyncio.sleep(0)
    free.set()
    with pytest.raises(asyncio.CancelledError):
        await closing
    assert closed.is_set()
