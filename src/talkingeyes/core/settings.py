"""What every configuration section is made of: frozen, typed, no unknown keys; defaults live in conf/ only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeVar

import pydantic
from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError

from talkingeyes.core.errors import InputError


class Settings(BaseModel):
    """Parent of every configuration section; a section stands beside the class or function that it configures."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())


class ComponentSettings(Settings):
    """The section of a part that can be exchanged: its `kind` says which class it configures."""

    kind: str


S = TypeVar("S", bound=Settings)


def bounds_error(requirement: str, value: object) -> PydanticCustomError:
    """The error of a validator that looks at several keys: `requirement` names key and bound, `value` is the value."""
    # Braces would be taken for a template.
    return PydanticCustomError("bounds", "{what}, got {came}", {"what": requirement, "came": str(value)})


@dataclass(frozen=True)
class ComponentRegistry:
    """A part that can be exchanged: classes that do the same in different ways, one of which a section's `kind` names.

    A kind is one of the short names in `kinds`, or `package.module:Class` for a class from anywhere (docs/extend.md).
    The class names its settings in `settings_class` and has the methods of the contract.
    """

    name: str
    kinds: Mapping[str, str]
    methods: tuple[str, ...]

    def parse(self, node: Any) -> Settings:
        """A section as the settings of the class that it names; used as a validator of pydantic."""
        if isinstance(node, Settings):
            return node
        if not isinstance(node, Mapping) or "kind" not in node:
            raise self._kind_error("should be a section with a kind", node)
        settings: Settings = self.component_class(str(node["kind"])).settings_class.model_validate(node)
        return settings

    def build(self, settings: ComponentSettings, *arguments: Any) -> Any:
        """The part that a section configures."""
        return self.component_class(settings.kind)(settings, *arguments)

    def component_class(self, kind: str) -> Any:
        """The class of a kind."""
        module, _, name = self.kinds.get(kind, kind).partition(":")
        if not name:
            raise self._kind_error(f"kind should be {', '.join(self.kinds)} or package.module:Class", kind)
        try:
            found = getattr(import_module(module), name)
        except (ImportError, AttributeError) as error:
            raise self._kind_error(f"kind should be a class that can be imported ({error})", kind) from None
        missing = [each for each in ("settings_class", *self.methods) if not hasattr(found, each)]
        if missing:
            raise self._kind_error(f"kind should be a {self.name}, with {', '.join(missing)}", kind)
        return found

    def _kind_error(self, requirement: str, value: Any) -> PydanticCustomError:
        # Braces would be taken for a template.
        return PydanticCustomError("kind", "{what}, got {came}", {"what": requirement, "came": str(value)})


def validate_section(section: str, kind: type[S], node: Any) -> S:
    """A section as its frozen settings. Raises InputError: one line with the key, the bound and the value that came."""
    try:
        return kind.model_validate(node)
    except pydantic.ValidationError as error:
        raise InputError(_line(section, error, node)) from None


def _line(section: str, error: pydantic.ValidationError, node: Any) -> str:
    """The first thing that is wrong; in a part that can be exchanged, what is wrong inside it."""
    first = error.errors()[0]
    keys: list[str] = [section] if section else []
    for step in first["loc"]:
        # Where kinds of sections are told apart by `kind`, pydantic names the kind, which is no key.
        if isinstance(node, Mapping) and step not in node and step == node.get("kind"):
            continue
        keys.append(str(step))
        node = node.get(step) if isinstance(node, Mapping) else None
    key = ".".join(keys)
    inner = first.get("ctx", {}).get("error")
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if isinstance(inner, pydantic.ValidationError):
        return _line(key, inner, node) + more
    if first["type"] == "missing":
        return f"{key}: is missing{more}"
    if first["type"] in ("kind", "bounds"):
        return f"{key}: {first['msg']}{more}"
    return f"{key}: {first['msg']}, got {first['input']!r}{more}"
