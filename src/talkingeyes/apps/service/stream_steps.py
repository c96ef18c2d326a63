"""The steps of the streams of a worker: every 40 ms, all that they ask for by then is one message to the worker.

A step for many streams costs little more than for a few (models/motion_stream.py), so streams wait for the next step,
20 ms in the mean. A stream has one request at a time. New streams are admitted by the measured load: the share of time
that steps take.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from talkingeyes.apps.service.animation_request import StepReply
from talkingeyes.apps.service.worker_pool import Worker, WorkerFailedError

STEP_S = 0.04
STEP_TIMEOUT_S = 20.0  # time limit of a worker for a step
WINDOW_S = 3.0  # in which load is measured
MAX_LOAD = 0.65
# The least load that a new stream is assumed to add; with few streams the only one, as a step has a fixed cost too.
STREAM_LOAD, FEW_STREAMS = 0.02, 8


@dataclass(frozen=True)
class _Request:
    kind: str
    key: str
    content: Any
    answer: asyncio.Future[Any]


class StreamSteps:
    """The streams of one worker."""

    def __init__(self, worker: Worker) -> None:
        self.worker, self.streams = worker, 0
        self._requests: deque[_Request] = deque()
        self._asked = asyncio.Event()
        self._steps: deque[tuple[float, float]] = deque()  # end and duration of each step
        self._admitted_s: deque[float] = deque()  # when streams came
        self._running: asyncio.Task[None] | None = None

    async def call(self, kind: str, key: str, content: Any = None) -> Any:
        """Take part in the next step and return its answer.

        Raises InputError for invalid input, WorkerFailedError for a fault of this stream or of the worker.
        """
        if self._running is None:
            self._running = asyncio.create_task(self._run())
        request = _Request(kind, key, content, asyncio.get_running_loop().create_future())
        self._requests.append(request)
        self._asked.set()
        return await request.answer

    async def stop(self) -> None:
        """End the steps."""
        if self._running is not None:
            self._running.cancel()
            with suppress(asyncio.CancelledError):
                await self._running

    @property
    def load(self) -> float:
        """Share of the last seconds that steps took."""
        begun = time.monotonic() - WINDOW_S
        while self._steps and self._steps[0][0] < begun:
            self._steps.popleft()
        return sum(duration for _, duration in self._steps) / WINDOW_S

    def admit(self) -> bool:
        """Whether there is room for one more stream, which then counts as one."""
        now = time.monotonic()
        while self._admitted_s and self._admitted_s[0] < now - WINDOW_S:
            self._admitted_s.popleft()
        load, unmeasured = self.load, len(self._admitted_s) + 1
        each = max(load / self.streams, STREAM_LOAD) if self.streams >= FEW_STREAMS else STREAM_LOAD
        if self.streams and load + unmeasured * each > MAX_LOAD:
            return False
        self._admitted_s.append(now)
        return True

    async def _run(self) -> None:
        while True:
            await self._asked.wait()
            begun = time.monotonic()
            requests = self._take()
            try:
                await self._step(requests)
            finally:  # also if this task is cancelled
                for each in requests:
                    if not each.answer.done():
                        each.answer.set_exception(WorkerFailedError("the service ends"))
            await asyncio.sleep(begun + STEP_S - time.monotonic())

    def _take(self) -> list[_Request]:
        """The requests of the next step; streams are opened one at a time, for that costs as much as a step."""
        requests: list[_Request] = []
        later: list[_Request] = []
        for each in self._requests:
            opens = each.kind == "open" and any(other.kind == "open" for other in requests)
            (later if opens else requests).append(each)
        self._requests = deque(later)
        if not later:
            self._asked.clear()
        return requests

    async def _step(self, requests: list[_Request]) -> None:
        message = [(each.kind, each.key, each.content) for each in requests]
        try:
            reply: StepReply = await self.worker.call(message, STEP_TIMEOUT_S)
            answers = reply.answers
            self._steps.append((time.monotonic(), reply.step_s))
        except Exception as error:  # every stream ends with it
            answers = [error] * len(requests)
        for each, answer in zip(requests, answers, strict=True):
            if each.answer.done():  # the client has gone
                continue
            if isinstance(answer, Exception):
                each.answer.set_exception(answer)
            else:
                each.answer.set_result(answer)
