"""The simulated world and its shutter controllers keep state and refuse what the devices refuse."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from near_world import NearWorld

from bssrdf.errors import InputError
from bssrdf.rig.sim.light import light_key, seen_light
from bssrdf.rig.sim.media import SampleMedium, published_sample, r_edges_mfp, sample_of, unit_medium
from bssrdf.rig.sim.peel_off import PeeledMedium, peel_off
from bssrdf.rig.sim.peel_off_lanes import BATCHES, peel_off_lanes
from bssrdf.rig.sim.scpi_device import Scpi
from bssrdf.rig.sim.serial_devices import Sc10, Uniblitz
from bssrdf.rig.sim.walked_light import walked
from bssrdf.rig.sim.world import World
from bssrdf.session.records import Material
from bssrdf.transport import MonteCarloMedium, load_materials, simulate
from bssrdf.transport.discrete_ordinates import half_space
from bssrdf.transport.exit_radiance import transmittance
from bssrdf.transport.photon import stream_states


def said(device: Any, command: bytes) -> bytes:
    whole, rest = device.take(command)
    assert rest == b""
    echo, reply = device.execute(whole)
    return echo + reply


def test_light_counts_only_while_shutter_and_beam_are_both_on() -> None:
    world = World()
    world.open(1.0, until=3.0)
    world.beam(2.0, False)
    assert world.lit_share(0.0, 4.0) == pytest.approx(0.25)
    world.beam(2.5, True)
    assert world.lit_share(2.0, 3.0) == pytest.approx(0.5)
    assert not world.is_open(3.0)


def test_a_stuck_blade_and_a_tripped_interlock_win_over_commands() -> None:
    world = World()
    world.arm(0.0, "shutter", "stuck_closed")
    world.open(1.0)
    assert not world.is_open(1.5)
    world.clear(2.0)
    world.open(2.0, until=3.0)
    world.arm(2.5, "shutter", "stuck_open")
    world.close(2.6)
    assert world.is_open(9.0)
    world.arm(9.5, "shutter", "interlock")
    assert not world.is_open(9.6)
    world.open(10.0)
    assert not world.is_open(10.0)


def test_a_fault_is_played_once_and_by_its_device() -> None:
    world = World()
    world.arm(0.0, "camera", "busy")
    assert world.fault("shutter") is None
    assert world.fault("camera") == "busy"
    assert world.fault("camera") is None


def test_the_sc10_toggles_closes_by_itself_and_refuses() -> None:
    near = NearWorld()
    device = Sc10(near)  # type: ignore[arg-type]
    assert said(device, b"open=2000\r") == b"open=2000\r> "
    assert said(device, b"mode=3\r") == b"mode=3\r> "
    said(device, b"ens\r")
    assert said(device, b"ens?\r") == b"ens?\r1\r> "
    near.t = 1.9
    assert said(device, b"closed?\r") == b"closed?\r0\r> "
    near.t = 2.1
    assert said(device, b"closed?\r") == b"closed?\r1\r> "
    said(device, b"ens\r")
    said(device, b"ens\r")
    assert said(device, b"ens?\r") == b"ens?\r0\r> "
    assert b"CMD_ARG_INVALID" in said(device, b"mode=9\r")
    assert b"CMD_NOT_DEFINED" in said(device, b"fire\r")


def test_the_uniblitz_never_answers() -> None:
    near = NearWorld()
    device = Uniblitz(near)  # type: ignore[arg-type]
    assert said(device, b"@") == b""
    assert near.is_open()
    assert said(device, b"A") == b""
    assert not near.is_open()


def test_the_scpi_controller_queues_errors_and_its_watchdog_makes_the_bench_safe() -> None:
    near = NearWorld()
    device = Scpi(near)  # type: ignore[arg-type]
    assert said(device, b"SYST:WATC 2000\n") == b""
    said(device, b"BEAM:STAT ON\n")
    said(device, b"SHUT:STAT OPEN\n")
    assert said(device, b"SHUT:STAT?\n") == b"OPEN\n"
    assert near.status()["lit"]
    near.t = 1.9
    device.idle()
    assert near.status()["lit"]
    near.t = 2.1
    device.idle()
    assert not near.status()["open"]
    assert not near.status()["beam"]
    assert b"-365" in said(device, b"SYST:ERR?\n")
    said(device, b"SHUT:FIRE\n")
    assert b"-113" in said(device, b"SYST:ERR?\n")
    assert said(device, b"SYST:ERR?\n") == b'0,"No error"\n'
    near.world.arm(near.t, "shutter", "interlock")
    said(device, b"SHUT:PULS 1000\n")
    assert b"interlock" in said(device, b"SYST:ERR?\n")


def test_the_shipped_light_is_what_the_walk_gives() -> None:
    medium = SampleMedium(0.17, 0.88, 1.3)
    shipped = seen_light(medium, 45.0, photons=1, seed=1)
    beyond, line_beyond, *harmonics = walked(unit_medium(medium), 45.0, photons=100_000, seed=5)
    assert shipped.line_beyond is not None
    assert shipped.harmonics is not None
    assert shipped.total == pytest.approx(beyond[0] + line_beyond[0], rel=0.01)
    near = (beyond > 0.05 * beyond[0]) & (beyond < 0.95 * beyond[0])
    np.testing.assert_allclose(shipped.beyond[near], beyond[near], rtol=0.03)
    np.testing.assert_allclose(shipped.line_beyond[near], line_beyond[near], atol=0.01 * line_beyond[0])
    np.testing.assert_allclose(shipped.harmonics[0, near[:-1]], harmonics[0][:-1][near[:-1]], atol=0.03)


def test_the_shipped_light_adds_up_to_the_exact_totals() -> None:
    """To 0.02 %, as its photons allow; the tile's to 0.1 %, which few photons leave before they have gone far."""
    for name in load_materials():
        for medium in published_sample(name).media.values():
            light = seen_light(medium, 45.0, photons=1, seed=1)
            albedo = np.array(medium.sigma_sp / (medium.sigma_sp + medium.sigma_a))
            exact = half_space(float(albedo), 0.0, medium.eta, np.array([np.sqrt(0.5)])).radiance[0]
            entering = float(transmittance(medium.eta, np.array(1.0)))
            near = 1e-3 if name == "Spectralon" else 3e-4
            assert light.total == pytest.approx(entering * exact, rel=near)


