"""What a client of a stream has sent and the stream has not taken yet: bounded, and with the time at which it was due.

Sound is due when it arrives, and not before it can have been spoken: a client that sends a file faster than it is
spoken is not behind, however much waits. What waits is bounded: while there is more, the socket is not read, and the
client has to wait.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from talkingeyes.audio.waveform import SAMPLE_RATE

STEP_SOUND_S = 0.16  # at most in a step, so that streams that catch up do not hold back the others
MAX_WAITING_S = 2.0
MAX_WAITING_MESSAGES = 256


@dataclass(frozen=True)
class Sound:
    """Sound for one step, and when the first of it was due (monotonic)."""

    pcm: bytes
    due_s: float


class StreamInbox:
    """The sound of one client, `channels` of 16-bit samples, and its other messages, in order."""

    def __init__(self, channels: int) -> None:
        self._messages: deque[Any] = deque()
        self._bytes_s = 2.0 * SAMPLE_RATE * channels
        self._changed = asyncio.Condition()
        self._due_s = -1.0  # of the next sound

    @property
    def waiting_s(self) -> float:
        """Sound that waits."""
        return sum(len(each.pcm) for each in self._messages if isinstance(each, Sound)) / self._bytes_s

    async def put(self, message: Any) -> None:
        """Append a message: sound as bytes, anything else as it is. Waits while too much waits."""
        async with self._changed:
            await self._changed.wait_for(
                lambda: self.waiting_s < MAX_WAITING_S and len(self._messages) < MAX_WAITING_MESSAGES
            )
            if isinstance(message, bytes):
                due_s = max(time.monotonic(), self._due_s)
                self._due_s = due_s + len(message) / self._bytes_s
                message = Sound(message, due_s)
            self._messages.append(message)
            self._changed.notify_all()

    async def take(self) -> Any:
        """The next message that is no sound, or the sound before it: as much as one step takes."""
        async with self._changed:
            await self._changed.wait_for(lambda: self._messages)
            if not isinstance(self._messages[0], Sound):
                found = self._messages.popleft()
            else:
                found = self._take_sound(round(STEP_SOUND_S * self._bytes_s))
            self._changed.notify_all()
            return found

    def _take_sound(self, most: int) -> Sound:
        due_s, parts, left = self._messages[0].due_s, [], most
        while left and self._messages and isinstance(self._messages[0], Sound):
            first = self._messages.popleft()
            parts.append(first.pcm[:left])
            if rest := first.pcm[left:]:
                self._messages.appendleft(Sound(rest, first.due_s + left / self._bytes_s))
            left -= len(parts[-1])
        return Sound(b"".join(parts), due_s)
