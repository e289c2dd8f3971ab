"""The part of an exported Blender file that is the same in all: it builds materials in the open scene.

`export.blender` appends this text to the numbers of a material, and a call of `main`. It runs inside Blender, from 4.5
on, and imports nothing else.
"""


def main(materials, unit_m, follow_scene):
    """Build all; their lengths are in units of `unit_m` metres, or in scene units if the scene is not asked."""
    import bpy

    scene = bpy.context.scene
    per_unit = unit_m / scene.unit_settings.scale_length if follow_scene else 1.0
    use_cycles(bpy, scene)
    for numbers in materials:
        made = build(bpy, numbers, per_unit)
        print(f"bssrdf: material {made.name!r} made, {numbers['kept']} kept")
    if any(numbers["kept"] == "medium" for numbers in materials):
        for_volumes(scene)
    if len(materials) == 1:
        for thing in bpy.context.selected_objects:
            if thing.type in {"MESH", "CURVE", "META", "SURFACE", "FONT"}:
                thing.active_material = made
                print(f"bssrdf: given to {thing.name!r}")


def use_cycles(bpy, scene):
    """These numbers hold in Cycles only."""
    if scene.render.engine != "CYCLES":
        bpy.ops.preferences.addon_enable(module="cycles")
        print(f"bssrdf: render engine set from {scene.render.engine} to CYCLES: Eevee's closures are others")
        scene.render.engine = "CYCLES"


def for_volumes(scene):
    """Light in a volume behind glass needs all its bounces, and no blur of sharp paths."""
    wanted = {
        "blur_glossy": 0.0,
        "sample_clamp_indirect": 0.0,
        "caustics_refractive": True,
        "caustics_reflective": True,
    }
    wanted |= {f"{kind}bounces": 1024 for kind in ("max_", "volume_", "transmission_", "glossy_", "transparent_max_")}
    for name, value in wanted.items():
        if getattr(scene.cycles, name) != value:
            print(f"bssrdf: cycles.{name} set from {getattr(scene.cycles, name)} to {value}")
            setattr(scene.cycles, name, value)


def build(bpy, numbers, per_unit):
    """The material of that name, made anew."""
    material = bpy.data.materials.get(numbers["name"]) or bpy.data.materials.new(numbers["name"])
    if hasattr(material, "use_nodes") and bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (600, 0)
    if numbers["kept"] == "medium":
        volume(tree, output, numbers, per_unit)
    else:
        surface(tree, output, numbers, per_unit)
    return material


def surface(tree, output, numbers, per_unit):
    """A Principled surface with its random walk, and a second, coarser walk where one is not enough."""
    principled = tree.nodes.new("ShaderNodeBsdfPrincipled")
    rule = numbers["rules"].get(version_of(principled))
    if rule is None:
        raise RuntimeError(
            f"these numbers are for Blender {'/'.join(numbers['rules'])}, not for this version; export again with "
            f"--renderer-version {version_of(principled)}"
        )
    principled.subsurface_method = "RANDOM_WALK"
    fill(
        principled,
        {
            "Base Color": (*rule["colour"], 1.0),
            "Subsurface Weight": 1.0,
            "Subsurface Scale": 1.0,
            "Subsurface Radius": [radius * per_unit for radius in rule["radius"]],
            "Subsurface Anisotropy": 0.0,
            "IOR": numbers["eta"],
            "Roughness": 0.0,
            "Metallic": 0.0,
        },
    )
    top = principled.outputs[0]
    if rule["second"] is not None:
        top = with_second(tree, top, rule["second"], numbers["eta"], per_unit)
    tree.links.new(top, output.inputs["Surface"])


def version_of(principled):
    """Which rule RANDOM_WALK follows here: the old one has a name of its own since the new one came."""
    methods = principled.bl_rna.properties["subsurface_method"].enum_items
    return "5.2" if "RANDOM_WALK_LEGACY" in methods else "5.1"


def with_second(tree, first, second, eta, per_unit):
    """`first` plus a share of another walk, under the same Fresnel transmittance."""
    walk = tree.nodes.new("ShaderNodeSubsurfaceScattering")
    walk.falloff = "RANDOM_WALK"
    fill(
        walk,
        {
            "Color": (*second["colour"], 1.0),
            "Scale": 1.0,
            "Radius": [radius * per_unit for radius in second["radius"]],
            "IOR": eta,
            "Roughness": 0.0,
            "Anisotropy": 0.0,
        },
    )
    fresnel = tree.nodes.new("ShaderNodeFresnel")
    fill(fresnel, {"IOR": eta})
    entering = tree.nodes.new("ShaderNodeMath")
    entering.operation = "MULTIPLY_ADD"
    tree.links.new(fresnel.outputs[0], entering.inputs[0])
    entering.inputs[1].default_value = -second["weight"]
    entering.inputs[2].default_value = second["weight"]
    share = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(entering.outputs[0], share.inputs[0])
    tree.links.new(walk.outputs[0], share.inputs[2])
    both = tree.nodes.new("ShaderNodeAddShader")
    tree.links.new(first, both.inputs[0])
    tree.links.new(share.outputs[0], both.inputs[1])
    for node, x in ((walk, 0), (fresnel, -200), (entering, 0), (share, 200), (both, 400)):
        node.location = (x, -500)
    return both.outputs[0]


def volume(tree, output, numbers, per_unit):
    """A polished glass surface around the scattering medium itself."""
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    fill(glass, {"Color": (1.0, 1.0, 1.0, 1.0), "IOR": numbers["eta"], "Roughness": 0.0})
    inside = tree.nodes.new("ShaderNodeVolumeCoefficients")
    inside.phase = "HENYEY_GREENSTEIN"
    inside.location = (0, -300)
    fill(
        inside,
        {
            "Absorption Coefficients": [value / per_unit for value in numbers["sigma_a"]],
            "Scatter Coefficients": [value / per_unit for value in numbers["sigma_s"]],
            "Anisotropy": numbers["g"],
        },
    )
    tree.links.new(glass.outputs[0], output.inputs["Surface"])
    tree.links.new(inside.outputs[0], output.inputs["Volume"])


def fill(node, values):
    """Set inputs by name; one that this version does not have is left out."""
    for name, value in values.items():
        if name in node.inputs:
            node.inputs[name].default_value = value
