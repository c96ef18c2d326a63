"""From frames to clips without a network: shots, crops, resampling, selection, ledgers, names."""

import os
import unicodedata
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
import yaml

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import read_index, write_index
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.head.landmarks import head_to_scene, landmarks, pupil_centres
from talkingeyes.tracking import journal
from talkingeyes.tracking.clip_filter import ShotQuality, fingerprint, hamming_distance, measure_shot, rejection_reason
from talkingeyes.tracking.cropping import crop_camera, crop_shot, face_crop, frame_count, pixels_per_mm, resample_at
from talkingeyes.tracking.face_mesh import MESH_INDICES, DetectedFace
from talkingeyes.tracking.journal import ShotRecord
from talkingeyes.tracking.lip_sync import lip_gap, lip_sync_score
from talkingeyes.tracking.report import VideoResult, write_tables, yield_summary
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.shots import Shot, TrackedFrame, detect_shots
from talkingeyes.tracking.soundtrack import open_soundtrack
from talkingeyes.tracking.sources import find_videos
from talkingeyes.tracking.video import Frame, rotate_upright
from talkingeyes.tracking.visibility import relative_difference, self_occluded
from talkingeyes.workflows.track import index_rows

GOOD = ShotQuality(8.0, 0.0, 150.0, 0.3, 0.0, 5.0, 0.0, -15.0, 0.8, 0.4)
SETTINGS = TrackSettings.model_validate(
    yaml.safe_load((Path(__file__).resolve().parents[1] / "conf/track/default.yaml").read_text())
)


