"""Causes of frozen gaze of the paper's decoder: teacher-forced, released and free-running predictions compared.

For every fitted sound of a split, with its true head: the gaze that a `regressed` decoder predicts for each frame from
the true past (teacher-forced); the gaze when it is teacher-forced for FREE_RUNNING_S seconds and then continues from
its own output (released); the gaze of a free run. A decoder that has learned to copy the last frame is as fast as the
truth under teacher forcing, one frame late, and stops soon after release. Then neither the number of codes nor a loss
term can have an effect in a free run, and the order of such rows in a table is random.

Run     python -m benchmarks.free_running [MODEL ...]     (make bench, after make repro; folders of the train stage, or
        data/train/talkingeyes_paper)
Reads   the corpus, data/fit, data/embed, data/critic of the folder where it runs; the models
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.core.kinematics import eye_speed_deg_s
from talkingeyes.corpus.recordings import Recording, recordings
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.corr import CRITICS
from talkingeyes.evaluation.paper_metrics.corr import CriticCorrelation
from talkingeyes.models.condition.conditioner import NO_CONDITIONING
from talkingeyes.models.gaze.gaze_signal import to_gaze_tensor, to_signal_tensor
from talkingeyes.models.gaze.generator import GazeCondition
from talkingeyes.models.gaze.regression import RegressionGaze
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.orchestration.run import Workspace, run_command
from talkingeyes.training.motion_generators import NetworkGenerator, load_generator

MODEL = Path("data", "train", "talkingeyes_paper")
SPLIT = "test"
FREE_RUNNING_S, WATCHED_S, PART_S = 2.0, 2.0, 0.5
MOVES_DEG = 1.0  # copying is tested in frames in which the eyes move by more


@dataclass(frozen=True)
class DecoderInput:
    """The input of a decoder for one sound."""

    memory: Float[Tensor, "1 T W"]
    true: Float[Tensor, "1 T F"]  # in units of the codebook's scale
    head: Float[Tensor, "1 T 3"]


def teacher_forced(
    gaze: RegressionGaze, past: Float[Tensor, "1 T F"], memory: Float[Tensor, "1 T W"]
) -> Float[Tensor, "1 T F"]:
    """Predict each frame from the true frames before it (eq. 9), in units of the codebook's scale."""
    features = gaze.out(gaze.transformer(gaze.embed(past), memory))
    values = gaze.codebook.quantiser(features).values
    signal = gaze.codebook.decode(values, torch.zeros(past.shape[:2], dtype=torch.bool))
    return (signal - gaze.codebook.mean) / gaze.codebook.scale


def previous_frames(frames: Float[Tensor, "1 T F"]) -> Float[Tensor, "1 T F"]:
    """The frame before each frame; before the first, the mean."""
    return torch.cat([torch.zeros_like(frames[:, :1]), frames[:, :-1]], dim=1)


def free_running(
    gaze: RegressionGaze, decoder_input: DecoderInput, from_frame: int, frames: int
) -> Float[Tensor, "1 N F"]:
    """Continue from the true frames before `from_frame` for `frames` frames."""
    known = decoder_input.true[:, :from_frame]
    for _ in range(min(frames, decoder_input.true.shape[1] - from_frame)):
        past = torch.cat([torch.zeros_like(known[:, :1]), known], dim=1)
        known = torch.cat([known, teacher_forced(gaze, past, decoder_input.memory[:, : past.shape[1]])[:, -1:]], dim=1)
    return known[:, from_frame:]


def decoder_input_of(network: SpeechToMotion, gaze: RegressionGaze, recording: Recording) -> DecoderInput:
    """A recording as decoder input, conditioned on its true head."""
    head, eyes, speech = (
        torch.from_numpy(np.array(each)).float()[None] for each in (recording.head, recording.gaze, recording.speech)
    )
    condition = GazeCondition(network.encode_speech(speech, NO_CONDITIONING).gaze, head, network.head.normal(head))
    memory = gaze.condition(torch.cat([condition.speech, condition.normalised_head], dim=-1))
    signal = to_signal_tensor(gaze.codebook.settings.signal, head, eyes)
    return DecoderInput(memory, (signal - gaze.codebook.mean) / gaze.codebook.scale, head)


