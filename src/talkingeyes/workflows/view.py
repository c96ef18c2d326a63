"""`talkingeyes view`: motions in the browser, with their sound.

Reads motions (.npz; events beside them) or samples of the stage `sample`, a sound, and from a corpus the sound, words
and truth of the clip with the name of the first motion. Serves one page on this machine until
interrupted, or writes it as one file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.apps.viewer.local_server import LOCALHOST, serve
from talkingeyes.apps.viewer.scene import NO_EVENTS, Scene, ViewerMotion
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.corpus.motion_loading import load_motions
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.head.model import HeadModel
from talkingeyes.workflows.render import check_output_file, load_shown_head, retarget_to_head

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
    eyelid: Path | str | None = None,
    look: str | None = None,
    host: str = LOCALHOST,
    port: int = PORT,
    on_start: Callable[[str], None],
) -> None:
    """Show motions side by side until interrupted; `on_start` is called with the URL of the page.

    Raises InputError (one line) for an invalid file, head, number of motions or port.
    """
    from talkingeyes.apps.viewer.server import viewer_app

    scene, target_head = _scene_on_head(motions, truth, sound, words, corpus, head, model, eyelid, look)
    serve(viewer_app(scene, target_head, host), host, port, on_start)


def write_page(
    motions: Sequence[Path | str],
    page: Path | str,
    *,
    truth: Path | str | None = None,
    sound: Path | str | None = None,
    words: Path | str | None = None,
    corpus: Path | str | None = None,
    head: str = "anny",
    model: Path | str | None = None,
    eyelid: Path | str | None = None,
    look: str | None = None,
    force: bool = False,
) -> None:
    """Write motions side by side as one HTML file that opens without a server. Raises InputError as `view` does."""
    from talkingeyes.apps.viewer.server import page_files
    from talkingeyes.apps.viewer.standalone import standalone_page

    target = check_output_file(Path(page), ".html", force)
    scene, target_head = _scene_on_head(motions, truth, sound, words, corpus, head, model, eyelid, look)
    content = standalone_page(page_files(scene, target_head))
    with atomic_write(target) as partial:
        partial.write_text(content)


def _scene_on_head(
    motions: Sequence[Path | str],
    truth: Path | str | None,
    sound: Path | str | None,
    words: Path | str | None,
    corpus: Path | str | None,
    head: str,
    model: Path | str | None,
    eyelid: Path | str | None,
    look: str | None,
) -> tuple[Scene, HeadModel]:
    """The scene with its motions on a head, and the head."""
    target_head = load_shown_head(head, model, eyelid, look)
    scene = build_scene(motions, truth=truth, sound=sound, words=words, corpus=corpus)
    viewer_motions = tuple(_shown_on(each, target_head, model) for each in scene.viewer_motions)
    return replace(scene, viewer_motions=viewer_motions), target_head


def _shown_on(viewer_motion: ViewerMotion, head: HeadModel, model: Path | str | None) -> ViewerMotion:
    """The motion on a head, with the parts that it lacks in its title."""
    motion, resting = viewer_motion.motion, viewer_motion.motion.parts_at_rest
    title = f"{viewer_motion.name} ({', '.join(resting)} at rest)" if resting else viewer_motion.name
    return replace(viewer_motion, name=title, motion=to_forward_axes(retarget_to_head(motion, head, model)))


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
    audio = known.sound if sound is None else read_speech(sound)
    beside = files[0].with_suffix(".mp4")
    if audio is None and beside.is_file():
        audio = read_speech(beside)
    said = known.words if words is None else Annotation.load(Path(words)).words
    return Scene(", ".join(file.stem for file in files), viewer_motions, audio, said)


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
