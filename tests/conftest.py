"""What all tests share: JAX checks that ranks are broadcast on purpose, and the data that lie beside the checkout."""

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

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(autouse=True)
def _ranks_are_broadcast_on_purpose() -> Iterator[None]:
    with jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture
def x64() -> Iterator[None]:
    """Double precision for this test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real and independent data beside the checkout; the test is skipped where they are absent."""
    if not SHARED.is_dir():
        pytest.skip("the shared data folder does not lie beside this checkout")
    return SHARED


@pytest.fixture(scope="module")
def renderer() -> None:
    """Mitsuba, ready; the test is skipped where it is not usable."""
    from bssrdf.errors import BssrdfError
    from bssrdf.render.variant import use_variant

    try:
        use_variant()
    except BssrdfError as error:
        pytest.skip(str(error))


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
