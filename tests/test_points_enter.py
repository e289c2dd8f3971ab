"""Light that enters a body: what single paths met by chance."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("mitsuba")

FACES = 700
"""Two blocks of 256 and a part of one."""


def spread_rare(light: Any, areas: Any) -> Any:
    from bssrdf.render.variant import use_variant

    use_variant()
    from bssrdf.render.points.enter import spread_rare as spread

    return spread(light, areas)


@pytest.fixture
def shade() -> tuple[Any, Any]:
    """Dim light of much noise, per area at three corners, and the areas of its faces."""
    rng = np.random.default_rng(3)
    return rng.exponential(0.03, (FACES, 1, 9)) * np.ones((1, 3, 1)), rng.uniform(0.5, 2.0, FACES)


@pytest.mark.parametrize("face", [0, 100, 699])
def test_a_path_that_shone_alone_is_spread_and_brings_all_its_light(face: int, shade: tuple[Any, Any]) -> None:
    light, areas = shade
    light[face] += 30.0
    spread = spread_rare(light, areas)
    flux = [np.einsum("mhv,m->v", each, areas) for each in (light, spread)]
    assert spread.max() < 1.0
    np.testing.assert_allclose(flux[1], flux[0], rtol=1e-9)


def test_light_that_neighbours_share_stays_where_it_is(shade: tuple[Any, Any]) -> None:
    light, areas = shade
    light[104:108] += 30.0
    np.testing.assert_allclose(spread_rare(light, areas), light, rtol=1e-9)


def test_faces_without_light_stay_dark() -> None:
    assert not spread_rare(np.zeros((FACES, 3, 9)), np.ones(FACES)).any()
