"""The default models in numpy: they equal those of torch up to rounding, and need no torch."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
import torch
from toy_model import sound_file

from talkingeyes.animation.inference import torch_random
from talkingeyes.animation.inference.face import NumpyFaceGenerator
from talkingeyes.animation.inference.loading import load_face_model, load_motion_generator
from talkingeyes.animation.inference.motion import NumpyMotionGenerator
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL, PACKAGED_MODEL, open_model
from talkingeyes.animation.torch_generation import sample_motion
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.models.condition.emotion_strength import emotion_strengths
from talkingeyes.models.face.style import FaceStyle, StyleKey, blend_over_time
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.training import checkpoint
from talkingeyes.training.face_generators import load_face_generator
from talkingeyes.training.motion_generators import load_generator
from talkingeyes.training.motion_task import MotionTaskSettings

# What the extras of pyproject.toml install beyond the base installation.
EXTRAS = (
    "torch sklearn hydra omegaconf mlflow dvc ruamel optuna ray pxr mediapipe cv2 transformers "
    "fastapi starlette uvicorn websockets"
)
# Runs the command line in a process without the packages that its first argument names.
REFUSE_PACKAGES = """
import sys

REFUSED = set(sys.argv.pop(1).split())

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in REFUSED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
from talkingeyes.cli.main import main
main()
"""


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """The packaged model of head and gaze; that of the face is beside it."""
    with open_model(PACKAGED_MODEL) as folder:
        yield folder


def embedding(frames: int) -> np.ndarray:
    """Speech features of the default's number of channels."""
    return np.random.default_rng(0).normal(size=(frames, 296)).astype(np.float32)


