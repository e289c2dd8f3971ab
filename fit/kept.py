"""Kernels kept between processes, as compiled: JAX's own cache spares the compiler only, not the tracing before it.

A kernel is kept beside JAX's cache, where that is on, under a name made of code, versions, computer and shapes.
"""

from __future__ import annotations

import functools
import hashlib
import pickle
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import serialize_executable

import bssrdf
from bssrdf.session.atomic import atomic_write

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
FOLDER = "kernels"
_PACKAGES = ("fit", "transport")

_loaded: dict[str, Callable[..., Any]] = {}


def kept(kernel: Kernel) -> Kernel:
    """`kernel(task, *arrays)`, jitted with its first argument static, from the cache where JAX has one."""

    @functools.wraps(kernel)
    def call(task: Any, *arguments: Any) -> Any:
        folder = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
        if folder is None:
            return kernel(task, *arguments)
        leaves, structure = jax.tree.flatten(arguments)
        arrays = [np.asarray(leaf) for leaf in leaves]
        shapes = [(array.shape, array.dtype.str) for array in arrays]
        name = _digest(_code(), kernel.__name__, repr(task), str(structure), repr(shapes))
        if name not in _loaded:
            _loaded[name] = _ready(Path(folder) / FOLDER / name, functools.partial(kernel, task), structure, arrays)
        return _loaded[name](*arrays)

    return call  # type: ignore[return-value]


def _ready(path: Path, kernel: Callable[..., Any], structure: Any, arrays: list[Any]) -> Callable[..., Any]:
    """The kernel as a function of its arrays, read from `path` or made and written there."""
    if not path.exists():

        def flat(*leaves: Any) -> list[Any]:
            return jax.tree.leaves(kernel(*jax.tree.unflatten(structure, leaves)))

        result = jax.eval_shape(kernel, *jax.tree.unflatten(structure, arrays))
        compiled = serialize_executable.serialize(jax.jit(flat).lower(*arrays).compile())
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as part:
            part.write_bytes(pickle.dumps((jax.tree.map(lambda _: 0, result), compiled)))
    skeleton, compiled = pickle.loads(path.read_bytes())
    run, shape = serialize_executable.deserialize_and_load(*compiled), jax.tree.structure(skeleton)
    return lambda *leaves: jax.tree.unflatten(shape, run(*leaves))


@functools.cache
def _code() -> str:
    """Of everything that a kernel is made from."""
    home = Path(bssrdf.__file__).parent
    sources = [file.read_text("utf-8") for package in _PACKAGES for file in sorted((home / package).glob("*.py"))]
    return _digest(bssrdf.__version__, jax.__version__, repr(platform.uname()), *sources)


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]
