"""Waiting with a limit: a result, a timeout, an error, and a cancellation that is never swallowed."""

from __future__ import annotations

import asyncio
import gc
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from zmav.waiting import alongside, cancelled, in_thread, together, until_any, within


async def linger(ended: list[str], name: str) -> None:
    try:
        await asyncio.Event().wait()
    finally:
        await asyncio.sleep(0)
        ended.append(name)


async def fail() -> None:
    await asyncio.sleep(0)
    raise KeyError("x")


async def test_a_result_an_error_and_a_timeout() -> None:
    async def give() -> int:
        await asyncio.sleep(0)
        return 7

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

    await together()
    await together(asyncio.sleep(0), asyncio.sleep(0))
    with pytest.raises(KeyError):
        await together(linger(ended, "a"), fail(), linger(ended, "b"))
    assert sorted(ended) == ["a", "b"]
    task = asyncio.create_task(together(linger(ended, "c"), linger(ended, "d")))
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


async def test_until_any_raises_what_the_first_raised_though_another_ended_well_with_it() -> None:
    ended: list[str] = []
    await until_any(asyncio.sleep(0), linger(ended, "a"))
    assert ended == ["a"]
    with pytest.raises(KeyError):
        await until_any(asyncio.sleep(0), linger(ended, "b"), fail())
    assert ended == ["a", "b"]


async def test_until_any_that_is_cancelled_has_ended_all() -> None:
    ended: list[str] = []
    task = asyncio.create_task(until_any(linger(ended, "a"), linger(ended, "b")))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert sorted(ended) == ["a", "b"]


async def test_cancelled_ends_those_that_there_are_however_they_do() -> None:
    ended: list[str] = []
    tasks = [
        asyncio.create_task(linger(ended, "a")),
        asyncio.create_task(fail()),
        asyncio.create_task(asyncio.sleep(0)),
    ]
    await asyncio.sleep(0)
    await cancelled(None, *tasks, None)
    assert ended == ["a"]
    assert [task.done() for task in tasks] == [True, True, True]
    await cancelled(None)


async def test_what_runs_alongside_has_ended_when_the_block_raises() -> None:
    ended: list[str] = []
    with pytest.raises(ValueError, match="ours"):
        async with alongside(linger(ended, "a"), linger(ended, "b")):
            await asyncio.sleep(0)
            raise ValueError("ours")
    assert sorted(ended) == ["a", "b"]


async def test_an_error_alongside_that_nobody_looks_at_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    gc.collect()  # what an earlier test left
    caplog.clear()
    async with alongside(fail()) as (task,):
        await asyncio.wait({task})
    del task
    gc.collect()
    (record,) = caplog.records
    assert record.exc_info is not None
    assert isinstance(record.exc_info[1], KeyError)


async def test_an_error_alongside_that_is_looked_at_or_comes_of_the_end_is_not_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def fail_at_the_end() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            raise ValueError("it was cancelled")

    gc.collect()  # what an earlier test left
    caplog.clear()
    async with alongside(fail(), fail_at_the_end()) as (task, _):
        await asyncio.wait({task})
        assert isinstance(task.exception(), KeyError)
    del task, _
    gc.collect()
    assert caplog.records == []
