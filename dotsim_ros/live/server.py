# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Serves the page, and its socket, to browsers on this machine.

Only this machine: the socket writes bags and reads them by path. A page of another site in the same
browser is refused by its origin, a name that another site lets lead here by the host.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import threading
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from dotsim_ros.live.payloads import Kind

if TYPE_CHECKING:
    from dotsim_ros.live.desk import LiveDesk

HOST = "127.0.0.1"
SOCKET = "/socket"
LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
PAGE = Path(__file__).parent / "page"
FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/style.css": ("style.css", "text/css; charset=utf-8"),
    "/main.js": ("main.js", "text/javascript; charset=utf-8"),
    "/scene.js": ("scene.js", "text/javascript; charset=utf-8"),
    "/plot.js": ("plot.js", "text/javascript; charset=utf-8"),
}
POLICY = "default-src 'self'; img-src 'self' blob: data:; connect-src 'self' ws: wss:"
LARGEST_ORDER_BYTES = 2**16
MOST_UNANSWERED = 2
"""Moments that a page has not confirmed; a slow one skips those in between."""
SILENCE_S = 20.0
"""A page that sleeps for longer, or has lost its network, is let go; it comes back by itself."""


class _Page:
    """One open page: the newest payload of each kind that it has not been sent."""

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self._waiting: dict[Kind, bytes] = {}
        self._unanswered = 0
        self._changed = asyncio.Event()

    def put(self, kind: Kind, payload: bytes) -> None:
        """Send a payload when the page is ready for it, instead of those of its kind that wait."""
        self._waiting.pop(kind, None)
        self._waiting[kind] = payload
        self._changed.set()

    def confirmed(self) -> None:
        """Take note that the page has drawn a payload."""
        self._unanswered = max(0, self._unanswered - 1)
        self._changed.set()

    async def send(self) -> None:
        """Send until the connection ends."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            while self._waiting and self._unanswered < MOST_UNANSWERED:
                kind = next(iter(self._waiting))
                self._unanswered += 1
                await self._connection.send(self._waiting.pop(kind))


class PageServer:
    """Serves one desk on a thread of its own.

    Args:
        port: of 127.0.0.1; 0: any that is free.

    Attributes:
        port: that it listens on, from `start` on.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self._desk: LiveDesk | None = None
        self._pages: set[_Page] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="server", daemon=True)
        self._server: Server | None = None

    def start(self, desk: LiveDesk) -> None:
        """Listen, and show a desk.

        Raises:
            OSError: the port is taken, or not allowed.
        """
        self._desk = desk
        self._thread.start()
        try:
            asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
        except OSError as error:
            self._end_loop()
            raise _port_refused(self.port, error) from error

    def publish(self, kind: Kind, payload: bytes) -> None:
        """Show a payload on all pages; from any thread."""
        if self._server is not None:
            self._loop.call_soon_threadsafe(self._put, kind, payload)

    def stop(self) -> None:
        """Close all pages' connections, and listen no more."""
        server, self._server = self._server, None
        if server is not None:
            asyncio.run_coroutine_threadsafe(_closed(server), self._loop).result()
            self._end_loop()

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        return f"http://{HOST}:{self.port}/"

    async def _listen(self) -> None:
        logger = logging.getLogger("dotsim_ros.live")
        # Browsers open connections that they then do not use; websockets would log each.
        logger.setLevel(logging.CRITICAL)
        self._server = await serve(
            self._converse,
            HOST,
            self.port,
            process_request=_answered,
            # Pictures are packed already.
            compression=None,
            max_size=LARGEST_ORDER_BYTES,
            ping_interval=SILENCE_S,
            ping_timeout=SILENCE_S,
            logger=logger,
        )
        self.port = int(next(iter(self._server.sockets)).getsockname()[1])

    async def _converse(self, connection: ServerConnection) -> None:
        assert self._desk is not None
        page = _Page(connection)
        # Nothing may be shown between the two.
        self._pages.add(page)
        for kind, payload in self._desk.greeting():
            page.put(kind, payload)
        sender = asyncio.create_task(page.send())
        try:
            async for message in connection:
                if message == "":
                    page.confirmed()
                else:
                    self._desk.hear(message)
        except ConnectionClosed:
            pass
        finally:
            self._pages.discard(page)
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)

    def _put(self, kind: Kind, payload: bytes) -> None:
        for page in self._pages:
            page.put(kind, payload)

    def _end_loop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def _closed(server: Server) -> None:
    server.close()
    await server.wait_closed()


def _port_refused(port: int, error: OSError) -> OSError:
    reason = {
        errno.EADDRINUSE: "another program listens there, perhaps another `dotsim_ros live`",
        errno.EACCES: "ports below 1024 are the administrator's",
    }.get(error.errno or 0, error.strerror or str(error))
    return OSError(f"port {port} cannot be used: {reason}; give another one with --port")


def _answered(connection: ServerConnection, request: Request) -> Response | None:
    """Return a file or a refusal; None for the socket."""
    host = request.headers.get("Host", "")
    if urlsplit(f"//{host}").hostname not in LOCAL_NAMES:
        return _refusal(
            403, "Forbidden", "open the page as http://localhost, which is this machine"
        )
    path = urlsplit(request.path).path
    if path == SOCKET:
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return _refusal(403, "Forbidden", "only the page itself may press the sensor")
        return None
    if path not in FILES:
        return _refusal(404, "Not Found", f"there is no such page; open http://{host}/")
    name, form = FILES[path]
    return _response(200, "OK", (PAGE / name).read_bytes(), form)


def _refusal(status: int, reason: str, words: str) -> Response:
    return _response(status, reason, f"{words}\n".encode(), "text/plain; charset=utf-8")


def _response(status: int, reason: str, body: bytes, form: str) -> Response:
    headers = Headers(
        {
            "Content-Type": form,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Content-Security-Policy": POLICY,
            "X-Content-Type-Options": "nosniff",
            "Connection": "close",
        }
    )
    return Response(status, reason, headers, body)
