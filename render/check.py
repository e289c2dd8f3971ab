"""What a scene can be wrong about before it is rendered, in one line each."""

from __future__ import annotations

from bssrdf.render.scenes.record import Scene


def remarks(scene: Scene) -> list[str]:
    """Warnings: coefficients that cannot be in 1/mm for bodies of this size."""
    found = []
    for name, body in scene.bodies.items():
        longest = max(body.material.mean_free_path)
        if longest > body.size_mm:
            found.append(
                f"{name}: the mean free path of {body.material.name}, {longest:.3g} mm, is larger than the body, "
                f"{body.size_mm:.3g} mm: are the coefficients in 1/mm and the mesh in mm?"
            )
    return found


def mc_refusal(scene: Scene) -> str | None:
    """Why volpath cannot render the scene, if so."""
    if any(body.maps is not None for body in scene.bodies.values()):
        return "mc takes no coefficients that vary over a surface"
    if scene.narrow_light and any(body.roughness == 0 and body.material.eta != 1 for body in scene.bodies.values()):
        return "mc does not find a narrow light through a polished surface"
    return None
