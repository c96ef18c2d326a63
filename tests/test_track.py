"""Tracking of videos to a corpus, end to end: a rendered talking head, and real clips where available."""

import csv
import json
import shutil
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from model_conf import compose
from typer.testing import CliRunner

from talkingeyes.cli.main import app
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.store import Corpus
from talkingeyes.head.anny import anny_head
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.video import write_video
from talkingeyes.rendering.view import FRAMINGS
from talkingeyes.tracking import journal
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.sources import find_videos
from talkingeyes.tracking.video import probe_video, read_frames
from talkingeyes.workflows.track import track, track_video

REAL = Path(__file__).resolve().parents[1] / "../shared/data/real/video"
HDTF, VOX = REAL / "hdtf_WDA_KatieHill_000.mp4", REAL / "vox2_681100216.mp4"
real = pytest.mark.skipif(not HDTF.is_file(), reason="no real clips on this machine")
DRAWN, SIDE = 40, 160


def settings(**changes: Any) -> TrackSettings:
    """Default settings with changes."""
    overrides = [f"track.{name.replace('__', '.')}={json.dumps(value)}" for name, value in changes.items()]
    return TrackSettings.model_validate(compose(overrides)["track"])


@pytest.fixture(scope="module")
def drawn() -> list[np.ndarray]:
    """Pictures of the open head turning, talking and looking around; played forwards and backwards they loop."""
    times_s = np.arange(DRAWN) / 25
    head = np.stack([0.06 * np.sin(2 * times_s), 0.25 * np.sin(1.5 * times_s), 0.03 * np.cos(times_s)], axis=1)
    jaw = np.zeros((DRAWN, 3))
    jaw[:, 0] = 0.12 * np.sin(6 * times_s) ** 2
    motion = Motion.of(25.0, head, np.zeros((DRAWN, 2, 3)), jaw=jaw)
    pictures = list(HeadRenderer(anny_head(), FRAMINGS["head"].view(SIDE, SIDE)).draw(motion))
    return pictures + pictures[::-1]


def filmed(path: Path, pictures: Sequence[np.ndarray], seconds: float, fps: float = 25.0, sound: bool = True) -> Path:
    """A video that loops the pictures, with noise of varying loudness."""
    count = round(seconds * fps)
    times_s = np.arange(round(seconds * 16_000)) / 16_000
    noise = np.random.default_rng(0).normal(0, 0.1, len(times_s)) * np.abs(np.sin(5 * times_s)) ** 2
    turns = (pictures[round(index * 25 / fps) % len(pictures)] for index in range(count))
    write_video(path, turns, fps, noise.astype(np.float32) if sound else None)
    return path


