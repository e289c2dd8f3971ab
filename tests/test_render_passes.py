"""A picture as a sum of passes: its mean, its noise, and where more of them are drawn."""

from __future__ import annotations

import numpy as np
import pytest

from bssrdf.render.passes import Passes


def test_pixels_drawn_more_often_have_the_mean_and_noise_of_all_their_samples() -> None:
    rng = np.random.default_rng(1)
    passes, some = Passes(100, 100), np.zeros((100, 100), bool)
    some[:, 50:] = True
    for samples in (4, 4, 16, 36):
        where = None if samples == 4 else some
        shape = (100, 100, 3) if where is None else (5000, 3)
        passes.add(rng.normal(10.0, 1 / np.sqrt(samples), shape).astype(np.float32), samples, where)
    for where, samples in ((some, 60), (~some, 8)):
        assert np.all(passes.samples[where] == samples)
        assert passes.mean[where].var() == pytest.approx(1 / samples, rel=0.05)
        assert passes.variance()[where].mean() == pytest.approx(1 / samples, rel=0.05)
        assert passes.noise(where) == pytest.approx(0.1 / np.sqrt(samples), rel=0.05)


def test_more_is_drawn_round_noisy_pixels_of_bodies_and_nowhere_else() -> None:
    passes, bodies = Passes(40, 40), np.zeros((40, 40), bool)
    bodies[:, :30] = True
    for side in (-1, 1):
        drawn = np.ones((40, 40, 3), np.float32)
        drawn[20, 10] += 0.5 * side
        drawn[:, 30:] += 0.5 * side
        passes.add(drawn, 4)
    chosen = passes.excess(bodies, 0.02) > 1
    expected = np.zeros((40, 40), bool)
    expected[18:23, 8:13] = True
    np.testing.assert_array_equal(chosen, expected)


@pytest.mark.usefixtures("renderer")
def test_chosen_pixels_are_those_of_the_whole_picture() -> None:
    from bssrdf.render.picture import load_stage, render_pass, render_pixels
    from bssrdf.render.plugins import RenderOptions
    from bssrdf.render.scenes.catalogue import build_scene

    own = {"light": None, "texture_path": None, "mesh": None}
    scene = build_scene("texture", material=None, g=None, roughness=None, width_px=16, own=own)
    stage = load_stage(scene, RenderOptions("brdf"))
    where = np.zeros((16, 16), bool)
    where[3:12, 5:9] = True
    few, all_ = render_pixels(stage, where, 400, 1), render_pass(stage, 400, 2)[where]
    other = render_pass(stage, 400, 3)[where]
    assert np.abs(few - all_).mean() < 1.3 * np.abs(other - all_).mean()
