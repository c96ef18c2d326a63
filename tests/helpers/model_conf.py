"""Models of conf/model/ and tokenizers of conf/pretrain/, with the defaults that they name."""

from __future__ import annotations

from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from talkingeyes.orchestration.config import CONFIG_DIR

MODEL_NAMES = tuple(path.stem for path in sorted((CONFIG_DIR / "model").glob("*.yaml")))


def model_section(name: str, group: str = "model") -> dict[str, Any]:
    """The composed section of a model, or of a tokenizer (group `pretrain`)."""
    with initialize_config_dir(str(CONFIG_DIR), version_base=None):
        section = compose(f"{group}/{name}")[group]
    return dict(OmegaConf.to_container(section))  # type: ignore[arg-type]
