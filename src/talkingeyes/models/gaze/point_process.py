"""Gaze as a point process of saccades: when the next saccade starts and where it lands, in space.

Not in the paper, whose decoder works frame by frame. A saccade is an event (models/layers/point_process.py) whose
location is the direction of both eyes. Between saccades, gaze rests in space and the eyes compensate for the head.
Saccades are rendered by the main sequence (physiology/saccades.py), so the same events can be rendered at any frame
rate. A process without lookahead (conf/model/talkingeyes_live.yaml) can be sampled bin by bin, as streaming needs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.gaze.gaze_signal import to_signal_tensor
from talkingeyes.models.gaze.generator import GazeCondition, uniform_noise
from talkingeyes.models.gaze.saccade_rendering import SEED_OFFSET, SaccadeSequence, eyes_towards, render_saccades
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.numpy_point_process import Guidance, SamplerState
from talkingeyes.models.layers.point_process import (
    CausalPointProcessSettings,
    EventSequence,
    PointProcess,
    PointProcessSettings,
    bin_means,
)
from talkingeyes.models.layers.point_process_sampler import make_sampler, sample_events
from talkingeyes.models.layers.uniform_rows import UniformRows

# Gaze moves in frames with a step of at least MIN_STEP_RAD; saccades smaller than MIN_AMPLITUDE_RAD are ignored.
MIN_STEP_RAD = np.radians(0.2)
MIN_AMPLITUDE_RAD = np.radians(0.7)
# Yaw and pitch of cyclopean gaze, and half the vergence angle, which is much smaller.
LOCATION_SPREAD = (1.0, 0.7, 0.15)


class PointProcessGazeSettings(ComponentSettings):
    """Settings of the process, frame rate of the training data and samples, and observation noise."""

    kind: Literal["point_process"]
    fps: Annotated[float, Field(gt=0)]
    # Strengthens what speech changes, in sampling alone (docs/log/2026-11-26-guidance-of-probabilities.md).
    guidance: Guidance
    # Standard deviation of the noise on yaw and pitch of fixations in the training data; samples are free of it.
    observation_noise_deg: Annotated[float, Field(ge=0)]
    process: CausalPointProcessSettings | PointProcessSettings


@dataclass(frozen=True)
class SaccadeLandings:
    """Frames where a saccade starts, and the landing location of the last saccade that started up to each frame."""

    onset: Bool[Tensor, "B T"]
    landing: Float[Tensor, "B T 3"]


class PointProcessGaze(nn.Module):
    """Generator of fixations from speech and head motion."""

    scale: Tensor
    centre: Tensor
    settings_class = PointProcessGazeSettings

    def __init__(self, settings: PointProcessGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        self.register_buffer("scale", torch.ones(()))
        self.register_buffer("centre", torch.zeros(len(LOCATION_SPREAD)))
        self.fps, self.bin_frames, self.guidance = settings.fps, settings.process.bin_frames, settings.guidance
        self._observation_noise_rad = float(np.radians(settings.observation_noise_deg))
        self.process = PointProcess(settings.process, speech + 3, LOCATION_SPREAD)

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """Set one scale for all angles, and the vergence of the mean gaze as centre. Yaw and pitch of gaze in space
        have a mean near zero. Vergence does not: without centring, all mixture centres would lie at locations that
        never occur."""
        still = torch.zeros(1, 1, 3, device=mean.device)
        self.centre[2] = cyclopean_and_vergence(to_signal_tensor("gaze_in_space", still, mean.reshape(1, 1, 2, 3)))[
            0, 0, 2
        ]
        self.scale.fill_(scale)
        self.process.observation_noise[:2] = self._observation_noise_rad / scale

    def loss_terms(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Negative log-likelihood of the fixations of true gaze."""
        loss_terms = self.process.loss_terms(self._events(condition, gaze), self.binned_condition(condition))
        return {f"gaze_{name}": value for name, value in loss_terms.items()}

    def log_likelihood(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Log-likelihood of the saccades of true gaze: when they start (`time`), and where they land."""
        return self.process.log_likelihood(self._events(condition, gaze), self.binned_condition(condition))

    def _events(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> EventSequence:
        found = saccade_landings(cyclopean_and_vergence(to_signal_tensor("gaze_in_space", condition.head, gaze)))
        return EventSequence.from_frames(found.onset, (found.landing - self.centre) / self.scale, self.bin_frames)

    @torch.no_grad()
    def sample(self, condition: GazeCondition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Sample fixations bin by bin and render them to frames."""
        binned_condition, *neutral = map(self.binned_condition, self.variants(condition))
        count = binned_condition.shape[1]
        uniform = (
            uniform_noise(seeds, count * (len(LOCATION_SPREAD) + 3)).reshape(len(seeds), count, -1).to(binned_condition)
        )
        sampled = sample_events(self.process, binned_condition, uniform, temperature, self.guidance, *neutral)
        times_s = np.arange(condition.speech.shape[1]) / self.fps
        starts_s = (np.arange(count) + sampled.phase) * self.bin_frames / self.fps
        return _eyes(
            condition.head, render_saccades(sampled.event, starts_s, self.to_radians(sampled.location), times_s)
        )

    @property
    def is_guided(self) -> bool:
        """Whether sampling needs `mean_speech`."""
        return not self.guidance.is_one

    def variants(self, condition: GazeCondition) -> list[GazeCondition]:
        """The condition, and with guidance that of mean speech."""
        if not self.is_guided:
            return [condition]
        assert condition.mean_speech is not None
        return [condition, replace(condition, speech=condition.mean_speech)]

    @property
    def step_frames(self) -> int:
        """Frames per bin."""
        return self.bin_frames

    @property
    def has_lookahead(self) -> bool:
        """Whether an event depends on speech and head after its bin."""
        return self.process.condition_encoder.lookahead != 0

    def streaming(self, temperature: float) -> StreamingPointProcess:
        """Gaze for streams, which yield the result of `sample` bin by bin."""
        return StreamingPointProcess(self, temperature)

    def to_radians(self, locations: Float[ndarray, "*K 3"]) -> Float[ndarray, "*K 3"]:
        """Locations in radians, normalisation undone."""
        return np.asarray(locations * self.scale.cpu().numpy() + self.centre.cpu().numpy(), float)

    def binned_condition(self, condition: GazeCondition) -> Float[Tensor, "B N C"]:
        """Means of speech and head per bin; the last bin is padded by its last frame."""
        both = torch.cat([condition.speech, condition.normalised_head], dim=-1)
        return bin_means(both, self.bin_frames)


def _eyes(head: Float[Tensor, "B T 3"], signal: Float[ndarray, "B T 4"]) -> Float[Tensor, "B T 2 3"]:
    """`eyes_towards` for tensors."""
    return torch.from_numpy(eyes_towards(head.cpu().numpy(), signal)).to(head)


def cyclopean_and_vergence(signal: Float[Tensor, "B T 4"]) -> Float[Tensor, "B T 3"]:
    """Yaw and pitch of cyclopean gaze, and half the difference of the yaws (left minus right)."""
    left, right = signal[..., :2], signal[..., 2:]
    return torch.cat([(left + right) / 2, (left - right)[..., :1] / 2], dim=-1)


def saccade_landings(gaze: Float[Tensor, "B T 3"]) -> SaccadeLandings:
    """Onsets and landings of runs of moving frames. The fit holds gaze over blinks, so a blink is not an event."""
    step = gaze[..., :2].diff(dim=1).norm(dim=-1)
    moving = torch.nn.functional.pad(step >= MIN_STEP_RAD, (0, 1))
    order = torch.arange(gaze.shape[1], device=gaze.device).expand(moving.shape)
    rest = torch.where(moving, gaze.shape[1] - 1, order).flip(1).cummin(dim=1).values.flip(1)
    landing = gaze.gather(1, rest[..., None].expand(-1, -1, 3))
    starts = moving & ~torch.nn.functional.pad(moving[:, :-1], (1, 0))
    far = (landing - gaze)[..., :2].norm(dim=-1) >= MIN_AMPLITUDE_RAD
    return SaccadeLandings(starts & far, landing)


@dataclass(frozen=True)
class EventStream:
    """A stream between two bins: the next bin, its uniform numbers, the past of the condition (with guidance of both
    variants), the state of the sampler and the saccades so far (None before the first bin)."""

    bin: int
    uniform: UniformRows
    past: Float[ndarray, "V P W"]
    run: SamplerState | None = None
    chain: SaccadeSequence | None = None


class StreamingPointProcess:
    """Gaze of many streams, bin by bin. The frames of a bin do not depend on later events."""

    def __init__(self, gaze: PointProcessGaze, temperature: float) -> None:
        self._gaze, self._sampler = gaze, make_sampler(gaze.process, temperature, gaze.guidance)
        self._condition_encoder = gaze.process.condition_encoder.streaming()

    def begin(self, seed: int) -> EventStream:
        """A stream before its first bin."""
        uniform = UniformRows(torch.Generator().manual_seed(seed + SEED_OFFSET), len(LOCATION_SPREAD) + 3)
        return EventStream(0, uniform, np.stack([self._condition_encoder.begin()] * (1 + self._gaze.is_guided)))

    def step(
        self, states: Sequence[EventStream], condition: GazeCondition
    ) -> tuple[Float[Tensor, "B T 2 3"], list[EventStream]]:
        """Frames of the next bin of each stream (fewer at its end), and the streams after them."""
        past = np.stack([each.past for each in states])
        binned = np.stack(
            [self._gaze.binned_condition(each).numpy() for each in self._gaze.variants(condition)], axis=1
        )
        encoded, kept = self._condition_encoder.step(
            past.reshape(-1, *past.shape[2:]), binned.reshape(-1, *binned.shape[2:])
        )
        encoded = encoded.reshape(*past.shape[:2], -1).swapaxes(0, 1)  # variant, stream
        uniform = torch.cat([each.uniform.rows(each.bin, each.bin + 1) for each in states]).numpy()
        runs, chains = self._sample(states, encoded, uniform)
        frames = condition.head.shape[1]
        firsts = [each.bin * self._gaze.bin_frames for each in states]
        times_s = (np.array(firsts)[:, None] + np.arange(frames)) / self._gaze.fps
        signal = np.stack([chain.at(times) for chain, times in zip(chains, times_s, strict=True)])
        for chain, times in zip(chains, times_s, strict=True):
            chain.discard_before(times[-1])
        after = [
            EventStream(each.bin + 1, each.uniform, own.copy(), run, chain)
            for each, own, run, chain in zip(states, kept.reshape(past.shape), runs, chains, strict=True)
        ]
        return _eyes(condition.head, signal), after

    def _sample(
        self, states: Sequence[EventStream], encoded: Float[ndarray, "V B W"], uniform: Float[ndarray, "B U"]
    ) -> tuple[list[SamplerState], list[SaccadeSequence]]:
        """Sampler and saccades of each stream after the next bin."""
        gaze = self._gaze
        is_new = np.array([each.run is None for each in states])
        new, old = np.flatnonzero(is_new), np.flatnonzero(~is_new)
        runs: dict[int, SamplerState] = {}
        chains = {row: copy(each.chain) for row, each in enumerate(states) if each.chain is not None}
        if len(new):
            begun = self._sampler.begin(encoded[:, new], uniform[new])
            runs |= dict(zip(new.tolist(), begun.rows(), strict=True))
            chains |= {row: SaccadeSequence(gaze.to_radians(runs[row].location[0])) for row in new.tolist()}
        if len(old):
            run = SamplerState.concat([each.run for each in states if each.run is not None])
            events = old[self._sampler.advance(run, encoded[:, old], uniform[old])].tolist()
            runs |= dict(zip(old.tolist(), run.rows(), strict=True))
            for row in events:
                onset_s = (states[row].bin + uniform[row, 1:2]) * gaze.bin_frames / gaze.fps
                chains[row].add_saccades(onset_s, gaze.to_radians(runs[row].location))
        rows = range(len(states))
        return [runs[row] for row in rows], [chains[row] for row in rows]
