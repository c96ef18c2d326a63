"""Synthetic voices: reproducible bytes, times that match the sound, level, pauses."""

import re
from itertools import pairwise

import numpy as np
import pytest
from jaxtyping import Float
from joblib import Parallel, delayed
from numpy import ndarray
from toy_scripts import write_script

from talkingeyes.audio.annotation import EMOTIONS
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.synthesis.phrases import NUCLEUS
from talkingeyes.synthesis.speech_synthesis import (
    DialogueVoices,
    SynthesizedSpeech,
    synthesize_conversation,
    synthesize_script,
)
from talkingeyes.synthesis.text import Filler, Pause, Script, Sentence, Word
from talkingeyes.synthesis.voice_profiles import ACCENTS, EMOTION_PROSODY, VARIANTS, Voice, apply_emotion, sample_voice

pytest.importorskip("espeakng_loader")
VOICES = [sample_voice(np.random.default_rng([1, i]), "en" if i % 4 else "fr") for i in range(12)]


def script_of(*parts: Word | Filler | Pause) -> Script:
    text = " ".join(part.text for part in parts if isinstance(part, Word))
    return Script("en", (Sentence(text, "statement", parts),))


def words_of(text: str) -> list[Word]:
    return [Word(word) for word in text.split()]


def level_db(spoken: SynthesizedSpeech, start_s: float, end_s: float) -> float:
    sound = spoken.sound[round(start_s * SAMPLE_RATE) : round(end_s * SAMPLE_RATE)]
    return float(10 * np.log10(np.mean(sound.astype(float) ** 2) + 1e-12))


def pitch_hz(sound: Float[ndarray, " N"]) -> float:
    """Median F0 by autocorrelation over clearly voiced frames."""
    found = []
    for start in range(0, len(sound) - 1024, 640):
        frame = sound[start : start + 1024].astype(float)
        if np.sqrt(np.mean(frame**2)) < 0.02:
            continue
        likeness = np.correlate(frame, frame, "full")[1023:]
        lag = 40 + int(np.argmax(likeness[40:280]))
        if likeness[lag] > 0.6 * likeness[0]:
            found.append(SAMPLE_RATE / lag)
    return float(np.median(found))


@pytest.fixture(scope="module")
def spoken() -> list[tuple[Script, SynthesizedSpeech]]:
    scripts = [write_script(voice.language, 8.0, np.random.default_rng([2, i])) for i, voice in enumerate(VOICES)]
    return [(script, synthesize_script(script, voice)) for script, voice in zip(scripts, VOICES, strict=True)]


