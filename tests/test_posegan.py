"""Personal head motion: poses of six numbers, models of the head alone, the rival in the one loop, PGFace, measures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from toy import clip

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.poses import PoseRecording, gaussian_filtered, head_of, linearly_resampled, poses_of, resampled
from talkingeyes.corpus.windows import Normaliser
from talkingeyes.evaluation.pose.classifier import ClassifierSettings, Labelled, judge, trained_classifier
from talkingeyes.evaluation.pose.correlation import SVMSettings, belonging, correlations
from talkingeyes.evaluation.pose.movement import distances, jitter, manner, seams, unlike, variety
from talkingeyes.evaluation.pose.transfer import blended
from talkingeyes.evaluation.pose.windows import PoseWindows, cut, windows_of
from talkingeyes.head.anny import open_head
from talkingeyes.head.sag import FaceSurface
from talkingeyes.orchestration.config import CONF, compose
from talkingeyes.training.checkpoint import load, save
from talkingeyes.training.loop import Contest, LoopSettings, train
from talkingeyes.training.pgface import PGFaceSettings, PGFaceTask, ShapeRecording
from talkingeyes.training.poses import PoseModelSettings, PoseTask, liveness
from talkingeyes.training.progress import Progress
from talkingeyes.training.trained import HeadThenGazeSettings, load_generator, save_head_then_gaze
from talkingeyes.training.trained_poses import HeadGenerator, pose_config

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
        "transformer": {"width": 8, "layers": 1, "heads": 2, "dropout": 0.0, "back": 8},
    },
    "posegan": {"width": 16, "layers": 1, "levels": 3, "window": 64},
}


def recordings(frames: int = 150, clips: int = 4) -> list[PoseRecording]:
    """Two people: one slow and wide, one quick and small; speech that says nothing."""
    random = np.random.default_rng(3)
    made = []
    for index in range(clips):
        who = index % 2
        hz, size = ((0.3, 0.10), (2.0, 0.03))[who]
        phase = random.uniform(0, 6, 6)
        pose = size * np.sin(2 * np.pi * hz * np.arange(frames)[:, None] / 30 + phase)
        speech = random.standard_normal((frames, CHANNELS)).astype(np.float32)
        made.append(PoseRecording(clip(f"c{index}", "ab"[who]), speech, pose.astype(np.float32), np.full(6, 0.1)))
    return made


def normaliser() -> Normaliser:
    names = tuple(str(index) for index in range(CHANNELS))
    return Normaliser(names, np.zeros(CHANNELS, np.float32), np.ones(CHANNELS, np.float32))


def settings(name: str, **changes: Any) -> PoseModelSettings:
    """A model of conf/, small."""
    node = yaml.safe_load((CONF / "model" / f"{name}.yaml").read_text())
    node["speech"] |= {"width": 8}
    node["head"] |= SMALL.get(node["head"]["kind"], {})
    node["windows"] = {"frames": 64, "hop": 5}
    if node["loop"]:
        node["loop"] |= {"steps": 4, "batch": 4, "validate_every": 2}
    if node["rival"]:
        node["rival"] = {"width": 8, "layers": 3}
    return PoseModelSettings.model_validate({**node, **changes})


def task(name: str, seed: int = 0, **changes: Any) -> PoseTask:
    found = recordings()
    made = PoseTask(settings(name, **changes), seed, found, found[:2], normaliser())
    made.module.eval()
    return made


class TestPoses:
    def test_six_numbers_and_back(self) -> None:
        random = np.random.default_rng(0)
        head, shift = 0.4 * random.standard_normal((50, 3)), random.standard_normal((50, 3))
        pose = poses_of(head, shift)
        np.testing.assert_allclose(rotation.matrices(head_of(pose)), rotation.matrices(head), atol=1e-9)
        np.testing.assert_array_equal(pose[:, 3:], shift)

    def test_pitch_is_up_and_yaw_to_the_left(self) -> None:
        pose = poses_of(np.array([[-0.2, 0.0, 0.0], [0.0, 0.3, 0.0]]), np.zeros((2, 3)))
        np.testing.assert_allclose(pose[:, :3], [[0.2, 0.0, 0.0], [0.0, 0.3, 0.0]], atol=1e-12)

    def test_the_filter_keeps_constants_and_damps_what_is_fast(self) -> None:
        times = np.arange(300)[:, None] / 30
        np.testing.assert_allclose(gaussian_filtered(np.full((9, 6), 2.0), 1.5, 5), 2.0)
        slow, fast = (np.sin(2 * np.pi * hz * times) * np.ones(6) for hz in (0.3, 8.0))
        assert gaussian_filtered(slow, 1.5, 5).std() > 0.98 * slow.std()
        assert gaussian_filtered(fast, 1.5, 5).std() < 0.15 * fast.std()

    def test_resampling_to_30_and_back(self) -> None:
        slow = np.sin(np.arange(100)[:, None] / 12) * np.ones(6)
        there = resampled(slow, 25.0, 30.0)
        assert len(there) == 119
        back = resampled(there, 30.0, 25.0)
        np.testing.assert_allclose(back, slow[: len(back)], atol=1e-3)
        assert linearly_resampled(slow, 25.0, 30.0).shape == there.shape


@pytest.mark.parametrize("name", HEADS)
class TestHeads:
    """The contract of all generators of head poses."""

    def test_any_length_one_seed_alone_or_with_others(self, name: str) -> None:
        network = task(name).module
        for frames in (1, 2, 7, 150):
            speech = np.random.default_rng(frames).standard_normal((frames, CHANNELS)).astype(np.float32)
            many, one = network.sample(speech, [3, 4], None), network.sample(speech, [4], None)
            assert many.shape == (2, frames, 6)
            assert np.isfinite(many).all()
            np.testing.assert_allclose(many[1], one[0], atol=1e-5)
        if name not in SAME_FOR_ALL_SEEDS:
            style = network.style_of("a")
            first, second = network.sample(speech, [0, 1], style)
            assert np.abs(first - second).max() > 1e-5

    def test_terms_cover_the_weights(self, name: str) -> None:
        made = task(name)
        if made.settings.loop is None:
            return
        terms = made.losses(1)
        assert set(made.settings.weights) <= set(terms)
        assert all(torch.isfinite(each) for each in terms.values())

    def test_a_folder_gives_the_same_head_and_it_drives_a_gaze_decoder(self, name: str, tmp_path: Path) -> None:
        made = task(name)
        for part in ("posegan", "joined"):
            (tmp_path / part).mkdir()
        save(tmp_path / "posegan", made.module.state_dict(), pose_config(made.settings, normaliser(), made.module))
        loaded = load_generator(tmp_path / "posegan")
        assert isinstance(loaded, HeadGenerator)
        speech = np.random.default_rng(0).standard_normal((80, CHANNELS)).astype(np.float32)
        ours = HeadGenerator(made.module).generate(speech, [1, 2], 25.0)
        theirs = loaded.generate(speech, [1, 2], 25.0)
        assert ours.head.shape == (2, 80, 3)
        np.testing.assert_array_equal(ours.head, theirs.head)
        _save_gaze(tmp_path / "gaze")
        joined = HeadThenGazeSettings(
            kind="head_then_gaze", parts=("head", "gaze"), prior=None, made_of=("posegan", "gaze")
        )
        save_head_then_gaze(tmp_path / "joined", joined, load(tmp_path / "posegan"), load(tmp_path / "gaze"))
        both = load_generator(tmp_path / "joined").generate(speech, [1, 2], 25.0)
        np.testing.assert_array_equal(both.head, ours.head)
        assert both.gaze.shape == (2, 80, 2, 3)
        assert np.abs(both.gaze).max() > 1e-4
        with pytest.raises(InputError, match="speech_to_motion"):
            save_head_then_gaze(tmp_path / "joined", joined, load(tmp_path / "gaze"), load(tmp_path / "posegan"))


def _save_gaze(folder: Path) -> None:
    """The smallest model with a gaze decoder, untrained."""
    from talkingeyes.models.speech_to_motion import SpeechToMotion
    from talkingeyes.training.trained import network_config
    from talkingeyes.training.translation import TranslationSettings

    node = yaml.safe_load((CONF / "model" / "vae.yaml").read_text())
    found = TranslationSettings.model_validate(node)
    torch.manual_seed(1)
    network = SpeechToMotion(found, normaliser().channels, None)
    folder.mkdir()
    save(folder, network.state_dict(), network_config(found, normaliser().channels, None))


class TestContest:
    """The rival's turn in the one loop."""

    def test_each_turn_moves_its_own_weights(self) -> None:
        made = task("posegan")
        assert isinstance(made, Contest)
        before = {name: value.clone() for name, value in made.module.state_dict().items()}
        train(made, LoopSettings.model_validate({**_loop(made), "steps": 1, "validate_every": 1}), "test")
        after = made.module.state_dict()
        moved = {name for name, value in before.items() if not torch.equal(value, after[name])}
        assert any(name.startswith("rival.") for name in moved)
        assert any(name.startswith("head.") for name in moved)

    def test_the_rival_learns_to_tell_and_does_not_help_the_generator(self) -> None:
        made = task("posegan")
        made.losses(1)
        made.rival_losses(1)["total"].backward()
        assert all(value.grad is None for name, value in made.module.named_parameters() if "rival" not in name)
        rival = made.module.rival
        assert rival is not None
        optimiser = torch.optim.Adam(rival.parameters(), 3e-3)
        told = []
        for _ in range(40):
            terms = made.rival_losses(1)
            optimiser.zero_grad()
            terms["total"].backward()
            optimiser.step()
            told.append(float((terms["believed_true"] - terms["believed_made"]).detach()))
        assert told[-1] > told[0] + 0.2

    def test_one_that_was_killed_ends_in_the_same_weights(self, tmp_path: Path) -> None:
        whole = task("posegan")
        train(whole, LoopSettings.model_validate(_loop(whole)), "whole")

        class Killed(Exception):
            pass

        def kill(step: int, figures: dict[str, float]) -> None:
            raise Killed

        progress = Progress.of(tmp_path / "p", ["test"], [])
        with pytest.raises(Killed):
            part = task("posegan")
            train(part, LoopSettings.model_validate(_loop(part)), "part", report=kill, progress=progress)
        rest = task("posegan")
        train(rest, LoopSettings.model_validate(_loop(rest)), "rest", progress=progress)
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
                made[anchor] = network.head.sample(network.hear(speech, style), start, [torch.Generator()])
        assert (made[0][:, 0] - start).abs().max() > 0.5
        torch.testing.assert_close(made[20][:, 0], start)
        torch.testing.assert_close(made[20][:, 20:], made[0][:, 20:])

    def test_a_stream_is_what_is_sampled(self) -> None:
        made = task("posegan").module
        speech = np.random.default_rng(0).standard_normal((200, CHANNELS)).astype(np.float32)
        parts = list(made.stream(speech, [5], None))
        assert len(parts) == 4
        np.testing.assert_array_equal(np.concatenate(parts, axis=1), made.sample(speech, [5], None))


