"""Exports look as measured: the walk that a file describes, photon by photon, has the measured medium's light."""

from __future__ import annotations

import ast
import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bssrdf.export.blender import LIMITS, blender_text
from bssrdf.export.bounce_walk import N_RHO, bounce_walk, make_table, orders, rho_edges
from bssrdf.export.closure import DEPTHS, Limits, MatchedWalk, mismatch, solve
from bssrdf.export.inversions import van_de_hulst, wrenninge
from bssrdf.export.loss import lost_share
from bssrdf.export.material import ExportMaterial, find_materials
from bssrdf.export.mitsuba import dipole_like
from bssrdf.export.solved import Setting
from bssrdf.export.spread import WalkMedium, measured_spread, walk_spread
from bssrdf.transport.discrete_ordinates import half_space
from bssrdf.transport.engine import MonteCarloMedium, Tally, simulate
from bssrdf.transport.materials import load_materials
from bssrdf.transport.photon import stream_states

ONE = np.array([1.0])
MARBLE_G = WalkMedium(0.0041, 2.62, 1.5)


def albedo_of_new_rule(colour: float) -> float:
    """As Blender from 5.2 on reads a colour: van de Hulst's fit, solved for the albedo."""
    s = 4.09712 + 4.20863 * colour - math.sqrt(9.59217 + 41.6808 * colour + 17.7126 * colour**2)
    return 1 - s * s


def albedo_of_old_rule(colour: float) -> float:
    """As Blender up to 5.1 reads it: Wrenninge et al. 2017 at g = 0, with the constants as printed."""
    a, b, c = 1.8260523782, 4.98511194385 + 0.127355959438, 1.09686102424
    d, e, f = 0.496310210422, 4.23190299701 + 0.00310603949088, 2.40602999408
    blend = colour**0.25
    return min((1 - blend) * a * math.atan(b * colour) ** c + blend * d * math.atan(e * colour) ** f, 0.999999)


RULES = {"5.2": (albedo_of_new_rule, 1.0), "5.1": (albedo_of_old_rule, 4 * math.pi)}


def numbers_of(text: str) -> dict[str, Any]:
    """What a Blender file says, read without running it."""
    tree = ast.parse(text)
    return {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }


class Followed:
    """Photons of Cycles' random walk as a file describes it, in one channel: 256 bounces, albedo not below 0.2."""

    def __init__(self, walks: list[tuple[float, float, float]], photons: int, seed: int) -> None:
        self.parts = []
        for weight, albedo, mfp in walks:
            scores = np.zeros((256, N_RHO))
            [state] = stream_states(seed, 1)
            bounce_walk(photons, state, scores)
            walked = max(albedo, 0.2)
            by_order = weight * min(1.0, albedo / 0.2) * walked ** np.arange(1, 257)
            self.parts.append((by_order @ scores / photons, mfp, by_order**2 @ scores / photons**2))

    @property
    def total(self) -> float:
        return float(sum(light.sum() for light, _, _ in self.parts))

    @property
    def total_se(self) -> float:
        return float(np.sqrt(sum(variance.sum() for _, _, variance in self.parts)))

    def beyond(self, x_mm: float) -> tuple[float, float]:
        """Light at a depth into the shadow of an edge, and its standard error."""
        value = variance = 0.0
        for light, mfp, noise in self.parts:
            r = mfp * (rho_edges()[1:] + rho_edges()[:-1]) / 2
            share = np.arccos(np.minimum(x_mm / r, 1.0)) / np.pi
            value += float(share @ light)
            variance += float(share**2 @ noise)
        return value, math.sqrt(variance)


def walks_in(numbers: dict[str, Any], version: str, channel: int, mm: float) -> list[tuple[float, float, float]]:
    """(weight, albedo, mean free path in mm) of the walks of one channel."""
    albedo, per_mfp = RULES[version]
    rule = numbers["rules"][version]
    walks = [(1.0, albedo(rule["colour"][channel]), rule["radius"][channel] * mm / per_mfp)]
    if rule["second"] and rule["second"]["colour"][channel] > 0:
        second = rule["second"]
        walks.append((second["weight"], albedo(second["colour"][channel]), second["radius"][channel] * mm / per_mfp))
    return walks


