"""State of an unfinished training on disk: an interrupted training resumes and ends with the same weights, bit for bit.

The file lies beside the outputs, e.g. data/.train-talkingeyes.resume. It is written atomically after every validation
and removed at the end of the stage. It holds weights, best weights, optimiser, random generators and history. A
training uses it only if settings, data, code and kind of machine are the same.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import math
import pickle
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from talkingeyes.core.atomic_file import atomic_write

PACKAGE = Path(__file__).resolve().parents[1]
# Packages whose code a training depends on; others may change during an interruption.
HASHED_PACKAGES = ("core", "corpus", "models", "training", "evaluation")


@dataclass
class TrainingState:
    """Progress of a training: last step, history (a row per validation), best score and its weights."""

    step: int = 0
    history: list[dict[str, float]] = field(default_factory=list)
    best_score: float = -math.inf
    best_weights: dict[str, Tensor] | None = None

    def update_best(self, score: float, weights: dict[str, Tensor]) -> None:
        """Keep the weights of the best score (with NaN: the last weights)."""
        if not score <= self.best_score:
            self.best_score = score
            self.best_weights = {name: tensor.clone() for name, tensor in weights.items()}


@dataclass(frozen=True)
class ResumeFile:
    """The resume file of a training, and a fingerprint of the training's settings and inputs."""

    path: Path
    fingerprint: str

    @classmethod
    def of(cls, path: Path, settings: Iterable[Any], reads: Iterable[Path]) -> ResumeFile:
        """Fingerprint of settings (JSON values) and of the files that represent the inputs, if they exist."""
        digests = [hashlib.sha256(each.read_bytes()).hexdigest() if each.is_file() else None for each in reads]
        return cls(path, json.dumps([list(settings), digests], sort_keys=True))

    def restore(
        self,
        module: nn.Module,
        optimiser: torch.optim.Optimizer,
        rng: np.random.Generator,
        discriminator_optimiser: torch.optim.Optimizer | None = None,
    ) -> TrainingState:
        """Restore the state of all arguments; returns a new state if there is nothing to resume."""
        if not self.path.exists():
            return TrainingState()
        try:
            saved = torch.load(self.path, map_location="cpu", weights_only=True)
            metadata = json.loads(saved["metadata"])
        except (OSError, RuntimeError, KeyError, EOFError, ValueError, pickle.UnpicklingError):
            return self._restart("is damaged")
        if metadata["key"] != self._key(module):
            return self._restart("is of other settings, data or code")
        module.load_state_dict(saved["weights"])
        optimiser.load_state_dict(saved["optimiser"])
        if discriminator_optimiser is not None:
            discriminator_optimiser.load_state_dict(saved["discriminator_optimiser"])
        torch.set_rng_state(saved["noise"])
        if saved["noise_cuda"]:
            torch.cuda.set_rng_state_all(saved["noise_cuda"])
        rng.bit_generator.state = metadata["random"]
        tqdm.write(f"{self.path.name}: resuming from step {metadata['step']}", file=sys.stderr)
        return TrainingState(metadata["step"], metadata["history"], metadata["best_score"], saved["best_weights"])

    def keep(
        self,
        state: TrainingState,
        module: nn.Module,
        optimiser: torch.optim.Optimizer,
        rng: np.random.Generator,
        discriminator_optimiser: torch.optim.Optimizer | None = None,
    ) -> None:
        """Write the state atomically."""
        metadata = {
            "key": self._key(module),
            "step": state.step,
            "history": state.history,
            "best_score": state.best_score,
            "random": rng.bit_generator.state,
        }
        content = {
            "metadata": json.dumps(metadata),
            "weights": module.state_dict(),
            "optimiser": optimiser.state_dict(),
            "discriminator_optimiser": discriminator_optimiser.state_dict()
            if discriminator_optimiser is not None
            else None,
            "best_weights": state.best_weights,
            "noise": torch.get_rng_state(),
            "noise_cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_initialized() else [],
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        file = io.BytesIO()  # torch tells no full disk from a damaged file
        torch.save(content, file)
        with atomic_write(self.path) as partial:
            partial.write_bytes(file.getbuffer())

    def remove(self) -> None:
        """Remove the file at the end of the stage."""
        self.path.unlink(missing_ok=True)

    def _restart(self, why: str) -> TrainingState:
        tqdm.write(f"{self.path.name}: {why}; training restarts", file=sys.stderr)
        return TrainingState()

    def _key(self, module: nn.Module) -> str:
        return hashlib.sha256(f"{self.fingerprint} {torch.__version__} {code_digest(module)}".encode()).hexdigest()


def code_digest(module: nn.Module) -> str:
    """Digest of the hashed packages, and of the files from elsewhere that define modules of the network."""
    rooms = {
        file for room in HASHED_PACKAGES for file in [PACKAGE / room, *(PACKAGE / room).rglob("*.py")] if file.is_file()
    }
    parts = {Path(inspect.getfile(type(each))) for each in module.modules()}
    own = sorted(file for file in rooms | parts if Path(torch.__file__).parent not in file.parents)
    return hashlib.sha256(b"".join(hashlib.sha256(file.read_bytes()).digest() for file in own)).hexdigest()
