"""The page of a running rehearsal in a browser of this machine: read-only, and for one user.

It is served on the loopback interface. The address that is printed has a secret, which the browser
changes for a cookie; other names of this host, other sites and other users get no answer.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, final

from bridge.monitor.live_page import EVENTS, LivePage
from bridge.recording.live_run import LiveRun
from cosim.base.clock import monotonic_ns
from cosim.base.errors import RunError, ScenarioError
from cosim.record.folder import REPORT

#: s between two looks at the run, pages at once, and looks that a slow page may lag behind.
PERIOD, PAGES, BEHIND = 0.1, 8, 50
HOST, COOKIE = "127.0.0.1", "cosim_monitor"
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


@final
class Broadcast:
    """Gives every open page what is new; nothing is computed while there is none."""

    def __init__(self, page: LivePage) -> None:
        self._page = page
        self._pages: set[asyncio.Queue[str]] = set()
        self._newest: float | None = None

    @property
    def full(self) -> bool:
        """True if there are as many pages as there may be."""
        return len(self._pages) >= PAGES

    async def run(self) -> None:
        """Look at the run again and again."""
        while True:
            if self._pages:
                self._look()
            else:
                self._newest = None
            await asyncio.sleep(PERIOD)

    def _look(self) -> None:
        news = self._page.news(monotonic_ns(), self._newest)
        if self._newest is None or news["t"]:
            self._newest = news["t"][-1] if news["t"] else self._newest
        text = json.dumps(news, allow_nan=False)
        for queue in list(self._pages):
            try:
                queue.put_nowait(text)
            except asyncio.QueueFull:
                self._pages.discard(queue)  # it may come again

    async def events(self) -> AsyncIterator[str]:
        """The data that a new page receives, as server-sent events: the last seconds, then what is
        new.
        """
        queue: asyncio.Queue[str] = asyncio.Queue(BEHIND)
        first = self._page.news(monotonic_ns())
        yield f"data: {json.dumps(first, allow_nan=False)}\n\n"
        if self._newest is None:
            self._newest = first["t"][-1] if first["t"] else None
        self._pages.add(queue)
        try:
            while queue in self._pages or not queue.empty():
                yield f"data: {await queue.get()}\n\n"
        finally:
            self._pages.discard(queue)


def serve(watched: LiveRun, port: int, say: Callable[[str], None]) -> None:
    """Serve the page of a run until Ctrl-C; `port` 0: any free one; `say`: is told the address.

    Raises ScenarioError without the packages of ``cosim-bridge[web]``, RunError for a port in use.
    """
    try:
        import uvicorn
    except ImportError as error:
        raise ScenarioError(
            f"uvicorn is not available ({error}); install cosim-bridge[web]"
        ) from error
    secret = secrets.token_urlsafe(32)
    application = app(LivePage(watched), watched.folder, secret)
    with socket.socket() as listening:
        try:
            listening.bind((HOST, port))
            listening.listen()
        except OSError as error:
            raise RunError(f"{HOST}:{port} cannot be listened at: {error.strerror}") from None
        say(f"http://{HOST}:{listening.getsockname()[1]}/?token={secret}")
        config = uvicorn.Config(
            application, log_level="warning", access_log=False, timeout_graceful_shutdown=1
        )
        uvicorn.Server(config).run(sockets=[listening])


def app(page: LivePage, folder: Path, secret: str) -> Any:
    """The application (ASGI): the page, its events, and the report of the run in `folder`."""
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.requests import Request
    from starlette.responses import (
        FileResponse,
        HTMLResponse,
        PlainTextResponse,
        RedirectResponse,
        Response,
        StreamingResponse,
    )
    from starlette.routing import Route

    broadcast = Broadcast(page)

    def known(given: str | None) -> bool:
        return given is not None and secrets.compare_digest(given.encode(), secret.encode())

    def refused(request: Request) -> Response | None:
        if known(request.cookies.get(COOKIE)):
            return None
        said = "open the address that cosim monitor has printed"
        return PlainTextResponse(said, 403, headers=_HEADERS)

    async def root(request: Request) -> Response:
        if known(request.query_params.get("token")):
            entered = RedirectResponse("/", 303, headers=_HEADERS)
            entered.set_cookie(COOKIE, secret, httponly=True, samesite="strict")
            return entered
        return refused(request) or HTMLResponse(page.text(), headers=_HEADERS)

    async def events(request: Request) -> Response:
        if answer := refused(request):
            return answer
        if broadcast.full:
            return PlainTextResponse(f"{PAGES} pages are open", 503, headers=_HEADERS)
        stream = broadcast.events()
        return StreamingResponse(stream, media_type="text/event-stream", headers=_HEADERS)

    async def report(request: Request) -> Response:
        if answer := refused(request):
            return answer
        path = folder / REPORT
        if not path.is_file():
            return Response(status_code=204, headers=_HEADERS)  # not yet
        return FileResponse(path, headers=_HEADERS)

    @asynccontextmanager
    async def looking(_: Any) -> AsyncIterator[None]:
        task = asyncio.create_task(broadcast.run())
        yield
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task

    paths = (("/", root), (f"/{EVENTS}", events), ("/report", report))
    return Starlette(
        routes=[Route(path, call, methods=["GET"]) for path, call in paths],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])],
        lifespan=looking,
    )
