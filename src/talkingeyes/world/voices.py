"""Who says it: many voices of espeak-ng, with the times of words and phonemes.

Pauses are not left to espeak: each run of words is spoken alone, trimmed, and set between silences of exactly the
length that the script asks for. Pure: gives a sound and its annotation; nothing is read or written.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Phoneme, Span
from talkingeyes.audio.loudness import with_loudness
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.errors import InputError
from talkingeyes.world.espeak import NATIVE_HZ, PHONEME, WORD, Raw, Say, engine
from talkingeyes.world.text import Filler, Pause, Script, Word, write_script

FRAME = 882  # native samples in a frame of 25 fps; resampled they are exactly 640
LEVEL_RMS = 10 ** (-23 / 20)
PEAK = 0.97
EDGE_SILENCE_S = (0.2, 0.6)
SPEAKING_GAP_S = 0.25
JOINT_S = 0.03
FADE_S = 0.004
TRIM_LEVEL = 10 ** (-42 / 20)
FILLER_RATE = 0.7  # an um is drawn out
USUAL_RATE_WPM = 170

ACCENTS: dict[str, tuple[str, ...]] = {
    "en": ("en-us", "en", "en-gb-scotland", "en-gb-x-rp", "en-gb-x-gbclan", "en-gb-x-gbcwmd", "en-029", "en-us-nyc"),
    "fr": ("fr", "fr-be", "fr-ch"),
}
VARIANTS = ("m1", "m2", "m3", "m4", "m5", "m6", "m7", "m8", "f1", "f2", "f3", "f4", "f5", "Andy", "Alicia", "Annie")
RATES_WPM = (145, 195)
PITCHES = (30, 70)
PITCH_RANGES = (35, 80)


@dataclass(frozen=True)
class Voice:
    """A voice of espeak-ng: `espeak_voice` is accent+variant; pitch and pitch_range are espeak's 0 to 99."""

    name: str
    language: str
    espeak_voice: str
    rate_wpm: int
    pitch: int
    pitch_range: int


@dataclass(frozen=True)
class Spoken:
    """A spoken script: sound at 16 kHz (a whole number of frames at 25 fps), what is known about it, its text."""

    sound: Float[ndarray, " N"]
    annotation: Annotation
    text: str

    @property
    def seconds(self) -> float:
        return len(self.sound) / SAMPLE_RATE


def draw_voice(random: np.random.Generator, language: str) -> Voice:
    """A new voice for a language. Raises InputError if there is none."""
    if language not in ACCENTS:
        raise InputError(f"voices: language should be one of {', '.join(ACCENTS)}, got {language!r}")
    espeak_voice = f"{random.choice(ACCENTS[language])}+{random.choice(VARIANTS)}"
    rate, pitch, pitch_range = (int(random.integers(a, b + 1)) for a, b in (RATES_WPM, PITCHES, PITCH_RANGES))
    return Voice(f"{espeak_voice}-{rate}-{pitch}-{pitch_range}", language, espeak_voice, rate, pitch, pitch_range)


def speak_about(
    voice: Voice, shortest_s: float, longest_s: float, random: np.random.Generator
) -> tuple[Script, Spoken]:
    """A new script whose sound, in this voice, lasts between two lengths (scripts of other lengths are dropped)."""
    for _ in range(200):
        target_s = random.uniform(shortest_s, longest_s) - sum(EDGE_SILENCE_S)
        script = write_script(voice.language, target_s * voice.rate_wpm / USUAL_RATE_WPM, random)
        spoken = speak(script, voice)
        if shortest_s <= spoken.seconds <= longest_s:
            return script, spoken
    raise InputError(f"voices: no script of {shortest_s} to {longest_s} s in 200 draws; widen the range")


def speak(script: Script, voice: Voice) -> Spoken:
    """The sound of a script. The same script and voice give the same bytes, whatever was said before."""
    edges = np.random.default_rng(zlib.crc32(repr((script, voice)).encode())).uniform(*EDGE_SILENCE_S, size=2)
    with engine(voice.espeak_voice) as say:
        runs = [run if isinstance(run, Pause) else _said(say, run, voice) for run in _runs(script)]
    return _joined(runs, edges[0], edges[1], script.text)


@dataclass(frozen=True)
class _Run:
    """Words without a pause between them, or one filler."""

    text: str
    filler: bool = False


@dataclass(frozen=True)
class _Said:
    """A spoken run, times counted in seconds from its own start."""

    sound: Float[ndarray, " N"]
    words: tuple[Span, ...]
    phonemes: tuple[Phoneme, ...]
    filler: str


def _runs(script: Script) -> list[_Run | Pause]:
    """The script as runs of words, fillers and pauses. A run broken off gets a comma, so the voice stays up."""
    runs: list[_Run | Pause] = []
    words: list[str] = []

    def flush() -> None:
        if words:
            text = " ".join(words)
            runs.append(_Run(text if text[-1] in ".,?!" else text + ","))
            words.clear()

    for part in script.parts:
        if isinstance(part, Word):
            words.append(part.text)
            continue
        flush()
        runs.append(_Run(part.text + ",", filler=True) if isinstance(part, Filler) else part)
    flush()
    return runs


