"""The published material table (Jensen et al. 2001, Fig. 5b), and how well it agrees with itself."""

from __future__ import annotations

import difflib
import functools
import importlib.resources
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bssrdf.errors import InputError

if TYPE_CHECKING:
    from bssrdf.transport.dipole import Medium

CHANNELS = ("R", "G", "B")

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class PublishedMaterial:
    """One line of the table."""

    name: str
    sigma_sp_per_mm: Rgb
    sigma_a_per_mm: Rgb
    total_r: Rgb
    """Diffuse reflectance as printed, to two digits."""
    eta: float

    def medium(self, channel: str) -> Medium:
        """What the dipole needs of one of CHANNELS."""
        from bssrdf.transport.dipole import Medium

        i = CHANNELS.index(channel)
        return Medium(self.sigma_a_per_mm[i], self.sigma_sp_per_mm[i], self.eta)


@dataclass(frozen=True)
class TableCheck:
    """One cell: the printed total reflectance beside the one that its printed coefficients give."""

    name: str
    channel: str
    published: float
    computed: float

    @property
    def difference(self) -> float:
        """Computed less published."""
        return self.computed - self.published


def load_materials() -> dict[str, PublishedMaterial]:
    """The table by name, in its printed order."""
    return {
        row["name"]: PublishedMaterial(
            name=row["name"],
            sigma_sp_per_mm=tuple(row["sigma_sp_per_mm"]),
            sigma_a_per_mm=tuple(row["sigma_a_per_mm"]),
            total_r=tuple(row["total_r"]),
            eta=row["eta"],
        )
        for row in _table()["materials"]
    }


def table_source() -> str:
    """Where the table was published."""
    return str(_table()["source"])


def find_material(name: str) -> PublishedMaterial:
    """The line of that name, in any case. Raises InputError, with the nearest names, where there is none."""
    by_lower = {material.name.lower(): material for material in load_materials().values()}
    if name.lower() in by_lower:
        return by_lower[name.lower()]
    near = difflib.get_close_matches(name.lower(), by_lower) or list(by_lower)
    raise InputError(
        f'material "{name}" is not in the published table: use {", ".join(by_lower[n].name for n in near)}'
    )


def table_check() -> list[TableCheck]:
    """All 36 cells, computed with the paper's polynomial for Fdr."""
    from bssrdf.transport.dipole import total_r
    from bssrdf.transport.precision import scoped_x64

    computed = scoped_x64(lambda medium: float(total_r(medium)))
    return [
        TableCheck(material.name, channel, published, computed(material.medium(channel)))
        for material in load_materials().values()
        for channel, published in zip(CHANNELS, material.total_r, strict=True)
    ]


@functools.cache
def _table() -> dict[str, Any]:
    return tomllib.loads((importlib.resources.files(__package__) / "materials.toml").read_text(encoding="utf-8"))
