"""Darks at another temperature than their frames are flagged with what they hold too much."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from bssrdf.measure.bracket import Bracket, bracket_of
from bssrdf.measure.frame_checks import warm_dark
from bssrdf.session.records import Card, Frame

DARK_DN_PER_S, DOUBLES_K = 3.0, 6.5


def bracket(folder: Path, frame_c: float | None, dark_c: float | None) -> Bracket:
    """Frames at `frame_c` and darks at `dark_c`, with the dark signal of their temperature (20 °C: 3 DN/s)."""
    frames = []
    for kind, celsius in (("sample", frame_c), ("dark", dark_c)):
        for exposure_s in (0.001, 40.0):
            signal = DARK_DN_PER_S * exposure_s * 2 ** (((20.0 if celsius is None else celsius) - 20) / DOUBLES_K)
            path = folder / f"{kind}_{exposure_s}.tif"
            tifffile.imwrite(path, np.full((8, 8), 100 + signal, np.float32))
            frames.append(Frame(path.name, kind, exposure_s, card=Card(temperature_c=celsius)))  # type: ignore[arg-type]
    return bracket_of("sample", folder, frames)


@pytest.mark.parametrize(("frame_c", "dark_c"), [(20.0, 25.0), (25.0, 20.0), (20.0, 21.5)])
def test_excess_of_the_darks_is_that_of_the_temperatures(tmp_path: Path, frame_c: float, dark_c: float) -> None:
    found = warm_dark([bracket(tmp_path, frame_c, dark_c)])
    assert found
    true = DARK_DN_PER_S * 40 * (2 ** ((dark_c - 20) / DOUBLES_K) - 2 ** ((frame_c - 20) / DOUBLES_K))
    assert found.excess_dn == pytest.approx(true, rel=1e-3)
    assert (found.warmer_k, found.exposure_s) == (dark_c - frame_c, 40.0)
    assert ("warmer" if dark_c > frame_c else "colder") in str(found)


@pytest.mark.parametrize(("frame_c", "dark_c"), [(20.0, 20.5), (None, 25.0), (20.0, None), (None, None)])
def test_equal_or_unknown_temperatures_say_nothing(tmp_path: Path, frame_c: float | None, dark_c: float | None) -> None:
    assert warm_dark([bracket(tmp_path, frame_c, dark_c)]) is None


def test_the_worst_bracket_is_named(tmp_path: Path) -> None:
    near, far = bracket(tmp_path, 20.0, 22.0), bracket(tmp_path, 20.0, 22.0)
    far = replace(
        far, darks=tuple(tuple(replace(d, card=Card(temperature_c=30.0)) for d in each) for each in far.darks)
    )
    found = warm_dark([near, far])
    assert found
    assert found.warmer_k == 10.0