def _said(say: Say, run: _Run, voice: Voice) -> _Said:
    """Speak a run and cut espeak's own padding off by level, so that silence outside it is the script's alone."""
    rate_wpm = round(voice.rate_wpm * (FILLER_RATE if run.filler else 1))
    raw = say(run.text, rate_wpm, voice.pitch, voice.pitch_range)
    loud = np.flatnonzero(np.abs(raw.sound) > TRIM_LEVEL * np.abs(raw.sound).max(initial=1e-6))
    fade = round(FADE_S * NATIVE_HZ)
    start, stop = max(int(loud[0]) - fade, 0), min(int(loud[-1]) + fade, len(raw.sound))
    sound = raw.sound[start:stop].copy()
    ramp = np.sin(np.linspace(0, np.pi / 2, fade)) ** 2
    sound[:fade] *= ramp
    sound[-fade:] *= ramp[::-1]
    phonemes, words = _timed(raw, run.text, start, stop)
    return _Said(sound, words, phonemes, run.text.strip(".,?!") if run.filler else "")


def _timed(raw: Raw, text: str, start: int, stop: int) -> tuple[tuple[Phoneme, ...], tuple[Span, ...]]:
    """Phonemes and words in seconds from sample `start`. A word lasts from its first phoneme to its last."""
    ends = [*[event.sample for event in raw.events if event.kind == PHONEME][1:], stop]
    phonemes: list[Phoneme] = []
    positions: list[int] = []
    first_of: list[int] = []
    following = iter(ends)
    for event in raw.events:
        if event.kind == WORD:
            positions.append(event.text_position - 1)
            first_of.append(len(phonemes))
            continue
        begin_s, end_s = ((min(max(at, start), stop) - start) / NATIVE_HZ for at in (event.sample, next(following)))
        symbol = event.symbol.lstrip("',%=")
        if symbol == ";" and phonemes:  # a palatal glide into the next sound: no phoneme of its own
            phonemes[-1] = Phoneme(phonemes[-1].start_s, end_s, phonemes[-1].symbol, phonemes[-1].stressed)
        elif end_s > begin_s and not symbol.startswith(("_", "|")) and symbol:
            phonemes.append(Phoneme(begin_s, end_s, symbol, event.symbol.startswith("'")))
    words = []
    for (i, j), (a, b) in zip(pairwise([*first_of, len(phonemes)]), pairwise([*positions, len(text)]), strict=True):
        if j > i:
            words.append(Span(phonemes[i].start_s, phonemes[j - 1].end_s, text[a:b].strip(" .,?!")))
    return tuple(phonemes), tuple(words)


def _joined(runs: list[_Said | Pause], before_s: float, after_s: float, text: str) -> Spoken:
    """Runs and silences in a row, with every time shifted to its place; one level for all voices."""
    import soxr

    pieces = [np.zeros(round(before_s * NATIVE_HZ))]
    words: list[Span] = []
    phonemes: list[Phoneme] = []
    voiced: list[Span] = []
    pauses: list[Span] = []
    fillers: list[Span] = []
    at = len(pieces[0])
    for run, after in zip(runs, [*runs[1:], None], strict=True):
        start_s = at / NATIVE_HZ
        if isinstance(run, Pause):
            pieces.append(np.zeros(round(run.seconds * NATIVE_HZ)))
            pauses.append(Span(start_s, (at + len(pieces[-1])) / NATIVE_HZ, run.kind))
        else:
            pieces.append(run.sound)
            voiced.append(Span(start_s, (at + len(run.sound)) / NATIVE_HZ))
            words += [Span(start_s + w.start_s, start_s + w.end_s, w.label) for w in run.words]
            phonemes += [Phoneme(start_s + p.start_s, start_s + p.end_s, p.symbol, p.stressed) for p in run.phonemes]
            fillers += [Span(voiced[-1].start_s, voiced[-1].end_s, run.filler)] * bool(run.filler)
            if isinstance(after, _Said):
                pieces.append(np.zeros(round(JOINT_S * NATIVE_HZ)))
                at += len(pieces[-1])
        at += len(pieces[-1]) if isinstance(run, Pause) else len(run.sound)
    length = at + round(after_s * NATIVE_HZ)
    pieces.append(np.zeros(-(-length // FRAME) * FRAME - at))
    sound = soxr.resample(_levelled(np.concatenate(pieces), voiced), NATIVE_HZ, SAMPLE_RATE, quality="HQ")
    sound = sound[: len(sound) // 640 * 640].astype(np.float32)
    annotation = Annotation(
        words=tuple(words),
        phonemes=tuple(phonemes),
        speaking=_merged(voiced),
        pauses=tuple(pauses),
        fillers=tuple(fillers),
    )
    return Spoken(sound, with_loudness(annotation, sound), text)


def _levelled(sound: Float[ndarray, " N"], voiced: list[Span]) -> Float[ndarray, " N"]:
    """At the level LEVEL_RMS while speech sounds; less only where a peak would clip."""
    power = sum(float(np.sum(sound[round(v.start_s * NATIVE_HZ) : round(v.end_s * NATIVE_HZ)] ** 2)) for v in voiced)
    seconds = sum(v.end_s - v.start_s for v in voiced)
    gain = LEVEL_RMS / np.sqrt(power / (seconds * NATIVE_HZ))
    levelled: ndarray = sound * min(gain, PEAK / np.abs(sound).max())
    return levelled


def _merged(voiced: list[Span]) -> tuple[Span, ...]:
    """Runs of speech; gaps below SPEAKING_GAP_S do not end one."""
    spans: list[Span] = []
    for each in voiced:
        if spans and each.start_s - spans[-1].end_s < SPEAKING_GAP_S:
            spans[-1] = Span(spans[-1].start_s, each.end_s)
        else:
            spans.append(each)
    return tuple(spans)
