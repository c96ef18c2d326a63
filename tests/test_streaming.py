"""Streaming: output equals that for the whole speech for any chunk sizes, within the stated latency."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from live_model import CODES, LIVE_GAZE, embedding_settings, write_live_face, write_live_model
from model_conf import model_section
from numpy import ndarray

from talkingeyes.animation.controls import NEUTRAL_FACE, Liveliness
from talkingeyes.animation.face import with_face
from talkingeyes.animation.live_gaze import GazeDirection
from talkingeyes.animation.live_stream import StreamFrames, StreamSound, push_together
from talkingeyes.animation.model_file import LIVE_FACE_FOLDER
from talkingeyes.animation.streaming import MAX_LATENCY_S, LiveControls, LiveModel
from talkingeyes.audio.encoder import LOUD_PERCENTILE, make_encoder
from talkingeyes.audio.speech_boundaries import BOUNDARY_CHANNELS
from talkingeyes.audio.streaming_prosody import DEFAULT_LEVEL_DBFS, RunningLevel, StreamingProsody
from talkingeyes.audio.waveform import SAMPLE_RATE, block_levels_dbfs, frame_count
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import eye_speed_deg_s
from talkingeyes.core.motion import Motion
from talkingeyes.models.face.style import STYLE_FADE_S, FaceStyle, StyleKey
from talkingeyes.models.layers.convolution import ConvolutionStack
from talkingeyes.models.motion_stream import MotionStreams, StreamingModules, concat_motions

SECONDS = 3.3
NAMES = ("head", "gaze", "lid", "jaw", "expression")


def speech(seconds: float = SECONDS, seed: int = 0) -> ndarray:
    """Syllables: bursts of a buzz with gliding pitch, and pauses."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * SAMPLE_RATE)) / SAMPLE_RATE
    pitch = 120 + 40 * np.sin(2 * np.pi * 0.7 * times)
    buzz = np.sign(np.sin(2 * np.pi * np.cumsum(pitch) / SAMPLE_RATE))
    loud = np.clip(np.sin(2 * np.pi * 3 * times), 0, 1) * (np.sin(2 * np.pi * 0.4 * times) > -0.3)
    return (0.2 * loud * buzz + 0.002 * rng.standard_normal(len(times))).astype(np.float32)


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> LiveModel:
    return LiveModel.load(write_live_model(tmp_path_factory.mktemp("live") / "model"))


@pytest.fixture(scope="module")
def codes(tmp_path_factory: pytest.TempPathFactory) -> LiveModel:
    """The same with a model of gaze codes."""
    return LiveModel.load(write_live_model(tmp_path_factory.mktemp("codes") / "model", **CODES))


@pytest.fixture(scope="module")
def guided(tmp_path_factory: pytest.TempPathFactory) -> LiveModel:
    """The same with guidance of gaze."""
    gaze = LIVE_GAZE | {"guidance": {"time": 2.0, "location": 3.0}}
    return LiveModel.load(write_live_model(tmp_path_factory.mktemp("guided") / "model", gaze=gaze))


def streamed(
    live: LiveModel, sound: ndarray, sizes: list[int], seed: int = 4, controls: LiveControls | None = None
) -> StreamFrames:
    """All frames of a stream with chunks of these sizes, in turn."""
    stream = live.stream(seed, controls or LiveControls())
    parts, start, turn = [], 0, 0
    while start < len(sound):
        size = sizes[turn % len(sizes)]
        parts.append(stream.push(sound[start : start + size]))
        start, turn = start + size, turn + 1
    parts.append(stream.finish())
    return joined(parts)


def joined(parts: list[StreamFrames]) -> StreamFrames:
    """Consecutive parts of a stream as one."""
    assert [part.first for part in parts] == np.cumsum([0, *(len(part) for part in parts[:-1])]).tolist()
    return StreamFrames.concat(parts)


def close(one: StreamFrames | Motion, other: StreamFrames | Motion) -> None:
    for name in NAMES:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-5)


@pytest.mark.parametrize("seconds", [0.31, 0.7, 1.0, SECONDS])
def test_a_stream_is_what_the_whole_speech_gives(live: LiveModel, seconds: float) -> None:
    sound = speech(seconds)
    whole = live.generate_offline(sound, 4)
    assert len(whole) == frame_count(len(sound), live.fps)
    close(streamed(live, sound, [640]), whole)


