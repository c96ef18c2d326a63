"""A process that works for the service and may be killed at any time: messages in on stdin, answers out on stdout.

Run (the service does): python -m talkingeyes.apps.service.worker_process MODULE:FACTORY ARGUMENT...
The factory, called with the arguments, gives the function that answers a message. A message and an answer are a length
and a pickle: both ends are this program. It ends when stdin does, so none outlives the service.
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
    """A message on its way."""
    body = pickle.dumps(content)
    return LENGTH_PREFIX.pack(len(body)) + body


def serve_messages(handler: Callable[[Any], Any], source: BinaryIO, target: BinaryIO) -> None:
    """Answer messages until there are no more; what goes wrong with one does not end the work."""
    while len(head := source.read(LENGTH_PREFIX.size)) == LENGTH_PREFIX.size:
        message = pickle.loads(source.read(LENGTH_PREFIX.unpack(head)[0]))
        try:
            reply = (DONE, None if message is None else handler(message))  # None only asks whether all is loaded
        except InputError as error:
            reply = (INPUT_ERROR, " ".join(str(error).split()))
        except Exception as error:  # whatever a sound does to a decoder: told, and the next one is answered
            reply = (INTERNAL_ERROR, f"{type(error).__name__}: {error}"[:300])
        target.write(pack_message(reply))
        target.flush()


def main() -> None:
    """The entry point: libraries that print do so to stderr."""
    target = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    module, _, factory = sys.argv[1].partition(":")
    serve_messages(getattr(import_module(module), factory)(*sys.argv[2:]), sys.stdin.buffer, target)


if __name__ == "__main__":
    main()
