"""Every part named in conf/ satisfies the contract of its role, including added ones (docs/extend.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from model_conf import MODEL_NAMES, model_section
from toy import recordings

from talkingeyes.audio.encoder import ENCODERS, EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.audio.waveform import frame_count
from talkingeyes.core.errors import InputError
from talkingeyes.models.face.autoencoder import FACE_AUTOENCODERS
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import FaceStyle, StyleVocabulary
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.models.layers.gradient_quantiser import GradientQuantiser
from talkingeyes.models.speech_to_face import FaceBatch, SpeechToFace
from talkingeyes.models.speech_to_motion import MotionBatch, SpeechToMotion
from talkingeyes.orchestration.config import CONFIG_DIR
from talkingeyes.training.face_task import FaceTaskSettings
from talkingeyes.training.face_tokenizer import FaceTokenizerSettings
from talkingeyes.training.motion_task import MotionTaskSettings

CHANNELS = 6
FACE_BASIS, SPEAKERS = FaceBasis("toy", ("mouthSmileLeft", "mouthSmileRight")), StyleVocabulary(("a", "b"))


def content(path: Path) -> Any:
    return yaml.safe_load(path.read_text())


KINDS = {name: model_section(name)["kind"] for name in MODEL_NAMES}
MODELS = [name for name, kind in KINDS.items() if kind == "speech_to_motion"]
FACES = [name for name, kind in KINDS.items() if kind == "speech_to_face"]
FAMILIES = [path.stem for path in sorted((CONFIG_DIR / "embed" / "encoder").glob("*.yaml"))]


def codebook(tokenizer: str | None) -> GazeVQVAE | None:
    """The untrained codebook that a model needs."""
    if tokenizer is None:
        return None
    network = GazeVQVAE(GazeVQVAESettings.model_validate(model_section(tokenizer, "pretrain")["network"]))
    network.normalise_by(torch.zeros_like(network.mean), 0.1)
    network.quantiser.train()
    network.quantiser(torch.randn(1, 64, network.settings.quantiser.width))
    if isinstance(network.quantiser, GradientQuantiser):  # untrained, all its codes lie near 0
        torch.nn.init.normal_(network.quantiser.codebook)
    return network.freeze()


def toy_settings(raw: dict[str, Any]) -> tuple[MotionTaskSettings, list[str]]:
    """Settings with at most as many channels of speech as toy recordings have, and the names of these."""
    chosen = raw["speech"]["channels"]
    channels = None if chosen is None else chosen[:CHANNELS]
    settings = MotionTaskSettings.model_validate(raw | {"speech": raw["speech"] | {"channels": channels}})
    return settings, [*(channels or ()), *(str(index) for index in range(CHANNELS))][:CHANNELS]


def network(name: str) -> SpeechToMotion:
    """An untrained model of conf/model/."""
    settings, names = toy_settings(model_section(name))
    torch.manual_seed(0)
    made = SpeechToMotion(settings, names, codebook(settings.tokenizer), ("a", "b"))
    made.head.normal.set(torch.zeros(3), 0.1)
    made.gaze.normalise_by(torch.zeros(6), 0.1)
    return made.eval()


def batch() -> MotionBatch:
    found = recordings(2, seed=5, frames=48)
    return MotionBatch(
        *(torch.from_numpy(np.stack([getattr(r, part) for r in found])) for part in ("speech", "head", "gaze"))
    )


def test_weight_of_unknown_term_is_an_error_with_known_terms() -> None:
    raw = model_section("talkingeyes_events")
    raw["weights"]["gaze_velocity"] = 1.0
    settings, names = toy_settings(raw)
    made = SpeechToMotion(settings, names, None, ("a", "b"))
    with pytest.raises(InputError, match=r"weights: should be among gaze_location, .*; got 'gaze_velocity'"):
        made.loss_terms(batch())


@pytest.mark.parametrize("name", MODELS)
class TestModel:
    """Contract of head and gaze generators, as combined by their model."""

    def test_motion_is_finite_at_any_length(self, name: str) -> None:
        made = network(name)
        for frames in (1, 7, 41):
            out = made.generate(torch.randn(frames, CHANNELS), [1, 2])
            assert out.head.shape == (2, frames, 3)
            assert out.gaze.shape == (2, frames, 2, 3)
            assert torch.isfinite(out.head).all()
            assert torch.isfinite(out.gaze).all()

    def test_a_seed_is_the_same_alone_and_in_a_batch_and_another_differs(self, name: str) -> None:
        made, speech = network(name), torch.randn(40, CHANNELS)
        # At temperature 0 a decoder can give the same gaze for all seeds.
        many, one = made.generate(speech, [3, 4], 1.0), made.generate(speech, [4], 1.0)
        torch.testing.assert_close(many.head[1], one.head[0], atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(many.gaze[1], one.gaze[0], atol=1e-5, rtol=1e-4)
        assert (many.head[0] - many.head[1]).abs().max() > 1e-4
        assert (many.gaze[0] - many.gaze[1]).abs().max() > 1e-5

    def test_it_learns_one_batch_through_the_speech(self, name: str) -> None:
        made, data = network(name).train(), batch()
        optimiser = torch.optim.Adam([each for each in made.parameters() if each.requires_grad], 3e-3)
        totals = []
        for _ in range(24):  # on its own past, a loss rises before it falls
            torch.manual_seed(0)
            loss_terms = made.loss_terms(data)
            assert set(made.settings.weights) <= set(loss_terms)
            assert all(value.shape == () and torch.isfinite(value) for value in loss_terms.values())
            optimiser.zero_grad()
            loss_terms["total"].backward()
            optimiser.step()
            totals.append(loss_terms["total"].item())
        assert totals[-1] < totals[0]
        gradients = [parameter.grad for parameter in made.speech.parameters()]
        assert any(gradient is not None and gradient.abs().sum() > 0 for gradient in gradients)


def face_network(name: str) -> SpeechToFace:
    """A face model of conf/model/ with its motion autoencoder, both untrained."""
    settings = FaceTaskSettings.model_validate(model_section(name))
    torch.manual_seed(0)
    tokenizer = None
    if settings.tokenizer:
        of_tokenizer = FaceTokenizerSettings.model_validate(model_section(settings.tokenizer, "pretrain"))
        tokenizer = FACE_AUTOENCODERS.build(of_tokenizer.network, FACE_BASIS.numbers)
        tokenizer.fit_latent_statistics([torch.randn(2, 20, FACE_BASIS.numbers)])
        tokenizer.freeze()
    channels = [*(settings.speech.channels or ()), *(str(index) for index in range(CHANNELS))][:CHANNELS]
    return SpeechToFace(settings, channels, SPEAKERS, FACE_BASIS.numbers, tokenizer).eval()


@pytest.mark.parametrize("name", FACES)
class TestFaceModel:
    """Contract of face generators, on a head with two blend shapes."""

    def test_it_learns_one_batch_through_speech_and_style(self, name: str) -> None:
        made = face_network(name).train()
        torch.manual_seed(1)
        styles = [FaceStyle("a", "happy", 1), FaceStyle("b", "angry", 2)]
        style = torch.from_numpy(np.stack([SPEAKERS.style_vector(each)[None] for each in styles]))
        data = FaceBatch(torch.randn(2, 20, CHANNELS), style, torch.randn(2, 20, 5))
        optimiser = torch.optim.Adam([each for each in made.parameters() if each.requires_grad], 3e-3)
        totals = []
        for _ in range(24):  # a wide network overshoots at this rate
            torch.manual_seed(0)
            loss_terms = made.loss_terms(data)
            assert set(made.settings.weights) <= set(loss_terms)
            assert all(value.shape == () and torch.isfinite(value) for value in loss_terms.values())
            optimiser.zero_grad()
            loss_terms["total"].backward()
            optimiser.step()
            totals.append(loss_terms["total"].item())
        assert totals[-1] < totals[0]
        inputs = [made.speech, made.style] if made.style else [made.speech]
        assert all(any(each.grad.abs().sum() > 0 for each in part.parameters()) for part in inputs)

    def test_a_face_is_finite_at_any_length_and_the_same_for_a_seed(self, name: str) -> None:
        made = face_network(name)
        style = torch.from_numpy(SPEAKERS.style_vector(FaceStyle("a", "happy", 1)))[None]
        for frames in (1, 9):
            speech = torch.randn(frames, CHANNELS)
            many = made.generate(speech, style, [3, 4], 1.0)
            assert many.shape == (2, frames, FACE_BASIS.numbers)
            assert torch.isfinite(many).all()
            torch.testing.assert_close(many[1], made.generate(speech, style, [4], 1.0)[0], atol=1e-4, rtol=1e-3)
        if made.settings.temperature:
            assert (many[0] - many[1]).abs().max() > 1e-5


@pytest.mark.parametrize("name", FAMILIES)
class TestEncoder:
    """Contract of speech encoders. Those without local weights are tested in tests/test_encoder_contract.py."""

    def encoder(self, name: str) -> SpeechEncoder:
        node = {
            **content(CONFIG_DIR / "embed" / "default.yaml"),
            "encoder": content(CONFIG_DIR / "embed" / "encoder" / f"{name}.yaml"),
        }
        node.pop("defaults")
        assert ENCODERS.component_class(node["encoder"]["kind"])
        try:
            return make_encoder(EmbedSettings.model_validate(node))
        except InputError as error:
            pytest.skip(str(error))

    def test_one_finite_reproducible_row_per_frame(self, name: str) -> None:
        encoder = self.encoder(name)
        sound = (0.1 * np.sin(np.arange(24_123) ** 1.3)).astype(np.float32)
        assert len(set(encoder.channels)) == len(encoder.channels)
        for fps in (12.0, 25.0, 29.97):
            features = encoder(sound, fps)
            assert features.shape == (frame_count(len(sound), fps), len(encoder.channels))
            assert features.dtype == np.float32
            assert np.isfinite(features).all()
        np.testing.assert_array_equal(encoder(sound, fps), features)
        assert np.isfinite(encoder(np.zeros(16_000, np.float32), 25.0)).all()
