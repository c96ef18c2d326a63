"""What every configuration section is made of: frozen, typed, no unknown keys; defaults live in conf/ only."""

from typing import Any, TypeVar

import pydantic
from pydantic import BaseModel, ConfigDict

from talkingeyes.errors import InputError


class Settings(BaseModel):
    """Parent of every configuration section; a section stands beside the class or function that it configures."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())


S = TypeVar("S", bound=Settings)


def validated(section: str, kind: type[S], node: Any) -> S:
    """A section as its frozen settings. Raises InputError: one line with the key, the bound and the value that came."""
    try:
        return kind.model_validate(node)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        key = ".".join(filter(None, [section, *map(str, first["loc"])]))
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise InputError(f"{key}: {first['msg']}, got {first['input']!r}{more}") from None
