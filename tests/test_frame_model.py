"""What comparisons of frames tell: the simplest model that they bear, and errors that grow with their disagreement."""

from __future__ import annotations

import numpy as np
import pytest

from bssrdf.calib.exposures import Comparison, InCommon, shared_noise
from bssrdf.calib.frame_model import leak_of, solve_frames
from bssrdf.calib.frame_solution import Exposed

LABELS_S = [0.001 * 4**k for k in range(6)]
SPAN, NOISE, REL_SD = 16_000.0, 0.8, 3e-4
LEVELS = np.geomspace(20, 3500, 8)
"""Signal of the shorter of two exposures [DN]."""


def frames(kinds=("sample", "reference"), rel_sd=0.03):
    return [Exposed(kind, t, t, rel_sd) for kind in kinds for t in LABELS_S]


def comparisons(scale, *, offset=0.0, bend=0.0, leak=0.0, scatter=1.0, seed=0):
    """Of every neighbouring pair, with the errors that they state times `scatter`; scale and offset by frame (12,)."""
    rng = np.random.default_rng(seed)
    offset = np.broadcast_to(offset, 12)
    found = []
    for first in (*range(5), *range(6, 11)):
        second = first + 1
        for level in LEVELS:
            for beside in (False, True):
                straight = np.array([level, 4 * level * np.exp(scale[second] - scale[first])])
                shown = straight * (1 - bend * straight / SPAN) + offset[[first, second]] + np.array([0, leak * beside])
                shown[1] *= np.exp(scatter * REL_SD * rng.standard_normal())
                found.append(Comparison(first, second, 0, False, beside, *shown.tolist(), REL_SD**2))
    return found


def solved(scale, rel_sd=0.03, **world):
    given = comparisons(scale, **world)
    return solve_frames(frames(rel_sd=rel_sd), given, 1, NOISE, SPAN), given


def about_mean(scale):
    return scale - scale.mean()


def test_frames_without_fault_keep_their_labels_and_get_nothing_else():
    model, _ = solved(np.zeros(12))
    assert np.abs(about_mean(model.log_scale)).max() < 2e-3
    assert not model.offset_dn.any()
    assert model.bend == 0
    assert model.lamp_rel_sd < 1e-4
    assert model.contradiction < 1e-4


def test_what_both_kinds_show_is_the_labels_error_and_cancels_between_them():
    off = np.tile(np.random.default_rng(1).uniform(-0.03, 0.03, 6), 2)
    model, _ = solved(off)
    np.testing.assert_allclose(about_mean(model.log_scale), about_mean(off), atol=2e-3)
    assert model.lamp_rel_sd < 1e-4
    across = np.array([1, 0, 0, 0, 0, 0, -1, 0, 0, 0, 0, 0])
    assert across @ model.covariance @ across < 1e-8


def test_a_lamp_that_falls_within_one_bracket_widens_what_the_kinds_have_in_common():
    fall = np.concatenate([np.linspace(0, -0.05, 6), np.zeros(6)])
    model, _ = solved(fall)
    for kind in (slice(6), slice(6, 12)):
        np.testing.assert_allclose(about_mean(model.log_scale[kind]), about_mean(fall[kind]), atol=2e-3)
    across = np.repeat([1 / 6, -1 / 6], 6)
    found = across @ model.log_scale - across @ fall
    assert abs(found) < 2 * np.sqrt(across @ model.covariance @ across)


@pytest.mark.parametrize("offset", [-3.0, 0.7])
def test_black_that_lies_off_the_darks_of_one_kind_is_found_and_bends_nothing(offset):
    model, _ = solved(np.zeros(12), offset=np.repeat([offset, 0.0], 6))
    np.testing.assert_allclose(model.offset_dn[:6, 0], offset, atol=0.1)
    np.testing.assert_allclose(model.offset_dn[6:, 0], 0, atol=0.1)
    assert abs(model.bend) < 0.003
    assert np.abs(about_mean(model.log_scale)).max() < 3e-3


def test_a_response_that_bends_is_told_from_labels_that_are_exact():
    model, _ = solved(np.zeros(12), rel_sd=0.0005, bend=0.05)
    assert model.bend == pytest.approx(0.05, rel=0.15)
    assert np.abs(model.log_scale).max() < 2e-3


def test_comparisons_that_contradict_each_other_enlarge_every_error():
    calm, wild = (solved(np.zeros(12), scatter=scatter)[0] for scatter in (1.0, 30.0))
    assert wild.contradiction == pytest.approx(30 * REL_SD, rel=0.3)
    shape = np.eye(12) - np.kron(np.eye(2), np.full((6, 6), 1 / 6))
    spread = [np.sqrt(np.diag(shape @ model.covariance @ shape)).mean() for model in (calm, wild)]
    assert spread[1] > 5 * spread[0]


