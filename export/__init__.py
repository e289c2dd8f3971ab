"""From measured coefficients to what renderers read, looking as measured.

The names below are imported when first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_HOME = {
    "Material": "material",
    "find_materials": "material",
    "export_files": "run",
    "read_version": "run",
}

if TYPE_CHECKING:
    from bssrdf.export.material import Material as Material
    from bssrdf.export.material import find_materials as find_materials
    from bssrdf.export.run import export_files as export_files
    from bssrdf.export.run import read_version as read_version


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_HOME)
