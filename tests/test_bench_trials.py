"""Fits of the engine's own light: four dark cells of `bssrdf bench trials`, and with shared errors drawn."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from bssrdf.bench.trial_light import TrialLight, cells, edges_mm, more, shipped
from bssrdf.bench.trials import KEYS, Drawn, Outcome, cramer_rao, noise_of, outcome_of, run_trials, slices_of, table
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice

NAMES = ("Chicken1 G", "Chicken1 B", "Chicken2 G", "Ketchup R")
TRIALS = 48


def lights() -> list[TrialLight]:
    return [shipped()[name] for name in NAMES]


def fits_of(slices: list[Slice], options: FitOptions) -> list[ChannelFit]:
    return [fit["G"] for fit in fit_slices(slices, options)]


@pytest.fixture(scope="module")
def slices() -> list[Slice]:
    return [piece for at, light in enumerate(lights()) for piece in slices_of(light, TRIALS, 0.01, at)]


@pytest.fixture(scope="module")
def whole(slices: list[Slice]) -> list[ChannelFit]:
    return fits_of(slices, FitOptions(model="mc", constraint="soft"))


def share_held(fits: list[ChannelFit]) -> np.ndarray:
    """Of the 95 % intervals of (σs′, σa), those that hold the truth."""
    held = []
    for at, fit in enumerate(fits):
        cell = lights()[at // TRIALS].cell
        for key in KEYS:
            lo, hi = getattr(fit, f"{key}_interval95_per_mm")
            held.append(lo <= getattr(cell, key) <= hi)
    return np.reshape(held, (-1, 2)).mean(axis=0)


def cut(piece: Slice, n: int) -> Slice:
    channel = piece.channels["G"]
    assert channel.r_lo_mm is not None
    assert channel.r_hi_mm is not None
    arrays = (channel.r_mm, channel.rd_per_mm2, channel.sd_per_mm2, channel.r_lo_mm, channel.r_hi_mm)
    return replace(piece, channels={"G": ChannelSlice(*(each[:n] for each in arrays))})


def scaled(piece: Slice, factor: float) -> Slice:
    channel = piece.channels["G"]
    bright = replace(channel, rd_per_mm2=factor * channel.rd_per_mm2, sd_per_mm2=factor * channel.sd_per_mm2)
    return replace(piece, channels={"G": bright})


def test_errors_and_intervals_on_the_engines_light(whole: list[ChannelFit]) -> None:
    outcomes: list[Outcome] = [
        outcome_of(light, "mc", whole[at * TRIALS : (at + 1) * TRIALS], 0.01) for at, light in enumerate(lights())
    ]
    for each in outcomes:
        assert each.median_error[0] < 0.01
        assert each.median_error[1] < 0.02
        assert each.judged > 0.9 * TRIALS
    np.testing.assert_array_less(0.9, share_held(whole))
    ratio = np.sqrt(np.mean(np.square([np.divide(each.sd, each.bound_of_noise) for each in outcomes]), axis=0))
    assert np.all((ratio > 0.85) & (ratio < 1.15))


def test_intervals_hold_with_errors_of_scale_and_length_drawn_and_the_curve_tells_the_scale() -> None:
    """What a scale error of 1 % does to σa is far below the 1 % and more of a fit that propagates it afterwards."""
    shared = Drawn(scale=0.01, length=0.002)
    slices = [piece for at, light in enumerate(lights()) for piece in slices_of(light, TRIALS, 0.01, at, shared)]
    fits = fits_of(slices, FitOptions(model="mc", constraint="soft"))
    np.testing.assert_array_less(0.9, share_held(fits))
    for at, light in enumerate(lights()):
        outcome = outcome_of(light, "mc", fits[at * TRIALS : (at + 1) * TRIALS], 0.01, shared)
        assert np.all(np.array(outcome.width) < 1.15)
        assert outcome.refused == 0


def test_a_slice_cut_short_has_wider_intervals_that_hold_the_truth(
    slices: list[Slice], whole: list[ChannelFit]
) -> None:
    short = fits_of([cut(piece, 16) for piece in slices], FitOptions(model="mc", constraint="soft"))
    np.testing.assert_array_less(0.9, share_held(short))
    for less, more_ in zip(short, whole, strict=True):
        assert less.sigma_sp_sd_per_mm > more_.sigma_sp_sd_per_mm


@pytest.mark.slow
def test_a_slice_of_unknown_factor_has_wider_intervals_that_hold_the_truth(
    slices: list[Slice], whole: list[ChannelFit]
) -> None:
    free = fits_of([scaled(piece, 1.7) for piece in slices], FitOptions(model="mc", constraint="none", scale="free"))
    np.testing.assert_array_less(0.9, share_held(free))
    for less, more_ in zip(free, whole, strict=True):
        assert less.sigma_a_sd_per_mm > more_.sigma_a_sd_per_mm
        assert "scale_free" in less.flags


def test_the_bound_is_what_less_noise_makes_smaller() -> None:
    light = lights()[0]
    stated, _ = noise_of(light, 0.02)
    whole = np.array(cramer_rao(light, stated))
    half = np.array(cramer_rao(light, stated._replace(curve=stated.curve / 2, total=stated.total / 2)))
    np.testing.assert_allclose(whole, 2 * half, rtol=1e-6)


def test_light_walked_on_is_the_mean_of_its_walks() -> None:
    cell = next(cell for cell in cells() if cell.name == "Ketchup R")
    first, second = more(cell, None, 4000, 1), more(cell, None, 12000, 2)
    both = more(cell, first, 12000, 2)
    np.testing.assert_allclose(both.rd, 0.25 * first.rd + 0.75 * second.rd, rtol=1e-12)
    assert both.photons == first.photons + second.photons
    assert both.rd.size == edges_mm(cell).size - 1


def test_trials_on_light_of_their_own_hold_and_say_where_no_light_came() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told, dark = run_trials(
            lights=[shipped()["Chicken1 R"], shipped()["Ketchup B"]], trials=40, models=["mc"], own_steps=1e5
        )
    assert told.judged == 40
    assert min(told.inside) >= 34
    assert told.bound == told.bound_of_noise
    assert (dark.judged, dark.refused) == (0, 40)
    assert "Ketchup B" in table([told, dark])