@pytest.fixture(scope="module")
def exported() -> dict[str, dict[str, Any]]:
    """What Blender files say of all published materials."""
    text = blender_text([find_materials(name)[0] for name in load_materials()], Setting("", "appearance", "m"))
    return {numbers["name"]: numbers for numbers in numbers_of(text)["MATERIALS"]}


@pytest.mark.parametrize("albedo", [0.02, 0.5, 0.9, 0.97])
def test_orders_of_the_walk_add_up_to_the_exact_total(albedo: float) -> None:
    total = (albedo ** np.arange(1, 257)) @ orders().sum(1)
    assert total == pytest.approx(half_space(albedo, 0.0, 1.0, ONE).total, rel=1e-3)


def test_table_of_orders_is_what_its_walk_makes(tmp_path: Path) -> None:
    make_table(tmp_path / "small.npz", 64_000, seed=7)
    with np.load(tmp_path / "small.npz") as small:
        found = small["counts"].sum(1) / small["n_photons"]
    expected = orders().sum(1)
    np.testing.assert_allclose(found[:8], expected[:8], atol=5 * np.sqrt(expected[:8] / 64_000).max())
    assert found.sum() == pytest.approx(expected.sum(), abs=0.005)


@pytest.mark.parametrize("albedo", [0.2, 0.5, 0.9, 0.99, 0.999, 0.99999])
def test_renderers_read_back_the_albedo_that_a_colour_stands_for(albedo: float) -> None:
    assert albedo_of_new_rule(van_de_hulst(albedo)) == pytest.approx(albedo, abs=1e-5)
    assert albedo_of_old_rule(wrenninge(albedo)) == pytest.approx(albedo, abs=2e-7)


@pytest.mark.parametrize("version", ["5.2", "5.1"])
def test_walks_of_all_published_materials_have_the_measured_total(exported: Any, version: str) -> None:
    for name, line in load_materials().items():
        for i, channel in enumerate("RGB"):
            medium = WalkMedium(line.sigma_a_per_mm[i], line.sigma_sp_per_mm[i], line.eta)
            seen = Followed(walks_in(exported[name], version, i, 1000.0), 20_000, seed=11 + i)
            assert abs(seen.total / medium.total - 1) < 0.01 + 3 * seen.total_se / medium.total, (name, channel)


@functools.cache
def simulated(medium: WalkMedium) -> Tally:
    """The measured medium, photon by photon."""
    edges = np.append(np.concatenate([[0.0], np.geomspace(0.01, 30, 150)]) / medium.sigma_tr, 1e4)
    walked = MonteCarloMedium.reduced(medium.sigma_a, medium.sigma_sp, medium.g, medium.eta)
    return simulate(walked, r_edges_mm=edges, n_photons=4000, seed=2)


@pytest.mark.parametrize(("name", "channel"), [("Marble", 1), ("Skin1", 0), ("Wholemilk", 0), ("Cream", 0)])
@pytest.mark.parametrize("version", ["5.2", "5.1"])
def test_edge_of_a_shadow_is_the_measured_mediums(exported: Any, name: str, channel: int, version: str) -> None:
    material = find_materials(name)[0]
    medium = material.media[channel]
    seen = Followed(walks_in(exported[name], version, channel, 1000.0), 200_000, seed=3)
    tally = simulated(medium)
    rd, rd_se = tally.rd()
    edges = tally.r_edges_mm
    r, light, noise = (edges[1:] + edges[:-1]) / 2, rd * tally.area_mm2, rd_se * tally.area_mm2
    for depth in (0.1, 0.5, 1.0, 1.5):
        x = depth / medium.sigma_tr
        share = np.arccos(np.minimum(x / r, 1.0)) / np.pi
        true, true_se = float(share @ light), float(np.hypot.reduce(share * noise))
        value, se = seen.beyond(x)
        assert abs(value / true - 1) < 0.12 + 2 * math.hypot(se / value, true_se / true), depth
        lit = (medium.total - true, seen.total - value)
        assert abs(lit[1] / lit[0] - 1) < 0.03 + 2 * math.hypot(se, true_se) / lit[0], depth


def test_verbatim_coefficients_would_be_far_too_bright() -> None:
    """The mistake that this folder is there to avoid."""
    for i, excess in enumerate((0.29, 0.53, 0.69)):
        medium = find_materials("Skin1")[0].media[i]
        albedo = medium.sigma_sp / medium.sigma_tp
        assert walk_spread(albedo, 1.0, 256).total / medium.total - 1 == pytest.approx(excess, abs=0.02)


