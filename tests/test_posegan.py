"""Personal head motion: six-component poses, models of the head alone, adversarial training, PGFace, metrics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from model_conf import compose, model_section
from toy import clip

from pipelines.results.talking_face import talking_face
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.poses import (
    PoseRecording,
    gaussian_smooth,
    head_rotations,
    resample_cubic,
    resample_linear,
    to_poses,
)
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.evaluation.papers.posegan_classifiers import (
    ClassifierSettings,
    LabelledWindows,
    PoseWindows,
    SVMSettings,
    acceptance_rates,
    blend_styles,
    classifier_scores,
    correlations,
    pose_windows,
    sliding_windows,
    train_classifier,
)
from talkingeyes.evaluation.papers.posegan_metrics import _reference_free_metrics
from talkingeyes.evaluation.papers.posegan_movement import (
    clip_difference,
    distances,
    jitter,
    measure_style,
    seam_speed_ratio,
    style_distance,
)
from talkingeyes.head.anny import anny_head
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.sag import FaceSurface
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.models.head.discriminator import Discriminator, DiscriminatorContext, DiscriminatorSettings
from talkingeyes.models.head.pose_generator import PoseInputs
from talkingeyes.training.checkpoint import save
from talkingeyes.training.loop import AdversarialTask, LoopSettings, train
from talkingeyes.training.motion_generators import (
    PoseModelGenerator,
    load_generator,
    pose_config,
)
from talkingeyes.training.pgface_task import PGFaceTask, PGFaceTaskSettings, ShapeRecording
from talkingeyes.training.pose_task import PoseTask, PoseTaskSettings, movement_ratios
from talkingeyes.training.resume import ResumeFile

CHANNELS = 6
HEADS = ("head_mean", "head_random", "head_similar", "head_cnn", "head_vae", "head_vqvae", "posegan")
SAME_FOR_ALL_SEEDS = ("head_mean", "head_similar", "head_cnn")
SMALL = {
    "cnn": {"width": 8, "layers": 2},
    "vae": {"width": 8, "layers": 1},
    "vqvae": {
        "width": 8,
        "layers": 1,
        "quantiser": {
            "kind": "codebook",
            "codes": 8,
            "width": 4,
            "commitment": 0.25,
            "decay": 0.95,
            "restart_below": 0.05,
        },
        "transformer": {"width": 8, "layers": 1, "heads": 2, "dropout": 0.0, "lookback": 8},
    },
    "posegan": {"width": 16, "layers": 1, "levels": 3, "window": 64},
}


def recordings(frames: int = 150, clips: int = 4) -> list[PoseRecording]:
    """Two speakers: one with slow, large motion, one with fast, small motion; uninformative speech."""
    rng = np.random.default_rng(3)
    made = []
    for index in range(clips):
        who = index % 2
        hz, size = ((0.3, 0.10), (2.0, 0.03))[who]
        phase = rng.uniform(0, 6, 6)
        pose = size * np.sin(2 * np.pi * hz * np.arange(frames)[:, None] / 30 + phase)
        speech = rng.standard_normal((frames, CHANNELS)).astype(np.float32)
        made.append(PoseRecording(clip(f"c{index}", "ab"[who]), speech, pose.astype(np.float32), np.full(6, 0.1)))
    return made


def normaliser() -> Normaliser:
    names = tuple(str(index) for index in range(CHANNELS))
    return Normaliser(names, np.zeros(CHANNELS, np.float32), np.ones(CHANNELS, np.float32))


def settings(name: str, **changes: Any) -> PoseTaskSettings:
    """A small version of a model of conf/."""
    node = model_section(name)
    node["speech"] |= {"width": 8}
    node["head"] |= SMALL.get(node["head"]["kind"], {})
    node["windows"] = {"frames": 64, "hop": 5}
    if node["loop"]:
        node["loop"] |= {"steps": 4, "batch": 4, "validate_every": 2}
    if node["discriminator"]:
        node["discriminator"] |= {"width": 8, "layers": 3}
    return PoseTaskSettings.model_validate({**node, **changes})


def task(name: str, seed: int = 0, **changes: Any) -> PoseTask:
    found = recordings()
    made = PoseTask(settings(name, **changes), seed, found, found[:2], normaliser())
    made.module.eval()
    return made


class TestPoses:
    def test_six_numbers_and_back(self) -> None:
        rng = np.random.default_rng(0)
        head, shift = 0.4 * rng.standard_normal((50, 3)), rng.standard_normal((50, 3))
        pose = to_poses(head, shift)
        np.testing.assert_allclose(
            rotation.rotvec_to_matrix(head_rotations(pose)), rotation.rotvec_to_matrix(head), atol=1e-9
        )
        np.testing.assert_array_equal(pose[:, 3:], shift)

    def test_pitch_is_up_and_yaw_to_the_left(self) -> None:
        pose = to_poses(np.array([[-0.2, 0.0, 0.0], [0.0, 0.3, 0.0]]), np.zeros((2, 3)))
        np.testing.assert_allclose(pose[:, :3], [[0.2, 0.0, 0.0], [0.0, 0.3, 0.0]], atol=1e-12)

    def test_the_filter_keeps_constants_and_damps_what_is_fast(self) -> None:
        times = np.arange(300)[:, None] / 30
        np.testing.assert_allclose(gaussian_smooth(np.full((9, 6), 2.0), 1.5, 5), 2.0)
        slow, fast = (np.sin(2 * np.pi * hz * times) * np.ones(6) for hz in (0.3, 8.0))
        assert gaussian_smooth(slow, 1.5, 5).std() > 0.98 * slow.std()
        assert gaussian_smooth(fast, 1.5, 5).std() < 0.15 * fast.std()

    def test_resampling_to_30_and_back(self) -> None:
        slow = np.sin(np.arange(100)[:, None] / 12) * np.ones(6)
        there = resample_cubic(slow, 25.0, 30.0)
        assert len(there) == 119
        back = resample_cubic(there, 30.0, 25.0)
        np.testing.assert_allclose(back, slow[: len(back)], atol=1e-3)
        assert resample_linear(slow, 25.0, 30.0).shape == there.shape


@pytest.mark.parametrize("name", HEADS)
class TestHeads:
    """Contract of all generators of head poses."""

    def test_any_length_one_seed_alone_or_with_others(self, name: str) -> None:
        network = task(name).module
        style = network.style_of("a")
        for frames in (1, 2, 7, 150):
            speech = np.random.default_rng(frames).standard_normal((frames, CHANNELS)).astype(np.float32)
            many, one = network.sample(speech, [3, 4], style), network.sample(speech, [4], style)
            assert many.shape == (2, frames, 6)
            assert np.isfinite(many).all()
            np.testing.assert_allclose(many[1], one[0], atol=1e-5)
        if name not in SAME_FOR_ALL_SEEDS:
            first, second = network.sample(speech, [0, 1], style)
            assert np.abs(first - second).max() > 1e-5

    def test_terms_cover_the_weights(self, name: str) -> None:
        made = task(name)
        if made.settings.loop is None:
            return
        loss_terms = made.losses(1)
        assert set(made.settings.weights) <= set(loss_terms)
        assert all(torch.isfinite(each) for each in loss_terms.values())

    def test_a_folder_gives_the_same_head(self, name: str, tmp_path: Path) -> None:
        made = task(name)
        save(tmp_path, made.module.state_dict(), pose_config(made.settings, normaliser(), made.module))
        loaded = load_generator(tmp_path)
        assert isinstance(loaded, PoseModelGenerator)
        speech = np.random.default_rng(0).standard_normal((80, CHANNELS)).astype(np.float32)
        ours = PoseModelGenerator(made.module).generate(speech, [1, 2], 25.0)
        assert ours.head.shape == (2, 80, 3)
        np.testing.assert_array_equal(ours.head, loaded.generate(speech, [1, 2], 25.0).head)


def test_a_pose_model_of_an_old_configuration_is_a_one_line_error(tmp_path: Path) -> None:
    made = task("head_mean")
    config = pose_config(made.settings, normaliser(), made.module)
    save(tmp_path, made.module.state_dict(), config | {"model": config["model"] | {"prior": 1}})
    with pytest.raises(InputError, match=r"\(model\.prior: .*, got 1\); `make repro`") as error:
        load_generator(tmp_path)
    assert "\n" not in str(error.value)


class TestContest:
    """Adversarial training in the common loop."""

    def test_each_adversarial_step_updates_its_own_weights(self) -> None:
        made = task("posegan")
        assert isinstance(made, AdversarialTask)
        before = {name: value.clone() for name, value in made.module.state_dict().items()}
        train(made, LoopSettings.model_validate({**_loop(made), "steps": 1, "validate_every": 1}), "test")
        after = made.module.state_dict()
        moved = {name for name, value in before.items() if not torch.equal(value, after[name])}
        assert any(name.startswith("discriminator.") for name in moved)
        assert any(name.startswith("head.") for name in moved)

    @pytest.mark.parametrize("conditions", [(), ("speaker",), ("pose", "speech"), ("speaker", "pose", "speech")])
    def test_discriminator_sees_motion_and_its_conditions_alone(self, conditions: tuple[str, ...]) -> None:
        torch.manual_seed(0)
        settings = DiscriminatorSettings.model_validate({"width": 8, "layers": 3, "conditions": conditions})
        discriminator = Discriminator(settings, speakers=2, channels=CHANNELS)
        rng = np.random.default_rng(0)
        pose, speech = (torch.from_numpy(rng.standard_normal((1, 64, each), np.float32)) for each in (6, CHANNELS))
        one, other = torch.eye(2)[:1], torch.eye(2)[1:]

        def score(pose: torch.Tensor, style: torch.Tensor, speech: torch.Tensor) -> np.ndarray:
            return discriminator(pose, DiscriminatorContext(style, speech)).detach().numpy()

        plain = score(pose, one, speech)
        assert not np.allclose(score(pose * 1.5, one, speech), plain, atol=1e-4)
        assert ("speaker" in conditions) != np.allclose(score(pose, other, speech), plain, atol=1e-4)
        assert ("pose" in conditions) != np.allclose(score(pose + 1, one, speech), plain, atol=1e-4)
        assert ("speech" in conditions) != np.allclose(score(pose, one, speech.flip(1)), plain, atol=1e-4)

    def test_discriminator_learns_without_gradient_to_generator(self) -> None:
        made = task("posegan")
        made.losses(1)
        made.discriminator_losses(1)["total"].backward()
        assert all(value.grad is None for name, value in made.module.named_parameters() if "discriminator" not in name)
        discriminator = made.module.discriminator
        assert discriminator is not None
        optimiser = torch.optim.Adam(discriminator.parameters(), 3e-3)
        told = []
        for _ in range(40):
            loss_terms = made.discriminator_losses(1)
            optimiser.zero_grad()
            loss_terms["total"].backward()
            optimiser.step()
            told.append(float((loss_terms["real_probability"] - loss_terms["fake_probability"]).detach()))
        assert told[-1] > told[0] + 0.2

    def test_killed_adversarial_training_ends_in_the_same_weights(self, tmp_path: Path) -> None:
        whole = task("posegan")
        train(whole, LoopSettings.model_validate(_loop(whole)), "whole")

        class Killed(Exception):
            pass

        def kill(step: int, figures: dict[str, float]) -> None:
            raise Killed

        resume = ResumeFile.of(tmp_path / "p", ["test"], [])
        with pytest.raises(Killed):
            part = task("posegan")
            train(part, LoopSettings.model_validate(_loop(part)), "part", on_validation=kill, resume=resume)
        rest = task("posegan")
        train(rest, LoopSettings.model_validate(_loop(rest)), "rest", resume=resume)
        for name, value in whole.module.state_dict().items():
            torch.testing.assert_close(rest.module.state_dict()[name], value, atol=0, rtol=0)


def _loop(made: PoseTask) -> dict[str, Any]:
    assert made.settings.loop is not None
    return made.settings.loop.model_dump()


class TestChaining:
    def test_a_window_starts_at_the_last_pose_only_when_anchored(self) -> None:
        node = settings("posegan").head.model_dump()
        start, style = torch.full((1, 6), 3.0), torch.tensor([[1.0, 0.0]])
        speech = torch.from_numpy(np.random.default_rng(0).standard_normal((1, 64, CHANNELS)).astype(np.float32))
        made = {}
        for anchor in (0, 20):
            network = task("posegan", head={**node, "anchor_frames": anchor}).module
            with torch.no_grad():
                made[anchor] = network.head.sample(network.encode_speech(speech, style), start, [torch.Generator()])
        assert (made[0][:, 0] - start).abs().max() > 0.5
        torch.testing.assert_close(made[20][:, 0], start)
        torch.testing.assert_close(made[20][:, 20:], made[0][:, 20:])

    def test_stream_equals_sampling(self) -> None:
        made = task("posegan").module
        speech = np.random.default_rng(0).standard_normal((200, CHANNELS)).astype(np.float32)
        style = made.style_of("a")
        parts = list(made.stream(speech, [5], style))
        assert len(parts) == 4
        np.testing.assert_array_equal(np.concatenate(parts, axis=1), made.sample(speech, [5], style))


class Drift(torch.nn.Module):
    """A generator that moves on by 0.01 a frame from the initial pose, after a jump at the first frame."""

    window = 64

    def __init__(self, jump: float) -> None:
        super().__init__()
        self.jump = jump

    def sample(self, inputs: PoseInputs, start: torch.Tensor, generators: list[torch.Generator]) -> torch.Tensor:
        """Poses of one window."""
        frames = torch.arange(inputs.features.shape[1], dtype=torch.float32)
        return start[:, None] + self.jump + 0.01 * frames[:, None]


class TestSeams:
    """Steps into a new window, measured on what `stream` yields."""

    @pytest.mark.parametrize("jump", [0.0, 1.0])
    def test_a_jump_at_each_window_is_measured_and_steady_motion_is_not(self, jump: float) -> None:
        network = task("posegan").module
        network.head = Drift(jump)
        parts = list(network.stream(np.zeros((4 * 63 + 1, CHANNELS), np.float32), [0], network.style_of("a")))
        assert [part.shape[1] for part in parts] == [64, 63, 63, 63]
        generated = np.concatenate(parts, axis=1)[0] / network.scale.numpy()
        found = _reference_free_metrics(network, [generated, generated])["seams"]
        assert found == pytest.approx((jump + 0.01) / 0.01, rel=1e-3)

    def test_windows_that_share_no_frame_are_measured_at_their_joins(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("talkingeyes.evaluation.papers.posegan_metrics.WINDOW_FRAMES", 64)
        network = task("head_random").module
        slow = 0.01 * torch.arange(64)[:, None].expand(64, 6)
        network.head.set_training_windows(torch.stack([slow, slow]), torch.zeros(2, 2 * CHANNELS))
        speech = np.zeros((256, CHANNELS), np.float32)
        generated = network.sample(speech, [0], network.style_of("a"))[0] / network.scale.numpy()
        assert _reference_free_metrics(network, [generated])["seams"] == pytest.approx(63.0, rel=1e-3)

    def test_one_window_has_no_seam(self) -> None:
        assert np.isnan(seam_speed_ratio([np.zeros((256, 6))], 256, 1))


class TestMeasures:
    def test_correlations_are_pearson(self) -> None:
        rng = np.random.default_rng(0)
        speech, pose = rng.standard_normal((2, 64, 3)), rng.standard_normal((2, 64, 6))
        pose[:, :, 5] = 1.0
        found = correlations(speech, pose).reshape(2, 3, 6)
        assert found[1, 2, 4] == pytest.approx(np.corrcoef(speech[1, :, 2], pose[1, :, 4])[0, 1])
        assert (found[:, :, 5] == 0).all()

    def test_svm_prefers_matched_poses_if_speech_and_pose_are_coupled(self) -> None:
        rng = np.random.default_rng(0)

        def made(count: int) -> PoseWindows:
            speech = rng.standard_normal((count, 64, 6))
            pose = speech @ np.eye(6)[::-1] + 0.3 * rng.standard_normal((count, 64, 6))
            return PoseWindows(speech, pose, np.zeros(count, int))

        found = acceptance_rates(made(80), made(40), ["a"], SVMSettings(features=6, nu=0.1, seed=0))
        assert found.matched[0] > 0.6
        assert found.random_poses[0, 0] < 0.2

    def test_classifier_identifies_speakers_but_not_from_still_head(self) -> None:
        windows = pose_windows(recordings(300, 6), ["a", "b"], 64, 8)
        labelled = LabelledWindows(windows.pose, windows.speaker)
        loop = dict(
            steps=40, batch=16, learning_rate=5e-3, schedule="constant", weight_decay=0.0, clip_norm=1.0,
            validate_every=20,
        )  # fmt: skip
        found = ClassifierSettings(seed=0, width=8, dropout=0.0, loop=LoopSettings.model_validate(loop))
        classifier = train_classifier(found, labelled, labelled)
        assert classifier_scores(classifier, labelled).accuracy.min() > 0.9
        still = classifier_scores(classifier, LabelledWindows(np.zeros((8, 64, 6), np.float32), np.repeat([0, 1], 4)))
        assert still.confidence.mean() == pytest.approx(0.5, abs=1e-5)
        assert blend_styles(classifier, recordings(300, 6)[1].pose).argmax() == 1
        with pytest.raises(InputError, match="at least"):
            blend_styles(classifier, np.zeros((5, 6), np.float32))

    def test_distances_jitter_and_clip_difference_by_hand(self) -> None:
        times = np.arange(301)[:, None] / 30
        slow, fast = (np.sin(2 * np.pi * hz * times) * np.ones(6) for hz in (0.5, 8.0))
        assert distances([slow], [slow + 2.0]).pose == pytest.approx(2.0)
        assert distances([slow], [slow + 2.0]).motion == pytest.approx(0.0, abs=1e-12)
        assert jitter([slow], 30.0) < 0.01
        assert jitter([fast], 30.0) > 0.9
        assert clip_difference([slow, slow]) == 0.0
        assert clip_difference([slow, slow + 1.0]) == pytest.approx(1.0)
        assert style_distance(measure_style(slow), measure_style(2 * slow)) == pytest.approx(np.log(2))
        alive = movement_ratios([2 * slow], [slow])
        assert alive.distance() == pytest.approx(3 * np.log(2))

    def test_windows_slide_within_clips(self) -> None:
        assert sliding_windows(np.arange(10)[:, None].astype(float), 4, 3)[:, 0, 0].tolist() == [0, 3, 6]
        assert len(sliding_windows(np.zeros((3, 2)), 4, 1)) == 0
        assert set(pose_windows(recordings(), ["b"], 64, 32).speaker) == {0}


def pgface_task() -> PGFaceTask:
    rng = np.random.default_rng(0)
    node = model_section("pgface")
    node["network"] |= {"coefficients": 4, "dropout": 0.0}
    node["network"]["speech"] |= {"width": 8, "channel_dropout": 0.0}
    node["loop"] |= {"steps": 60, "batch": 32, "validate_every": 60}
    node["validation_windows"] = 20
    found = []
    for _ in range(3):
        head = np.cumsum(0.02 * rng.standard_normal((200, 3)), axis=0)
        speech = rng.standard_normal((200, CHANNELS)).astype(np.float32)
        motion = Motion.of(30.0, head, np.zeros((200, 2, 3)))
        found.append(ShapeRecording(speech, to_poses(head, np.zeros((200, 3))).astype(np.float32), motion))
    settings = PGFaceTaskSettings.model_validate(node)
    return PGFaceTask(settings, 0, found[:2], found[2:], normaliser(), FaceSurface(anny_head()))


class TestPGFace:
    """Soft tissue depends on head pose, and PGFace learns the dependence."""

    def test_tissue_sags_except_at_the_brow(self) -> None:
        surface = FaceSurface(anny_head())
        motion = Motion.of(30.0, np.zeros((2, 3)), np.zeros((2, 2, 3)))
        up = np.array([[0.0, 0.0, 0.0], [-np.radians(18), 0.0, 0.0]])
        upright, raised = surface.shapes(surface.factors(motion, up))
        moved = np.linalg.norm(raised - upright, axis=1) * 1000
        assert moved[surface.lower].max() == pytest.approx(1.25, abs=0.1)
        assert moved[surface.below_eyes_m < -0.02].max() < 0.1
        # The head looks up, so gravity pulls the tissue towards the back of the head.
        assert (raised - upright)[surface.lower][:, 2].mean() < 0

    def test_pgface_learns_the_pose(self) -> None:
        made = pgface_task()
        history = train(made, made.settings.loop, "pgface")
        assert history[-1]["vertex_error_mm"] < 0.7 * history[-1]["mean_shape_error_mm"]

    def test_each_frame_of_a_sequence_is_that_of_its_window(self) -> None:
        network = pgface_task().module.eval()
        rng = np.random.default_rng(1)
        speech, pose = (torch.from_numpy(rng.standard_normal((300, n)).astype(np.float32)) for n in (CHANNELS, 6))
        made = network.sequence(speech, pose)
        assert made.shape == (300, 4)
        for frame in (7, 100, 291):  # the 8th of 16 frames
            cut = slice(frame - 7, frame + 9)
            torch.testing.assert_close(made[frame], network(speech[None, cut], pose[None, cut])[0], atol=1e-5, rtol=0)
        assert torch.isfinite(made).all()

    def test_weights_give_the_same_face_also_on_the_sagging_head(self) -> None:
        surface = FaceSurface(anny_head())
        rng = np.random.default_rng(0)
        jaw = np.stack([rng.uniform(0, 0.3, 5), np.zeros(5), np.zeros(5)], axis=1)
        motion = Motion.of(30.0, 0.3 * rng.standard_normal((5, 3)), np.zeros((5, 2, 3)), jaw=jaw)
        shapes = surface.shapes(surface.factors(motion, motion.head))
        weights = surface.weights(shapes)
        np.testing.assert_allclose(surface.shapes(weights), shapes, atol=1e-4)  # metres
        level = Motion.of(
            30.0, np.zeros((5, 3)), np.zeros((5, 2, 3)),
            expression=weights, expression_names=surface.sagging_model.expression_names,
        )  # fmt: skip
        posed = posed_vertices(surface.sagging_model, motion_to_pose(surface.sagging_model, level))
        np.testing.assert_allclose(posed[:, surface.vertices], shapes, atol=1e-4)

    def test_the_face_answers_to_the_head_that_posegan_moves_unless_its_pose_is_fixed(self) -> None:
        heads, faces, surface = task("posegan").module, pgface_task().module.eval(), FaceSurface(anny_head())
        speech = np.random.default_rng(2).standard_normal((90, CHANNELS)).astype(np.float32)
        moved, fixed = (talking_face(heads, faces, surface, speech, "a", 0, fixed_pose=each) for each in (False, True))
        np.testing.assert_array_equal(moved.head, fixed.head)
        assert moved.expression.shape == (90, len(surface.sagging_model.expression_names))
        assert np.abs(moved.expression - fixed.expression).max() > 1e-3

    def test_eq_7_is_the_masked_sum_over_vertices(self) -> None:
        from talkingeyes.models.pgface import PGFace

        node = model_section("pgface")["network"] | {"coefficients": 3}
        network = PGFace(PGFaceTaskSettings.model_fields["network"].annotation.model_validate(node), ["a"], 5)  # type: ignore[union-attr]
        torch.manual_seed(0)
        basis, lower = torch.randn(3, 5, 3), torch.tensor([True, False, True, False, False])
        network.set_basis(torch.zeros(5, 3), basis, lower)
        difference = torch.randn(7, 3)
        moved = 1000 * torch.einsum("bk,kvc->bvc", difference, basis) * torch.where(lower, 10.0, 1.0)[:, None]
        torch.testing.assert_close(network.masked_squared_error(difference), moved.square().mean())


def test_the_experiment_composes_and_its_heads_are_those_of_the_tables() -> None:
    from pipelines.results.posegan_table import ABLATIONS, GAZE

    models = compose(["experiment=posegan"])["model"]
    assert {*HEADS, *ABLATIONS, *GAZE, "pgface", "talkingeyes_events"} <= set(models)
    for name in ABLATIONS:
        assert set(models[name]["weights"]) == set(models["posegan"]["weights"]), name
    assert models["posegan_without_motion"]["weights"]["motion"] == 0
    assert models["posegan_without_initial_pose"]["weights"]["initial_pose"] == 0
    assert not models["posegan_without_initial_pose"]["head"]["initial_pose"]
    assert models["head_vqvae_then_gaze"]["source_models"] == ["head_vqvae", "talkingeyes_events"]


class TestTables:
    """From evaluation to the page."""

    def test_new_people_are_measured_by_style_and_language(self) -> None:
        from talkingeyes.evaluation.papers.posegan_metrics import _languages, _transfer

        made = task("posegan").module
        people = [recordings(300, 4)[index::2] for index in (0, 1)]
        windows = pose_windows([each for clips in people for each in clips], ["a", "b"], 64, 8)
        loop = LoopSettings(
            steps=10, batch=8, learning_rate=5e-3, schedule="constant", weight_decay=0.0, clip_norm=1.0,
            validate_every=10,
        )  # fmt: skip
        labelled = LabelledWindows(windows.pose, windows.speaker)
        classifier = train_classifier(ClassifierSettings(seed=0, width=8, dropout=0.0, loop=loop), labelled, labelled)
        found = _transfer(made, people, classifier, 0)
        assert found["the best of the learnt styles"] <= found["any learnt style"]
        assert found["the person's own other clip"] < found["another new person"]
        languages = _languages(made, [clips[0] for clips in people], classifier, 0)
        assert set(languages) == {"en"}
        assert 0 <= np.nanmean(languages["en"]["confidence"]) <= 1

    def test_page_has_all_tables_with_published_values(self) -> None:
        from pipelines.results.posegan_page import page

        row = {
            "l2_pose": 1.0, "l2_motion": 0.1, "confidence": [0.25, 0.75], "accuracy": [0.0, 1.0], "range": 1.0,
            "speed": 1.0, "acceleration": 1.0, "jitter": 0.01, "seams": float("nan"), "variety": 1.0, "pace": 0.1,
            "parameters": 1234, "generation_s": 0.5,
        }  # fmt: skip
        seed = {
            "speakers": ["a", "b"],
            "table1": {"own": [0.9, 0.8], "random": [[0.5, 0.4], [0.3, 0.2]]},
            "classifier": row,
            "truth": row,
            "rows": {name: row for name in HEADS},
            "training_s": {name: 60.0 for name in HEADS},
            "noise": {"20": row},
            "strangers": {"transfer": {"nearest, of 4 s": 0.4}, "languages": {"fr": row}},
        }
        other = {**seed, "rows": {name: {**row, "l2_pose": 2.0} for name in HEADS}}
        measures = {
            "metrics": {
                "gaze/x": {"value": {"value": 3.0}, "worse": True},
                "gaze/y": {"value": None, "worse": None},
                "corr/head": {"value": {"value": 0.25}, "worse": False},
            }
        }
        text = page([seed, other], {"truth": [measures, measures], "head_cnn_then_gaze": [measures, measures]})
        assert "| CNN | 1.50 <sub>1.00–2.00</sub> | 0.100 <sub>0.100–0.100</sub> | 0.82 | 0.11 |" in text
        assert "| mean | 0.85 (paper 0.85) | 0.35 (paper 0.65) |" in text
        assert "0.50 <sub>0.50–0.50</sub>" in text
        assert "gaze/x" in text
        assert "gaze/y" not in text
        every = text[text.index("Every head model with one gaze decoder") :].split("\n\n")[1].splitlines()
        assert len(every) == 3  # only the CNN's gaze was measured
        assert "worse, of 3" in every[0]
        assert every[2].startswith("| CNN | 1.50 <sub>1.00–2.00</sub> | 0.50")
        assert "| 1 <sub>1–1</sub> | 0.25 <sub>0.25–0.25</sub> | – |" in every[2]
