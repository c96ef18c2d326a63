"""Stage `synthesize`: a whole corpus, the same for any number of processes, and settings refused before writing."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from pipelines import synthesize
from talkingeyes.config import compose
from talkingeyes.corpus.index import SPLITS
from talkingeyes.corpus.store import Corpus
from talkingeyes.errors import InputError
from talkingeyes.run import Workspace
from talkingeyes.world import plan
from talkingeyes.world.plan import SynthesizeSettings
from tests.fixtures_corpus import make_tiny_corpus


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return Corpus(make_tiny_corpus(tmp_path_factory.mktemp("tiny")))


def files(root: Path):
    return {path.relative_to(root): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def test_every_clip_is_whole(corpus):
    assert corpus.has_truth
    for clip in corpus.clips:
        motion, seen, speech = corpus.truth(clip), corpus.observation(clip), corpus.speech(clip)
        assert len(speech) % 640 == 0 and len(motion) == len(speech) * 25 // 16000 == len(seen.landmarks)
        assert 8.0 <= clip.seconds == len(speech) / 16000 <= 9.6
        assert motion.fps == seen.fps == clip.fps == 25.0
        assert np.abs(speech).max() > 0.05
        annotation = corpus.annotation(clip)
        assert annotation.words and annotation.phonemes and annotation.speaking
        assert annotation.phonemes[-1].end_s <= clip.seconds
        assert corpus.truth_events(clip).saccades and clip.text


def test_splits_are_disjoint_and_none_is_empty(corpus):
    split_of = {clip.sound: clip.split for clip in corpus.clips}
    speakers = {split: {clip.speaker for clip in corpus.select(split)} for split in SPLITS}
    assert all(speakers.values())
    assert not speakers["unseen"] & (speakers["train"] | speakers["val"] | speakers["test"])
    assert all(split_of[clip.sound] == clip.split for clip in corpus.clips)
    assert len(split_of) == 24 and len({clip.id for clip in corpus.clips}) == len(corpus.clips)


def test_takes_share_a_sound_and_differ_in_motion(corpus):
    takes = Counter(clip.sound for clip in corpus.clips)
    several = [sound for sound, count in takes.items() if count > 1]
    assert sorted(takes[sound] for sound in several) == [4, 4]
    assert {clip.split for clip in corpus.clips if clip.sound in several} == {"test", "unseen"}
    first, second = [clip for clip in corpus.clips if clip.sound == several[0]][:2]
    assert (first.take, second.take) == (0, 1) and first.content_hash != second.content_hash
    assert not np.allclose(corpus.truth(first).gaze, corpus.truth(second).gaze, atol=0.02)
    assert np.array_equal(corpus.truth(first).jaw, corpus.truth(second).jaw)


def test_two_processes_make_the_same_bytes(tmp_path):
    few = ("synthesize.clips=10", "synthesize.takes=2")
    one = files(make_tiny_corpus(tmp_path / "one", *few))
    two = files(make_tiny_corpus(tmp_path / "two", *few, jobs=2))
    assert one == two


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"clips": 0}, "synthesize.clips"),
        ({"speakers": 1}, "synthesize.speakers"),
        ({"shortest_s": 3.0}, "synthesize.shortest_s"),
        ({"shortest_s": 9.5}, "longest_s should be at least"),
        ({"fps": -1.0}, "synthesize.fps"),
        ({"speakers": 300}, "clips should be at least speakers"),
        ({"languages": ["xx"]}, "languages should be among"),
        ({"blinks": "never"}, "synthesize.blinks"),
        ({"noise.pupil.white_least_px": 9.0}, "white_most_px should be at least"),
        ({"colour": "red"}, "synthesize.colour"),
    ],
)
def test_settings_out_of_range_are_refused_before_anything_is_written(tmp_path, change, message):
    params = compose(["synthesize=tiny"])
    for key, value in change.items():
        *path, last = key.split(".")
        section = params["synthesize"]
        for part in path:
            section = section[part]
        section[last] = value
    with pytest.raises(InputError, match=message):
        synthesize.run(Workspace(tmp_path, params))
    assert list(tmp_path.iterdir()) == []


def test_a_corpus_too_small_for_its_splits_is_refused():
    settings = SynthesizeSettings(**compose(["synthesize=tiny"])["synthesize"])
    said = [synthesize.Said(sound, ("The same sentence.",), "", 8.0, "en") for sound in plan.sounds(settings)]
    with pytest.raises(InputError, match="every split"):
        synthesize.orders(said, settings)


def test_other_frame_rates(tmp_path):
    settings = SynthesizeSettings(**compose(["synthesize=tiny", "synthesize.fps=50"])["synthesize"])
    said = synthesize.say_sound(tmp_path, settings, plan.sounds(settings)[3])
    (clip,) = synthesize.perform_sound(tmp_path, settings, synthesize.Order(said, "train", 1))
    corpus = Corpus(tmp_path)
    assert len(corpus.truth(clip)) == round(clip.seconds * 50) and corpus.observation(clip).fps == 50.0


def test_paper_is_as_large_as_the_paper():
    settings = SynthesizeSettings(**compose(["synthesize=paper"])["synthesize"])
    assert (settings.clips, settings.speakers) == (5982, 669)
