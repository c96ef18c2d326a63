"""conf/, composed once in a process for each set of overrides: Hydra needs half a second each time."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from functools import cache
from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from omegaconf import OmegaConf

from talkingeyes.orchestration import config
from talkingeyes.orchestration.config import CONFIG_DIR

MODEL_NAMES = tuple(path.stem for path in sorted((CONFIG_DIR / "model").glob("*.yaml")))


def compose(overrides: Sequence[str] = ()) -> dict[str, Any]:
    """What `talkingeyes.orchestration.config.compose` returns."""
    return deepcopy(_composed(tuple(overrides)))


@cache
def _composed(overrides: tuple[str, ...]) -> dict[str, Any]:
    return config.compose(overrides)


def model_section(name: str, group: str = "model") -> dict[str, Any]:
    """The composed section of a model of conf/model/, or of a tokenizer of conf/pretrain/ (group `pretrain`)."""
    return deepcopy(_sections(group)[name])


@cache
def _sections(group: str) -> dict[str, dict[str, Any]]:
    names = [path.stem for path in (CONFIG_DIR / group).glob("*.yaml")]
    with initialize_config_dir(str(CONFIG_DIR), version_base=None):
        sections = hydra_compose(overrides=[f"+{group}@{name}={name}" for name in names])
    return dict(OmegaConf.to_container(sections))  # type: ignore[arg-type]