class TestMeasures:
    def test_correlations_are_pearson(self) -> None:
        random = np.random.default_rng(0)
        speech, pose = random.standard_normal((2, 64, 3)), random.standard_normal((2, 64, 6))
        pose[:, :, 5] = 1.0
        found = correlations(speech, pose).reshape(2, 3, 6)
        assert found[1, 2, 4] == pytest.approx(np.corrcoef(speech[1, :, 2], pose[1, :, 4])[0, 1])
        assert (found[:, :, 5] == 0).all()

    def test_the_svm_prefers_own_poses_where_speech_and_pose_are_tied(self) -> None:
        random = np.random.default_rng(0)

        def made(count: int) -> PoseWindows:
            speech = random.standard_normal((count, 64, 6))
            pose = speech @ np.eye(6)[::-1] + 0.3 * random.standard_normal((count, 64, 6))
            return PoseWindows(speech, pose, np.zeros(count, int))

        found = belonging(made(80), made(40), ["a"], SVMSettings(features=6, nu=0.1, seed=0))
        assert found.own[0] > 0.6
        assert found.random[0, 0] < 0.2

    def test_the_classifier_tells_people_and_a_still_head_is_nobodys(self) -> None:
        windows = windows_of(recordings(300, 6), ["a", "b"], 64, 8)
        labelled = Labelled(windows.pose, windows.speaker)
        loop = dict(
            steps=40, batch=16, learning_rate=5e-3, schedule="constant", weight_decay=0.0, clip_norm=1.0,
            validate_every=20,
        )  # fmt: skip
        found = ClassifierSettings(seed=0, width=8, dropout=0.0, loop=LoopSettings.model_validate(loop))
        classifier = trained_classifier(found, labelled, labelled)
        assert judge(classifier, labelled).accuracy.min() > 0.9
        still = judge(classifier, Labelled(np.zeros((8, 64, 6), np.float32), np.repeat([0, 1], 4)))
        assert still.confidence.mean() == pytest.approx(0.5, abs=1e-5)
        assert blended(classifier, recordings(300, 6)[1].pose).argmax() == 1
        with pytest.raises(InputError, match="at least"):
            blended(classifier, np.zeros((5, 6), np.float32))

    def test_distances_jitter_seams_and_variety_on_cases_made_by_hand(self) -> None:
        times = np.arange(301)[:, None] / 30
        slow, fast = (np.sin(2 * np.pi * hz * times) * np.ones(6) for hz in (0.5, 8.0))
        assert distances([slow], [slow + 2.0]).pose == pytest.approx(2.0)
        assert distances([slow], [slow + 2.0]).motion == pytest.approx(0.0, abs=1e-12)
        assert jitter([slow], 30.0) < 0.01
        assert jitter([fast], 30.0) > 0.9
        stepped = slow.copy()
        stepped[100:] += 1.0
        assert seams([stepped], 100) > 2 * seams([slow], 100)
        assert variety([slow, slow]) == 0.0
        assert variety([slow, slow + 1.0]) == pytest.approx(1.0)
        assert unlike(manner(slow), manner(2 * slow)) == pytest.approx(np.log(2))
        alive = liveness([2 * slow], [slow])
        assert alive.distance() == pytest.approx(3 * np.log(2))

    def test_windows_slide_within_clips(self) -> None:
        assert cut(np.arange(10)[:, None].astype(float), 4, 3)[:, 0, 0].tolist() == [0, 3, 6]
        assert len(cut(np.zeros((3, 2)), 4, 1)) == 0
        assert set(windows_of(recordings(), ["b"], 64, 32).speaker) == {0}


