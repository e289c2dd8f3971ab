"""Arrays that take seconds to make, kept on disk beside the Monte Carlo tables."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bssrdf import __version__
from bssrdf.session import atomic_write
from bssrdf.transport import cache_directory

Arrays = Mapping[str, Any]
"""Of NumPy."""


def kept(name: str, known: tuple[Any, ...], make: Callable[[], Arrays]) -> Arrays:
    """The arrays that `make` gives, from the cache where they are in it; `known` is all that they depend on."""
    digest = hashlib.sha256(repr((__version__, *known)).encode()).hexdigest()[:24]
    path = cache_directory() / f"{name}-{digest}.npz"
    try:
        with np.load(path) as held:
            return {key: held[key] for key in held.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        made = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as part, part.open("wb") as file:
        np.savez(file, **made)
    return made
