"""Common parts of all local servers.

They accept only the host names of this machine (protection against DNS rebinding) and no requests from pages of other
sites, load nothing from other sites, end requests that stall, and disable caches and access logs. A server that other
machines can reach requires the access token of the printed URL; the browser then keeps it in a cookie.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from talkingeyes.apps.viewer.assets import Asset
from talkingeyes.core.errors import InputError

if TYPE_CHECKING:
    from fastapi import FastAPI
    from starlette.responses import Response
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOCALHOST = "127.0.0.1"
REQUEST_TIMEOUT_S = 10.0  # time limit for the head of a request, and for each next part of its body
MAX_MESSAGE_BYTES = 1 << 17  # maximum WebSocket message; a longer one closes the socket
LOOPBACK_HOSTS = (LOCALHOST, "localhost", "::1", "[::1]")
ANY_ADDRESS = ("0.0.0.0", "::")
ACCESS = "talkingeyes_access"  # name of the query parameter and of the cookie
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; media-src 'self' blob:; img-src 'self' data: blob:; "
    "style-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def create_app(
    host: str = LOCALHOST, stream_origins: Sequence[str] = (), body_timeout_s: float = REQUEST_TIMEOUT_S
) -> FastAPI:
    """An application without pages that answers requests to `host` or this machine.

    Pages of `stream_origins` (http://host:port) may open WebSockets, and nothing else. A body of which no part comes
    for `body_timeout_s` is answered with 408. `app.state.access_token` is the
    token that requests must have, None on the loopback interface.
    """
    from fastapi import FastAPI
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.requests import ClientDisconnect

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.add_exception_handler(ClientDisconnect, _gone)
    app.add_middleware(BodyTimeoutMiddleware, seconds=body_timeout_s)
    app.state.access_token = None if host in LOOPBACK_HOSTS else secrets.token_urlsafe(16)
    if app.state.access_token:
        app.add_middleware(AccessMiddleware, token=app.state.access_token)
    for origin in stream_origins:
        _check_origin(origin)
    app.add_middleware(SameOriginMiddleware, stream_origins=tuple(stream_origins))
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=_host_names(host), www_redirect=False)
    app.add_middleware(SecurityHeadersMiddleware)
    return app


async def _gone(_: Any, __: Exception) -> Response:
    """The answer to a client that has left before its request was complete."""
    from starlette.responses import Response

    return Response(status_code=400)


def serve_files(app: FastAPI, files: Mapping[str, Asset]) -> None:
    """Answer all requests that no route of `app` answers yet with these files, by name."""
    from fastapi import HTTPException, Response

    @app.get("/{name:path}", include_in_schema=False, response_model=None)
    async def file(name: str) -> Response:
        if name not in files:
            raise HTTPException(404, f"should be one of the server's own files, got {name[:100]!r}")
        return Response(files[name].content, media_type=files[name].media)


def _check_origin(origin: str) -> None:
    parts = urlsplit(origin)
    if parts.scheme not in ("http", "https") or not parts.netloc or origin != f"{parts.scheme}://{parts.netloc}":
        raise InputError(f"origin: should be as http://127.0.0.1:8000, without a path, got {origin!r}")


def _host_names(host: str) -> list[str]:
    """The names by which this machine may be addressed."""
    names = {*LOOPBACK_HOSTS}
    if host not in ANY_ADDRESS:
        return [*names, host]
    own = {socket.gethostname(), socket.getfqdn()}
    for name in own:
        with contextlib.suppress(OSError):
            own = own | {str(found[4][0]) for found in socket.getaddrinfo(name, None)}
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # sends nothing; finds the address of the default route
        own.add(probe.getsockname()[0])
    return [*names, *own]


class SecurityHeadersMiddleware:
    """Adds SECURITY_HEADERS to every response."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        from starlette.datastructures import MutableHeaders

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(SECURITY_HEADERS)
            await send(message)

        await self.app(scope, receive, send_with_headers)


class BodyTimeoutMiddleware:
    """Raises 408 where a handler waits for a body of which no part comes."""

    def __init__(self, app: ASGIApp, seconds: float) -> None:
        self.app, self.seconds = app, seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        from starlette.exceptions import HTTPException

        is_complete = scope["type"] != "http"

        async def receive_in_time() -> Message:
            nonlocal is_complete
            try:
                async with asyncio.timeout(None if is_complete else self.seconds):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(408, f"no data received for {self.seconds:g} s") from None
            is_complete = is_complete or not message.get("more_body", False)
            return message

        await self.app(scope, receive_in_time, send)


class SameOriginMiddleware:
    """Rejects cross-origin requests, which pages of other sites could send through a visitor's browser.

    Pages of `stream_origins` may open WebSockets.
    """

    def __init__(self, app: ASGIApp, stream_origins: tuple[str, ...] = ()) -> None:
        self.app, self.stream_origins = app, stream_origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = dict(scope.get("headers", ()))
        origin, host = (headers.get(name, b"").decode("latin-1") for name in (b"origin", b"host"))
        may_stream = scope["type"] == "websocket" and origin in self.stream_origins
        if origin and urlsplit(origin).netloc != host and not may_stream:
            await _refuse(scope, receive, send, "origin: should be the server's own page")
        else:
            await self.app(scope, receive, send)


class AccessMiddleware:
    """Rejects requests without the access token, as a query parameter or as the cookie that it sets."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self.app, self.token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        from starlette.datastructures import MutableHeaders
        from starlette.requests import HTTPConnection

        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        given, kept = connection.query_params.get(ACCESS, ""), connection.cookies.get(ACCESS, "")
        if not any(secrets.compare_digest(each.encode(), self.token.encode()) for each in (given, kept)):
            await _refuse(scope, receive, send, "access: should be the token of the address that the server printed")
            return

        async def send_with_cookie(message: Message) -> None:
            if given and message["type"] == "http.response.start":
                cookie = f"{ACCESS}={self.token}; HttpOnly; SameSite=Strict; Path=/"
                MutableHeaders(scope=message).append("set-cookie", cookie)
            await send(message)

        await self.app(scope, receive, send_with_cookie)


async def _refuse(scope: Scope, receive: Receive, send: Send, reason: str) -> None:
    from starlette.responses import JSONResponse
    from starlette.websockets import WebSocket

    if scope["type"] == "websocket":
        await WebSocket(scope, receive, send).close(1008, reason)
    else:
        await JSONResponse({"error": reason, "detail": reason}, 403)(scope, receive, send)


def _timed_protocol() -> type[asyncio.Protocol]:
    """HTTP/1.1 of uvicorn, which waits for a half-sent head of a request for ever, with a time limit for it."""
    import h11
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class TimedProtocol(H11Protocol):
        head_timer: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self.watch_head()

        def handle_events(self) -> None:
            super().handle_events()
            self.watch_head()

        def connection_lost(self, exc: Exception | None) -> None:
            if self.head_timer:
                self.head_timer.cancel()
            super().connection_lost(exc)

        def watch_head(self) -> None:
            waits = self.conn.their_state is h11.IDLE
            if waits and self.head_timer is None:
                self.head_timer = self.loop.call_later(REQUEST_TIMEOUT_S, self.transport.close)
            elif not waits and self.head_timer is not None:
                self.head_timer.cancel()
                self.head_timer = None

    return TimedProtocol


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
        token = app.state.access_token
        name = socket.gethostname() if host in ANY_ADDRESS else host
        on_start(f"http://{name}:{listener.getsockname()[1]}{path}{f'?{ACCESS}={token}' if token else ''}")
        with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C ends the server
            # No pings: the service disconnects idle clients itself, and a busy machine answers pings late.
            config = uvicorn.Config(
                app,
                http=_timed_protocol(),
                log_level="warning",
                access_log=False,
                ws_max_size=MAX_MESSAGE_BYTES,
                ws_ping_interval=None,
            )
            uvicorn.Server(config).run(sockets=[listener])
