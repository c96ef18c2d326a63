"""What the paper's decoder (eq. 9 to 14) generates where the answer is known: gaze that jumps between two directions,
at times that neither speech nor head tell, minus a fraction of the head's rotation.

On its own past a decoder is a function of speech and head, so the minimiser of eq. 11 and 12 is the mean of gaze given
both: one constant direction less that fraction of the head. It moves as far as eyes compensate for the head.
On the true past the minimiser repeats the last frame, and generation, which has none but its own, stands still.
"""

import pytest
import torch
from test_gaze_models import CODEBOOK, TRANSFORMER

from talkingeyes.models.gaze.generator import GazeCondition
from talkingeyes.models.gaze.regression import RegressionGaze, RegressionGazeSettings
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings

pytestmark = pytest.mark.long
FRAMES, BATCH, FPS = 64, 16, 25.0
DIRECTION_RAD, HOLD_FRAMES = 0.15, 20
LAYERS = TRANSFORMER | {"width": 32, "lookback": FRAMES}


def world(compensation: float, seed: int, clips: int = BATCH) -> tuple[GazeCondition, torch.Tensor]:
    """Speech without content, head yaw of two sines, and eye-in-head in radians (B, T, 2, 3)."""
    random = torch.Generator().manual_seed(seed)
    time = torch.arange(FRAMES) / FPS
    phase = 2 * torch.pi * torch.rand(clips, 2, 1, generator=random)
    yaw = 0.08 * (
        torch.sin(2 * torch.pi * 0.4 * time + phase[:, 0]) + torch.sin(2 * torch.pi * 0.9 * time + phase[:, 1])
    )
    head = torch.zeros(clips, FRAMES, 3)
    head[..., 1] = yaw
    jumps = torch.rand(clips, FRAMES, generator=random) < 1 / HOLD_FRAMES
    side = torch.where((jumps.cumsum(1) + torch.randint(2, (clips, 1), generator=random)) % 2 == 0, 1.0, -1.0)
    gaze = torch.zeros(clips, FRAMES, 2, 3)
    gaze[..., 1] = (DIRECTION_RAD * side - compensation * yaw)[..., None]
    return GazeCondition(torch.zeros(clips, FRAMES, 1), head, head / 0.08), gaze


def learn(module: torch.nn.Module, loss, steps: int) -> None:
    optimiser = torch.optim.Adam(module.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 3e-3, steps)
    for step in range(steps):
        optimiser.zero_grad()
        loss(step).backward()
        optimiser.step()
        schedule.step()


def train(history: dict, compensation: float) -> RegressionGaze:
    """The VQ-VAE of eq. 5 to 7, frozen; then the decoder with its losses, standardised."""
    torch.manual_seed(0)
    tokenizer = GazeVQVAE(
        GazeVQVAESettings.model_validate(
            {
                "signal": "eye_in_head",
                "frames_per_code": 1,
                "stay_tolerance_deg": None,
                "norm": "standardised_mean",
                "standardised": True,
                "quantiser": CODEBOOK | {"codes": 64},
                "encoder": LAYERS,
                "decoder": LAYERS,
            }
        )
    ).train()
    tokenizer.normalise_by(torch.zeros(6), 0.1)

    def reconstruction(step: int) -> torch.Tensor:
        signal = world(compensation, step)[1].flatten(2)
        made = tokenizer(signal, torch.zeros(signal.shape[:2], dtype=torch.bool))
        return ((made.signal - signal) / 0.1).square().mean() + made.quantised.commitment

    learn(tokenizer, reconstruction, 200)
    decoder = RegressionGaze(
        RegressionGazeSettings.model_validate(
            {
                "kind": "regression",
                "transformer": LAYERS,
                "condition_lookback": 3,
                "condition_lookahead": 3,
                "history": history,
                "regularity": "nearest_codes",
            }
        ),
        1,
        tokenizer.freeze(),
    ).train()

    def losses(step: int) -> torch.Tensor:
        terms = decoder.loss_terms(*world(compensation, 1000 + step))
        return terms["gaze_reconstruction"] + terms["gaze_velocity"] + terms["gaze_regularity"]

    learn(decoder, losses, 250)
    return decoder.eval()


def speeds(yaw: torch.Tensor) -> float:
    return float(yaw.diff(dim=-1).abs().mean())


@pytest.mark.parametrize("kind", ["teacher_forcing", "predicted"])
def test_eyes_that_jump_at_times_of_their_own_stand_still(kind: str) -> None:
    decoder = train({"kind": kind}, compensation=0.0)
    condition, gaze = world(0.0, seed=-1)
    made = decoder.sample_batch([condition], [[0] * BATCH], 0.0)[0][..., 0, 1]
    assert speeds(made) < 0.1 * speeds(gaze[..., 0, 1])


def test_eyes_that_compensate_for_the_head_move_with_it() -> None:
    decoder = train({"kind": "predicted"}, compensation=1.0)
    condition, _ = world(1.0, seed=-1)
    made = decoder.sample_batch([condition], [[0] * BATCH], 0.0)[0][..., 0, 1]
    head = condition.head[..., 1]
    assert 0.8 < speeds(made) / speeds(head) < 1.2
    assert torch.corrcoef(torch.stack([made.flatten(), head.flatten()]))[0, 1] < -0.9
