"""Common parts of all local servers.

They accept only the host names of this machine (protection against DNS rebinding), load nothing from other sites, and
disable caches and access logs.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from talkingeyes.core.errors import InputError

if TYPE_CHECKING:
    from fastapi import FastAPI

LOCALHOST = "127.0.0.1"
MAX_MESSAGE_BYTES = 1 << 17  # maximum WebSocket message; a longer one closes the socket
ALLOWED_HOSTS = (LOCALHOST, "localhost", "[::1]", "testserver")  # the last is FastAPI's test client
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; media-src 'self' blob:; img-src 'self' data: blob:; "
    "style-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def create_app(host: str = LOCALHOST) -> FastAPI:
    """An application without pages that answers requests to `host` or this machine."""
    from fastapi import FastAPI
    from starlette.datastructures import MutableHeaders
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    class SecurityHeadersMiddleware:
        """Adds SECURITY_HEADERS to every response."""

        def __init__(self, app: ASGIApp) -> None:
            self.app = app

        async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
            async def send_with_headers(message: Message) -> None:
                if message["type"] == "http.response.start":
                    MutableHeaders(scope=message).update(SECURITY_HEADERS)
                await send(message)

            await self.app(scope, receive, send_with_headers)

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    hosts = ["*"] if host == "0.0.0.0" else [*ALLOWED_HOSTS, host]
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts)
    app.add_middleware(SecurityHeadersMiddleware)
    return app


def serve(app: FastAPI, host: str, port: int, on_start: Callable[[str], None], path: str = "/") -> None:
    """Serve until interrupted; `on_start` is called with the URL. Port 0 selects a free one. Raises InputError if it is
    in use."""
    import uvicorn

    if not 0 <= port <= 65535:
        raise InputError(f"port: should be 0 to 65535, got {port}")
    try:
        listener = socket.create_server((host, port))
    except OSError as error:
        raise InputError(f"port: should be free at {host}, got {port} ({error.strerror or error})") from None
    with listener:
        on_start(f"http://{host}:{listener.getsockname()[1]}{path}")
        with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C ends the server
            # No pings: the service disconnects idle clients itself, and a busy machine answers pings late.
            config = uvicorn.Config(
                app, log_level="warning", access_log=False, ws_max_size=MAX_MESSAGE_BYTES, ws_ping_interval=None
            )
            uvicorn.Server(config).run(sockets=[listener])
