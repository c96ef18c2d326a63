"""Gaze signals, stays, the VQ-VAE, and the contract of all gaze generators."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from toy import CHANNELS, recordings

from talkingeyes.models.gaze.categorical import stay_mask
from talkingeyes.models.gaze.gaze_signal import find_stays, mirror_motion, to_gaze, to_signal
from talkingeyes.models.gaze.generator import GazeCondition
from talkingeyes.models.gaze.history import NoisyTeacherForcing
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.models.layers.categorical_sampling import sample_categorical
from talkingeyes.models.layers.schedules import set_trained_steps
from talkingeyes.models.layers.transformer import shift_right
from talkingeyes.models.speech_to_motion import MotionBatch, SpeechInput, SpeechToMotion, SpeechToMotionSettings

TRANSFORMER = {"width": 16, "layers": 2, "heads": 2, "dropout": 0.0, "lookback": 20}
VAE = {
    "width": 16,
    "layers": 2,
    "dropout": 0.0,
    "latent": 4,
    "latent_frames": 25,
    "free_bits": 0.0,
}
CLEAN = {"kind": "teacher_forcing"}
GAZE: dict[str, dict[str, Any]] = {
    "categorical": {
        "transformer": TRANSFORMER,
        "condition_lookback": 3,
        "condition_lookahead": 3,
        "history_dropout": 0.0,
        "history": CLEAN,
    },
    "point_process": {
        "fps": 25.0,
        "guidance": {"time": 1.0, "location": 1.0},
        "observation_noise_deg": 0.9,
        "process": {
            "width": 16,
            "bin_frames": 2,
            "absolute_components": 8,
            "relative_components": 2,
            "adaptive_components": False,
            "previous_steps": 0,
            "previous_locations": 2,
            "layers": 1,
            "dropout": 0.0,
            "history_dropout": 0.0,
            "history_noise": 0.0,
        },
    },
    "regression": {
        "transformer": TRANSFORMER,
        "condition_lookback": 3,
        "condition_lookahead": 3,
        "history": CLEAN,
        "regularity": "nearest_codes",
    },
    "vae": VAE,
}

CODEBOOK = {"kind": "codebook", "codes": 32, "width": 8, "commitment": 0.25, "decay": 0.9, "restart_below": 0.1}
ELEMENTWISE = {"kind": "elementwise", "factors": 2, "codebook": CODEBOOK | {"width": 4}}


@dataclass(frozen=True)
class Member:
    """A gaze generator of the suite: kind, changes to the default settings, codebook."""

    kind: str
    changes: dict[str, Any] = field(default_factory=dict)
    quantiser: dict[str, Any] = field(default_factory=lambda: CODEBOOK)


NOISE, SCHEDULED = {"kind": "noise", "sigma": 0.5}, {"kind": "scheduled_sampling", "max_fraction": 0.5, "ramp_steps": 1}
MEMBERS = {
    **{kind: Member(kind) for kind in GAZE},
    "categorical_noise": Member("categorical", {"history": NOISE}),
    "categorical_scheduled": Member("categorical", {"history": SCHEDULED}),
    "regression_noise": Member("regression", {"history": NOISE}),
    "regression_scheduled": Member("regression", {"history": SCHEDULED}),
    "regression_free": Member("regression", {"history": {"kind": "free_running", "truncation_frames": 8}}),
    "regression_free_untruncated": Member(
        "regression", {"history": {"kind": "free_running", "truncation_frames": None}}
    ),
    "regression_whole": Member(
        "regression",
        {
            "transformer": TRANSFORMER | {"lookback": None},
            "condition_lookback": None,
            "condition_lookahead": None,
        },
    ),
    "regression_predicted": Member("regression", {"history": {"kind": "predicted"}}),
    "regression_true_codes": Member("regression", {"regularity": "true_codes"}),
    "regression_elementwise": Member("regression", quantiser=ELEMENTWISE),
    "vae_free_bits": Member("vae", {"free_bits": 0.25}),
}

# Those that differ in sampling: a history, a regularity and free bits act in training alone.
SAMPLED = [name for name, each in MEMBERS.items() if not each.changes.keys() & {"history", "regularity", "free_bits"}]


def codebook(patch: int, tolerance: float | None, quantiser: dict[str, Any] = CODEBOOK) -> GazeVQVAE:
    """A small untrained codebook, initialised on toy gaze."""
    torch.manual_seed(0)
    network = GazeVQVAE(
        GazeVQVAESettings.model_validate(
            {
                "signal": "eye_in_head" if patch == 1 else "gaze_in_space",
                "frames_per_code": patch,
                "stay_tolerance_deg": tolerance,
                "norm": "standardised_mean",
                "standardised": True,
                "quantiser": quantiser,
                "encoder": TRANSFORMER,
                "decoder": TRANSFORMER,
            }
        )
    )
    network.normalise_by(torch.zeros(6 if patch == 1 else 4), 0.1)
    network.quantiser.train()
    network.quantiser(torch.randn(1, 64, network.settings.quantiser.width))
    return network.freeze()


def model(
    kind: str,
    head_frames: int | None = 25,
    reconstructed_heads: float = 0.5,
    gaze: Mapping[str, Any] | None = None,
    channels: Sequence[str] | None = None,
) -> SpeechToMotion:
    """A small untrained joint model."""
    member = MEMBERS[kind]
    patch, tolerance = (4, 1.0) if member.kind == "categorical" else (1, None)
    book = None if member.kind in ("vae", "point_process") else codebook(patch, tolerance, member.quantiser)
    torch.manual_seed(1)
    return SpeechToMotion(
        SpeechToMotionSettings(
            kind="speech_to_motion",
            parts=("head", "gaze"),
            tokenizer=None,
            speech={"channels": channels, "width": 12, "layers": 2, "dropout": 0.0, "channel_dropout": 0.0},
            head=VAE | {"kind": "vae", "norm": "standardised_mean", "standardised": True, "latent_frames": head_frames},
            gaze={"kind": member.kind, **GAZE[member.kind], **member.changes, **(gaze or {})},
            conditions=(),
            reconstructed_heads=reconstructed_heads,
            weights={"head_reconstruction": 1.0, "head_kl": 0.1},
            temperatures=(1.0,),
        ),
        [str(index) for index in range(CHANNELS)],
        book,
    ).eval()


def batch(count: int = 3, frames: int = 100) -> MotionBatch:
    """Toy windows."""
    found = recordings(count, seed=5, frames=frames)
    return MotionBatch(
        *(torch.from_numpy(np.stack([getattr(r, name) for r in found])) for name in ("speech", "head", "gaze"))
    )


@pytest.mark.parametrize("name", ["eye_in_head", "gaze_in_space"])
def test_signal_and_gaze_are_inverse(name: Any) -> None:
    for each in recordings(3, seed=1):
        signal = to_signal(name, each.head, each.gaze)
        np.testing.assert_allclose(to_gaze(name, each.head, signal), each.gaze, atol=1e-5)


def test_the_mirror_is_its_own_inverse_and_swaps_sides() -> None:
    each = recordings(1, seed=2)[0]
    head, gaze = mirror_motion(each.head, each.gaze)
    space, reflected = to_signal("gaze_in_space", each.head, each.gaze), to_signal("gaze_in_space", head, gaze)
    np.testing.assert_allclose(reflected[:, [2, 3, 0, 1]] * [-1, 1, -1, 1], space, atol=1e-5)
    np.testing.assert_array_equal(mirror_motion(head, gaze)[1], each.gaze)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31 - 1), st.floats(0.01, 0.2))
def test_stays_never_leave_the_tolerance_of_what_is_held(seed: int, tolerance: float) -> None:
    patches = np.random.default_rng(seed).normal(0, 0.1, (2, 12, 4, 2)).cumsum(1)
    still = find_stays(patches, tolerance)
    assert not still[:, 0].any()
    for row, mask in zip(patches, still, strict=True):
        held = row[0, -1]
        for patch, stay in zip(row[1:], mask[1:], strict=True):
            assert stay == (np.abs(patch - held).max() < tolerance)
            held = held if stay else patch[-1]


def test_decoding_a_stay_copies_the_frame_before_it() -> None:
    network = codebook(4, 1.0)
    stay = torch.tensor([[False, True, True, False, True]])
    with torch.no_grad():
        signal = network.decode(torch.randn(1, 5, 8), stay).unflatten(1, (5, 4))
    assert torch.equal(signal[0, 1], signal[0, 0, -1:].expand(4, -1))
    assert torch.equal(signal[0, 2], signal[0, 0, -1:].expand(4, -1))
    assert torch.equal(signal[0, 4], signal[0, 3, -1:].expand(4, -1))
    assert not torch.equal(signal[0, 3], signal[0, 0])


def test_codebook_steps_equal_the_parallel_decoder() -> None:
    network = codebook(4, 1.0)
    values, stay = torch.randn(2, 12, 8), torch.rand(2, 12) < 0.5
    stay[:, 0] = False
    with torch.no_grad():
        whole = network.render(values, stay).unflatten(1, (12, 4))
        held, cache = None, network.decoder.start()
        for step in range(12):
            patch = network.step(values[:, step], stay[:, step], held, cache)
            torch.testing.assert_close(patch, whole[:, step], atol=1e-6, rtol=1e-5)
            held = patch[:, -1]


def test_rendered_frames_rest_or_move_by_at_least_the_tolerance() -> None:
    network = codebook(4, 1.0)
    network.scale.fill_(0.015)
    with torch.no_grad():
        steps = network.render(torch.randn(2, 30, 8), torch.zeros(2, 30, dtype=torch.bool)).diff(dim=1).abs().amax(-1)
    moving = steps > 0
    assert 0.02 < moving.float().mean() < 1
    assert steps[moving].min() >= network.stay_tolerance_rad - 1e-6


def test_encoder_and_decoder_are_causal() -> None:
    network = codebook(4, 1.0)
    signal = torch.randn(1, 80, 4)
    changed = signal.clone()
    changed[:, 40:] += 1
    stay = torch.zeros(1, 20, dtype=torch.bool)
    with torch.no_grad():
        assert torch.equal(network(signal, stay).signal[:, :40], network(changed, stay).signal[:, :40])


def test_frozen_codebook_does_not_move_in_training() -> None:
    network = model("categorical")
    before = network.gaze.codebook.quantiser.codebook.clone()
    network.train()
    network.loss_terms(batch())["total"].backward()
    assert torch.equal(before, network.gaze.codebook.quantiser.codebook)
    assert all(parameter.grad is None for parameter in network.gaze.codebook.parameters())


@pytest.mark.parametrize("kind", MEMBERS)
def test_terms_are_finite_and_reach_the_speech_input(kind: str) -> None:
    network = model(kind).train()
    loss_terms = network.loss_terms(batch())
    assert all(torch.isfinite(value) for value in loss_terms.values())
    sum(value for name, value in loss_terms.items() if name != "copy_last_frame").backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in network.speech.parameters())


@pytest.mark.parametrize("kind", SAMPLED)
class TestContract:
    """Contract of gaze generators in sampling, combined with a head generator."""

    def test_speeches_of_several_lengths_in_a_batch_are_as_alone(self, kind: str) -> None:
        network = model(kind)
        speeches = [SpeechInput(torch.randn(frames, CHANNELS), [frames, 2]) for frames in (41, 60, 1, 50)]
        for speech, many in zip(speeches, network.generate_batch(speeches), strict=True):
            one = network.generate(speech.embedding, speech.seeds)
            torch.testing.assert_close(many.head, one.head, atol=1e-5, rtol=1e-4)
            torch.testing.assert_close(many.gaze, one.gaze, atol=1e-5, rtol=1e-4)

    def test_eyes_have_no_torsion_beyond_what_was_learned(self, kind: str) -> None:
        if kind.startswith("categorical"):
            out = model(kind).generate(torch.randn(60, CHANNELS), [3])
            assert out.gaze[..., 2].abs().max() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize(
    "kind", [*GAZE, "categorical_scheduled", pytest.param("regression_free", marks=pytest.mark.slow)]
)
def test_gradient_steps_lower_the_loss_on_one_batch(kind: str) -> None:
    network, data = model(kind).train(), batch(2, 24)
    names = {"categorical": "gaze_codes", "point_process": "gaze_location"}
    name = next((term for prefix, term in names.items() if kind.startswith(prefix)), "gaze_reconstruction")
    optimiser = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], 1e-2)
    values = []
    for _ in range(40):
        torch.manual_seed(0)
        loss_terms = network.loss_terms(data)
        loss = loss_terms[name] + loss_terms["head_reconstruction"]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        values.append(float(loss.detach()))
    assert values[-1] < values[0] - 0.2 * abs(values[0])


def test_teacher_forcing_and_free_running_agree_on_the_same_codes() -> None:
    """The history in training equals that in generation."""
    network = model("categorical")
    speech = torch.randn(40, CHANNELS)
    out = network.generate(speech, [7])
    codes, history = network.gaze._encode(out.head, out.gaze)
    signal = torch.from_numpy(to_signal("gaze_in_space", out.head.numpy(), out.gaze.numpy()))
    assert (codes == network.gaze.stay).sum() == stay_mask(network.gaze.codebook, signal).sum()
    assert history.before[0, 0] == network.gaze.stay + 1
    assert torch.equal(history.before[:, 1:], codes[:, :-1])


def terms_at(network: SpeechToMotion, steps: int) -> dict[str, torch.Tensor]:
    """Loss terms of one batch after `steps` of training, with fixed noise."""
    torch.manual_seed(3)
    set_trained_steps(network, steps)
    return network.loss_terms(batch(2, 40))


@pytest.mark.parametrize("kind", ["categorical", "regression"])
def test_a_scheduled_history_begins_as_the_true_one_and_grows(kind: str) -> None:
    loss = "gaze_codes" if kind == "categorical" else "gaze_reconstruction"
    clean, scheduled = (terms_at(model(each).train(), 0) for each in (kind, f"{kind}_scheduled"))
    torch.testing.assert_close(scheduled[loss], clean[loss], rtol=1e-6, atol=0)
    assert (terms_at(model(f"{kind}_scheduled").train(), 1)[loss] - clean[loss]).abs() > 1e-6
    assert torch.equal(*(terms_at(model(each).eval(), 9)[loss] for each in (kind, f"{kind}_scheduled")))


def test_noise_moves_codes_to_near_ones_and_leaves_stays() -> None:
    gaze = model("categorical_noise").gaze
    codes = torch.randint(0, gaze.stay + 1, (4, 30))
    codes[:, 0] = 3
    table = torch.cat([gaze.codebook.quantiser.codebook, torch.zeros(1, 8)])
    moved = {
        sigma: gaze._noisy_history(NoisyTeacherForcing(kind="noise", sigma=sigma), codes).before[:, 1:]
        for sigma in (1e-4, 1.0)
    }
    assert torch.equal(moved[1e-4], codes[:, :-1])
    changed = moved[1.0] != codes[:, :-1]
    assert changed.float().mean() > 0.1
    assert torch.equal(moved[1.0] == gaze.stay, codes[:, :-1] == gaze.stay)
    apart = (table[moved[1.0]] - table[codes[:, :-1]])[changed].norm(dim=-1).mean()
    assert apart < torch.cdist(table[:-1], table[:-1]).mean()


def test_free_running_training_equals_generation() -> None:
    network = model("regression_free")
    data = batch(2, 40)
    condition = GazeCondition(network.speech(data.speech), data.head, network.head.normal(data.head))
    made = network.gaze.sample(condition, [1, 2], 0.0)
    free = network.gaze.train().loss_terms(condition, made)
    assert free["gaze_reconstruction"] < 1e-9
    assert network.gaze.loss_terms(condition, data.gaze)["gaze_reconstruction"] > 1e-3


def test_the_predicted_past_is_that_of_generation_without_its_gradient() -> None:
    """Where the truth is what the network generates, the parallel pass on the predicted past gives it again."""
    network = model("regression_predicted")
    data = batch(2, 40)
    condition = GazeCondition(network.speech(data.speech), data.head, network.head.normal(data.head))
    made = network.gaze.sample(condition, [1, 2], 0.0)
    assert network.gaze.train().loss_terms(condition, made)["gaze_reconstruction"] < 1e-9


def test_regularity_of_true_codes_is_a_distance_to_the_tokens_of_the_truth() -> None:
    """Eq. 14 with the codes of the true motion: 0 for features that are those codes."""
    gaze = model("regression_true_codes").gaze
    data = batch(2, 40)
    signal = data.gaze.flatten(2)
    codes = gaze.codebook.quantiser(gaze.codebook.encode(signal)).codes
    assert torch.equal(gaze._codes(signal), codes)
    condition = GazeCondition(torch.randn(2, 40, 12), data.head, data.head)
    terms = gaze.loss_terms(condition, data.gaze)
    features = gaze.out(gaze.transformer(gaze.embed(shift_right(gaze._normal(signal))), gaze._memory(condition)))
    torch.testing.assert_close(terms["gaze_regularity"], (features - codes).square().mean())


def test_gradient_is_truncated_to_requested_frames() -> None:
    """Gradient of the last frame with respect to the features of the frames before it."""
    gaze = model("regression_free").gaze
    memory, kept = torch.randn(1, 12, 16), []

    def nearest(features: torch.Tensor, step: int) -> torch.Tensor:
        features.retain_grad()
        kept.append(features)
        return gaze._nearest(features)

    for frames, reached in ((4, 4), (12, 12)):
        kept.clear()
        gaze._free_run(memory, nearest, frames).signal[:, -1].sum().backward()
        assert [bool(each.grad.abs().sum() > 0) for each in kept] == [False] * (12 - reached) + [True] * reached


def test_gaze_is_trained_on_true_and_reconstructed_heads_in_proportion() -> None:
    seen = []
    network = model("vae", reconstructed_heads=0.5).train()
    loss_terms = network.gaze.loss_terms
    network.gaze.loss_terms = lambda condition, gaze: seen.append(condition) or loss_terms(condition, gaze)
    data = batch(1, 40)
    many = MotionBatch(*(each.expand(400, *each.shape[1:]) for each in (data.speech, data.head, data.gaze)))
    network.loss_terms(many)["total"].backward()
    true = (seen[0].normalised_head == network.head.normal(many.head)).flatten(1).all(1)
    assert true.float().mean() == pytest.approx(0.5, abs=0.08)
    assert seen[0].normalised_head[~true].std(0).mean() > 1e-3


@pytest.mark.parametrize("guidance", [{"time": 20.0, "location": 1.0}, {"time": 1.0, "location": 20.0}])
def test_guidance_changes_sampled_gaze_alone(guidance: dict[str, float]) -> None:
    plain, guided = model("point_process"), model("point_process", gaze={"guidance": guidance})
    sound, seeds = batch(1, 200).speech[0], [1, 2]
    one, other = plain.generate(sound, seeds), guided.generate(sound, seeds)
    assert torch.equal(one.head, other.head)
    assert not torch.allclose(one.gaze, other.gaze, atol=1e-4)
    torch.testing.assert_close(guided.generate_gaze(sound, other.head, seeds), other.gaze)
    # Training and likelihood have none.
    data = batch()
    torch.testing.assert_close(guided.log_likelihood(data), plain.log_likelihood(data))


def test_guidance_changes_nothing_without_speech() -> None:
    guidance = {"guidance": {"time": 3.0, "location": 3.0}}
    deaf, guided = (model("point_process", gaze=gaze, channels=[]) for gaze in ({}, guidance))
    sound = batch(1, 60).speech[0]
    torch.testing.assert_close(guided.generate(sound, [1]).gaze, deaf.generate(sound, [1]).gaze)


def test_samples_follow_the_probabilities() -> None:
    logits = torch.log(torch.tensor([0.7, 0.2, 0.1])).expand(10_000, 3)
    uniform = torch.rand(10_000, generator=torch.Generator().manual_seed(0))
    shares = torch.bincount(sample_categorical(logits, uniform, 1.0), minlength=3) / 10_000
    torch.testing.assert_close(shares, torch.tensor([0.7, 0.2, 0.1]), atol=0.02, rtol=0)
    assert (sample_categorical(logits, uniform, 0.0) == 0).all()
    cold = torch.bincount(sample_categorical(logits, uniform, 0.5), minlength=3) / 10_000
    assert cold[0] > 0.85
    assert sample_categorical(torch.tensor([[0.0, -torch.inf]]), torch.tensor([1.0]), 1.0) == 0
