"""`talkingeyes view`: motions in the browser, with their sound.

Reads motions (.npz; events beside them) or samples of the stage `sample`, a sound, and from a corpus the sound, words
and truth of the clip with the name of the first motion. Writes nothing; serves one page on this machine until
interrupted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.apps.viewer.local_server import LOCALHOST, serve
from talkingeyes.apps.viewer.scene import NO_EVENTS, Scene, ViewerMotion
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.corpus.motion_loading import load_motions
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.workflows.render import load_head, retarget_to_head

MAX_MOTIONS = 12
MAX_FRAMES = 120_000  # of all motions together: about 40 MB in the browser
PORT = 8010


@dataclass(frozen=True)
class ClipContext:
    """Known data of a clip: its sound, words and true motion."""

    sound: Float[ndarray, " N"] | None = None
    words: tuple[Span, ...] = ()
    truth: ViewerMotion | None = None


def view(
    motions: Sequence[Path | str],
    *,
    truth: Path | str | None = None,
    sound: Path | str | None = None,
    words: Path | str | None = None,
    corpus: Path | str | None = None,
    head: str = "anny",
    model: Path | str | None = None,
    host: str = LOCALHOST,
    port: int = PORT,
    on_start: Callable[[str], None],
) -> None:
    """Show motions side by side until interrupted; `on_start` is called with the URL of the page.

    Raises InputError (one line) for an invalid file, head, number of motions or port.
    """
    from talkingeyes.apps.viewer.server import viewer_app

    target_head = load_head(head, model)
    scene = build_scene(motions, truth=truth, sound=sound, words=words, corpus=corpus)
    viewer_motions = tuple(
        replace(viewer_motion, motion=retarget_to_head(viewer_motion.motion, target_head, model))
        for viewer_motion in scene.viewer_motions
    )
    serve(viewer_app(replace(scene, viewer_motions=viewer_motions), target_head, host), host, port, on_start)


def build_scene(
    motions: Sequence[Path | str],
    *,
    truth: Path | str | None = None,
    sound: Path | str | None = None,
    words: Path | str | None = None,
    corpus: Path | str | None = None,
) -> Scene:
    """Scene of motion files and related data; the truth comes first."""
    files = [Path(motion) for motion in motions]
    if not files:
        raise InputError("motions: should be one file or more, got none")
    known = ClipContext() if corpus is None else _of_clip(Corpus(Path(corpus)), files[0].stem)
    true = known.truth if truth is None else replace(_load_motion(Path(truth), Path(truth).stem), truth=True)
    viewer_motions = tuple([] if true is None else [true]) + tuple(
        viewer_motion for file in files for viewer_motion in _load_motions(file)
    )
    if len(viewer_motions) > MAX_MOTIONS:
        raise InputError(f"motions: should be at most {MAX_MOTIONS} to view together, got {len(viewer_motions)}")
    frames = sum(len(viewer_motion.motion) for viewer_motion in viewer_motions)
    if frames > MAX_FRAMES:
        raise InputError(f"motions: should have at most {MAX_FRAMES} frames together, got {frames}")
    heard = known.sound if sound is None else read_speech(sound)
    beside = files[0].with_suffix(".mp4")
    if heard is None and beside.is_file():
        heard = read_speech(beside)
    said = known.words if words is None else Annotation.load(Path(words)).words
    return Scene(", ".join(file.stem for file in files), viewer_motions, heard, said)


def _of_clip(corpus: Corpus, name: str) -> ClipContext:
    clip = next((clip for clip in corpus.clips if clip.id == name), None)
    if clip is None:
        raise InputError(f"corpus: should have a clip named as the first motion, got none called {name}")
    true = _load_motion(shard_path(corpus.root / "truth", name, ".npz"), name) if corpus.has_truth else None
    return ClipContext(
        corpus.speech(clip), corpus.annotation(clip).words, None if true is None else replace(true, truth=True)
    )


def _load_motions(file: Path) -> Iterator[ViewerMotion]:
    """The motion of a file, or all samples in it."""
    motions = load_motions(file)
    if len(motions) == 1:
        yield _load_motion(file, file.stem)
        return
    for index, motion in enumerate(motions):
        yield ViewerMotion(f"{file.stem}, sample {index}", motion)


def _load_motion(file: Path, name: str) -> ViewerMotion:
    motion = Motion.load(file)
    beside = file.with_name(f"{file.stem}.events.json")
    return ViewerMotion(name, motion, Events.load(beside) if beside.is_file() else NO_EVENTS)
