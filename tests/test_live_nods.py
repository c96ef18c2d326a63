"""Nods of a stream: at the ends of the partner's phrases, as in files, for any chunks, and causal."""

from __future__ import annotations

import numpy as np
import pytest
from live_model import LIVE_GAZE, write_live_model
from numpy import ndarray
from test_streaming import close, speech

from talkingeyes.animation.controls import Liveliness
from talkingeyes.animation.listening_behaviour import sample_listening_behaviour
from talkingeyes.animation.live_gaze import GazeDirection
from talkingeyes.animation.live_listening import LiveListening
from talkingeyes.animation.live_nods import LiveNods, PhraseDetector
from talkingeyes.animation.live_stream import StreamFrames
from talkingeyes.animation.streaming import LiveControls, LiveModel
from talkingeyes.audio.turn_taking import detect_turns
from talkingeyes.audio.voice_activity import detect_speech
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.physiology import eye_head
from talkingeyes.synthesis.head_gestures import BACKCHANNEL_DEG, MAX_DEPTH_FACTOR

SECONDS, SEED = 12.0, 4
CALM = LiveControls("paper", Liveliness(gaze=0.5))  # gaze within the range of the eyes
EARLIEST_S, LATEST_S = 0.1, 0.5  # of nods after a phrase


def phrases(seconds: float = SECONDS, noise: float = 0.0005) -> ndarray:
    """Phrases of 1.2 s with gaps of 0.6 s between them, over the noise of a microphone."""
    times = np.arange(round(seconds * SAMPLE_RATE)) / SAMPLE_RATE
    syllables = 0.2 + 0.8 * np.abs(np.sin(2 * np.pi * 2.5 * times))
    buzz = np.sign(np.sin(2 * np.pi * 140 * times)) * syllables * ((times - 0.5) % 1.8 < 1.2) * (times > 0.5)
    return (0.2 * buzz + noise * np.random.default_rng(1).standard_normal(len(times))).astype(np.float32)


