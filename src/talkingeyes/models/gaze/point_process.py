"""Gaze as a point process of saccades: when the next saccade starts and where it lands, in space.

Not in the paper, whose decoder works frame by frame. A saccade is an event (models/layers/point_process.py) that leads
to the directions of both eyes; between saccades gaze rests in space and the eyes compensate for the head. Frames show
saccades by the main sequence (physiology/saccades.py), so any frame rate can be rendered from the same events. With a
process without lookahead (conf/model/talkingeyes_live.yaml), gaze can be sampled bin by bin, as streaming needs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.gaze.gaze_signal import to_gaze, to_signal_tensor
from talkingeyes.models.gaze.generator import SEED_OFFSET, GazeCondition, uniform_noise
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.convolution import CausalConvolutionStack
from talkingeyes.models.layers.point_process import (
    CausalPointProcessSettings,
    EventSequence,
    PointProcess,
    PointProcessSettings,
    bin_means,
)
from talkingeyes.models.layers.point_process_sampler import Sampler, SamplerState
from talkingeyes.physiology import eye_head, saccades

# Fitted gaze rests between steps: what moves by less than EDGE a frame rests; what lands nearer than LEAST never left.
MIN_STEP_RAD = np.radians(0.2)
MIN_AMPLITUDE_RAD = np.radians(0.7)
MAX_SACCADE_S = 1.0  # no saccade takes so long
# Yaw and pitch where both eyes look together, and half the angle between them, which is much smaller.
LOCATION_SPREAD = (1.0, 0.7, 0.15)


class PointProcessGazeSettings(ComponentSettings):
    """The process, the rate of the frames that it is learnt from and shown in, and how far off those are."""

    kind: Literal["point_process"]
    fps: Annotated[float, Field(gt=0)]
    # Standard deviation of the yaw and pitch of a fixation in what is learnt from; drawn saccades do without.
    observation_noise_deg: Annotated[float, Field(ge=0)]
    process: CausalPointProcessSettings | PointProcessSettings


@dataclass(frozen=True)
class SaccadeLandings:
    """Frames in which a saccade starts, and where gaze is after the one that starts at or before each frame."""

    onset: Bool[Tensor, "B T"]
    landing: Float[Tensor, "B T 3"]


class PointProcessGaze(nn.Module):
    """Fixations of speech and head."""

    scale: Tensor
    centre: Tensor
    settings_class = PointProcessGazeSettings

    def __init__(self, settings: PointProcessGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        self.register_buffer("scale", torch.ones(()))
        self.register_buffer("centre", torch.zeros(len(LOCATION_SPREAD)))
        self.fps, self.bin_frames = settings.fps, settings.process.bin_frames
        self._observation_noise_rad = float(np.radians(settings.observation_noise_deg))
        self.process = PointProcess(settings.process, speech + 3, LOCATION_SPREAD)

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """One scale for all angles. Gaze in space has a mean near zero, but for the angle between the eyes' axes: left
        out of the centre, it would put all places of the Gaussians where no eyes ever look."""
        still = torch.zeros(1, 1, 3, device=mean.device)
        self.centre[2] = cyclopean_and_vergence(to_signal_tensor("gaze_in_space", still, mean.reshape(1, 1, 2, 3)))[
            0, 0, 2
        ]
        self.scale.fill_(scale)
        self.process.observation_noise[:2] = self._observation_noise_rad / scale

    def loss_terms(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """The likelihood of the fixations of true gaze."""
        found = saccade_landings(cyclopean_and_vergence(to_signal_tensor("gaze_in_space", condition.head, gaze)))
        events = EventSequence.from_frames(found.onset, (found.landing - self.centre) / self.scale, self.bin_frames)
        loss_terms = self.process.loss_terms(events, self.binned_condition(condition))
        return {f"gaze_{name}": value for name, value in loss_terms.items()}

    @torch.no_grad()
    def sample(self, condition: GazeCondition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Fixations drawn bin after bin, shown as frames."""
        binned_condition = self.binned_condition(condition)
        count = binned_condition.shape[1]
        uniform = (
            uniform_noise(seeds, count * (len(LOCATION_SPREAD) + 3)).reshape(len(seeds), count, -1).to(binned_condition)
        )
        sampled = self.process.sample(binned_condition, uniform, temperature)
        times_s = np.arange(condition.speech.shape[1]) / self.fps
        starts_s = (np.arange(count) + sampled.phase) * self.bin_frames / self.fps
        return _eyes(condition.head, render_saccades(sampled.event, starts_s, self.radians(sampled.location), times_s))

    @property
    def step_frames(self) -> int:
        """A bin."""
        return self.bin_frames

    @property
    def has_lookahead(self) -> bool:
        """Whether an event depends on speech and head after its bin."""
        condition_encoder = self.process.condition_encoder
        return not isinstance(condition_encoder, CausalConvolutionStack) or condition_encoder.lookahead > 0

    def stream(self, seed: int, temperature: float) -> PointProcessGazeStream:
        """Bin after bin what `sample` gives."""
        return PointProcessGazeStream(self, seed, temperature)

    def radians(self, locations: Float[ndarray, "*K 3"]) -> Float[ndarray, "*K 3"]:
        """Places as they are shown."""
        return np.asarray(locations * self.scale.cpu().numpy() + self.centre.cpu().numpy(), float)

    def binned_condition(self, condition: GazeCondition) -> Float[Tensor, "B N C"]:
        """Speech and head a bin: their means; the last bin is filled up by its last frame."""
        both = torch.cat([condition.speech, condition.normalised_head], dim=-1)
        return bin_means(both, self.bin_frames)