def test_output_is_independent_of_chunks(live: LiveModel) -> None:
    sound = speech()
    expected = streamed(live, sound, [640])
    for sizes in ([len(sound)], [160], [1, 7000, 333, 0]):
        found = streamed(live, sound, sizes)
        for name in NAMES:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_codes_of_gaze_can_be_streamed_too(live: LiveModel, codes: LiveModel) -> None:
    sound = speech()
    found = streamed(codes, sound, [640])
    close(found, codes.generate_offline(sound, 4))
    np.testing.assert_array_equal(found.gaze, streamed(codes, sound, [1, 7000, 333, 0]).gaze)
    assert codes.latency_s == pytest.approx(live.latency_s + 0.08)  # a code is two frames longer than a bin


def test_a_guided_stream_is_what_the_whole_speech_gives(live: LiveModel, guided: LiveModel) -> None:
    sound = speech()
    whole, plain = guided.generate_offline(sound, 4), live.generate_offline(sound, 4)
    for sizes in ([640], [1, 7000, 333, 0]):
        close(streamed(guided, sound, sizes), whole)
    np.testing.assert_array_equal(whole.head, plain.head)
    assert np.abs(whole.gaze - plain.gaze).max() > 1e-3


@pytest.mark.parametrize("kind", ["live", "codes", "guided"])
def test_streams_of_a_batch_are_as_alone(live: LiveModel, codes: LiveModel, guided: LiveModel, kind: str) -> None:
    """Streams that begin and end at other times than others, with other seeds, chunks, controls and partners."""
    model = {"live": live, "codes": codes, "guided": guided}[kind]
    controls = [
        LiveControls(),
        LiveControls(gaze=GazeDirection(eye_contact=0.8)),
        LiveControls("paper", Liveliness(2.0, 0.5, 1.0), GazeDirection(state="thinking")),
        LiveControls(gaze=GazeDirection(target_m=(0.4, 0.1, 1.0))),
        LiveControls(),
    ]
    sounds = [speech(SECONDS - 0.3 * row, seed=row) for row in range(5)]
    partners = [None, None, speech(seed=9), None, speech(seed=8)]
    streams = [model.stream(row, own) for row, own in enumerate(controls)]
    parts: list[list[StreamFrames]] = [[] for _ in streams]
    at = [-640 * 4 * row for row in range(5)]  # a later one begins later
    while any(start < len(sound) for start, sound in zip(at, sounds, strict=True)):
        rows = [row for row in range(5) if 0 <= at[row] < len(sounds[row])]
        given = []
        for row in rows:
            now = slice(at[row], min(at[row] + 500 + 100 * row, len(sounds[row])))
            partner = partners[row]
            given.append(StreamSound(streams[row], sounds[row][now], None if partner is None else partner[now]))
        for row, found in zip(rows, push_together(given), strict=True):
            assert isinstance(found, StreamFrames)
            parts[row].append(found)
        at = [start + (500 + 100 * row if start >= 0 else 640) for row, start in enumerate(at)]
    for row, (stream, sound, own) in enumerate(zip(streams, sounds, controls, strict=True)):
        partner = partners[row]
        heard = None if partner is None else partner[: len(sound)]
        whole = model.generate_offline(sound, row, own, heard)
        close(joined([*parts[row], stream.finish()]), whole)


@pytest.mark.parametrize("stage", ["receive", "prosody", "network", "direct"])
def test_a_stream_that_fails_ends_alone(live: LiveModel, stage: str) -> None:
    sound = speech(1.0)
    streams = [live.stream(seed) for seed in range(3)]
    if stage == "prosody":
        streams[1].prosody._lookahead_frames = None  # type: ignore[assignment]
    if stage == "network":
        object.__setattr__(streams[1].motion, "head", None)
    if stage == "direct":
        streams[1]._blinks = None  # type: ignore[assignment]
    parts: list[list[StreamFrames]] = [[], []]
    for start in range(0, len(sound), 1600):
        chunk = sound[start : start + 1600]
        given = [chunk, np.full(1600, np.nan) if stage == "receive" else chunk, chunk]
        first, failed, last = push_together([StreamSound(*each) for each in zip(streams, given, strict=True)])
        parts[0].append(first)
        parts[1].append(last)
    assert isinstance(failed, Exception)
    for part, stream in zip(parts, (streams[0], streams[2]), strict=True):
        seed = streams.index(stream)
        close(joined([*part, stream.finish()]), live.generate_offline(sound, seed))


def test_output_moves_and_depends_on_the_seed(live: LiveModel) -> None:
    one, other = live.generate_offline(speech(), 1), live.generate_offline(speech(), 2)
    assert eye_speed_deg_s(one.gaze[None], live.fps).max() > 10
    assert np.abs(one.head - other.head).max() > 0.01
    assert np.abs(one.gaze - other.gaze).max() > 0.01


