"""A host's router and what runs beside it: measuring neighbours, answering measurements, passing the roster on."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from types import TracebackType

import zenoh

from mesh.plan import RouterPlan
from zmav.session import SessionSettings, open_session

Part = Callable[[zenoh.Session, RouterPlan], contextlib.AbstractAsyncContextManager[object]]
"""Something that runs beside the router as long as it does"""
PARTS: tuple[Part, ...] = ()


class Router:
    """``async with Router(plan, settings) as router: router.session``; the session closes with it.

    Raises what :func:`zmav.session.open_session` does.
    """

    def __init__(self, plan: RouterPlan, settings: SessionSettings, parts: tuple[Part, ...] = PARTS) -> None:
        self.plan, self._settings, self._parts = plan, plan.session(settings), parts
        self._stack = contextlib.AsyncExitStack()
        self._session: zenoh.Session | None = None

    @property
    def session(self) -> zenoh.Session:
        if self._session is None:
            raise RuntimeError("the router is not open: use 'async with'")
        return self._session

    async def __aenter__(self) -> Router:
        async with contextlib.AsyncExitStack() as stack:
            session = self._session = await asyncio.to_thread(open_session, self._settings)
            stack.push_async_callback(asyncio.to_thread, session.close)
            for part in self._parts:
                await stack.enter_async_context(part(session, self.plan))
            self._stack = stack.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        self._session = None
        await self._stack.aclose()
