"""What keeps many streams of the service in time: bounded waiting, common steps, admission by load, lateness."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_model import write_live_model
from starlette.requests import Request
from test_streaming import speech

from talkingeyes.animation.streaming import LiveModel
from talkingeyes.apps.service import stream_inbox, stream_status, stream_steps
from talkingeyes.apps.service.animation_request import PoseChunk, StepReply, StreamRequest
from talkingeyes.apps.service.stream_inbox import Sound, StreamInbox
from talkingeyes.apps.service.stream_status import BEHIND_S, Lateness, metrics_text
from talkingeyes.apps.service.stream_steps import MAX_LOAD, WINDOW_S, StreamSteps
from talkingeyes.apps.service.stream_worker import StreamWorker
from talkingeyes.apps.service.worker_pool import Worker, WorkerFailedError
from talkingeyes.apps.viewer.local_server import create_app
from talkingeyes.core.errors import InputError
from talkingeyes.head.looks import dressed_head

SECOND = bytes(32_000)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A time that tests set."""
    now = [100.0]
    for module in (stream_inbox, stream_status, stream_steps):
        monkeypatch.setattr(f"{module.__name__}.time.monotonic", lambda: now[0])
    return now


class FakeWorker(Worker):
    """Answers each step of messages by a function, without a process."""

    def __init__(self, answer: Callable[[list[Any]], StepReply]) -> None:
        self.answer, self.steps = answer, list[list[Any]]()

    async def call(self, message: list[Any], limit_s: float) -> StepReply:
        self.steps.append(message)
        return self.answer(message)


class TestInbox:
    def test_sound_is_due_when_it_comes_but_not_before_it_can_be_spoken(self, clock: list[float]) -> None:
        async def run() -> list[Any]:
            inbox = StreamInbox(channels=1)
            await inbox.put(SECOND)  # a file: all at once
            await inbox.put(SECOND[:3200])
            await inbox.put({"set": 1})
            clock[0] += 5.0  # a pause of the client
            await inbox.put(SECOND[:3200])
            return [await inbox.take() for _ in range(9)]

        taken = asyncio.run(run())
        sounds = taken[:7]
        assert b"".join(each.pcm for each in sounds) == SECOND + SECOND[:3200]
        assert [each.due_s for each in sounds] == pytest.approx([100.0 + 0.16 * step for step in range(7)])
        assert taken[7] == {"set": 1}
        assert taken[8] == Sound(SECOND[:3200], 105.0)

    def test_what_waits_is_bounded(self) -> None:
        async def run() -> float:
            inbox = StreamInbox(channels=2)
            for _ in range(4):  # 2 s of two channels
                await inbox.put(SECOND)
            waiting = asyncio.create_task(inbox.put(SECOND))
            await asyncio.sleep(0.01)
            assert not waiting.done()
            await inbox.take()
            await asyncio.sleep(0.01)
            assert waiting.done()
            return inbox.waiting_s

        assert asyncio.run(run()) == pytest.approx(2.0 - 0.16 + 0.5)


def test_a_client_is_told_once_a_second_that_it_is_behind_and_once_that_it_is_not(clock: list[float]) -> None:
    lateness, told = Lateness(deque()), []
    for late_s in (-3.0, 0.1, 0.2, 0.5, 0.5, 0.1, 0.05, 0.0):
        told.append(lateness.add(late_s))
        clock[0] += 0.6
    assert told == [None, None, 0.2, None, 0.5, None, 0.0, None]
    assert BEHIND_S == 0.15