def test_frames_have_the_stated_latency(live: LiveModel) -> None:
    assert live.latency_s <= MAX_LATENCY_S
    sound, size = speech(), 80
    stream = live.stream(0)
    given, waits = 0, []
    for start in range(0, len(sound), size):
        frames = stream.push(sound[start : start + size])
        heard_s = min(start + size, len(sound)) / SAMPLE_RATE
        given += len(frames)
        # The next frame is not yet due by the stated latency.
        assert heard_s - given / live.fps < live.latency_s + size / SAMPLE_RATE
        waits += [heard_s - frame / live.fps for frame in range(frames.first, frames.first + len(frames))]
    assert max(waits) == pytest.approx(live.latency_s, abs=size / SAMPLE_RATE)


def test_later_speech_does_not_change_earlier_frames(live: LiveModel) -> None:
    sound = speech()
    cut = round(1.8 * SAMPLE_RATE)
    other = np.concatenate([sound[:cut], speech(seed=9)[: len(sound) - cut] * 3])
    first, second = live.generate_offline(sound, 4), live.generate_offline(other, 4)
    same = int((cut / SAMPLE_RATE - live.latency_s) * live.fps)
    np.testing.assert_allclose(first.head[:same], second.head[:same], atol=1e-5)
    np.testing.assert_allclose(first.gaze[:same], second.gaze[:same], atol=1e-5)
    lookahead = slice(same, same + 25)
    assert np.abs(first.head[lookahead] - second.head[lookahead]).max() > 1e-4


