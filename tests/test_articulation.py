"""Jaw and lips: targets of phonemes, co-articulation, loudness, any frame rate; facial emotions and brows."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from talkingeyes.audio.annotation import EMOTIONS, Annotation, Phoneme, Span
from talkingeyes.audio.loudness import with_loudness
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.head.landmarks import motion_landmarks
from talkingeyes.head.posing import expression_shape_names
from talkingeyes.physiology import articulation, face
from talkingeyes.physiology.articulation import ArticulationStyle, mouth_motion
from talkingeyes.physiology.face import FACE_SHAPES, BrowRaise, FacialBehaviour
from talkingeyes.synthesis.brows import sample_brow_raises

USUAL = ArticulationStyle()
STEP_S = 0.12


def said(symbols, stressed="aouiE", loudness=1.0):
    """Consecutive phonemes and the apex times."""
    phonemes = [
        Phoneme(i * STEP_S, (i + 1) * STEP_S, symbol, symbol in stressed, loudness=loudness)
        for i, symbol in enumerate(symbols)
    ]
    return phonemes, (np.arange(len(symbols)) + articulation.APEX) * STEP_S


def shown(symbols, style=USUAL, mood=None):
    """A motion with one frame at each apex."""
    phonemes, times = said(symbols)
    spoken = mouth_motion(phonemes, times, style)
    still = np.zeros((len(times), 3))
    return Motion.of(
        25.0,
        still,
        np.zeros((len(times), 2, 3)),
        jaw=spoken.jaw,
        expression=face.expression_weights(mood or FacialBehaviour(), spoken, times, np.ones(len(times))),
        expression_names=FACE_SHAPES,
    )


def lip_gap_m(motion):
    points = motion_landmarks(motion)
    return points[:, LANDMARK_NAMES.index("upper_lip_inner"), 1] - points[:, LANDMARK_NAMES.index("lower_lip_inner"), 1]


def mouth_width_m(motion):
    points = motion_landmarks(motion)
    return (
        points[:, LANDMARK_NAMES.index("left_mouth_corner"), 0]
        - points[:, LANDMARK_NAMES.index("right_mouth_corner"), 0]
    )


def test_the_jaw_opens_for_vowels_and_closes_in_silence():
    phonemes, times = said(["m", "a", "m", "a", "m"])
    jaw = mouth_motion(phonemes, np.append(times, 3.0), USUAL).jaw[:, 0]
    assert jaw[1] > 2 * jaw[2] and jaw[3] > 2 * jaw[4] and jaw[5] < 0.01
    assert jaw[1] > 2 * mouth_motion(*said(["m", "i", "m"]), USUAL).jaw[1, 0]
    assert mouth_motion(phonemes, times, replace(USUAL, jaw_scale=50.0)).jaw[1, 0] == articulation.JAW_LIMIT_RAD
    assert np.array_equal(mouth_motion((), times, USUAL).jaw, np.zeros((5, 3)))
    assert np.allclose(mouth_motion((), times, replace(USUAL, jaw_rest_rad=0.05)).jaw[:, 0], 0.05)
    assert mouth_motion(phonemes, times, replace(USUAL, jaw_asymmetry=0.2)).jaw[1, 1] == pytest.approx(0.2 * jaw[1])


@pytest.mark.parametrize("symbol", ["p", "b", "m"])
def test_lips_meet_between_any_vowels(symbol):
    """Resting lips touch: closed lips have no larger gap, even between two open vowels."""
    rest_m = lip_gap_m(Motion.of(25.0, np.zeros((1, 3)), np.zeros((1, 2, 3))))[0]
    motion = shown(["a", symbol, "a"])
    gap_m = lip_gap_m(motion)
    assert gap_m[1] < rest_m < gap_m[0] - 0.005
    assert motion.jaw[1, 0] > 0.005


def test_closed_lips_are_seen_at_25_frames_a_second():
    phonemes, _ = said(["a", "b", "a"])
    for shift in np.linspace(0, 0.04, 9):
        assert mouth_motion(phonemes, np.arange(0, 0.36, 0.04) + shift, USUAL).closed.max() > 0.99


def test_lips_are_narrow_and_forward_for_round_vowels_and_wide_for_i():
    round_, wide, ahead = (mouth_width_m(shown(["h", vowel, "h"]))[1] for vowel in ("u", "i", "V"))
    assert round_ < ahead - 0.003 and wide > ahead + 0.001
    points = motion_landmarks(shown(["h", "u", "h"]))[1], motion_landmarks(shown(["h", "i", "h"]))[1]
    assert points[0][LANDMARK_NAMES.index("upper_lip"), 2] > points[1][LANDMARK_NAMES.index("upper_lip"), 2] + 0.002


def test_teeth_meet_the_lower_lip():
    tucked, open_ = (shown(["a", symbol, "a"]) for symbol in ("f", "k"))
    assert tucked.expression[1, FACE_SHAPES.index("mouthRollLower")] > 0.5
    assert lip_gap_m(tucked)[1] < lip_gap_m(open_)[1]


def test_phonemes_are_coarticulated():
    """The t before a rounded vowel is rounder than before a spread one, and rounding starts earlier than the jaw."""
    pucker = FACE_SHAPES.index("mouthPucker")
    before_u, before_i = (shown(["i", "t", vowel]).expression[1, pucker] for vowel in ("u", "i"))
    assert before_u > before_i + 0.2
    times = np.linspace(-0.4, 0.6, 1001)
    fields = articulation.coarticulated_parameters([Phoneme(0.0, 0.1, "u", True)], times, USUAL)
    half_s = [times[np.argmax(fields[:, field] > 0.5 * fields[:, field].max())] for field in (0, 1)]
    assert half_s[1] < half_s[0] - 0.02


def test_a_diphthong_has_two_apexes():
    phonemes = [Phoneme(0.0, 0.3, "aI", True)]
    early, late = mouth_motion(phonemes, np.array([0.09, 0.24]), USUAL).jaw[:, 0]
    assert early > 1.5 * late
    assert articulation.phoneme_targets("aI@") == articulation.phoneme_targets("a") != articulation.phoneme_targets("t")
    assert articulation.phoneme_targets("tS") != articulation.phoneme_targets("t")


def test_loud_vowels_open_further():
    soft, loud = (mouth_motion(*said(["t", "a", "t"], loudness=level), USUAL).jaw[1, 0] for level in (0.4, 2.0))
    assert loud > 1.3 * soft


def test_loudness_is_that_of_the_sound():
    annotation = Annotation(
        phonemes=(Phoneme(0.0, 0.1, "a", True), Phoneme(0.1, 0.2, "a", True), Phoneme(0.2, 0.3, "t"))
    )
    sound = np.repeat([0.1, 0.3, 0.0], 1600) * np.tile([1.0, -1.0], 2400)
    levels = [phoneme.loudness for phoneme in with_loudness(annotation, sound).phonemes]
    assert levels == pytest.approx([0.5, 1.5, 0.0], abs=0.01)
    assert with_loudness(Annotation(), sound) == Annotation()


@given(st.lists(st.sampled_from(sorted(articulation._TARGETS)), min_size=1, max_size=60))
def test_mouth_stays_valid_for_any_speech(symbols):
    phonemes, _ = said(symbols)
    times = np.arange(-0.2, len(symbols) * STEP_S + 0.2, 0.02)
    spoken = mouth_motion(phonemes, times, USUAL)
    weights = face.expression_weights(FacialBehaviour(), spoken, times, np.ones(len(times)))
    assert (spoken.jaw[:, 0] >= 0).all() and (spoken.jaw[:, 0] <= articulation.JAW_LIMIT_RAD).all()
    assert (weights >= 0).all() and (weights <= 1).all()


def test_frames_do_not_depend_on_each_other():
    """The output depends only on the nearest phonemes, at any frame rate; more distant ones have no visible effect."""
    phonemes, _ = said(["t", "a", "m", "u"] * 30)
    times = np.arange(0, 14, 0.01)
    whole = mouth_motion(phonemes, times, USUAL)
    assert np.array_equal(mouth_motion(phonemes, times[::4], USUAL).jaw, whole.jaw[::4])
    every = articulation.NEAREST_PHONEMES
    articulation.NEAREST_PHONEMES = len(phonemes)
    try:
        assert np.abs(mouth_motion(phonemes, times, USUAL).jaw - whole.jaw).max() < 1e-4
    finally:
        articulation.NEAREST_PHONEMES = every


def test_face_shapes_are_those_of_the_open_head():
    assert expression_shape_names(anny_head()) == FACE_SHAPES
    for mood in face.EMOTION_EXPRESSIONS.values():
        assert set(mood.shapes) <= set(FACE_SHAPES)
    assert set(face.EMOTION_EXPRESSIONS) == set(EMOTIONS)


def test_emotions_scale_with_intensity_and_keep_lip_motion():
    smile = FACE_SHAPES.index("mouthSmileLeft")
    sizes = [
        shown(["t"], mood=FacialBehaviour("happy", share)).expression[0, smile] for share in face.INTENSITY_STRENGTH
    ]
    assert np.all(np.diff(sizes) > 0.05)
    calm, disgusted = shown(["a", "m", "a"]), shown(["a", "m", "a"], mood=FacialBehaviour("disgusted", 1.0))
    assert disgusted.expression[0, FACE_SHAPES.index("mouthUpperUpLeft")] > 0.15
    assert lip_gap_m(disgusted)[1] < lip_gap_m(calm)[1] + 0.001
    assert np.array_equal(shown(["a"]).expression, shown(["a"], mood=FacialBehaviour("happy", 0.0)).expression)


@pytest.mark.parametrize("emotion", EMOTIONS)
@pytest.mark.parametrize("symbols", [["a", "m", "a"], ["i", "b", "u"], ["s", "p", "i"]])
def test_lips_close_under_the_strongest_emotion(emotion, symbols):
    expression, share = face.EMOTION_EXPRESSIONS[emotion], 1.3
    style = ArticulationStyle(jaw_scale=expression.jaw_scale, jaw_rest_rad=share * expression.jaw_rest_rad)
    calm, felt = shown(symbols), shown(symbols, style, FacialBehaviour(emotion, share))
    assert lip_gap_m(felt)[1] < lip_gap_m(calm)[1] + 0.0005
    assert lip_gap_m(felt)[0] > lip_gap_m(felt)[1] + 0.002, "and the vowel before them is open"


def resting_mm(emotion):
    """Displacement of each landmark from a neutral face, in silence."""
    expression = face.EMOTION_EXPRESSIONS[emotion]
    silent = mouth_motion((), np.zeros(1), ArticulationStyle(jaw_rest_rad=expression.jaw_rest_rad))
    weights = face.expression_weights(FacialBehaviour(emotion, 1.0), silent, np.zeros(1), np.ones(1))
    still, rest = np.zeros((1, 3)), np.zeros((1, 2, 3))
    felt = Motion.of(25.0, still, rest, jaw=silent.jaw, expression=weights, expression_names=FACE_SHAPES)
    moved = motion_landmarks(felt)[0] - motion_landmarks(Motion.of(25.0, still, rest, expression_names=FACE_SHAPES))[0]
    return dict(zip(LANDMARK_NAMES, 1000.0 * moved, strict=True))


def test_full_emotions_are_as_large_as_measured_movements():
    """Ranges of Jorge et al. 2012 (12 people, mean and one SD): smile, raised brows, frown."""
    happy, surprised, angry, contempt = map(resting_mm, ("happy", "surprised", "angry", "contempt"))
    assert 6.45 <= np.linalg.norm(happy["left_mouth_corner"]) <= 12.11
    assert 6.00 <= surprised["left_brow_outer"][1] <= 13.08
    assert 4.16 <= -angry["left_brow_inner"][1] <= 10.85
    assert np.linalg.norm(contempt["left_mouth_corner"]) > 20 * np.linalg.norm(contempt["right_mouth_corner"])
    assert happy["left_eye_lower_inner"][1] > 1.5, "a smile reaches the eyes"


def test_brows_rise_and_come_back():
    raises = (BrowRaise(1.0, 0.2, 0.1, 0.3, 0.5), BrowRaise(1.2, 0.2, 0.1, 0.3, 0.3))
    up = face.brow_height(raises, np.array([0.9, 1.0, 1.1, 1.25, 1.9]))
    assert up == pytest.approx([0.0, 0.0, 0.25, 0.5, 0.0], abs=1e-9)


def test_brows_prefer_accents_and_questions_weakly():
    def count(annotation):
        return np.mean([len(sample_brow_raises(annotation, 1.0, 10.0, np.random.default_rng(i))) for i in range(200)])

    vowels = tuple(Phoneme(i * 0.5, i * 0.5 + 0.1, "a", True, prominence=1.0) for i in range(16))
    flat = tuple(replace(vowel, prominence=0.0) for vowel in vowels)
    assert count(Annotation(phonemes=flat)) < 0.6
    assert 2.5 < count(Annotation(phonemes=vowels)) < 6
    asked, told = (count(Annotation(sentences=(Span(0.0, 4.0, kind),))) for kind in ("question", "statement"))
    assert 0.3 < asked - told < 0.6
