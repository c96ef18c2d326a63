"""Speech from text by the installed synthesiser: times of words and phonemes, reproducible bytes, errors."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import call
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_model import toy_model

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.workflows import speak as speech
from talkingeyes.workflows.speak import parse_script, speak

TEXT = "Well, um, how are you today? I was thinking - no, dreaming - about Rome!"


def test_words_and_phonemes_have_their_times() -> None:
    spoken = speak(TEXT)
    seconds = len(spoken.sound) / 16_000
    words = [word.label for word in spoken.annotation.words]
    assert words[:2] + words[-2:] == ["Well", "um", "about", "Rome"]
    assert [span.label for span in spoken.annotation.sentences] == ["question", "statement"]
    assert [span.label for span in spoken.annotation.fillers] == ["um"]
    assert [span.label for span in spoken.annotation.pauses] == [
        "comma",
        "comma",
        "sentence",
        "comma",
        "comma",
        "comma",
    ]
    starts = [phoneme.start_s for phoneme in spoken.annotation.phonemes]
    assert starts == sorted(starts)
    assert 3.0 < seconds < 9.0
    for word in spoken.annotation.words:
        inside = spoken.sound[int(word.start_s * 16_000) : int(word.end_s * 16_000)]
        assert np.sqrt(np.mean(inside**2)) > 0.01, word
    for pause in spoken.annotation.pauses:
        inside = spoken.sound[int((pause.start_s + 0.02) * 16_000) : int((pause.end_s - 0.02) * 16_000)]
        assert np.abs(inside).max() < 0.01, pause


def test_the_same_text_and_voice_give_the_same_bytes() -> None:
    one, between, again = speak(TEXT, voice="en-us+m3"), speak("Hallo.", language="de"), speak(TEXT, voice="en-us+m3")
    assert one.sound.tobytes() == again.sound.tobytes()
    assert between.voice.startswith("de+")
    assert speak(TEXT, voice="en-us+f1").sound.tobytes() != one.sound.tobytes()


def test_file_has_the_synthesised_sound(tmp_path: Path) -> None:
    spoken = speak("Hello there.")
    spoken.save(tmp_path / "a.wav")
    np.testing.assert_array_equal(read_speech(tmp_path / "a.wav"), spoken.sound)
    assert Annotation.load(tmp_path / "a.json") == spoken.annotation


def test_emotion_changes_the_voice() -> None:
    calm, sad = speak(TEXT), speak(TEXT, emotion="sad", intensity=3)
    assert len(sad.sound) > 1.1 * len(calm.sound)
    assert (sad.annotation.emotion, sad.annotation.intensity) == ("sad", 3)
    with pytest.raises(InputError, match="emotion: should be one of neutral, happy"):
        speak(TEXT, emotion="bored", intensity=1)


@pytest.mark.parametrize("language", ["en", "fr", "de", "es", "it", "pt", "nl"])
def test_every_language_has_a_voice(language: str) -> None:
    spoken = speak("Maria, 21.", language=language)
    assert speech.select_voice(spoken.voice, None).language == language
    assert len(spoken.annotation.phonemes) > 8


@given(st.text(max_size=60))
@settings(max_examples=60)
def test_any_text_is_a_script_or_one_line(text: str) -> None:
    try:
        script = parse_script(text, "en")
    except InputError as error:
        assert "\n" not in str(error)
        return
    assert script.sentences
    assert all(re.search(r"\w", part.text) for part in script.parts if hasattr(part, "text"))


@pytest.mark.parametrize("text", ["\N{GRINNING FACE}", "...", "", " \n ", "a\0b", "x" * 50_001])
def test_unspeakable_text_is_one_line_error(text: str) -> None:
    with pytest.raises(InputError, match=r"^text: should [^\n]*$"):
        speak(text)


def test_missing_synthesiser_is_one_line_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speech, "find_spec", lambda _: None)
    with pytest.raises(InputError, match="should have the package espeakng-loader"):
        speak("Hello.")


def test_animate_speaks_and_keeps_the_speech_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    toy_model(tmp_path / "toy")
    words = ["animate", "--text", "Hello, who is there?", "--voice", "en-gb-scotland+f2", "-o", "out", "--model", "toy"]
    assert call(*words, "--samples", "1", "--no-previews") == 0
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["manifest.json", "sample_00.events.json", "sample_00.npz", "speech.json", "speech.wav"]
    phonemes = json.loads((tmp_path / "out" / "speech.json").read_text())["phonemes"]
    assert [each["symbol"] for each in phonemes][:2] == ["h", "@"]