def test_a_longer_speech_begins_like_a_shorter_one(live: LiveModel) -> None:
    sound = speech()
    whole, half = streamed(live, sound, [640]), streamed(live, sound[: len(sound) // 2], [640])
    same = len(half.head) - round(live.latency_s * live.fps) - 1
    np.testing.assert_array_equal(half.head[:same], whole.head[:same])
    np.testing.assert_array_equal(half.lid, whole.lid[: len(half.lid)])


def test_dials(live: LiveModel) -> None:
    sound = speech()
    counts = [
        len([*live.hour_of_blinks(1, LiveControls(liveliness=Liveliness(blinks=each)))]) for each in (0.0, 1.0, 2.0)
    ]
    assert counts[0] == 0
    assert 1.7 * counts[1] < counts[2] < 2.3 * counts[1]
    still = live.generate_offline(sound, 1, LiveControls(liveliness=Liveliness(head=0.0)))
    np.testing.assert_allclose(still.head, still.head[:1].repeat(len(still), 0), atol=1e-6)
    controls = LiveControls("paper", Liveliness(2.0, 0.5, 1.0))
    close(streamed(live, sound, [3000], 1, controls), live.generate_offline(sound, 1, controls))
    own, calm = (live.generate_offline(sound, 1, LiveControls("paper", Liveliness(gaze=each))) for each in (1.0, 0.5))
    both = [rotation.gaze_in_space(each.head, each.gaze) for each in (own, calm)]
    np.testing.assert_allclose(both[1].mean(1), 0.5 * both[0].mean(1), atol=1e-6)
    np.testing.assert_allclose(both[1][:, 0] - both[1][:, 1], both[0][:, 0] - both[0][:, 1], atol=1e-6)
    with pytest.raises(InputError, match=r"blinks: should be one of .*, got often"):
        live.stream(0, LiveControls("often"))


def test_what_cannot_be_streamed(live: LiveModel) -> None:
    stream = live.stream(0)
    with pytest.raises(InputError, match="finite"):
        stream.push(np.array([0.0, np.nan], np.float32))
    assert not len(stream.finish())
    with pytest.raises(InputError, match="has ended"):
        stream.push(np.zeros(10, np.float32))
    with pytest.raises(InputError, match="at most 3600 s"):
        live.stream(0).push(np.zeros(3601 * SAMPLE_RATE, np.float32))


def test_memory_does_not_grow(live: LiveModel) -> None:
    def size(stream: object) -> int:
        """Number of stored array elements of a stream."""
        seen: set[int] = set()

        def count(thing: object) -> int:
            if id(thing) in seen or isinstance(thing, (torch.nn.Module, LiveModel, type)):
                return 0
            seen.add(id(thing))
            if isinstance(thing, (np.ndarray, torch.Tensor)):
                return int(np.prod(thing.shape))
            inner = (
                thing
                if isinstance(thing, (list, tuple))
                else vars(thing).values()
                if hasattr(thing, "__dict__")
                else ()
            )
            return sum(map(count, inner))

        return count(stream)

    stream, sizes = live.stream(0), []
    for seconds in (9.0, 1.6, 1.6):  # attention covers the last 8 s
        stream.push(speech(seconds))
        sizes.append(size(stream))
    assert sizes[0] > 1000
    assert sizes[2] <= sizes[1] * 1.02


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"speech": {"channels": None, "width": 64, "layers": 2, "dropout": 0.1, "channel_dropout": 0.0}},
            "should use",
        ),
        (
            {
                "head": {
                    "kind": "vae",
                    "norm": "standardised_mean",
                    "standardised": True,
                    "width": 64,
                    "layers": 3,
                    "dropout": 0.1,
                    "latent": 4,
                    "latent_frames": 12,
                    "free_bits": 0.0,
                }
            },
            "head",
        ),
        ({"gaze": model_section("talkingeyes_events")["gaze"]}, "gaze without lookahead"),
        ({**CODES, "gaze": CODES["gaze"] | {"condition_lookahead": 1}}, "gaze without lookahead"),
    ],
)
def test_model_with_too_much_lookahead_is_an_error(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        LiveModel.load(write_live_model(tmp_path / "model", **changes))


def test_model_with_too_much_latency_is_an_error(live: LiveModel, tmp_path: Path) -> None:
    late = live.network.settings.speech.model_dump() | {"lookahead": 9}
    with pytest.raises(InputError, match=r"at most 0.4 s ahead, got 0.437 s"):
        LiveModel.load(write_live_model(tmp_path / "model", speech=late))


class TestFace:
    """Emotions, and faces that cannot be streamed. Other tests compare the face with that of the whole sound."""

    def test_an_emotion_changes_face_and_lids_alone(self, live: LiveModel) -> None:
        controls = LiveControls(face=FaceStyle(None, "surprised", 3))
        whole, neutral = (live.generate_offline(speech(), 4, each) for each in (controls, LiveControls()))
        close(streamed(live, speech(), [1, 7000, 333, 0], controls=controls), whole)
        assert np.abs(whole.expression - neutral.expression).max() > 0.05
        assert whole.lid.min() == pytest.approx(-0.3)
        for name in ("head", "gaze"):
            np.testing.assert_array_equal(getattr(whole, name), getattr(neutral, name))

    @pytest.mark.parametrize("pause", [640, 4000, 12000])
    def test_a_changed_emotion_fades_in_as_in_files(self, live: LiveModel, pause: int) -> None:
        """Also while the last change still fades in."""
        sound, stream = speech(), live.stream(4)
        styles = [FaceStyle(None, *each) for each in (("happy", 1), ("angry", 3), ("neutral", 0))]
        keys, parts, start = [StyleKey(0.0, NEUTRAL_FACE[0].style)], [], 0
        for style in styles:
            parts.append(stream.push(sound[start : start + pause]))
            keys.append(StyleKey(stream.change(face=style) / live.fps, style))
            assert stream.change(face=style) == round(keys[-1].onset_s * live.fps)
            start += pause
        found = joined([*parts, stream.push(sound[start:]), stream.finish()])
        speech_channels = live.face.generator.network.speech.embedding_of(
            live.features.process_offline(sound), live.features.channels
        )
        last = {key.onset_s: key for key in keys}  # of several changes of one frame
        faces = live.face.generator.generate(speech_channels.numpy(), [*last.values()], [0], live.fps)
        whole = with_face(live.generate_offline(sound, 4), faces, 0, keys)
        np.testing.assert_allclose(found.jaw, whole.jaw, atol=1e-5)
        np.testing.assert_allclose(found.expression, whole.expression, atol=1e-5)
        assert len(stream._styles) <= 1 + STYLE_FADE_S * live.fps

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"speech": {"lookahead": 5}}, "at most 4 frames ahead, got 5"),
            ({"face": {"kind": "diffusion", "width": 16, "layers": 1, "dropout": 0.0, "diffusion_steps": 20,
                       "sampling_steps": 5, "eta": 0.0}}, "should be streamable"),
        ],
    )  # fmt: skip
    def test_a_face_with_other_lookahead_is_an_error(
        self, tmp_path: Path, changes: dict[str, Any], message: str
    ) -> None:
        model = write_live_model(tmp_path / "model")
        if "speech" in changes:
            changes = {"speech": model_section("face_live")["speech"] | {"width": 24} | changes["speech"]}
        write_live_face(tmp_path / LIVE_FACE_FOLDER, **changes)
        with pytest.raises(InputError, match=message):
            LiveModel.load(model)

    def test_a_face_with_other_prosody_is_an_error(self, tmp_path: Path) -> None:
        model, settings = write_live_model(tmp_path / "model"), embedding_settings()
        write_live_face(tmp_path / LIVE_FACE_FOLDER, settings.model_copy(update={"level_dbfs": -26.0}))
        with pytest.raises(InputError, match="level and prosody of its face"):
            LiveModel.load(model)


