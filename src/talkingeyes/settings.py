"""What every configuration section is made of: frozen, typed, no unknown keys, no defaults (defaults live in conf/ only)."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Parent of every configuration section; a section stands beside the class or function that it configures."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())
