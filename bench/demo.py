"""The whole story on the simulated bench: capture, measure, fit, and the published table beside the recovered one."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bssrdf.errors import BssrdfError
from bssrdf.report import wrapped
from bssrdf.rig import BRACKET_S, SCALE_REL_SD, TILE_SD, BenchScene, published_sample, simulated_bench, white_tile
from bssrdf.transport import CHANNELS, find_material

LIGHT = (
    "The light is photon transport (Monte Carlo, absorption in the walk, isotropic scattering) of the published "
    "coefficients, seen at 45 degrees by a simulated camera over PTP/IP; neither model that is fitted made it. "
    "Spectralon, published with an absorption of 0, is given 4.6e-6 of its scattering. Scale and tile are stated with "
    "errors, 0.2 % and 0.1 %, and are off by errors drawn from these."
)
MODELS = {"mc": ("--model", "mc"), "dipole": ("--model", "dipole", "--constraint", "exact")}
MM_PER_PX = {
    "Apple": 0.10,
    "Chicken1": 0.15,
    "Chicken2": 0.15,
    "Cream": 0.15,
    "Ketchup": 0.10,
    "Marble": 0.10,
    "Potato": 0.15,
    "Skimmilk": 0.20,
    "Skin1": 0.06,
    "Skin2": 0.08,
    "Spectralon": 0.10,
    "Wholemilk": 0.15,
}
"""Scale at which each material is filmed: the frame holds a few of its 1/σtr."""
_SPOT_MM = 0.2
_SPOT_PX = 2.5
"""A narrower spot falls between the pixels of one colour."""
_SPEED = 50.0
SEED = 2001
_LIMIT_S = 600.0


@dataclass(frozen=True)
class DemoCell:
    """One coefficient of one channel of one material, as one model recovers it."""

    material: str
    channel: str
    quantity: str
    model: str
    published: float
    given: float
    """What the bench was given: the published value, but where that is 0."""
    recovered: float | None
    low: float | None
    high: float | None
    """95 % interval."""
    status: str
    flags: tuple[str, ...]

    @property
    def error(self) -> float | None:
        """Relative to what was given."""
        return None if self.recovered is None else self.recovered / self.given - 1

    @property
    def holds(self) -> bool:
        """Whether there is an interval, and holds what was given."""
        low, high = self.low, self.high
        if low is None:
            return False
        return low <= self.given and (high is None or self.given <= high)


def run_demo(out: Path, *, seed: int = SEED, progress: Callable[[str], None] | None = None) -> str:
    """Film every material into `out` through `bssrdf capture`, measure, fit and report on them; return the table.

    `seed` draws the errors of scale and tile, within those that are stated.

    The table is also written to table.md and table.json. What the bench was given is in `out`/truth, which nothing
    reads that measures or fits.
    """
    say = progress or (lambda message: None)
    (out / "truth").mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(2) as pool:
        sessions = list(pool.map(lambda name: _film(out, name, seed, say), MM_PER_PX))
    say("fit")
    with ThreadPoolExecutor(2) as pool:
        fits = pool.map(lambda model: _fit(sessions, model), MODELS)
        cells = [cell for fitted in fits for cell in fitted]
    say("report")
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda session: _command("report", session), sessions))
    table = "\n".join([wrapped([LIGHT], indent=""), *table_lines(cells), "", wrapped(summary_lines(cells)), ""])
    (out / "table.md").write_text(table, encoding="utf-8")
    (out / "table.json").write_text(json.dumps([asdict(cell) for cell in cells], indent=1) + "\n", encoding="utf-8")
    return table


def _film(out: Path, name: str, seed: int, say: Callable[[str], None]) -> Path:
    """Capture and measure one material on a bench of its own."""
    session, plan = out / name.lower(), out / "truth" / f"{name.lower()}.plan.toml"
    shutil.rmtree(session, ignore_errors=True)
    eta = find_material(name).eta
    exposures = ", ".join(f"{exposure_s:g}" for exposure_s in BRACKET_S)
    plan.write_text(
        f'settle_s = 0.02\n[material]\nname = "{name}"\neta = {eta}\ng = 0.0\n[exposures]\nlist_s = [{exposures}]\n',
        encoding="utf-8",
    )
    say(f"{name}: capture")
    errors = np.random.default_rng([seed, *name.encode()]).normal(size=2)
    scene = BenchScene(
        published_sample(name),
        white_tile(),
        mm_per_px=MM_PER_PX[name],
        spot_radius_mm=max(_SPOT_MM, _SPOT_PX * MM_PER_PX[name]),
        scale_error=SCALE_REL_SD * errors[0],
        tile_error=TILE_SD * errors[1],
    )
    with simulated_bench(scene, speed=_SPEED) as bench:
        shutil.copyfile(bench.scene_file, out / "truth" / f"{name.lower()}.json")
        _command("capture", plan, "--rig", bench.rig_file, "--out", session)
    say(f"{name}: measure")
    _command("measure", session)
    return session


def _fit(sessions: Sequence[Path], model: str) -> list[DemoCell]:
    names = list(MM_PER_PX)
    inputs = sessions if model == "mc" else [session / "measured/slice.csv" for session in sessions]
    lines = _command("fit", *MODELS[model], "--json", *inputs)
    return [
        cell
        for name, line in zip(names, lines.splitlines(), strict=True)
        for cell in _cells(name, model, json.loads(line)["channels"])
    ]


def _cells(name: str, model: str, channels: dict[str, dict[str, Any]]) -> list[DemoCell]:
    material, media = find_material(name), published_sample(name).media
    published = {"sigma_sp": material.sigma_sp_per_mm, "sigma_a": material.sigma_a_per_mm}
    return [
        DemoCell(
            name,
            channel,
            quantity,
            model,
            values[number],
            getattr(media[channel], quantity),
            channels[channel][f"{quantity}_per_mm"],
            channels[channel][f"{quantity}_interval95_per_mm"][0],
            channels[channel][f"{quantity}_interval95_per_mm"][1],
            channels[channel]["status"],
            tuple(channels[channel]["flags"]),
        )
        for number, channel in enumerate(CHANNELS)
        for quantity, values in published.items()
    ]


def _command(*arguments: object) -> str:
    """stdout of a public command; its own message where it fails."""
    words = [sys.executable, "-m", "bssrdf", *map(str, arguments), "--quiet"]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=_LIMIT_S)
    if done.returncode:
        raise BssrdfError(f"{' '.join(words[1:])} failed: {done.stderr.strip()}")
    return done.stdout


def table_lines(cells: Sequence[DemoCell]) -> list[str]:
    """By coefficient, one line per channel: published, recovered by the table model, its error and interval; the
    dipole's error."""
    found = {(cell.material, cell.channel, cell.quantity, cell.model): cell for cell in cells}
    channels = dict.fromkeys((cell.material, cell.channel) for cell in cells)
    lines = []
    for quantity, symbol in (("sigma_sp", "σs′"), ("sigma_a", "σa")):
        lines += ["", _line("material", f"{symbol} 1/mm", "mc", "error", "95 %", "dipole"), _RULE]
        for name, channel in channels:
            cell, dipole = (found[name, channel, quantity, model] for model in MODELS)
            missed = "" if cell.holds else " ✗"
            interval = "refused" if cell.low is None else f"{_value(cell.low)}–{_value(cell.high)}{missed}"
            published = f"{cell.published:g}{'' if cell.given == cell.published else '*'}"
            errors = _percent(cell.error), interval, _percent(dipole.error)
            lines.append(_line(f"{name} {channel}", published, _value(cell.recovered), *errors))
    given = [cell for cell in cells if cell.given != cell.published]
    if given:
        values = ", ".join(sorted({f"{cell.given:.2g}" for cell in given}))
        lines += ["", f"* given {values}; ✗: the interval misses what was given."]
    return lines