class TestNetwork:
    def test_it_takes_parts_of_any_length(self, live: LiveModel) -> None:
        torch.manual_seed(0)
        embedding = torch.randn(61, len(live.network.speech.mean)) * 10 - 20
        expected = live.network.generate(embedding, [5])
        for part in (1, 3, 4, 61):
            streams, found = MotionStreams(live.network), []
            state = streams.begin(5)
            for each in embedding.split(part):
                (step,) = streams.step([state], each[None])
                state = step.state
                found.append(step.motion)
            joined = concat_motions([*found, streams.finish(state).motion])
            for name in ("head", "gaze"):
                torch.testing.assert_close(getattr(joined, name), getattr(expected, name), atol=1e-5, rtol=0)

    def test_the_frames_ahead_are_those_that_count(self, live: LiveModel) -> None:
        torch.manual_seed(0)
        embedding = torch.randn(60, len(live.network.speech.mean)) * 10 - 20
        known, changed = 40, embedding.clone()
        changed[known:] += 30
        one, other = (live.network.generate(each, [5]) for each in (embedding, changed))
        moved = (one.head - other.head).abs().amax(-1)[0] > 1e-6
        assert int(moved.nonzero()[0]) >= known - StreamingModules.of(live.network).lookahead_frames

    def test_causal_convolutions_step_by_step(self) -> None:
        torch.manual_seed(0)
        stack, x = ConvolutionStack(3, 8, 3, 0.0, lookahead=2), torch.randn(2, 40, 3)
        whole = stack(x)
        streaming, steps = stack.streaming(), []
        past = np.stack([streaming.begin()] * 2)
        for part in torch.nn.functional.pad(x, (0, 0, 0, 2)).split(5, dim=1):
            features, past = streaming.step(past, part.numpy())
            steps.append(features)
        found = np.concatenate(steps, axis=1)[:, 2:]
        np.testing.assert_allclose(found, whole.detach().numpy(), atol=1e-6, rtol=1e-5)
        changed = x.clone()
        changed[:, 20:] += 1
        assert torch.equal(stack(changed)[:, :18], whole[:, :18])
        assert not torch.equal(stack(changed)[:, 18], whole[:, 18])


class TestProsody:
    def test_it_is_the_embedding_but_for_the_level(self) -> None:
        settings, sound = embedding_settings(), speech()
        features = StreamingProsody(settings, 25.0)
        live = features.process_offline(sound)
        whole = make_encoder(settings)(sound, 25.0)[:, : -len(BOUNDARY_CHANNELS)]
        np.testing.assert_allclose(live[:, -2:], whole[:, -2:], atol=1e-3)
        loud = whole[:, -3] > settings.prosody.energy_floor_dbfs + 10
        off = np.abs(live - whole)[loud, -3]
        assert off[-10:].max() < min(off[:10].min(), 4.0)  # the estimate of the level improves
        level = RunningLevel()
        level.levels_dbfs = [float(np.percentile(block_levels_dbfs(sound), LOUD_PERCENTILE))]
        np.testing.assert_allclose(features._normalise(features._analyse(sound), 0, level), whole, atol=2e-3)

    def test_level_starts_at_default_and_follows_the_sound(self) -> None:
        level = RunningLevel()
        assert level.levels_dbfs == [DEFAULT_LEVEL_DBFS]
        level.push(np.zeros(SAMPLE_RATE, np.float32))
        assert level.levels_dbfs[-1] == DEFAULT_LEVEL_DBFS  # silence does not change it
        loud = np.tile([0.5, -0.5], 40 * SAMPLE_RATE // 2).astype(np.float32)
        level.push(loud)
        assert level.levels_dbfs[-1] == pytest.approx(-6.02, abs=1)
        level.push(loud / 100)
        assert level.levels_dbfs[-1] == pytest.approx(-46.02, abs=3)  # the loud part has left the memory
        assert len(level._audible_dbfs) == 600

    def test_other_frame_rates(self) -> None:
        settings, sound = embedding_settings(), speech(2.0)
        live = StreamingProsody(settings, 50.0, block_frames=3)
        parts = [live.push(each) for each in np.array_split(sound, 17)] + [live.finish()]
        expected = StreamingProsody(settings, 50.0).process_offline(sound)
        assert len(expected) == 100
        np.testing.assert_allclose(np.concatenate(parts), expected, atol=1e-4)
        with pytest.raises(InputError, match=r"fps: should be 20, 25, 50 or 100 .* got 30"):
            StreamingProsody(settings, 30.0)
