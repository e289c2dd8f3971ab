"""Which of Mitsuba's variants can run here, found out in child processes, since a wrong libLLVM aborts its process."""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util
import os
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bssrdf.errors import InputError

VARIABLE = "DRJIT_LIBLLVM_PATH"
OLDEST_LLVM = 17
"""14 is refused by Dr.Jit; 15 and 16 load and then abort on processors with AVX-512."""
ADVICE = (
    f"no usable libLLVM: install one of version {OLDEST_LLVM} or later (Debian and Ubuntu: apt install libllvm19; "
    f"macOS: brew install llvm), or name it in {VARIABLE}"
)
MISSING = 'Mitsuba is not installed: pip install "bssrdf[render]"'

_PLACES = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM.dylib",
)
_TRIAL = """
import sys, drjit, mitsuba
mitsuba.set_variant(sys.argv[1])
scene = mitsuba.load_dict({"type": "scene", "ball": {"type": "sphere"}})
ray = mitsuba.Ray3f(mitsuba.Point3f(drjit.linspace(mitsuba.Float, 0, 0.5, 64), 0, -2), mitsuba.Vector3f(0, 0, 1))
assert drjit.all(scene.ray_intersect(ray).is_valid())
"""
_TRIAL_TIMEOUT_S = 120


@dataclass(frozen=True)
class Backend:
    """What compiles Mitsuba's vectorised variants."""

    name: Literal["llvm", "cuda"]
    library: Path | None
    """The libLLVM to name to Dr.Jit; None where it needs none or finds it by itself."""


def use_variant(colour: Literal["rgb", "mono"] = "rgb") -> str:
    """Set Mitsuba's vectorised variant for this process and return its name.

    Raises InputError, one line, where Mitsuba or everything that could compile its kernels is missing.
    """
    if importlib.util.find_spec("mitsuba") is None:
        raise InputError(MISSING)
    backend = _known_backend() or find_backend()
    if backend is None:
        raise InputError(ADVICE)
    if backend.library is not None:
        os.environ[VARIABLE] = str(backend.library)  # Dr.Jit reads it once, when it is imported
    import mitsuba

    name = f"{backend.name}_ad_{colour}"
    if mitsuba.variant() != name:
        mitsuba.set_variant(name)
    return name


def _known_backend() -> Backend | None:
    """The libLLVM that was found before, while it, Mitsuba and the computer stay the same: a trial takes a second."""
    from bssrdf.render.kept import kept

    libraries = [(str(path), path.stat().st_mtime_ns) for path in _candidates() if path.exists()]
    versions = [importlib.metadata.version(package) for package in ("mitsuba", "drjit")]
    try:
        found = kept("libllvm", (platform.node(), platform.machine(), *versions, *libraries), _llvm)
    except InputError:
        return None
    return Backend("llvm", Path(str(found["library"])))


def _llvm() -> dict[str, str]:
    """Raises InputError where none works: what fails is tried again next time."""
    backend = find_backend()
    if backend is None or backend.library is None:
        raise InputError(ADVICE)
    return {"library": str(backend.library)}


@functools.cache
def find_backend() -> Backend | None:
    """The first that works of: the library that the environment names, others newest first, CUDA."""
    for library in _candidates():
        if _works("llvm_ad_rgb", library):
            return Backend("llvm", library)
    return Backend("cuda", None) if _works("cuda_ad_rgb", None) else None


def _candidates() -> list[Path]:
    named = [Path(os.environ[VARIABLE])] if os.environ.get(VARIABLE) else []
    found = {path.resolve() for place in _PLACES for path in Path("/").glob(place[1:])}
    return named + sorted((path for path in found if _version(path) >= OLDEST_LLVM), key=_version, reverse=True)


def _version(library: Path) -> float:
    """Of a resolved name: libLLVM.so.19.1, libLLVM-17.0.6.so, …; infinite where the name tells none."""
    number = re.search(r"libLLVM(?:-|\.so\.)(\d+)", library.name)
    return float(number.group(1)) if number else float("inf")


def _works(variant: str, library: Path | None) -> bool:
    environment = dict(os.environ) | ({VARIABLE: str(library)} if library else {})
    trial = [sys.executable, "-c", _TRIAL, variant]
    try:
        done = subprocess.run(trial, env=environment, capture_output=True, timeout=_TRIAL_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


_ORIGIN = re.compile(r"^(\[\w+\.\w+:\d+\] |InputError: )")
"""Its own source line, or the name of an error of ours that passed through it."""


def cause(error: Exception) -> str:
    """The last line of the message, which names the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return _ORIGIN.sub("", lines[-1]) if lines else repr(error)
