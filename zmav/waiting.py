"""Waiting on the event loop, for so long and no longer."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


async def within(seconds: float, coroutine: Coroutine[Any, Any, T]) -> T:
    """What the coroutine returns; raises asyncio.TimeoutError and cancels it after ``seconds`` (zero and less: it may
    only do what needs no waiting).

    As ``asyncio.wait_for``, which before Python 3.12 swallows a cancellation that comes together with the result: an
    order that was told to end would go on, and the vehicle with it.
    """
    task = asyncio.ensure_future(coroutine)
    try:
        await asyncio.wait({task}, timeout=max(seconds, 0.0))
        if not task.done():
            raise asyncio.TimeoutError
        return task.result()
    finally:
        task.cancel()


async def in_thread(work: Callable[..., T], *args: Any) -> T:
    """What ``work`` returns, from a thread of the loop's executor; a cancellation is raised once it has ended.

    For what has to be closed. ``asyncio.to_thread`` does not even begin it where a cancellation comes before a thread
    is free: a session of Zenoh then stays open, and the process never ends.
    """
    working = asyncio.get_running_loop().run_in_executor(None, work, *args)
    try:
        return await asyncio.shield(working)
    finally:
        await asyncio.wait({working})


async def cancelled(*tasks: asyncio.Future[Any] | None) -> None:
    """Cancel those that there are, and return once they have ended, however they did."""
    there = [task for task in tasks if task is not None]
    for task in there:
        task.cancel()
    await asyncio.gather(*there, return_exceptions=True)


async def together(*coroutines: Coroutine[Any, Any, Any]) -> None:
    """Run them side by side. When one fails or we are cancelled, the others are cancelled and have ended before that is
    raised: nothing goes on behind the back of who cleans up.
    """
    async with alongside(*coroutines) as tasks:
        await asyncio.gather(*tasks)


@contextlib.asynccontextmanager
async def alongside(*coroutines: Coroutine[Any, Any, Any]) -> AsyncIterator[list[asyncio.Task[Any]]]:
    """Run them beside the block. At its end they are cancelled, and have ended before it is left.

    How one ended by itself, who looks at its task learns; what it raised and nobody looked at, asyncio logs.
    """
    tasks = [asyncio.ensure_future(each) for each in coroutines]
    try:
        yield tasks
    finally:
        await cancelled(*(task for task in tasks if not task.done()))


async def until_any(*coroutines: Coroutine[Any, Any, Any]) -> None:
    """Run them side by side until the first has ended, and raise what it raised. The others are cancelled, and have
    ended by then.
    """
    tasks = [asyncio.ensure_future(each) for each in coroutines]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        await cancelled(*tasks)


def on_loop(loop: asyncio.AbstractEventLoop, call: Callable[..., object]) -> Callable[..., None]:
    """``call``, made safe to call from any thread: it runs on ``loop``, or not at all once the loop has closed."""

    def relay(*args: Any) -> None:
        try:
            loop.call_soon_threadsafe(call, *args)
        except RuntimeError:
            if not loop.is_closed():
                raise

    return relay
