"""`talkingeyes track` and the stage `track`: from videos to a corpus.

Reads videos with sound (any container, codec, rate, size). Writes a corpus as described in docs/conventions.md, and
beside it tracked.csv (location of each clip in its video), rejected.csv, failed.csv, summary.json, table1.md,
thumbnails.html, and tracking/ (a journal per video, from which an interrupted run resumes). The index is written last:
without clips.parquet, the folder is not yet a corpus. No data leave the machine; no absolute paths are written.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.voice_activity import detect_speech
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.output_folder import output_path
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.splits import split_in_time, split_sounds
from talkingeyes.corpus.statistics import corpus_statistics, statistics_table
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.fitting.clip import FitSettings
from talkingeyes.head.observation import Observation
from talkingeyes.orchestration.run import parallel_backend, parallel_map
from talkingeyes.tracking import journal
from talkingeyes.tracking.clip_filter import fingerprint, hamming_distance, measure_shot, rejection_reason
from talkingeyes.tracking.cropping import crop_shot
from talkingeyes.tracking.estimate import estimate_tracking
from talkingeyes.tracking.face_mesh import FaceDetectionSettings, FaceMesh
from talkingeyes.tracking.journal import ShotRecord, TrackingJournal
from talkingeyes.tracking.report import DUPLICATE_OF, VideoResult, as_text, write_page, write_summary, write_tables
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.shots import Shot, detect_shots
from talkingeyes.tracking.soundtrack import Soundtrack, open_soundtrack
from talkingeyes.tracking.sources import VideoSource, find_videos
from talkingeyes.tracking.video import Frame, read_frames
from talkingeyes.workflows.track_overlay import ClipLocation
from talkingeyes.workflows.track_overlay import overlay as film

OWN_FILES = re.compile(
    r"clips\.parquet|(tracked|rejected|failed)\.csv|summary\.json|table1\.md|thumbnails(\.html)?|SHA256SUMS"
    r"|speech|annotations|observations|tracking|overlay"
)
DUPLICATE_LENGTH_TOLERANCE_S = 0.2  # between duplicates
MIN_SHOT_S = 0.5  # shorter shots are ignored


@dataclass(frozen=True)
class TrackingResult:
    """A finished corpus and the result of each video."""

    corpus: Corpus
    outcomes: list[VideoResult]


def track_command(
    videos: Sequence[Path],
    out: Path,
    overrides: Sequence[str],
    *,
    speakers: Path | None,
    jobs: int,
    dry_run: bool,
    overlay: bool,
    force: bool,
) -> Iterator[str]:
    """`talkingeyes track`; yields its output lines. `overrides` are overrides of conf/."""
    from talkingeyes.orchestration.config import compose

    if jobs < 1:
        raise InputError(f"jobs: should be 1 or more, got {jobs}")
    params = compose(overrides)
    settings = validate_section("track", TrackSettings, params["track"])
    if dry_run:
        yield estimate_tracking(find_videos(videos, speakers), settings).text(jobs)
        return
    root = output_path(out, OWN_FILES, force=True)
    if force:
        shutil.rmtree(root, ignore_errors=True)
    with parallel_backend({**params["machine"], "jobs": jobs}):
        tracked = track(videos, out, settings, speakers=speakers, jobs=jobs)
        yield as_text(tracked.outcomes)
        if overlay:
            fit = validate_section("fit", FitSettings, params["fit"])
            yield from map(str, parallel_map(partial(film, root, fit), clip_locations(tracked), jobs, "overlay"))


def track(
    videos: Sequence[Path], out: Path, settings: TrackSettings, *, speakers: Path | None = None, jobs: int = 1
) -> TrackingResult:
    """Track all videos. Resumes an interrupted call, and retries failed videos.

    Raises InputError (one line) for a folder with other content or other settings, and if no clip was kept.
    """
    found = find_videos(videos, speakers)
    root = output_path(out, OWN_FILES, force=True)
    _same_settings(root, settings)
    (root / "clips.parquet").unlink(missing_ok=True)
    journals = list(parallel_map(partial(track_video, root, settings), found, jobs, "track"))
    outcomes = mark_duplicates(
        [
            VideoResult(s, video_journal.entries, video_journal.seconds, video_journal.failure)
            for s, video_journal in zip(found, journals, strict=True)
        ],
        settings,
    )
    write_tables(root, outcomes)
    write_summary(root / "summary.json", outcomes)
    if settings.thumbnails:
        names = [entry.id for outcome in outcomes for entry in outcome.entries]
        where = {name: shard_path(Path("thumbnails"), name, ".jpg").as_posix() for name in names}
        write_page(root / "thumbnails.html", where, outcomes)
    clips = index_rows(outcomes, settings)
    if not clips:
        raise InputError(
            f"{out}: should contain clips, got none kept of {len(found)} videos; see {out}/rejected.csv and failed.csv"
        )
    (root / "table1.md").write_text(statistics_table(root.name, corpus_statistics(clips), "tracked from video"))
    corpus = Corpus(root)
    corpus.write_index(clips)
    return TrackingResult(corpus, outcomes)


def track_video(root: Path, settings: TrackSettings, source: VideoSource) -> TrackingJournal:
    """Track one video from where its journal ends; an unreadable video is recorded, without raising an error."""
    path = shard_path(root / "tracking", source.id, ".jsonl")
    video_journal = journal.read(path)
    if video_journal.done:
        return video_journal
    if video_journal.attempt_count >= settings.max_attempts:
        journal.add(
            path,
            "failed",
            f"crashed {video_journal.attempt_count} times without an error message; the next call tries again",
        )
        return journal.read(path)
    journal.add(path, "begin", True)
    clock = _LastFrameTime()
    try:
        with open_soundtrack(source.path) as sound:
            seen = detect_shots(
                clock.watch(read_frames(source.path, settings.max_fps, video_journal.resume_s)),
                get_face_mesh(settings.face),
                settings.shot,
            )
            worth = (shot for shot in seen if shot.stop_s - shot.start_s >= MIN_SHOT_S)
            for number, shot in enumerate(worth, start=len(video_journal.entries)):
                journal.add(path, "shot", write_shot(root, settings, f"{source.id}-{number:04d}", shot, sound))
    except (InputError, OSError, ValueError, RuntimeError, MemoryError) as error:
        journal.add(path, "failed", " ".join(str(error).split()) or type(error).__name__)
        return journal.read(path)
    journal.finish(path, round(clock.last_s, 3))
    return journal.read(path)


def clip_locations(tracked: TrackingResult) -> list[tuple[Clip, ClipLocation]]:
    """Location of each clip of a corpus in the videos."""
    where = {
        entry.id: ClipLocation(outcome.source.path, entry.start_s, entry.crop)
        for outcome in tracked.outcomes
        for entry in outcome.entries
    }
    return [(clip, where[clip.id]) for clip in tracked.corpus.clips]


def write_shot(root: Path, settings: TrackSettings, name: str, shot: Shot, sound: Soundtrack) -> ShotRecord:
    """Assess a shot; write its observation, sound and annotation if it is kept, and its thumbnail in any case."""
    frame = crop_shot(shot, settings.fps, settings.crop, settings.eyes)
    seen = frame.observation
    clip_sound = sound.cut(shot.start_s, round(len(seen.landmarks) * SAMPLE_RATE / settings.fps))
    quality = measure_shot(shot, seen, clip_sound, settings.eyes)
    reason = rejection_reason(quality, settings.clip_filter)
    if not reason:
        corpus = Corpus(root)
        corpus.write_sound(name, clip_sound, detect_speech(clip_sound) if quality.speaking else Annotation())
        corpus.write_clip(name, seen, None, None)
    if settings.thumbnails:
        import cv2

        path = make_shard_path(root / "thumbnails", name, ".jpg")
        cv2.imwrite(str(path), cv2.cvtColor(shot.image, cv2.COLOR_RGB2BGR))
    return ShotRecord(
        id=name,
        start_s=shot.start_s,
        stop_s=shot.stop_s,
        resume_s=shot.resume_s,
        end_reason=shot.end_reason,
        reason=reason,
        crop=frame.crop,
        fingerprint=fingerprint(seen.landmarks),
        content_hash=_content_hash(clip_sound, seen),
        quality=quality,
    )


def mark_duplicates(outcomes: list[VideoResult], settings: TrackSettings) -> list[VideoResult]:
    """The results, with every kept shot that duplicates an earlier one marked.

    Candidates share 16 bits of the fingerprint at the same position, so not all pairs of a million clips are compared.
    """
    places: dict[tuple[int, str], list[ShotRecord]] = {}
    judged = []
    for outcome in outcomes:
        entries = []
        for entry in outcome.entries:
            keys = [(at, entry.fingerprint[at : at + 4]) for at in range(0, len(entry.fingerprint), 4)]
            if not entry.reason:
                near = (other for key in keys for other in places.get(key, ()))
                twin = next(
                    (
                        other
                        for other in near
                        if _is_duplicate(entry, other, settings.clip_filter.max_duplicate_distance)
                    ),
                    None,
                )
                if twin is None:
                    for key in keys:
                        places.setdefault(key, []).append(entry)
                else:
                    entry = replace(entry, reason=f"{DUPLICATE_OF} {twin.id}")  # noqa: PLW2901
            entries.append(entry)
        judged.append(replace(outcome, entries=tuple(entries)))
    return judged


def index_rows(outcomes: Sequence[VideoResult], settings: TrackSettings) -> list[Clip]:
    """Rows of the index; all clips of a video are in the same split, unless there is one person alone."""
    kept = [(outcome.source, entry) for outcome in outcomes for entry in outcome.entries if not entry.reason]
    speaker_of = {entry.id: source.speaker for source, entry in kept}
    if len(set(speaker_of.values())) <= 1:
        split = split_in_time({entry.id: entry.quality.seconds for _, entry in kept})
    else:
        split = split_sounds(speaker_of, {entry.id: [source.name] for source, entry in kept}, settings.seed)
    return [_row(source, entry, split[entry.id], settings) for source, entry in kept]


def _row(source: VideoSource, entry: ShotRecord, split: str, settings: TrackSettings) -> Clip:
    return Clip(
        id=entry.id,
        sound=entry.id,
        take=0,
        speaker=source.speaker,
        split=split,
        seconds=entry.quality.seconds,
        fps=settings.fps,
        emotion="",
        intensity=0,
        language="",
        text="",
        source=settings.source,
        licence=settings.licence,
        content_hash=entry.content_hash,
        speaker_name=source.speaker_name,
    )


class _LastFrameTime:
    """Remembers the time of the last frame."""

    last_s = 0.0

    def watch(self, seen: Iterator[Frame]) -> Iterator[Frame]:
        for frame in seen:
            self.last_s = frame.time_s
            yield frame


@cache
def _mesh(settings: FaceDetectionSettings) -> FaceMesh:
    """One pair of networks per process, because loading takes a second."""
    return FaceMesh(settings)


def get_face_mesh(settings: FaceDetectionSettings) -> FaceMesh:
    """The networks of this process, reset before a new video."""
    mesh = _mesh(settings)
    mesh.reset()
    return mesh


def _is_duplicate(one: ShotRecord, other: ShotRecord, bits: float) -> bool:
    same_length = abs(one.quality.seconds - other.quality.seconds) < DUPLICATE_LENGTH_TOLERANCE_S
    return same_length and hamming_distance(one.fingerprint, other.fingerprint) < bits


def _same_settings(root: Path, settings: TrackSettings) -> None:
    """Store the settings beside the journals; a run with other settings cannot be resumed."""
    path = root / "tracking" / "settings.json"
    wanted = json.loads(settings.model_dump_json(exclude={"seed", "source", "licence"}))
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(wanted, indent=1) + "\n")
    elif read_json(path, "file of settings") != wanted:
        raise InputError(f"{root}: should be tracked with the same settings, got others; use another folder or --force")


def _content_hash(sound: Float[ndarray, " N"], seen: Observation) -> str:
    content = hashlib.blake2b(digest_size=16)
    for array in (sound, seen.landmarks, seen.pupils):
        content.update(np.ascontiguousarray(array, np.float32).tobytes())
    return content.hexdigest()
