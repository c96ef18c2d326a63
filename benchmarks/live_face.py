"""Lips and jaw of live streams, as clients get them: in chunks of 40 ms, with the emotion of the sound.

Run: python -m benchmarks.live_face [MODEL] [CORPUS] [SPLIT] [SOUNDS]

Prints the fraction of p, b and m in which the lips close, and the correlation of the jaw's opening with the sound's
envelope (`probtalk3d_articulation`), with intervals over sounds: of the streams, of what the model gives with the level
of the whole sound (as the chain evaluates it), and of the true motion.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from talkingeyes.animation.live_stream import StreamFrames
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL
from talkingeyes.animation.streaming import LiveControls, LiveModel
from talkingeyes.audio.encoder import make_encoder
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.papers.probtalk3d_articulation import articulation
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface
from talkingeyes.head.anny import anny_head
from talkingeyes.models.face.style import FaceStyle, StyleKey, default_intensity

CHUNK = SAMPLE_RATE // 25
SOUNDS, RESAMPLED = 60, 2000


def main(model: Path, corpus: Corpus, split: str, sounds: int) -> None:
    """Measure and print."""
    torch.set_num_threads(1)
    live = LiveModel.load(model)
    clips = list({clip.sound: clip for clip in corpus.select(split)}.values())[:sounds]
    found = measure(live, corpus, clips)
    for row, values in found.items():
        closed, jaw = (interval(np.array(column)) for column in zip(*values, strict=True))
        print(f"{split}, {len(clips)} sounds, {row:12s} p, b, m closed {closed}  jaw and envelope {jaw}")


def measure(live: LiveModel, corpus: Corpus, clips: Sequence[Clip]) -> dict[str, list[tuple[float, float]]]:
    """Closures and correlation of each clip, by row."""
    surface, encoder = FaceSurface(anny_head()), make_encoder(live.face.embedding)
    found: dict[str, list[tuple[float, float]]] = {"stream": [], "whole level": [], "truth": []}
    for clip in clips:
        sound, emotion = corpus.speech(clip), clip.emotion or "neutral"
        style = FaceStyle(None, emotion, default_intensity(emotion, clip.intensity if clip.emotion else None))
        faces = {
            "stream": stacked(live.motion_of(streamed(live, sound, LiveControls(face=style)))),
            "whole level": live.face.generator.generate(
                encoder(sound, live.fps), [StyleKey(0.0, style)], [0], live.fps
            ),
            "truth": stacked(corpus.truth(clip)),
        }
        for row, samples in faces.items():
            measured = articulation(surface, samples, corpus.annotation(clip), sound)
            found[row].append((measured.bilabials_closed, measured.jaw_envelope))
    return found


def streamed(live: LiveModel, sound: np.ndarray, controls: LiveControls) -> StreamFrames:
    """All frames of a stream."""
    stream = live.stream(0, controls)
    parts = [stream.push(sound[start : start + CHUNK]) for start in range(0, len(sound), CHUNK)]
    return StreamFrames.concat([*parts, stream.finish()])


def stacked(motion: Motion) -> FaceSamples:
    """The face of a motion as one sample."""
    return FaceSamples(
        motion.fps,
        motion.jaw[None].astype(float),
        motion.expression[None].astype(float),
        motion.expression_names,
        motion.head_model,
    )


def interval(values: np.ndarray) -> str:
    """Mean, and its bootstrap interval of 95 %."""
    values, rng = values[np.isfinite(values)], np.random.default_rng(0)
    means = rng.choice(values, (RESAMPLED, len(values))).mean(axis=1)
    low, high = np.percentile(means, (2.5, 97.5))
    return f"{values.mean():.3f} ({low:.3f} to {high:.3f})"


if __name__ == "__main__":
    given = sys.argv[1:]
    main(
        Path(given[0]) if given else PACKAGED_LIVE_MODEL,
        Corpus(Path(given[1] if len(given) > 1 else "data/synthesize")),
        given[2] if len(given) > 2 else "val",
        int(given[3]) if len(given) > 3 else SOUNDS,
    )
