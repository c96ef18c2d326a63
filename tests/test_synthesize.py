"""Stage `synthesize`: a complete corpus, independent of the number of processes; bad settings fail before writing."""

import re
import subprocess
import sys
import time
from collections import Counter
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from model_conf import compose
from toy_corpus import make_tiny_corpus

from pipelines import synthesize
from talkingeyes.audio.annotation import EMOTIONS
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import SPLITS
from talkingeyes.corpus.store import Corpus
from talkingeyes.orchestration.config import write_params
from talkingeyes.orchestration.run import Workspace
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.plan import SynthesizeSettings
from talkingeyes.synthesis.speech_synthesis import synthesize_conversation

FEW = ("synthesize.clips=10", "synthesize.takes=1")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return Corpus(make_tiny_corpus(tmp_path_factory.mktemp("tiny")))


def files(root: Path):
    return {path.relative_to(root): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def test_every_clip_is_complete(corpus):
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
    assert sorted(takes[sound] for sound in several) == [2, 2, 4, 4]
    assert {clip.split for clip in corpus.clips if clip.sound in several} == {"val", "test", "unseen"}
    assert all(takes[clip.sound] == 2 for clip in corpus.select("val"))
    first, second = [clip for clip in corpus.clips if clip.sound == several[0]][:2]
    assert (first.take, second.take) == (0, 1) and first.content_hash != second.content_hash
    assert not np.allclose(corpus.truth(first).gaze, corpus.truth(second).gaze, atol=0.02)
    assert np.array_equal(corpus.truth(first).jaw, corpus.truth(second).jaw)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Files of a corpus made by one uninterrupted process."""
    return files(make_tiny_corpus(tmp_path_factory.mktemp("whole"), *FEW))


@pytest.mark.long
def test_two_processes_make_the_same_bytes(tmp_path, whole):
    assert files(make_tiny_corpus(tmp_path, *FEW, jobs=2)) == whole


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"clips": 0}, "synthesize.clips"),
        ({"shortest_s": 9.5}, r"longest_s should be at least shortest_s \+ 0.5 \(10.0\), got 9.6"),
        ({"splits.val": 0.5}, "synthesize.splits.val: Input should be less than 0.5"),
        ({"longest_s": 601.0}, "synthesize.longest_s: Input should be less than or equal to 600, got 601.0"),
        ({"acoustics.rt60_min_s": 2.0}, r"rt60_max_s should be at least rt60_min_s \(2.0\), got 0.6"),
        ({"voices": ["en-us+nobody"]}, "voices should be accent.variant, of the accents en-us, .*, got en-us.nobody"),
        ({"voices": ["fr+f1"]}, r"voices should have one for en \(en-us, .*, got fr.f1"),
        ({"further_sources": {"interview": {}}}, "synthesize.further_sources.interview.clips"),
        ({"speakers": 300}, r"clips should be at least speakers \(300\), got 24"),
        ({"languages": ["xx"]}, "languages should be among en, fr, de, es, it, pt, nl, got xx"),
        ({"noise.pupil.white_min_px": 9.0}, "white_max_px should be at least"),
        ({"colour": "red"}, "synthesize.colour"),
    ],
)
def test_settings_out_of_range_are_errors_before_any_output(tmp_path, change, message):
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


def test_other_frame_rates(tmp_path):
    settings = SynthesizeSettings(**compose(["synthesize=tiny", "synthesize.fps=50"])["synthesize"])
    clip = synthesize.synthesize_sound(tmp_path, settings, synthesize.sound_jobs(settings)[3])[0]
    corpus = Corpus(tmp_path)
    assert len(corpus.truth(clip)) == round(clip.seconds * 50) and corpus.observation(clip).fps == 50.0


def test_no_text_voice_or_sound_is_in_two_splits(corpus):
    said, speakers, sounds = ({split: set() for split in SPLITS} for _ in range(3))
    for clip in corpus.clips:
        said[clip.split] |= set(re.findall(r"[^.?]+[.?]", clip.text))
        speakers[clip.split].add(clip.speaker)
        sounds[clip.split].add(clip.sound)
    for one, other in combinations(SPLITS, 2):
        assert not said[one] & said[other] and not sounds[one] & sounds[other]
        assert "unseen" not in (one, other) or not speakers[one] & speakers[other]


def test_sentences_of_both_speakers_belong_to_their_split():
    settings = SynthesizeSettings(**compose(["synthesize=tiny", "synthesize.dialogue_share=1"])["synthesize"])
    for split, partition in synthesize.SPLIT_PARTITIONS.items():
        speaker_voices = plan.dialogue_voices(settings, plan.plan_sounds(settings)[0])
        spoken = synthesize_conversation(
            speaker_voices, 8.0, 9.6, np.random.default_rng(SPLITS.index(split)), partition
        )
        assert len(spoken.sentences) >= 2
        assert all(text in partition for text in spoken.sentences)


def test_texts_of_splits_do_not_overlap():
    shares = sorted((partition.start, partition.stop) for partition in synthesize.SPLIT_PARTITIONS.values())
    assert set(synthesize.SPLIT_PARTITIONS) == set(SPLITS) and shares[0][0] == 0.0
    assert all(one[1] <= other[0] for one, other in pairwise(shares))


def test_a_partner_speaks_on_a_channel_of_its_own(tmp_path):
    settings = SynthesizeSettings(**compose(["synthesize=tiny", "synthesize.dialogue_share=1"])["synthesize"])
    clip = synthesize.synthesize_sound(tmp_path, settings, synthesize.sound_jobs(settings)[0])[0]
    corpus = Corpus(tmp_path)
    own, partner, known = corpus.speech(clip), corpus.partner(clip), corpus.annotation(clip)
    assert partner.shape == own.shape and known.speaking and known.listening and known.partner
    for sound, silent, heard in ((own, known.listening, known.speaking), (partner, known.speaking, known.partner)):
        for span in silent:
            assert np.abs(sound[round(span.start_s * 16000) + 80 : round(span.end_s * 16000) - 80]).max() < 1e-3
        for span in heard:
            assert np.abs(sound[round(span.start_s * 16000) : round(span.end_s * 16000)]).max() > 0.05


def test_splits_have_the_sizes_of_the_settings():
    jobs = synthesize.sound_jobs(SynthesizeSettings(**compose([])["synthesize"]))
    assert Counter(job.split for job in jobs) == {"train": 2798, "val": 105, "test": 105, "unseen": 192}
    speakers = {split: {job.sound.speaker for job in jobs if job.split == split} for split in ("train", "unseen")}
    assert len(speakers["unseen"]) == 12 and not speakers["unseen"] & speakers["train"]


def test_the_content_hash_covers_observations(tmp_path):
    hashes = set()
    for number, noise in enumerate((0.12, 0.13)):
        overrides = ["synthesize=tiny", f"synthesize.noise.landmark.white_px={noise}"]
        settings = SynthesizeSettings(**compose(overrides)["synthesize"])
        job = synthesize.sound_jobs(settings)[0]
        hashes.add(synthesize.synthesize_sound(tmp_path / str(number), settings, job)[0].content_hash)
    assert len(hashes) == 2


def test_fractions_of_listening_and_emotions_are_as_configured():
    overrides = ["synthesize.clips=2000", "synthesize.dialogue_share=0.3", "synthesize.neutral_share=0.6"]
    sounds = plan.plan_sounds(SynthesizeSettings(**compose(["synthesize=tiny", *overrides])["synthesize"]))
    assert np.mean([sound.listening for sound in sounds]) == pytest.approx(0.3, abs=0.05)
    moods = Counter((sound.emotion, sound.intensity) for sound in sounds)
    assert moods.pop(("neutral", 0)) / 2000 == pytest.approx(0.6, abs=0.05)
    assert len(moods) == 21 and {intensity for _, intensity in moods} == {1, 2, 3} and min(moods.values()) > 15


def test_index_has_emotion_and_source(corpus):
    for clip in corpus.clips:
        known = corpus.annotation(clip)
        assert (known.emotion, known.intensity) == (clip.emotion, clip.intensity)
        assert clip.source == "synthetic interview" and clip.emotion in EMOTIONS
    assert len({clip.emotion for clip in corpus.clips}) > 2


def test_table_1_is_reproduced(corpus):
    rows = (corpus.root / "table1.md").read_text().splitlines()
    cells = [cell.strip() for cell in rows[-1].split("|")]
    hours = sum(clip.seconds for clip in corpus.clips) / 3600
    assert cells[5:8] == [str(len(corpus.clips)), "4", f"{hours:.3g}"]


def test_noise_and_room_change_only_the_sound(tmp_path):
    loud = ["synthesize.acoustics.noise_probability=1", "synthesize.acoustics.reverb_probability=1"]
    plain, noisy = (SynthesizeSettings(**compose(["synthesize=tiny", *more])["synthesize"]) for more in ([], loud))
    job = synthesize.sound_jobs(plain)[0]
    for name, settings in (("plain", plain), ("noisy", noisy), ("again", noisy)):
        synthesize.synthesize_sound(tmp_path / name, settings, job)
    content = {name: files(tmp_path / name) for name in ("plain", "noisy", "again")}
    assert content["noisy"] == content["again"]
    differing = {path.parts[0] for path, data in content["plain"].items() if content["noisy"][path] != data}
    assert differing == {"speech", "rows"}  # rows contain a hash of the sound


@pytest.mark.long
def test_killed_run_resumes(tmp_path, whole):
    root = tmp_path / "killed"
    write_params(root / "params.yaml", compose(["experiment=tiny", "machine.jobs=1", *FEW]))
    rows = root / "data" / ".synthesize.partial" / "rows"
    command = [sys.executable, "-m", "pipelines.synthesize"]
    with subprocess.Popen(command, cwd=root, stderr=subprocess.DEVNULL) as run:
        while len(list(rows.rglob("*.json"))) < 3:
            assert run.poll() is None, "ended before anything could be killed"
            time.sleep(0.005)
        run.kill()
    assert run.returncode == -9
    partial = root / "data" / ".synthesize.partial"
    done = [path.relative_to(partial) for path in partial.rglob("*.events.json")]
    finished = {path.stem for path in rows.rglob("*.json")}
    before = {path: (partial / path).stat().st_mtime_ns for path in done if path.name[:12] in finished}
    assert before and not (root / "data" / "synthesize").exists()
    synthesize.run(Workspace.open(root))
    assert files(root / "data" / "synthesize") == whole
    assert all((root / "data" / "synthesize" / path).stat().st_mtime_ns == time_ns for path, time_ns in before.items())


def test_unfinished_output_is_resumed_only_with_equal_inputs(tmp_path):
    workspace = Workspace(tmp_path, {})
    for fingerprint, left in (("one", []), ("one", ["half"]), ("other", [])):
        with pytest.raises(KeyboardInterrupt), workspace.output("synthesize", fingerprint=fingerprint) as folder:
            assert sorted(path.name for path in folder.glob("[a-z]*")) == left
            (folder / "half").write_text("")
            raise KeyboardInterrupt
    with workspace.output("synthesize", fingerprint="other") as folder:
        assert (folder / "half").exists()
    assert sorted(path.name for path in (tmp_path / "data").rglob("*")) == ["SHA256SUMS", "half", "synthesize"]


def test_corpus_too_small_for_its_splits_is_an_error():
    settings = SynthesizeSettings(**compose(["synthesize=tiny"])["synthesize"])
    with pytest.raises(InputError, match="every split"):
        synthesize.sound_jobs(settings.model_copy(update={"clips": 4}))


def test_preset_paper_has_the_size_and_sources_of_the_paper():
    settings = SynthesizeSettings(**compose(["synthesize=paper"])["synthesize"])
    sounds = plan.plan_sounds(settings)
    assert Counter(sound.source for sound in sounds) == {"interview": 5912, "monologue": 70}
    assert len({sound.speaker for sound in sounds}) == 669
    rng = np.random.default_rng(0)
    hours = {
        name: each.clips * np.exp(rng.uniform(np.log(each.shortest_s), np.log(each.longest_s), 9999)).mean() / 3600
        for name, each in settings.sources.items()
    }
    assert hours["interview"] == pytest.approx(12, abs=0.2) and hours["monologue"] == pytest.approx(2, abs=0.1)
    lively, quiet = (plan.speaker_of(settings, sound).style.liveliness for sound in (sounds[0], sounds[-1]))
    assert quiet < 0.5 < lively


def test_personal_has_clips_of_every_person_in_every_split():
    settings = SynthesizeSettings(**compose(["synthesize=personal"])["synthesize"])
    sound_jobs = synthesize.sound_jobs(settings)
    people = {speaker: Counter(o.split for o in sound_jobs if o.sound.speaker == speaker) for speaker in range(6)}
    unseen = [speaker for speaker, splits in people.items() if splits == {"unseen": 10}]
    assert len(sound_jobs) == 60 and len(unseen) == 1
    assert all(splits == {"train": 8, "val": 1, "test": 1} for s, splits in people.items() if s not in unseen)


def test_every_language_has_speakers(tmp_path):
    settings = SynthesizeSettings(**compose(["synthesize=languages"])["synthesize"])
    texts = {}
    for job in synthesize.sound_jobs(settings)[1:7]:
        (clip, *_) = synthesize.synthesize_sound(tmp_path, settings, job)
        texts[clip.language] = clip.text
    assert set(texts) == {"fr", "de", "es", "it", "pt", "nl"} and len(set(texts.values())) == 6
