"""Several slices of one material as one fit. The light is the dipole's, so that few and small kernels are compiled."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from bssrdf.cli import cli
from bssrdf.console import run
from bssrdf.errors import InputError
from bssrdf.fit.joint import fit_joint
from bssrdf.fit.run import FitOptions, fit_slice
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.session.slice_csv import write_slice
from bssrdf.transport import dipole
from bssrdf.transport.dipole import Medium

OPTIONS = FitOptions(model="dipole", constraint="soft")
MEDIUM = Medium(0.17, 0.88, 1.3)


def session(seed: int, *, factor: float = 1.0, scale_sd: float = 0.0) -> Slice:
    """The dipole's light with 1 % noise, all of it multiplied by `factor`."""
    rng = np.random.default_rng(seed)
    with jax.enable_x64(True):
        r_mm = np.linspace(1, 20, 60) / float(MEDIUM.sigma_tp)
        rd = factor * np.asarray(dipole.rd(MEDIUM, r_mm))
        total_r = factor * float(dipole.total_r(MEDIUM))
    return Slice(
        channels={"G": ChannelSlice(r_mm, rd * (1 + 0.01 * rng.standard_normal(60)), 0.01 * rd)},
        eta=1.3,
        flux="entering",
        exit="hemisphere",
        total_r={"G": total_r * (1 + 0.002 * rng.standard_normal())},
        total_r_sd={"G": 0.002 * total_r},
        g=0.0,
        scale_rel_sd=scale_sd,
    )


def test_four_slices_know_twice_as_much_as_one() -> None:
    slices = [session(seed) for seed in range(4)]
    alone = [fit_slice(piece, OPTIONS)["G"] for piece in slices]
    together = fit_joint(slices, OPTIONS)["G"]
    for key in ("sigma_a", "sigma_sp"):
        values = [getattr(fit, f"{key}_per_mm") for fit in alone]
        sds = [getattr(fit, f"{key}_sd_per_mm") for fit in alone]
        assert getattr(together, f"{key}_per_mm") == pytest.approx(np.mean(values), abs=0.1 * np.mean(sds))
        assert getattr(together, f"{key}_sd_per_mm") == pytest.approx(np.mean(sds) / 2, rel=0.05)
    assert together.n == sum(fit.n for fit in alone)
    assert together.status == "converged"
    assert "joint" in together.flags


def test_a_slice_of_unsure_scale_does_not_mislead_a_sure_one() -> None:
    sure, bright = session(1), session(2, factor=1.06, scale_sd=0.05)
    right = fit_slice(sure, OPTIONS)["G"]
    together = fit_joint([sure, bright], OPTIONS)["G"]
    misled = fit_joint([sure, replace(bright, scale_rel_sd=0.0)], OPTIONS)["G"]
    assert together.sigma_a_per_mm == pytest.approx(right.sigma_a_per_mm, abs=2 * right.sigma_a_sd_per_mm)
    assert abs(misled.sigma_a_per_mm - right.sigma_a_per_mm) > 5 * right.sigma_a_sd_per_mm
    assert "poor_fit" in misled.flags
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
    assert run(cli, ["fit", str(paths[0]), "--joint"]) == 2