def _eyes(head: Float[Tensor, "B T 3"], signal: Float[ndarray, "B T 4"]) -> Float[Tensor, "B T 2 3"]:
    """Eyes in the head that look there in space, no further than eyes turn: then they go with the head."""
    gaze = to_gaze("gaze_in_space", head.cpu().numpy(), signal.astype(np.float32))
    return torch.from_numpy(eye_head.clamp_to_eye_range(gaze)).to(head)


def cyclopean_and_vergence(signal: Float[Tensor, "B T 4"]) -> Float[Tensor, "B T 3"]:
    """Yaw and pitch of the mean direction, and half the difference of the yaws (left less right)."""
    left, right = signal[..., :2], signal[..., 2:]
    return torch.cat([(left + right) / 2, (left - right)[..., :1] / 2], dim=-1)


def saccade_landings(gaze: Float[Tensor, "B T 3"]) -> SaccadeLandings:
    """Where runs of steps start, and where each ends. Gaze is held over blinks by the fit, so a blink is no event."""
    step = gaze[..., :2].diff(dim=1).norm(dim=-1)
    moving = torch.nn.functional.pad(step >= MIN_STEP_RAD, (0, 1))
    order = torch.arange(gaze.shape[1], device=gaze.device).expand(moving.shape)
    rest = torch.where(moving, gaze.shape[1] - 1, order).flip(1).cummin(dim=1).values.flip(1)
    landing = gaze.gather(1, rest[..., None].expand(-1, -1, 3))
    starts = moving & ~torch.nn.functional.pad(moving[:, :-1], (1, 0))
    far = (landing - gaze)[..., :2].norm(dim=-1) >= MIN_AMPLITUDE_RAD
    return SaccadeLandings(starts & far, landing)


