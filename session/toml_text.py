"""TOML text of the values our formats hold: tomllib reads it back the same."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any

import numpy as np

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_table(values: Mapping[str, Any]) -> str:
    """`key = value` lines; a key whose value is None is left out."""
    return "".join(f"{_key(key)} = {toml_value(value)}\n" for key, value in values.items() if value is not None)


def toml_value(value: Any) -> str:
    """One value, on one line; TypeError for what TOML has no form for."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        return repr(float(value))
    if isinstance(value, Mapping):
        items = (f"{_key(key)} = {toml_value(each)}" for key, each in value.items() if each is not None)
        return "{ " + ", ".join(items) + " }" if value else "{}"
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + ", ".join(toml_value(each) for each in value) + "]"
    raise TypeError(f"{type(value).__name__} {value!r} has no TOML form")


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else toml_value(key)