def test_limits_of_the_renderer_are_allowed_for() -> None:
    """A walk cut off after 64 bounces needs a higher albedo for the same R, and shows it."""
    short = solve(MARBLE_G, Limits(bounces=64))
    long = solve(MARBLE_G, Limits(bounces=256))
    assert short.first.albedo > long.first.albedo
    assert short.light.total == pytest.approx(MARBLE_G.total, abs=1e-6)


def test_second_walk_is_there_only_where_one_cannot_do_it() -> None:
    assert solve(MARBLE_G, LIMITS).second is None
    white = WalkMedium(0.0, 11.6, 1.3)
    one, two = solve(white, LIMITS._replace(second=False)), solve(white, LIMITS)
    assert one.light.total < 0.91
    assert two.light.total == pytest.approx(1.0, abs=1e-3)


def test_every_published_edge_is_within_what_docs_say() -> None:
    for name in load_materials():
        for medium in find_materials(name)[0].media:
            closure = solve(medium, LIMITS)
            shadow, lit = mismatch(closure.light, closure.measured, closure.length_mm)
            assert np.abs(shadow).max() < 0.09, name
            assert np.abs(lit).max() < 0.025, name


def test_lengths_scale_with_the_medium() -> None:
    once, twice = solve(MARBLE_G, LIMITS), solve(WalkMedium(0.0082, 5.24, 1.5), LIMITS)
    assert once.first.mfp_mm == pytest.approx(2 * twice.first.mfp_mm, rel=1e-3)
    assert once.first.albedo == pytest.approx(twice.first.albedo, abs=1e-7)


def test_light_beyond_the_edge_and_before_it_are_all_light() -> None:
    light = measured_spread(MARBLE_G)
    x = DEPTHS * 5
    np.testing.assert_allclose(light.edge(x) + light.edge(-x), light.total, rtol=1e-12)
    assert light.edge(np.array([-1e-9]))[0] == pytest.approx(light.total / 2, rel=1e-3)


def test_walk_below_the_least_albedo_is_dimmed_in_proportion() -> None:
    limits = Limits(bounces=256, least_albedo=0.2)
    assert MatchedWalk(0.05, 1.0).spread(limits).total == pytest.approx(walk_spread(0.2, 1.0, 256).total / 4)


@pytest.mark.parametrize("depth", [64, 128, 256])
def test_share_lost_after_many_bounces_is_that_of_the_orders(depth: int) -> None:
    medium = WalkMedium(0.002, 0.998, 1.0)
    kept = (0.998 ** np.arange(1, depth + 1)) @ orders()[:depth].sum(1)
    assert lost_share(medium, depth) == pytest.approx(1 - kept / medium.total, abs=0.004)


def test_dipole_of_our_own_integrator_adds_up_to_the_measured_total() -> None:
    from bssrdf.transport.dipole import Medium as Dipole
    from bssrdf.transport.dipole import total_r
    from bssrdf.transport.single import first_order_total

    for medium in find_materials("Skin1")[0].media:
        matched = dipole_like(medium)
        terms = float(total_r(Dipole(matched.sigma_a, matched.sigma_sp, matched.eta)))
        terms += float(first_order_total(matched.sigma_s, matched.sigma_a, 0.0, matched.eta))
        assert terms == pytest.approx(medium.total, rel=1e-4)


def test_forward_scattering_is_taken_into_the_walk() -> None:
    """At one σs′ the total depends on g: the walk follows the medium's own."""
    isotropic, forward = WalkMedium(0.17, 0.88, 1.3), WalkMedium(0.17, 0.88, 1.3, 0.8)
    assert forward.total < 0.95 * isotropic.total
    assert solve(forward, LIMITS).light.total == pytest.approx(forward.total, abs=1e-6)


def marble() -> ExportMaterial:
    return find_materials("Marble")[0]


def test_residuals_stand_in_the_file() -> None:
    text = blender_text([marble()], Setting("Blender", "appearance", "mm"))
    said = [line for line in text.splitlines() if line.startswith("# residuals")]
    assert "256 bounces; R in R, G, B: -0.0 -0.0 -0.0 %" in said[0].replace("+0.0", "-0.0")
    assert sum("R_d(r) at 0.1, 0.3, 1, 3, 10 x" in line for line in said) == 3
    assert sum("from its edge" in line for line in said) == 3