def pgface_task() -> PGFaceTask:
    random = np.random.default_rng(0)
    node = yaml.safe_load((CONF / "model" / "pgface.yaml").read_text())
    node["network"] |= {"coefficients": 4, "dropout": 0.0}
    node["network"]["speech"] |= {"width": 8, "channel_dropout": 0.0}
    node["loop"] |= {"steps": 60, "batch": 32, "validate_every": 60}
    node["watched"] = 20
    found = []
    for _ in range(3):
        head = np.cumsum(0.02 * random.standard_normal((200, 3)), axis=0)
        speech = random.standard_normal((200, CHANNELS)).astype(np.float32)
        motion = Motion.of(30.0, head, np.zeros((200, 2, 3)))
        found.append(ShapeRecording(speech, poses_of(head, np.zeros((200, 3))).astype(np.float32), motion))
    settings = PGFaceSettings.model_validate(node)
    return PGFaceTask(settings, 0, found[:2], found[2:], normaliser(), FaceSurface(open_head()))


class TestPGFace:
    """The face hangs as the head is held, and PGFace learns that it does."""

    def test_tissue_hangs_down_and_not_at_the_brow(self) -> None:
        surface = FaceSurface(open_head())
        motion = Motion.of(30.0, np.zeros((2, 3)), np.zeros((2, 2, 3)))
        up = np.array([[0.0, 0.0, 0.0], [-np.radians(18), 0.0, 0.0]])
        upright, raised = surface.shapes(surface.factors(motion, up))
        moved = np.linalg.norm(raised - upright, axis=1) * 1000
        assert moved[surface.lower].max() == pytest.approx(1.25, abs=0.1)
        assert moved[surface.below_eyes_m < -0.02].max() < 0.1
        # The head looks up: the ground is behind the face, and tissue falls towards the back.
        assert (raised - upright)[surface.lower][:, 2].mean() < 0

    def test_it_learns_the_pose(self) -> None:
        made = pgface_task()
        history = train(made, made.settings.loop, "pgface")
        assert history[-1]["mm"] < 0.7 * history[-1]["mm_mean_shape"]

    def test_eq_7_is_the_masked_sum_over_vertices(self) -> None:
        from talkingeyes.models.pgface import PGFace

        node = yaml.safe_load((CONF / "model" / "pgface.yaml").read_text())["network"] | {"coefficients": 3}
        network = PGFace(PGFaceSettings.model_fields["network"].annotation.model_validate(node), ["a"], 5)  # type: ignore[union-attr]
        torch.manual_seed(0)
        basis, lower = torch.randn(3, 5, 3), torch.tensor([True, False, True, False, False])
        network.learn_basis(torch.zeros(5, 3), basis, lower)
        difference = torch.randn(7, 3)
        moved = 1000 * torch.einsum("bk,kvc->bvc", difference, basis) * torch.where(lower, 10.0, 1.0)[:, None]
        torch.testing.assert_close(network.squared(difference), moved.square().mean())


