"""Tables of oblique beams against the absorbing engine and against a walk written out once more."""

import math

import jax
import numpy as np
import pytest
from numba import njit

from bssrdf.errors import InputError
from bssrdf.transport.dipole import Medium
from bssrdf.transport.engine import IncidentBeam, MonteCarloMedium, simulate
from bssrdf.transport.incidence import Incidence
from bssrdf.transport.white.store import place, table_model

ETA, G, ANGLE = 1.4, 0.6, 50.0
SIGMA_A, SIGMA_SP = 0.3, 1.0
EDGES = np.append(0.0, np.geomspace(0.1, 6, 13))
CORE_SECONDS = 8.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tables")


def rd_of(beam, folder):
    with jax.enable_x64(True):
        model = table_model(ETA, G, beam=beam, directory=folder, core_seconds=CORE_SECONDS)
        return np.asarray(model.bin_average(Medium(SIGMA_A, SIGMA_SP, ETA), EDGES[:-1], EDGES[1:])), model


def test_the_mean_over_azimuths_is_that_of_the_engine(folder):
    value, model = rd_of(Incidence(ANGLE), folder)
    medium = MonteCarloMedium.reduced(SIGMA_A, SIGMA_SP, G, ETA)
    tally = simulate(medium, IncidentBeam(0.0, ANGLE), r_edges_mm=EDGES, n_photons=400_000, seed=8)
    expected, error = tally.rd()
    z = (value - expected) / np.hypot(error, 0.015 * expected)
    assert np.mean(z**2) < 1.6
    with jax.enable_x64(True):
        normal = np.asarray(table_model(1.4, G).bin_average(Medium(SIGMA_A, SIGMA_SP, ETA), EDGES[:-1], EDGES[1:]))
        total = float(model.total(Medium(SIGMA_A, SIGMA_SP, ETA)))
    assert np.mean(((normal - expected) / np.hypot(error, 0.015 * expected)) ** 2) > 4
    assert total == pytest.approx(tally.total_r()[0], abs=4 * tally.total_r()[1])


def test_across_the_plane_of_incidence_it_is_that_of_a_literal_walk(folder):
    value, _ = rd_of(Incidence(ANGLE, across=True), folder)
    sigma_s = SIGMA_SP / (1 - G)
    batches = np.array(
        [
            literal_walk(40_000, seed, SIGMA_A, sigma_s, G, ETA, math.sin(math.radians(ANGLE)) / ETA, EDGES)
            for seed in range(20)
        ]
    )
    expected, error = batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(20)
    used = error < 0.1 * expected
    assert used.sum() >= 8
    z = (value - expected)[used] / np.hypot(error, 0.03 * expected)[used]
    assert np.mean(z**2) < 2
    around, _ = rd_of(Incidence(ANGLE), folder)
    assert np.mean(((around - expected)[used] / np.hypot(error, 0.03 * expected)[used]) ** 2) > 2 * np.mean(z**2)


def test_a_table_of_another_angle_is_not_taken_for_it(folder):
    rd_of(Incidence(ANGLE), folder)
    assert place(ETA, G, beam=Incidence(ANGLE), directory=folder).origin == "cached"
    assert place(ETA, G, beam=Incidence(ANGLE + 1), directory=folder).origin == "made"
    assert place(ETA, G, beam=Incidence(0.0), directory=folder).origin == "shipped"
    [made] = folder.glob("*at50.0.npz")
    made.with_name(made.name.replace("at50.0", "at20.0")).write_bytes(made.read_bytes())
    with pytest.raises(InputError, match="kind"):
        table_model(ETA, G, beam=Incidence(20.0), directory=folder)


@njit
def literal_walk(n, seed, sigma_a, sigma_s, g, eta, sine, edges):
    """R_d by ring, from light that leaves within 15 degrees of a right angle to the plane of incidence.

    Every step as the textbook has it: exponential paths, Henyey and Greenstein's cosine, Fresnel's reflection by lot.
    """
    np.random.seed(seed)  # noqa: NPY002
    out = np.zeros(edges.size - 1)
    sigma_t = sigma_a + sigma_s
    for _ in range(n):
        x, y, z, w = 0.0, 0.0, 0.0, 1.0
        ux, uy, uz = sine, 0.0, math.sqrt(1 - sine * sine)
        while w > 1e-4:
            d = -math.log(1 - np.random.random()) / sigma_t  # noqa: NPY002
            gone = False
            while z + d * uz < 0:
                b = -z / uz
                x, y, z, d = x + ux * b, y + uy * b, 0.0, d - b
                cos_i = -uz
                sin_t = eta * math.sqrt(1 - cos_i * cos_i)
                reflected = 1.0
                if sin_t < 1:
                    cos_t = math.sqrt(1 - sin_t * sin_t)
                    r_s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
                    r_p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
                    reflected = (r_s * r_s + r_p * r_p) / 2
                if np.random.random() >= reflected:  # noqa: NPY002
                    r = math.sqrt(x * x + y * y)
                    if abs(x) < r * math.sin(math.pi / 12):
                        at = np.searchsorted(edges, r) - 1
                        if at < out.size:
                            out[at] += w
                    gone = True
                    break
                uz = -uz
            if gone:
                break
            x, y, z = x + d * ux, y + d * uy, z + d * uz
            w *= sigma_s / sigma_t
            t = (1 - g * g) / (1 - g + 2 * g * np.random.random())  # noqa: NPY002
            c = (1 + g * g - t * t) / (2 * g)
            s, phi = math.sqrt(max(0.0, 1 - c * c)), 2 * math.pi * np.random.random()  # noqa: NPY002
            h = math.sqrt(max(1e-12, 1 - uz * uz))
            vx = s * (ux * uz * math.cos(phi) - uy * math.sin(phi)) / h + ux * c
            vy = s * (uy * uz * math.cos(phi) + ux * math.sin(phi)) / h + uy * c
            vz = -s * math.cos(phi) * h + uz * c
            ux, uy, uz = vx, vy, vz
    return out / n * 6 / (np.pi * (edges[1:] ** 2 - edges[:-1] ** 2))
