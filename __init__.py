"""Measure, fit and render light under the surface of translucent materials (Jensen et al. 2001).

The names below are imported when first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "BssrdfError": "bssrdf.errors",
    "FitOptions": "bssrdf.fit",
    "fit_slice": "bssrdf.fit",
    "fit_slices": "bssrdf.fit",
    "load_materials": "bssrdf.transport",
    "measure_session": "bssrdf.measure",
    "read_fit": "bssrdf.session.fit_json",
    "read_session": "bssrdf.session.session_toml",
    "read_slice": "bssrdf.session.slice_csv",
    "write_slice": "bssrdf.session.slice_csv",
}

if TYPE_CHECKING:
    from bssrdf.errors import BssrdfError as BssrdfError
    from bssrdf.fit import FitOptions as FitOptions
    from bssrdf.fit import fit_slice as fit_slice
    from bssrdf.fit import fit_slices as fit_slices
    from bssrdf.measure import measure_session as measure_session
    from bssrdf.session.fit_json import read_fit as read_fit
    from bssrdf.session.session_toml import read_session as read_session
    from bssrdf.session.slice_csv import read_slice as read_slice
    from bssrdf.session.slice_csv import write_slice as write_slice
    from bssrdf.transport import load_materials as load_materials


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'bssrdf' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted([*_HOME, "__version__"])
