"""A worker process of the service, which may be killed at any time: messages on stdin, replies on stdout.

Run (by the service): python -m talkingeyes.apps.service.worker_process MODULE:FACTORY ARGUMENT...

The factory, called with the arguments, returns the message handler. Messages and replies consist of a length and a
pickle, because both ends are this program. The process ends with its stdin, so none outlives the service.
"""

from __future__ import annotations

import os
import pickle
import struct
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any, BinaryIO

from talkingeyes.core.errors import InputError

LENGTH_PREFIX = struct.Struct("<I")
DONE, INPUT_ERROR, INTERNAL_ERROR = "done", "mistake", "fault"


def pack_message(content: Any) -> bytes:
    """Encode a message: its length and its pickle."""
    body = pickle.dumps(content)
    return LENGTH_PREFIX.pack(len(body)) + body


def serve_messages(handler: Callable[[Any], Any], source: BinaryIO, target: BinaryIO) -> None:
    """Answer messages until the end of the input. Errors are returned to the caller and do not end the process."""
    while len(head := source.read(LENGTH_PREFIX.size)) == LENGTH_PREFIX.size:
        message = pickle.loads(source.read(LENGTH_PREFIX.unpack(head)[0]))
        try:
            reply = (DONE, None if message is None else handler(message))  # None: a readiness check
        except InputError as error:
            reply = (INPUT_ERROR, str(error))
        except Exception as error:  # any decoder error is reported
            reply = (INTERNAL_ERROR, f"{type(error).__name__}: {error}"[:300])
        target.write(pack_message(reply))
        target.flush()


def main() -> None:
    """Entry point. Output of libraries to stdout is redirected to stderr."""
    target = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    module, _, factory = sys.argv[1].partition(":")
    serve_messages(getattr(import_module(module), factory)(*sys.argv[2:]), sys.stdin.buffer, target)


if __name__ == "__main__":
    main()
