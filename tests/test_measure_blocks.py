"""Blocks of pixels that grow with the distance: nothing is lost, nothing counts twice, and the curve stays."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bssrdf.calib.surface import Surface
from bssrdf.measure.hdr import HOT, SATURATED, Hdr
from bssrdf.measure.image import Image
from bssrdf.measure.pixels import grids_of
from bssrdf.measure.profile import Points, bin_edges, profile
from bssrdf.measure.pyramid import Pyramid
from bssrdf.measure.reflectance import _points as points_of
from bssrdf.measure.reflectance import blocks_of, light_by_count, radial_profile, slice_profiles
from bssrdf.session.records import Geometry


def picture(shape: tuple[int, int], centre: tuple[float, float], seed: int = 0) -> Hdr:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    r = np.hypot(x - centre[0], (y - centre[1]) * 2**0.5)
    light = 1e5 / (1 + (r / 20) ** 2) ** 1.5 + 10
    sd = 0.01 * light
    radiance = (light + rng.normal(size=shape) * sd).astype(np.float32)
    return Hdr(radiance, (sd**2).astype(np.float32), np.ones(shape, np.uint8), np.zeros(shape, np.uint8))


def image(hdr: Hdr, layout: str = "RGGB") -> Image:
    channels = tuple("RGB") if layout == "RGGB" else ("mono",)
    return Image("sample", hdr, layout, channels, Surface(Geometry(0.05, view_angle_deg=45.0)))


@settings(max_examples=25, deadline=None)
@given(st.integers(60, 400), st.integers(60, 400), st.floats(0, 1), st.floats(0, 1), st.integers(0, 99))
def test_every_pixel_counts_once_wherever_the_beam_and_whatever_is_bad(height, width, u, v, seed):
    hdr = picture((height, width), (u * width, v * height), seed)
    rng = np.random.default_rng(seed)
    hdr.mask[rng.random(hdr.mask.shape) < 0.02] = HOT
    hdr.radiance[rng.random(hdr.mask.shape) < 0.01] = np.nan
    for name in "RGB":
        for grid in grids_of(hdr, "RGGB", name):
            blocks = Pyramid(grid).around((u * width, v * height))
            good = (grid.mask == 0) & np.isfinite(grid.radiance)
            assert blocks.n_missing.sum() == np.count_nonzero(~good)
            assert blocks.n.sum() <= np.count_nonzero(good)
            assert blocks.light.sum() == pytest.approx(grid.radiance[good].sum(dtype=float), rel=1e-5)


def sums_one_by_one(grid, size):
    """n, value, variance, light and good pixels of blocks, pair by pair: what stands out of four is left out."""
    height, width = grid.shape
    sums = np.zeros((5, -(-height // size), -(-width // size)))
    for y, x in np.ndindex(-(-height // 2), -(-width // 2)):
        at = (slice(2 * y, 2 * y + 2), slice(2 * x, 2 * x + 2))
        good = (grid.mask[at] == 0) & np.isfinite(grid.radiance[at])
        light, variance = grid.radiance[at][good].astype(float), grid.variance[at][good].astype(float)
        kept = np.full(light.shape, True)
        if light.size and np.any(np.abs(light - light.mean()) > 4 * np.sqrt(variance)):
            off = np.abs(light - np.median(light))
            kept = off <= 6 * np.fmax(np.sqrt(variance), 1.4826 * np.median(off))
        own = (kept.sum(), light[kept].sum(), variance[kept].sum(), light.sum(), light.size)
        sums[:, 2 * y // size, 2 * x // size] += own
    return sums


@pytest.mark.parametrize("shape", [(401, 417), (390, 420)])
def test_blocks_of_each_size_are_the_sums_of_their_pixels(shape):
    hdr = picture(shape, (shape[1] / 3, shape[0] / 2))
    rng = np.random.default_rng(1)
    hdr.radiance[rng.random(shape) < 0.02] *= 1.5
    hdr.mask[rng.random(shape) < 0.05] = HOT
    hdr.radiance[rng.random(shape) < 0.05] = np.nan
    grid = grids_of(hdr, "RGGB", "B")[0]
    pyramid = Pyramid(grid)
    for k in (1, 2, 3):
        expected = sums_one_by_one(grid, 2**k)
        rows, columns = (axis.ravel() for axis in np.indices(expected.shape[1:]))
        for found, sums in zip(pyramid._sums(k, rows, columns), expected, strict=True):
            np.testing.assert_allclose(found, sums.ravel(), rtol=1e-5, atol=1e-5)


def test_the_curve_of_blocks_is_that_of_all_pixels():
    whole = image(picture((700, 900), (430.3, 350.8)))
    spot = whole.spot
    blocks = blocks_of(whole, "G", spot)
    pixels = [pyramid.window((spot.x_px, spot.y_px), 2000.0) for pyramid in whole.pyramids["G"]]
    every = type(blocks)(*(np.concatenate(fields) for fields in zip(*pixels, strict=True)))
    assert blocks.x_px.size < 0.5 * every.x_px.size
    edges = bin_edges(0.15, 35.0)
    ours, theirs = (
        profile(points_of(whole, each, spot), edges, whole.footprint(spot), None) for each in (blocks, every)
    )
    np.testing.assert_allclose(ours.n, theirs.n, rtol=0.1)
    pull = (ours.value - theirs.value) / theirs.sd
    assert np.abs(pull).max() < 2.0
    assert np.median(ours.sd / theirs.sd) == pytest.approx(1, abs=0.1)


def test_a_wide_band_takes_blocks_and_a_narrow_one_pixels():
    whole = image(picture((500, 900), (430.3, 250.8)))
    spot = whole.spot
    narrow, wide = (slice_profiles(whole, "G", spot, band_mm) for band_mm in (0.5, 12.0))
    far = narrow[1].r > 10
    ratio = np.interp(narrow[1].r[far], wide[1].r, wide[1].value) / narrow[1].value[far]
    assert np.median(ratio) == pytest.approx(1, abs=0.01)


def test_a_glint_in_a_block_is_light_but_no_part_of_the_curve():
    hdr = picture((500, 700), (350.0, 250.0))
    before = radial_profile(image(hdr), "G", image(hdr).spot)
    hdr.radiance[33, 100] += 1e6
    hdr.mask[40, 101] = SATURATED
    glint = image(hdr)
    spot = glint.spot
    after = radial_profile(glint, "G", spot)
    np.testing.assert_allclose(after.value, before.value, rtol=0.02)
    assert blocks_of(glint, "G", spot).light.sum() > 1e6


def test_light_by_count_is_all_the_light():
    hdr = picture((101, 140), (70.0, 50.0))
    hdr.count[:] = np.random.default_rng(0).integers(0, 300, hdr.count.shape).astype(np.uint16) % 251
    light = light_by_count(image(hdr), "G")
    greens = np.concatenate([grid.radiance.ravel() for grid in grids_of(hdr, "RGGB", "G")])
    assert light.sum() == pytest.approx(greens.sum(dtype=float), rel=1e-5)
    assert len(light) == 251


def test_memory_beside_the_image_is_a_fraction_of_it():
    """40 bytes a pixel would be its coordinates and values in lists."""
    whole = image(picture((1600, 2400), (1201.0, 803.0)), "mono")
    assert image(picture((100, 100), (50.0, 50.0)), "mono").spot.x_px > 0  # all is compiled
    tracemalloc.start()
    try:
        spot = whole.spot
        radial_profile(whole, "mono", spot)
        slice_profiles(whole, "mono", spot, 0.5)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20 * whole.hdr.radiance.size


@pytest.mark.parametrize("seed", range(30))
def test_bins_of_noise_alone_keep_their_noise(seed):
    """Where a curve has faded into noise it crosses 0 within bins: their errors stay those of their pixels."""
    rng = np.random.default_rng(seed)
    across, along = rng.uniform(-30, 30, (2, 8000))
    value = np.exp(-np.hypot(across, along)) + 1e-3 * rng.standard_normal(8000)
    points = Points(across, along, value, np.full(8000, 1e-6), n=np.ones(8000))
    found = profile(points, bin_edges(0.3, 30.0), (0.1, 0.1), None)
    faded = found.r > 12
    assert np.all(found.sd[faded] > 0.7 * 1e-3 / np.sqrt(found.n[faded]))


@pytest.mark.parametrize("band", [None, 0.8])
def test_a_bin_is_the_mean_by_r_dr_of_all_its_pixels_however_wide(band):
    y, x = np.mgrid[-300:301, -300:301].ravel().reshape(2, -1) * 0.02
    near = np.hypot(x, y) < 5.9 if band is None else np.abs(y) < band / 2

    def curve(r):
        return np.exp(-1.5 * r)

    value = curve(np.hypot(x, y))[near]
    points = Points(x[near], y[near], value, 1e-6 * value**2, np.ones_like(value))
    found = profile(points, np.arange(0, 4.1, 0.25), (0.02, 0.02), band)
    for lo, hi, mean in zip(found.r_lo, found.r_hi, found.value, strict=True):
        r = np.linspace(lo, hi, 20_001)
        assert mean == pytest.approx(np.trapezoid(r * curve(r), r) / np.trapezoid(r, r), rel=0.01), (lo, hi)
