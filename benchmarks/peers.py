"""The default model, tracking and synthesis beside published systems, in one run: CPU seconds for 10 and 40 s of sound.

The decoders of FaceFormer (Fan et al. 2022), CodeTalker (Xing et al. 2023), ProbTalk3D (Wu et al. 2024) and TalkingEyes
are built at the sizes of their released configurations for VOCASET and 3DMEAD, with random weights, because weights do
not affect time. TalkingEyes prints no sizes: those of conf/model/talkingeyes_literal.yaml. All run at 25 frames per
second on one thread. FaceFormer, CodeTalker and TalkingEyes decode all earlier frames again for every new one, as
printed and released; the time of that is measured at a few frames of the clip and summed by the midpoint rule.

Decoders are measured without speech encoder, then with it: wav2vec 2.0 base (HuBERT base of ProbTalk3D is the same
network) beside the packaged encoder. MediaPipe's landmarker sees frames that are decoded already; espeak-ng says the
words of the same sounds. Rows take turns, so that a change of the machine's speed concerns all; medians.

Run     python -m benchmarks.peers [REPEATS]     (make bench; some ten minutes)
Reads   conf/ (experiment=paper_literal, synthesize, track); the packaged models; a video of shared/, if there
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from numpy import ndarray
from torch import Tensor, nn

from benchmarks.track import start, write_test_video
from pipelines.synthesize import sound_jobs, synthesize_sound, synthesize_speech
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.model_file import find_model
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import read_speech
from talkingeyes.models.gaze.regression import RegressionGaze, RegressionGazeSettings
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.synthesis.espeak import ESPEAK_SAMPLE_RATE, espeak_engine
from talkingeyes.synthesis.plan import SynthesizeSettings
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.sources import find_videos
from talkingeyes.tracking.video import probe_video, read_frames
from talkingeyes.workflows.track import track_video

DURATIONS_S = (10, 40)
FPS = 25
MEASURED_FRAMES = 10  # of a clip, at which the decoding of a prefix is timed
VERTICES = 3 * 5023
FLAME_FACE = 53
CLIP_S = 8  # of a corpus, on average
VIDEO = Path("..", "shared", "data", "real", "video", "vox2_00002.mp4")
ANIMATION, ENCODER, SYNTHESIS = "animation, default model", "its speech encoder", "synthesize, clips"
TRACKING, REAL_TRACKING = "track, drawn head", "track, real face"
WAV2VEC = "wav2vec 2.0 base"


@dataclass(frozen=True)
class Row:
    """Something that is measured: CPU seconds for a number of seconds, the row it is compared with, and its speech
    encoder, if that is not counted."""

    name: str
    cost: Callable[[int], float]
    reference: str
    encoder: str | None = None


def cpu_s(work: Callable[[], object]) -> float:
    """CPU seconds of all threads of this process."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def every_prefix(step: Callable[[int, int], object]) -> Callable[[int], float]:
    """The cost of `step(t, T)` for each frame t of T."""

    def cost(seconds: int) -> float:
        frames = seconds * FPS
        measured = (np.arange(MEASURED_FRAMES) + 0.5) * frames / MEASURED_FRAMES
        return frames * float(np.mean([cpu_s(lambda t=t: step(int(t), frames)) for t in measured]))  # type: ignore[misc]

    return cost


def transformer(width: int, layers: int, heads: int, feed: int) -> nn.TransformerEncoder:
    """Pre-norm layers of a motion autoencoder."""
    layer = nn.TransformerEncoderLayer(width, heads, feed, activation="gelu", batch_first=True, norm_first=True)
    return nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)


def nearest(features: Tensor, codebook: Tensor) -> Tensor:
    """The codes nearest to features."""
    return codebook[torch.cdist(features, codebook).argmin(-1)]


