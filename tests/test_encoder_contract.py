"""Contract of speech encoders: packaged Moonshine, wav2vec 2.0, HuBERT (random weights on disk), log-mel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from talkingeyes.audio.encoder import PROSODY_CHANNELS, EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.prosody import energy_dbfs
from talkingeyes.audio.speech_boundaries import BOUNDARY_CHANNELS
from talkingeyes.audio.waveform import frame_count, read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section

PROSODY = {
    "f0_min_hz": 60.0,
    "f0_max_hz": 450.0,
    "yin_threshold": 0.25,
    "energy_window_s": 0.05,
    "energy_floor_dbfs": -80.0,
}
FAMILIES = ("moonshine", "wav2vec2", "hubert", "logmel")
APPENDED = len(PROSODY_CHANNELS) + len(BOUNDARY_CHANNELS)
SIZES = {"moonshine": 288, "wav2vec2": 16, "hubert": 16, "logmel": 80}


def section(encoder: dict[str, Any]) -> EmbedSettings:
    node = {"encoder": encoder, "prosody": PROSODY, "level_dbfs": -20.0}
    return validate_section("embed", EmbedSettings, node)


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Small models with random weights, saved in the format that users provide."""
    import torch
    from transformers import HubertConfig, HubertModel, Wav2Vec2Config, Wav2Vec2Model

    torch.manual_seed(0)
    small = {
        "hidden_size": 16,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "intermediate_size": 32,
        "conv_dim": [8] * 7,
        "num_conv_pos_embeddings": 8,
        "num_conv_pos_embedding_groups": 2,
    }
    folder = tmp_path_factory.mktemp("checkpoints")
    Wav2Vec2Model(Wav2Vec2Config(**small)).save_pretrained(folder / "wav2vec2")
    HubertModel(HubertConfig(**small)).save_pretrained(folder / "hubert")
    return {name: str(folder / name) for name in ("wav2vec2", "hubert")}


def family(name: str, checkpoints: dict[str, str], window_s: float = 10.0) -> SpeechEncoder:
    windows = {"window_s": window_s, "overlap_s": 2.0}
    encoders: dict[str, dict[str, Any]] = {
        "moonshine": {"kind": "moonshine", **windows},
        "wav2vec2": {"kind": "wav2vec2", "layer": 2, "checkpoint": checkpoints["wav2vec2"], **windows},
        "hubert": {"kind": "hubert", "layer": 1, "checkpoint": checkpoints["hubert"], **windows},
        "logmel": {"kind": "logmel", "bands": 80, "window_s": 0.05, "windows_per_frame": 1},
    }
    return make_encoder(section(encoders[name]))


