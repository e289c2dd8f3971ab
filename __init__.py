"""Measure, fit and render light under the surface of translucent materials (Jensen et al. 2001).

The names below are imported when first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "BssrdfError": ("bssrdf.errors", "BssrdfError"),
    "Fit": ("bssrdf.api", "ApiFit"),
    "InputError": ("bssrdf.errors", "InputError"),
    "Slice": ("bssrdf.api", "ApiSlice"),
    "fit_slice": ("bssrdf.api", "fit_slice"),
    "load_materials": ("bssrdf.transport", "load_materials"),
    "measure_session": ("bssrdf.api", "measure_session"),
    "rd": ("bssrdf.api", "rd"),
    "read_fit": ("bssrdf.api", "read_fit"),
    "read_session": ("bssrdf.api", "read_session"),
    "read_slice": ("bssrdf.api", "read_slice"),
    "write_slice": ("bssrdf.session.slice_csv", "write_slice"),
}

if TYPE_CHECKING:
    from bssrdf.api import ApiFit as Fit  # noqa: F401
    from bssrdf.api import ApiSlice as Slice  # noqa: F401
    from bssrdf.api import fit_slice as fit_slice
    from bssrdf.api import measure_session as measure_session
    from bssrdf.api import rd as rd
    from bssrdf.api import read_fit as read_fit
    from bssrdf.api import read_session as read_session
    from bssrdf.api import read_slice as read_slice
    from bssrdf.errors import BssrdfError as BssrdfError
    from bssrdf.errors import InputError as InputError
    from bssrdf.session import write_slice as write_slice
    from bssrdf.transport import load_materials as load_materials


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'bssrdf' has no attribute {name!r}")
    module, inside = _HOME[name]
    return getattr(importlib.import_module(module), inside)


def __dir__() -> list[str]:
    return sorted([*_HOME, "__version__"])
