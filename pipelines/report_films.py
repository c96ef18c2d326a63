"""The films of the report: a few seconds of each row on the open head, which MLflow shows beside its figures.

Every film has the same sound. A row of gaze and head has a neutral face, a row of the face a still head. The motion of
`mismatched` is that of another sound of the speaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_loading import load_motions
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.head.anny import anny_head
from talkingeyes.orchestration.run import InputPaths, Workspace, parallel_map
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.video import ReportSettings, write_video
from talkingeyes.rendering.view import FRAMINGS

FILM_PX = 160


def write_films(workspace: Workspace, rows: Sequence[str], clip: Clip, folder: Path) -> None:
    """Write <row>.mp4 of the first seconds of a clip for every row that has a motion for it."""
    folder.mkdir()
    film_s = workspace.settings("report", ReportSettings).film_s
    of_rows = [workspace.input_paths(row) for row in rows]
    list(parallel_map(partial(write_film, clip, folder, film_s), of_rows, workspace.jobs, "films"))


def write_film(clip: Clip, folder: Path, film_s: float, paths: InputPaths) -> None:
    """Write the film of one row; none if it has no motion for the clip."""
    motion = row_motion(paths, clip)
    if motion is None:
        return
    short = motion.cut(0, round(film_s * motion.fps))
    speech = Corpus(paths.corpus).speech(clip)[: round(short.seconds * SAMPLE_RATE)]
    renderer = HeadRenderer(anny_head(), FRAMINGS["head"].view(FILM_PX, FILM_PX))
    write_video(folder / f"{paths.row}.mp4", renderer.draw(short), short.fps, speech)


def row_motion(paths: InputPaths, clip: Clip) -> Motion | None:
    """The motion of a row for a clip: the first sample of a model."""
    corpus = Corpus(paths.corpus)
    if paths.row == "truth":
        return corpus.truth(clip) if corpus.has_truth else None
    if paths.row == "fitted":
        return _fitted(paths, clip)
    if paths.row == "mismatched":
        others = (each for each in corpus.clips if each.speaker == clip.speaker and each.sound != clip.sound)
        return next(filter(None, (_fitted(paths, other) for other in others)), None)
    sampled = shard_path(paths.sample, clip.id, ".npz")
    return load_motions(sampled)[0] if sampled.is_file() else None


def _fitted(paths: InputPaths, clip: Clip) -> Motion | None:
    path = shard_path(paths.fit / "motion", clip.id, ".npz")
    return Motion.load(path) if path.is_file() else None
