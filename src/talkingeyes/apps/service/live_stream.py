"""A live stream over a WebSocket: sound from the client, rows of poses in return, in order.

The client sends a request (JSON), then sound (binary messages: 16-bit PCM, 16 kHz; of two "channels", the samples of
subject and partner in turn) and perhaps {"set": {...}}, which changes controls, then {"end": true}. The server sends
fps, latency_s, format and columns, then the frames: binary messages with the index of the first frame (4 bytes) and its
rows, or JSON (frame_encoding.py). It answers {"set": ...} with the first frame that is changed, says {"behind_s": ...}
while frames are late, and ends with {"end": true, "frames": N}. What waits for a stream is bounded (stream_inbox.py): a
client that sends too fast is slowed down. Errors are sent as {"error": ...} before the socket is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import secrets
import time
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from talkingeyes.apps.service.animation_request import Limits, PoseChunk, StreamChanges, StreamRequest
from talkingeyes.apps.service.stream_inbox import Sound, StreamInbox
from talkingeyes.apps.service.stream_status import BEHIND_S, Lateness, StreamStatus
from talkingeyes.apps.service.stream_steps import FEW_STREAMS, WINDOW_S, StreamSteps
from talkingeyes.apps.service.worker_pool import WorkerFailedError, WorkerPool
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.containers import parse_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section

POLICY, TOO_BIG, FAULT, TRY_AGAIN_LATER = 1008, 1009, 1011, 1013  # close codes of RFC 6455
MAX_CHUNK_BYTES = 2 * SAMPLE_RATE * 2  # 2 s of a channel
CLOSE_TIMEOUT_S = 10.0  # time limit for sending the reason
LOG = logging.getLogger(__name__)


class StreamRefusedError(Exception):
    """The reason why a stream ends, and its close code."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code, self.reason = code, reason


class StreamServer:
    """All streams of the service."""

    def __init__(self, workers: WorkerPool, limits: Limits) -> None:
        self.steps, self._limits = [StreamSteps(each) for each in workers.workers], limits
        self.status = StreamStatus()

    async def stop(self) -> None:
        """End the steps."""
        for each in self.steps:
            await each.stop()

    async def serve(self, socket: WebSocket) -> None:
        """Serve one stream from its request to its end."""
        await socket.accept()
        try:
            steps = self._admitted()
            steps.streams += 1
            try:
                await self._stream(socket, steps)
            finally:
                steps.streams -= 1
        except StreamRefusedError as refusal:
            await self._close(socket, refusal.code, refusal.reason)
        except InputError as error:
            await self._close(socket, POLICY, str(error))
        except WorkerFailedError as error:
            await self._close(socket, FAULT, str(error))
        except TimeoutError:
            await self._close(socket, POLICY, f"no data received or read for {self._limits.idle_timeout_s:g} s")
        except (WebSocketDisconnect, RuntimeError):  # the client has disconnected; starlette raises either
            pass

    def _admitted(self) -> StreamSteps:
        """The worker for one more stream. Raises StreamRefusedError for too many, or for too high a load."""
        running = sum(each.streams for each in self.steps)
        if running >= self._limits.streams:
            raise StreamRefusedError(
                TRY_AGAIN_LATER, f"{running} streams are running, which is the maximum; try again later"
            )
        steps = min(self.steps, key=lambda each: each.streams)
        are_late = running >= FEW_STREAMS and self.status.lateness_s(WINDOW_S)[0.5] > BEHIND_S
        if are_late or not steps.admit():
            reason = f"{running} streams are running, and one more would be late; try again later"
            raise StreamRefusedError(TRY_AGAIN_LATER, reason)
        return steps

    async def _stream(self, socket: WebSocket, steps: StreamSteps) -> None:
        request = _stream_request(_content(await self._receive(socket)))
        key, inbox = secrets.token_hex(8), StreamInbox(request.channels)
        begun = await steps.call("open", key, request)
        reading = asyncio.create_task(self._read(socket, inbox, request.channels))
        try:
            await self._send(socket, json.dumps(begun))
            with self.status.stream(inbox) as lateness:
                frames = await self._relay(socket, steps, key, inbox, lateness)
            await self._send(socket, json.dumps({"end": True, "frames": frames}))
            await socket.close()
        finally:
            reading.cancel()
            with contextlib.suppress(WorkerFailedError):
                await steps.call("close", key)

    async def _read(self, socket: WebSocket, inbox: StreamInbox, channels: int) -> None:
        """Pass on what the client sends: sound, changes, None at the end, or the error that ends the stream."""
        samples = 0
        try:
            while True:
                message = await self._receive(socket)
                if (sound := message.get("bytes")) is not None:
                    samples += _samples(sound, channels)
                    if samples > self._limits.max_stream_s * SAMPLE_RATE:
                        most = f"a stream should last at most {self._limits.max_stream_s:g} s"
                        raise StreamRefusedError(TOO_BIG, most)
                    await inbox.put(sound)
                elif (content := _content(message)) == {"end": True}:
                    await inbox.put(None)
                    return
                else:
                    await inbox.put(_stream_changes(content))
        except Exception as error:
            await inbox.put(error)

    async def _relay(
        self, socket: WebSocket, steps: StreamSteps, key: str, inbox: StreamInbox, lateness: Lateness
    ) -> int:
        """Answer sound with pose rows until the client ends the stream. Returns the number of sent frames."""
        frames = 0
        while True:
            message = await inbox.take()
            if isinstance(message, Exception):
                raise message
            if isinstance(message, StreamChanges):
                first = await steps.call("set", key, message)
                changed = message.model_dump(exclude_unset=True)
                await self._send(socket, json.dumps({"set": changed, "frame": first}))
                continue
            asked = ("push", key, message.pcm) if isinstance(message, Sound) else ("finish", key)
            pose_chunk: PoseChunk = await steps.call(*asked)
            if pose_chunk.count:
                await self._send(socket, pose_chunk.rows)
            frames += pose_chunk.count
            if message is None:
                return frames
            if (behind_s := lateness.add(time.monotonic() - message.due_s)) is not None:
                await self._send(socket, json.dumps({"behind_s": round(behind_s, 2)}))

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

    async def _close(self, socket: WebSocket, code: int, reason: str) -> None:
        """Send the reason and close; the client may have disconnected."""
        self.status.ended[code] += 1
        LOG.info("a stream ended with code %d", code)
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await socket.send_text(json.dumps({"error": reason}))
                await socket.close(code, reason.encode()[:120].decode(errors="ignore"))


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
