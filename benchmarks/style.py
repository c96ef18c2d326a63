"""Style transfer from a reference clip, for unseen speakers.

Run: python -m benchmarks.style --workspace build/style --model talkingeyes_style_encoder Reads: data of a workspace
with the model. Prints, for pairs of unseen speakers: how often the samples of a speech with A's reference differ from
those with B's in the direction in which A's other clips differ from B's. Chance: 0.5.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.corpus.recordings import Recording, recordings
from talkingeyes.corpus.store import Corpus
from talkingeyes.models.condition.conditioner import ConditioningInputs
from talkingeyes.physiology.frame_saccades import find_saccades
from talkingeyes.training.conditioning import motion_array
from talkingeyes.training.motion_generators import load_generator

SAMPLES = 4


@dataclass(frozen=True)
class StyleStatistics:
    """Range of head and eyes (standard deviations, degrees), and saccades per second."""

    head_range_deg: float
    eye_range_deg: float
    saccades_hz: float


def style_statistics(head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"], fps: float) -> StyleStatistics:
    """Statistics of one motion."""
    space = rotation.gaze_in_space(head.astype(np.float64), gaze.astype(np.float64)).mean(1)
    rate = len(find_saccades(space, fps)) / (len(head) / fps)
    head_range_deg, eye_range_deg = (float(np.degrees(each.std(0).mean())) for each in (head, gaze[..., :2]))
    return StyleStatistics(head_range_deg, eye_range_deg, rate)


def mean(found: list[StyleStatistics]) -> StyleStatistics:
    """Mean over motions."""
    return StyleStatistics(*np.mean([list(asdict(each).values()) for each in found], axis=0).tolist())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workspace", type=Path, default=Path("build/style"))
    parser.add_argument("--model", default="talkingeyes_style_encoder")
    parser.add_argument("--speeches", type=int, default=4)
    asked = parser.parse_args()
    data = asked.workspace / "data"
    if not (data / "train" / asked.model).exists():  # make bench
        print(f"style: no {asked.model} in {data / 'train'}, nothing to measure")
        return
    generator = load_generator(data / "train" / asked.model)
    clips = recordings(Corpus(data / "synthesize"), data / "fit", data / "embed", "unseen", take=0)
    speeches = list(recordings(Corpus(data / "synthesize"), data / "fit", data / "embed", "val", take=0))
    by_speaker: defaultdict[str, list[Recording]] = defaultdict(list)
    for each in clips:
        by_speaker[each.clip.speaker].append(each)
    true, made = {}, {}
    for who, (first, *others) in by_speaker.items():
        if not others:
            continue
        true[who] = mean([style_statistics(each.head, each.gaze, each.clip.fps) for each in others])
        conditioning = ConditioningInputs(reference=torch.from_numpy(motion_array(first.head, first.gaze))[None])
        found = []
        for speech in speeches[: asked.speeches]:
            drawn = generator.generate(np.asarray(speech.speech), list(range(SAMPLES)), speech.clip.fps, conditioning)
            found += [style_statistics(drawn.head[index], drawn.gaze[index], drawn.fps) for index in range(SAMPLES)]
        made[who] = mean(found)
    pairs = list(combinations(true, 2))
    print(f"{len(true)} unseen speakers, {len(pairs)} pairs, {SAMPLES * asked.speeches} samples each")
    print("| statistic | pairs in the right direction | r over speakers | spread generated / true |")
    print("|---|---|---|---|")
    for name in asdict(next(iter(true.values()))):
        ours, theirs = ({who: getattr(each, name) for who, each in of.items()} for of in (made, true))
        right = np.mean([(ours[a] - ours[b]) * (theirs[a] - theirs[b]) > 0 for a, b in pairs])
        values = np.array([list(ours.values()), list(theirs.values())])
        spread = values.std(1)
        print(f"| {name} | {right:.2f} | {np.corrcoef(values)[0, 1]:.2f} | {spread[0] / spread[1]:.2f} |")


if __name__ == "__main__":
    main()
