"""Motions in the browser, with their sound: what `talkingeyes view` does.

Reads motions (.npz; events beside them) or what the stage `sample` wrote, a sound, and from a corpus the sound, words
and truth of the clip that they are named after. Writes nothing; serves one page on this machine until interrupted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.apps.viewer.scene import NO_EVENTS, Scene, Take
from talkingeyes.apps.viewer.serving import LOCAL, serve
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.corpus.store import Corpus, sharded
from talkingeyes.corpus.takes import motions_in
from talkingeyes.workflows.render import on_head, open_named

MOST_TAKES = 12
MOST_FRAMES = 120_000  # of all takes together: some 40 MB in the browser
PORT = 8010


@dataclass(frozen=True)
class Known:
    """What is known about a sound beside the motions made for it."""

    sound: Float[ndarray, " N"] | None = None
    words: tuple[Span, ...] = ()
    truth: Take | None = None


def view(
    motions: Sequence[Path | str],
    *,
    truth: Path | str | None = None,
    sound: Path | str | None = None,
    words: Path | str | None = None,
    corpus: Path | str | None = None,
    head: str = "anny",
    model: Path | str | None = None,
    host: str = LOCAL,
    port: int = PORT,
    started: Callable[[str], None],
) -> None:
    """Show motions side by side until interrupted; `started` is told the address of the page.

    Raises InputError (one line) for a file, a head, a number of motions or a port that will not do.
    """
    from talkingeyes.apps.viewer.server import viewer_app

    drawn = open_named(head, model)
    scene = scene_of(motions, truth=truth, sound=sound, words=words, corpus=corpus)
    takes = tuple(replace(take, motion=on_head(take.motion, drawn, model)) for take in scene.takes)
    serve(viewer_app(replace(scene, takes=takes), drawn, host), host, port, started)


def scene_of(
    motions: Sequence[Path | str],
    *,
    truth: Path | str | None = None,
    sound: Path | str | None = None,
    words: Path | str | None = None,
    corpus: Path | str | None = None,
) -> Scene:
    """The motions of files with what is known beside them; the truth stands first."""
    files = [Path(motion) for motion in motions]
    if not files:
        raise InputError("motions: should be one file or more, got none")
    known = Known() if corpus is None else _of_clip(Corpus(Path(corpus)), files[0].stem)
    true = known.truth if truth is None else replace(_taken(Path(truth), Path(truth).stem), truth=True)
    takes = tuple([] if true is None else [true]) + tuple(take for file in files for take in _takes(file))
    if len(takes) > MOST_TAKES:
        raise InputError(f"motions: should be at most {MOST_TAKES} to look at together, got {len(takes)}")
    frames = sum(len(take.motion) for take in takes)
    if frames > MOST_FRAMES:
        raise InputError(f"motions: should have at most {MOST_FRAMES} frames together, got {frames}")
    heard = known.sound if sound is None else read_speech(sound)
    beside = files[0].with_suffix(".mp4")
    if heard is None and beside.is_file():
        heard = read_speech(beside)
    said = known.words if words is None else Annotation.load(Path(words)).words
    return Scene(", ".join(file.stem for file in files), takes, heard, said)


def _of_clip(corpus: Corpus, name: str) -> Known:
    clip = next((clip for clip in corpus.clips if clip.id == name), None)
    if clip is None:
        raise InputError(f"corpus: should have a clip named as the first motion, got none called {name}")
    true = _taken(sharded(corpus.root / "truth", name, ".npz"), name) if corpus.has_truth else None
    return Known(
        corpus.speech(clip), corpus.annotation(clip).words, None if true is None else replace(true, truth=True)
    )


def _takes(file: Path) -> Iterator[Take]:
    """The motion of a file, or each of the samples in it."""
    motions = motions_in(file)
    if len(motions) == 1:
        yield _taken(file, file.stem)
        return
    for index, motion in enumerate(motions):
        yield Take(f"{file.stem}, sample {index}", motion)


def _taken(file: Path, name: str) -> Take:
    motion = Motion.load(file)
    beside = file.with_name(f"{file.stem}.events.json")
    return Take(name, motion, Events.load(beside) if beside.is_file() else NO_EVENTS)