def face(frames: int = 200, yaw_rad: float = 0.0, scale: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks and pupils of a head that turns, nods and talks, in a picture `scale` times the standard crop."""
    times_s = np.arange(frames) / 25
    head = np.stack([0.1 * np.sin(times_s), yaw_rad + 0.1 * np.sin(2 * times_s), 0.03 * np.cos(times_s)], axis=1)
    gaze, lid, jaw = np.zeros((frames, 2, 3)), np.zeros((frames, 2)), np.zeros((frames, 3))
    jaw[:, 0] = 0.1 * np.abs(np.sin(7 * times_s)) ** 2
    camera = crop_camera(SETTINGS.crop)
    places = [landmarks(gaze, lid, jaw), pupil_centres(gaze)]
    return tuple(camera.project(head_to_scene(place, head, np.zeros((frames, 3)))) * scale + 40 for place in places)


def shot(frames: int = 200, fps: float = 25.0, faces: int = 1, yaw_rad: float = 0.0) -> Shot:
    """These frames as a tracked shot of a video."""
    marks, eyes = face(frames, yaw_rad)
    rng = np.random.default_rng(0)
    tracked_frames = [
        TrackedFrame(
            index / fps,
            DetectedFace(marks[index], eyes[index], faces),
            0.3,
            rng.integers(0, 255, (16, 16), np.uint8),
        )
        for index in range(frames)
    ]
    return Shot(tracked_frames, "the video ended", None, np.zeros((8, 8, 3), np.uint8))


class Script:
    """Stub of the face mesh: detects the face of each frame, except in `hidden` frames."""

    def __init__(self, hidden: set[int] = frozenset(), moved: int | None = None) -> None:
        self.marks, self.eyes = face(500)
        self.hidden, self.moved, self.forgotten = hidden, moved, 0

    def detect(self, image: np.ndarray, time_s: float) -> DetectedFace | None:
        index = round(time_s * 25)
        away = 2000.0 if self.moved is not None and index >= self.moved else 0.0
        return None if index in self.hidden else DetectedFace(self.marks[index] + away, self.eyes[index], 1)

    def reset(self) -> None:
        self.forgotten += 1


def film(count: int, cut: int | None = None) -> list[Frame]:
    grey = [40 if cut is None or index < cut else 140 for index in range(count)]
    return [Frame(index / 25, np.full((36, 64, 3), level, np.uint8)) for index, level in enumerate(grey)]


def lengths(eye: Script, frames: list[Frame], longest_s: float = 20.0) -> list[tuple[int, str]]:
    settings = SETTINGS.shot.model_copy(update={"max_duration_s": longest_s})
    return [(len(found.tracked_frames), found.end_reason) for found in detect_shots(frames, eye, settings)]


def test_every_landmark_of_the_head_has_its_own_point_of_the_mesh():
    assert set(MESH_INDICES) == set(LANDMARK_NAMES)
    assert len(set(MESH_INDICES.values())) == len(LANDMARK_NAMES)
    assert max(MESH_INDICES.values()) < 468


def test_shots_end_at_cuts_lost_faces_jumps_and_their_longest_length():
    assert lengths(Script(), film(100)) == [(100, "the video ended")]
    assert lengths(Script(), film(100, cut=60)) == [(60, "the scene changed"), (40, "the video ended")]
    assert lengths(Script(set(range(30, 50))), film(100)) == [(30, "the face was lost"), (50, "the video ended")]
    assert lengths(Script({30, 31}), film(100)) == [(100, "the video ended")]
    assert lengths(Script(moved=70), film(100)) == [(70, "the face jumped"), (30, "the video ended")]
    assert lengths(Script(), film(100), longest_s=2.0) == [(50, "long enough"), (50, "the video ended")]
    assert lengths(Script(set(range(100))), film(100)) == []
    missing = [frame for frame in film(100) if not 40 <= frame.time_s * 25 < 60]
    assert lengths(Script(), missing) == [(40, "frames are missing"), (40, "the video ended")]


def test_shot_is_the_same_after_resuming():
    settings = SETTINGS.shot.model_copy(update={"max_duration_s": 2.0})
    frames = film(140, cut=70)
    whole = list(detect_shots(frames, Script({90, 91, 92, 93, 94, 95, 96}), settings))
    for before, after in pairwise(whole):
        rest = [frame for frame in frames if frame.time_s >= before.resume_s]
        again = next(detect_shots(rest, Script({90, 91, 92, 93, 94, 95, 96}), settings))
        assert (again.start_s, again.stop_s, again.end_reason) == (after.start_s, after.stop_s, after.end_reason)


@pytest.mark.parametrize("yaw_rad", [-0.5, 0.0, 0.5])
def test_the_crop_has_one_scale_whatever_the_size_and_the_turn(yaw_rad: float):
    marks, _ = face(yaw_rad=yaw_rad, scale=3.0)
    assert np.median(pixels_per_mm(marks)) == pytest.approx(3 * SETTINGS.crop.scale_px_per_mm, rel=0.05)
    cropped = face_crop(marks, SETTINGS.crop).to_crop(marks)
    assert np.allclose(np.median((cropped.min(axis=1) + cropped.max(axis=1)) / 2, axis=0), 112, atol=1)


@pytest.mark.parametrize("fps", [22.13, 24000 / 1001, 25.0, 30000 / 1001, 30.0, 60.0])
def test_any_rate_becomes_25_by_time_stamps(fps: float):
    moment = np.arange(0, 6, 1 / fps)
    course = np.sin(moment)[:, None, None] * np.ones((1, 3, 2))
    wanted = np.arange(int((moment[-1] - moment[0]) * 25 + 1e-6) + 1) / 25
    found = resample_at(course, moment, wanted, 0.2)
    assert np.allclose(found[:, 0, 0], np.sin(wanted), atol=1 / fps**2)


def test_frames_that_are_far_apart_are_not_joined():
    moment = np.array([0.0, 0.04, 0.08, 0.4, 0.44])
    found = resample_at(np.ones((5, 1, 2)), moment, np.arange(12) / 25, 0.2)
    assert np.isnan(found[3:10]).all()
    assert np.isfinite(found[[0, 1, 2, 10, 11]]).all()


def test_turned_face_hides_the_far_eye_and_frontal_face_nothing():
    seen = crop_shot(shot(), 25.0, SETTINGS.crop, SETTINGS.eyes).observation
    assert seen.landmarks.shape == (frame_count(shot(), 25.0), len(LANDMARK_NAMES), 2)
    assert np.isfinite(seen.pupils).all()
    turned = crop_shot(shot(yaw_rad=0.75), 25.0, SETTINGS.crop, SETTINGS.eyes).observation
    hidden = np.isnan(turned.pupils).any(axis=2)
    assert hidden[:, 0].mean() > 0.5  # turned to the subject's left, so the left eye is farther away
    assert not hidden[:, 1].any()


def test_disparity_increases_with_yaw_and_identifies_the_far_eye():
    middle = [np.median(relative_difference(face(yaw_rad=yaw_rad)[0])) for yaw_rad in (0.0, 0.2, 0.4, 0.6)]
    assert middle == sorted(middle)
    away = self_occluded(face(yaw_rad=-0.75)[0], SETTINGS.eyes)
    assert away[:, 1].mean() > 0.5
    assert not away[:, 0].any()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, ""),
        ({"seconds": 2.0}, "too short"),
        ({"multi_face_ratio": 0.9}, "more than one face"),
        ({"face_width_px": 30.0}, "too small"),
        ({"sharpness": 0.02}, "too blurred"),
        ({"hidden_eye_ratio": 0.5}, "an eye is hidden"),
        ({"movement_px": 0.1}, "too still"),
        ({"duplicate_frame_ratio": 0.9}, "too still"),
        ({"loudest_dbfs": -200.0}, "no voice"),
        ({"speaking": 0.05}, "no voice"),
        ({"lip_sync_score": -0.1}, "not this face's voice"),
    ],
)
def test_each_rejection_has_its_reason(change: dict[str, float], reason: str):
    found = rejection_reason(replace(GOOD, **change), SETTINGS.clip_filter)
    assert found.partition(":")[0] == reason
    assert reason not in ("no voice", "not this face's voice") or not rejection_reason(
        replace(GOOD, **change), SETTINGS.clip_filter.model_copy(update={"require_voice": False})
    )


def test_shot_statistics():
    of = crop_shot(shot(faces=2), 25.0, SETTINGS.crop, SETTINGS.eyes).observation
    found = measure_shot(shot(faces=2), of, np.zeros(128_000, np.float32), SETTINGS.eyes)
    assert (found.multi_face_ratio, found.duplicate_frame_ratio, found.lip_sync_score, found.speaking) == (
        1.0,
        0.0,
        0.0,
        0.0,
    )
    assert found.seconds == 8.0
    assert found.movement_px > SETTINGS.clip_filter.min_movement_px


def test_a_voice_that_follows_the_lips_agrees_more_than_one_that_does_not():
    marks, _ = face(300)
    rng = np.random.default_rng(0)
    open_ = lip_gap(marks) / lip_gap(marks).max()
    gap = np.interp(np.arange(300 * 640) / 640, np.arange(300), open_**2)
    voice = (rng.normal(0, 0.1, len(gap)) * gap).astype(np.float32)
    hum = rng.normal(0, 0.1, len(gap)).astype(np.float32)
    assert lip_sync_score(marks, voice, 25.0) > 0.4
    assert lip_sync_score(marks, hum, 25.0) < 0.4
    assert lip_sync_score(marks, np.zeros(len(gap), np.float32), 25.0) == 0.0


def test_fingerprint_is_robust_and_distinguishes_footage():
    marks, _ = face(200)
    rng = np.random.default_rng(0)
    again = marks * 0.4 + rng.normal(0, 0.05, marks.shape)
    assert hamming_distance(fingerprint(marks), fingerprint(again)) < SETTINGS.clip_filter.max_duplicate_distance
    other = np.roll(marks, 70, axis=0)
    assert hamming_distance(fingerprint(marks), fingerprint(other)) > 2 * SETTINGS.clip_filter.max_duplicate_distance


def test_rotation_of_pictures_follows_the_file():
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    assert rotate_upright(image, 0).shape == (2, 4, 3)
    assert rotate_upright(image, 90).shape == (4, 2, 3)
    assert np.array_equal(rotate_upright(image, -90), np.rot90(image, -1))
    assert np.array_equal(rotate_upright(image, 180), image[::-1, ::-1])


def entry(name: str, reason: str = "") -> ShotRecord:
    crop = face_crop(face(20)[0], SETTINGS.crop)
    return ShotRecord(name, 0.0, 7.96, 8.0, "long enough", reason, crop, "ab" * 64, "c0ffee", GOOD)


def test_ledger_drops_truncated_line_and_resumes(tmp_path: Path):
    path, straight = tmp_path / "a" / "v.jsonl", tmp_path / "b.jsonl"
    journal.add(path, "begin", True)
    journal.add(path, "shot", entry("v-0"))
    journal.add(path, "begin", True)
    with path.open("a") as file:
        file.write('{"shot": {"id": "v-1", "sta')
    assert (len(journal.read(path).entries), journal.read(path).attempt_count, journal.read(path).resume_s) == (
        1,
        1,
        8.0,
    )
    journal.add(path, "shot", entry("v-1"))
    journal.finish(path, 16.0)
    for kind, content in (("begin", True), ("shot", entry("v-0")), ("shot", entry("v-1"))):
        journal.add(straight, kind, content)
    journal.finish(straight, 16.0)
    assert path.read_bytes() == straight.read_bytes()
    assert journal.read(path).done
    journal.add(tmp_path / "c", "failed", "damaged")
    assert (journal.read(tmp_path / "c").failure, journal.read(tmp_path / "c").done) == ("damaged", False)


def test_names_and_speakers_come_from_the_path_or_a_map(tmp_path: Path):
    for name in ("id1/talk one.mp4", "id1/b.webm", "solo.mkv", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = find_videos([tmp_path], None)
    assert [source.name for source in found] == ["id1/b.webm", "id1/talk one.mp4", "solo.mkv"]
    assert [source.speaker for source in found] == ["id1", "id1", "solo"]
    assert len({source.id for source in found}) == 3
    assert not any(set(source.id) & set(" /.") for source in found)
    speakers = tmp_path / "map.csv"
    speakers.write_text("video,speaker\nid1/b.webm,ann\nid1/talk one.mp4,ben\nsolo.mkv,ann\n")
    assert [source.speaker for source in find_videos([tmp_path], speakers)] == ["ann", "ben", "ann"]
    speakers.write_text("video,speaker\nsolo.mkv,ann\n")
    for arguments in (([tmp_path], speakers), ([tmp_path / "nothing"], None), ([tmp_path / "notes.txt"], speakers)):
        with pytest.raises(InputError, match=r"^[^\n]+$"):
            find_videos(*arguments)
    with pytest.raises(InputError, match="got another video solo"):
        (tmp_path / "id1" / "solo.mkv").touch()
        find_videos([tmp_path / "solo.mkv", tmp_path / "id1" / "solo.mkv"], None)


NAMES = {  # of videos, and of the speakers that they have without a map
    "Anna Maria/take 1.mp4": "Anna Maria",
    "Anna-Maria/take 1.mp4": "Anna-Maria",
    "Anna+Maria/take 1.mp4": "Anna+Maria",
    "Anna, Maria/take 1.mp4": "Anna, Maria",
    "Jürgen/a=b [x].mp4": "Jürgen",
    "--x/-.mp4": "--x",
    "Мария Анна/видео.mp4": "Мария Анна",
    "高橋 さん.mp4": "高橋 さん",
    "talk.v2.mp4": "talk.v2",
    "!!!.mp4": "!!!",
    "?.mp4": "?",
}


def test_a_corpus_of_videos_with_any_names_is_readable(tmp_path: Path):
    latin1 = os.fsdecode(b"M\xfcller 1.mp4")  # of an old archive
    for name in (*NAMES, latin1):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = find_videos([tmp_path], None)
    assert found == find_videos([tmp_path], None)
    index_path = tmp_path / "clips.parquet"
    write_index(
        index_path, index_rows([VideoResult(each, (entry(f"{each.id}-0000"),), 8.0, "") for each in found], SETTINGS)
    )
    clips = read_index(index_path)
    assert [clip.speaker_name for clip in clips] == [each.speaker_name for each in found]
    assert {each.name: each.speaker_name for each in found} == NAMES | {r"M\xfcller 1.mp4": r"M\xfcller 1"}
    assert len({clip.id for clip in clips}) == len({clip.speaker for clip in clips}) == len(found)
    kept = ("Anna-Maria", "Anna+Maria", "Jürgen", "talk.v2")
    assert all((clip.speaker == clip.speaker_name) == (clip.speaker_name in kept) for clip in clips)


def test_a_map_finds_names_however_their_umlauts_are_written(tmp_path: Path):
    (tmp_path / unicodedata.normalize("NFD", "Jürgen.mp4")).touch()
    speakers = tmp_path / "map.csv"
    speakers.write_text("video,speaker\nJürgen.mp4,Jürgen Groß\n")
    (source,) = find_videos([tmp_path], speakers)
    assert (source.speaker_name, source.speaker.rpartition("-")[0]) == ("Jürgen Groß", "Jürgen-Groß")


@pytest.mark.parametrize("right", [1.0, -1.0])
def test_the_sound_of_a_video_is_there_in_any_phase(tmp_path: Path, right: float):
    tone = 0.3 * np.sin(2 * np.pi * 440 * np.arange(48_000) / 48_000)
    with av.open(str(tmp_path / "a.mov"), "w") as file:
        pictures, sound = file.add_stream("mpeg4", rate=25), file.add_stream("pcm_s16le", rate=48_000, layout="stereo")
        pictures.width = pictures.height = 64
        both = (np.stack([tone, right * tone], axis=1).reshape(1, -1) * 32_767).astype(np.int16)
        frame = av.AudioFrame.from_ndarray(both, format="s16", layout="stereo")
        frame.sample_rate = 48_000
        for stream, content in ((sound, frame), (pictures, av.VideoFrame(64, 64, "yuv420p"))):
            for packet in [*stream.encode(content), *stream.encode(None)]:
                file.mux(packet)
    with open_soundtrack(tmp_path / "a.mov") as track:
        level = np.abs(track.cut(0.2, 9600)).max()
    assert 0.25 < level < 0.45


def test_the_yield_counts_everything_once(tmp_path: Path):
    (tmp_path / "v.mp4").touch()
    source = find_videos([tmp_path / "v.mp4"], None)[0]
    outcomes = [
        VideoResult(source, (entry("a"), entry("b", "too short: 1 s"), entry("c", "a copy of a")), 24.0, ""),
        VideoResult(source, (), 4.0, ""),
        VideoResult(source, (), 0.0, "damaged"),
    ]
    total = yield_summary(outcomes)
    assert (total["videos"], total["videos_failed"], total["shots"], total["clips"]) == (3, 1, 3, 1)
    assert set(total["rejected"]) == {"too short", "a copy of another", "no face was found"}
    write_tables(tmp_path, outcomes)
    assert len((tmp_path / "rejected.csv").read_text().splitlines()) == 4
    assert (tmp_path / "failed.csv").read_text().splitlines() == ["video,error", "v.mp4,damaged"]
    assert (tmp_path / "tracked.csv").read_text().splitlines()[1].startswith("a,v.mp4,0.000000,7.960000,")
