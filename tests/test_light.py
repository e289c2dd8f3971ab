"""The reduced models that fits look at: the same light as the models elsewhere, slopes that are right, both engines."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bssrdf.transport import fresnel
from bssrdf.transport.arrays import NUMPY, JaxEngine
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import Azimuths, DipoleModel
from bssrdf.transport.light import Light, boundary_a, coefficients, dipole, exit_norm, shape_of, table_of
from bssrdf.transport.light import transmittance as ft
from bssrdf.transport.q_root import q_of_total
from bssrdf.transport.white.store import table_model

MODELS = {
    "dipole": (dipole(1.5), DipoleModel(1.5)),
    "dipole, dense": (dipole(2.3), DipoleModel(2.3)),
    "table": (table_of(table_model(1.4, 0.8)), table_model(1.4, 0.8)),
}
QS = (1e-3, 0.1, 1.4)
X = np.geomspace(0.02, 150, 60)[None]
MU, AZIMUTHS = float(np.cos(np.radians(50))), Azimuths(-0.7, 0.3)


def column(q: float) -> np.ndarray:
    return np.full((1, 1), q)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("q", QS)
def test_a_look_is_the_model_s_curve_total_and_radiance(name: str, q: float, x64: None) -> None:
    light, model = MODELS[name]
    sigma_tp = 1.7
    medium = Medium(*coefficients(np.log(sigma_tp), q), light.eta)
    r = jnp.asarray(X[0] / sigma_tp)
    per_area = sigma_tp**2
    np.testing.assert_allclose(per_area * light.look(NUMPY, column(q), X)[0][0], model.rd(medium, r), rtol=1e-11)
    assert light.total(NUMPY, column(q))[0][0, 0] == pytest.approx(float(model.total(medium)), rel=1e-12)
    seen = light.radiance(NUMPY, column(q), X, MU, *AZIMUTHS)[0][0]
    np.testing.assert_allclose(per_area * seen, model.radiance(medium, r, MU, AZIMUTHS), rtol=1e-11)
    factor = light.total_radiance_factor(NUMPY, column(q), MU)[0, 0]
    assert factor == pytest.approx(float(model.total_radiance_factor(medium, MU)), rel=1e-12)


@pytest.mark.parametrize("name", ["dipole", "table"])
@pytest.mark.parametrize("q", QS)
def test_slopes_written_out_are_those_of_automatic_differentiation(name: str, q: float, x64: None) -> None:
    light: Light = jax.tree.map(lambda each: each, MODELS[name][0])
    engine = JaxEngine()

    def check(text: Any) -> None:
        _, by_x, by_q = text(jnp.asarray(column(q)), jnp.asarray(X))
        log_x = jnp.log(jnp.asarray(X))
        along = jax.jvp(lambda v: text(column(q), jnp.exp(v))[0], (log_x,), (jnp.ones_like(log_x),))[1]
        across = jax.jvp(lambda v: text(v, X)[0], (jnp.asarray(column(q)),), (jnp.ones((1, 1)),))[1]
        np.testing.assert_allclose(by_x, along, rtol=1e-8, atol=1e-300)
        np.testing.assert_allclose(by_q, across, rtol=1e-6, atol=1e-12 * float(jnp.max(jnp.abs(across))))

    with jax.numpy_rank_promotion("allow"):
        check(lambda q, x: light.look(engine, q, x))
        check(lambda q, x: light.radiance(engine, q, x, MU, *AZIMUTHS))
    total = jax.jvp(lambda v: light.total(engine, v)[0], (jnp.asarray(column(q)),), (jnp.ones((1, 1)),))[1]
    np.testing.assert_allclose(light.total(engine, jnp.asarray(column(q)))[1], total, rtol=1e-8)


@pytest.mark.parametrize("name", MODELS)
def test_the_q_of_a_total_gives_that_total(name: str) -> None:
    light = MODELS[name][0]
    for total_r in (0.02, 0.2, 0.7, 0.95, 0.9999):
        q = q_of_total(NUMPY, light, column(total_r))
        assert light.total(NUMPY, q)[0][0, 0] == pytest.approx(total_r, rel=1e-6) or q == light.q_max
    assert q_of_total(NUMPY, light, column(1.0))[0, 0] == 0


def test_coefficients_and_shape_are_each_other_s_inverse() -> None:
    for sigma_a, sigma_sp in ((0.0, 2.0), (0.0041, 2.62), (1.45, 0.03)):
        assert coefficients(*shape_of(sigma_a, sigma_sp)) == pytest.approx((sigma_a, sigma_sp), rel=1e-12)


@pytest.mark.parametrize("eta", [0.7, 1.0, 1.3, 1.5, 2.0, 2.6])
def test_fresnel_in_numpy_is_fresnel_in_jax(eta: float, x64: None) -> None:
    mu = np.linspace(0.01, 1, 50)
    np.testing.assert_allclose(ft(np, eta, mu), fresnel.fresnel_t(eta, jnp.asarray(mu)), rtol=1e-12, atol=1e-15)
    assert exit_norm(eta) == pytest.approx(float(fresnel.exit_norm(eta)), rel=1e-12)
    assert boundary_a(eta) == pytest.approx(float(fresnel.boundary_a(eta)), rel=1e-12)


@pytest.mark.parametrize("g", [0.0, 0.8])
def test_a_table_s_noise_has_no_step_along_the_albedo(g: float) -> None:
    q = np.linspace(0.0, 1.6, 8001)[:, None]
    for x in (0.5, 5.0, 50.0):
        sd = table_of(table_model(1.3, g)).shape_sd(NUMPY, q, np.full_like(q, x))[:, 0]
        assert np.abs(np.diff(np.log(sd))).max() < 0.01
