"""Renders exported Blender files on a slab in real Cycles: run by the Python of a `bpy`, a job a line on stdin.

A job is {"file", "light": "sky" or "edge", "half_mm", "field_mm", "pixels", "samples", "seed"}; its answer, one line on
stdout, is {"mean": rows of columns x 3, "version"}. The scene's unit is 1 mm. Needs nothing of the package.
"""

import json
import sys
import tempfile
from pathlib import Path


def render(job):
    """The picture of one job, (rows, columns, 3)."""
    import bpy
    import numpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module="cycles")
    scene = bpy.context.scene
    scene.unit_settings.scale_length = 0.001
    settings(scene, job)
    half = job["half_mm"]
    slab = box(bpy, scene, (-half, -half, -half), (half, half, 0.0))
    slab.select_set(True)
    exec(compile(Path(job["file"]).read_text(encoding="utf-8"), job["file"], "exec"), {})
    sky(bpy, scene)
    if job["light"] == "edge":
        card = box(bpy, scene, (-half, -half, 0.01), (0.0, half, 0.02))
        card.visible_camera = False
        card.active_material = black(bpy)
    camera(bpy, scene, job["field_mm"])
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "slab.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = numpy.array(image.pixels[:]).reshape(image.size[1], image.size[0], -1)[..., :3]
    return pixels, bpy.app.version_string


def settings(scene, job):
    """What a measurement needs, and nothing that an exported file should set."""
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x = scene.render.resolution_y = job["pixels"]
    scene.render.resolution_percentage = 100
    scene.cycles.samples, scene.cycles.seed = job["samples"], job["seed"]
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth, scene.render.image_settings.color_mode = "32", "RGB"


def box(bpy, scene, low, high):
    """A closed box."""
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new("box")
    mesh.from_pydata(corners, [], faces)
    mesh.update()
    made = bpy.data.objects.new("box", mesh)
    scene.collection.objects.link(made)
    return made


def sky(bpy, scene):
    """Radiance 1 from everywhere."""
    scene.world = bpy.data.worlds.new("sky")
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    tree = scene.world.node_tree
    tree.nodes.clear()
    light, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    light.inputs[0].default_value = (1, 1, 1, 1)
    tree.links.new(light.outputs[0], output.inputs[0])


def black(bpy):
    """A material that takes in all light."""
    made = bpy.data.materials.new("black")
    if bpy.app.version < (5, 0, 0):
        made.use_nodes = True
    made.node_tree.nodes.clear()
    nothing, output = (
        made.node_tree.nodes.new("ShaderNodeBsdfDiffuse"),
        made.node_tree.nodes.new("ShaderNodeOutputMaterial"),
    )
    nothing.inputs[0].default_value = (0, 0, 0, 1)
    made.node_tree.links.new(nothing.outputs[0], output.inputs[0])
    return made


def camera(bpy, scene, field_mm):
    """From straight above, orthographic."""
    made = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    made.data.type, made.data.ortho_scale, made.data.clip_end = "ORTHO", field_mm, 1000.0
    made.location = (0, 0, 50)
    scene.collection.objects.link(made)
    scene.camera = made


if __name__ == "__main__":
    for line in sys.stdin:
        picture, version = render(json.loads(line))
        print("ANSWER " + json.dumps({"mean": picture.tolist(), "version": version}), flush=True)
