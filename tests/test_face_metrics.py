"""Metrics of a talking face on artificial cases with known results."""

from dataclasses import replace

import numpy as np
import pytest

from talkingeyes.audio.annotation import Annotation, Phoneme
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.papers import probtalk3d_surface as surfaces
from talkingeyes.evaluation.papers.probtalk3d_articulation import articulation, best_correlation
from talkingeyes.evaluation.papers.probtalk3d_metrics import (
    EmotionClassifier,
    FaceCase,
    balanced_accuracy,
    crop_faces,
    emotion_features,
    face_metrics,
    summarise_face,
)
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface
from talkingeyes.evaluation.papers.probtalk3d_vertices import DynamicsAccumulator, split_half_diversity, vertex_errors
from talkingeyes.head.anny import anny_head
from talkingeyes.head.model import Landmarks
from talkingeyes.head.posing import expression_shape_names, motion_to_pose
from talkingeyes.head.skinning import posed_vertices

FPS, FRAMES = 25.0, 30
NAMES = expression_shape_names(anny_head())
EVERY = np.ones(FRAMES, bool)
SETTINGS = BootstrapSettings(n_resamples=50, confidence_level=0.95, seed=0)


@pytest.fixture(scope="module")
def surface():
    return FaceSurface(anny_head())


def faces(*samples, jaw_rad=0.0, frames=FRAMES):
    """A sample for each mapping of blend shapes to weights (constant or per frame)."""
    expression = np.zeros((len(samples), frames, len(NAMES)))
    for sample, weights in enumerate(samples):
        for name, weight in weights.items():
            expression[sample, :, NAMES.index(name)] = weight
    jaw = np.zeros((len(samples), frames, 3))
    jaw[..., 0] = jaw_rad
    return FaceSamples(FPS, jaw, expression, NAMES, "anny")


def moved_mm(surface, name, region):
    """Displacement of each vertex of a region by a blend shape at weight 1."""
    head = surface.model
    return 1000 * np.linalg.norm(head.expression[head.shape(name)][surface.regions[region]], axis=-1)


def test_displacements_are_those_of_the_posed_head(surface):
    rng = np.random.default_rng(0)
    shown = faces({})
    shown = replace(shown, expression=rng.uniform(0, 1, shown.expression.shape))
    shown.jaw[..., :2] = rng.uniform(-0.2, 0.3, (1, FRAMES, 2))
    motion = Motion.of(
        FPS,
        np.zeros((FRAMES, 3)),
        np.zeros((FRAMES, 2, 3)),
        jaw=shown.jaw[0],
        expression=shown.expression[0],
        expression_names=NAMES,
        head_model="anny",
    )
    neutral = Motion.of(FPS, np.zeros((1, 3)), np.zeros((1, 2, 3)))
    head = surface.model
    expected = 1000 * (
        posed_vertices(head, motion_to_pose(head, motion)) - posed_vertices(head, motion_to_pose(head, neutral))
    )
    for region, vertices in surface.regions.items():
        found = surface.displacement_mm(shown, 0, slice(None), region)
        assert np.abs(found - expected[:, vertices]).max() < 2e-3


def test_errors_of_one_shape_are_what_the_shape_moves(surface):
    found = vertex_errors(surface, faces({}), faces({"mouthPucker": 0.5}), [0], EVERY)
    assert found.mve == pytest.approx(0.5 * moved_mm(surface, "mouthPucker", "face").mean(), rel=1e-4)
    greatest = 0.5 * moved_mm(surface, "mouthPucker", "lips").max()
    assert found.lve == pytest.approx(greatest, rel=1e-4)
    assert found.lve_squared == pytest.approx(greatest**2, rel=1e-4)
    brows = vertex_errors(surface, faces({}), faces({"browInnerUp": 1.0}), [0], EVERY)
    assert brows.lve < 0.01 < brows.mve, "brows are no lips"


def test_the_mean_and_the_best_of_samples(surface):
    truth, samples = (
        faces({"mouthFunnel": 0.4}),
        faces({"mouthFunnel": 0.2}, {"mouthFunnel": 0.6}, {"mouthFunnel": 0.9}),
    )
    reach = moved_mm(surface, "mouthFunnel", "lips").max()
    two = vertex_errors(surface, truth, samples, [0, 1], EVERY)
    assert two.mee == pytest.approx(0.0, abs=1e-4)
    assert two.ce == pytest.approx(0.2 * reach, rel=1e-3)
    off = vertex_errors(surface, truth, samples, [2, 1], EVERY)
    assert off.lve == pytest.approx(0.5 * reach, rel=1e-3), "of the first sample"
    assert off.ce == pytest.approx(0.2 * reach, rel=1e-3), "of the best"
    assert off.ce_squared == pytest.approx((0.2 * reach) ** 2, rel=1e-3)
    assert off.mee == pytest.approx(0.35 * reach, rel=1e-3)


