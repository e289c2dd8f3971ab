"""Spot lights, whose rays also choose where light enters: a narrow beam is hardly ever found from the other end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

SPOT = "SpotLight"
_GRID = 33


@dataclass
class SpotRay:
    """A ray of a spot light."""

    ray: Any
    intensity: Any
    density: Any
    """Of the ray's direction, per solid angle and including the choice of the light."""
    chance: Any
    """With which light sampling would choose this light."""


class Spots:
    """The spot lights of a scene; Mitsuba draws their rays evenly over the cone."""

    def __init__(self, scene: Any) -> None:
        lights = scene.emitters()
        chosen = [i for i, light in enumerate(lights) if light.class_name() == SPOT]
        self.any = bool(chosen)
        """Is there one?"""
        if not chosen:
            return
        ids = [int(dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(light))[0]) for light in lights]
        density = np.zeros(max(ids) + 1, np.float32)
        for i in chosen:
            density[ids[i]] = _cone_density(lights[i]) / len(chosen)
        self._lights = scene.emitters_dr()
        self._chosen = mi.UInt32(chosen)
        self._density = mi.Float(density)
        self._scene = scene

    def density(self, light: Any, active: Any) -> Any:
        """`Shot.density` for any light; 0 where it is not a spot."""
        light_id = dr.reinterpret_array(mi.UInt32, light)
        known = active & (light_id < dr.width(self._density))
        return dr.gather(mi.Float, self._density, light_id, known)

    def shoot(self, time: Any, sampler: Any, active: Any) -> SpotRay:
        """A ray of one of the spots."""
        n = dr.width(self._chosen)
        which = dr.minimum(mi.UInt32(sampler.next_1d(active) * n), n - 1)
        index = dr.gather(mi.UInt32, self._chosen, which, active)
        light = dr.gather(mi.EmitterPtr, self._lights, index, active)
        ray, weight = light.sample_ray(time, 0.5, sampler.next_2d(active), sampler.next_2d(active), active)
        density = self.density(light, active)
        return SpotRay(ray, weight * density * n, density, self._scene.pdf_emitter(index, active))


def _cone_density(light: Any) -> float:
    """One over the solid angle of the cone, from the rays of a grid of numbers that reaches its rim."""
    grid = np.linspace(0, 1 - 2.0**-24, _GRID, dtype=np.float32)
    u, v = (mi.Float(side.ravel()) for side in np.meshgrid(grid, grid))
    ray, _ = light.sample_ray(0.0, 0.5, mi.Point2f(u, v), mi.Point2f(u, v), True)
    d = np.array(ray.d, np.float64)
    axis = d.mean(axis=1) / np.linalg.norm(d.mean(axis=1))
    return 1 / (math.pi * float(np.max(np.sum(np.square(d.T - axis), axis=1))))
