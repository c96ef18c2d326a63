"""A film of Zhang et al.'s whole pipeline (Fig. 1): speech to head poses (PoseGAN), both to face shapes (PGFace).

Run     python -m pipelines.results.talking_face SPEECH [--speaker s0003] [--seed 0] [--fixed-pose] [--out FILM.mp4]
        [overrides]
Reads   conf/ (experiment=posegan, or that of the overrides); trains what the result store does not contain
Writes  the film: eyes straight ahead and lids open, which neither model moves

--fixed-pose: PGFace receives the mean pose in every frame, so the shape does not answer to the head (section 5.3.2;
the condition `fixed` of the study `posegan_shape`).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from pipelines.experiment import run_pipeline
from pipelines.results.posegan_table import with_experiment
from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.poses import head_rotations, resample_linear
from talkingeyes.head.anny import anny_head
from talkingeyes.head.sag import FaceSurface
from talkingeyes.models.pgface import PGFace
from talkingeyes.models.speech_to_pose import SpeechToPose
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import Workspace, run_command
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.video import write_video
from talkingeyes.rendering.view import FRAMINGS
from talkingeyes.training.checkpoint import load
from talkingeyes.training.motion_generators import pose_network
from talkingeyes.training.pgface_task import pgface_network
from talkingeyes.workflows.render import check_output_file

SIZE_PX = 512


def main() -> None:
    """Train both models if needed, and write the film."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("speech", help="a sound file")
    parser.add_argument("--speaker", help="a speaker of the train split (default: the first)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the head")
    parser.add_argument("--fixed-pose", action="store_true", help="the shape does not answer to the pose of the head")
    parser.add_argument("--out", type=Path, help="the film (default: talking_face.mp4 in the workspace)")
    parser.add_argument("--force", action="store_true", help="overwrite the film")
    parser.add_argument("overrides", nargs="*", help="overrides of conf/, such as experiment=posegan_tiny")
    given = parser.parse_intermixed_args()
    sound = read_speech(given.speech)
    params = compose(with_experiment(given.overrides))
    workspace = Workspace(Path(params["workspace"]), params)
    workspace.root.mkdir(parents=True, exist_ok=True)
    out = check_output_file(given.out or workspace.root / "talking_face.mp4", ".mp4", given.force)
    for name in ("posegan", "pgface"):
        run_pipeline({**params, "target": f"train@{name}"}, workspace.root)
    heads = pose_network(load(workspace.data("train", "posegan")))
    speaker = given.speaker or heads.speakers[0]
    if speaker not in heads.speakers:
        raise InputError(f"--speaker: should be one of {', '.join(heads.speakers)}, got {speaker}")
    faces = pgface_network(load(workspace.data("train", "pgface")))
    speech = speech_features(workspace.data("train", "posegan"), sound, heads.settings.poses.fps)
    surface = FaceSurface(anny_head())
    motion = talking_face(heads, faces, surface, speech, speaker, given.seed, fixed_pose=given.fixed_pose)
    renderer = HeadRenderer(surface.sagging_model, FRAMINGS["head"].view(SIZE_PX, SIZE_PX))
    write_video(out, renderer.draw(motion), motion.fps, sound)
    print(out)


def speech_features(model: Path, sound: Float[ndarray, " N"], fps: float) -> Float[ndarray, "T C"]:
    """The speech embedding that a model was trained on, at the frame rate of poses."""
    embedding = read_json(model / "embedding.json", "JSON file")
    encoder = make_encoder(validate_section("embed", EmbedSettings, embedding["settings"]))
    return resample_linear(encoder(sound, embedding["fps"]), embedding["fps"], fps).astype(np.float32)


def talking_face(
    heads: SpeechToPose,
    faces: PGFace,
    surface: FaceSurface,
    speech: Float[ndarray, "T C"],
    speaker: str,
    seed: int,
    *,
    fixed_pose: bool = False,
) -> Motion:
    """Head and face of one sample, for the head `surface.sagging_model`."""
    pose = heads.sample(speech, [seed], heads.style_of(speaker))[0] + heads.mean_pose.numpy()
    shape_pose = heads.mean_pose.expand(len(pose), -1) if fixed_pose else torch.from_numpy(pose)
    shapes = faces.shapes(faces.sequence(torch.from_numpy(speech), shape_pose)).numpy()
    return Motion.of(
        heads.settings.poses.fps,
        head_rotations(pose.astype(np.float64)),
        np.zeros((len(pose), 2, 3)),
        expression=surface.weights(shapes),
        expression_names=surface.sagging_model.expression_names,
        head_model=surface.model.name,
    )


if __name__ == "__main__":
    run_command(main)
