"""What all tests share: JAX checks that ranks are broadcast on purpose, and what is costly to set up."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

# Kernels that one test file, worker or child process has compiled serve the others; JAX reads this when imported.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(tempfile.gettempdir()) / "bssrdf-test-kernels"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")

import jax
import pytest
from simulated_chip import Chip, built


@pytest.fixture(autouse=True)
def _ranks_are_broadcast_on_purpose() -> Iterator[None]:
    with jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture
def x64() -> Iterator[None]:
    """Double precision for this test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def renderer() -> None:
    """Mitsuba, ready; the test is skipped where it is not usable."""
    from bssrdf.errors import BssrdfError
    from bssrdf.render.variant import use_variant

    try:
        use_variant()
    except BssrdfError as error:
        pytest.skip(str(error))


@pytest.fixture
def mitsuba_mono() -> Iterator[None]:
    """Mitsuba of one channel with our plugins; the test is skipped where no variant of it runs."""
    import warnings

    from bssrdf.render.integrator import register
    from bssrdf.render.variant import ADVICE, find_backend, use_variant

    if find_backend() is None:
        pytest.skip(ADVICE)
    use_variant("mono")
    register()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "shape .* is open", UserWarning)
        yield


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The controller's firmware and the program that simulates its chip, built."""
    return built(tmp_path_factory.mktemp("firmware"))


@pytest.fixture
def chip(firmware: Path) -> Iterator[Chip]:
    """A board that was told once that its output is TTL."""
    one = Chip(firmware)
    yield one
    one.release()
