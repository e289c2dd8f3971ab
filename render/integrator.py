"""Mitsuba 3 plugins for translucent surfaces, after Jensen et al. 2001, sections 2 and 4.

`register` makes three plugins known, once a vectorised variant is set (`variant.use_variant`):

- BSDF `bssrdf_medium`: a surface with light under it. `eta` (inside over outside) is required; `sigma_a` and `sigma_sp`
  [1/scene unit], or `reflectance` and `mean_free_path` (1/σt′) in their place, each a number, a colour or a texture;
  `scale` multiplies both sigmas; `g`; `alpha` for GGX slopes; `bump` (a texture of displacements) with `bump_scale`.
  All shapes that share one such BSDF are one body. To Mitsuba's own integrators it is a Lambertian surface.
- Integrator `bssrdf`: `terms` ("diffusion,single,specular"), `sampling` ("exact" or the paper's "exponential"),
  `paper` (the exit lobe as printed), `max_depth`, `rr_depth`, `max_probe_hits`, `hide_emitters`.
- Integrator `bssrdf_brdf`: the approximation of section 2.4, with the same options but `sampling` and
  `max_probe_hits`.
"""

from __future__ import annotations

import functools
import warnings
from typing import Any

import drjit as dr
import mitsuba as mi

from bssrdf.errors import InputError
from bssrdf.render.mesh_file import openings
from bssrdf.render.paths import TERMS, Settings, Tracer
from bssrdf.render.sampling import LAWS
from bssrdf.render.surface import register_medium

VARIANTS = ("llvm_ad_rgb", "llvm_ad_mono", "cuda_ad_rgb", "cuda_ad_mono")


def register() -> None:
    """Register the plugins with Mitsuba in its current variant. Raises InputError for one they cannot run in."""
    variant = mi.variant()
    if variant not in VARIANTS:
        raise InputError(
            f"Mitsuba's variant is {variant}: call use_variant() first, or set one of {', '.join(VARIANTS)}"
        )
    register_medium(variant)
    _register_integrators(variant)


@functools.cache
def _register_integrators(variant: str) -> None:
    class BssrdfIntegrator(mi.SamplingIntegrator):
        """Paths that go on under translucent surfaces."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self._settings = read_settings(properties, local=properties.plugin_name() == "bssrdf_brdf")
            self._checked = 0

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            tracer = Tracer(scene, self._settings)
            self._warn_once(scene, tracer)
            path, _ = dr.while_loop(
                (tracer.start(ray, active), sampler),
                lambda path, _: path.active,
                lambda path, sampler: (tracer.step(path, sampler), sampler),
                label="bssrdf",
            )
            return path.radiance, path.seen, []

        def to_string(self) -> str:
            return f"BssrdfIntegrator[{self._settings}]"

        def _warn_once(self, scene: Any, tracer: Tracer) -> None:
            if self._checked == id(scene):
                return
            self._checked = id(scene)
            for line in openings(tracer.media.shapes):
                warnings.warn(line, stacklevel=2)

    for name in ("bssrdf", "bssrdf_brdf"):
        mi.register_integrator(name, BssrdfIntegrator)


def read_settings(properties: Any, *, local: bool) -> Settings:
    """The integrator's properties, checked. Raises InputError, one line, for a value out of range."""
    terms = tuple(term.strip() for term in str(properties.get("terms", ",".join(TERMS))).split(","))
    law = str(properties.get("sampling", LAWS[0]))
    max_depth = int(properties.get("max_depth", -1))
    rr_depth = int(properties.get("rr_depth", Settings.rr_depth))
    hits = int(properties.get("max_probe_hits", Settings.max_probe_hits))
    _require(set(terms) <= set(TERMS) and len(set(terms)) == len(terms), "terms", terms, f"some of {', '.join(TERMS)}")
    _require(law in LAWS, "sampling", law, " or ".join(LAWS))
    _require(max_depth == -1 or max_depth > 0, "max_depth", max_depth, "a number above 0, or -1 for no limit")
    _require(rr_depth > 0, "rr_depth", rr_depth, "a number above 0")
    _require(hits > 0, "max_probe_hits", hits, "a number above 0")
    return Settings(
        terms=terms,
        law="exponential" if law == "exponential" else "exact",
        local=local,
        paper=bool(properties.get("paper", False)),
        max_depth=Settings.max_depth if max_depth == -1 else max_depth,
        rr_depth=rr_depth,
        max_probe_hits=hits,
        hide_emitters=bool(properties.get("hide_emitters", False)),
    )


def _require(holds: bool, name: str, value: object, advice: str) -> None:
    if not holds:
        raise InputError(f"integrator bssrdf: {name} = {value}: give {advice}")
