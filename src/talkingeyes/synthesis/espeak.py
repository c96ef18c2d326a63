"""Speech synthesis with espeak-ng through ctypes (speak_lib.h): text to sound with word and phoneme events.

The same text gives the same bytes. espeakng_loader bundles the library and its data (GPL-3, the extra `synthesis`), so
it is imported only when needed.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError

ESPEAK_SAMPLE_RATE = 22050
WORD, PHONEME = 1, 7
_SYNCHRONOUS = 2
_PHONEME_EVENTS, _DONT_EXIT = 0x0001, 0x8000
_RATE, _VOLUME, _PITCH, _RANGE, _WORD_GAP = 1, 2, 3, 4, 7
_UTF8 = 1
_engine_lock = Lock()


class _Id(ctypes.Union):
    _fields_ = (("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8))


class _EventStruct(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("id", _Id),
    )


_Callback = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(_EventStruct))


@dataclass(frozen=True)
class EspeakEvent:
    """Onset of a word or phoneme: its sample, its position in the text (from 1), its mnemonic with stress mark."""

    kind: int
    sample: int
    text_position: int
    symbol: str


@dataclass(frozen=True)
class EspeakOutput:
    """Output of espeak-ng: sound at ESPEAK_SAMPLE_RATE in -1..1, word and phoneme events in order."""

    sound: Float[ndarray, " N"]
    events: tuple[EspeakEvent, ...]


# text, words per minute, pitch and pitch range (espeak's 0 to 99) -> sound and events
SpeakFunction = Callable[[str, int, int, int], EspeakOutput]


@contextmanager
def espeak_engine(espeak_voice: str) -> Iterator[SpeakFunction]:
    """Load espeak-ng anew (0.4 ms), because the state of its flutter and noise carries over between utterances.

    A fresh load with a seeded noise generator is the only way to the same bytes in any order and in any process. The
    state of espeak-ng is global to the process, hence the lock. Raises InputError if the voice does not exist or
    espeak-ng cannot be started.
    """
    import _ctypes

    import espeakng_loader

    data = Path(espeakng_loader.get_data_path())
    _check(espeak_voice, data)
    with _engine_lock:
        library = ctypes.CDLL(str(espeakng_loader.get_library_path()))
        try:
            wanted = _PHONEME_EVENTS | _DONT_EXIT
            if library.espeak_Initialize(_SYNCHRONOUS, 0, str(data).encode(), wanted) != ESPEAK_SAMPLE_RATE:
                raise InputError(
                    f"voices: espeak-ng should start with the data in {data}, got an error; install it again"
                )
            library.espeak_ng_SetRandSeed(ctypes.c_long(1))
            if library.espeak_SetVoiceByName(espeak_voice.encode()) != 0:
                raise InputError(f"voices: should be a voice of espeak-ng, got {espeak_voice!r}")
            yield partial(_synthesise, library)
        finally:
            library.espeak_Terminate()
            _ctypes.dlclose(library._handle)


@cache
def _check(espeak_voice: str, data: Path) -> None:
    """Check the voice name against the data, because espeak-ng silently falls back to another voice."""
    accent, _, variant = espeak_voice.partition("+")
    accents = {path.name.lower() for path in (data / "lang").glob("*/*")}
    variants = {path.name for path in (data / "voices" / "!v").iterdir()}
    if accent not in accents or variant not in variants:
        raise InputError(f"voices: should be an accent and variant of espeak-ng such as en-us+f3, got {espeak_voice!r}")


def _synthesise(library: ctypes.CDLL, text: str, rate_wpm: int, pitch: int, pitch_range: int) -> EspeakOutput:
    chunks: list[bytes] = []
    events: list[EspeakEvent] = []

    def collect(wave: int | None, samples: int, reported: Any) -> int:
        if wave and samples > 0:
            chunks.append(ctypes.string_at(wave, 2 * samples))
        for event in _until_end(reported):
            symbol = bytes(event.id.string).decode("utf-8", "replace") if event.type == PHONEME else ""
            events.append(EspeakEvent(event.type, event.sample, event.text_position, symbol))
        return 0

    callback = _Callback(collect)
    library.espeak_SetSynthCallback(callback)
    settings = {_RATE: rate_wpm, _VOLUME: 100, _PITCH: pitch, _RANGE: pitch_range, _WORD_GAP: 0}
    for parameter, value in settings.items():
        library.espeak_SetParameter(parameter, value, 0)
    encoded = text.encode() + b"\0"
    library.espeak_Synth(encoded, ctypes.c_size_t(len(encoded)), 0, 1, 0, _UTF8, None, None)
    library.espeak_Synchronize()
    sound = np.frombuffer(b"".join(chunks), np.int16).astype(np.float64) / 32768
    return EspeakOutput(sound, tuple(event for event in events if event.kind in (WORD, PHONEME)))


def _until_end(reported: Any) -> Iterator[Any]:
    """Events of one callback: an array terminated by an event of type 0."""
    i = 0
    while reported[i].type:
        yield reported[i]
        i += 1
