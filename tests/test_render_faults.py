"""Scenes that cannot give a true picture: each is told, or refused, in one line that names the cause."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

pytestmark = pytest.mark.usefixtures("renderer")

LAMP = {"type": "point", "position": [0.0, 0.0, 50.0]}


def wax(scale: float = 1.0) -> dict[str, Any]:
    return {"type": "bssrdf_medium", "sigma_a": 0.01, "sigma_sp": 2.0, "eta": 1.3, "scale": scale}


def ball(x: float = 0.0, radius: float = 10.0, **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, 0, 0], "radius": radius, "bsdf": wax(), **more}


def cube(**more: Any) -> dict[str, Any]:
    return {"type": "cube", "bsdf": wax(), **more}


def told(**things: Any) -> list[str]:
    import mitsuba as mi

    from bssrdf.render.faults import faults, unit_faults
    from bssrdf.render.integrator import register

    register()
    scene = mi.load_dict({"type": "scene", **things})
    return faults(scene) + unit_faults(scene)


@pytest.mark.parametrize(
    "things",
    [
        {"a": ball(), "lamp": LAMP},
        {"a": ball(-10.0), "b": ball(10.0), "lamp": LAMP},
        {"a": ball(), "sun": {"type": "directional", "direction": [0, 0, -1]}, "sky": {"type": "constant"}},
        {"a": cube(), "b": ball(20.0), "lamp": LAMP},
    ],
)
def test_of_a_sound_scene_nothing_is_told(things: dict[str, Any]) -> None:
    assert told(**things) == []


@pytest.mark.parametrize(
    ("things", "words"),
    [
        ({"a": ball(-9.0), "b": ball(9.0)}, '"a" and "b" overlap'),
        ({"a": ball(), "b": ball(0.0, 3.0)}, '"a" and "b" overlap'),
        ({"a": ball(), "lamp": {"type": "point", "position": [0, 0, 5]}}, 'light "lamp" is inside shape "a"'),
        ({"a": ball(), "bulb": {"type": "sphere", "emitter": {"type": "area"}}}, 'light "bulb" is inside shape "a"'),
        ({"a": {"type": "rectangle", "bsdf": wax()}}, '"a" is open (4 edges'),
        ({"a": cube(bsdf=wax(0.001))}, '"a" is 2 across, and light runs 498'),
    ],
)
def test_what_is_wrong_with_a_scene_is_one_line(things: dict[str, Any], words: str) -> None:
    (line,) = told(**({"lamp": LAMP} | things))
    assert words in line


@pytest.mark.parametrize("body", [ball(flip_normals=True), cube(flip_normals=True)])
def test_a_body_that_looks_inwards_is_refused(body: dict[str, Any]) -> None:
    from bssrdf.errors import InputError

    with pytest.raises(InputError, match='shape "a": its faces look inwards'):
        told(a=body, lamp=LAMP)


def write_tetrahedron(path: Path, *, inward: bool, normals: bool) -> None:
    places = np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 30]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    into = 1 if normals else 0
    lines = ["ply", "format ascii 1.0", "element vertex 4", *[f"property float {axis}" for axis in "xyz"]]
    lines += [f"property float n{axis}" for axis in "xyz"] * into
    lines += ["element face 4", "property list uchar int vertex_indices", "end_header"]
    for place in places:
        towards_middle = np.array([7.5, 7.5, 7.5]) - place
        lines.append(" ".join(f"{value:g}" for value in [*place, *(towards_middle if into else [])]))
    lines += [f"3 {' '.join(map(str, face[::-1] if inward else face))}" for face in faces]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("inward", "normals", "words"),
    [(True, False, "faces look inwards; they were turned over"), (False, True, "normals point into the body")],
)
def test_a_mesh_inside_out_is_turned_and_told(tmp_path: Path, inward: bool, normals: bool, words: str) -> None:
    from bssrdf.render import read_mesh

    write_tetrahedron(tmp_path / "bad.ply", inward=inward, normals=normals)
    mesh, remarks = read_mesh(tmp_path / "bad.ply")
    assert any(words in line for line in remarks)
    corners = mesh.vertices[mesh.faces]
    out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(np.einsum("ij,ij->i", out, corners.mean(axis=1) - mesh.vertices.mean(axis=0)) > 0)
    assert np.all(np.einsum("ij,ij->i", mesh.normals, mesh.vertices - mesh.vertices.mean(axis=0)) > 0)


@pytest.mark.parametrize("turned", [0, 1])
def test_faces_that_look_either_way_are_told(tmp_path: Path, turned: int) -> None:
    from bssrdf.render import read_mesh

    path = tmp_path / "mixed.ply"
    write_tetrahedron(path, inward=False, normals=False)
    text = path.read_text()
    path.write_text(text.replace("3 1 2 3", "3 1 3 2") if turned else text)
    _, remarks = read_mesh(path)
    assert any("either way across 3 edges" in line for line in remarks) == bool(turned)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("empty.ply", "", "is empty"),
        ("empty.obj", "\n", "is empty"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 1\n", "has no faces"),
        ("broken.ply", "hello\n", "cannot be read as a mesh"),
    ],
)
def test_a_file_without_a_mesh_says_what_is_missing(tmp_path: Path, name: str, text: str, words: str) -> None:
    from bssrdf.errors import InputError
    from bssrdf.render import read_mesh

    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=f"{name}: {words}"):
        read_mesh(tmp_path / name)


def test_a_black_picture_is_told() -> None:
    from bssrdf.render import Goal, RenderOptions, find_medium, render
    from bssrdf.render.scenes.record import Body, Scene, Viewpoint

    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.0] * 3}}
    body = Body({"type": "sphere"}, find_medium("Marble"), 1.0)
    scene = Scene("dark", {"ball": body}, {"sky": sky}, Viewpoint((0, -5, 0), (0, 0, 0), pixels=(4, 4)))
    with pytest.warns(UserWarning, match="picture is black"):
        render(scene, RenderOptions("brdf"), Goal(samples=2))


def test_a_library_that_worked_is_remembered_until_it_or_mitsuba_changes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from bssrdf.render import kept, variant

    monkeypatch.setattr(kept, "cache_directory", lambda: tmp_path)
    tried = []
    found = variant.find_backend()
    monkeypatch.setattr(variant, "find_backend", lambda: tried.append(1) or found)
    assert variant._known_backend() == variant._known_backend() == found
    assert tried == [1]
    monkeypatch.setattr("importlib.metadata.version", lambda package: "9.9")
    assert variant._known_backend() == found
    assert tried == [1, 1]