@pytest.fixture(scope="module")
def videos(drawn: list[np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with videos of a talking head, a copy, two heads, a blank video, a truncated one, and another file."""
    folder = tmp_path_factory.mktemp("videos")
    (folder / "ann").mkdir()
    talk = filmed(folder / "ann" / "talk.mp4", drawn, 2.4)
    shutil.copy(talk, folder / "ben.mp4")
    filmed(folder / "pair.mp4", [np.hstack([one, one]) for one in drawn], 2.4)
    filmed(folder / "blank.mp4", [np.full((SIDE, SIDE, 3), 90, np.uint8)], 1.0)
    (folder / "broken.mp4").write_bytes(talk.read_bytes()[:2000])
    (folder / "text.mkv").write_text("no video")
    return folder


KEEP = {"clip_filter__min_lip_sync": -1.0, "clip_filter__min_duration_s": 2.0}


@pytest.fixture(scope="module")
def corpus(videos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("corpus") / "tracked"
    track([videos], root, settings(**KEEP))
    return root


def rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(newline="") as file:
        yield from csv.DictReader(file)


@pytest.mark.long
def test_a_folder_of_videos_becomes_a_corpus(corpus: Path):
    clips = {clip.id.rpartition("-")[0].rpartition("-")[0]: clip for clip in Corpus(corpus).clips}
    assert {"ann-talk"} <= set(clips)
    clip = clips["ann-talk"]
    seen, heard = Corpus(corpus).observation(clip), Corpus(corpus).speech(clip)
    assert (clip.speaker, clip.fps, clip.take, clip.seconds) == ("ann", 25.0, 0, 2.4)
    assert len(seen.landmarks) * 640 == len(heard) == 38_400
    assert seen.landmarks.shape == (60, len(LANDMARK_NAMES), 2)
    assert np.isfinite(seen.pupils).mean() > 0.8
    assert Corpus(corpus).annotation(clip).speaking
    left, right = (seen.landmarks[:, LANDMARK_NAMES.index(f"{side}_eye_outer"), 0].mean() for side in ("left", "right"))
    assert left > right + 50


def test_rejected_clips_are_listed_with_reason(corpus: Path):
    reasons = {row["video"]: row["reason"] for row in rows(corpus / "rejected.csv")}
    assert reasons["blank.mp4"] == "no face was found"
    assert reasons["ben.mp4"].startswith("a copy of ann-talk")
    assert reasons["pair.mp4"].startswith("more than one face")
    assert {row["video"] for row in rows(corpus / "failed.csv")} == {"broken.mp4", "text.mkv"}
    total = json.loads((corpus / "summary.json").read_text())
    assert (total["videos"], total["videos_failed"]) == (6, 2)
    page = (corpus / "thumbnails.html").read_text()
    assert all(f"{word}: " in page for word in ("Kept", "Rejected"))
    assert page.count("<img") == total["shots"] == len(list((corpus / "thumbnails").rglob("*.jpg")))


def test_no_path_of_this_machine_is_in_the_corpus(corpus: Path, videos: Path):
    for path in corpus.rglob("*"):
        if path.is_file():
            assert str(videos).encode() not in path.read_bytes(), path


def test_an_interrupted_run_ends_with_the_same_bytes(corpus: Path, videos: Path, tmp_path: Path):
    root, chosen = tmp_path / "again", settings(**KEEP)
    for kind in (
        "tracking",
        "speech",
        "annotations",
        "observations",
        "thumbnails",
    ):  # as after a crash, before the lists are written
        shutil.copytree(corpus / kind, root / kind)
    lost = next((root / "observations").rglob("ann-talk*"))
    lost.unlink()
    half = next((root / "tracking").rglob("ann-talk*"))
    half.write_text(
        half.read_text().splitlines()[0] + '\n{"begin": true}\n{"shot": {"id"'
    )  # the end of the file was not written
    track([videos], root, chosen, jobs=1)
    ours, theirs = ({p.relative_to(r): p.read_bytes() for p in r.rglob("*") if p.is_file()} for r in (root, corpus))
    assert sorted(ours) == sorted(theirs)
    noted = {path for path in ours if ours[path] != theirs[path]} - {Path("table1.md")}
    assert {path.stem.rpartition("-")[0] for path in noted} <= {"broken", "text"}  # failed videos are retried


def test_repeatedly_failing_video_is_skipped(videos: Path, tmp_path: Path):
    source = find_videos([videos / "blank.mp4"], None)[0]
    chosen = settings(**KEEP)
    video_journal = track_video(tmp_path, chosen, source)
    assert (video_journal.done, video_journal.entries) == (True, ())
    path = next((tmp_path / "tracking").rglob("*.jsonl"))
    path.write_text('{"begin": true}\n{"begin": true}\n')
    assert "crashed 2 times" in track_video(tmp_path, chosen, source).failure
    assert track_video(tmp_path, chosen, source).done  # and tried again by the next call


def test_mistakes_are_one_line(videos: Path, corpus: Path, tmp_path: Path):
    with pytest.raises(InputError, match=r"^[^\n]*same settings[^\n]*$"):
        track([videos], corpus, settings(fps=30.0))
    with pytest.raises(InputError, match=r"^[^\n]*got none kept of 1 videos[^\n]*$"):
        track([videos / "blank.mp4"], tmp_path / "none", settings(thumbnails=False))
    assert not (tmp_path / "none" / "clips.parquet").exists()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.doc").touch()
    with pytest.raises(InputError, match=r"thesis\.doc"):
        track([videos], tmp_path / "full", settings())


@pytest.mark.long
def test_the_command_plans_tracks_without_pictures_and_films_the_fit(drawn: list[np.ndarray], tmp_path: Path):
    video = filmed(tmp_path / "talk.mp4", drawn, 0.8)
    call = ["track", str(video), "-o", str(tmp_path / "out"), "--set", "clip_filter.min_duration_s=0.5"]
    planned = CliRunner().invoke(app, [*call, "--dry-run"], catch_exceptions=False)
    assert "1 videos, 0.00 h, 20 frames" in planned.output
    assert not (tmp_path / "out").exists()
    done = CliRunner().invoke(app, [*call, "--keep-silent", "--no-thumbnails", "--overlay"], catch_exceptions=False)
    assert "1 clips kept" in done.output
    assert not (tmp_path / "out" / "thumbnails").exists()
    film = next((tmp_path / "out" / "overlay").iterdir())
    assert (probe_video(film).width, probe_video(film).height) == (896, 448)
    assert len(list(read_frames(film, 60.0))) == 20


def test_rotation_flags_are_obeyed(drawn: list[np.ndarray], tmp_path: Path):
    upright = filmed(tmp_path / "a.mp4", [np.vstack([one, one // 2]) for one in drawn[:1]], 0.4)
    content = bytearray(upright.read_bytes())
    matrix = content.index(b"tkhd") + 4 + 40  # version 0: rotated a quarter clockwise for display, as phones write it
    content[matrix : matrix + 36] = np.array([0, 65536, 0, -65536, 0, 0, 0, 0, 1 << 30], ">i4").tobytes()
    (tmp_path / "b.mp4").write_bytes(content)
    straight, turned = (next(read_frames(tmp_path / f"{name}.mp4", 60.0)).image for name in "ab")
    assert np.abs(np.rot90(straight, -1).astype(int) - turned).mean() < 2


def remade(path: Path, pictures: Sequence[np.ndarray], rate: Fraction, sound: np.ndarray | None = None) -> Path:
    write_video(path, pictures, float(rate), sound)
    return path


@pytest.fixture(scope="module")
def clips() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The beginnings of two real clips, 224 pixels wide."""
    import cv2

    first = [cv2.resize(frame.image, (224, 224), interpolation=cv2.INTER_AREA) for frame in read_frames(HDTF, 60.0)]
    return first[:60], [frame.image for frame in read_frames(VOX, 60.0)][:60]


@real
def test_real_faces_side_by_side_at_29_97_and_truncated(clips: tuple[list[np.ndarray], ...], tmp_path: Path):
    one, other = clips
    (tmp_path / "in").mkdir()
    remade(tmp_path / "in/pair.mp4", [np.hstack(both) for both in zip(one, other, strict=True)], Fraction(25))
    remade(tmp_path / "in/ntsc.mp4", one, Fraction(30000, 1001))
    remade(tmp_path / "in/joined.mp4", [*one[:50], *other[:50]], Fraction(25))
    whole = HDTF.read_bytes()
    (tmp_path / "in/truncated.mp4").write_bytes(whole[: len(whole) // 2])
    tracked = track(
        [tmp_path / "in"], tmp_path / "out", settings(clip_filter__require_voice=False, clip_filter__min_duration_s=1.5)
    )
    reasons = [row["reason"] for row in rows(tmp_path / "out/rejected.csv") if row["video"] == "pair.mp4"]
    assert any(reason.startswith("more than one face") for reason in reasons)
    assert not any(clip.id.startswith("pair") for clip in tracked.corpus.clips)
    lengths = {clip.id.partition("-")[0]: clip.seconds for clip in tracked.corpus.clips}
    assert lengths["ntsc"] == pytest.approx(60 * 1001 / 30000, abs=0.05)
    cut = [entry for outcome in tracked.outcomes if outcome.source.name == "joined.mp4" for entry in outcome.entries]
    assert [round(entry.start_s * 25) for entry in cut] == [0, 50]
    assert "truncated" in lengths or "truncated.mp4" in {row["video"] for row in rows(tmp_path / "out/failed.csv")}


@real
@pytest.mark.slow
def test_real_clips_keep_their_size_whatever_the_picture(clips: tuple[list[np.ndarray], ...], tmp_path: Path):
    import cv2

    large = [cv2.resize(one, (896, 896)) for one in clips[0]]
    scattered = [np.pad(one, ((300, 200), (100, 500), (0, 0))) for one in clips[0]]
    for name, pictures in {"large": large, "scattered": scattered, "plain": clips[0]}.items():
        remade(tmp_path / f"{name}.mp4", pictures, Fraction(25))
    tracked = track(
        [tmp_path],
        tmp_path / "out",
        settings(
            clip_filter__require_voice=False, clip_filter__max_duplicate_distance=0.0, clip_filter__min_duration_s=1.5
        ),
    )
    seen = {clip.id.partition("-")[0]: tracked.corpus.observation(clip) for clip in tracked.corpus.clips}
    for name in ("large", "scattered"):
        apart = np.linalg.norm(seen[name].landmarks - seen["plain"].landmarks, axis=-1)
        assert np.median(apart) < 1.5


def test_truncated_stream_gives_complete_frames(drawn: list[np.ndarray], tmp_path: Path):
    path = filmed(tmp_path / "whole.mp4", drawn, 4.0)
    with av.open(str(path)) as source, av.open(str(tmp_path / "a.mkv"), "w") as copy:
        stream = copy.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                copy.mux(packet)
    content = (tmp_path / "a.mkv").read_bytes()
    (tmp_path / "b.mkv").write_bytes(content[: len(content) * 3 // 4])
    assert (
        0 < len(list(read_frames(tmp_path / "b.mkv", 60.0))) < len(list(read_frames(tmp_path / "a.mkv", 60.0))) == 100
    )


def test_ledger_is_stored_with_its_clip(corpus: Path):
    for path in (corpus / "tracking").rglob("*.jsonl"):
        video_journal = journal.read(path)
        assert video_journal.done or video_journal.failure
        for entry in video_journal.entries:
            assert entry.id.startswith(path.stem)
