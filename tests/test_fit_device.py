"""The batched search by JAX on a device: in float64 as NumPy's, in float32 within its stated error."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from bssrdf.bench.engines import SINGLE_ERROR, SINGLE_LOSES, Engine, EngineScore, scores_of

CURVES = 96
"""Four of each cell of the published table at this η."""


def on_gpu(engine: Engine) -> EngineScore:
    try:
        jax.devices("cuda")
    except RuntimeError as error:
        pytest.skip(f"JAX has no CUDA device here: {error}")
    (score,) = scores_of(CURVES, engine, "cuda")
    return score


def test_single_precision_keeps_its_stated_error_and_says_where_it_finds_nothing() -> None:
    (score,) = scores_of(CURVES, "float32", "cpu")
    assert 1e-9 < score.largest_error < SINGLE_ERROR
    assert score.not_found <= SINGLE_LOSES * CURVES
    assert np.isfinite(score.largest_error)


def test_double_precision_on_a_gpu_finds_what_numpy_finds() -> None:
    score = on_gpu("float64")
    assert score.not_found == 0
    assert score.largest_error < 1e-6
    assert "CPU" not in score.device


def test_single_precision_on_a_gpu_keeps_its_stated_error() -> None:
    score = on_gpu("float32")
    assert score.largest_error < SINGLE_ERROR
    assert score.not_found <= SINGLE_LOSES * CURVES
    assert "CPU" not in score.device