class PrefixDecoder(nn.Module):
    """Post-norm decoder layers with causal self-attention, and cross-attention to the speech of the same frame."""

    def __init__(self, width: int, layers: int, outputs: int) -> None:
        super().__init__()
        layer = nn.TransformerDecoderLayer(width, 4, 2 * width, batch_first=True)
        self.decoder, self.out = nn.TransformerDecoder(layer, layers), nn.Linear(width, outputs)
        self.embed, self.width = nn.Linear(VERTICES, width), width

    def forward(self, length: int, frames: int) -> Tensor:
        """Outputs of a prefix of `length` frames, for speech of `frames` frames."""
        causal = torch.full((length, length), -torch.inf).triu(1)
        other_frames = ~torch.eye(length, frames, dtype=torch.bool)
        past, speech = torch.randn(1, length, self.width), torch.randn(1, frames, self.width)
        out: Tensor = self.out(self.decoder(past, speech, tgt_mask=causal, memory_mask=other_frames))
        return out


class FaceFormer(PrefixDecoder):
    """One layer of width 64, to vertices."""

    def __init__(self) -> None:
        super().__init__(64, 1, VERTICES)

    def forward(self, length: int, frames: int) -> Tensor:
        """Decode a prefix, and embed its last frame for the next."""
        embedded: Tensor = self.embed(super().forward(length, frames)[:, -1])
        return embedded


class CodeTalker(PrefixDecoder):
    """Six layers of width 1,024 to 16 codes a frame, which six more layers decode to vertices."""

    def __init__(self) -> None:
        super().__init__(1024, 6, 16 * 64)
        self.codebook = nn.Parameter(torch.randn(256, 64))
        self.smooth, self.autoencoder = nn.Conv1d(1024, 1024, 5, padding=2), transformer(1024, 6, 8, 1536)
        self.vertices = nn.Linear(1024, VERTICES)

    def forward(self, length: int, frames: int) -> Tensor:
        """Decode a prefix to codes and to vertices, and embed its last frame for the next."""
        codes = nearest(super().forward(length, frames).view(-1, 64), self.codebook).view(1, length, 1024)
        decoded = self.autoencoder(self.smooth(codes.transpose(1, 2)).transpose(1, 2))
        embedded: Tensor = self.embed(self.vertices(decoded)[:, -1])
        return embedded


class ProbTalk3D(nn.Module):
    """Twelve layers of width 256 to two codes a frame, sampled for all frames at once; six layers decode them."""

    def __init__(self) -> None:
        super().__init__()
        self.codebook = nn.Parameter(torch.randn(256, 128))
        self.enter, self.leave = nn.Conv1d(256, 256, 5, padding=2), nn.Conv1d(256, 256, 5, padding=2)
        self.predictor, self.autoencoder = transformer(256, 12, 8, 384), transformer(256, 6, 8, 384)
        self.out = nn.Linear(256, FLAME_FACE)

    def forward(self, frames: int) -> Tensor:
        """A face of `frames` frames."""
        latents = self.predictor(self.enter(torch.randn(1, 256, frames)).transpose(1, 2)).reshape(-1, 128)
        chances = (-torch.cdist(latents, self.codebook) / 0.2).softmax(-1)
        codes = self.codebook[torch.multinomial(chances, 1)[:, 0]].view(1, frames, 256)
        face: Tensor = self.out(self.autoencoder(self.leave(codes.transpose(1, 2)).transpose(1, 2)))
        return face


def talkingeyes_decoder() -> Callable[[int, int], Tensor]:
    """The cross-modal decoder of eq. 9 and 10 for one more frame: features of the prefix, their codes, D_VQ."""
    params = compose(["experiment=paper_literal"])
    codebook = GazeVQVAE(GazeVQVAESettings.model_validate(params["pretrain"]["gaze_literal"]["network"])).eval()
    settings = RegressionGazeSettings.model_validate(params["model"]["talkingeyes_literal"]["gaze"])
    gaze = RegressionGaze(settings, speech=64, codebook=codebook).eval()

    def step(length: int, frames: int) -> Tensor:
        past, memory = torch.randn(1, length, 6), torch.randn(1, frames, settings.transformer.width)
        codes = codebook.quantiser(gaze.out(gaze.transformer(gaze.embed(past), memory))).codes
        return codebook.decode(codes, torch.zeros(1, length, dtype=torch.bool))

    return step