def test_same_script_and_voice_give_the_same_bytes_in_any_order(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    for (script, first), voice in reversed(list(zip(spoken, VOICES, strict=True))):
        again = synthesize_script(script, voice)
        assert again.sound.tobytes() == first.sound.tobytes()
        assert again.annotation == first.annotation


def test_same_bytes_in_worker_processes(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    items = [(script, voice) for (script, _), voice in zip(spoken, VOICES, strict=True)]
    for other, (_, first) in zip(
        Parallel(n_jobs=2)(delayed(synthesize_script)(*item) for item in items), spoken, strict=True
    ):
        assert other.sound.tobytes() == first.sound.tobytes()


def test_sound_is_whole_frames_at_one_level_without_clipping(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    for _, each in spoken:
        assert each.sound.dtype == np.float32
        assert len(each.sound) % 640 == 0
        assert np.abs(each.sound).max() < 1
        speech = [
            each.sound[round(s.start_s * SAMPLE_RATE) : round(s.end_s * SAMPLE_RATE)] for s in each.annotation.speaking
        ]
        assert 10 * np.log10(np.mean(np.concatenate(speech).astype(float) ** 2)) == pytest.approx(-23, abs=1.5)


def test_pauses_are_the_scripts_and_silent(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    for script, each in spoken:
        pauses = [part for part in script.parts if isinstance(part, Pause)]
        assert [pause.label for pause in each.annotation.pauses] == [pause.kind for pause in pauses]
        for span, pause in zip(each.annotation.pauses, pauses, strict=True):
            assert span.end_s - span.start_s == pytest.approx(pause.seconds, abs=1e-4)
            assert level_db(each, span.start_s + 0.005, span.end_s - 0.005) < -70


def test_stressed_vowels_are_loud_and_edges_silent(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    for _, each in spoken:
        first, last = each.annotation.speaking[0].start_s, each.annotation.speaking[-1].end_s
        assert 0.2 <= first <= 0.61 and 0.2 <= each.seconds - last <= 0.65
        assert max(level_db(each, 0, first - 0.005), level_db(each, last + 0.005, each.seconds)) < -70
        stressed = [level_db(each, p.start_s, p.end_s) for p in each.annotation.phonemes if p.stressed]
        assert len(stressed) >= 5
        assert min(stressed) > -35 and np.median(stressed) > -26


def test_words_and_phonemes_are_complete_and_in_order(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    for script, each in spoken:
        said = re.findall(r"[\w'-]+", script.text)
        assert re.findall(r"[\w'-]+", " ".join(word.label for word in each.annotation.words)) == said
        for spans in (each.annotation.words, each.annotation.phonemes):
            times = [time for span in spans for time in (span.start_s, span.end_s)]
            assert all(a <= b + 1e-9 for a, b in pairwise(times))
            assert all(type(time) is float for time in times)
        assert not any(p.symbol.startswith(("_", "'", ",")) for p in each.annotation.phonemes)


def test_word_onsets_match_the_hiss_of_their_first_sound() -> None:
    """An s has energy above 4.5 kHz and a nasal has not, so its onset can be measured in the sound."""
    from scipy import signal

    script = script_of(*words_of("When ten signs and nine sons seem in seven salons, then some sang."))
    high = signal.butter(4, 4500, "high", fs=SAMPLE_RATE, output="sos")
    smooth = signal.butter(2, 60, fs=SAMPLE_RATE, output="sos")
    for voice in (voice for voice in VOICES if voice.language == "en"):
        each = synthesize_script(script, voice)
        hiss = signal.sosfiltfilt(smooth, signal.sosfiltfilt(high, each.sound.astype(float)) ** 2)
        onsets = [word.start_s for word in each.annotation.words if word.label in {"signs", "seem", "seven", "some"}]
        assert len(onsets) == 4
        for onset_s in onsets:
            start = round((onset_s - 0.06) * SAMPLE_RATE)
            near = hiss[start : start + round(0.16 * SAMPLE_RATE)]
            rise_s = (start + int(np.argmax(near > 0.25 * near.max()))) / SAMPLE_RATE
            assert abs(rise_s - onset_s) < 0.03


def test_runs_of_speech_end_at_pauses_of_a_quarter_second() -> None:
    script = script_of(
        *words_of("We saw it,"), Pause("comma", 0.2), *words_of("and then"), Pause("hesitation", 0.3), Filler("um"),
        Pause("hesitation", 0.6), *words_of("went home."),
    )  # fmt: skip
    annotation = synthesize_script(script, VOICES[1]).annotation
    assert len(annotation.speaking) == 3
    assert [filler.label for filler in annotation.fillers] == ["um"]
    assert annotation.speaking[1].start_s == annotation.fillers[0].start_s
    assert 0.15 < annotation.fillers[0].end_s - annotation.fillers[0].start_s < 0.8


def test_joins_do_not_click(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    for _, each in spoken:
        for pause in each.annotation.pauses:
            for edge in (round(pause.start_s * SAMPLE_RATE), round(pause.end_s * SAMPLE_RATE)):
                assert np.abs(np.diff(each.sound[edge - 8 : edge + 8])).max() < 0.02


def test_voices_differ_in_pitch() -> None:
    script = script_of(*words_of("My young cousin will borrow a yellow umbrella."))
    pitches = [pitch_hz(synthesize_script(script, Voice("", "en", f"en-us+{v}", 170, 50, 50)).sound) for v in VARIANTS]
    assert max(pitches) > 1.8 * min(pitches)
    assert all(70 < pitch < 320 for pitch in pitches)
    low, high = (
        pitch_hz(synthesize_script(script, Voice("", "en", "en-us+m1", 170, pitch, 50)).sound) for pitch in (30, 70)
    )
    assert high > 1.15 * low


def test_emotions_change_the_voice_as_in_the_literature() -> None:
    script = script_of(*words_of("My young cousin will borrow a yellow umbrella near the old library."))
    voice = Voice("", "en", "en-us+m1", 170, 50, 50)
    plain = synthesize_script(script, voice)

    def against_plain(emotion: str, intensity: int) -> tuple[float, float, float]:
        """Rate, pitch and level relative to the neutral voice."""
        each = synthesize_script(script, apply_emotion(voice, emotion, intensity))
        spans = (spoken.annotation.sentences[0] for spoken in (plain, each))
        usual_s, own_s = (span.end_s - span.start_s for span in spans)
        level = float(np.abs(each.sound).mean() * len(each.sound) / np.abs(plain.sound).sum() * usual_s / own_s)
        return usual_s / own_s, pitch_hz(each.sound) / pitch_hz(plain.sound), level

    angry, sad = against_plain("angry", 3), against_plain("sad", 3)
    assert min(angry) > 1.04 and max(sad) < 0.96
    weak, medium = against_plain("sad", 1), against_plain("sad", 2)
    assert sad[0] < medium[0] < weak[0] < 1.01 and sad[2] < medium[2] < weak[2] < 1.01
    happy = against_plain("happy", 3)
    assert happy[1] > 1.08 and apply_emotion(voice, "happy", 3).pitch_range > voice.pitch_range
    assert apply_emotion(voice, "neutral", 0) == voice
    assert set(EMOTION_PROSODY) == set(EMOTIONS)


def test_unknown_emotion_is_refused() -> None:
    with pytest.raises(InputError, match=r"one of neutral, happy, .*, got 'bored'"):
        apply_emotion(VOICES[0], "bored", 1)


def test_two_people_speak_by_turns() -> None:
    for number in range(4):
        rng = np.random.default_rng([9, number])
        speaker_voices = DialogueVoices(sample_voice(rng, "en"), sample_voice(rng, "en"))
        each = synthesize_conversation(speaker_voices, 20.0, 24.0, rng)
        assert each.partner is not None and each.partner_script is not None
        assert 20.0 <= each.seconds <= 24.0 and each.partner.shape == each.sound.shape
        known = each.annotation
        turns = sorted([*known.speaking, *known.partner], key=lambda span: span.start_s)
        assert all(a.end_s <= b.start_s + 1e-9 for a, b in pairwise(turns))  # no interruptions
        assert all(
            any(turn.start_s <= p.start_s and p.end_s <= turn.end_s for turn in known.listening) for p in known.partner
        )
        assert set(each.sentences) == set(each.script.sentences_text) | set(each.partner_script.sentences_text)


def test_long_talk_keeps_to_its_length() -> None:
    each = synthesize_conversation(DialogueVoices(VOICES[1]), 58.0, 62.0, np.random.default_rng(3))
    assert 58.0 <= each.seconds <= 62.0 and each.partner is None and not each.annotation.listening


def test_sentences_have_times_and_kinds(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    for script, each in spoken:
        spans = each.annotation.sentences
        assert [span.label for span in spans] == [sentence.kind for sentence in script.sentences]
        assert all(a.end_s <= b.start_s for a, b in pairwise(spans))
        for word in each.annotation.words:
            assert any(span.start_s <= word.start_s and word.end_s <= span.end_s + 1e-9 for span in spans)


def test_prominence_is_of_stressed_vowels_and_goes_by_loudness(spoken: list[tuple[Script, SynthesizedSpeech]]) -> None:
    loud, prominent = [], []
    for _, each in spoken:
        phonemes = each.annotation.phonemes
        assert all(0.0 <= p.prominence <= 1.0 and (p.stressed or p.prominence == 0.0) for p in phonemes)
        loud += [p.loudness for p in phonemes if p.stressed]
        prominent += [p.prominence for p in phonemes if p.stressed]
    assert 0.3 < np.mean(np.array(prominent) > 0.5) < 0.8
    by_level = np.array(prominent) != NUCLEUS  # the last stressed phoneme of a phrase is prominent at any level
    assert np.corrcoef(np.log(loud)[by_level], np.array(prominent)[by_level])[0, 1] > 0.4


@pytest.mark.parametrize("language", ACCENTS)
def test_every_language_is_spoken(language: str) -> None:
    rng = np.random.default_rng(6)
    each = synthesize_conversation(DialogueVoices(sample_voice(rng, language)), 8.0, 9.6, rng)
    said = re.findall(r"[\w'-]+", each.text)
    words = each.annotation.clipped(each.seconds).words
    assert re.findall(r"[\w'-]+", " ".join(word.label for word in words)) == said
    assert sum(p.stressed for p in each.annotation.phonemes) >= 4


def test_a_clip_is_cut_out_of_a_conversation_at_a_random_place() -> None:
    rng = np.random.default_rng(7)
    made = [synthesize_conversation(DialogueVoices(VOICES[0]), 4.0, 5.0, rng) for _ in range(40)]
    spoken_at_start = [any(span.start_s < 0.0 < span.end_s for span in each.annotation.speaking) for each in made]
    spoken_at_end = [any(s.start_s < each.seconds < s.end_s for s in each.annotation.speaking) for each in made]
    assert 0.5 <= np.mean(spoken_at_start) <= 0.95 and 0.5 <= np.mean(spoken_at_end) <= 0.95
    before_s = [-min(each.annotation.speaking[0].start_s, 0.0) for each in made]
    assert 2.0 <= np.mean(before_s) <= 4.0 and max(before_s) <= 6.0
    for each in made:
        inside = each.annotation.clipped(each.seconds)
        assert all(0.0 <= span.start_s < span.end_s <= each.seconds for span in (*inside.words, *inside.speaking))
        silent = np.ones(len(each.sound), dtype=bool)
        for span in inside.speaking:
            silent[int(span.start_s * SAMPLE_RATE) : int(np.ceil(span.end_s * SAMPLE_RATE))] = False
        assert np.abs(each.sound[silent]).max(initial=0.0) < 0.1 * np.abs(each.sound).max()


def test_sampled_voices_are_diverse() -> None:
    rng = np.random.default_rng(4)
    voices = [sample_voice(rng, "en") for _ in range(300)]
    assert len({voice.name for voice in voices}) >= 299
    assert len({voice.espeak_voice for voice in voices}) > 80


def test_speak_about_keeps_to_the_length() -> None:
    rng = np.random.default_rng(5)
    for voice in VOICES[:6]:
        each = synthesize_conversation(DialogueVoices(voice), 8.0, 9.6, rng)
        assert 8.0 <= each.seconds <= 9.6


@pytest.mark.parametrize("name", ["en-us+nobody", "tlh-xx+f1", "", "en-us+"])
def test_unknown_voice_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"such as en-us+f3, got {name!r}")) as caught:
        synthesize_script(script_of(*words_of("Hello there.")), Voice("", "en", name, 170, 50, 50))
    assert "\n" not in str(caught.value)


def test_unknown_language_is_refused() -> None:
    with pytest.raises(InputError, match="one of en, fr, de, es, it, pt, nl, got 'xx'"):
        sample_voice(np.random.default_rng(0), "xx")
