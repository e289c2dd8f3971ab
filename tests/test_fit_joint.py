"""Several slices of one material as one fit: laws that hold whatever the light; it is each model's own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import model_slice

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.fit import FitOptions, fit_joint, fit_slice
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.session.slice_csv import write_slice
from bssrdf.transport.forward import DipoleModel
from bssrdf.transport.white.store import table_model

OPTIONS = FitOptions(model="dipole", constraint="soft")
MEDIUM = (0.17, 0.88)
"""σa and σs′ [1/mm]."""


def session(seed: int, *, factor: float = 1.0, scale_sd: float = 0.0, model: str = "dipole") -> Slice:
    """The model's light with 1 % noise, all of it multiplied by `factor`."""
    light = DipoleModel(1.3) if model == "dipole" else table_model(1.3, 0.0)
    errors = {"noise": 0.01, "total_noise": 0.002, "scale_rel_sd": scale_sd, "g": 0.0}
    return model_slice(light, *MEDIUM, np.linspace(1, 20, 60), factor=factor, seed=seed, **errors)


def test_four_slices_know_twice_as_much_as_one() -> None:
    slices = [session(seed) for seed in range(4)]
    alone = [fit_slice(piece, OPTIONS)["G"] for piece in slices]
    together = fit_joint(slices, OPTIONS)["G"]
    for key in ("sigma_a", "sigma_sp"):
        values = [getattr(fit, f"{key}_per_mm") for fit in alone]
        sds = [getattr(fit, f"{key}_sd_per_mm") for fit in alone]
        assert getattr(together, f"{key}_per_mm") == pytest.approx(np.mean(values), abs=0.1 * np.mean(sds))
        assert getattr(together, f"{key}_sd_per_mm") == pytest.approx(np.mean(sds) / 2, rel=0.05)
    assert together.n == pytest.approx(sum(fit.n for fit in alone), abs=4)  # each has its own window's ends
    assert together.status == "converged"
    assert "joint" in together.flags


def test_a_slice_of_unsure_scale_does_not_mislead_a_sure_one() -> None:
    sure, bright = session(1), session(2, factor=1.06, scale_sd=0.05)
    right = fit_slice(sure, OPTIONS)["G"]
    together = fit_joint([sure, bright], OPTIONS)["G"]
    misled = fit_joint([sure, replace(bright, scale_rel_sd=0.0)], OPTIONS)["G"]
    assert together.sigma_a_per_mm == pytest.approx(right.sigma_a_per_mm, abs=2 * right.sigma_a_sd_per_mm)
    assert misled.status == "rejected"
    assert {"poor_fit", "total_inconsistent"} <= set(misled.flags)
    assert "poor_fit" not in together.flags


def test_slices_of_two_media_are_not_joined() -> None:
    with pytest.raises(InputError, match=r"eta = 1\.3 in one slice and 1\.5"):
        fit_joint([session(1), replace(session(2), eta=1.5)], OPTIONS)
    blue = replace(session(2), channels={"B": session(2).channels["G"]}, total_r={"B": 0.3}, total_r_sd={"B": 0.001})
    with pytest.raises(InputError, match="no channel in common"):
        fit_joint([session(1), blue], OPTIONS)


def test_the_result_names_all_its_inputs(tmp_path: Path) -> None:
    paths = [tmp_path / f"{seed}.csv" for seed in (1, 2)]
    for seed, path in zip((1, 2), paths, strict=True):
        write_slice(path, session(seed))
    out = tmp_path / "fit.json"
    arguments = [*map(str, paths), "--model", "dipole", "--joint", "--out", str(out)]
    assert run(cli, ["fit", *arguments]) == 0
    written = json.loads(out.read_text())
    assert [each["path"] for each in written["options"]["joint"]] == [str(path) for path in paths]
    assert written["channels"]["G"]["n"] > 100


def near(piece: Slice, within: np.ndarray) -> Slice:
    """Some radii of the slice."""
    channel = piece.channels["G"]
    part = ChannelSlice(channel.r_mm[within], channel.rd_per_mm2[within], channel.sd_per_mm2[within])
    return replace(piece, channels={"G": part})


@pytest.mark.parametrize("model", ["dipole", "mc"])
def test_one_slice_joined_is_that_slice_fitted(model: str) -> None:
    piece = session(1, scale_sd=0.01, model=model)
    options = FitOptions(model=model)  # type: ignore[arg-type]
    alone, joined = fit_slice(piece, options)["G"], fit_joint([piece], options)["G"]
    for key in ("sigma_a_per_mm", "sigma_sp_per_mm", "sigma_a_sd_per_mm", "sigma_sp_sd_per_mm", "chi2_reduced"):
        assert getattr(joined, key) == pytest.approx(getattr(alone, key), rel=1e-9)


@pytest.mark.parametrize("model", ["dipole", "mc"])
def test_a_slice_cut_in_two_is_the_whole_where_the_parts_share_their_errors(model: str) -> None:
    whole = replace(session(3, scale_sd=0.01, model=model), mm_rel_sd=0.003)
    inner = np.arange(60) < 25
    options = FitOptions(model=model)  # type: ignore[arg-type]
    parts = [near(whole, inner), near(whole, ~inner)]
    one = [replace(part, shared_errors="tile") for part in parts]
    expected = fit_slice(whole, options)["G"]
    together, apart = fit_joint(one, options)["G"], fit_joint(parts, options)["G"]
    turned = fit_joint(one[::-1], options)["G"]
    for key in ("sigma_a_per_mm", "sigma_sp_per_mm", "sigma_a_sd_per_mm", "sigma_sp_sd_per_mm"):
        assert getattr(together, key) == pytest.approx(getattr(expected, key), rel=1e-8)
        assert getattr(turned, key) == pytest.approx(getattr(together, key), rel=1e-9)
    assert apart.sigma_a_per_mm != pytest.approx(expected.sigma_a_per_mm, rel=1e-4)


def test_the_order_of_the_data_does_not_matter() -> None:
    piece = session(5, scale_sd=0.01)
    order = np.random.default_rng(0).permutation(60)
    mixed = near(piece, order)
    a, b = (fit_slice(each, OPTIONS)["G"] for each in (piece, mixed))
    assert a.sigma_a_per_mm == pytest.approx(b.sigma_a_per_mm, rel=1e-9)
    assert a.sigma_sp_sd_per_mm == pytest.approx(b.sigma_sp_sd_per_mm, rel=1e-9)


def test_each_channel_has_its_own_totals() -> None:
    """Each R stands in another slice, so that channels that are fitted in one batch would take the wrong one."""
    one, two = session(1), session(2)
    curves = dict.fromkeys(("R", "G"), one.channels["G"])
    first = replace(one, channels=curves, total_r={"R": one.total_r["G"]}, total_r_sd={"R": one.total_r_sd["G"]})
    second = replace(two, channels=dict.fromkeys(("R", "G"), two.channels["G"]))
    together = fit_joint([first, second], OPTIONS)
    alone = fit_joint([replace(piece, channels={"G": piece.channels["G"]}) for piece in (first, second)], OPTIONS)
    assert together["G"].status == alone["G"].status == "converged"
    for key in ("sigma_a_per_mm", "sigma_sp_per_mm"):
        assert getattr(together["G"], key) == pytest.approx(getattr(alone["G"], key), rel=1e-9)
