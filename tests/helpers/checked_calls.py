"""Type checker of the tests: array shapes and types of the first calls of each function in each test.

jaxtyping and beartype check every call, which makes code that runs once a frame four times as slow. What a function is
given hardly changes within a test, so further calls go to the function itself.

pyproject.toml names `first_calls` in --jaxtyping-packages; conftest.py calls `check_again` before each test.
"""

from __future__ import annotations

import inspect
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from beartype import beartype

CALLS = 20
_calls: Counter[tuple[str, str]] = Counter()
_released: list[Any] = []


def first_calls(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate what jaxtyping makes of a function: one that checks the arguments, one that checks the result, too."""
    key = function.__module__, function.__qualname__
    checked: Callable[..., Any] | None = None

    def counted(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        checked = checked or beartype(function)  # not before: most functions are not called
        _calls[key] += 1
        if _calls[key] == 2 * CALLS:
            _release(*key)
        return checked(*args, **kwargs)

    return counted


def check_again() -> None:
    """Check all functions again."""
    for function in _released:
        function.__no_type_check__ = False
    _released.clear()
    _calls.clear()


def _release(module: str, qualified_name: str) -> None:
    """Let jaxtyping call a function directly. A function within a function is not found, so it stays checked."""
    found: Any = sys.modules.get(module)
    for name in qualified_name.split("."):
        found = inspect.getattr_static(found, name, None)
    for each in _layers(found):
        if inspect.isfunction(each):
            each.__no_type_check__ = True  # type: ignore[attr-defined]
            _released.append(each)


def _layers(found: Any) -> Iterator[Any]:
    """A member of a module or class, and the functions that it wraps: property, class method, cached property, ..."""
    while found is not None:
        yield found
        inner = (getattr(found, name, None) for name in ("__wrapped__", "__func__", "fget", "func"))
        found = next((each for each in inner if each is not None), None)
