"""The service as a web application: files by POST, streams by WebSocket, one page.

    POST /performances?seed=1&...   the body is a sound file; returns id, seconds, fps and frames of the animation
    GET /performances/ID/poses      pose rows (apps/viewer/pose_encoding.py); /sound: its sound as wav; /FORMAT: export
    POST /performances/ID/faces/csv?blend=1&...   the body is face motion of another program (csv, csv.gz, json, glb,
                                    vrma, npz, npy); returns it with eyes for the sound of the animation
    WS /stream                      apps/service/live_stream.py
    GET /health, /metrics           whether streams are in time (apps/service/stream_status.py)
    GET /docs, /openapi.json        the description of all this (apps/service/api_page.py)

Errors return a status of 400 to 499 and {"error": one line}; overload returns 503. Clients do not choose file names:
ids are random, and all files are stored in the service's own folder.
"""

from __future__ import annotations

import asyncio
import os
import secrets
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse
from starlette.exceptions import HTTPException as HTTPError

from talkingeyes.apps.service.animation_request import AnimationRequest, EyesRequest, Limits
from talkingeyes.apps.service.api_page import (
    ADD_EYES_DOCS,
    DOWNLOAD_DOCS,
    PERFORM_DOCS,
    ErrorReply,
    HealthReply,
    PerformanceReply,
    ServiceReply,
    api_page,
)
from talkingeyes.apps.service.live_stream import StreamServer
from talkingeyes.apps.service.result_cache import ResultCache
from talkingeyes.apps.service.stream_status import BEHIND_S, metrics_text, process_sizes
from talkingeyes.apps.service.worker_pool import BusyError, WorkerFailedError, WorkerPool
from talkingeyes.apps.viewer.assets import ASSETS_FOLDER as VIEWER_FOLDER
from talkingeyes.apps.viewer.assets import Asset, read_assets
from talkingeyes.apps.viewer.local_server import create_app, serve_files
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section
from talkingeyes.formats.editors.face_file import SUFFIXES

ASSETS = Path(__file__).parent / "assets"
SERVICE_ASSETS = ("live.html", "live.js", "microphone.js", "recorder.js", "waveform.js", "live.css")
SOUND = "sound file itself (wav, flac, ogg, mp3, m4a, webm)"
ERRORS: dict[int | str, dict[str, Any]] = {
    413: {"model": ErrorReply, "description": "The file is too large"},
    415: {"model": ErrorReply, "description": "The body is not the file itself"},
    422: {"model": ErrorReply, "description": "A mistake; one line says what would be right"},
    503: {"model": ErrorReply, "description": "The queue is full; try again later"},
}
NOT_FOUND: dict[int | str, dict[str, Any]] = {
    404: {"model": ErrorReply, "description": "No such animation (only the newest are kept) or format"}
}
DESCRIPTION = "Speech in; gaze, head, blinks, lids and face out. Live streams: WebSocket /stream, described at /docs."
FACE_ENDINGS = tuple(suffix[1:] for suffix in SUFFIXES)
VIEWER_ASSETS = ("stage.js", "style.css", "three.js")


@dataclass(frozen=True)
class ServiceResources:
    """Resources of the service: workers for files and for streams, the head, export formats."""

    file_workers: WorkerPool
    stream_workers: WorkerPool
    head: bytes
    persons: Sequence[str]  # speakers of the model for files
    emotions: Sequence[str]
    formats: Mapping[str, str]  # export formats and their file suffixes


def service_app(
    resources: ServiceResources, limits: Limits, folder: Path, host: str, stream_origins: Sequence[str] = ()
) -> FastAPI:
    """The application; `folder` must be empty and is used by the service alone."""
    app = create_app(host, stream_origins, limits.idle_timeout_s)
    result_cache, streams = ResultCache(folder, limits.max_results), StreamServer(resources.stream_workers, limits)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        processes = (resources.file_workers, resources.stream_workers)
        warming = [asyncio.create_task(workers.warm_up()) for workers in processes]
        yield
        for task, workers in zip(warming, processes, strict=True):
            task.cancel()
            await workers.stop()
        await streams.stop()

    app.router.lifespan_context = lifespan
    app.title, app.version, app.description = "TalkingEyes", version("talkingeyes"), DESCRIPTION
    _register_error_handlers(app)
    _files(app, resources, limits, result_cache)
    app.add_api_websocket_route("/stream", streams.serve)
    _status(app, streams)
    _pages(app, resources, limits)
    return app


def _register_error_handlers(app: FastAPI) -> None:
    @app.exception_handler(InputError)
    async def input_error(_: Request, error: InputError) -> Response:
        return JSONResponse({"error": str(error)}, 422)

    @app.exception_handler(BusyError)
    async def busy(_: Request, __: BusyError) -> Response:
        text = "the queue is full; try again later"
        return JSONResponse({"error": text}, 503, {"Retry-After": "5"})

    @app.exception_handler(WorkerFailedError)
    async def worker_failed(_: Request, error: WorkerFailedError) -> Response:
        return JSONResponse({"error": f"the sound could not be processed: {error}"}, 422)

    @app.exception_handler(HTTPError)
    async def other(_: Request, error: HTTPError) -> Response:
        return JSONResponse({"error": str(error.detail)}, error.status_code)


