"""The face in an animation: combined with blinks and lids at any rate, replaced, switched off; rejected input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from model_conf import compose

from talkingeyes.animation import face as faces_of
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.blink_sampling import emotional_blinks
from talkingeyes.animation.controls import Controls
from talkingeyes.animation.face import FaceAnimator, emotion_lid_closure, interpolate_pchip, with_face
from talkingeyes.animation.model_file import find_face_model, parts_title
from talkingeyes.animation.part_overrides import PartOverrides
from talkingeyes.audio.encoder import EmbedSettings
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples, Samples
from talkingeyes.head.anny import anny_head
from talkingeyes.head.posing import expression_shape_names
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import FaceStyle, StyleKey, StyleVocabulary
from talkingeyes.synthesis.emotion import EMOTION_FACTORS
from talkingeyes.training.motion_generators import TrainedGenerator

FPS, FRAMES = 25.0, 100
NAMES = expression_shape_names(anny_head())
SOUND = np.zeros(16000 * FRAMES // 25, np.float32)


class Encoder:
    """Speech encoder that returns the features of silence."""

    channels = ("one",)

    def __call__(self, sound, fps):
        return np.zeros((round(len(sound) / 16000 * fps), 1), np.float32)


class Heads(TrainedGenerator):
    """Generator of drifting heads and eyes, by seed."""

    def sample(self, speech):
        frames, seeds = len(speech.embedding), speech.seeds
        wander = [np.cumsum(np.random.default_rng(seed).normal(0, 0.004, (frames, 3)), axis=0) for seed in seeds]
        head = np.stack(wander)
        gaze = np.zeros((len(seeds), frames, 2, 3))
        gaze[:, frames // 2 :, :, 1] = 0.2
        return Samples(speech.fps, head, gaze)


class Faces:
    """Generator of noise faces by seed, with a constant squint."""

    basis = FaceBasis("anny", NAMES)
    vocabulary = StyleVocabulary(("ann", "ben"))

    def generate(self, embedding, style, seeds, fps):
        frames = len(embedding)
        drawn = np.stack([np.random.default_rng(seed).uniform(0, 0.5, (frames, len(NAMES) + 3)) for seed in seeds])
        drawn[..., NAMES.index("eyeSquintLeft")] = 0.4
        return FaceSamples(fps, drawn[..., -3:], drawn[..., :-3], NAMES, "anny")


ENCODER = Encoder()
WITH_FACE = Animator(ENCODER, Heads(), FPS, face=FaceAnimator(Faces(), ENCODER, FPS))
WITHOUT_FACE = replace(WITH_FACE, face=None)


def perform(controls=None, animator=WITH_FACE, samples=1, seed=3, fps=FPS):
    return animator.perform(SOUND, samples, seed, fps, controls or Controls())


def felt(emotion, intensity=3, speaker=None):
    return (StyleKey(0.0, FaceStyle(speaker, emotion, intensity)),)


def test_one_speech_and_one_seed_give_a_complete_motion():
    one, many = perform(), perform(samples=3)
    motion = one[0].motion
    assert motion.expression_names == NAMES
    assert np.ptp(motion.jaw) > 0.1
    assert np.ptp(motion.head) > 0.01
    assert len(one[0].events.blinks) > 0
    for name in ("head", "gaze", "lid", "jaw", "expression"):
        assert np.array_equal(getattr(motion, name), getattr(many[0].motion, name)), f"{name}: alone or with others"
        assert not np.array_equal(many[0].motion.expression, many[1].motion.expression)
    assert not np.array_equal(perform(seed=4)[0].motion.jaw, motion.jaw)


def test_face_does_not_change_head_gaze_and_blinks():
    whole, bare = perform()[0], perform(animator=WITHOUT_FACE)[0]
    for name in ("head", "gaze", "lid"):
        assert np.array_equal(getattr(whole.motion, name), getattr(bare.motion, name)), name
    assert whole.events == bare.events
    assert bare.motion.expression_names == ()


def test_a_blink_closes_lids_that_squint_or_are_raised():
    motion = perform(Controls(face=felt("surprised")))[0].motion
    shut = motion.lid.mean(axis=1) > 0.99
    assert shut.any(), "raised lids still close"
    squint = motion.expression[:, NAMES.index("eyeSquintLeft")]
    assert squint[shut].max() < 0.01
    quiet = np.isclose(motion.lid, -0.3).all(axis=1)  # the rule for strong surprise
    assert quiet.mean() > 0.5
    assert np.allclose(squint[quiet], 0.4)
    brows = motion.expression[:, NAMES.index("browInnerUp")]
    assert brows[shut].max() > 0, "brows are the face model's own"


def test_blinks_follow_the_emotion_that_changes_along_a_clip():
    scared, calm, sad = (FaceStyle(None, *each) for each in (("fear", 3), ("neutral", 0), ("sad", 3)))
    times = np.arange(0.0, 10.0, 0.04)
    assert emotional_blinks((StyleKey(0.0, calm),), times) == 1.0
    assert emotional_blinks((StyleKey(0.0, scared),), times) == pytest.approx(EMOTION_FACTORS["fear"].blinks)
    half = emotional_blinks((StyleKey(0.0, scared), StyleKey(4.75, calm)), times)
    assert half == pytest.approx(EMOTION_FACTORS["fear"].blinks ** 0.5, rel=0.01)
    fast, slow = (
        sum(len(each.events.blinks) for each in perform(Controls(face=(StyleKey(0.0, style),)), samples=12))
        for style in (scared, sad)
    )
    assert fast > 1.2 * slow


def test_an_emotion_may_change_along_a_clip():
    keys = (*felt("neutral", 0), StyleKey(2.0, FaceStyle(None, "surprised", 3)))
    lid = emotion_lid_closure(keys, np.array([0.0, 1.9, 2.25, 3.0]))
    assert np.allclose(lid, [0.0, 0.0, -0.15, -0.3])
    assert np.allclose(emotion_lid_closure(keys[::-1], np.array([0.0, 3.0])), [0.0, -0.3]), (
        "in whatever order they are given"
    )


def test_other_frame_rates_interpolate_frames_of_the_model():
    slow, fast = perform()[0].motion, perform(fps=75.0)[0].motion
    assert len(fast) == 3 * len(slow)
    assert np.allclose(fast.jaw[::3], slow.jaw)
    values = np.array([[0.0], [0.0], [1.0], [1.0]])
    course = interpolate_pchip(values, FPS, np.arange(12) / 75.0)[:, 0]
    assert (np.diff(course) >= 0).all()
    assert course.min() == 0.0
    assert course.max() == 1.0, "lips that meet stay together: no overshoot"
    assert np.allclose(interpolate_pchip(np.ones((1, 2)), FPS, np.arange(3) / 75.0), 1.0)


def test_long_speech_is_made_of_pieces_without_seams(monkeypatch):
    embedding, style = np.zeros((FRAMES, 1), np.float32), felt("neutral", 0)
    whole = WITH_FACE.face.perform(embedding, style, 3, 2)
    monkeypatch.setattr(faces_of, "CHUNK_S", 1.6)
    monkeypatch.setattr(faces_of, "OVERLAP_S", 0.8)
    monkeypatch.setattr(faces_of, "CROSSFADE_S", 0.4)
    pieces = WITH_FACE.face.perform(embedding, style, 3, 2)
    assert pieces.jaw.shape == whole.jaw.shape
    assert pieces.expression.shape == whole.expression.shape
    for start in (20, 40, 60):
        following = WITH_FACE.face._chunk(embedding[start : start + 40], style, (3, 2, start // 20))
        assert np.array_equal(pieces.jaw[:, start + 15 : start + 25], following.jaw[:, 15:25]), "after its seam its own"
    still = replace(whole, jaw=np.zeros((2, 40, 3)), expression=np.zeros((2, 40, len(NAMES))))
    one, other = still, replace(still, jaw=np.ones((2, 40, 3)))
    course = faced_over(one, other)
    assert (np.diff(course) >= 0).all()
    assert np.diff(course).max() < 0.11, "faded, not cut"
    assert (course[:20].max(), course[-20:].min()) == (0.0, 1.0)


def faced_over(one, other):
    """Cross-fade of the jaw between two pieces, from frame 20, over an overlap of 20 frames."""
    return faces_of.crossfade(one, other, 20, 20).jaw[0, :, 0]


@pytest.mark.parametrize("fps", [FPS, 60.0])
def test_parts_are_switched_off(fps):
    own = perform(fps=fps)[0]
    still = perform(Controls(parts=PartOverrides(("head", "gaze", "blinks", "face"))), fps=fps)[0]
    assert not still.motion.head.any()
    assert not still.motion.gaze.any()
    assert not still.motion.lid.any()
    assert not still.motion.jaw.any()
    assert still.motion.expression_names == ()
    assert still.events.saccades == still.events.blinks == ()
    headless = perform(Controls(parts=PartOverrides(("head",))), fps=fps)[0].motion
    space, own_space = (rotation.gaze_in_space(each.head, each.gaze) for each in (headless, own.motion))
    assert np.allclose(space, own_space, atol=1e-6), "gaze in space stays"
    assert np.array_equal(headless.jaw, own.motion.jaw)


def test_parts_are_replaced_from_other_motions():
    donor = perform(seed=9)[0].motion
    parts = PartOverrides(replacements={"head": donor, "face": donor, "blinks": donor})
    own, recast = perform()[0], perform(Controls(parts=parts))[0]
    assert np.allclose(recast.motion.head, donor.head)
    for name in ("jaw", "expression", "lid"):
        assert np.array_equal(getattr(recast.motion, name), getattr(donor, name)), name
    space, own_space = (rotation.gaze_in_space(each.head, each.gaze) for each in (recast.motion, own.motion))
    # Blinks hold gaze, and those of the model are not sampled here: in other frames gaze is the same.
    open_eyes = own.motion.lid.max(axis=1) == 0
    assert np.allclose(space[open_eyes], own_space[open_eyes], atol=1e-6)
    eyes = perform(Controls(parts=PartOverrides(replacements={"gaze": donor})))[0]
    assert np.array_equal(eyes.motion.gaze, donor.gaze)
    assert len(eyes.events.saccades) >= 1, "found in the eyes that are shown"
    at_60 = perform(Controls(parts=PartOverrides(replacements={"face": donor})), fps=60.0)[0].motion
    assert len(at_60) == FRAMES * 60 // 25
    with pytest.raises(InputError, match=r"^replace face: should last as long as the speech, 4\.00 s, got 2\.00 s$"):
        perform(Controls(parts=PartOverrides(replacements={"face": donor.cut(0, 50)})))


def test_missing_parts_are_one_line_errors():
    with pytest.raises(InputError, match=r"^speaker: should be one of ann, ben or none for their mean, got carl$"):
        perform(Controls(face=felt("happy", 2, "carl")))
    with pytest.raises(InputError, match=r"without a face model \(probtalk3d\), got one of them$"):
        perform(Controls(face=felt("happy")), WITHOUT_FACE)
    with pytest.raises(InputError, match=r"^parts: should be among head, gaze, blinks, face, got ears$"):
        PartOverrides(("ears",))
    with pytest.raises(InputError, match=r"^parts: head should be replaced or switched off, got both$"):
        PartOverrides(("head",), {"head": Motion.of(FPS, np.zeros((1, 3)), np.zeros((1, 2, 3)))})
    with pytest.raises(InputError, match="at least one style"):
        Controls(face=())


def test_face_model_is_found_next_to_the_other_model(tmp_path, monkeypatch):
    for name in ("talkingeyes", "probtalk3d"):
        (tmp_path / name).mkdir()
    assert find_face_model(tmp_path / "talkingeyes") == tmp_path / "probtalk3d"
    assert find_face_model(tmp_path / "probtalk3d") is None
    monkeypatch.chdir(tmp_path)
    assert parts_title(Path("talkingeyes")) == "head and gaze: talkingeyes, face: probtalk3d"
    monkeypatch.chdir(tmp_path / "talkingeyes")
    assert find_face_model(Path()) == tmp_path / "probtalk3d"
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "talkingeyes").symlink_to(tmp_path / "talkingeyes")
    (tmp_path / "linked" / "probtalk3d").symlink_to(tmp_path / "elsewhere")
    assert find_face_model(tmp_path / "linked" / "talkingeyes") == tmp_path / "linked" / "probtalk3d", (
        "links stay links"
    )
    (tmp_path / "probtalk3d").rmdir()
    assert find_face_model(tmp_path / "talkingeyes") is None
    (tmp_path / "talkingeyes" / "config.json").write_text('{"model": {"parts": ["head", "gaze"]}}')
    with pytest.raises(InputError, match="should be a face model, such as probtalk3d"):
        FaceAnimator.load(tmp_path / "talkingeyes", EmbedSettings.model_validate(compose()["embed"]), ENCODER)


def test_face_model_with_other_encoder_encodes_the_sound():
    other = Encoder()
    animator = replace(WITH_FACE, face=FaceAnimator(Faces(), other, FPS))
    assert np.array_equal(perform(animator=animator)[0].motion.jaw, perform()[0].motion.jaw)
    with pytest.raises(InputError, match=r"^face: should come with the sound of the speech itself"):
        animator.generate_from_embedding(ENCODER(SOUND, FPS), 1, 3, FPS)


def test_face_keeps_its_own_frame_rate():
    slow = replace(WITH_FACE, face=FaceAnimator(Faces(), ENCODER, FPS / 2))
    jaw = perform(animator=slow)[0].motion.jaw
    own = slow.face.perform(ENCODER(SOUND, FPS / 2), Controls().face, 3, 1)
    assert len(jaw) == FRAMES
    assert np.allclose(jaw[::2], own.jaw[0]), "frames of the face lie at its own times"


def test_with_face_needs_no_names_of_its_own():
    motion = Motion.of(FPS, np.zeros((3, 3)), np.zeros((3, 2, 3)))
    faces = FaceSamples(FPS, np.zeros((1, 3, 3)), np.full((1, 3, 1), 2.0), ("mouthPucker",), "anny")
    shown = with_face(motion, faces, 0, felt("neutral", 0))
    assert shown.expression.max() == 1.0, "weights of the open head lie between 0 and 1"
