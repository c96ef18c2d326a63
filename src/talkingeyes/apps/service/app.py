"""The service as a web application: files by POST, streams by WebSocket, one page.

POST /performances?seed=1&...   the body is a sound file; answers what was made: its id, seconds, fps, frames
GET /performances/ID/poses      rows of poses (viewer/head_file.py); /sound: what was heard, wav; /FORMAT: a download
WS /stream                      apps/service/live.py
A mistake is answered by a status of 400 to 499 and {"error": one line}, too much by 503. No name comes from a client:
ids are drawn here, and files lie in the one folder that the service made for itself.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from fastapi import FastAPI, HTTPException, Request, Response, WebSocket
from fastapi.responses import FileResponse, JSONResponse
from starlette.exceptions import HTTPException as HTTPError
from starlette.types import ASGIApp, Receive, Scope, Send

from talkingeyes.apps.service.live import Streams
from talkingeyes.apps.service.shelf import Shelf
from talkingeyes.apps.service.wish import Limits, Wish
from talkingeyes.apps.service.workers import BusyError, FaultError, Workers
from talkingeyes.apps.viewer.assets import Asset, asset
from talkingeyes.apps.viewer.serving import application
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validated

ASSETS = Path(__file__).parent / "assets"
OWN = {
    "": "text/html; charset=utf-8",
    "live.js": "text/javascript",
    "microphone.js": "text/javascript",
    "live.css": "text/css",
}
SHARED = ("stage.js", "style.css", "three.js")


@dataclass(frozen=True)
class Equipment:
    """What the service works with: processes for files and for streams (None: there are none), the head, formats."""

    studio: Workers
    speakers: Workers | None
    head: bytes
    persons: Sequence[str]  # whom the model of files can move as
    formats: Mapping[str, str]  # what can be downloaded, and the suffix of such a file


def service_app(equipment: Equipment, limits: Limits, folder: Path, host: str) -> FastAPI:
    """The application; `folder` is its own, and empty."""
    app = application(host)
    shelf, streams = Shelf(folder, limits.kept), Streams(equipment.speakers, limits)

    @asynccontextmanager
    async def living(_: FastAPI) -> AsyncIterator[None]:
        processes = [workers for workers in (equipment.studio, equipment.speakers) if workers]
        warming = [asyncio.create_task(workers.warm()) for workers in processes]
        yield
        for task, workers in zip(warming, processes, strict=True):
            task.cancel()
            await workers.stop()

    app.router.lifespan_context = living
    app.add_middleware(OwnPagesOnly)
    _answer_mistakes(app)
    _files(app, equipment, limits, shelf)
    app.add_api_websocket_route("/stream", streams.serve)
    _pages(app, equipment)
    return app


class OwnPagesOnly:
    """Refuses what a page from elsewhere sends through a visitor's browser."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = dict(scope.get("headers", ()))
        origin = headers.get(b"origin")
        if origin is not None and urlsplit(origin.decode("latin-1")).netloc != headers.get(b"host", b"").decode(
            "latin-1"
        ):
            if scope["type"] == "websocket":
                await WebSocket(scope, receive, send).close(1008, "a page from elsewhere")
            else:
                await JSONResponse({"error": "should come from the service's own page"}, 403)(scope, receive, send)
            return
        await self.app(scope, receive, send)


def _answer_mistakes(app: FastAPI) -> None:
    @app.exception_handler(InputError)
    async def mistake(_: Request, error: InputError) -> Response:
        return JSONResponse({"error": str(error)}, 422)

    @app.exception_handler(BusyError)
    async def busy(_: Request, __: BusyError) -> Response:
        text = "as many files wait as the service takes; try again later"
        return JSONResponse({"error": text}, 503, {"Retry-After": "5"})

    @app.exception_handler(FaultError)
    async def fault(_: Request, error: FaultError) -> Response:
        return JSONResponse({"error": f"the sound could not be worked on: {error}"}, 422)

    @app.exception_handler(HTTPError)
    async def other(_: Request, error: HTTPError) -> Response:
        return JSONResponse({"error": str(error.detail)}, error.status_code)


def _files(app: FastAPI, equipment: Equipment, limits: Limits, shelf: Shelf) -> None:
    @app.post("/performances")
    async def perform(request: Request) -> dict[str, Any]:
        wish = validated("wish", Wish, dict(request.query_params))
        body = await _body(request, limits)
        async with equipment.studio.one() as worker:
            with shelf.place() as place:
                (place.folder / "upload").write_bytes(body)
                made = await worker.call(("perform", place.folder, wish, limits.speech_s), limits.work_s)
        return {"id": place.name, **made}

    @app.get("/performances/{name}/{what}")
    async def download(name: str, what: str) -> Response:
        folder = shelf.find(name)
        if what in ("poses", "sound"):
            return FileResponse(folder / what, media_type="audio/wav" if what == "sound" else None)
        if what not in equipment.formats:
            raise HTTPException(404, f"should be poses, sound, {', '.join(equipment.formats)}, got {what[:40]!r}")
        file = folder / f"{what}{equipment.formats[what]}"
        if not file.exists():
            async with equipment.studio.one() as worker:
                await worker.call(("export", folder, what, file), limits.work_s)
        return FileResponse(
            file, filename=f"talkingeyes{'' if file.stem == file.suffix[1:] else f'.{what}'}{file.suffix}"
        )


async def _body(request: Request, limits: Limits) -> bytes:
    """The sound file that a request brings."""
    if request.headers.get("content-type", "").startswith(("multipart/", "text/", "application/json")):
        raise HTTPException(415, "the body should be the sound file itself (wav, flac, ogg, mp3, m4a, webm)")
    too_big = HTTPException(413, f"a file should have at most {limits.upload_bytes} bytes")
    claimed = request.headers.get("content-length", "0")
    if claimed.isdigit() and int(claimed) > limits.upload_bytes:
        raise too_big
    body = bytearray()
    parts = request.stream().__aiter__()
    try:
        async with asyncio.timeout(limits.work_s):
            while True:
                async with asyncio.timeout(limits.idle_s):
                    body += await anext(parts)
                if len(body) > limits.upload_bytes:
                    raise too_big
    except StopAsyncIteration:
        return bytes(body)
    except TimeoutError:
        raise HTTPException(408, f"nothing came for {limits.idle_s:g} s") from None


def _pages(app: FastAPI, equipment: Equipment) -> None:
    files = {name: asset(name) for name in SHARED}
    files |= {name: Asset((ASSETS / (name or "live.html")).read_bytes(), media) for name, media in OWN.items()}
    files["head.glb"] = Asset(equipment.head, "model/gltf-binary")

    @app.get("/service.json")
    async def about() -> dict[str, Any]:
        live = equipment.speakers is not None
        return {"formats": list(equipment.formats), "live": live, "persons": list(equipment.persons)}

    @app.get("/{name:path}")
    async def page(name: str) -> Response:
        found = files.get(name)
        if found is None:
            raise HTTPException(404, f"should be one of the service's own files, got {name[:100]!r}")
        return Response(found.content, media_type=found.media)
