"""Base of all configuration sections: frozen, typed, without unknown keys; defaults are in conf/ only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, TypeVar, cast

import pydantic
from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError

from talkingeyes.core.errors import InputError


class Settings(BaseModel):
    """Base of every configuration section; a section is defined beside the class or function that it configures."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())


class ComponentSettings(Settings):
    """The section of an exchangeable component: its `kind` names the class that it configures."""

    kind: str


S = TypeVar("S", bound=Settings)
D = TypeVar("D")


def bounds_error(requirement: str, value: object) -> PydanticCustomError:
    """The error of a validator over several keys: `requirement` names key and bound, `value` is the actual value."""
    # braces in the message itself would be a template
    return PydanticCustomError("bounds", "{what}, got {came}", {"what": requirement, "came": str(value)})


@dataclass(frozen=True)
class ComponentRegistry:
    """An exchangeable component: alternative classes, one of which is selected by the `kind` of a section.

    A kind is one of the short names in `kinds`, or `package.module:Class` for any importable class (docs/extend.md).
    The class has its settings class as `settings_class`, and the required `methods`.
    """

    name: str
    kinds: Mapping[str, str]
    methods: tuple[str, ...]

    def parse(self, node: Any) -> Settings:
        """Validate a section with the settings of its kind; used as a pydantic validator."""
        if isinstance(node, Settings):
            return node
        if not isinstance(node, Mapping) or "kind" not in node:
            raise self._kind_error("should be a section with a kind", node)
        settings: Settings = self.component_class(str(node["kind"])).settings_class.model_validate(node)
        return settings

    def build(self, settings: ComponentSettings, *arguments: Any) -> Any:
        """Construct the component of a section."""
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
        # braces in the message itself would be a template
        return PydanticCustomError("kind", "{what}, got {came}", {"what": requirement, "came": str(value)})


def validate_section(section: str, kind: type[S], node: Any) -> S:
    """Validate a section. Raises InputError: one line with the key, the bound and the actual value."""
    try:
        return kind.model_validate(node)
    except pydantic.ValidationError as error:
        raise InputError(_line(section, error, node)) from None


def validate_record(kind: type[D], content: Any) -> D:
    """A dataclass from the content of a file. Raises ValueError: one line with the first key of another type."""
    try:
        return cast(D, _adapter(cast(Any, kind)).validate_python(content))
    except pydantic.ValidationError as error:
        raise ValueError(_line("", error, content)) from None


@cache
def _adapter(kind: Any) -> Any:
    return pydantic.TypeAdapter(kind)


def _line(section: str, error: pydantic.ValidationError, node: Any) -> str:
    """The first error; inside an exchangeable component, the first error of its section."""
    first = error.errors()[0]
    keys: list[str] = [section] if section else []
    for step in first["loc"]:
        # In a union discriminated by `kind`, pydantic adds the kind to the location, which is not a key.
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
