"""Speech synthesis of monologues and conversations, with the times of all words, phonemes and pauses.

The sound is assembled phrase by phrase at espeak's rate and padded to whole frames of 25 fps. The text of a turn is
written during synthesis, so that the turn ends on time: sentences are chosen with the pace of the voice so far. A clip
is cut out of a longer conversation at a random place, so that nothing can be read off where it starts and ends. Pure:
returns sounds and annotations; reads and writes no files.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Phoneme, Span
from talkingeyes.audio.loudness import with_loudness
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.synthesis.espeak import ESPEAK_SAMPLE_RATE, SpeakFunction, espeak_engine
from talkingeyes.synthesis.phrases import Phrase, SpokenPhrase, speak_phrase, split_phrases
from talkingeyes.synthesis.text import (
    ALL_TEXT,
    MIN_NEXT_SENTENCE_S,
    SHORTEST_SENTENCE_S,
    Pause,
    Script,
    Sentence,
    TextPartition,
    estimated_duration_s,
    without_last_pause,
    write_sentence,
)
from talkingeyes.synthesis.voice_profiles import Voice

FRAME_SAMPLES = 882  # native samples per frame at 25 fps; exactly 640 after resampling
LEVEL_RMS = 10 ** (-23 / 20)
PEAK = 0.97
EDGE_SILENCE_S = (0.2, 0.6)
SPEAKING_GAP_S = 0.25
PHRASE_GAP_S = 0.03
DEFAULT_RATE_WPM = 170
# Duration of espeak speech relative to text.SECONDS_PER_LETTER, over 30 voices per language.
LANGUAGE_PACES = {"en": 0.97, "fr": 0.91, "de": 1.02, "es": 1.16, "it": 1.10, "pt": 1.15, "nl": 1.10}
PACE_PRIOR_S = 2.0  # weight of the usual pace in the estimate of a voice's pace, in seconds of speech
MIN_SPEED_FACTOR, MAX_SPEED_FACTOR = 0.9, 1.12  # of the last sentence of a turn, so that it ends on time
ATTEMPTS = 50
MARGIN_S = 0.2  # inside the requested range of durations, so that few attempts fail
CONTEXT_S = 6.0  # of conversation around a clip, before and after it together
MIN_SPOKEN_S = 2.0  # of the speaker's own speech in a clip
FRAME_S = FRAME_SAMPLES / ESPEAK_SAMPLE_RATE
LONGEST_MONOLOGUE_S = 300.0  # of one text for given turns
TURN_S = 6.0  # mean duration of a turn in a conversation
TURN_SPREAD = 0.35
SPEAKER_TURN_WEIGHT = 1.5  # weight of the speaker's turns relative to the partner's
# From the end of a turn to the start of the next: median 0.2 s in ten languages (Stivers et al. 2009, PNAS 106(26)).
TURN_GAP_S = (0.2, 0.6, 0.05, 1.2)


@dataclass(frozen=True)
class SynthesizedSpeech:
    """A sound at 16 kHz (a whole number of frames at 25 fps), its annotation and script.

    The annotation and the script are those of the whole conversation that the sound is cut out of: events may lie
    before 0 and after the end of the sound. `partner` is the partner's sound, of the same length; None without a
    partner.
    """

    sound: Float[ndarray, " N"]
    annotation: Annotation
    script: Script
    partner: Float[ndarray, " N"] | None = None
    partner_script: Script | None = None

    @property
    def seconds(self) -> float:
        return len(self.sound) / SAMPLE_RATE

    @property
    def text(self) -> str:
        """The speaker's words in the sound, including hesitations."""
        inside = self.annotation.clipped(self.seconds)
        return self.script.text if inside == self.annotation else " ".join(word.label for word in inside.words)

    @property
    def sentences(self) -> tuple[str, ...]:
        """All sentences of speaker and partner, without hesitations."""
        return self.script.sentences_text + (self.partner_script.sentences_text if self.partner_script else ())


@dataclass(frozen=True)
class DialogueVoices:
    """The voice of the speaker, and of the partner if there is one."""

    speaker: Voice
    partner: Voice | None = None