class TestSteps:
    def test_requests_of_many_streams_are_one_message_and_openings_come_one_at_a_time(self) -> None:
        worker = FakeWorker(lambda message: StepReply(0.0, [key for _, key, _ in message]))

        async def run() -> list[Any]:
            steps = StreamSteps(worker)
            calls = [steps.call(kind, key) for kind, key in zip(("push", "open", "open", "set"), "abcd", strict=True)]
            try:
                return list(await asyncio.gather(*calls))
            finally:
                await steps.stop()

        assert asyncio.run(run()) == ["a", "b", "c", "d"]
        assert [[key for _, key, _ in step] for step in worker.steps] == [["a", "b", "d"], ["c"]]

    def test_an_error_is_of_its_stream_and_that_of_the_worker_of_all(self) -> None:
        def answer(message: list[Any]) -> StepReply:
            if message[0][0] == "finish":
                raise WorkerFailedError("the worker process ended")
            return StepReply(0.0, [InputError("no") if key == "b" else key for _, key, _ in message])

        async def run(kind: str) -> list[Any]:
            steps = StreamSteps(FakeWorker(answer))
            try:
                return list(await asyncio.gather(*(steps.call(kind, key) for key in "abc"), return_exceptions=True))
            finally:
                await steps.stop()

        first, failed, last = asyncio.run(run("push"))
        assert (first, str(failed), last) == ("a", "no", "c")
        assert [str(each) for each in asyncio.run(run("finish"))] == ["the worker process ended"] * 3

    def test_streams_are_admitted_by_the_load_of_steps(self, clock: list[float]) -> None:
        steps = StreamSteps(FakeWorker(lambda _: StepReply(0.0, [])))
        assert steps.load == 0.0
        first = 0
        while steps.admit():  # the first one always
            first += 1
            steps.streams = 1
        assert first == math.floor(MAX_LOAD / stream_steps.STREAM_LOAD + 1e-9)
        steps.streams = 20
        clock[0] += WINDOW_S + 0.1
        steps._steps.extend((clock[0], 0.6 * WINDOW_S / 10) for _ in range(10))  # a load of 0.6, of 20 streams
        assert steps.load == pytest.approx(0.6)
        assert [steps.admit(), steps.admit()] == [True, False]
        clock[0] += WINDOW_S + 0.1
        assert steps.load == 0.0
        assert steps.admit()


def test_a_stream_whose_step_fails_ends_alone(tmp_path: Path) -> None:
    live = LiveModel.load(write_live_model(tmp_path / "model"))
    sound = np.round(speech(1.0) * 32767).astype("<i2").tobytes()

    def rows(seeds: str, breaks: bool) -> dict[str, Any]:
        worker, answers = StreamWorker(live, dressed_head()), dict[str, Any]()
        worker.step([("open", key, StreamRequest(seed=int(key))) for key in seeds])
        if breaks:
            worker._streams["2"].stream._blinks = None  # type: ignore[assignment]
        for _ in range(2):
            found = worker.step([("push", key, sound) for key in seeds]).answers
            answers = {key: [*answers.get(key, []), answer] for key, answer in zip(seeds, found, strict=True)}
        assert set(worker._streams) == set(seeds) - ({"2"} if breaks else set())
        return answers

    alone, found = rows("1", breaks=False), rows("123", breaks=True)
    reasons = [str(each) for each in found["2"]]
    assert reasons[0] == "an internal error ended this stream"
    assert reasons[1].startswith("the stream has ended")
    assert all(isinstance(each, PoseChunk) for each in found["3"])
    assert [each.count for each in found["1"]] == [each.count for each in alone["1"]]
    values = [np.frombuffer(b"".join(each.rows[4:] for each in part["1"]), "<f4") for part in (alone, found)]
    np.testing.assert_allclose(*values, atol=1e-5)


def test_a_body_of_which_no_part_comes_is_answered_with_408() -> None:
    app, sent = create_app(body_timeout_s=0.05), list[Any]()

    @app.post("/")
    async def read(request: Request) -> dict[str, int]:
        return {"bytes": len(await request.body())}

    async def run(parts: list[Any]) -> int:
        async def receive() -> Any:
            return parts.pop(0) if parts else await asyncio.sleep(60)

        async def send(message: Any) -> None:
            sent.append(message)

        scope = {
            "type": "http",
            "method": "POST",
            "path": "/",
            "query_string": b"",
            "headers": [(b"host", b"localhost")],
        }
        await app(scope, receive, send)
        return int(sent[-2]["status"])

    part = {"type": "http.request", "body": b"half", "more_body": True}
    assert asyncio.run(run([part])) == 408
    assert asyncio.run(run([part, {**part, "more_body": False}])) == 200


def test_metrics_are_lines_that_prometheus_reads() -> None:
    assert metrics_text({"streams": 2.0, "load": {'{worker="0"}': 0.25}}) == (
        "# TYPE talkingeyes_streams gauge\ntalkingeyes_streams 2\n"
        '# TYPE talkingeyes_load gauge\ntalkingeyes_load{worker="0"} 0.25\n'
    )
