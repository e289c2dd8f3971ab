"""The whole story on the simulated bench: sessions, the public commands on them, recovered beside published values."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bssrdf.errors import BssrdfError
from bssrdf.rig.sim.samples import published_sample, white_tile
from bssrdf.rig.sim.write_session import Bench, FileFormat, write_simulated_session
from bssrdf.transport.materials import CHANNELS, find_material

LIGHT = (
    "The light is photon transport (Monte Carlo, absorption in the walk, isotropic scattering) of the published "
    "coefficients, seen at 45 degrees; the fit is the dipole of 2001 under the total, whose own error shows below."
)


@dataclass(frozen=True)
class Setting:
    """How one material of the demonstration is filmed."""

    name: str
    mm_per_px: float
    file_format: FileFormat = "tiff"


SETTINGS = (
    Setting("Marble", 0.10),
    Setting("Skin1", 0.06, "dng"),
    Setting("Wholemilk", 0.15),
    Setting("Ketchup", 0.10),
)


@dataclass(frozen=True)
class Row:
    """One channel of one material."""

    material: str
    channel: str
    published_sigma_sp: float
    recovered_sigma_sp: float | None
    published_sigma_a: float
    recovered_sigma_a: float | None
    published_r: float
    recovered_r: float | None
    status: str
    flags: tuple[str, ...]


def run_demo(out: Path, *, progress: Callable[[str], None] | None = None) -> str:
    """Write the sessions into `out`, measure and fit them by the public commands, and return the table.

    The table is also written to table.md and table.json. What the sessions were made from is in `out`/truth, which
    nothing reads that measures or fits.
    """
    say = progress or (lambda message: None)
    out.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(2) as pool:
        sessions = list(pool.map(lambda setting: _film(out, setting, say), SETTINGS))
    say("fit")
    options = ("--model", "dipole", "--constraint", "exact", "--json")
    fits = [json.loads(line) for line in _command("fit", *options, *sessions).splitlines()]
    rows = [row for fit, setting in zip(fits, SETTINGS, strict=True) for row in _rows(setting.name, fit)]
    table = _table(rows)
    (out / "table.md").write_text(table, encoding="utf-8")
    (out / "table.json").write_text(json.dumps([vars(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    return table


def _film(out: Path, setting: Setting, say: Callable[[str], None]) -> Path:
    """Write and measure one session."""
    session = out / setting.name.lower()
    say(f"{setting.name}: frames")
    shutil.rmtree(session, ignore_errors=True)
    write_simulated_session(
        session,
        out / "truth" / f"{session.name}.json",
        published_sample(setting.name),
        white_tile(),
        bench=Bench(mm_per_px=setting.mm_per_px),
        file_format=setting.file_format,
        seed=len(setting.name),
    )
    say(f"{setting.name}: measure")
    _command("measure", session)
    return session


def _command(*arguments: object) -> str:
    """stdout of a public command; its own message where it fails."""
    words = [sys.executable, "-m", "bssrdf", *map(str, arguments), "--quiet"]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=600)
    if done.returncode:
        raise BssrdfError(f"{' '.join(words[1:])} failed: {done.stderr.strip()}")
    return done.stdout


def _rows(name: str, fit: dict[str, Any]) -> list[Row]:
    material = find_material(name)
    published = zip(material.sigma_sp_per_mm, material.sigma_a_per_mm, material.total_r, strict=True)
    return [
        Row(
            name,
            channel,
            sigma_sp,
            fit["channels"][channel]["sigma_sp_per_mm"],
            sigma_a,
            fit["channels"][channel]["sigma_a_per_mm"],
            total_r,
            fit["channels"][channel]["total_r_model"],
            fit["channels"][channel]["status"],
            tuple(fit["channels"][channel]["flags"]),
        )
        for channel, (sigma_sp, sigma_a, total_r) in zip(CHANNELS, published, strict=True)
    ]


def _table(rows: list[Row]) -> str:
    quantities = ("σs′", "recovered", "error", "σa", "recovered", "error", "R", "recovered")
    head = f"| material | | {' | '.join(quantities)} |"
    lines = [LIGHT, "", head, "|---|---|" + "---:|" * 8]
    lines += [
        f"| {row.material} | {row.channel} "
        f"| {row.published_sigma_sp:g} | {_value(row.recovered_sigma_sp)} "
        f"| {_error(row.published_sigma_sp, row.recovered_sigma_sp)} "
        f"| {row.published_sigma_a:g} | {_value(row.recovered_sigma_a)} "
        f"| {_error(row.published_sigma_a, row.recovered_sigma_a)} "
        f"| {row.published_r:.2f} | {_value(row.recovered_r, '.2f')} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def _value(value: float | None, form: str = ".3g") -> str:
    return "–" if value is None else format(value, form)


def _error(published: float, recovered: float | None) -> str:
    return "–" if recovered is None or published == 0 else f"{100 * (recovered / published - 1):+.1f} %"
