"""A small composed configuration for logging, and a client of the logged runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

PARAMS: dict[str, Any] = {
    "corpus": "data/synthesize",
    "workspace": "build/x",
    "result_store": "build/x/store",
    "target": "report",
    "objective": {"model": "talkingeyes"},
    "study": "alive",
    "machine": {"jobs": 2},
    "synthesize": {"seed": 0},
    "fit": {"tolerance": 0.1, "smoothing": {"step_cost": 30.0}},
    "pretrain": {"gaze_frames": {"codes": 1024}, "gaze_patches": {"codes": 256}},
    "train": {"seed": 1},
    "model": {
        "vae": {"kind": "speech_to_motion", "tokenizer": None, "width": 64},
        "talkingeyes": {"kind": "speech_to_motion", "tokenizer": "gaze_patches", "weights": {"head_kl": 1.0}},
    },
    "sample": {"seed": 1},
}


def mlflow_client(root: Path) -> Any:
    """MLflow client of a workspace."""
    from mlflow.tracking import MlflowClient

    return MlflowClient(f"sqlite:///{root / 'mlflow.db'}")