class SaccadeSequence:
    """Yaw and pitch of both eyes, and half the angle between them, over time: saccades by the law, each from where the
    last one ended. One that would start before the last one has ended waits for it. What is over may be forgotten.
    """

    def __init__(self, location_rad: Float[ndarray, " 3"]) -> None:
        """Where gaze begins."""
        self._location_rad = location_rad
        self._timing = np.empty((0, 3))  # onset and duration in seconds, skew
        self._from_rad, self._to_rad = np.empty((0, 3)), np.empty((0, 3))

    def __len__(self) -> int:
        return len(self._timing)

    def add_saccades(self, onsets_s: Float[ndarray, " K"], to_rad: Float[ndarray, "K 3"]) -> None:
        """K saccades more; none starts before the one before it."""
        start = np.concatenate([self._location_rad[None], to_rad])
        amplitude = np.hypot(*(to_rad - start[:-1])[:, :2].T)
        duration_s = saccades.duration_s(amplitude)
        before_s = np.cumsum(duration_s) - duration_s
        free_s = self._timing[-1:, :2].sum(1)  # when the last one has ended
        onset_s = before_s + np.maximum.accumulate(np.concatenate([free_s, onsets_s - before_s]))[len(free_s) :]
        timing = np.stack([onset_s, duration_s, saccades.skew(amplitude)], axis=1)
        self._timing = np.concatenate([self._timing, timing])
        self._from_rad = np.concatenate([self._from_rad, start[:-1]])
        self._to_rad, self._location_rad = np.concatenate([self._to_rad, to_rad]), start[-1]

    def at(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 4"]:
        """Left yaw and pitch, right yaw and pitch."""
        if not len(self):
            cyclopean, half_vergence = (
                np.tile(self._location_rad[:2], (len(times_s), 1)),
                np.full(len(times_s), self._location_rad[2]),
            )
        else:
            onset_s, duration_s, skew = self._timing.T
            now = saccades.saccade_progress(onset_s, duration_s, skew, times_s)
            start, way = self._from_rad[now.index], (self._to_rad - self._from_rad)[now.index]
            cyclopean = start[:, :2] + way[:, :2] * now.completed[:, None]
            half_vergence = start[:, 2] + way[:, 2] * now.phase
        signal = np.concatenate([cyclopean, cyclopean], axis=1)
        signal[:, 0] += half_vergence
        signal[:, 2] -= half_vergence
        return signal

    def discard_before(self, time_s: float) -> None:
        """Nothing before this time will be asked for."""
        over = max(int(np.searchsorted(self._timing[:, 0], time_s, side="right")) - 1, 0)
        self._timing, self._from_rad, self._to_rad = (
            each[over:] for each in (self._timing, self._from_rad, self._to_rad)
        )


def render_saccades(
    event: Bool[ndarray, "B N"],
    onsets_s: Float[ndarray, "B N"],
    locations_rad: Float[ndarray, "B N 3"],
    times_s: Float[ndarray, " T"],
) -> Float[ndarray, "B T 4"]:
    """Yaw and pitch of both eyes at any times; the first event of a row is where its gaze begins.

    All rows are one chain, one after the other, for many small steps of numpy cost more than one long one.
    """
    row, index = np.nonzero(event)
    # Between two rows there is more time than all saccades of one take, should they wait for each other.
    begins_s = np.arange(len(event)) * (times_s[-1] + MAX_SACCADE_S * (event.shape[1] + 1))
    onset_s = begins_s[row] + np.where(index, onsets_s[row, index], -MAX_SACCADE_S)
    chain = SaccadeSequence(locations_rad[0, 0])
    chain.add_saccades(onset_s, locations_rad[row, index])
    signal = chain.at((begins_s[:, None] + times_s).ravel())
    return signal.reshape(len(event), len(times_s), 4)


class PointProcessGazeStream:
    """Gaze of one seed, bin after bin. What is shown in a bin depends on no event after it."""

    def __init__(self, gaze: PointProcessGaze, seed: int, temperature: float) -> None:
        assert isinstance(gaze.process.condition_encoder, CausalConvolutionStack)
        self._gaze, self._sampler = gaze, Sampler(gaze.process, temperature)
        self._condition_encoder = gaze.process.condition_encoder.stream()
        self._uniform = torch.Generator().manual_seed(seed + SEED_OFFSET)
        self._bin = 0
        self._run: SamplerState | None = None
        self._chain: SaccadeSequence | None = None

    def step(self, condition: GazeCondition) -> Float[Tensor, "1 T 2 3"]:
        """The frames of the next bin, or of its beginning where the stream ends."""
        gaze = self._gaze
        uniform = torch.rand(1, len(LOCATION_SPREAD) + 3, generator=self._uniform).numpy()
        encoded_condition = self._condition_encoder.step(gaze.binned_condition(condition)[0].numpy())
        if self._run is None or self._chain is None:
            self._run = self._sampler.begin(encoded_condition, uniform)
            self._chain = SaccadeSequence(gaze.radians(self._run.location[0]))
        elif self._sampler.advance(self._run, encoded_condition, uniform).any():
            onset_s = (self._bin + uniform[:, 1]) * gaze.bin_frames / gaze.fps
            self._chain.add_saccades(onset_s, gaze.radians(self._run.location))
        first, self._bin = self._bin * gaze.bin_frames, self._bin + 1
        times_s = np.arange(first, first + condition.head.shape[1]) / gaze.fps
        signal = self._chain.at(times_s)[None]
        self._chain.discard_before(times_s[-1])
        return _eyes(condition.head, signal)