@pytest.mark.parametrize("seed", [0, 5, 2**31 + 1, 2**32 + 3])
def test_random_numbers_are_those_of_torch(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    np.testing.assert_array_equal(torch_random.uniform(seed, 1001), torch.rand(1001, generator=generator).numpy())
    normal = torch.randn(1600, generator=generator.manual_seed(seed)).numpy()
    np.testing.assert_allclose(torch_random.normal(seed, 1600), normal, atol=1e-6)


@pytest.mark.parametrize("speaker", [None, 3])
def test_head_and_gaze_equal_those_of_torch(folder: Path, speaker: int | None) -> None:
    generator, speech, seeds = load_motion_generator(folder), embedding(301), [1, 2, 3]
    assert isinstance(generator, NumpyMotionGenerator)
    found = generator.generate(speech, seeds, 25.0, speaker)
    expected = sample_motion(load_generator(folder), speech, np.zeros(0), seeds, 25.0, speaker)
    np.testing.assert_allclose(found.head, expected.head, atol=1e-5)
    np.testing.assert_allclose(found.gaze, expected.gaze, atol=1e-5)
    alone = generator.generate(speech, seeds[1:2], 25.0, speaker)  # a seed gives the same motion alone
    np.testing.assert_allclose(alone.gaze[0], found.gaze[1], atol=1e-5)


def test_a_model_told_the_emotion_equals_that_of_torch(folder: Path, tmp_path: Path) -> None:
    packaged = checkpoint.load(folder)
    model = packaged.config["model"] | {"conditions": [*packaged.config["model"]["conditions"], {"kind": "emotion"}]}
    settings = MotionTaskSettings.model_validate(model)
    torch.manual_seed(0)
    network = SpeechToMotion(settings, packaged.config["channels"], None, packaged.config["speakers"])
    known = {
        name: packaged.tensors[name] if name in packaged.tensors and packaged.tensors[name].shape == own.shape else own
        for name, own in network.state_dict().items()
    }
    checkpoint.save(tmp_path, known, packaged.config | {"model": model})
    generator, torch_generator = load_motion_generator(tmp_path), load_generator(tmp_path)
    assert isinstance(generator, NumpyMotionGenerator)
    speech, keys = embedding(120), [StyleKey(0.0, FaceStyle(None, "sad", 3)), StyleKey(2.0, FaceStyle(None, "fear", 2))]
    emotion = blend_over_time(keys, np.arange(120) / 25.0, emotion_strengths)
    felt = generator.generate(speech, [1, 2], 25.0, 3, emotion)
    expected = sample_motion(torch_generator, speech, np.zeros(0), [1, 2], 25.0, 3, emotion)
    np.testing.assert_allclose(felt.head, expected.head, atol=1e-5)
    np.testing.assert_allclose(felt.gaze, expected.gaze, atol=1e-5)
    calm = generator.generate(speech, [1, 2], 25.0, 3)
    np.testing.assert_array_equal(
        calm.head, generator.generate(speech, [1, 2], 25.0, 3, np.zeros_like(emotion)).head, "none is neutral"
    )
    assert np.abs(felt.head - calm.head).max() > 0.01


@pytest.mark.parametrize("frames", [1, 300])  # more than a block of attention
def test_faces_equal_those_of_torch(folder: Path, frames: int) -> None:
    place, speech, seeds = folder.parent / "probtalk3d", embedding(frames), [1, 2]
    torch_generator = load_face_generator(place)
    generator = load_face_model(place, torch_generator.basis)
    assert isinstance(generator, NumpyFaceGenerator)
    style = [StyleKey(0.0, FaceStyle("s0004", "neutral", 0)), StyleKey(4.0, FaceStyle(None, "happy", 2))]
    found, expected = (each.generate(speech, style, seeds, 25.0) for each in (generator, torch_generator))
    np.testing.assert_allclose(found.expression, expected.expression, atol=1e-5)
    np.testing.assert_allclose(found.jaw, expected.jaw, atol=1e-5)


def without_extras(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`talkingeyes` in a process in which importing what only extras install fails."""
    command = [sys.executable, "-c", REFUSE_PACKAGES, EXTRAS, *arguments]
    return subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=240, check=False)


@pytest.mark.long
def test_animate_export_render_and_view_need_no_extra(tmp_path: Path) -> None:
    sound_file(tmp_path / "a.wav", 1.0)
    for arguments in (
        ("animate", "a.wav", "-o", "out", "--samples", "1", "-f", "glb", "-f", "vocaset"),
        ("export", "out/sample_00.npz", "-f", "arkit", "-o", "a.json"),
        ("render", "out/sample_00.npz", "-o", "a.mp4"),
        ("view", "out/sample_00.npz", "--page", "a.html"),
    ):
        done = without_extras(tmp_path, *arguments)
        assert done.returncode == 0, done.stderr
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"sample_00.npz", "sample_00.mp4", "sample_00.glb", "sheet.png", "traces.png"} <= written


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("animate", "a.wav", "-o", "out", "--model", str(PACKAGED_LIVE_MODEL)), "torch: should be installed"),
        (("view", "a.npz"), "fastapi: should be installed for this (pip install 'talkingeyes[web]')"),
        (("serve",), "should be installed for this (pip install 'talkingeyes["),
    ],
)
def test_what_needs_an_extra_says_so_in_one_line(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    sound_file(tmp_path / "a.wav", 1.0)
    three, two = np.zeros((10, 3)), np.zeros((10, 2))
    Motion(25.0, three, three, np.zeros((10, 2, 3)), two, three, two[:, :0], np.ones(10, bool)).save(tmp_path / "a.npz")
    done = without_extras(tmp_path, *arguments)
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert last.startswith("error: ")
    assert message in last
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("key", "value"), [("bin_frames", 10**12), ("bin_frames", 0), ("bin_frames", "two"), ("width", None)]
)
def test_a_damaged_model_is_refused(folder: Path, tmp_path: Path, key: str, value: object) -> None:
    config = json.loads((folder / "config.json").read_text())
    tensors = safetensors.numpy.load_file(folder / "model.safetensors")
    if key == "width":
        tensors["head.process.hazard.weight"] = tensors["head.process.hazard.weight"][:, 1:].copy()
    config["model"]["gaze"]["process"][key] = value
    (tmp_path / "config.json").write_text(json.dumps(config))
    safetensors.numpy.save_file(tensors, tmp_path / "model.safetensors")
    with pytest.raises(InputError, match="not a model of this version"):
        load_motion_generator(tmp_path)
