"""Register the default model in MLflow as `talkingeyes`: a pyfunc from paths of sound files to motion.

Run     python -m pipelines.register_model [WORKSPACE]
Reads   data/train/talkingeyes_events of the workspace (default: here), else the packaged model
Writes  a version of the registered model to the workspace's mlflow.db and mlartifacts/ (or to MLFLOW_TRACKING_URI);
        nothing if the last version has the same weights and code. Columns of the output: registered_model.py
"""

from __future__ import annotations

import hashlib
import logging
import os
import sys
import tempfile
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.animation.model_file import PACKAGED_MODEL, WORKSPACE_MODEL, model_title
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.mlflow_logging import exclusive, get_experiment, revision, tracking_uri
from talkingeyes.orchestration.run import run_command
from talkingeyes.workflows.pack import pack

NAME, EXPERIMENT = "talkingeyes", "registered_models"
CODE = Path(__file__).with_name("registered_model.py")
EXAMPLE_S = 2.0


def register(root: Path) -> str:
    """Register the model of a workspace, unless its last version is the same. Returns its URI, models:/NAME/VERSION."""
    if not root.is_dir():
        raise InputError(f"{root}: should be a folder, a workspace")
    with tempfile.TemporaryDirectory(prefix="talkingeyes-") as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations inside MLflow
        os.environ["MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR"] = "false"
        from mlflow import MlflowClient

        file, source = Path(folder, f"{NAME}.safetensors"), root / WORKSPACE_MODEL
        if source.is_dir():
            pack(source, file)
        else:
            file, source = PACKAGED_MODEL, PACKAGED_MODEL
        digest = hashlib.sha256(file.read_bytes() + CODE.read_bytes()).hexdigest()[:16]
        uri = tracking_uri(root)
        client = MlflowClient(uri)
        with exclusive(root):
            found = client.search_model_versions(f"name='{NAME}'", order_by=["version_number DESC"], max_results=1)
            if found and found[0].tags.get("sha256") == digest:
                return f"models:/{NAME}/{found[0].version}"
            number = _log(client, uri, root, file)
            tags = {"sha256": digest, "source": model_title(source), "revision": revision()}
            for key, value in tags.items():
                client.set_model_version_tag(NAME, number, key, value)
    return f"models:/{NAME}/{number}"


def _log(client: Any, uri: str, root: Path, file: Path) -> str:
    import mlflow

    logging.getLogger("mlflow").setLevel(logging.ERROR)
    experiment = get_experiment(client, root, EXPERIMENT, {})
    before = os.environ.get("MLFLOW_TRACKING_URI", "")
    mlflow.set_tracking_uri(uri)  # sets the variable
    try:
        with mlflow.start_run(experiment_id=experiment, run_name=NAME, tags={"revision": revision()}):
            logged = mlflow.pyfunc.log_model(
                name=NAME,
                python_model=str(CODE),
                artifacts={"model": str(file)},
                signature=_signature(file),
                pip_requirements=[f"talkingeyes=={version('talkingeyes')}"],
                registered_model_name=NAME,
            )
    finally:
        mlflow.set_tracking_uri(before)
    return str(logged.registered_model_version)


def _signature(file: Path) -> Any:
    """Columns and parameters, from an animation of noise; the face model decides which expressions there are."""
    import pandas as pd
    from mlflow.models import infer_signature

    from pipelines.registered_model import DEFAULTS, motion_columns
    from talkingeyes.workflows.animate import AnimationOptions, load_performer, sample_animations

    noise = 0.01 * np.random.default_rng(0).normal(size=round(EXAMPLE_S * SAMPLE_RATE))
    motion = sample_animations(load_performer(file), noise, AnimationOptions(samples=1))[0].motion
    columns = {"speech": "speech.wav", "sample": 0, "frame": np.arange(len(motion)), **motion_columns(motion)}
    return infer_signature(pd.DataFrame({"speech": ["speech.wav"]}), pd.DataFrame(columns), DEFAULTS)


def main() -> None:
    """Register and print the URI."""
    if len(sys.argv) > 2:
        raise InputError(f"register_model: should get one workspace, got {' '.join(sys.argv[1:])}")
    print("Registered model:", register(Path(sys.argv[1] if len(sys.argv) == 2 else ".")))


if __name__ == "__main__":
    run_command(main)