def _files(app: FastAPI, resources: ServiceResources, limits: Limits, result_cache: ResultCache) -> None:
    @app.post(
        "/performances",
        summary="Animate a sound",
        response_description="The animation, which can be downloaded by its id",
        responses=ERRORS,
        openapi_extra=PERFORM_DOCS,
    )
    async def perform(request: Request) -> PerformanceReply:
        animation_request = validate_section("request", AnimationRequest, dict(request.query_params))
        body = await _body(request, limits, SOUND, ("multipart/", "text/", "application/json"))
        async with resources.file_workers.acquire() as worker:
            with result_cache.entry() as entry:
                (entry.folder / "upload").write_bytes(body)
                made = await worker.call(
                    ("perform", entry.folder, animation_request, limits.max_speech_s), limits.work_timeout_s
                )
        return PerformanceReply(id=entry.name, **made)

    @app.post(
        "/performances/{name}/faces/{ending}",
        summary="Add the eyes of an animation to face motion of another program",
        response_class=Response,
        responses=NOT_FOUND | ERRORS,
        openapi_extra=ADD_EYES_DOCS,
    )
    async def add_eyes(name: str, ending: str, request: Request) -> Response:
        asked = validate_section("request", EyesRequest, dict(request.query_params))
        result_cache.find(name)
        if ending not in FACE_ENDINGS:
            raise HTTPException(404, f"should be one of {', '.join(FACE_ENDINGS)}, got {ending[:40]!r}")
        body = await _body(request, limits, "face motion itself", ("multipart/",))
        async with resources.file_workers.acquire() as worker:
            folder = result_cache.find(name)  # which may have been removed by now
            face = folder / f"{secrets.token_hex(8)}.{ending}"
            face.write_bytes(body)
            content = await worker.call(("add_eyes", folder, face, asked, limits.max_speech_s), limits.work_timeout_s)
        return Response(content, media_type="application/octet-stream")

    @app.get(
        "/performances/{name}/{what}",
        summary="Download an animation: poses, sound, or an export format",
        response_class=Response,
        responses=NOT_FOUND | {status: ERRORS[status] for status in (422, 503)},
        openapi_extra=DOWNLOAD_DOCS,
    )
    async def download(name: str, what: str) -> Response:
        folder = result_cache.find(name)
        if what in ("poses", "sound"):
            return FileResponse(folder / what, media_type="audio/wav" if what == "sound" else None)
        if what not in resources.formats:
            raise HTTPException(404, f"should be poses, sound, {', '.join(resources.formats)}, got {what[:40]!r}")
        file = folder / f"{what}{resources.formats[what]}"
        if not file.exists():
            async with resources.file_workers.acquire() as worker:
                await worker.call(("export", folder, what, file), limits.work_timeout_s)
        return FileResponse(
            file, filename=f"talkingeyes{'' if file.stem == file.suffix[1:] else f'.{what}'}{file.suffix}"
        )


async def _body(request: Request, limits: Limits, what: str, refused: tuple[str, ...]) -> bytes:
    """The file in the body of a request."""
    if request.headers.get("content-type", "").startswith(refused):
        raise HTTPException(415, f"the body should be the {what}")
    too_big = HTTPException(413, f"a file should have at most {limits.max_upload_bytes} bytes")
    claimed = request.headers.get("content-length", "0")
    if claimed.isdigit() and int(claimed) > limits.max_upload_bytes:
        raise too_big
    body = bytearray()
    try:
        async with asyncio.timeout(limits.work_timeout_s):
            async for part in request.stream():
                body += part
                if len(body) > limits.max_upload_bytes:
                    raise too_big
    except TimeoutError:
        raise HTTPException(408, f"a file should come within {limits.work_timeout_s:g} s") from None
    return bytes(body)


def _status(app: FastAPI, streams: StreamServer) -> None:
    def gauges() -> dict[str, float | dict[str, float]]:
        status = streams.status
        pids = [os.getpid(), *(pid for each in streams.steps if (pid := each.worker.pid))]
        return {
            "streams": sum(each.streams for each in streams.steps),
            "load": {f'{{worker="{index}"}}': each.load for index, each in enumerate(streams.steps)},
            "lateness_seconds": {f'{{quantile="{share:g}"}}': late for share, late in status.lateness_s().items()},
            "waiting_seconds": status.waiting_s,
            "streams_ended": {f'{{code="{code}"}}': count for code, count in sorted(status.ended.items())},
            **process_sizes(pids),
        }

    @app.get("/health", summary="Whether streams are in time", response_description="Streams, load and lateness")
    async def health() -> HealthReply:
        return HealthReply(
            behind=(late := streams.status.lateness_s()[0.99]) > BEHIND_S,
            streams=sum(each.streams for each in streams.steps),
            load=round(max(each.load for each in streams.steps), 3),
            lateness_s=round(late, 3),
        )

    @app.get("/metrics", summary="The same for Prometheus, with memory", response_class=PlainTextResponse)
    async def metrics() -> str:
        return metrics_text(gauges())


def _pages(app: FastAPI, resources: ServiceResources, limits: Limits) -> None:
    files = read_assets(VIEWER_FOLDER, VIEWER_ASSETS) | read_assets(ASSETS, SERVICE_ASSETS)
    files["head.glb"] = Asset(resources.head, "model/gltf-binary")

    @app.get("/service.json", summary="What this service offers", response_description="Formats, speakers and limits")
    async def about() -> ServiceReply:
        return ServiceReply(
            formats=list(resources.formats),
            persons=list(resources.persons),
            emotions=list(resources.emotions),
            max_seconds=limits.max_speech_s,
            max_megabytes=round(limits.max_upload_bytes / (1 << 20), 1),
        )

    @app.get("/openapi.json", include_in_schema=False)
    async def openapi() -> dict[str, Any]:
        return app.openapi()

    @app.get("/docs", include_in_schema=False)
    async def docs(request: Request) -> Response:
        return HTMLResponse(api_page(app.openapi(), str(request.base_url).rstrip("/")))

    serve_files(app, files)
