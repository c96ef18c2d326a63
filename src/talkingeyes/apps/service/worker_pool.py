"""Worker processes as the event loop sees them: one message at a time each, a time limit, a new process after a crash.

All computing is done there, so the service answers while it is done, and a sound that hangs or breaks a decoder costs
one process and not the service.
"""

from __future__ import annotations

import asyncio
import contextlib
import pickle
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from talkingeyes.apps.service.worker_process import DONE, INPUT_ERROR, LENGTH_PREFIX, pack_message
from talkingeyes.core.errors import InputError

START_TIMEOUT_S = 300.0  # within which a process has loaded its model


class BusyError(Exception):
    """More is asked for than the service does at once; it may be asked again later."""


class WorkerFailedError(Exception):
    """The work failed through no fault of the message that anybody knows of."""


class Worker:
    """One process, started when it is first needed."""

    def __init__(self, factory: str, arguments: Sequence[str]) -> None:
        self._command = [sys.executable, "-m", "talkingeyes.apps.service.worker_process", factory, *arguments]
        self._process: asyncio.subprocess.Process | None = None
        self._lock = asyncio.Lock()
        self.users = 0

    async def call(self, message: Any, limit_s: float) -> Any:
        """The answer to a message.

        Raises InputError for what the message's author can mend, FaultError for a crash or after `limit_s`.
        """
        # A caller who leaves does not leave half an answer behind.
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
                raise WorkerFailedError("the process that worked on it ended") from None
        if kind == DONE:
            return content
        raise InputError(content) if kind == INPUT_ERROR else WorkerFailedError(content)

    async def _answer(self, message: Any) -> tuple[str, Any]:
        process = self._process
        if process is None:
            pipe = asyncio.subprocess.PIPE
            process = await asyncio.create_subprocess_exec(*self._command, stdin=pipe, stdout=pipe)
            self._process = process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(pack_message(message))
        await process.stdin.drain()
        (length,) = LENGTH_PREFIX.unpack(await process.stdout.readexactly(LENGTH_PREFIX.size))
        kind, content = pickle.loads(await process.stdout.readexactly(length))
        return kind, content


class WorkerPool:
    """Several of them: any may do a single piece of work; whoever comes back again is given one and keeps it."""

    def __init__(self, factory: str, arguments: Sequence[str], count: int, waiting: int) -> None:
        self._all = [Worker(factory, arguments) for _ in range(count)]
        self._free = asyncio.Semaphore(count)
        self._capacity = count + waiting

    @asynccontextmanager
    async def acquire(self) -> AsyncIterator[Worker]:
        """A worker for one piece of work. Raises BusyError if too many wait already."""
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
        worker = min(self._all, key=lambda each: each.users)
        worker.users += 1
        try:
            yield worker
        finally:
            worker.users -= 1

    async def warm_up(self) -> None:
        """Start all processes, so that nobody waits for a model to load."""
        await asyncio.gather(*(worker.call(None, 0.0) for worker in self._all), return_exceptions=True)

    async def stop(self) -> None:
        """Kill all processes."""
        for worker in self._all:
            await worker.stop()
