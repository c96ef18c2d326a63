"""Gaze as fixations: when the next saccade starts and where it lands, in space; the law of saccades does the rest.

Not in the paper, whose decoder works frame by frame. A saccade is an event (layers/event_process.py) that leads to the
directions of both eyes; between saccades gaze rests in space and the eyes make up for the head. Frames show saccades
by the main sequence (physiology/saccades.py), so any frame rate can be made of the same events.
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

from talkingeyes.models.gaze.generator import Condition, uniforms
from talkingeyes.models.gaze.signal import gaze_of, signal_of
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.event_process import EventProcess, EventProcessSettings, EventSequence, binned
from talkingeyes.motion import Saccade
from talkingeyes.physiology import saccades
from talkingeyes.settings import PartSettings

# Fitted gaze rests between steps: what moves by less than EDGE a frame rests; what lands nearer than LEAST never left.
EDGE_RAD = np.radians(0.2)
LEAST_RAD = np.radians(0.7)
# Yaw and pitch where both eyes look together, and half the angle between them, which is much smaller.
SPREAD = (1.0, 0.7, 0.15)


class EventGazeSettings(PartSettings):
    """The process, and the rate of the frames that it is learnt from and shown in."""

    kind: Literal["events"]
    fps: Annotated[float, Field(gt=0)]
    process: EventProcessSettings


@dataclass(frozen=True)
class Fixations:
    """Frames in which a saccade starts, and where gaze is after the one that starts at or before each frame."""

    onset: Bool[Tensor, "B T"]
    landing: Float[Tensor, "B T 3"]


class EventGaze(nn.Module):
    """Fixations of speech and head."""

    scale: Tensor
    configured_by = EventGazeSettings

    def __init__(self, settings: EventGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        self.register_buffer("scale", torch.ones(()))
        self.fps, self.bin_frames = settings.fps, settings.process.bin_frames
        self.process = EventProcess(settings.process, speech + 3, SPREAD)

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """One scale for all angles; gaze in space has a mean near zero."""
        self.scale.fill_(scale)

    def terms(self, condition: Condition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """The likelihood of the fixations of true gaze."""
        found = fixations(both_eyes(signal_of("gaze_in_space", condition.head, gaze)))
        events = EventSequence.of_frames(found.onset, found.landing / self.scale, self.bin_frames)
        terms = self.process.terms(events, self._condition(condition))
        return {f"gaze_{name}": value for name, value in terms.items()}

    @torch.no_grad()
    def sample(self, condition: Condition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Fixations drawn bin after bin, shown as frames."""
        within = self._condition(condition)
        count = within.shape[1]
        uniform = uniforms(seeds, count * (len(SPREAD) + 3)).reshape(len(seeds), count, -1).to(within)
        drawn = self.process.sample(within, uniform, temperature)
        frames = condition.speech.shape[1]
        start = (torch.arange(count, device=within.device) + drawn.phase) * self.bin_frames
        made = [
            shown(
                start[row][event].cpu().numpy() / self.fps,
                (places[event] * self.scale).cpu().numpy().astype(float),
                np.arange(frames) / self.fps,
            )
            for row, (event, places) in enumerate(zip(drawn.event, drawn.place, strict=True))
        ]
        signal = torch.from_numpy(np.stack(made).astype(np.float32)).to(within)
        return gaze_of("gaze_in_space", condition.head, signal)

    def _condition(self, condition: Condition) -> Float[Tensor, "B N C"]:
        """Speech and head a bin: their means; the last bin is filled up by its last frame."""
        both = torch.cat([condition.speech, condition.head_normal], dim=-1)
        return binned(both, self.bin_frames)


def both_eyes(signal: Float[Tensor, "B T 4"]) -> Float[Tensor, "B T 3"]:
    """Yaw and pitch of the mean direction, and half the difference of the yaws (left less right)."""
    left, right = signal[..., :2], signal[..., 2:]
    return torch.cat([(left + right) / 2, (left - right)[..., :1] / 2], dim=-1)


def fixations(gaze: Float[Tensor, "B T 3"]) -> Fixations:
    """Where runs of steps start, and where each ends. Gaze is held over blinks by the fit, so a blink is no event."""
    step = gaze[..., :2].diff(dim=1).norm(dim=-1)
    moving = torch.nn.functional.pad(step >= EDGE_RAD, (0, 1))
    order = torch.arange(gaze.shape[1], device=gaze.device).expand(moving.shape)
    rest = torch.where(moving, gaze.shape[1] - 1, order).flip(1).cummin(dim=1).values.flip(1)
    landing = gaze.gather(1, rest[..., None].expand(-1, -1, 3))
    starts = moving & ~torch.nn.functional.pad(moving[:, :-1], (1, 0))
    far = (landing - gaze)[..., :2].norm(dim=-1) >= LEAST_RAD
    return Fixations(starts & far, landing)


def shown(
    onsets_s: Float[ndarray, " K"], places_rad: Float[ndarray, "K 3"], times_s: Float[ndarray, " T"]
) -> Float[ndarray, "T 4"]:
    """Yaw and pitch of both eyes at any times: saccades by the law, each from where the last one ended.

    The first place is where gaze begins; a saccade that would start before the last one has ended waits for it.
    """
    chain: list[Saccade] = []
    free_s = 0.0
    for onset_s, start, end in zip(onsets_s[1:], places_rad[:-1], places_rad[1:], strict=True):
        amplitude = float(np.hypot(*(end - start)[:2]))
        begins_s, duration_s = max(float(onset_s), free_s), float(saccades.duration_s(amplitude))
        chain.append(Saccade(begins_s, duration_s, tuple(start[:2]), tuple(end[:2]), float(saccades.skew(amplitude))))
        free_s = begins_s + duration_s
    together = saccades.path(chain, places_rad[0, :2], times_s)
    knots_s = [time for each in chain for time in (each.onset_s, each.onset_s + each.duration_s)]
    apart = np.interp(times_s, [0.0, *knots_s], np.repeat(places_rad[:, 2], 2)[:-1])[:, None] * [1.0, 0.0]
    return np.concatenate([together + apart, together - apart], axis=1)
