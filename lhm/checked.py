"""Arguments checked against a function's own annotations: the border at which a wrong kind of thing is named."""

from __future__ import annotations

import collections.abc
import functools
import inspect
import numbers
import os
import types
import typing
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .errors import InputError

Checked = TypeVar("Checked", bound=Callable[..., Any])


def checked(border: Checked) -> Checked:
    """The function, or the class when one is made, that refuses arguments of other kinds than its annotations'.

    InputError then names function and argument, what was expected and what came. A text is no list, and an array
    is one of numbers. Shapes, ranges and NaN are the function's to check.
    """
    if isinstance(border, type):
        border.__init__ = _checking(border.__init__, border.__name__)  # type: ignore[misc]
        return border
    return _checking(border, border.__qualname__)  # type: ignore[return-value]


def _checking(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    signature = inspect.signature(function)

    @functools.cache
    def kinds() -> dict[str, Any]:
        hints = typing.get_type_hints(function)  # when first called: annotations may name what is imported later
        named = (p.name for p in signature.parameters.values() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL))
        return {argument: hints[argument] for argument in named if argument in hints}

    @functools.wraps(function)
    def border(*arguments, **named):
        try:
            given = signature.bind(*arguments, **named).arguments
        except TypeError:
            return function(*arguments, **named)  # whose own words for it are better
        for argument, kind in kinds().items():
            if argument in given and not fits(given[argument], kind):
                raise InputError(f"{name}: {argument}: expected {_words(kind)}, got {_shown(given[argument])}")
        return function(*arguments, **named)

    return border


def fits(value: object, kind: Any) -> bool:
    """Whether a value is of an annotation's kind."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any or isinstance(kind, TypeVar) or getattr(kind, "_is_protocol", False):
        return True
    if kind == ArrayLike or kind is np.ndarray or origin is np.ndarray:
        return _is_array(value)
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is typing.Literal:
        return any(type(value) is type(one) for one in inner)
    if kind is float:
        return _is_number(value)
    if kind is int:
        return isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if kind is bool:
        return isinstance(value, (bool, np.bool_))
    if origin is collections.abc.Callable:
        return callable(value)
    if origin is tuple or origin in LISTS:
        return _is_list(value, origin) and all(fits(one, inner[0]) for one in value)  # type: ignore[attr-defined]
    return isinstance(value, origin or kind)


LISTS = (list, collections.abc.Sequence, collections.abc.Collection, collections.abc.Iterable)


def _is_list(value: object, origin: Any) -> bool:
    """Lists and arrays do for tuples; a text or a dict is no list of anything."""
    if isinstance(value, (str, bytes, collections.abc.Mapping)):
        return False
    return isinstance(value, (list, tuple, np.ndarray)) or (origin is not tuple and isinstance(value, origin))


def _is_number(value: object) -> bool:
    if isinstance(value, numbers.Real):
        return not isinstance(value, bool)
    return isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"


def _is_array(value: object) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError):  # rows of several lengths, or what refuses to be an array
        return False


def _words(kind: Any) -> str:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind == ArrayLike or kind is np.ndarray or origin is np.ndarray:
        return "an array of numbers"
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(_words(one) for one in inner))
    if origin is typing.Literal:
        return " or ".join(repr(one) for one in inner)
    if origin is tuple or origin in LISTS:
        return f"a list, each {_words(inner[0])}"
    simple: dict[Any, str] = {
        float: "a number",
        int: "an integer",
        bool: "True or False",
        str: "a text",
        type(None): "None",
    }
    simple |= {os.PathLike: "a path", collections.abc.Mapping: "a dict", collections.abc.Callable: "a function"}
    return simple.get(origin or kind) or _article((origin or kind).__name__)


def _shown(value: object) -> str:
    if value is None:
        return "None"
    if isinstance(value, (str, numbers.Number)):
        return f"{value!r:.40}"
    return _article(type(value).__name__)


def _article(word: str) -> str:
    return f"{'an' if word[0] in 'AEIOUaeiou' else 'a'} {word}"
