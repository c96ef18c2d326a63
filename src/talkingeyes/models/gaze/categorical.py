"""Categorical variant of the cross-modal gaze decoder: it predicts a distribution over codes (eq. 9, other output).

The paper regresses features and looks up the nearest code, which freezes in free running (docs/log.md). Here the same
cross-modal causal transformer outputs a distribution over the codes of several frames of gaze in space and a stay
token, trained by cross-entropy and sampled at a temperature. The position and the dwell so far, functions of past
codes, are inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.gaze.gaze_signal import find_stays, split_gaze, to_gaze_tensor, to_signal_tensor
from talkingeyes.models.gaze.generator import GazeCondition, concat_padded, uniform_noise
from talkingeyes.models.gaze.history import (
    CodeHistorySettings,
    NoisyTeacherForcing,
    ScheduledSampling,
    replacement_mask,
)
from talkingeyes.models.gaze.saccade_rendering import SEED_OFFSET
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.categorical_sampling import sample_categorical
from talkingeyes.models.layers.quantiser import squared_distances
from talkingeyes.models.layers.transformer import Cache, CausalTransformer, CrossAttentionWindow, TransformerSettings
from talkingeyes.models.layers.uniform_rows import UniformRows


class CategoricalGazeSettings(ComponentSettings):
    """Settings of the decoder over codes."""

    kind: Literal["categorical"]
    transformer: TransformerSettings
    # Numbers of condition steps before and after its own that cross-attention uses.
    condition_lookback: Annotated[int, Field(ge=0)]
    condition_lookahead: Annotated[int, Field(ge=0)]
    # Fraction of past codes hidden in training, against the mismatch between teacher forcing and free running.
    history_dropout: Annotated[float, Field(ge=0, lt=1)]
    # The history used in training.
    history: CodeHistorySettings


@dataclass(frozen=True)
class _History:
    """History of each code: the code before it, the last frame (normalised), and the number of stays since the last
    move."""

    before: Int[Tensor, "B N"]
    last_frame: Float[Tensor, "B N F"]
    dwell: Int[Tensor, "B N"]


@dataclass
class DecoderState:
    """State between two codes in free running: the history of the next code, and the caches of both networks."""

    before: Int[Tensor, " B"]
    last_frame: Float[Tensor, "B F"]
    dwell: Int[Tensor, " B"]
    cache: Cache
    decoder_cache: Cache


class CategoricalGaze(nn.Module):
    """Distribution over codes and the stay token (the last index), given history and a condition of speech and head."""

    settings_class = CategoricalGazeSettings

    def __init__(self, settings: CategoricalGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        if codebook is None:
            raise InputError("model.tokenizer: should name a codebook for categorical gaze, got null")
        self.settings, self.codebook, self.trained_steps = settings, codebook, 0
        self.patch_frames = codebook.settings.frames_per_code
        width = settings.transformer.width
        self.stay = codebook.settings.quantiser.codes
        self.embed = nn.Embedding(self.stay + 2, width)
        self.state_projection = nn.Linear(len(codebook.mean) + 1, width)
        self.condition = nn.Linear(speech + 3 * self.patch_frames, width)
        self.transformer = CausalTransformer(
            settings.transformer, CrossAttentionWindow(settings.condition_lookback, settings.condition_lookahead)
        )
        self.out = nn.Linear(width, self.stay + 1)

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """Do nothing: the codebook has its own statistics."""

    def loss_terms(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Cross-entropy of the codes of true gaze, given the true history or, in training, that of `history`."""
        codes, history = self._encode(condition.head, gaze)
        memory = self.memory(condition)
        if self.training and isinstance(self.settings.history, NoisyTeacherForcing):
            history = self._noisy_history(self.settings.history, codes)
        if self.training and isinstance(self.settings.history, ScheduledSampling):
            history = self._scheduled_history(self.settings.history, codes, self._logits(history, memory).detach())
        return {"gaze_codes": F.cross_entropy(self._logits(history, memory).flatten(0, 1), codes.flatten())}

    def log_likelihood(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Log-likelihood of the codes of true gaze (`codes`), without the first and without a part of a code at the
        end."""
        codes, history = self._encode(condition.head, gaze)
        memory = self.memory(condition)[:, : codes.shape[1]]
        likelihood = self._logits(history, memory).log_softmax(-1).gather(2, codes[..., None])
        return {"codes": likelihood[:, 1:, 0].sum(1)}

    @torch.no_grad()
    def sample(self, condition: GazeCondition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Sample codes autoregressively. D_VQ decodes gaze in space; the eyes compensate for the head."""
        return self.sample_batch([condition], [seeds], temperature)[0]

    @torch.no_grad()
    def sample_batch(
        self, conditions: Sequence[GazeCondition], seeds: Sequence[list[int]], temperature: float
    ) -> list[Float[Tensor, "_ _ 2 3"]]:
        """`sample` for each of several conditions of any lengths, in one batch."""
        memory, lengths = concat_padded([self.memory(each) for each in conditions])
        uniform = uniform_noise([seed for each in seeds for seed in each], memory.shape[1]).to(memory.device)
        run = self.start(len(memory), memory, lengths)
        patches = [self.advance(run, memory[:, [step]], column, temperature) for step, column in enumerate(uniform.T)]
        return split_gaze(self.codebook.settings.signal, [each.head for each in conditions], torch.cat(patches, dim=1))

    @property
    def step_frames(self) -> int:
        """Frames per code."""
        return self.patch_frames

    @property
    def has_lookahead(self) -> bool:
        """Whether a code depends on later speech and head motion."""
        return self.settings.condition_lookahead > 0

    def streaming(self, temperature: float) -> StreamingCategoricalGaze:
        """Gaze for streams, which yield the result of `sample` code by code."""
        return StreamingCategoricalGaze(self, temperature)

    def start(
        self, batch: int, memory: Float[Tensor, "B N W"] | None = None, lengths: Int[Tensor, " B"] | None = None
    ) -> DecoderState:
        """State before the first code; `lengths`: codes of each row that are no padding. In a stream, the memory is not
        yet known and is appended to the cache later."""
        before = torch.full((batch,), self.stay + 1, device=self.codebook.mean.device)
        last_frame = self.codebook.mean.expand(batch, -1)
        cache, decoder_cache = self.transformer.start(memory, lengths), self.codebook.decoder.start()
        return DecoderState(before, last_frame, torch.zeros_like(before), cache, decoder_cache)

    def advance(
        self, run: DecoderState, memory: Float[Tensor, "B 1 W"], uniform: Float[Tensor, " B"], temperature: float
    ) -> Float[Tensor, "B P F"]:
        """Sample the next code from a uniform number and return its signal; updates the state."""
        normal = (run.last_frame - self.codebook.mean) / self.codebook.scale
        x = self._query(_History(run.before[:, None], normal[:, None], run.dwell[:, None]))
        first = run.cache.position == 0
        logits = self.out(self.transformer.step(x + memory, run.cache))
        logits = self._mask_first_stay(logits) if first else logits
        run.before = sample_categorical(logits[:, 0], uniform, temperature)
        stay = run.before == self.stay
        values = self.codebook.code_values(run.before)
        patch = self.codebook.step(values, stay, None if first else run.last_frame, run.decoder_cache)
        run.last_frame = patch[:, -1]
        run.dwell = torch.where(stay, run.dwell + 1, 0)
        return patch

    @torch.no_grad()
    def _encode(self, head: Tensor, gaze: Tensor) -> tuple[Int[Tensor, "B N"], _History]:
        """Codes of true gaze (stays by the tolerance of the codebook) and their history."""
        frames = head.shape[1] // self.patch_frames * self.patch_frames
        name = self.codebook.settings.signal
        signal = to_signal_tensor(name, head[:, :frames], gaze[:, :frames])
        stay = stay_mask(self.codebook, signal)
        with torch.autocast(signal.device.type, enabled=False):  # the precision of generation
            quantised = self.codebook.quantiser(self.codebook.encode(signal))
            codes = torch.where(stay, self.stay, quantised.indices)
            return codes, self._history(codes, quantised.values)

    @torch.no_grad()
    def _history(self, codes: Int[Tensor, "B N"], values: Float[Tensor, "B N C"]) -> _History:
        """History of each of these codes with the given values."""
        stay = codes == self.stay
        with torch.autocast(values.device.type, enabled=False):
            rendered = self.codebook.render(values, stay)
        last = ((rendered - self.codebook.mean) / self.codebook.scale)[:, self.patch_frames - 1 :: self.patch_frames]
        order = torch.arange(stay.shape[1], device=stay.device).expand_as(stay)
        dwell = order - torch.where(stay, 0, order).cummax(dim=1).values
        return _History(
            torch.cat([torch.full_like(codes[:, :1], self.stay + 1), codes[:, :-1]], dim=1),
            torch.cat([torch.zeros_like(last[:, :1]), last[:, :-1]], dim=1),
            torch.cat([torch.zeros_like(dwell[:, :1]), dwell[:, :-1]], dim=1),
        )

    def _noisy_history(self, settings: NoisyTeacherForcing, codes: Int[Tensor, "B N"]) -> _History:
        """History of codes close to the true ones; stays are kept."""
        table, values = self.codebook.quantiser.codebook, self.codebook.code_values(codes)
        moved = values + settings.sigma * table.std() * torch.randn_like(values)
        near = torch.where(codes == self.stay, self.stay, squared_distances(moved, table).argmin(-1))
        return self._history(near, self.codebook.code_values(near))

    def _scheduled_history(
        self, settings: ScheduledSampling, codes: Int[Tensor, "B N"], logits: Float[Tensor, "B N K"]
    ) -> _History:
        """History of true codes, a fraction of them replaced by samples of a first pass (Gumbel-max trick)."""
        sampled = (logits - (-torch.rand_like(logits).clamp(1e-9, 1 - 1e-7).log()).log()).argmax(-1)
        mixed_codes = torch.where(replacement_mask(settings, self.trained_steps, logits[..., 0]), sampled, codes)
        return self._history(mixed_codes, self.codebook.code_values(mixed_codes))

    def _logits(self, history: _History, memory: Float[Tensor, "B N W"]) -> Float[Tensor, "B N K"]:
        """Logits of all codes in parallel."""
        return self._mask_first_stay(self.out(self.transformer(self._query(history) + memory, memory)))

    def memory(self, condition: GazeCondition) -> Float[Tensor, "B N W"]:
        """Condition per code from speech and head; the last patch is padded by its last frame."""
        speech = condition.speech
        missing = -speech.shape[1] % self.patch_frames
        both = torch.cat([speech, condition.normalised_head], dim=-1)
        both = torch.cat([both, both[:, -1:].expand(-1, missing, -1)], dim=1).unflatten(1, (-1, self.patch_frames))
        pooled = both[..., : speech.shape[-1]].mean(2)
        out: Tensor = self.condition(torch.cat([pooled, both[..., speech.shape[-1] :].flatten(2)], dim=-1))
        return out

    def _query(self, history: _History) -> Float[Tensor, "B N W"]:
        x = self.embed(history.before)
        if self.training:
            x = x * (torch.rand(x.shape[:2], device=x.device) >= self.settings.history_dropout)[..., None]
        out: Tensor = x + self.state_projection(
            torch.cat([history.last_frame, history.dwell[..., None].float().log1p()], dim=-1)
        )
        return out

    def _mask_first_stay(self, logits: Float[Tensor, "B N K"]) -> Float[Tensor, "B N K"]:
        """Forbid a stay as the first code."""
        barred = torch.zeros_like(logits)
        barred[:, 0, self.stay] = -torch.inf
        return logits + barred


@dataclass(frozen=True)
class CodeStream:
    """A stream between two codes: the next code, its uniform numbers, and the state of the decoder."""

    code: int
    uniform: UniformRows
    run: DecoderState


class StreamingCategoricalGaze:
    """Gaze of streams, code by code; one stream after the other, as their pasts differ in length."""

    def __init__(self, gaze: CategoricalGaze, temperature: float) -> None:
        self._gaze, self._temperature = gaze, temperature

    def begin(self, seed: int) -> CodeStream:
        """A stream before its first code."""
        uniform = UniformRows(torch.Generator().manual_seed(seed + SEED_OFFSET), 1)
        return CodeStream(0, uniform, self._gaze.start(1))

    def step(
        self, states: Sequence[CodeStream], condition: GazeCondition
    ) -> tuple[Float[Tensor, "B T 2 3"], list[CodeStream]]:
        """Frames of the next code of each stream (fewer at its end), and the streams after them."""
        gaze, memory, signals, after = self._gaze, self._gaze.memory(condition), [], []
        for each, own in zip(states, memory.split(1), strict=True):
            run = deepcopy(each.run)
            gaze.transformer.append_memory(own, run.cache)
            uniform = each.uniform.rows(each.code, each.code + 1)[0]
            signals.append(gaze.advance(run, own, uniform, self._temperature)[:, : condition.speech.shape[1]])
            after.append(CodeStream(each.code + 1, each.uniform, run))
        return to_gaze_tensor(gaze.codebook.settings.signal, condition.head, torch.cat(signals)), after


def stay_mask(codebook: GazeVQVAE, signal: Float[Tensor, "B T F"]) -> Bool[Tensor, "B N"]:
    """Patches that are stays under the codebook's tolerance (none without a stay token)."""
    patches = codebook.patches(signal)
    if codebook.stay_tolerance_rad is None:
        return torch.zeros(patches.shape[:2], dtype=torch.bool, device=patches.device)
    return torch.from_numpy(find_stays(patches.cpu().numpy(), codebook.stay_tolerance_rad)).to(patches.device)
