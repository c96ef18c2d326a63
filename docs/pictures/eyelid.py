"""Draws the two pictures of docs/eyelid.md.

Run     python docs/pictures/eyelid.py CORPUS [FOLDER]     (a synthetic corpus, as data/synthesize)
Writes  eyelid-parameters.png, eyelid-tracks.png: the true motion of the first long test clip that blinks
"""

from __future__ import annotations

import sys
from pathlib import Path

from talkingeyes.corpus.store import Corpus
from talkingeyes.head.anny import anny_head
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.rendering.eyelid_plots import plot_parameters, plot_tracks

SECONDS = 8.0
LEAST_BLINKS = 3


def main() -> None:
    """Both pictures."""
    corpus = Corpus(Path(sys.argv[1]))
    folder = Path(sys.argv[2]) if sys.argv[2:] else Path(__file__).resolve().parent
    plot_parameters(anny_head(), folder / "eyelid-parameters.png")
    for clip in corpus.select("test", take=0):
        blinks = [blink for blink in corpus.truth_events(clip).blinks if blink.onset_s < SECONDS - 0.3]
        motion = corpus.truth(clip)
        if motion.seconds >= SECONDS and len(blinks) >= LEAST_BLINKS:
            path = folder / "eyelid-tracks.png"
            plot_tracks(motion, corpus.speech(clip), corpus.annotation(clip), (0.0, SECONDS), path)
            print(f"{path.name}: clip {clip.id}")
            return


if __name__ == "__main__":
    configure_environment()
    main()
