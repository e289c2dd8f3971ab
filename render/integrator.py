"""Mitsuba 3 plugins for translucent surfaces, after Jensen et al. 2001, sections 2 and 4.

`register` makes three plugins known, once a vectorised variant is set (`variant.use_variant`):

- BSDF `bssrdf_medium`: a surface with light under it. `eta` (inside over outside) is required; `sigma_a` and `sigma_sp`
  [1/scene unit], or `reflectance` (R of the Monte Carlo table) and `mean_free_path` (1/σt′) in their place, each a
  number, a colour or a texture; `scale` multiplies both sigmas; `g`; `alpha` for GGX slopes; `bump` (a texture of
  displacements) with `bump_scale`.
  Open shapes that share one such BSDF are one body, a closed one is by itself. To Mitsuba's own integrators it is a
  Lambertian surface.
- Integrator `bssrdf`: finds the light under all surfaces before it draws (`bssrdf.render.points`). `kernel` ("table" or
  "dipole"), `method` ("points" or "walks"), `light_samples`, `walks`, `seed`; `terms` ("diffusion,single,specular") and
  `paper` (the exit lobe as printed) with the dipole; `max_depth`, `rr_depth`, `hide_emitters`.
- Integrator `bssrdf_brdf`: the approximation of section 2.4, light leaves where it entered; the same options.
"""

from __future__ import annotations

import functools
from typing import Any

import drjit as dr
import mitsuba as mi

from bssrdf.errors import InputError
from bssrdf.render.kernel import KERNELS
from bssrdf.render.paths import TERMS, Settings, Tracer
from bssrdf.render.points.prepare import Prepared, Progress, prepare
from bssrdf.render.points.record import METHODS, LightPlan
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
    class LocalIntegrator(mi.SamplingIntegrator):
        """Paths on which light leaves a body where it entered."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.settings = read_settings(properties, local=True)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            return trace(Tracer(scene, self.settings), sampler, ray, active)

        def to_string(self) -> str:
            return f"LocalIntegrator[{self.settings}]"

    class BssrdfIntegrator(mi.SamplingIntegrator):
        """Paths that meet the light that was found under surfaces beforehand."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.settings = read_settings(properties, local=False)
            self.plan = read_plan(properties)
            self._prepared: dict[tuple[int, int], Prepared] = {}
            self._drawn: Prepared | None = None

        def prepare(self, scene: Any, sensor: Any | None = None, progress: Progress | None = None) -> Prepared:
            """What is found beforehand, once for a scene and a sensor."""
            key = (scene.ptr, 0 if sensor is None else sensor.ptr)
            if key not in self._prepared:
                self._prepared = {key: prepare(scene, sensor, self.settings, self.plan, progress)}
            return self._prepared[key]

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            if self._drawn is not None:  # Mitsuba's own comes back here once
                return super().render(scene, sensor, seed, spp, develop, evaluate)
            camera = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            prepared = self.prepare(scene, camera)
            self._drawn = prepared
            try:
                return super().render(prepared.scene, camera, seed, spp, develop, evaluate)
            finally:
                self._drawn = None

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            known = [prepared for (of, _), prepared in self._prepared.items() if of == scene.ptr]
            prepared = self._drawn or (known[0] if known else self.prepare(scene))
            return trace(prepared.tracer, sampler, ray, active)

        def to_string(self) -> str:
            return f"BssrdfIntegrator[{self.settings}, {self.plan}]"

    mi.register_integrator("bssrdf", BssrdfIntegrator)
    mi.register_integrator("bssrdf_brdf", LocalIntegrator)


def trace(tracer: Tracer, sampler: Any, ray: Any, active: Any) -> Any:
    """Radiance along rays, whether they met a surface, and no further images."""
    path, _ = dr.while_loop(
        (tracer.start(ray, active), sampler),
        lambda path, _: path.active,
        lambda path, sampler: (tracer.step(path, sampler), sampler),
        label="bssrdf",
    )
    return path.radiance, path.seen, []


def read_settings(properties: Any, *, local: bool) -> Settings:
    """The integrator's properties, checked. Raises InputError, one line, for a value out of range."""
    kernel = str(properties.get("kernel", "table"))
    _require(kernel in KERNELS, "kernel", kernel, " or ".join(KERNELS))
    terms = tuple(term.strip() for term in str(properties.get("terms", ",".join(TERMS))).split(","))
    paper = bool(properties.get("paper", False))
    max_depth = int(properties.get("max_depth", -1))
    rr_depth = int(properties.get("rr_depth", Settings.rr_depth))
    _require(set(terms) <= set(TERMS) and len(set(terms)) == len(terms), "terms", terms, f"some of {', '.join(TERMS)}")
    alone = kernel == "table" and (set(terms) != set(TERMS) or paper)
    _require(not alone, "terms or paper", "of the table", "them with kernel dipole, whose terms they are")
    _require(max_depth == -1 or max_depth > 0, "max_depth", max_depth, "a number above 0, or -1 for no limit")
    _require(rr_depth > 0, "rr_depth", rr_depth, "a number above 0")
    return Settings(
        terms=terms,
        kernel="dipole" if kernel == "dipole" else "table",
        local=local,
        paper=paper,
        max_depth=Settings.max_depth if max_depth == -1 else max_depth,
        rr_depth=rr_depth,
        hide_emitters=bool(properties.get("hide_emitters", False)),
    )


def read_plan(properties: Any) -> LightPlan:
    """How the light under surfaces is to be found. Raises InputError, one line, for a value out of range."""
    method = str(properties.get("method", LightPlan.method))
    _require(method in METHODS, "method", method, " or ".join(METHODS))
    numbers = {name: int(properties.get(name, getattr(LightPlan, name))) for name in ("light_samples", "walks", "seed")}
    for name, value in numbers.items():
        _require(value >= (name != "seed"), name, value, "a number above 0")
    return LightPlan(method="walks" if method == "walks" else "points", **numbers)


def _require(holds: bool, name: str, value: object, advice: str) -> None:
    if not holds:
        raise InputError(f"integrator bssrdf: {name} = {value}: give {advice}")
