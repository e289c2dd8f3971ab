"""The dipole and its radius sampling on Dr.Jit arrays, against the literal forms of transport/."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

from bssrdf.errors import InputError
from bssrdf.render import sampling
from bssrdf.render.variant import ADVICE, find_backend, use_variant
from bssrdf.transport import dipole
from bssrdf.transport.fresnel import boundary_a

pytestmark = pytest.mark.usefixtures("x64")

MEDIA = [
    pytest.param(dipole.Medium(0.0041, 2.62, 1.5), id="marble"),
    pytest.param(dipole.Medium(1.45, 0.03, 1.3), id="ketchup, blue"),
    pytest.param(dipole.Medium(0.0, 20.4, 1.3), id="no absorption"),
    pytest.param(dipole.Medium(1e-6, 0.999999, 1.3), id="albedo 0.999999"),
]
N = 1 << 16


@pytest.fixture(autouse=True)
def _mono() -> None:
    if find_backend() is None:
        pytest.skip(ADVICE)
    use_variant("mono")


def on_device(medium: dipole.Medium) -> sampling.DipoleSources:
    import mitsuba as mi

    boundary = float(boundary_a(medium.eta))
    return sampling.dipole(mi.Float(medium.sigma_a), mi.Float(medium.sigma_sp), mi.Float(boundary))


def radii(medium: dipole.Medium, law: sampling.Law, seed: int) -> np.ndarray:
    import mitsuba as mi

    u = mi.Float(np.random.default_rng(seed).random(N, dtype=np.float32))
    return np.array(sampling.sample_radius(on_device(medium), u, law), np.float64)


def chi2_p_value(cdf_of_samples: np.ndarray) -> float:
    counts, _ = np.histogram(cdf_of_samples, bins=64, range=(0, 1))
    assert counts.sum() == N
    return float(stats.chisquare(counts).pvalue)


@pytest.mark.parametrize("medium", MEDIA)
def test_exact_radii_follow_the_dipoles_tail(medium: dipole.Medium) -> None:
    r = radii(medium, "exact", seed=1)
    cdf = 1 - np.asarray(dipole.tail(medium, r)) / float(dipole.total_r(medium))
    assert chi2_p_value(cdf) > 1e-4


@pytest.mark.parametrize("medium", MEDIA[:2])
def test_exponential_radii_follow_the_papers_density(medium: dipole.Medium) -> None:
    r = radii(medium, "exponential", seed=2)
    assert chi2_p_value(-np.expm1(-float(medium.sigma_tr) * r)) > 1e-4


@pytest.mark.parametrize("law", sampling.LAWS)
@pytest.mark.parametrize("medium", MEDIA)
def test_density_over_the_plane_integrates_to_one(medium: dipole.Medium, law: sampling.Law) -> None:
    import mitsuba as mi

    r = np.geomspace(1e-4, 1e6, 20_000) / medium.sigma_tp
    density = np.array(sampling.radius_density(on_device(medium), mi.Float(np.square(r).astype(np.float32)), law))
    assert np.trapezoid(2 * np.pi * r * r * density, np.log(r)) == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("medium", MEDIA)
def test_profile_in_single_precision_is_that_of_transport(medium: dipole.Medium) -> None:
    import mitsuba as mi

    r = np.concatenate([[0], np.geomspace(1e-3, 30, 50)]) / medium.sigma_tp
    here = np.array(sampling.rd_flat(on_device(medium), mi.Float(np.square(r).astype(np.float32))), np.float64)
    np.testing.assert_allclose(here, np.asarray(dipole.rd(medium, r)), rtol=1e-4)


@pytest.mark.parametrize("medium", MEDIA)
def test_nothing_is_lost_within_reach_but_the_tail(medium: dipole.Medium) -> None:
    farthest = float(np.array(sampling.reach(on_device(medium)))[0])
    assert float(dipole.tail(medium, farthest)) <= 1.1 * sampling.TAIL * float(dipole.total_r(medium))


@pytest.mark.parametrize("law", sampling.LAWS)
@pytest.mark.parametrize("medium", MEDIA)
def test_the_ends_of_the_random_numbers_give_finite_radii(medium: dipole.Medium, law: sampling.Law) -> None:
    import mitsuba as mi

    r = np.array(sampling.sample_radius(on_device(medium), mi.Float([0, 1e-7, 0.5, 1 - 2.0**-24, 1]), law))
    assert np.all(np.isfinite(r))
    assert np.all(r >= 0)


def test_a_library_that_is_none_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bssrdf.render.variant.find_backend", lambda: None)
    with pytest.raises(InputError, match="apt install libllvm19") as caught:
        use_variant()
    assert "\n" not in str(caught.value)
