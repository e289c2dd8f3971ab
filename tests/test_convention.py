"""The factors between a model's value and a camera's."""

import jax
import pytest

from bssrdf.errors import InputError
from bssrdf.transport.convention import camera_factor


@pytest.mark.parametrize(
    ("eta", "by_angle"),
    [
        (1.3, {0.0: 1.047, 30.0: 1.046, 45.0: 1.040, 60.0: 1.008}),
        (1.5, {0.0: 1.057, 30.0: 1.055, 45.0: 1.046, 60.0: 1.003}),
    ],
)
def test_the_fresnel_exit_has_its_known_values(eta: float, by_angle: dict[float, float]) -> None:
    for angle, factor in by_angle.items():
        seen = camera_factor(eta, flux="entering", exit="fresnel", view_angle_deg=angle, incidence_deg=0)
        assert seen == pytest.approx(factor, abs=5e-4)


@pytest.mark.parametrize("exit_", ["hemisphere", "lambertian"])
def test_only_incident_flux_changes_a_lambertian_exit(exit_: str) -> None:
    assert camera_factor(1.5, flux="entering", exit=exit_, view_angle_deg=45, incidence_deg=30) == 1
    seen = camera_factor(1.5, flux="incident", exit=exit_, view_angle_deg=45, incidence_deg=0)
    assert seen == pytest.approx(0.96, abs=1e-14)


def test_the_factors_multiply_and_need_no_interface() -> None:
    angles = {"view_angle_deg": 50.0, "incidence_deg": 40.0}
    both = camera_factor(1.4, flux="incident", exit="fresnel", **angles)
    flux = camera_factor(1.4, flux="incident", exit="hemisphere", **angles)
    exit_ = camera_factor(1.4, flux="entering", exit="fresnel", **angles)
    assert both == pytest.approx(flux * exit_, rel=1e-14)
    assert camera_factor(1.0, flux="incident", exit="fresnel", **angles) == pytest.approx(1, rel=1e-14)


def test_it_works_in_double_and_leaves_the_switch_alone() -> None:
    before = jax.config.jax_enable_x64
    assert isinstance(camera_factor(1.3, flux="incident", exit="fresnel", view_angle_deg=0, incidence_deg=0), float)
    assert jax.config.jax_enable_x64 == before


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"flux": "total"}, 'flux = "total"'),
        ({"exit": "cosine"}, 'exit = "cosine"'),
        ({"eta": float("nan")}, "eta = nan"),
        ({"eta": 0.0}, "eta = 0.0"),
        ({"view_angle_deg": 90.0}, "view_angle_deg = 90.0"),
        ({"incidence_deg": -1.0}, "incidence_deg = -1.0"),
        ({"incidence_deg": float("nan")}, "incidence_deg = nan"),
    ],
)
def test_what_cannot_be_is_named(change: dict[str, object], said: str) -> None:
    given = {"eta": 1.3, "flux": "incident", "exit": "fresnel", "view_angle_deg": 45.0, "incidence_deg": 0.0}
    with pytest.raises(InputError, match=said):
        camera_factor(**(given | change))