def test_the_best_sample_is_chosen_by_clip_not_by_frame(surface):
    early = np.where(np.arange(FRAMES) < FRAMES / 2, 0.0, 0.5)
    samples = faces({"mouthFunnel": early}, {"mouthFunnel": 0.5 - early})
    found = vertex_errors(surface, faces({}), samples, [0, 1], EVERY)
    assert found.ce == pytest.approx(0.25 * moved_mm(surface, "mouthFunnel", "lips").max(), rel=1e-3)


def test_invalid_frames_do_not_count(surface):
    weight = np.where(np.arange(FRAMES) < 10, 1.0, 0.0)
    found = vertex_errors(surface, faces({}), faces({"mouthFunnel": weight}), [0], np.arange(FRAMES) >= 10)
    assert (found.frames, found.lve, found.mve) == (FRAMES - 10, 0.0, 0.0)


def test_dynamics_of_the_upper_face_have_a_sign(surface):
    waves = np.sin(np.arange(FRAMES))
    lively, dull = faces({"browInnerUp": 0.5 + 0.4 * waves}), faces({"browInnerUp": 0.5 + 0.1 * waves})
    duller, livelier = (vertex_errors(surface, *pair, [0], EVERY) for pair in ((lively, dull), (dull, lively)))
    assert duller.fdd_signed > 0 > livelier.fdd_signed
    assert duller.fdd_signed == pytest.approx(-livelier.fdd_signed)
    assert duller.fdd_absolute == livelier.fdd_absolute == duller.fdd_signed
    moved = surface.displacement_mm(lively, 0, slice(None), "upper")
    expected = np.square(moved).sum(-1).std(axis=0).mean()
    dynamics = DynamicsAccumulator()
    dynamics.add(moved[:11])
    dynamics.add(moved[11:])
    assert dynamics.deviation() == pytest.approx(expected, rel=1e-3)
    mouth = faces({"mouthLowerDownLeft": 0.5 + 0.4 * waves})
    assert vertex_errors(surface, mouth, faces({}), [0], EVERY).fdd_absolute < 0.01 * duller.fdd_absolute


def test_block_size_does_not_matter(surface, monkeypatch):
    rng = np.random.default_rng(0)
    shown = replace(faces({}, {}), expression=rng.uniform(0, 1, (2, FRAMES, len(NAMES))))
    whole = vertex_errors(surface, faces({}), shown, [0, 1], EVERY)
    variety = split_half_diversity(surface, shown, np.random.default_rng(0))
    monkeypatch.setattr(surfaces, "BLOCK_FRAMES", 7)
    for name, value in vars(vertex_errors(surface, faces({}), shown, [0, 1], EVERY)).items():
        assert value == pytest.approx(getattr(whole, name), rel=1e-4), name
    assert split_half_diversity(surface, shown, np.random.default_rng(0)) == pytest.approx(variety, rel=1e-4)


def test_diversity_pairs_two_halves(surface):
    reach = moved_mm(surface, "mouthPucker", "face").mean()
    rng = np.random.default_rng(0)
    assert split_half_diversity(surface, faces({}, {"mouthPucker": 0.3}), rng) == pytest.approx(0.3 * reach, rel=1e-3)
    assert split_half_diversity(surface, faces(*[{"mouthPucker": 0.3}] * 10), rng) == 0.0
    assert np.isnan(split_half_diversity(surface, faces({}), rng))
    # With three equal samples and a different one, one of two pairs differs in every split.
    odd = faces({}, {}, {}, {"mouthPucker": 1.0})
    assert split_half_diversity(surface, odd, rng) == pytest.approx(reach / 2, rel=1e-3)


ANNOTATION = Annotation(phonemes=(Phoneme(0.2, 0.3, "b"), Phoneme(0.6, 0.8, "aa"), Phoneme(1.0, 1.1, "p")))


def opened(*closed_s):
    """An open jaw, with lips closed around some times."""
    times_s = np.arange(FRAMES) / FPS
    closes = np.max([np.abs(times_s - moment) < 0.05 for moment in closed_s], axis=0) if closed_s else np.zeros(FRAMES)
    return faces({"mouthClose": 0.2 / anny_head().jaw_open_rad * closes}, jaw_rad=0.2)


def test_lips_close_on_bilabials(surface):
    silence = np.zeros(round(16000 * FRAMES / FPS))
    both, one, none = (articulation(surface, opened(*at), ANNOTATION, silence) for at in ((0.25, 1.05), (0.25,), ()))
    assert (both.bilabials_closed, one.bilabials_closed, none.bilabials_closed) == (1.0, 0.5, 0.0)
    assert both.bilabial_gap < one.bilabial_gap < none.bilabial_gap
    assert both.vowel_gap == pytest.approx(none.vowel_gap), "an open vowel elsewhere"
    shut = articulation(surface, faces({}), ANNOTATION, silence)
    assert (shut.bilabials_closed, shut.vowel_gap) == (1.0, 0.0), "a shut mouth is told by its vowels"
    assert np.isnan(articulation(surface, opened(), Annotation(), silence).bilabials_closed)


