"""Make the shipped light of the simulated bench again: `python -m bssrdf.rig.sim.make_light`.

It holds the published materials and the white tile at 45°, and a thin sample: 10 mm of skim milk on black. So many
photons want a GPU for JAX; a processor would take weeks.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from bssrdf.rig.sim.light import SHIPPED, light_key
from bssrdf.rig.sim.media import SampleMedium, published_sample, unit_medium
from bssrdf.rig.sim.walked_light import walked_in_lanes
from bssrdf.session import atomic_write
from bssrdf.transport import load_materials

VIEW_ANGLE_DEG = 45.0
PHOTONS = (20_000_000, 500_000_000)
"""At least and at most."""
STEPS = 1e10
"""Collisions spent on a walk, between these: R is then known to 0.01 %, and the curve of cream to 0.1 % out to 50 mean
free paths."""
SEED = 20011


def make_light(path: Path, steps: float = STEPS) -> None:
    """Walk every medium of the table and write the file."""
    units = {light_key(unit, VIEW_ANGLE_DEG): unit for unit in _units()}
    rows = []
    for number, (key, unit) in enumerate(units.items()):
        absorbed = 1 - np.exp(-4.6 * np.sqrt(unit.sigma_a))
        photons = int(np.clip(steps * unit.sigma_a / absorbed, *PHOTONS))
        print(f"{number + 1}/{len(units)} {key}: {photons} photons", file=sys.stderr)
        rows.append(walked_in_lanes(unit, VIEW_ANGLE_DEG, photons, SEED + number))
    with atomic_write(path) as part, part.open("wb") as stream:
        np.savez_compressed(stream, keys=np.array(list(units)), rows=np.stack(rows).astype(np.float32))


def _units() -> list[SampleMedium]:
    samples = [*map(published_sample, load_materials()), published_sample("Skimmilk").slab(10.0, back=0.0)]
    return [unit_medium(medium) for sample in samples for medium in sample.media.values()]


if __name__ == "__main__":
    make_light(Path(__file__).parent / SHIPPED)
