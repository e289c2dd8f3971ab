"""Scores of a picture against a reference: the ratio of the means with its error, and bias told from noise."""

from __future__ import annotations

import numpy as np
import pytest

from bssrdf.render.compare import score
from bssrdf.render.picture import Picture, exposure, shown

NOISE = 0.15


def picture(radiance: np.ndarray, seed: int) -> Picture:
    noisy = radiance + np.random.default_rng(seed).normal(0, NOISE, radiance.shape)
    return Picture(noisy.astype(np.float32), np.full(radiance.shape, NOISE**2, np.float32), 8, 1.0, 0.0)


@pytest.fixture
def truth() -> np.ndarray:
    """A step, as a shadow's edge."""
    return np.where(np.arange(96)[None, :, None] < 48, 0.5, 2.0) * np.ones((96, 96, 3))


def test_two_pictures_of_the_same_have_no_bias(truth: np.ndarray) -> None:
    found = score("bssrdf", picture(truth, 1), picture(truth, 2))
    assert found.mean_ratio == pytest.approx(1, abs=4 * found.mean_ratio_se)
    assert found.mean_ratio_se == pytest.approx(np.sqrt(2) * NOISE / 1.25 / np.sqrt(truth.size), rel=0.05)
    assert found.rel_mse_bias == pytest.approx(0, abs=1e-3)
    assert found.rel_mse > 0.01


def test_a_picture_that_is_too_bright_is_biased_by_the_square(truth: np.ndarray) -> None:
    found = score("brdf", picture(1.2 * truth, 1), picture(truth, 2))
    assert found.mean_ratio == pytest.approx(1.2, abs=4 * found.mean_ratio_se)
    assert found.rel_mse_bias == pytest.approx(0.04, rel=0.15)


def test_the_reference_against_itself_is_exact(truth: np.ndarray) -> None:
    reference = picture(truth, 1)
    found = score("mc", reference, reference)
    assert (found.mean_ratio, found.mean_ratio_se, found.rel_mse, found.rel_mse_bias) == (1, 0, 0, 0)


def test_a_black_or_broken_picture_can_still_be_shown() -> None:
    black = np.zeros((4, 4, 3), np.float32)
    assert shown(black, exposure(black)).max() == 0
    broken = np.full((4, 4, 3), np.nan, np.float32)
    assert shown(broken, 1.0).max() == 0