@pytest.fixture(autouse=True)
def own_gaze(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gaze that answers the partner turns the head too (test_live_gaze.py)."""
    monkeypatch.setattr(LiveListening, "contact", lambda self, frames: [])


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> LiveModel:
    """Without guidance, which makes the gaze of an untrained model large: at its limits, nods would be cut in two."""
    place = tmp_path_factory.mktemp("live") / "model"
    return LiveModel.load(write_live_model(place, gaze=LIVE_GAZE | {"guidance": {"time": 1.0, "location": 1.0}}))


def streamed(
    live: LiveModel,
    sizes: list[int],
    partner: ndarray | None,
    controls: LiveControls = CALM,
    states: dict[float, str | None] | None = None,
    seed: int = SEED,
) -> StreamFrames:
    """All frames of a stream; `states`: the state from a time of the sound on."""
    sound, stream, parts, start, turn = speech(SECONDS), live.stream(seed, controls), [], 0, 0
    changes = sorted((round(time_s * SAMPLE_RATE), state) for time_s, state in (states or {}).items())
    while start < len(sound):
        stop = min([start + sizes[turn % len(sizes)], len(sound), *(at for at, _ in changes if at > start)])
        for at, state in changes:
            if at == start:
                stream.change(gaze=GazeDirection(state=state))
        parts.append(stream.push(sound[start:stop], None if partner is None else partner[start:stop]))
        start, turn = stop, turn + 1
    parts.append(stream.finish())
    return StreamFrames.concat(parts)


def nodding(frames: StreamFrames, others: StreamFrames, fps: float) -> ndarray:
    """Times in seconds at which the heads differ."""
    return np.flatnonzero(np.abs(frames.head - others.head).max(axis=1) > 1e-9) / fps


def nod_onsets(frames: StreamFrames, others: StreamFrames, fps: float) -> ndarray:
    """Times of the first frames of the stretches in which the heads differ."""
    times = nodding(frames, others, fps)
    return times[np.diff(times, prepend=-1.0) > 1.5 / fps]


@pytest.mark.parametrize("noise", [0.0, 0.0005, 0.005])
def test_phrases_are_those_of_files(noise: float) -> None:
    sound = phrases(noise=noise)
    expected = detect_speech(phrases(noise=0.0)).speaking[:-1]  # the last one has no end
    assert len(expected) == 6
    whole = PhraseDetector().push(sound)
    np.testing.assert_allclose([each.span.end_s for each in whole], [each.end_s for each in expected], atol=0.03)
    assert max(each.known_s - each.span.end_s for each in whole) < 0.27
    detector = PhraseDetector()
    parts = [detector.push(chunk) for chunk in np.split(sound, range(7, len(sound), 331))]
    assert [phrase for part in parts for phrase in part] == whole


@pytest.mark.parametrize("level", [0.0, 1e-4, 0.002, 0.05])
def test_no_phrases_in_silence_and_in_constant_noise(level: float) -> None:
    noise = level * np.random.default_rng(0).standard_normal(60 * SAMPLE_RATE)
    assert not PhraseDetector().push(noise.astype(np.float32))


@pytest.mark.long
def test_nods_come_after_the_ends_of_phrases_and_nowhere_else(live: LiveModel) -> None:
    partner, alone = phrases(), streamed(live, [640], None)
    ends = np.array([each.end_s for each in detect_speech(partner).speaking])
    silent = streamed(live, [640], np.zeros_like(partner))
    for name in ("head", "gaze", "lid"):
        np.testing.assert_array_equal(getattr(silent, name), getattr(alone, name))
    begun = 0
    for seed in range(3):
        frames, others = (streamed(live, [640], sound, seed=seed) for sound in (partner, None))
        onsets = nod_onsets(frames, others, live.fps)
        since = onsets - ends[np.searchsorted(ends + EARLIEST_S, onsets) - 1]
        assert (since > EARLIEST_S - 0.03).all()
        assert (since < LATEST_S + 0.03 + 1.0 / live.fps).all()
        begun += len(onsets)
        pitch = (frames.head - others.head)[:, 0]
        assert pitch.min() >= 0.0
        assert pitch.max() < np.radians(BACKCHANNEL_DEG * MAX_DEPTH_FACTOR * 1.9)
        own, nods = (rotation.gaze_in_space(each.head, each.gaze) for each in (others, frames))
        np.testing.assert_allclose(nods, own, atol=1e-6)  # gaze stays where it is in space
    assert begun >= 4


@pytest.mark.long
def test_nods_do_not_depend_on_chunks_and_are_those_of_the_whole_sound(live: LiveModel) -> None:
    partner = phrases()
    expected = streamed(live, [640], partner)
    assert len(nodding(expected, streamed(live, [640], None), live.fps)) > 10
    for sizes in ([1_000_000], [160], [1, 7000, 333]):
        found = streamed(live, sizes, partner)
        for name in ("head", "gaze", "lid"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    close(expected, live.generate_offline(speech(SECONDS), SEED, CALM, partner))
    contact = LiveControls("paper", CALM.liveliness, GazeDirection(eye_contact=0.8))
    close(streamed(live, [640], partner, contact), live.generate_offline(speech(SECONDS), SEED, contact, partner))


def test_later_sound_of_the_partner_does_not_change_earlier_frames(live: LiveModel) -> None:
    partner, cut_s = phrases(), 6.6
    other = partner.copy()
    other[round(cut_s * SAMPLE_RATE) :] = 0.0
    for seed in range(3):
        one, two = (live.generate_offline(speech(SECONDS), seed, CALM, each) for each in (partner, other))
        same = int((cut_s - live.latency_s) * live.fps)
        np.testing.assert_array_equal(one.head[:same], two.head[:same])


@pytest.mark.long
def test_nods_begin_only_while_listening_or_without_a_state(live: LiveModel) -> None:
    partner = phrases()
    for state in ("speaking", "thinking"):
        controls = LiveControls("paper", CALM.liveliness, GazeDirection(state=state))
        frames, others = (streamed(live, [640], sound, controls) for sound in (partner, None))
        assert not len(nodding(frames, others, live.fps))
    changes: dict[float, str | None] = {4.0: "thinking", 8.0: "listening"}
    frames, others = (streamed(live, [640], sound, states=changes, seed=2) for sound in (partner, None))
    onsets = nod_onsets(frames, others, live.fps)
    assert (onsets < 3.8).any()
    assert (onsets > 7.8).any()
    assert not ((onsets > 3.8) & (onsets < 7.7)).any()
    np.testing.assert_array_equal(frames.head, streamed(live, [333, 2000], partner, states=changes, seed=2).head)


@pytest.mark.parametrize("latency_s", [0.0, 0.04, 0.4])
def test_nods_of_models_with_any_lookahead_are_causal(latency_s: float) -> None:
    """Each frame alone, given `latency_s` after its time, is that of the whole sound."""
    partner, fps = phrases(), 25.0
    times = np.arange(round((SECONDS - latency_s) * fps)) / fps
    for seed in range(5):
        whole, steps, given = LiveNods(latency_s, [seed]), LiveNods(latency_s, [seed]), 0
        whole.push(partner)
        parts = []
        for time in times:
            needed = round((time + latency_s) * SAMPLE_RATE)
            steps.push(partner[given:needed])
            given = needed
            parts.append(steps.rotation(np.array([time]), True))
        np.testing.assert_array_equal(np.concatenate(parts), whole.rotation(times, True))


@pytest.mark.long
def test_rate_latency_and_depth_are_those_of_files() -> None:
    """Over 50 seeds; in both, a nod is what lifts the path from zero for the first time in 0.1 s."""
    partner, times = phrases(60.0), np.arange(60 * 100) / 100.0
    turns = detect_turns(np.zeros(60 * SAMPLE_RATE, np.float32), partner)
    ends = np.array([each.end_s for each in turns.partner])[:-1]  # the last phrase has no end

    def figures(paths: list[ndarray]) -> ndarray:
        counts, latencies, depths = [], [], []
        for pitch in (path[:, 0] for path in paths):
            moving = np.flatnonzero(pitch > 1e-6)
            onsets = times[moving[np.diff(moving, prepend=-100) > 10]]
            counts.append(len(onsets))
            latencies += [onset - ends[ends < onset].max() for onset in onsets]
            depths += [pitch[(times >= onset) & (times < onset + 0.32)].max() for onset in onsets]
        return np.array([np.mean(counts) / len(ends), np.mean(latencies), np.mean(depths)])

    streams, files = [], []
    for seed in range(50):
        nods = LiveNods(0.237, [seed, 2])
        nods.push(partner)
        streams.append(nods.rotation(times, True))
        files.append(eye_head.head_path(sample_listening_behaviour(turns, [seed, 3]).nods, times))
    found, expected = figures(streams), figures(files)
    np.testing.assert_allclose(found, expected, rtol=0.12)
    assert found[0] == pytest.approx(0.46, abs=0.03)


def test_invalid_partners_get_one_line(live: LiveModel) -> None:
    chunk = np.zeros(640, np.float32)
    with pytest.raises(InputError, match=r"partner: should have as many samples as the sound, 640, got 639"):
        live.stream(0).push(chunk, chunk[1:])
    with pytest.raises(InputError, match=r"partner: samples should be finite"):
        live.stream(0).push(chunk, chunk * np.nan)
    stream = live.stream(0)
    stream.push(chunk)
    with pytest.raises(InputError, match=r"partner: should come with every chunk of a stream or with none"):
        stream.push(chunk, chunk)
    stream = live.stream(0)
    stream.push(chunk, chunk)
    with pytest.raises(InputError, match=r"partner: should come with every chunk"):
        stream.push(chunk)
