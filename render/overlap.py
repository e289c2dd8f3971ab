"""How much light the sum of the terms counts twice: the dipole already holds part of the single scattering."""

from __future__ import annotations

from typing import NamedTuple

from bssrdf.render.material import RenderMaterial
from bssrdf.transport import CHANNELS, dipole, first_order_total, scoped_x64, table_model
from bssrdf.transport.dipole import Medium


class Overlap(NamedTuple):
    """Shares of the light that entered along the normal of a half space, in one channel."""

    channel: str
    diffusion: float
    single: float
    monte_carlo: float
    """All orders, from the table: the truth."""

    @property
    def excess(self) -> float:
        """Of the terms' sum over the truth, relative."""
        return (self.diffusion + self.single) / self.monte_carlo - 1


@scoped_x64
def overlap(material: RenderMaterial) -> list[Overlap]:
    """The terms of each channel beside Monte Carlo."""
    model = table_model(material.eta, material.g)
    found = []
    for channel, a, sp, s in zip(CHANNELS, material.sigma_a, material.sigma_sp, material.sigma_s, strict=True):
        medium = Medium(a, sp, material.eta)
        single = float(first_order_total(s, a, material.g, material.eta))
        found.append(Overlap(channel, float(dipole.total_r(medium)), single, float(model.total(medium))))
    return found


def overlap_text(material: RenderMaterial) -> str:
    """One line per channel."""
    lines = [
        f"  {each.channel}: diffusion {each.diffusion:.3f} + single {each.single:.3f} = "
        f"{each.diffusion + each.single:.3f} of the light that enters; Monte Carlo {each.monte_carlo:.3f}: "
        f"{100 * each.excess:+.1f} %"
        for each in overlap(material)
    ]
    head = f"{material.name} (g {material.g:g}): the diffusion term already holds much of the single scattering"
    return "\n".join([head, *lines])
