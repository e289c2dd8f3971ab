"""The exact parts of a table: NumPy alone, at once, and equal to what other methods give."""

import subprocess
import sys
import time

import jax
import numpy as np
import pytest
from scipy.linalg import eigvalsh_tridiagonal

from bssrdf.transport.dipole import Medium
from bssrdf.transport.discrete_ordinates import N_MOMENTS, decay_constants, half_spaces
from bssrdf.transport.incidence import NORMAL, Incidence, once_scattered
from bssrdf.transport.single import first_order_rd, first_order_total
from bssrdf.transport.white.grid import N_W_CELLS, RHO_ZERO, W_MAX, albedo_of, by_cell, interpolating, q_nodes
from bssrdf.transport.white.store import COARSE_FACTOR, place, shipped, shipped_wide, table_model

SCRIPT = """
import sys
from bssrdf.transport.white.store import table_model
model = table_model(1.37, 0.13)
assert model.log_curve.shape[1] == 4
print(*sorted(name for name in ("jax", "scipy", "numba", "matplotlib") if name in sys.modules))
"""


def test_a_table_is_made_without_jax_or_scipy():
    done = subprocess.run([sys.executable, "-c", SCRIPT], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == ""


def test_a_table_between_the_nodes_is_ready_at_once():
    """In processor time, so that threads that wait for each other count; 0.05 s on the machine this was written on."""
    table_model(1.3, 0.0)
    start = time.process_time()
    shipped().model(1.36, 0.42)
    assert time.process_time() - start < 0.5


@pytest.mark.parametrize("g", [-0.7, 0.0, 0.8, 0.95])
def test_decay_constants_are_the_largest_eigenvalues(g):
    albedo = albedo_of(q_nodes(), g)
    order = np.arange(N_MOMENTS)
    for a, kappa in zip(albedo[1::6], decay_constants(albedo, g)[1::6], strict=True):
        h = (2 * order + 1) * (1 - a * g**order)
        coupling = order[1:] / np.sqrt(h[:-1] * h[1:])
        [largest] = eigvalsh_tridiagonal(np.zeros(N_MOMENTS), coupling, select="i", select_range=(N_MOMENTS - 1,) * 2)
        assert kappa == pytest.approx(min(1, 1 / largest), rel=1e-12)


@pytest.mark.parametrize(("eta", "g"), [(1.0, 0.0), (1.3, 0.8), (1.5, -0.5), (3.0, 0.95)])
def test_light_scattered_once_is_the_same_with_and_without_jax(eta, g):
    rho = RHO_ZERO * np.expm1(np.linspace(0, W_MAX, N_W_CELLS + 1))[1:60]
    once = once_scattered(eta, g, NORMAL, rho)
    with jax.enable_x64(True):
        light = np.asarray(first_order_rd(1.0, 0.0, g, eta, rho))
        total = float(first_order_total(1.0, 0.0, g, eta))
    assert np.log(light * rho) + once.decay * rho == pytest.approx(np.log(once.light), abs=1e-11)
    assert once.total == pytest.approx(total, rel=1e-12)


def test_half_spaces_agree_with_their_own_limit_of_many_ordinates():
    albedo = np.array([0.05, 0.9, 0.9999])
    few, many = (half_spaces(albedo, 0.8, 1.4, np.array([0.7]), n).total for n in (40, 64))
    assert few == pytest.approx(many, rel=5e-5)


def test_splines_go_through_their_values_and_on_as_cubics():
    knots = np.arange(13.0)
    cells = by_cell(interpolating(knots**3 - 5 * knots))
    middle = cells[:, 5] @ 0.5 ** np.arange(4)
    assert middle == pytest.approx(5.5**3 - 5 * 5.5)
    assert cells[0] == pytest.approx((knots**3 - 5 * knots)[:-1])


@pytest.mark.parametrize("angle", [20, 45, 60, 80])
def test_light_scattered_once_from_an_oblique_beam_adds_up(angle):
    rho = np.geomspace(1e-7, 60, 20_001)
    once = once_scattered(1.4, 0.8, Incidence(angle), rho)
    curve = 2 * np.pi * once.light * np.exp(-once.decay * rho)
    assert np.trapezoid(curve, rho) + curve[0] * rho[0] == pytest.approx(once.total, rel=1e-5)


@pytest.mark.parametrize("across", [False, True])
def test_an_oblique_beam_ends_in_a_normal_one(across):
    rho = np.array([0.01, 1.0, 5.0])
    normal, oblique = (once_scattered(1.4, 0.8, Incidence(angle, across), rho) for angle in (0.0, 0.5))
    scale = np.exp(-(oblique.decay - normal.decay) * rho)
    assert oblique.light * scale == pytest.approx(normal.light, rel=0.02)
    totals = [
        half_spaces(np.array([0.5, 0.99]), 0.8, 1.4, np.array([1.0]), sin_incidence=sine).total for sine in (0, 1e-4)
    ]
    assert totals[1] == pytest.approx(totals[0], rel=1e-6)


@pytest.mark.parametrize(("eta", "g"), [(1.33, 0.6), (1.45, 0.2), (1.5, 0.8)])
def test_coarse_tables_agree_with_fine_ones_between_their_nodes(eta, g):
    with jax.enable_x64(True):
        radii = np.geomspace(0.1, 8, 20)
        coarse, fine = (
            np.array([tables.model(eta, g).rd(Medium(a, 1.0, eta), radii) for a in (0.01, 0.1, 1.0)])
            for tables in (shipped_wide(), shipped())
        )
    assert np.sqrt(np.mean((coarse / fine - 1) ** 2)) < 0.01
    assert coarse == pytest.approx(fine, rel=0.04)


def light_of(model, radii):
    return np.array([model.rd(Medium(a, 1.0, float(model.eta)), radii) for a in (0.01, 0.1)])


@pytest.mark.parametrize("eta", [1.3, 1.5])
@pytest.mark.parametrize("g", [0.0, 0.8])
def test_fine_tables_tell_of_media_beyond_their_last_node(eta, g):
    """Predicted without the fine table there, which the walks of all others know nothing of."""
    fine, coarse, others = shipped().of(g), shipped_wide().of(g), shipped().etas != eta
    without = fine._replace(etas=fine.etas[others], **{n: getattr(fine, n)[:, others] for n in fine._fields[2:]})
    with jax.enable_x64(True):
        radii = np.geomspace(0.3, 10, 20)
        found, expected = (
            light_of(tables.model(eta, g), radii) for tables in (without.widened(coarse, COARSE_FACTOR), fine)
        )
    assert found == pytest.approx(expected, rel=0.004)


@pytest.mark.parametrize("eta", [1.3, 1.5])
def test_light_does_not_jump_where_coarse_tables_take_over(eta):
    with jax.enable_x64(True):
        below, above = (light_of(table_model(eta + step, 0.3), np.geomspace(0.1, 20, 20)) for step in (-1e-6, 1e-6))
    assert above == pytest.approx(below, rel=1e-4)


@pytest.mark.parametrize(("eta", "g"), [(1.0, 0.0), (1.7, 0.8), (2.5, 0.5), (3.0, 0.85)])
def test_usual_media_out_to_an_index_of_3_need_no_waiting(eta, g):
    assert place(eta, g).origin == "shipped"
