"""View angles compared."""

from pathlib import Path

import numpy as np
import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import BAD_INPUT, run
from bssrdf.errors import InputError
from bssrdf.report.views import compare_views
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.session.slice_csv import write_slice
from bssrdf.transport.convention import camera_factor


def seen_under(angle_deg, eta=1.5):
    r = np.linspace(0.5, 8, 60)
    factor = camera_factor(eta, flux="incident", exit="fresnel", view_angle_deg=angle_deg, incidence_deg=0.0)
    part = ChannelSlice(r, factor * np.exp(-r) / r, np.full(r.shape, np.nan))
    return Slice({"G": part}, eta, "incident", "fresnel", angle_deg, total_r={"G": 0.7 * factor})


def test_curves_that_follow_the_exit_law_agree_at_every_angle():
    found = compare_views([seen_under(angle) for angle in (0.0, 30.0, 60.0)], "G")
    np.testing.assert_allclose(found.rd_over_mean, 1, rtol=1e-12)
    assert found.total_r == pytest.approx((0.7, 0.7, 0.7))


def test_the_command_prints_each_angle_and_refuses_a_single_one(tmp_path, capsys):
    files = []
    for angle in (0.0, 45.0):
        files.append(str(tmp_path / f"{angle:g}.csv"))
        write_slice(Path(files[-1]), seen_under(angle))
    assert run(cli, ["views", *files]) == 0
    assert "45°: 1.000 of the mean" in capsys.readouterr().out
    assert run(cli, ["views", files[0]]) == BAD_INPUT


def test_one_view_or_a_missing_channel_cannot_be_compared():
    with pytest.raises(InputError, match="two or more"):
        compare_views([seen_under(0.0)], "G")
    with pytest.raises(InputError, match="channel R is not"):
        compare_views([seen_under(0.0), seen_under(45.0)], "R")