def test_what_saturated_neighbours_add_is_found_apart():
    model, given = solved(np.zeros(12), leak=2.0)
    leak = leak_of(model, frames(), given, NOISE, SPAN)
    assert leak.dn[0] == pytest.approx(2.0, abs=4 * leak.sd_dn[0] + 0.1)
    assert leak.contradiction == pytest.approx(model.contradiction, abs=1e-3)
    assert not model.offset_dn.any()


def test_a_leak_that_one_number_does_not_explain_is_an_error_of_the_light():
    off = np.log(1.03) * np.array([1, -1])
    model, given = solved(np.zeros(12), leak=2.0)
    apart = [c for c in given if not c.second_beside]
    beside = [c for c in given if c.second_beside]
    uneven = [c._replace(longer=c.longer * np.exp(off[at % 2])) for at, c in enumerate(beside)]
    found = leak_of(model, frames(), [*apart, *uneven], NOISE, SPAN).contradiction
    share = len(beside) / len(given)
    assert found == pytest.approx(0.03 * share**0.5, rel=0.2)


def noisy(scale, repeats=1, seed=0, noise=10.0):
    """A session whose frames were taken `repeats` times, of `noise` times the usual errors."""
    given = [comparisons(scale, scatter=noise, seed=seed + each) for each in range(repeats)]
    mean = [
        alike[0]._replace(
            longer=float(np.mean([each.longer for each in alike])), log_var=(noise * REL_SD) ** 2 / repeats
        )
        for alike in zip(*given, strict=True)
    ]
    return solve_frames(frames(), mean, 1, NOISE / repeats**0.5, SPAN)


def test_a_drift_that_no_step_shows_is_held_more_often_than_not():
    """1 % over the bracket of the sample, steps of 0.2 % with errors of 0.1 %."""
    across = np.repeat([1 / 6, -1 / 6], 6)
    fall = np.concatenate([np.linspace(0, -0.01, 6), np.zeros(6)])
    held = []
    for seed in range(30):
        model = noisy(fall, seed=seed)
        off = across @ (model.log_scale - fall)
        held.append(abs(off) < 1.96 * np.sqrt(across @ model.covariance @ across))
    assert np.mean(held) > 0.5  # of steps that vary alone and a drift of as much, 0.3


def test_no_error_jumps_where_a_lamp_comes_to_be_seen():
    shape = np.array([0, 1, -1, 0, 1, 0, 0, -1, 0, 1, 1, 0])
    across = np.repeat([1 / 6, -1 / 6], 6)
    models = [noisy(swing * shape) for swing in np.geomspace(1e-4, 3e-2, 100)]
    sd = [np.sqrt(across @ model.covariance @ across) for model in models]
    assert sd[-1] > 20 * sd[0]
    assert np.diff(np.log(sd)).max() < 0.4


def test_repeats_shrink_errors_as_their_root_but_where_chance_looks_like_a_lamp():
    across = np.array([0.2, 0.2, 0.2, 0.2, 0.1, 0.1, -0.4, -0.2, -0.1, -0.1, -0.1, -0.1])
    sd = np.zeros((40, 4))
    for seed, row in enumerate(sd):
        for at, repeats in enumerate((1, 2, 4, 8)):
            model = noisy(np.zeros(12), repeats, 8 * seed)
            of_images = 1.4e-3 / repeats**0.5  # photon noise of the two images in `bssrdf bench frames`
            row[at] = np.sqrt(across @ model.covariance @ across + of_images**2)
    np.testing.assert_allclose(np.median(sd, axis=0), np.median(sd[:, 0]) / np.sqrt([1, 2, 4, 8]), rtol=0.1)
    assert np.mean((np.diff(sd) > 0).any(axis=1)) <= 0.05  # a lamp that is looked for is found by chance as often
    assert np.exp(np.diff(np.log(sd))).max() < 1.5


def test_errors_of_a_chain_are_those_of_photons_counted_by_three_exposures_of_the_same_pixels():
    rng = np.random.default_rng(0)
    mean = np.array([400.0, 1600.0, 6400.0])
    n, world = 50, [Exposed("sample", t, t, 10.0) for t in (1, 4, 16)]
    ends, stated = [], []
    for _ in range(300):
        x = rng.poisson(n * mean) / n
        both = [
            Comparison(k, k + 1, 0, False, False, float(x[k]), float(x[k + 1]),
                       1 / (n * mean[k]) + 1 / (n * mean[k + 1]))
            for k in (0, 1)
        ]  # fmt: skip
        shared = [InCommon(0, 1, shared_noise(both[0], n, both[1], n, n * float(x[1])))]
        model = solve_frames(world, both, 1, NOISE, SPAN, shared)
        end = np.array([-1, 0, 1])
        ends.append(end @ model.log_scale)
        stated.append(np.sqrt(end @ model.covariance @ end))
    assert np.std(ends) == pytest.approx(np.mean(stated), rel=0.1)