def synthesize_conversation(
    speaker_voices: DialogueVoices,
    shortest_s: float,
    longest_s: float,
    rng: np.random.Generator,
    partition: TextPartition = ALL_TEXT,
) -> SynthesizedSpeech:
    """Synthesize a conversation with sentences from a partition of all text, and cut a clip out of it at a random
    place, with a duration between two limits.

    Raises InputError if ATTEMPTS attempts have no clip with MIN_SPOKEN_S of speech.
    """
    for _ in range(ATTEMPTS):
        seconds = float(np.exp(rng.uniform(np.log(shortest_s + MARGIN_S), np.log(longest_s - MARGIN_S))))
        frames = round(seconds / FRAME_S)
        whole = _talk(speaker_voices, seconds + CONTEXT_S, rng, partition)
        spare = round(whole.seconds / FRAME_S) - frames
        if spare < 0:
            continue
        clip = excerpt(whole, int(rng.integers(spare + 1)), frames)
        if _seconds(clip.annotation.clipped(clip.seconds).speaking) >= min(MIN_SPOKEN_S, seconds / 2):
            return clip
    raise InputError(
        f"voices: speech should last {shortest_s} to {longest_s} s, got none in {ATTEMPTS} attempts; widen the range"
    )


def synthesize_turns(
    speaker_voices: DialogueVoices,
    turns: Sequence[Sequence[Span]],
    seconds: float,
    rng: np.random.Generator,
    partition: TextPartition = ALL_TEXT,
) -> SynthesizedSpeech:
    """Synthesize a conversation with given turns, of the speaker and of the partner, to the sample.

    Each turn is a piece of a monologue from the start of one of its phrases on, cut where the turn ends, so a last word
    may be cut off. `partner` is the partner's sound.
    """
    assert speaker_voices.partner is not None, "a conversation should have a partner"
    (own, said), (other, answered) = (
        _fill_turns(voice, spans, seconds, rng, partition)
        for voice, spans in zip((speaker_voices.speaker, speaker_voices.partner), turns, strict=True)
    )
    listening = tuple(Annotation(listening=tuple(turns[1])).clipped(seconds).listening)
    annotation = replace(said, listening=listening, partner=answered.speaking)
    script = Script(speaker_voices.speaker.language, ())
    return SynthesizedSpeech(own, with_loudness(annotation, own), script, other)


def _fill_turns(
    voice: Voice, turns: Sequence[Span], seconds: float, rng: np.random.Generator, partition: TextPartition
) -> tuple[Float[ndarray, " N"], Annotation]:
    """Sound and annotation of one person, silent outside of the turns; a long conversation repeats the monologue."""
    monologue = _talk(DialogueVoices(voice), min(seconds, LONGEST_MONOLOGUE_S), rng, partition)
    sound, pieces, at_s = np.zeros(round(seconds * SAMPLE_RATE), np.float32), [], 0.0
    for turn in turns:
        length_s = min(turn.end_s, seconds) - turn.start_s
        if length_s <= 0:
            continue
        phrases = [
            span.start_s for span in monologue.annotation.speaking if span.start_s + length_s < monologue.seconds
        ]
        start_s = next((each for each in phrases if each >= at_s), phrases[0] if phrases else 0.0)
        said = monologue.sound[round(start_s * SAMPLE_RATE) :][: round(length_s * SAMPLE_RATE)]
        first = round(turn.start_s * SAMPLE_RATE)
        sound[first : first + len(said)] = said[: len(sound) - first]
        pieces.append(monologue.annotation.shifted(-start_s).clipped(length_s).shifted(turn.start_s))
        at_s = start_s + length_s
    joined: dict[str, Any] = {
        name: tuple(chain.from_iterable(getattr(piece, name) for piece in pieces))
        for name, value in vars(Annotation()).items()
        if isinstance(value, tuple)
    }
    return sound, Annotation(**joined)


def excerpt(spoken: SynthesizedSpeech, first: int, frames: int) -> SynthesizedSpeech:
    """Frames `first` to `first + frames` (25 fps) of a conversation, with the time of the first as 0."""
    samples = round(SAMPLE_RATE * FRAME_S)
    part = slice(first * samples, (first + frames) * samples)
    partner = None if spoken.partner is None else spoken.partner[part]
    annotation = spoken.annotation.shifted(-first * FRAME_S)
    return replace(spoken, sound=spoken.sound[part], annotation=annotation, partner=partner)


def synthesize_script(script: Script, voice: Voice) -> SynthesizedSpeech:
    """Synthesize a script. The same script and voice always give the same bytes."""
    edges_s = np.random.default_rng(zlib.crc32(repr((script, voice)).encode())).uniform(*EDGE_SILENCE_S, size=2)
    track = VoiceTrack(voice, round(edges_s[0] * ESPEAK_SAMPLE_RATE))
    with espeak_engine(voice.espeak_voice) as say:
        for sentence in script.sentences:
            track.add_sentence(sentence, say)
    return _spoken(track, None, track.at_s + edges_s[1])