@pytest.mark.parametrize("depth", [np.inf, 3.0])
def test_lanes_send_the_camera_the_light_of_one_photon_after_the_other(depth: float) -> None:
    """Forward scattering of an oblique beam, in a half space and in a slab on a back."""
    medium, photons = PeeledMedium(0.95, 0.7, 1.4, float(np.sqrt(0.5)), 0.6, depth, 0.6), 4_000
    lanes = peel_off_lanes(medium, 0.1, 4.0, (24, 8), photons=BATCHES * photons, seed=6, lanes=4096)
    around, line = np.zeros((BATCHES, 24, 8)), np.zeros((BATCHES, 24))
    for state, one, once in zip(stream_states(8, BATCHES), around, line, strict=True):
        peel_off(photons, state, *medium, 0.1, 4.0, one, once)
    for ours, theirs in zip(lanes, (around / photons, line / photons), strict=True):
        sums = [each.reshape(BATCHES, 6, -1).sum(2) for each in (ours, theirs)]
        sums = [np.concatenate([each, each.sum(1, keepdims=True)], axis=1) for each in sums]
        apart = sums[0].mean(0) - sums[1].mean(0)
        error = np.hypot(*(each.std(0, ddof=1) for each in sums)) / np.sqrt(BATCHES)
        assert (np.abs(apart) < 4 * error + 1e-12).all()
        assert error[-1] < 0.02 * sums[0].mean(0)[-1]


