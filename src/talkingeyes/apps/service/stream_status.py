"""How the streams of the service are doing: lateness, what waits, load, memory; for clients, /health and /metrics.

Lateness is the time from when sound was due (stream_inbox.py) until the frames that it completes are sent, beyond the
lookahead of the model. The text of /metrics is the exposition format of Prometheus
(https://prometheus.io/docs/instrumenting/exposition_formats/).
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from talkingeyes.apps.service.stream_inbox import StreamInbox

BEHIND_S = 0.15  # with the lookahead of the model and the client's chunk, frames are then about 0.4 s late
TELL_EVERY_S = 1.0
RECENT_S, RECENT = 60.0, 20_000  # of which quantiles of lateness are given: seconds, and steps at most


class Lateness:
    """The lateness of one stream, and when its client is notified."""

    def __init__(self, recent: deque[tuple[float, float]]) -> None:
        self._recent, self._told_s, self._is_behind = recent, -np.inf, False

    def add(self, late_s: float) -> float | None:
        """Note the lateness of a step. Returns what the client is notified of: how late frames are, at most once a
        second while they are late, then 0 once."""
        now = time.monotonic()
        self._recent.append((now, max(late_s, 0.0)))
        if late_s > BEHIND_S and now - self._told_s >= TELL_EVERY_S:
            self._told_s, self._is_behind = now, True
            return late_s
        if self._is_behind and late_s < BEHIND_S / 2:
            self._told_s, self._is_behind = -np.inf, False
            return 0.0
        return None


class StreamStatus:
    """The state of all streams."""

    def __init__(self) -> None:
        self.ended: Counter[int] = Counter()  # streams that ended by an error, by close code
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)  # when, and how late
        self._inboxes: set[StreamInbox] = set()

    @contextmanager
    def stream(self, inbox: StreamInbox) -> Iterator[Lateness]:
        """Note a stream while it runs."""
        self._inboxes.add(inbox)
        try:
            yield Lateness(self._recent)
        finally:
            self._inboxes.remove(inbox)

    @property
    def waiting_s(self) -> float:
        """The most sound that waits for a stream."""
        return max((each.waiting_s for each in self._inboxes), default=0.0)

    def lateness_s(self, last_s: float = RECENT_S) -> dict[float, float]:
        """Quantiles of the lateness of the steps in the last seconds."""
        quantiles, begun = (0.5, 0.99, 1.0), time.monotonic() - last_s
        late = [late_s for noted_s, late_s in self._recent if noted_s > begun]
        found = np.quantile(late, quantiles).tolist() if late else [0.0] * 3
        return dict(zip(quantiles, found, strict=True))


def process_sizes(pids: Sequence[int]) -> dict[str, int]:
    """Resident bytes and threads of processes together; nothing where there is no /proc."""
    sizes: Counter[str] = Counter()
    for pid in pids:
        status = Path(f"/proc/{pid}/status")
        for line in status.read_text().splitlines() if status.exists() else ():
            name, _, value = line.partition(":")
            if name in ("VmRSS", "Threads"):
                number = int(value.split()[0])
                sizes["memory_bytes" if name == "VmRSS" else "threads"] += number * (1024 if name == "VmRSS" else 1)
    return dict(sizes)


def metrics_text(values: Mapping[str, float | Mapping[str, float]]) -> str:
    """Gauges as the text that Prometheus reads; a mapping is a gauge by labels."""
    lines = []
    for name, value in values.items():
        lines.append(f"# TYPE talkingeyes_{name} gauge")
        labelled = value if isinstance(value, Mapping) else {"": value}
        lines += [f"talkingeyes_{name}{label} {number:g}" for label, number in labelled.items()]
    return "\n".join(lines) + "\n"