def speeds(gaze: RegressionGaze, frames: Float[Tensor, "1 T F"], fps: float) -> Float[ndarray, " _"]:
    """Degrees per second between frames; eye-in-head codes need no head."""
    still = torch.zeros(1, frames.shape[1], 3)
    eyes = to_gaze_tensor(gaze.codebook.settings.signal, still, frames * gaze.codebook.scale + gaze.codebook.mean)
    return eye_speed_deg_s(eyes.numpy(), fps).ravel()


def degrees(gaze: RegressionGaze, off: Float[Tensor, "1 T F"]) -> Float[ndarray, " T"]:
    """Difference between two trajectories in each frame, mean of both eyes."""
    eyes = (off * gaze.codebook.scale)[0].reshape(off.shape[1], 2, -1)
    return np.asarray(np.degrees(eyes.norm(dim=-1).mean(-1).numpy()))


@torch.no_grad()
def measure(model: Path, workspace: Workspace) -> dict[str, float]:
    """The results of one model over all sounds of the split."""
    generator = load_generator(model)
    assert isinstance(generator, NetworkGenerator)
    network, gaze = generator.network, generator.network.gaze
    assert isinstance(gaze, RegressionGaze)
    corpus = Corpus(workspace.corpus)
    clips = recordings(corpus, workspace.data("fit"), workspace.data("embed"), SPLIT, take=0)
    critic = CriticCorrelation.load(workspace.data("critic"), CRITICS["gaze"])
    found: dict[str, list[float]] = {}

    def add(name: str, value: float) -> None:
        found.setdefault(name, []).append(value)

    for recording in clips:
        fps = recording.clip.fps
        decoder_input = decoder_input_of(network, gaze, recording)
        told = teacher_forced(gaze, previous_frames(decoder_input.true), decoder_input.memory)
        true_speed = speeds(gaze, decoder_input.true, fps)
        add("teacher-forced: speed / fitted", speeds(gaze, told, fps).mean() / true_speed.mean())
        moves = degrees(gaze, decoder_input.true - previous_frames(decoder_input.true)) > MOVES_DEG
        moves[0] = False
        late, right = (
            degrees(gaze, told - each)[moves] for each in (previous_frames(decoder_input.true), decoder_input.true)
        )
        add("teacher-forced: moving frames nearer to the last frame than to their own", float((late < right).mean()))
        speech, head = np.array(recording.speech), decoder_input.head.numpy()
        for name, frames in (("teacher-forced", told), ("fitted", decoder_input.true)):
            eyes = to_gaze_tensor(
                gaze.codebook.settings.signal, decoder_input.head, frames * gaze.codebook.scale + gaze.codebook.mean
            )
            add(f"{name}: Corr. eyes", float(critic(speech, head, eyes.numpy()).mean()))
        first, part = round(FREE_RUNNING_S * fps), round(PART_S * fps)
        alone = torch.cat(
            [
                decoder_input.true[:, first - 1 : first],
                free_running(gaze, decoder_input, first, round(WATCHED_S * fps)),
            ],
            1,
        )
        course = speeds(gaze, alone, fps)
        for number in range(len(course) // part):
            add(
                f"released {number * PART_S:g} to {(number + 1) * PART_S:g} s: deg/s",
                course[number * part :][:part].mean(),
            )
        add("fitted: deg/s", true_speed.mean())
        free = generator.generate(speech, [0], fps)
        add("free: speed / fitted", eye_speed_deg_s(free.gaze, fps).mean() / true_speed.mean())
    return {name: float(np.mean(values)) for name, values in found.items()}


def main() -> None:
    """Print a line per result, with a column per model."""
    workspace, models = Workspace.open(Path.cwd()), [Path(each) for each in sys.argv[1:] or [str(MODEL)]]
    columns = [measure(model, workspace) for model in models]
    print("models: " + ", ".join(map(str, models)))
    for name in columns[0]:
        print(f"{name:64s}", *(f"{column[name]:8.3f}" for column in columns))


if __name__ == "__main__":
    run_command(main)