@pytest.fixture(scope="module", params=FAMILIES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def encoder(name: str, checkpoints: dict[str, str]) -> SpeechEncoder:
    return family(name, checkpoints)


@pytest.fixture(scope="module")
def speech() -> np.ndarray:
    return read_speech(package_file(EXAMPLE_SPEECH))


@pytest.mark.parametrize("seconds", [0.3, 1.0, 2.345])
@pytest.mark.parametrize("fps", [12.0, 25.0, 29.97, 240.0])
def test_one_finite_row_a_frame(
    encoder: SpeechEncoder, name: str, speech: np.ndarray, seconds: float, fps: float
) -> None:
    sound = speech[16_000 : 16_000 + round(seconds * 16_000)]
    features = encoder(sound, fps)
    assert features.shape == (frame_count(len(sound), fps), SIZES[name] + APPENDED)
    assert features.dtype == np.float32
    assert np.isfinite(features).all()


def test_channels_have_names(encoder: SpeechEncoder, name: str) -> None:
    assert len(set(encoder.channels)) == SIZES[name] + APPENDED
    assert encoder.channels[-APPENDED:] == (*PROSODY_CHANNELS, *BOUNDARY_CHANNELS)
    assert all(channel.startswith(name) for channel in encoder.channels[:-APPENDED])


def test_the_same_sound_gives_the_same_features(
    encoder: SpeechEncoder, name: str, checkpoints: dict[str, str], speech: np.ndarray
) -> None:
    features = encoder(speech[:48_000], 25.0)
    np.testing.assert_array_equal(encoder(speech[:48_000], 25.0), features)
    np.testing.assert_array_equal(family(name, checkpoints)(speech[:48_000], 25.0), features)


def test_level_does_not_matter(encoder: SpeechEncoder, speech: np.ndarray) -> None:
    """The packaged model is quantised dynamically, so it has rounding differences; all others are nearly equal."""
    features, quiet = (encoder(sound, 25.0) for sound in (speech[:48_000], speech[:48_000] * 0.05))
    np.testing.assert_allclose(quiet[:, -3:], features[:, -3:], atol=1e-3)
    assert np.corrcoef(quiet[:, :-3].ravel(), features[:, :-3].ravel())[0, 1] > 0.999


def test_digital_silence_is_finite(encoder: SpeechEncoder) -> None:
    assert np.isfinite(encoder(np.zeros(16_000, np.float32), 25.0)).all()


def test_features_are_aligned_in_time(encoder: SpeechEncoder, speech: np.ndarray) -> None:
    """Linear prediction of the energy at a lag is best at lag 0, to within a frame of 20 ms, on held-out sound."""
    fps = 50.0
    features = encoder(speech, fps)[:, :-3]
    features = (features - features.mean(axis=0)) / (features.std(axis=0) + 1e-6)
    half = len(features) // 2
    fitted, unseen = features[:half], features[half:]
    lags = range(-5, 6)
    read = []
    for lag in lags:
        times_s = np.clip((np.arange(len(features)) + lag) / fps, 0, len(speech) / 16_000 - 0.1)
        energy = energy_dbfs(speech, times_s, 0.03, -50.0)
        energy -= energy.mean()
        weights = np.linalg.solve(fitted.T @ fitted + 100 * np.eye(fitted.shape[1]), fitted.T @ energy[:half])
        read.append(np.corrcoef(unseen @ weights, energy[half:])[0, 1])
    assert abs(lags[int(np.argmax(read))]) <= 1


def test_long_sound_is_like_short_sound(
    encoder: SpeechEncoder, name: str, checkpoints: dict[str, str], speech: np.ndarray
) -> None:
    """60 s in windows compared with the longest possible windows, and no jump between windows.

    The features of a transformer depend on the context of a frame; log-mel does not.
    """
    sound = np.concatenate([speech, speech])[: 60 * 16_000]
    short, long = encoder(sound, 25.0), family(name, checkpoints, window_s=30.0)(sound, 25.0)
    spread = long.std(axis=0) + 1e-6
    correlation = np.mean((short - short.mean(0)) * (long - long.mean(0)), axis=0) / (short.std(0) + 1e-6) / spread
    assert correlation.mean() > 0.85
    if name == "logmel":
        np.testing.assert_array_equal(short, long)
    step = np.linalg.norm(np.diff(short / spread, axis=0)[:, :-3], axis=1)
    for start_s in range(8, 50, 8):
        seam = step[start_s * 25 - 5 : (start_s + 2) * 25 + 5]
        assert seam.mean() < 1.3 * step.mean()
        assert seam.max() <= step.max()


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ({"kind": "mfcc"}, "kind.*mfcc"),
        (
            {"kind": "logmel", "bands": 4, "window_s": 0.05, "windows_per_frame": 1},
            "bands.*greater than or equal to 8, got 4",
        ),
        ({"kind": "logmel", "bands": 80, "window_s": 0.05, "windows_per_frame": 1, "layer": 3}, "layer.*not permitted"),
        ({"kind": "moonshine", "window_s": 1.0, "overlap_s": 2.0}, "window_s.*greater than or equal to 6, got 1"),
    ],
)
def test_settings_errors_name_key_and_value(node: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        section(node)


def test_mismatched_checkpoint_is_an_error(
    checkpoints: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    node = {"kind": "hubert", "layer": 1, "window_s": 10.0, "overlap_s": 2.0}
    for checkpoint, layer, words in [
        (checkpoints["wav2vec2"], 1, "should be a hubert model, got wav2vec2"),
        (checkpoints["hubert"], 3, "should be at most 2, got 3"),
        (str(tmp_path), 1, "local folder or a hub name"),
        (str(tmp_path / "none"), 1, "local folder or a hub name"),
    ]:
        with pytest.raises(InputError, match=words) as caught:
            make_encoder(section({**node, "checkpoint": checkpoint, "layer": layer}))
        assert "\n" not in str(caught.value)
