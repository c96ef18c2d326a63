"""Writes files with the names used in the docs to the current folder: FLAME_FILE, SPEECH.wav, VIDEOS.

Run     python tests/placeholder_files.py SOUND     (any; SPEECH.wav is its beginning)
"""

import sys
from pathlib import Path

import soundfile
from flame_file import arrays, write

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.corpus.store import Corpus
from talkingeyes.head.anny import anny_head
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.video import write_video
from talkingeyes.rendering.view import FRAMINGS

# Enough people for one in each split of a tracked corpus, and clips longer than a training window.
PEOPLE, SECONDS, SIDE = 8, 8.4, 128
SPEECH_S = 2.0


def videos(corpus: Corpus, folder: Path) -> None:
    """Rendered videos of people who talk: true motion of the corpus with its sound, a folder for each person."""
    renderer = HeadRenderer(anny_head(), FRAMINGS["head"].view(SIDE, SIDE))
    for index, clip in enumerate(corpus.select("train", "val", "test", "unseen", take=0)[:PEOPLE]):
        motion = corpus.truth(clip)
        count = round(SECONDS * motion.fps)
        path = folder / f"person_{index}" / "talk.mp4"
        path.parent.mkdir(parents=True)
        sound = corpus.speech(clip)[: round(SECONDS * SAMPLE_RATE)]
        write_video(path, renderer.draw(motion.cut(0, count)), motion.fps, sound)


if __name__ == "__main__":
    write(Path("FLAME_FILE"), arrays())
    sound, rate = soundfile.read(sys.argv[1])
    soundfile.write("SPEECH.wav", sound[: round(SPEECH_S * rate)], rate)
    videos(Corpus(Path("data/synthesize")), Path("VIDEOS"))