@dataclass
class VoiceTrack:
    """The speech of one person, assembled piece by piece; `at` is the native sample of the next piece."""

    voice: Voice
    at: int = 0
    pieces: list[tuple[int, ndarray]] = field(default_factory=list)
    words: list[Span] = field(default_factory=list)
    phonemes: list[Phoneme] = field(default_factory=list)
    voiced: list[Span] = field(default_factory=list)
    pauses: list[Span] = field(default_factory=list)
    fillers: list[Span] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)
    turns: list[Span] = field(default_factory=list)
    sentences: list[Sentence] = field(default_factory=list)

    @property
    def at_s(self) -> float:
        return self.at / ESPEAK_SAMPLE_RATE

    @property
    def script(self) -> Script:
        return Script(self.voice.language, tuple(self.sentences))

    @property
    def pace(self) -> float:
        """Duration of this voice's speech relative to the usual rate, estimated from its speech so far."""
        usual = LANGUAGE_PACES[self.voice.language] * DEFAULT_RATE_WPM / self.voice.rate_wpm
        silent = _seconds(self.pauses)
        written_s = sum(map(estimated_duration_s, self.sentences), 0.0) - silent
        return (usual * PACE_PRIOR_S + _seconds(self.voiced)) / (PACE_PRIOR_S + written_s)

    def add_sentence(self, sentence: Sentence, say: SpeakFunction, speed_factor: float = 1.0) -> None:
        """Synthesize a sentence, faster than usual by a factor."""
        start_s, joint = self.at_s, 0
        voice = replace(self.voice, rate_wpm=round(self.voice.rate_wpm * speed_factor))
        for phrase in split_phrases(sentence.parts):
            if isinstance(phrase, Phrase):
                self.at += joint
                self._sound(speak_phrase(say, phrase, voice))
                joint = round(PHRASE_GAP_S * ESPEAK_SAMPLE_RATE)
            else:
                self._silence(phrase)
                joint = 0
        self.spans.append(Span(start_s, self.voiced[-1].end_s, sentence.kind))
        self.sentences.append(sentence)

    def add_pause(self, pause: Pause) -> None:
        """Append a silence to the last sentence."""
        last = self.sentences[-1]
        self.sentences[-1] = Sentence(last.text, last.kind, (*last.parts, pause))
        self._silence(pause)

    def _silence(self, pause: Pause) -> None:
        start_s = self.at_s
        self.at += round(pause.seconds * ESPEAK_SAMPLE_RATE)
        self.pauses.append(Span(start_s, self.at_s, pause.kind))

    def _sound(self, phrase: SpokenPhrase) -> None:
        start_s = self.at_s
        self.pieces.append((self.at, phrase.sound))
        self.at += len(phrase.sound)
        self.voiced.append(Span(start_s, self.at_s))
        self.words += [Span(start_s + each.start_s, start_s + each.end_s, each.label) for each in phrase.words]
        self.phonemes += [_moved(each, start_s) for each in phrase.phonemes]
        self.fillers += [Span(start_s, self.at_s, phrase.filler)] * bool(phrase.filler)

    def waveform(self, samples: int) -> Float[ndarray, " N"]:
        """The track at 16 kHz with a fixed RMS level of speech, reduced only to avoid clipping."""
        import soxr

        sound = np.zeros(samples)
        for start, piece in self.pieces:
            sound[start : start + len(piece)] = piece
        power = sum(float(piece @ piece) for _, piece in self.pieces) / sum(len(piece) for _, piece in self.pieces)
        gain = LEVEL_RMS * 10 ** (self.voice.level_db / 20) / np.sqrt(power)
        sound *= min(gain, PEAK / max(float(sound.max()), -float(sound.min())))
        resampled = soxr.resample(sound, ESPEAK_SAMPLE_RATE, SAMPLE_RATE, quality="HQ")
        return np.asarray(resampled[: len(resampled) // 640 * 640], np.float32)


def _moved(phoneme: Phoneme, by_s: float) -> Phoneme:
    start_s, end_s = by_s + phoneme.start_s, by_s + phoneme.end_s
    return Phoneme(start_s, end_s, phoneme.symbol, phoneme.stressed, phoneme.prominence)


def _talk(
    speaker_voices: DialogueVoices, seconds: float, rng: np.random.Generator, partition: TextPartition
) -> SynthesizedSpeech:
    """Synthesize turns that fill a duration; the final silence adjusts the total."""
    before_s, after_s = rng.uniform(*EDGE_SILENCE_S, size=2)
    track = VoiceTrack(speaker_voices.speaker)
    partner = VoiceTrack(speaker_voices.partner) if speaker_voices.partner else None
    at_s = before_s
    for who, end_s in _turns(track, partner, before_s, seconds - after_s, rng):
        who.at = round(at_s * ESPEAK_SAMPLE_RATE)
        _turn(who, end_s, rng, partition)
        at_s = who.at_s + _sample_turn_gap_s(rng)
    end_s = max(each.at_s for each in (track, partner) if each)
    silence_s = min(max(seconds - end_s, EDGE_SILENCE_S[0]), EDGE_SILENCE_S[1])
    return _spoken(track, partner, end_s + silence_s)


def _turns(
    track: VoiceTrack, partner: VoiceTrack | None, start_s: float, end_s: float, rng: np.random.Generator
) -> list[tuple[VoiceTrack, float]]:
    """Turns and their end times: one speaker, or two alternating with a random first."""
    if partner is None:
        return [(track, end_s)]
    count = max(2, round((end_s - start_s) / TURN_S))
    first = int(rng.integers(2))
    who = [(track, partner)[(first + index) % 2] for index in range(count)]
    part = np.exp(TURN_SPREAD * rng.standard_normal(count)) * [SPEAKER_TURN_WEIGHT if w is track else 1.0 for w in who]
    ends = start_s + (end_s - start_s) * np.cumsum(part) / part.sum()
    return [(each, float(end)) for each, end in zip(who, ends, strict=True)]


def _turn(track: VoiceTrack, end_s: float, rng: np.random.Generator, partition: TextPartition) -> None:
    """Add sentences until a time, at least one."""
    start_s = track.at_s
    with espeak_engine(track.voice.espeak_voice) as say:
        while True:
            remaining_s = end_s - track.at_s
            sentence = write_sentence(track.voice.language, remaining_s, rng, partition, track.pace)
            pause = sentence.parts[-1]
            sentence = without_last_pause(sentence)
            needed_s = estimated_duration_s(sentence, track.pace)
            speed_factor = needed_s / max(remaining_s, 0.1) if remaining_s - needed_s < MIN_NEXT_SENTENCE_S else 1.0
            track.add_sentence(sentence, say, min(max(speed_factor, MIN_SPEED_FACTOR), MAX_SPEED_FACTOR))
            if not isinstance(pause, Pause) or end_s - track.at_s - pause.seconds < SHORTEST_SENTENCE_S:
                break
            track.add_pause(pause)
    track.turns.append(Span(start_s, track.at_s))


def _sample_turn_gap_s(rng: np.random.Generator) -> float:
    median_s, sigma, shortest_s, longest_s = TURN_GAP_S
    return float(min(max(rng.lognormal(np.log(median_s), sigma), shortest_s), longest_s))


def _spoken(track: VoiceTrack, partner: VoiceTrack | None, seconds: float) -> SynthesizedSpeech:
    samples = -(-round(seconds * ESPEAK_SAMPLE_RATE) // FRAME_SAMPLES) * FRAME_SAMPLES
    sound = track.waveform(samples)
    annotation = Annotation(
        words=tuple(track.words),
        phonemes=tuple(track.phonemes),
        speaking=_merged(track.voiced),
        listening=tuple(partner.turns) if partner else (),
        pauses=tuple(track.pauses),
        fillers=tuple(track.fillers),
        sentences=tuple(track.spans),
        partner=_merged(partner.voiced) if partner else (),
    )
    annotation = with_loudness(annotation, sound)
    if partner is None:
        return SynthesizedSpeech(sound, annotation, track.script)
    return SynthesizedSpeech(sound, annotation, track.script, partner.waveform(samples), partner.script)


def _seconds(spans: Sequence[Span]) -> float:
    return sum((span.end_s - span.start_s for span in spans), 0.0)


def _merged(voiced: Sequence[Span]) -> tuple[Span, ...]:
    """Merge spans of speech separated by gaps below SPEAKING_GAP_S."""
    spans: list[Span] = []
    for each in voiced:
        if spans and each.start_s - spans[-1].end_s < SPEAKING_GAP_S:
            spans[-1] = Span(spans[-1].start_s, each.end_s)
        else:
            spans.append(each)
    return tuple(spans)
