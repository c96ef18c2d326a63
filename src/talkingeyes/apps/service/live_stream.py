"""A live stream over a WebSocket: sound from the client, rows of poses in return, in order.

The client sends a request (JSON), then sound (binary messages: 16-bit PCM, 16 kHz; of two "channels", the samples of
subject and partner in turn) and perhaps {"set": {...}}, which changes controls, then {"end": true}. The server sends
fps, latency_s, format and columns, then the frames: binary messages with the index of the first frame (4 bytes) and its
rows, or JSON (frame_encoding.py). It answers {"set": ...} with the first frame that is changed, and ends with
{"end": true, "frames": N}. A message is read after the one before was answered, so a client that sends too fast is
slowed down (backpressure). Errors are sent as {"error": ...} before the socket is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from talkingeyes.apps.service.animation_request import Limits, PoseChunk, StreamChanges, StreamRequest
from talkingeyes.apps.service.worker_pool import Worker, WorkerFailedError, WorkerPool
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.containers import parse_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section

POLICY, TOO_BIG, FAULT, TRY_AGAIN_LATER = 1008, 1009, 1011, 1013  # close codes of RFC 6455
MAX_CHUNK_BYTES = 2 * SAMPLE_RATE * 2  # 2 s of a channel
WORKER_TIMEOUT_S = 20.0  # time limit of a worker for a chunk
CLOSE_TIMEOUT_S = 10.0  # time limit for sending the reason


class StreamRefusedError(Exception):
    """The reason why a stream ends, and its close code."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code, self.reason = code, reason


class StreamServer:
    """All streams of the service."""

    def __init__(self, workers: WorkerPool, limits: Limits) -> None:
        self._workers, self._limits = workers, limits
        self.running = 0

    async def serve(self, socket: WebSocket) -> None:
        """Serve one stream from its request to its end."""
        await socket.accept()
        try:
            if self.running >= self._limits.streams:
                raise StreamRefusedError(
                    TRY_AGAIN_LATER, f"{self.running} streams are running, which is the maximum; try again later"
                )
            self.running += 1
            try:
                async with self._workers.least_busy() as worker:
                    await self._stream(socket, worker)
            finally:
                self.running -= 1
        except StreamRefusedError as refusal:
            await _close(socket, refusal.code, refusal.reason)
        except InputError as error:
            await _close(socket, POLICY, str(error))
        except WorkerFailedError as error:
            await _close(socket, FAULT, str(error))
        except TimeoutError:
            await _close(socket, POLICY, f"no data received or read for {self._limits.idle_timeout_s:g} s")
        except (WebSocketDisconnect, RuntimeError):  # the client has disconnected; starlette raises either
            pass

    async def _stream(self, socket: WebSocket, worker: Worker) -> None:
        request = _stream_request(_content(await self._receive(socket)))
        key = secrets.token_hex(8)
        begun = await worker.call(("open", key, request), WORKER_TIMEOUT_S)
        try:
            await self._send(socket, json.dumps(begun))
            frames = await self._relay(socket, worker, key, request.channels)
            await self._send(socket, json.dumps({"end": True, "frames": frames}))
            await socket.close()
        finally:
            with contextlib.suppress(WorkerFailedError):
                await worker.call(("close", key), WORKER_TIMEOUT_S)

    async def _relay(self, socket: WebSocket, worker: Worker, key: str, channels: int) -> int:
        """Answer sound with pose rows until the client ends the stream. Returns the number of sent frames."""
        samples = frames = 0
        while True:
            message = await self._receive(socket)
            sound = message.get("bytes")
            if sound is not None:
                samples += _samples(sound, channels)
                if samples > self._limits.max_stream_s * SAMPLE_RATE:
                    raise StreamRefusedError(TOO_BIG, f"a stream should last at most {self._limits.max_stream_s:g} s")
            elif (content := _content(message)) != {"end": True}:
                changes = _stream_changes(content)
                first = await worker.call(("set", key, changes), WORKER_TIMEOUT_S)
                changed = changes.model_dump(exclude_unset=True)
                await self._send(socket, json.dumps({"set": changed, "frame": first}))
                continue
            pose_chunk: PoseChunk = await worker.call(
                ("finish", key) if sound is None else ("push", key, sound), WORKER_TIMEOUT_S
            )
            if pose_chunk.count:
                await self._send(socket, pose_chunk.rows)
            frames += pose_chunk.count
            if sound is None:
                return frames

    async def _receive(self, socket: WebSocket) -> Any:
        """The next message. Raises TimeoutError if none arrives in time."""
        async with asyncio.timeout(self._limits.idle_timeout_s):
            message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1000))
        return message

    async def _send(self, socket: WebSocket, message: str | bytes) -> None:
        async with asyncio.timeout(self._limits.idle_timeout_s):
            await (socket.send_text(message) if isinstance(message, str) else socket.send_bytes(message))


def _samples(sound: bytes, channels: int) -> int:
    """Samples of each channel."""
    if len(sound) > (most := channels * MAX_CHUNK_BYTES):
        raise StreamRefusedError(TOO_BIG, f"a message should hold at most {most} bytes, got {len(sound)}")
    if len(sound) % (2 * channels):
        pairs = "pairs of " if channels == 2 else ""
        raise StreamRefusedError(POLICY, f"sound should be {pairs}16-bit samples, got {len(sound)} bytes")
    return len(sound) // (2 * channels)


def _content(message: Any) -> Any:
    text = message.get("text")
    try:
        return None if text is None else parse_json(text)
    except ValueError:
        return None


def _stream_request(content: Any) -> StreamRequest:
    if not isinstance(content, dict):
        raise StreamRefusedError(POLICY, 'the first message should be a request, such as {"seed": 1}')
    return validate_section("request", StreamRequest, content)


def _stream_changes(content: Any) -> StreamChanges:
    if not isinstance(content, dict) or set(content) != {"set"} or not isinstance(content["set"], dict):
        raise StreamRefusedError(POLICY, 'a text message after the request should be {"set": {...}} or {"end": true}')
    return validate_section("set", StreamChanges, content["set"])


async def _close(socket: WebSocket, code: int, reason: str) -> None:
    """Send the reason and close; the client may have disconnected."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError, TimeoutError):
        async with asyncio.timeout(CLOSE_TIMEOUT_S):
            await socket.send_text(json.dumps({"error": reason}))
            await socket.close(code, reason.encode()[:120].decode(errors="ignore"))
