"""Face models: style, codes over frames or channels, sampling, both training stages, baselines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from toy_faces import BASIS, NAMES, data, faces

from talkingeyes.core.errors import InputError
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.emotion_mean import EmotionMeans, EmotionMeanSettings
from talkingeyes.models.face.style import FaceStyle, StyleKey, StyleVocabulary, clip_style
from talkingeyes.models.face.vqvae import FaceVQVAE, FaceVQVAESettings, merge_codes, split_codes
from talkingeyes.models.layers import attention
from talkingeyes.models.layers.attention import WindowAttention
from talkingeyes.models.layers.correlated_noise import correlated_normal
from talkingeyes.models.speech_to_face import SpeechToFace
from talkingeyes.training import checkpoint
from talkingeyes.training.baseline_checkpoint import save_baseline
from talkingeyes.training.face_generators import TrainedFaceGenerator, face_config, face_space, load_face_generator
from talkingeyes.training.face_task import FaceTask, FaceTaskSettings, speed_ratio
from talkingeyes.training.face_tokenizer import (
    FaceTokenizer,
    FaceTokenizerSettings,
    FaceTokenizerTask,
    face_tokenizer_config,
    load_face_tokenizer,
)
from talkingeyes.training.loop import train
from talkingeyes.training.model_folder import is_face_model
from talkingeyes.training.resume import ResumeFile
from talkingeyes.training.windows import WindowSettings

LOOP = {
    "steps": 40, "batch": 6, "learning_rate": 5e-3, "schedule": "one-cycle", "weight_decay": 0.0, "clip_norm": 1.0,
    "validate_every": 20,
}  # fmt: skip
BOTH_WAYS = {"width": 16, "layers": 1, "heads": 2, "dropout": 0.0, "lookback": 8, "lookahead": 8, "kernel": 3}
CAUSAL = {"width": 16, "layers": 1, "heads": 2, "dropout": 0.0, "lookback": 8}
QUANTISER = {"kind": "codebook", "codes": 16, "width": 8, "commitment": 0.25, "decay": 0.9, "restart_below": 0.1}
AUTOREGRESSION = {"transformer": CAUSAL, "speech_lookback": 3, "speech_lookahead": 3, "own_history_fraction": 0.5}
DIFFUSION = {"kind": "diffusion", "width": 16, "layers": 1, "dropout": 0.0, "diffusion_steps": 20}
GENERATORS: dict[str, dict[str, Any]] = {
    "latent": {"kind": "latent", "transformer": BOTH_WAYS, "correlation_frames": 5},
    "latent_vae": {"kind": "latent", "transformer": BOTH_WAYS, "correlation_frames": 1},
    "ddpm": {**DIFFUSION, "sampling_steps": 20, "eta": 1.0},
    "ddim": {**DIFFUSION, "sampling_steps": 5, "eta": 0.0},
    "autoregression": {"kind": "autoregression", **AUTOREGRESSION},
    "autoregressive_codes": {"kind": "autoregressive_codes", **AUTOREGRESSION},
    "causal": {"kind": "causal", "layers": 2, "dropout": 0.0},
}
OF_CODES = ("latent", "autoregressive_codes")
HAPPY, ANGRY = FaceStyle("a", "happy", 2), FaceStyle("a", "angry", 2)


def prior_settings(kind: str = "vq", layout: str = "frames", **changes: Any) -> FaceTokenizerSettings:
    vq = {"layout": layout, "quantiser": QUANTISER} if kind == "vq" else {}
    first = {"quantisation": 1.5} if kind == "vq" else {"divergence": 1e-4}
    return FaceTokenizerSettings.model_validate(
        {
            "kind": "face",
            "seed": 0,
            "network": {"kind": kind, "latent": 16, "encoder": BOTH_WAYS, "decoder": BOTH_WAYS, **vq},
            "weights": {**first, "expression": 0.5, "jaw": 0.1},
            "windows": {"frames": 40, "mirror": True},
            "loop": LOOP | changes,
        }
    )


def prior_of(settings: FaceTokenizerSettings) -> FaceTokenizerTask:
    task = FaceTokenizerTask(settings, faces(12, seed=1), faces(3, seed=2), BASIS)
    train(task, settings.loop, "tokenizer")
    task.fit_latent_statistics()
    return task


@pytest.fixture(scope="module")
def tokenizers() -> dict[str, FaceTokenizer]:
    made = {kind: prior_of(prior_settings(kind)) for kind in ("vq", "vae")}
    for task in made.values():
        task.module.freeze()
    return {kind: FaceTokenizer(task.settings.network, task.module, BASIS) for kind, task in made.items()}


def tokenizer_for(name: str, tokenizers: dict[str, FaceTokenizer]) -> FaceTokenizer | None:
    if name in OF_CODES:
        return tokenizers["vq"]
    return tokenizers["vae"] if name == "latent_vae" else None


def model_settings(name: str, **changes: Any) -> FaceTaskSettings:
    weights = {"expression": 0.15, "jaw": 0.1} | (
        {"latent": 1.0} if "latent" in name or name == "autoregressive_codes" else {}
    )
    return FaceTaskSettings.model_validate(
        {
            "kind": "speech_to_face",
            "parts": ["face"],
            "tokenizer": None,
            "speech": {"channels": None, "width": 16, "layers": 1, "dropout": 0.0, "channel_dropout": 0.0},
            "style": ["speaker", "emotion", "intensity"],
            "speaker_dropout": 0.1,
            "face": GENERATORS[name],
            "weights": weights,
            "temperature": 0.5,
            "windows": {"frames": 40, "mirror": False},
            "loop": LOOP | {"steps": 24, "validate_every": 8},
            "validation_clips": 1,
        }
        | changes
    )


# Style


def test_style_vector_is_one_hot_and_mean_for_unknown_speaker() -> None:
    known = StyleVocabulary(("a", "b", "c"))
    style_vector = known.style_vector(FaceStyle("b", "happy", 3))
    assert style_vector.tolist() == [0, 1, 0, *(1.0 if i == 1 else 0.0 for i in range(8)), 0, 0, 1]
    assert known.style_vector(FaceStyle(None, "neutral", 0))[:3].tolist() == pytest.approx([1 / 3] * 3)
    assert known.style_vector(FaceStyle("a", "neutral", 0))[-3:].tolist() == [0, 0, 0]
    assert known.columns(["intensity"]) == [11, 12, 13]
    assert known.columns([]) == []


@pytest.mark.parametrize(
    ("style", "line"),
    [
        (("a", "joyful", 1), r"^emotion: should be one of neutral, happy, .*contempt, got joyful$"),
        (("a", "happy", 4), r"^intensity: should be 1, 2 or 3 with happy, got 4$"),
        (("a", "happy", 0), r"^intensity: should be 1, 2 or 3 with happy, got 0$"),
        (("a", "neutral", 2), r"^intensity: should be 0 with a neutral face, got 2$"),
    ],
)
def test_unknown_style_is_an_error_with_the_choices(style: Any, line: str) -> None:
    with pytest.raises(InputError, match=line):
        FaceStyle(*style)


def test_style_changes_along_a_clip() -> None:
    known = StyleVocabulary(("a",))
    course = known.per_frame([StyleKey(2.0, ANGRY), StyleKey(0.0, HAPPY)], 100, 25.0)
    np.testing.assert_allclose(course[:51], np.repeat(known.style_vector(HAPPY)[None], 51, axis=0))
    np.testing.assert_allclose(course[63:], np.repeat(known.style_vector(ANGRY)[None], 37, axis=0))
    np.testing.assert_allclose(
        course[56], 0.52 * known.style_vector(HAPPY) + 0.48 * known.style_vector(ANGRY), atol=1e-6
    )


# Face parameters


def test_a_face_in_a_mirror_changes_sides_and_comes_back() -> None:
    face = BASIS.to_vector(np.array([[0.1, 0.2, 0.3, 0.4]]), np.array([[0.5, 0.6, 0.7]]))
    np.testing.assert_allclose(BASIS.mirrored(face), [[0.2, 0.1, 0.4, 0.3, 0.5, -0.6, -0.7]], rtol=1e-6)
    np.testing.assert_allclose(BASIS.mirrored(BASIS.mirrored(face)), face)
    flame = FaceBasis("flame", tuple(f"expression_{index}" for index in range(50)))
    assert flame.numbers == 53
    with pytest.raises(InputError, match=r"^windows\.mirror: should be false for flame"):
        flame.mirrored(np.zeros((1, 53), np.float32))


# Codes


@pytest.mark.parametrize("layout", ["frames", "channels"])
def test_splitting_codes_is_invertible(layout: Any) -> None:
    latents = torch.randn(2, 12, 16)
    torch.testing.assert_close(merge_codes(split_codes(latents, layout, 8), layout, 16), latents)


@pytest.mark.parametrize(("layout", "changed"), [("frames", 2), ("channels", 2 * 8)])
def test_number_of_codes_changed_by_one_frame(layout: Any, changed: int) -> None:
    """In the layout `frames` a frame has its own codes; in the released layout it affects every code of a clip."""
    settings = prior_settings(layout=layout).network
    assert isinstance(settings, FaceVQVAESettings)
    latents = torch.randn(1, 8, 16, generator=torch.Generator().manual_seed(0))
    other = latents.clone()
    other[:, 3] *= -5.0  # far enough to change the code for any weights
    before, after = (split_codes(each, layout, settings.quantiser.width) for each in (latents, other))
    assert int((before != after).any(-1).sum()) == changed
    network = FaceVQVAE(settings, BASIS.numbers).eval()
    noise = torch.zeros(1, 8, 1)
    codes = [network.codes(each, noise, 0.0) for each in (latents, other)]
    differ = (codes[0] != codes[1]).nonzero()[:, 1].tolist()
    assert differ
    assert layout == "channels" or set(differ) <= {6, 7}


def test_noise_is_standard_slow_and_the_same_for_a_seed() -> None:
    slow = correlated_normal([1, 2], 4000, 3, 5)
    assert slow.shape == (2, 4000, 3)
    assert float(slow.var()) == pytest.approx(1.0, abs=0.06)
    assert float((slow[:, 1:] * slow[:, :-1]).mean()) > 0.9
    assert abs(float((slow[:, 20:] * slow[:, :-20]).mean())) < 0.1
    torch.testing.assert_close(correlated_normal([2], 50, 3, 5), slow[1:, :50])
    white = correlated_normal([1], 4000, 3, 1)
    assert abs(float((white[:, 1:] * white[:, :-1]).mean())) < 0.05


def test_codes_are_sampled_by_softmax_over_distances() -> None:
    settings = prior_settings().network
    assert isinstance(settings, FaceVQVAESettings)
    torch.manual_seed(0)
    network = FaceVQVAE(settings, BASIS.numbers).eval()
    latents = torch.randn(1, 1, 16)
    network.temperature_scale.fill_(4.0)
    wanted = (-network.quantiser.distances(split_codes(latents, "frames", 8)) / (4.0 * 0.5)).softmax(-1)[0]
    noise = network.noise(list(range(4000)), 1, 1)
    drawn = network.codes(latents, noise, 0.5)
    for place in (0, 1):
        shares = torch.bincount(drawn[:, place], minlength=16) / 4000
        assert float((shares - wanted[place]).abs().max()) < 0.03
    nearest = network.quantiser.distances(split_codes(latents, "frames", 8)).argmin(-1)
    assert (network.codes(latents, noise[:3], 0.0) == nearest).all()
    assert float((network.codes(latents, noise, 1e-4) == nearest).float().mean()) > 0.99


def test_latent_size_must_be_multiple_of_code_size() -> None:
    network = prior_settings().network.model_dump() | {"latent": 12}
    with pytest.raises(ValueError, match=r"latent should be a multiple of quantiser\.width, 8, got 12"):
        FaceVQVAESettings.model_validate(network)


def test_long_speech_has_blockwise_attention(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(0)
    layer, x = WindowAttention(16, 2, 5, 3, 0.0).eval(), torch.randn(2, 40, 16)
    whole = layer(x, x)
    monkeypatch.setattr(attention, "BLOCK_FRAMES", 7)
    torch.testing.assert_close(layer(x, x), whole, atol=1e-6, rtol=1e-5)


# Stage 1


@pytest.mark.parametrize(("kind", "layout"), [("vq", "frames"), ("vq", "channels"), ("vae", "frames")])
def test_autoencoder_trains_reproducibly_and_loads(kind: str, layout: str, tmp_path: Path) -> None:
    settings = prior_settings(kind, layout)
    build_face_tokenizer = FaceTokenizerTask(settings, faces(12, seed=1), faces(3, seed=2), BASIS)
    build_face_tokenizer.module.eval()
    before = build_face_tokenizer.error(build_face_tokenizer.val_faces).normalised_l1
    first, second = prior_of(settings), prior_of(settings)
    error = first.error(first.val_faces)
    assert error.normalised_l1 < 0.5 * before
    same = zip(first.module.state_dict().values(), second.module.state_dict().values(), strict=True)
    assert all(torch.equal(a, b) for a, b in same)
    if kind == "vq":
        assert error.figures()["codes_used"] > 3
        assert float(first.module.temperature_scale) > 0
    checkpoint.save(tmp_path, first.module.state_dict(), face_tokenizer_config(settings.network, BASIS), [])
    again = load_face_tokenizer(tmp_path)
    face = torch.from_numpy(BASIS.to_vector(faces(1, 9)[0].expression, faces(1, 9)[0].jaw))[None]
    torch.testing.assert_close(again.network.latents(face), first.module.latents(face))
    assert again.basis == BASIS


def test_whole_clips_set_the_statistics_of_latents() -> None:
    settings = prior_settings("vq", "channels", batch=1)
    settings = settings.model_copy(update={"windows": WindowSettings(frames=None, mirror=False)})
    clips = [*faces(2, seed=1), *faces(2, seed=2, frames=90)]
    task = FaceTokenizerTask(settings, clips, clips, BASIS)
    task.fit_latent_statistics()
    assert float(task.module.temperature_scale) > 0
    assert float(task.module.latent_scale) not in (0.0, 1.0)


def test_invalid_tokenizer_is_one_line_error(tmp_path: Path) -> None:
    checkpoint.save(tmp_path, {}, {"network": {"kind": "vq"}})
    with pytest.raises(InputError, match=r"not a motion autoencoder of the face(.|\n)*`make report` trains one$"):
        load_face_tokenizer(tmp_path)


# Stage 2


@pytest.mark.parametrize("name", GENERATORS)
def test_model_trains_and_samples_the_same_after_loading(
    name: str, tokenizers: dict[str, FaceTokenizer], tmp_path: Path
) -> None:
    settings, tokenizer, known = model_settings(name), tokenizer_for(name, tokenizers), data()
    task = FaceTask(settings, 0, known, tokenizer)
    history = train(task, settings.loop, name)
    assert history[-1]["loss/total"] < history[0]["loss/total"]
    checkpoint.save(tmp_path, task.module.state_dict(), face_config(settings, known, tokenizer), history)
    assert is_face_model(tmp_path)
    generator = load_face_generator(tmp_path, BASIS)
    assert isinstance(generator, TrainedFaceGenerator)
    speech = known.val[0].speech
    drawn = generator.generate(speech, [StyleKey(0.0, HAPPY)], [5, 6], 25.0)
    course = torch.from_numpy(known.vocabulary.style_vector(HAPPY)[None])
    direct = task.module.generate(torch.from_numpy(speech), course, [6])[0].numpy()
    np.testing.assert_allclose(drawn.expression[1], direct[:, :4], atol=1e-5)
    np.testing.assert_allclose(drawn.jaw[1], direct[:, 4:], atol=1e-5)
    assert drawn.expression_names == NAMES
    assert drawn.expression.min() >= 0
    assert drawn.expression.max() <= 1


def test_a_causal_face_depends_on_no_more_than_its_lookahead() -> None:
    speech = {"channels": None, "width": 16, "layers": 2, "dropout": 0.0, "channel_dropout": 0.0, "lookahead": 3}
    network = FaceTask(model_settings("causal", speech=speech), 0, data(), None).module.eval()
    known = data()
    style = torch.from_numpy(known.vocabulary.style_vector(HAPPY)[None])
    original = torch.from_numpy(known.val[0].speech)
    other = original.clone()
    other[20:] += 1.0
    one, two = (network.generate(each, style, [0])[0].numpy() for each in (original, other))
    np.testing.assert_array_equal(one[:17], two[:17])
    assert np.abs(one[17] - two[17]).max() > 1e-4


@pytest.fixture(scope="module")
def talker(tokenizers: dict[str, FaceTokenizer]) -> Any:
    weights = {"latent": 1.0, "expression": 1.0, "jaw": 1.0}
    settings = model_settings("latent_vae", weights=weights, loop=LOOP | {"steps": 80, "validate_every": 80})
    task = FaceTask(settings, 0, data(), tokenizers["vae"])
    task.module.eval()
    before = task.validate()["validation_score"]
    train(task, settings.loop, "talker")
    assert task.validate()["validation_score"] > before
    return task


def test_emotion_has_effect_and_can_change_within_a_clip(talker: Any) -> None:
    known = talker.data.vocabulary
    speech = torch.from_numpy(faces(1, seed=7)[0].speech)
    keys = [StyleKey(0.0, HAPPY), StyleKey(2.4, ANGRY)]
    happy, changing = (
        talker.module.generate(speech, torch.from_numpy(known.per_frame(course, 120, 25.0)), [3], 0.0)[0].numpy()
        for course in (keys[:1], keys)
    )
    np.testing.assert_allclose(changing[:30], happy[:30], atol=1e-5)
    assert happy[:, 2].mean() > happy[:, 0].mean() + 0.4
    before, after = changing[:40].mean(0), changing[80:].mean(0)
    assert after[2] < before[2] - 0.2, "the smile goes"
    assert after[0] > before[0] + 0.03, "the brows come down"


def test_emotions_differ_before_training_among_many_speakers(tokenizers: dict[str, FaceTokenizer]) -> None:
    """Factors that begin the same for all emotions are not learnt in the steps of the chain."""
    vocabulary = StyleVocabulary(tuple(f"s{number:03}" for number in range(200)))
    network = tokenizers["vq"].network
    made = SpeechToFace(model_settings("latent"), ("energy_dbfs",), vocabulary, BASIS.numbers, network)
    styles = np.stack([vocabulary.style_vector(FaceStyle(None, each, 1)) for each in ("happy", "angry", "sad")])
    assert made.style is not None
    assert made.style(torch.from_numpy(styles)).std(dim=0).mean() > 0.2


def test_speaker_has_effect_only_with_style(talker: Any, tokenizers: dict[str, FaceTokenizer]) -> None:
    speech = torch.from_numpy(faces(1, seed=7)[0].speech)

    def smile(task: Any, speaker: str) -> float:
        style = torch.from_numpy(task.data.vocabulary.style_vector(replace(HAPPY, speaker=speaker))[None])
        return float(task.module.generate(speech, style, [1], 0.0)[0, :, 3].mean())

    assert abs(smile(talker, "a") - smile(talker, "b")) > 1e-4
    alone = FaceTask(model_settings("latent", style=["speaker"]), 0, data(), tokenizers["vq"])
    assert smile(alone, "a") != smile(alone, "b")
    deaf = FaceTask(model_settings("latent", style=[]), 0, data(), tokenizers["vq"])
    assert smile(deaf, "a") == smile(deaf, "b")


def test_the_jaw_follows_the_speech(talker: Any) -> None:
    recording = faces(1, seed=11)[0]
    style = torch.from_numpy(talker.data.vocabulary.style_vector(FaceStyle("a", "neutral", 0))[None])
    jaw = talker.module.generate(torch.from_numpy(recording.speech), style, [1], 0.0)[0, :, 4].numpy()
    assert np.corrcoef(jaw, recording.jaw[:, 0])[0, 1] > 0.2


def test_killed_training_resumes_to_the_same_weights(tokenizers: dict[str, FaceTokenizer], tmp_path: Path) -> None:
    settings = model_settings("latent", loop=LOOP | {"steps": 4, "validate_every": 2})

    class Killed(Exception):
        """Simulates termination by a signal."""

    def kill(step: int, _: dict[str, float]) -> None:
        if step == 2:
            raise Killed

    whole = FaceTask(settings, 0, data(), tokenizers["vq"])
    train(whole, settings.loop, "whole")
    resume = ResumeFile.of(tmp_path / "face.resume", [], [])
    with pytest.raises(Killed):
        train(FaceTask(settings, 0, data(), tokenizers["vq"]), settings.loop, "cut", on_validation=kill, resume=resume)
    resumed = FaceTask(settings, 0, data(), tokenizers["vq"])
    train(resumed, settings.loop, "resumed", resume=resume)
    same = zip(whole.module.state_dict().values(), resumed.module.state_dict().values(), strict=True)
    assert all(torch.equal(a, b) for a, b in same)


@pytest.mark.parametrize("name", ["latent", "autoregressive_codes"])
def test_generator_without_tokenizer_is_an_error(name: str) -> None:
    with pytest.raises(InputError, match=r"^model\.tokenizer: should "):
        FaceTask(model_settings(name), 0, data(), None)


# Wrong speakers and heads; baselines


def baseline(kind: str, folder: Path) -> TrainedFaceGenerator:
    known = data()
    settings = BaselineSettings.model_validate({"kind": kind, "parts": ["face"], "tokenizer": None, "neighbours": 2})
    joined_faces = [BASIS.to_vector(each.expression, each.jaw) for each in known.train]
    speech, normaliser = [each.speech for each in known.train], known.normaliser
    bank = MotionBank.of(speech, joined_faces, normaliser.mean, normaliser.std)
    save_baseline(folder, settings, bank, face_space(known))
    return load_face_generator(folder)


def test_unknown_speaker_and_other_head_are_one_line_errors(tmp_path: Path) -> None:
    generator = baseline("mean", tmp_path)
    line = r"^speaker: should be one of a, b or none for their mean, got bob$"
    with pytest.raises(InputError, match=line):
        generator.generate(faces(1, 3)[0].speech, [StyleKey(0.0, FaceStyle("bob", "happy", 1))], [1], 25.0)
    flame = FaceBasis("flame", tuple(f"expression_{index}" for index in range(50)))
    with pytest.raises(InputError, match=r"should be of the head flame \(50 shapes\), got toy \(4\); train one on"):
        load_face_generator(tmp_path, flame)


def test_invalid_face_model_folder_is_one_line_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`make repro` trains"):
        load_face_generator(tmp_path / "none")
    with pytest.raises(InputError, match="not a trained model"):
        is_face_model(tmp_path / "none")
    checkpoint.save(tmp_path, {}, {"model": {"kind": "speech_to_motion", "parts": ["head", "gaze"]}})
    assert not is_face_model(tmp_path)
    with pytest.raises(InputError, match="not a model of the face"):
        load_face_generator(tmp_path)


def test_a_face_model_of_an_old_configuration_is_a_one_line_error(tmp_path: Path) -> None:
    baseline("mean", tmp_path)
    saved = checkpoint.load(tmp_path)
    checkpoint.save(tmp_path, saved.tensors, saved.config | {"model": saved.config["model"] | {"prior": 1}})
    with pytest.raises(InputError, match=r"\(model\.prior: .*, got 1\); `make report`") as error:
        load_face_generator(tmp_path)
    assert "\n" not in str(error.value)


def test_baselines_take_the_mean_or_a_piece_of_one_clip(tmp_path: Path) -> None:
    known = data()
    mean = baseline("mean", tmp_path).generate(known.val[0].speech, [StyleKey(0.0, HAPPY)], [1, 2], 25.0)
    everything = np.concatenate([each.jaw for each in known.train])
    np.testing.assert_allclose(mean.jaw[1, 7], everything.mean(0), atol=1e-6)
    similar = baseline("similar", tmp_path).generate(
        known.train[4].speech, [StyleKey(0.0, HAPPY)], list(range(9)), 25.0
    )
    source = known.train[4]
    assert any(np.allclose(drawn, source.jaw, atol=1e-6) for drawn in similar.jaw), "the clip of the same sound is near"
    random = baseline("random", tmp_path).generate(known.val[0].speech, [StyleKey(0.0, HAPPY)], list(range(12)), 25.0)
    assert len({each.tobytes() for each in random.expression}) > 3


def test_the_mean_face_of_each_emotion_is_that_of_its_clips_and_still(tmp_path: Path) -> None:
    known = data()
    vectors = [BASIS.to_vector(each.expression, each.jaw) for each in known.train]
    felt = [clip_style(each.clip).emotion for each in known.train]
    settings = EmotionMeanSettings(kind="emotion_mean", parts=("face",), tokenizer=None)
    save_baseline(tmp_path, settings, EmotionMeans.of(vectors, felt), face_space(known))
    generator = load_face_generator(tmp_path)
    found = {
        name: generator.generate(known.val[0].speech, [StyleKey(0.0, FaceStyle(None, name, size))], [1, 2], 25.0)
        for name, size in (("happy", 3), ("angry", 1), ("contempt", 2))
    }
    for name in ("happy", "angry"):
        own = np.concatenate([each for each, emotion in zip(vectors, felt, strict=True) if emotion == name])
        np.testing.assert_allclose(
            found[name].expression[1, 7], own[:, : len(BASIS.expression_names)].mean(0), atol=1e-5
        )
        assert np.ptp(found[name].jaw, axis=1).max() == 0
    assert "contempt" not in felt
    everything = np.concatenate(vectors)[:, : len(BASIS.expression_names)].mean(0)
    np.testing.assert_allclose(found["contempt"].expression[0, 0], everything, atol=1e-5)
    assert np.abs(found["happy"].expression - found["angry"].expression).max() > 0.05


# Model selection


def test_speed_ratio_is_0_for_a_frozen_face() -> None:
    true = np.random.default_rng(0).normal(0, 1.0, (400, 3))
    assert speed_ratio(np.zeros((2, 400, 3)), true) == 0
    assert speed_ratio(true[None], true) == pytest.approx(1.0)