_WIDTHS = (12, 8, 8, 7, 19, 7)
_RULE = "|" + "|".join("-" * (width + 2) for width in _WIDTHS) + "|"


def _line(*cells: str) -> str:
    """A line of the table, as wide as a terminal."""
    name, *numbers = (cell.rjust(width) for cell, width in zip(cells, _WIDTHS, strict=True))
    return f"| {' | '.join([name.strip().ljust(_WIDTHS[0]), *numbers])} |"


def summary_lines(cells: Sequence[DemoCell]) -> list[str]:
    """How far the table model is off over the cells without Spectralon, and how many intervals hold the truth."""
    lines = []
    for quantity, symbol in (("sigma_sp", "σs′"), ("sigma_a", "σa")):
        own = [cell for cell in cells if (cell.quantity, cell.model) == (quantity, "mc")]
        errors = [abs(cell.error) for cell in own if cell.error is not None and cell.material != "Spectralon"]
        refused = sum(cell.error is None for cell in own)
        lines.append(
            f"{symbol}, mc: median error {100 * median(errors):.1f} %, "
            f"{sum(error <= 0.05 for error in errors)} of {len(errors)} within 5 %; "
            f"{sum(cell.holds for cell in own)} of {len(own)} intervals hold what was given, {refused} refused."
        )
    return lines


def _value(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _percent(error: float | None) -> str:
    return "–" if error is None else f"{100 * error:+.1f} %"