def test_the_experiment_composes_and_its_heads_are_those_of_the_tables() -> None:
    from pipelines.posegan_table import ABLATIONS, GAZE

    models = compose(["experiment=posegan"])["model"]
    assert {*HEADS, *ABLATIONS, *GAZE, "pgface", "talkingeyes"} <= set(models)
    assert models["posegan_without_motion"]["weights"]["motion"] == 0
    assert not models["posegan_without_start"]["head"]["initial_pose"]
    assert models["gaze_after_vqvae"]["made_of"] == ["head_vqvae", "talkingeyes"]


class TestTables:
    """From what is measured to the page."""

    def test_new_people_are_measured_by_style_and_language(self) -> None:
        from talkingeyes.evaluation.pose import measuring

        made = task("posegan").module
        people = [recordings(300, 4)[index::2] for index in (0, 1)]
        windows = windows_of([each for clips in people for each in clips], ["a", "b"], 64, 8)
        loop = LoopSettings(
            steps=10, batch=8, learning_rate=5e-3, schedule="constant", weight_decay=0.0, clip_norm=1.0,
            validate_every=10,
        )  # fmt: skip
        labelled = Labelled(windows.pose, windows.speaker)
        classifier = trained_classifier(ClassifierSettings(seed=0, width=8, dropout=0.0, loop=loop), labelled, labelled)
        found = measuring._transfer(made, people, classifier, 0)
        assert found["the best of the learnt styles"] <= found["any learnt style"]
        assert found["the person's own other clip"] < found["another new person"]
        languages = measuring._languages(made, [clips[0] for clips in people], classifier, 0)
        assert set(languages) == {"en"}
        assert 0 <= np.nanmean(languages["en"]["confidence"]) <= 1

    def test_the_page_has_every_table_with_the_paper_beside(self) -> None:
        from talkingeyes.evaluation.pose.page import page

        row = {
            "l2_pose": 1.0, "l2_motion": 0.1, "confidence": [0.25, 0.75], "accuracy": [0.0, 1.0], "range": 1.0,
            "speed": 1.0, "jerkiness": 1.0, "jitter": 0.01, "seams": float("nan"), "variety": 1.0, "pace": 0.1,
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
            "measures": {
                "gaze/x": {"value": {"value": 3.0}, "apart": True},
                "gaze/y": {"value": None, "apart": None},
                "corr/head": {"value": {"value": 0.25}, "apart": False},
            }
        }
        text = page([seed, other], {"truth": [measures, measures], "gaze_after_cnn": [measures, measures]})
        assert "| CNN | 1.50 <sub>1.00–2.00</sub> | 0.100 <sub>0.100–0.100</sub> | 0.82 | 0.11 |" in text
        assert "| mean | 0.85 (paper 0.85) | 0.35 (paper 0.65) |" in text
        assert "0.50 <sub>0.50–0.50</sub>" in text
        assert "gaze/x" in text
        assert "gaze/y" not in text
        every = text[text.index("Every head before one gaze decoder") :].split("\n\n")[1].splitlines()
        assert len(every) == 3  # only the CNN's gaze was measured
        assert "apart, of 3" in every[0]
        assert every[2].startswith("| CNN | 1.50 <sub>1.00–2.00</sub> | 0.50")
        assert "| 1 <sub>1–1</sub> | 0.25 <sub>0.25–0.25</sub> | – |" in every[2]