def animation_rows() -> list[Row]:
    """The default model and the decoders of others, with both speech encoders."""
    from transformers import Wav2Vec2Config, Wav2Vec2Model

    animator = Animator.load(find_model(None))
    speech = read_speech(package_file(EXAMPLE_SPEECH))
    sounds = {seconds: np.resize(speech, seconds * 16_000).astype(np.float32) for seconds in DURATIONS_S}
    features = {seconds: animator.encoder(sound, animator.fps) for seconds, sound in sounds.items()}
    wav2vec, probtalk3d = Wav2Vec2Model(Wav2Vec2Config()).eval(), ProbTalk3D().eval()

    def animate(seconds: int) -> float:
        return cpu_s(lambda: animator.generate_from_embedding(features[seconds], 1, seed=0, fps=animator.fps))

    def gaze_and_head(seconds: int) -> float:
        return cpu_s(lambda: animator.generator.generate(features[seconds], [0], animator.fps))

    prefix: dict[str, Callable[[int, int], Tensor]] = {
        "TalkingEyes, gaze": talkingeyes_decoder(),
        "FaceFormer": FaceFormer().eval(),
        "CodeTalker": CodeTalker().eval(),
    }
    return [
        Row(ANIMATION, animate, ANIMATION, ENCODER),
        Row("its gaze and head alone", gaze_and_head, ANIMATION, ENCODER),
        Row("ProbTalk3D", lambda seconds: cpu_s(lambda: probtalk3d(seconds * FPS)), ANIMATION, WAV2VEC),
        *(Row(name, every_prefix(step), ANIMATION, WAV2VEC) for name, step in prefix.items()),
        Row(ENCODER, lambda seconds: cpu_s(lambda: animator.encoder(sounds[seconds], animator.fps)), ENCODER),
        Row(WAV2VEC, lambda seconds: cpu_s(lambda: wav2vec(torch.from_numpy(sounds[seconds])[None])), ENCODER),
    ]


@dataclass(frozen=True)
class TrackedVideo:
    """A video, its decoded frames and their duration."""

    path: Path
    images: list[UInt8[ndarray, "H W 3"]]
    seconds: float

    @classmethod
    def read(cls, path: Path) -> TrackedVideo:
        """Decode all frames."""
        images = [frame.image for frame in read_frames(path, 60.0)]
        return cls(path, images, len(images) / probe_video(path).fps)

    def track(self, settings: TrackSettings) -> float:
        """CPU seconds of `track`, for each second of the video."""
        with tempfile.TemporaryDirectory() as corpus:
            source = find_videos([self.path], None)[0]
            return cpu_s(lambda: track_video(Path(corpus), settings, source)) / self.seconds


def tracking_rows(folder: Path) -> list[Row]:
    """`track` and MediaPipe's landmarker alone, on drawn heads and on a real video."""
    from mediapipe.python.solutions.face_mesh import FaceMesh

    settings = TrackSettings.model_validate(compose(["track.clip_filter.require_voice=false"])["track"])
    start(settings)
    landmarker = FaceMesh(refine_landmarks=True, max_num_faces=1)
    landmarker.process(np.zeros((64, 64, 3), np.uint8))

    def rows(name: str, videos: dict[int, TrackedVideo]) -> list[Row]:
        def landmarks(seconds: int) -> float:
            video = videos[seconds]
            return cpu_s(lambda: [landmarker.process(image) for image in video.images]) * seconds / video.seconds

        return [
            Row(name, lambda seconds: videos[seconds].track(settings) * seconds, name),
            Row(f"{name}: MediaPipe's landmarker", landmarks, name),
        ]

    drawn = {
        seconds: TrackedVideo.read(write_test_video(folder / f"{seconds}.mp4", seconds)) for seconds in DURATIONS_S
    }
    real = dict.fromkeys(DURATIONS_S, TrackedVideo.read(VIDEO)) if VIDEO.is_file() else None
    return rows(TRACKING, drawn) + (rows(REAL_TRACKING, real) if real else [])


