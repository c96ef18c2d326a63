"""Sensitivity of the benchmark metrics to corruptions of the truth.

The pool is synthetic motion with a fixed seed, without sound and corpus. docs/results/sensitivity.md
(pipelines/results/sensitivity.py) has all effects for a larger pool.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pytest

from talkingeyes.core.rotation import gaze_in_space
from talkingeyes.evaluation.benchmark.corruptions import CORRUPTIONS, SWAPPED, UNCORRUPTED, apply_corruption
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.benchmark.sensitivity import (
    CorruptionEffect,
    mean_l2,
    sensitivity_matrix,
    smallest_doses,
    split_takes,
    train_pool_encoder,
)
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.measures import partner_gaze
from talkingeyes.evaluation.measures.motion_encoder import EncoderSettings
from talkingeyes.models.motion_autoencoder import MotionAutoencoderSettings
from talkingeyes.synthesis.sketched_clips import sketch_clips
from talkingeyes.training.loop import LoopSettings

SETTINGS = BootstrapSettings(n_resamples=100, confidence_level=0.95, seed=0)
ENCODER = EncoderSettings(
    window_s=2.56,
    hop_s=1.28,
    network=MotionAutoencoderSettings(step_frames=4, width=64, latent=6, kl_weight=1.0),
    loop=LoopSettings(
        steps=100,
        batch=32,
        learning_rate=0.005,
        schedule="one-cycle",
        weight_decay=0.01,
        clip_norm=1.0,
        validate_every=50,
    ),
)
BY_NAME = {each.name: each for each in CORRUPTIONS}
# Corruptions and the metrics that must detect them.
MUST = {
    "frozen": (
        "gaze_in_space/still_fraction", "gaze_in_space/speed", "eye/sd_yaw", "head/speed",
    ),
    "mean pose": ("gaze_in_space/still_fraction", "eye/still_fraction"),
    "jittered": (
        "saccades/rate", "gaze_in_space/still_fraction", "gaze_in_space/speed", "head/above_5_hz", "eye/torsion",
        "eye/conjugacy",
    ),
    "smoothed": (
        "saccades/amplitude", "saccades/amplitude_distance", "saccades/interval_distance",
        "main_sequence/peak_speed_ratio", "fixations/duration_median", "gaze_in_space/speed_p99",
        "gaze_in_space/above_5_hz", "head/spectrum_distance",
    ),
    "reduced amplitude": ("saccades/amplitude_p90", "eye/sd_pitch", "head/sd_roll", "head/sd_yaw", "eye/range_yaw"),
    "delayed": ("head/speech_speed_ratio",),
    "swapped speaker": ("reference_correlation/head_pitch", "head/speech_speed_ratio"),
    "mirrored left-right": ("reference_correlation/head_roll",),
    "mirrored up-down": ("reference_correlation/head_pitch",),
    "flipped eyes": ("head_eye/slope_yaw", "head_eye/slope_pitch", "head_eye/correlation"),
    "flipped eye yaw": ("head_eye/slope_yaw", "main_sequence/log_spread"),
    "diverging eyes": ("eye/vergence",),
    "false torsion": ("eye/torsion",),
    "delayed eyes": ("head_eye/slope_yaw", "gaze_in_space/still_fraction"),
    "delayed head": ("head/speech_speed_ratio",),
    "fixed head": ("eye/still_fraction", "head/speed"),
    "delayed blinks": ("blinks/at_phrase_ends",),
    "drifting head": ("saccades/left_right_asymmetry", "head/speed", "head/above_5_hz"),
    "missing blinks": ("blinks/rate",),
    "shallow blinks": ("blinks/depth",),
    "slow blinks": ("blinks/duration_median", "blinks/duration_distance"),
    "timed blinks": ("blinks/interval_cv", "blinks/at_shifts"),
}  # fmt: skip
# Corruptions and metrics that must not detect them.
MUST_NOT = {
    "delayed": ("saccades/rate", "gaze_in_space/still_fraction", "head/sd_yaw"),
    "mirrored left-right": ("saccades/rate", "head_eye/slope_yaw", "head/speed", "blinks/rate"),
    "mirrored up-down": ("saccades/amplitude", "blinks/rate", "head/speed"),
    "delayed blinks": ("saccades/rate", "blinks/rate"),
    "drifting head": ("eye/speed", "blinks/rate"),
    "missing blinks": ("blinks/duration_median", "blinks/depth", "saccades/rate"),
    "shallow blinks": ("blinks/duration_median", "saccades/rate"),
    "slow blinks": ("blinks/depth", "saccades/rate"),
    "timed blinks": ("blinks/rate", "blinks/duration_median", "blinks/depth", "saccades/rate"),
}


def detected_corruptions(effects: Mapping[str, CorruptionEffect]) -> list[str]:
    """Names of the corruptions that a metric detects."""
    return [name for name, each in effects.items() if name != UNCORRUPTED.name and each.detected]


@pytest.fixture(scope="module")
def takes():
    """16 speakers with 2 sounds of 12 s: one reference take and one evaluated take."""
    return split_takes(sketch_clips(16, 2, 2, 12.0, 25.0, seed=0))


@pytest.fixture(scope="module")
def found(takes):
    """Sensitivity matrix of the metrics computed from sums over clips."""
    return sensitivity_matrix(takes, SETTINGS)


@pytest.fixture(scope="module")
def several():
    """8 speakers with 2 sounds: two reference takes and two evaluated takes."""
    return split_takes(sketch_clips(8, 2, 4, 12.0, 25.0, seed=0))


@pytest.fixture(scope="module")
def found_of_several(several):
    """Sensitivity matrix with the metrics over several samples and of the encoder, for a few corruptions."""
    encoder = train_pool_encoder(sketch_clips(12, 2, 1, 12.0, 25.0, seed=1), ENCODER, seed=0)
    return sensitivity_matrix(several, SETTINGS, encoder, corruptions=[BY_NAME[name] for name in MUST_OF_SEVERAL])


MUST_OF_SEVERAL = {
    "mean pose": ("samples/diversity_gaze", "samples/diversity_head", "features/frechet", "features/mmd"),
    "jittered": ("features/frechet", "features/coverage"),
    "reduced amplitude": ("samples/diversity_gaze", "samples/diversity_head", "features/frechet"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", MUST_OF_SEVERAL)
def test_sample_and_encoder_metrics_detect_their_corruptions(found_of_several, name: str) -> None:
    caught = {metric for metric, cells in found_of_several.items() if name in detected_corruptions(cells)}
    assert set(MUST_OF_SEVERAL[name]) <= caught


def test_mean_pose_has_best_l2_and_nearest_sample(several, found_of_several) -> None:
    """L2 and the distance to the nearest sample rank a constant above the truth; the energy score does not."""
    assert mean_l2(several, BY_NAME["mean pose"]) < 0.9 * mean_l2(several, UNCORRUPTED)
    assert found_of_several["samples/min_ade_head"]["mean pose"].rated_better
    assert not found_of_several["samples/energy_score_head"]["mean pose"].rated_better


@pytest.mark.long
@pytest.mark.parametrize("name", MUST)
def test_each_corruption_is_detected(found, name: str) -> None:
    assert set(MUST[name]) <= {metric for metric, cells in found.items() if name in detected_corruptions(cells)}


@pytest.mark.parametrize("name", MUST_NOT)
def test_unaffected_metrics_do_not_detect_corruptions(found, name: str) -> None:
    assert not set(MUST_NOT[name]) & {metric for metric, cells in found.items() if name in detected_corruptions(cells)}


def test_without_blinks_their_metrics_have_nothing_to_measure(found) -> None:
    for metric in ("blinks/rate", "blinks/depth"):
        cell = found[metric]["no blinks"]
        assert not cell.measured
        assert not cell.detected


def test_every_metric_detects_some_corruption(found) -> None:
    blind = {name for name, cells in found.items() if not detected_corruptions(cells)}
    aversion = {"reference_correlation/aversion_yaw", "reference_correlation/aversion_pitch"}
    aversion.add("partner_gaze/aversion_median")  # in 2 of 6 pools of this size
    assert blind <= {*aversion, "eye/pitch_skew", "head/pitch_velocity_skew", "saccades/interval_cv"}


@pytest.mark.long
def test_people_with_places_of_their_own_show_mirrored_aversion() -> None:
    takes = split_takes(sketch_clips(24, 4, 4, 12.0, 25.0, seed=0, population="remote_call"))
    sides, heights = BY_NAME["mirrored left-right"], BY_NAME["mirrored up-down"]
    found = sensitivity_matrix(takes, SETTINGS, corruptions=[sides, heights])
    for metric, corruption in (("aversion_yaw", sides), ("aversion_pitch", heights)):
        cells = found[f"reference_correlation/{metric}"]
        assert cells[corruption.name].detected
        assert cells[UNCORRUPTED.name].value > 0.1


@pytest.mark.long
def test_smallest_dose_is_where_detection_starts(takes) -> None:
    """From the smallest dose on, the matrix has the corruption as detected, and not at half of it."""
    corruption = BY_NAME["diverging eyes"]
    smallest = smallest_doses(takes, SETTINGS, corruptions=[corruption, BY_NAME["no blinks"]])
    assert set(smallest["eye/vergence"]) == {corruption.name}  # "no blinks" has no size
    assert smallest["blinks/rate"][corruption.name] is None
    dose = smallest["eye/vergence"][corruption.name]
    assert dose is not None
    assert corruption.doses[0] < dose < 0.5
    for size, expected in ((dose / 2, False), (dose, True), (2 * dose, True)):
        cells = sensitivity_matrix(takes, SETTINGS, None, corruption.strength(size), [corruption])["eye/vergence"]
        assert cells[corruption.name].detected == expected


def test_doses_ascend_to_the_size_in_the_title() -> None:
    for each in CORRUPTIONS:
        assert list(each.doses) == sorted(set(each.doses))
        assert not each.doses or each.strength(each.doses[-1]) == 1
        size = re.search(r"[\d.]+(?= deg| s\b)", each.title)
        if each.unit in ("deg", "s"):
            assert size is not None
            assert each.doses[-1] == pytest.approx(float(size[0]))


@pytest.mark.long
def test_true_takes_differ_no_more_often_than_by_chance() -> None:
    """In a tenth of the metrics at most, over pools: metrics are correlated, so single pools have 0.03 to 0.20."""
    shares = []
    for seed in range(6):
        cells = sensitivity_matrix(split_takes(sketch_clips(16, 2, 2, 12.0, 25.0, seed=seed)), SETTINGS, corruptions=[])
        shares.append(np.mean([each[UNCORRUPTED.name].effect_size > 1 for each in cells.values()]))
    assert np.mean(shares) <= 0.1, shares


@pytest.mark.long
def test_aversion_curves_agree_for_true_takes_but_not_for_late_motion() -> None:
    """The curves need 400 onsets and offsets, so they have a larger pool and only their extractor is run."""
    takes = split_takes(sketch_clips(75, 1, 2, 16.0, 25.0, seed=0))
    evaluated = [motions[0] for motions in takes.evaluated]
    sets = [
        [motions[0] for motions in takes.reference],
        evaluated,
        apply_corruption(evaluated, takes.speakers, BY_NAME["delayed"], 1.0, 0),
        apply_corruption(evaluated, takes.speakers, BY_NAME["frozen"], 1.0, 0),
    ]
    true, other, late, frozen = (_totals(each) for each in sets)
    for name in ("speech_onset/shape", "speech_offset/shape"):
        metric = next(each for each in METRICS if each.name == name)
        assert true[metric.count_key][0] >= metric.min_count
        shape = [float(metric.compare(each, true)[0]) for each in (other, late, frozen)]
        assert shape[0] > 0.5
        assert max(shape[1:]) < shape[0] - 0.2, name


def _totals(motions):
    sums = [partner_gaze.CURVES.extract(motion) for motion in motions]
    return {name: np.sum([each[name] for each in sums], axis=0)[None] for name in sums[0]}


@pytest.mark.parametrize("corruption", CORRUPTIONS, ids=lambda each: each.name)
def test_zero_strength_is_identity_and_seed_is_reproducible(takes, corruption) -> None:
    motions, speakers = [sounds[0] for sounds in takes.evaluated[:6]], takes.speakers[:6]
    nothing = apply_corruption(motions, speakers, corruption, 0.0, seed=0)
    once, again = (apply_corruption(motions, speakers, corruption, 1.0, seed=0) for _ in range(2))
    for before, same, one, two in zip(motions, nothing, once, again, strict=True):
        for field in ("head", "gaze", "lid", "valid"):
            assert getattr(same, field) == pytest.approx(getattr(before, field), abs=1e-9), field
            assert (getattr(one, field) == getattr(two, field)).all()
        assert one.annotation == before.annotation
        assert one.reference is before.reference
    assert any(
        (getattr(a, f) != getattr(b, f)).any()
        for a, b in zip(motions, once, strict=True)
        for f in ("head", "gaze", "lid")
    )


def test_corruptions_have_their_stated_effect(takes) -> None:
    motion = takes.evaluated[0][0]

    def made(name: str):
        return apply_corruption([motion], ["a"], BY_NAME[name], 1.0, seed=0)[0]

    space = gaze_in_space(motion.head, motion.gaze)
    assert gaze_in_space(made("mirrored left-right").head, made("mirrored left-right").gaze) == pytest.approx(
        space[:, ::-1] * [-1, 1], abs=1e-9
    )
    assert gaze_in_space(made("mirrored up-down").head, made("mirrored up-down").gaze) == pytest.approx(
        space * [1, -1], abs=1e-9
    )
    for name in ("delayed head", "fixed head"):
        assert gaze_in_space(made(name).head, made(name).gaze) == pytest.approx(space, abs=1e-9)
    assert (made("delayed").gaze[75:] == motion.gaze[:-75]).all()
    assert made("jittered").head.std() > motion.head.std()
    assert np.degrees((made("jittered").head - motion.head).std()) == pytest.approx(0.3, rel=0.1)
    drift = np.degrees((made("drifting head").head - motion.head)[:, 1])
    assert np.ptp(drift) == pytest.approx(3.0, abs=0.1)
    assert (np.diff(drift) > 0).mean() > 0.95  # to the left, but for the snaps


def test_corruptions_of_blinks_change_what_they_state(takes) -> None:
    motions = [motions[0] for motions in takes.evaluated]

    def blinks(name: str):
        return [each.blinks for each in apply_corruption(motions, takes.speakers, BY_NAME[name], 1.0, seed=0)]

    def total(found) -> int:
        return sum(map(len, found))

    true = [each.blinks for each in motions]
    assert total(blinks("missing blinks")) == pytest.approx(total(true) / 2, rel=0.15)
    duration = [
        np.median(np.concatenate([each.duration_s for each in found])) for found in (true, blinks("slow blinks"))
    ]
    assert duration[1] == pytest.approx(2 * duration[0], rel=0.1)
    spread = [
        np.median([np.std(np.diff(each.onset_s)) for each in found if len(each) > 2])
        for found in (true, blinks("timed blinks"))
    ]
    assert spread[0] > 0.5  # seconds
    assert spread[1] < 0.1
    assert total(blinks("timed blinks")) == pytest.approx(total(true), rel=0.05)


def test_swapped_motion_is_of_another_speaker(takes) -> None:
    motions, speakers = [sounds[0] for sounds in takes.evaluated], takes.speakers
    for motion, speaker in zip(apply_corruption(motions, speakers, SWAPPED, 1.0, 0), speakers, strict=True):
        owner = next(i for i, each in enumerate(motions) if np.array_equal(each.head, motion.head))
        assert speakers[owner] != speaker


@pytest.mark.long
def test_late_motion_is_detected_around_the_events_of_a_conversation() -> None:
    takes = split_takes(
        sketch_clips(64, 4, 2, 24.0, 25.0, seed=0, conversation=True)
    )  # 24 are too few for ends of turns
    delayed, diverging = BY_NAME["delayed"], BY_NAME["diverging eyes"]
    found = sensitivity_matrix(takes, SETTINGS, corruptions=[delayed, diverging])
    events = [name for name in found if name.startswith(("turn_", "hesitation/", "filler/"))]
    assert len(events) == 7
    assert {name for name in events if found[name][delayed.name].detected} >= set(events) - {"filler/rise"}  # no cue
    assert not any(found[name][diverging.name].detected for name in events)
