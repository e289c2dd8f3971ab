"""fit.json: the layout of the format, and a round trip in which NaN and infinity are null."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from bssrdf.errors import InputError
from bssrdf.session.fit_json import fit_line, fit_to_dict, read_fit, write_fit
from bssrdf.session.records import ChannelFit, Fit

CHANNEL = ChannelFit(
    model="mc",
    sigma_a_per_mm=0.0021,
    sigma_a_sd_per_mm=0.0001,
    sigma_a_interval95_per_mm=(0.0019, 0.0023),
    sigma_sp_per_mm=2.19,
    sigma_sp_sd_per_mm=0.02,
    sigma_sp_interval95_per_mm=(2.15, 2.23),
    correlation=-0.93,
    total_r_measured=0.830,
    total_r_model=0.826,
    total_r_half_space=0.84,
    tau_p=9.5,
    sample_effect=(-0.02, 0.7),
    window_mm=(0.5, 12.0),
    n=180,
    chi2_reduced=1.04,
    status="converged",
    model_error={"sigma_a": 0.06, "sigma_sp": 0.02},
    budget={"sigma_a": {"noise": 0.75, "total": 0.25}, "sigma_sp": {"noise": 0.5, "scale": 0.5}},
    not_stated=("g",),
)
FIT = Fit("0.1.0", "s/measured/slice.csv", "ab" * 32, {"model": "auto"}, "marble", 1.5, 0.0, {"R": CHANNEL})
LAYOUT: dict[str, Any] = {
    "format": 1,
    "version": "0.1.0",
    "input": {"path": "s/measured/slice.csv", "sha256": "ab" * 32},
    "options": {"model": "auto"},
    "material": "marble",
    "eta": 1.5,
    "g": 0.0,
    "channels": {
        "R": {
            "model": "mc",
            "sigma_a_per_mm": 0.0021,
            "sigma_a_sd_per_mm": 0.0001,
            "sigma_a_interval95_per_mm": [0.0019, 0.0023],
            "sigma_sp_per_mm": 2.19,
            "sigma_sp_sd_per_mm": 0.02,
            "sigma_sp_interval95_per_mm": [2.15, 2.23],
            "correlation": -0.93,
            "model_error": {"sigma_a": 0.06, "sigma_sp": 0.02},
            "budget": {
                "sigma_a": {"noise": 0.75, "total": 0.25},
                "sigma_sp": {"noise": 0.5, "scale": 0.5},
                "not_stated": ["g"],
            },
            "total_r_measured": 0.830,
            "total_r_model": 0.826,
            "total_r_half_space": 0.84,
            "tau_p": 9.5,
            "sample_effect": [-0.02, 0.7],
            "window_mm": [0.5, 12.0],
            "n": 180,
            "chi2_reduced": 1.04,
            "status": "converged",
            "flags": [],
        }
    },
}


def test_layout_is_that_of_the_format() -> None:
    assert json.dumps(fit_to_dict(FIT)) == json.dumps(LAYOUT)


def test_written_fit_is_read_back(tmp_path: Path) -> None:
    full = replace(CHANNEL, flags=("short_window",), sensitivity={"d_ln_sigma_a_d_g": -0.4}, status="upper_bound")
    for fit in (
        FIT,
        replace(FIT, material=None, g=None, channels={"633nm σ": full, "B": CHANNEL}, about={"source": "a"}),
    ):
        write_fit(tmp_path / "fit.json", fit)
        assert read_fit(tmp_path / "fit.json") == fit


def test_nan_and_infinity_are_null_and_come_back_as_nan(tmp_path: Path) -> None:
    unknown = replace(
        CHANNEL,
        sigma_a_sd_per_mm=math.nan,
        sigma_a_interval95_per_mm=(0.0, math.inf),
        model_error={"sigma_a": math.nan},
    )
    write_fit(tmp_path / "fit.json", replace(FIT, channels={"R": unknown}, options={"window": math.inf}))
    written = json.loads((tmp_path / "fit.json").read_text(), parse_constant=pytest.fail)
    assert written["channels"]["R"]["sigma_a_interval95_per_mm"] == [0.0, None]
    assert written["options"] == {"window": None}
    back = read_fit(tmp_path / "fit.json").channels["R"]
    assert math.isnan(back.sigma_a_sd_per_mm)
    assert math.isnan(back.sigma_a_interval95_per_mm[1])
    assert math.isnan(back.model_error["sigma_a"])


def test_line_is_one_compact_object() -> None:
    line = fit_line(replace(FIT, material="a\nb"))
    assert "\n" not in line
    assert ": " not in line
    assert json.loads(line) == LAYOUT | {"material": "a\nb"}


MAY_LACK = {
    *("model_error", "sensitivity", "budget", "not_stated"),
    *("total_r_half_space", "tau_p", "sample_effect"),
}


@pytest.mark.parametrize("key", sorted(asdict(CHANNEL).keys() - MAY_LACK))
def test_missing_value_is_named(tmp_path: Path, key: str) -> None:
    document = fit_to_dict(FIT)
    del document["channels"]["R"][key]
    (tmp_path / "fit.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=f"lacks {key}"):
        read_fit(tmp_path / "fit.json")


@pytest.mark.parametrize("status", ["done", None, []])
def test_unknown_status_is_refused(tmp_path: Path, status: Any) -> None:
    document = fit_to_dict(FIT)
    document["channels"]["R"]["status"] = status
    (tmp_path / "fit.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="status"):
        read_fit(tmp_path / "fit.json")