def synthesis_rows(folder: Path) -> list[Row]:
    """Clips of a corpus, their speech alone, and espeak-ng saying the same words; per second of what each makes."""
    settings = SynthesizeSettings.model_validate(compose()["synthesize"])
    jobs = [job for job in sound_jobs(settings) if job.takes == 1]
    chosen = {seconds: jobs[:: len(jobs) * CLIP_S // seconds] for seconds in DURATIONS_S}
    spoken = {job.sound.id: synthesize_speech(folder, settings, job) for jobs in chosen.values() for job in jobs}

    def clips(seconds: int) -> float:
        with tempfile.TemporaryDirectory() as corpus:
            spent_s = cpu_s(lambda: [synthesize_sound(Path(corpus), settings, job) for job in chosen[seconds]])
        return spent_s * seconds / sum(spoken[job.sound.id].seconds for job in chosen[seconds])

    def speech(seconds: int) -> float:
        spent_s = cpu_s(lambda: [synthesize_speech(folder, settings, job) for job in chosen[seconds]])
        return spent_s * seconds / sum(spoken[job.sound.id].seconds for job in chosen[seconds])

    def espeak(seconds: int) -> float:
        samples = 0
        begun = time.process_time()
        for job in chosen[seconds]:
            with espeak_engine("en-us+f3") as say:
                samples += len(say(spoken[job.sound.id].text, 170, 50, 50).sound)
        return (time.process_time() - begun) * seconds * ESPEAK_SAMPLE_RATE / samples

    return [
        Row(SYNTHESIS, clips, SYNTHESIS),
        Row("its speech alone", speech, SYNTHESIS),
        Row("espeak-ng", espeak, SYNTHESIS),
    ]


def table(rows: list[Row], cost: dict[tuple[str, int], float]) -> str:
    """Costs, their growth and their ratios to the row they are compared with, in Markdown."""
    short, long = DURATIONS_S
    lines = [
        f"| what | CPU s, {short} s | CPU s, {long} s | growth | times, {short} s | times, {long} s "
        f"| with encoder: CPU s, {short} s | CPU s, {long} s | times, {short} s | times, {long} s |",
        "|---" * 10 + "|",
    ]
    for row in rows:
        own = [cost[row.name, seconds] for seconds in DURATIONS_S]
        reference = [cost[row.reference, seconds] for seconds in DURATIONS_S]
        cells = [*own, own[1] / own[0], *(one / other for one, other in zip(own, reference, strict=True))]
        if row.encoder:
            whole = [cost[row.name, seconds] + cost[row.encoder, seconds] for seconds in DURATIONS_S]
            ours = [cost[row.reference, seconds] + cost[ENCODER, seconds] for seconds in DURATIONS_S]
            cells += [*whole, *(one / other for one, other in zip(whole, ours, strict=True))]
        lines.append(f"| {row.name} | " + " | ".join(f"{cell:.3g}" for cell in cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure all rows in turns and print the table."""
    torch.set_num_threads(1)
    repeats = int(sys.argv[1]) if sys.argv[1:] else 5
    with tempfile.TemporaryDirectory() as folder, torch.inference_mode():
        rows = animation_rows() + tracking_rows(Path(folder)) + synthesis_rows(Path(folder))
        measured = [
            {(row.name, seconds): row.cost(seconds) for row in rows for seconds in DURATIONS_S}
            for _ in range(1 + repeats)
        ]
    del measured[0]  # a warm-up
    print(table(rows, {key: float(np.median([each[key] for each in measured])) for key in measured[0]}))


if __name__ == "__main__":
    run_command(main)
