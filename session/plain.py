"""Frozen data classes as plain dicts, lists and numbers, and back: what JSON can hold to the last bit."""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")
_PLAIN = (float, int, str, bool, type(None))
_hints: Callable[[Any], dict[str, Any]] = cache(get_type_hints)


def to_plain(value: Any) -> Any:
    """The value with data classes and named tuples as dicts, arrays as lists, and text for keys."""
    if type(value) in _PLAIN:
        return value
    if is_dataclass(value) or hasattr(value, "_fields"):
        return {name: to_plain(getattr(value, name)) for name in _hints(type(value))}
    if isinstance(value, Mapping):
        return {_key(key): to_plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [to_plain(each) for each in value] if isinstance(value, tuple | list) else value


def from_plain(kind: type[T], value: Any) -> T:
    """The value of `kind` that `to_plain` was given, NaN for null; ValueError, TypeError or KeyError if it is none."""
    return _of(kind, value)


def _key(key: Any) -> str:
    return key if isinstance(key, str) else repr(float(key))


def _origin(kind: Any) -> Any:
    """The class behind a generic; of NDArray too, which from NumPy 2.5 on is an alias for one."""
    origin = get_origin(kind)
    return get_origin(origin.__value__) if hasattr(origin, "__value__") else origin


def _of(kind: Any, value: Any) -> Any:
    origin, arguments = _origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None or isinstance(value, tuple(each for each in arguments if isinstance(each, type))):
            return value
        return _of(next(each for each in arguments if each is not type(None)), value)
    if origin is np.ndarray:
        return np.array(value)
    if origin is dict:
        return {_of(arguments[0], key): _of(arguments[1], each) for key, each in value.items()}
    if origin is tuple:
        each_kind = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(_of(each, one) for each, one in zip(each_kind, value, strict=True))
    if origin is list:
        return [_of(arguments[0], each) for each in value]
    if is_dataclass(kind) or hasattr(kind, "_fields"):
        return kind(**{name: _of(hint, value[name]) for name, hint in _hints(kind).items()})
    if origin is Literal and value not in arguments:
        raise ValueError(f"{value!r} is not one of {', '.join(arguments)}")
    if kind is float and value is None:
        return math.nan
    return value if kind is Any or origin is Literal else kind(value)
