"""Worker processes for the event loop: one message at a time each, a time limit, a new process after a crash.

All computation runs in workers, so the service stays responsive, and a sound that hangs or crashes a decoder costs one
process instead of the service.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from talkingeyes.apps.service.worker_process import DONE, INPUT_ERROR, LENGTH_PREFIX, pack_message
from talkingeyes.core.errors import InputError

START_TIMEOUT_S = 300.0  # time limit for loading a model


class BusyError(Exception):
    """The queue is full; the client may try again later."""


class WorkerFailedError(Exception):
    """A worker crashed, exceeded its time limit or reported an internal error."""


class Worker:
    """One process, started on first use; its temporary files are in `temporary`, since it may be killed any time."""

    def __init__(self, factory: str, arguments: Sequence[str], temporary: Path) -> None:
        self._environment = {**os.environ, "TMPDIR": str(temporary)}
        self._command = [sys.executable, "-m", "talkingeyes.apps.service.worker_process", factory, *arguments]
        self._process: asyncio.subprocess.Process | None = None
        self._lock = asyncio.Lock()
        self.users = 0

    @property
    def pid(self) -> int | None:
        """Number of the process, None before its start."""
        return None if self._process is None else self._process.pid

    async def call(self, message: Any, limit_s: float) -> Any:
        """Send a message and return the answer.

        Raises InputError for invalid input, WorkerFailedError after a crash or after `limit_s`.
        """
        # Shielded: a cancelled caller must not leave half an answer in the pipe.
        return await asyncio.shield(asyncio.ensure_future(self._exchange(message, limit_s)))

    async def stop(self) -> None:
        """Kill the process."""
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
            await self._process.wait()
        self._process = None

    async def _exchange(self, message: Any, limit_s: float) -> Any:
        async with self._lock:
            fresh = self._process is None
            try:
                async with asyncio.timeout(limit_s + (START_TIMEOUT_S if fresh else 0.0)):
                    kind, content = await self._answer(message)
            except TimeoutError:
                await self.stop()
                raise WorkerFailedError(f"took longer than {limit_s:g} s") from None
            except (OSError, asyncio.IncompleteReadError, pickle.UnpicklingError):
                await self.stop()
                raise WorkerFailedError("the worker process ended") from None
        if kind == DONE:
            return content
        raise InputError(content) if kind == INPUT_ERROR else WorkerFailedError(content)

    async def _answer(self, message: Any) -> tuple[str, Any]:
        process = self._process
        if process is None:
            pipe = asyncio.subprocess.PIPE
            process = await asyncio.create_subprocess_exec(
                *self._command, stdin=pipe, stdout=pipe, env=self._environment
            )
            self._process = process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(pack_message(message))
        await process.stdin.drain()
        (length,) = LENGTH_PREFIX.unpack(await process.stdout.readexactly(LENGTH_PREFIX.size))
        kind, content = pickle.loads(await process.stdout.readexactly(length))
        return kind, content


class WorkerPool:
    """Several workers, of which any may process a request; streams keep theirs (stream_steps.py)."""

    def __init__(self, factory: str, arguments: Sequence[str], count: int, waiting: int, temporary: Path) -> None:
        self.workers = [Worker(factory, arguments, temporary) for _ in range(count)]
        self._free = asyncio.Semaphore(count)
        self._capacity = count + waiting

    @asynccontextmanager
    async def acquire(self) -> AsyncIterator[Worker]:
        """A worker for one request. Raises BusyError if the queue is full."""
        if self._capacity == 0:
            raise BusyError
        self._capacity -= 1
        try:
            async with self._free, self.least_busy() as worker:
                yield worker
        finally:
            self._capacity += 1

    @asynccontextmanager
    async def least_busy(self) -> AsyncIterator[Worker]:
        """The worker with the fewest users."""
        worker = min(self.workers, key=lambda each: each.users)
        worker.users += 1
        try:
            yield worker
        finally:
            worker.users -= 1

    async def warm_up(self) -> None:
        """Start all processes, so that the first requests do not wait for a model to load."""
        await asyncio.gather(*(worker.call(None, 0.0) for worker in self.workers), return_exceptions=True)

    async def stop(self) -> None:
        """Kill all processes."""
        for worker in self.workers:
            await worker.stop()