def test_the_light_towards_the_camera_adds_up_to_the_exact_total() -> None:
    medium = SampleMedium(0.3, 0.7, 1.4)
    beyond, line_beyond, *_ = walked(medium, 45.0, photons=400_000, seed=3)
    exact = half_space(0.7, 0.0, 1.4, np.array([np.sqrt(0.5)])).radiance[0]
    entering = float(transmittance(1.4, np.array(1.0)))
    assert beyond[0] + line_beyond[0] == pytest.approx(entering * exact, rel=3e-3)


def test_lamp_and_camera_may_change_places() -> None:
    """Helmholtz: a beam at 60° seen from the other side at 20° looks as bright as one at 20° seen at 60°."""
    medium = SampleMedium(0.3, 0.7, 1.4, 0.6)
    light = [walked(medium, view, 400_000, 5, incidence_deg=beam) for view, beam in ((20.0, 60.0), (60.0, 20.0))]
    there, back = (beyond[0] + line[0] for beyond, line, *_ in light)
    assert there == pytest.approx(back, rel=0.01)
    straight, line, *_ = walked(medium, 20.0, 400_000, 5)
    assert abs(there / (straight[0] + line[0]) - 1) > 0.05


def test_light_scattered_once_is_the_closed_form() -> None:
    medium, r = SampleMedium(0.3, 0.7, 1.4), r_edges_mfp()
    _, line_beyond, *_ = walked(medium, 45.0, photons=400_000, seed=4)
    sine = np.sqrt(0.5)
    per_length = 1.4 * (1 + np.sqrt(1 - (sine / 1.4) ** 2)) / sine
    passing = transmittance(1.4, np.array(sine)) * transmittance(1.4, np.array(1.0))
    expected = np.pi * 0.7 / (4 * np.pi) * passing / (1.4 * sine * per_length) * np.exp(-per_length * r)
    near = r < 1
    np.testing.assert_allclose(line_beyond[near], expected[near], rtol=0.02)


@pytest.mark.parametrize(("depth", "back"), [(4.0, 0.0), (0.7, 0.9)])
def test_a_slab_sends_the_camera_the_light_that_the_engine_counts(depth: float, back: float) -> None:
    unit = SampleMedium(0.002, 0.998, 1.3, thickness_mm=depth, back=back)
    around, line = np.zeros((200, 36)), np.zeros(200)
    sine = np.cos(np.pi / 4)
    for state in stream_states(8, 4):
        peel_off(10_000, state, 0.998, 0.0, 1.3, sine, 0.0, depth, back, 0.005, 15.0, around, line)
    medium = MonteCarloMedium(unit.sigma_a, unit.sigma_sp, 0.0, unit.eta, unit.thickness_mm, unit.back)
    counted, error = simulate(medium, r_edges_mm=[0.0, 30.0], n_photons=60_000, seed=9).total_radiance(45.0)
    assert np.pi * (around.sum() + line.sum()) / 40_000 == pytest.approx(counted, abs=4 * error)


def test_slabs_share_a_walk_where_depth_in_mean_free_paths_and_back_are_one() -> None:
    slab = SampleMedium(0.02, 0.98, 1.3, thickness_mm=8.0, back=0.1)
    key = light_key(unit_medium(slab), 45.0)
    assert light_key(unit_medium(SampleMedium(0.04, 1.96, 1.3, thickness_mm=4.0, back=0.1)), 45.0) == key
    others = [replace(slab, thickness_mm=9.0), replace(slab, back=0.0), replace(slab, thickness_mm=None)]
    assert all(light_key(unit_medium(other), 45.0) != key for other in others)


@pytest.mark.parametrize("keys", [{"backing": "air"}, {}, {"backing": 0.9, "width_mm": 50.0, "wall": "black"}])
def test_what_the_simulated_bench_cannot_hold_is_refused(keys: dict[str, Any]) -> None:
    material = Material("Skimmilk", 1.3, thickness_mm=10.0, **keys)
    with pytest.raises(InputError, match="simulated bench films"):
        sample_of(material)
    held = sample_of(replace(material, width_mm=None, backing="black")).media["G"]
    assert (held.thickness_mm, held.back) == (10.0, 0.03)
    assert sample_of(Material("Skimmilk", 1.3)) == published_sample("Skimmilk")