def test_the_jaw_follows_the_envelope_with_a_lag():
    rng = np.random.default_rng(0)
    envelope = rng.uniform(size=200)
    assert best_correlation(np.roll(envelope, 2), envelope, FPS) == pytest.approx(1.0)
    assert best_correlation(np.roll(envelope, 20), envelope, FPS) < 0.4, "too late"
    assert best_correlation(-envelope, envelope, FPS) < 0.4
    assert best_correlation(np.zeros(200), envelope, FPS) == 0.0


def felt(emotion, count, seed):
    """Faces that raise their brows or smile, with varying strength."""
    rng = np.random.default_rng(seed)
    names = {"surprised": ("browInnerUp", "browOuterUpLeft"), "happy": ("mouthSmileLeft", "mouthSmileRight")}[emotion]
    return faces(*[dict.fromkeys(names, rng.uniform(0.3, 0.9)) | {"mouthPucker": rng.uniform()} for _ in range(count)])


def test_emotions_are_classified(surface):
    kinds = ("happy", "surprised")
    seen = np.concatenate([emotion_features(surface, felt(kind, 12, seed)) for seed, kind in enumerate(kinds)])
    classifier = EmotionClassifier.fit(seen, ["happy"] * 12 + ["surprised"] * 12)
    for seed, kind in enumerate(kinds, start=10):
        assert classifier.predict(emotion_features(surface, felt(kind, 5, seed))) == [kind] * 5
    hits = np.array([1.0, 1.0, 1.0, 0.0])
    assert balanced_accuracy(hits, ["happy"] * 3 + ["surprised"]) == 0.5, (
        "each emotion counts alike, however often it comes"
    )


def test_a_row_compares_real_motion_with_itself_and_a_model_with_truth(surface):
    classifier = EmotionClassifier.fit(np.eye(2, 2 * 3 * len(anny_head().landmarks.names)), ["happy", "neutral"])
    truth, sound = faces({"mouthFunnel": 0.4}, {"mouthFunnel": 0.6}), np.zeros(16000 * FRAMES // 25)
    own = FaceCase(truth, True, truth, EVERY, ANNOTATION, sound, (0,))
    model = replace(own, samples=faces({"mouthFunnel": 0.4}, {"mouthFunnel": 0.4}), includes_reference=False)
    of_truth, of_model = (face_metrics(surface, classifier, case) for case in (own, model))
    assert of_truth.errors.lve > 0, "its second take against its first"
    assert of_model.errors.lve == 0.0
    table = summarise_face([of_model, of_model], SETTINGS)
    assert (table["lve"].value, table["diversity"].value, table["diversity_ratio"].value) == (0.0, 0.0, 0.0)
    assert summarise_face([of_truth], SETTINGS)["diversity_ratio"].value == 1.0
    alone = crop_faces(faces({}), 20)
    lonely = face_metrics(surface, classifier, FaceCase(alone, True, alone, EVERY[:20], ANNOTATION, sound, (0,)))
    assert lonely.errors is None
    assert "lve" not in summarise_face([lonely], SETTINGS)
    assert "diversity" not in summarise_face([lonely], SETTINGS)


def test_frames_weigh_in_mve_and_lve_and_clips_in_the_others(surface):
    classifier = EmotionClassifier.fit(np.eye(2, 2 * 3 * len(anny_head().landmarks.names)), ["happy", "neutral"])
    sound, figures = np.zeros(16000), []
    for weight, frames in ((0.0, 10), (1.0, 30)):
        pair = faces({}, frames=frames), faces({"mouthFunnel": weight}, frames=frames)
        case = FaceCase(pair[1], False, pair[0], np.ones(frames, bool), Annotation(), sound, (0,))
        figures.append(face_metrics(surface, classifier, case))
    table, reach = summarise_face(figures, SETTINGS), moved_mm(surface, "mouthFunnel", "lips").max()
    assert table["lve"].value == pytest.approx(0.75 * reach, rel=1e-3)
    assert table["ce"].value == pytest.approx(0.5 * reach, rel=1e-3)


def test_other_head_is_one_line_error(surface):
    with pytest.raises(InputError, match=r"^face: should be of the head anny, got flame$"):
        vertex_errors(surface, faces({}), replace(faces({}), head_model="flame"), [0], EVERY)
    with pytest.raises(InputError, match="should have the landmark nose_middle, got none"):
        _ = FaceSurface(replace(anny_head(), landmarks=Landmarks((), np.zeros((0, 3), int), np.zeros((0, 3))))).regions
