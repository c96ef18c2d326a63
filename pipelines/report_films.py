"""The films of the report: a few seconds of each row on the open head, which MLflow shows beside its figures.

Every film has the same sound. A row of gaze and head has a neutral face, a row of the face a still head. The motion of
`mismatched` is that of another sound of the speaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipelines.evaluate_face import has_face_samples
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples, Samples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.head.anny import anny_head
from talkingeyes.orchestration.run import Workspace, parallel_map
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.video import ReportSettings, write_video
from talkingeyes.rendering.view import FRAMINGS

FILM_PX = 160


@dataclass(frozen=True)
class FilmInputPaths:
    """Where the motions of the rows are."""

    corpus: Path
    fit: Path
    sample: Path


def write_films(workspace: Workspace, rows: Sequence[str], clip: Clip, folder: Path) -> None:
    """Write <row>.mp4 of the first seconds of a clip for every row that has a motion for it."""
    folder.mkdir()
    paths = FilmInputPaths(workspace.corpus, workspace.data("fit"), workspace.data("sample"))
    film_s = workspace.settings("report", ReportSettings).film_s
    list(parallel_map(partial(write_film, paths, clip, folder, film_s), rows, workspace.jobs, "films"))


def write_film(paths: FilmInputPaths, clip: Clip, folder: Path, film_s: float, row: str) -> None:
    """Write the film of one row; none if it has no motion for the clip."""
    motion = row_motion(paths, clip, row)
    if motion is None:
        return
    short = motion.cut(0, round(film_s * motion.fps))
    speech = Corpus(paths.corpus).speech(clip)[: round(short.seconds * SAMPLE_RATE)]
    renderer = HeadRenderer(anny_head(), FRAMINGS["head"].view(FILM_PX, FILM_PX))
    write_video(folder / f"{row}.mp4", renderer.draw(short), short.fps, speech)


def row_motion(paths: FilmInputPaths, clip: Clip, row: str) -> Motion | None:
    """The motion of a row for a clip: the first sample of a model."""
    corpus = Corpus(paths.corpus)
    if row == "truth":
        return corpus.truth(clip) if corpus.has_truth else None
    if row == "fitted":
        return _fitted(paths, clip)
    if row == "mismatched":
        others = (each for each in corpus.clips if each.speaker == clip.speaker and each.sound != clip.sound)
        return next(filter(None, (_fitted(paths, other) for other in others)), None)
    sampled = shard_path(paths.sample / row, clip.id, ".npz")
    if not sampled.is_file():
        return None
    if has_face_samples(paths.sample / row):
        face = FaceSamples.load(sampled)
        frames = len(face.jaw[0])
        shown = {"jaw": face.jaw[0], "expression": face.expression[0], "expression_names": face.expression_names}
        return Motion.of(face.fps, np.zeros((frames, 3)), np.zeros((frames, 2, 3)), **shown)
    samples = Samples.load(sampled)
    return Motion.of(samples.fps, samples.head[0], samples.gaze[0])


def _fitted(paths: FilmInputPaths, clip: Clip) -> Motion | None:
    path = shard_path(paths.fit / "motion", clip.id, ".npz")
    return Motion.load(path) if path.is_file() else None
