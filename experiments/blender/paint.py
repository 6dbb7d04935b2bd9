"""Painted surfaces: each pattern takes a node tree and a place in metres and returns a colour."""

import bpy
from mathutils import Vector


WOOD = ["#8a5f3c", "#a87848", "#6f4a30", "#b98d5c"]
CLAY = ["#b5533c", "#d98e5f", "#e8c9a0", "#7d3b30", "#c9714b"]
SEA = ["#1f6f78", "#57a6a1", "#bfd8c8", "#2d4a63", "#8cc0b0"]
SAND = ["#e3d3b0", "#c9a86a", "#d9bd8c", "#b58e54"]
PLUM = ["#6b4c7a", "#a684b0", "#d8c3d6", "#4b3a63", "#c58fa5"]
MOSS = ["#56713f", "#8da35f", "#cdd3a2", "#3f5636"]
TOYS = ["#d33f3a", "#f0c541", "#2f6db5", "#e9e2cf", "#3c9a5f", "#e8833a"]


def material(name, pattern, shine=0.0, roughness=0.15):
    """Paint: the pattern under a soft mottling; `shine` of the light is mirrored, 0 is matte."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    where = node(tree, "ShaderNodeTexCoord", {}).outputs["Object"]
    soft = {"Vector": where, "Scale": 2.2, "Detail": 0.0}
    mottle = node(tree, "ShaderNodeTexNoise", soft, name="mottle")
    span = {"From Min": 0.3, "From Max": 0.7, "To Min": 0.85, "To Max": 1.05}
    shade = node(tree, "ShaderNodeMapRange", {"Value": mottle.outputs["Fac"], **span}, name="shade")
    paint = node(
        tree,
        "ShaderNodeVectorMath",
        {0: pattern(tree, where), "Scale": shade.outputs["Result"]},
        operation="SCALE",
    )
    matte = node(tree, "ShaderNodeBsdfDiffuse", {"Color": paint.outputs["Vector"]})
    surface = matte.outputs["BSDF"]
    if shine:
        mirror = node(tree, "ShaderNodeBsdfGlossy", {"Roughness": roughness})
        both = {"Fac": shine, 1: surface, 2: mirror.outputs["BSDF"]}
        surface = node(tree, "ShaderNodeMixShader", both).outputs["Shader"]
    node(tree, "ShaderNodeOutputMaterial", {"Surface": surface})
    return made


def grain(painted, scale=9.0, darkest=0.45):
    """Turn the mottling of a material into one of all sizes, as worn surfaces have it: what tells
    the places of a pattern that repeats itself apart."""
    nodes = painted.node_tree.nodes
    for key, value in {"Scale": scale, "Detail": 8.0, "Roughness": 0.7}.items():
        nodes["mottle"].inputs[key].default_value = value
    nodes["shade"].inputs["To Min"].default_value = darkest


def mosaic_of(palette, size, randomness):
    """Cells of one colour each: a square lattice at randomness 0, crazy paving at 1."""

    def pattern(tree, where):
        lattice = {"Vector": where, "Scale": 1 / size, "Randomness": randomness}
        cell = node(tree, "ShaderNodeTexVoronoi", lattice)
        pick = node(tree, "ShaderNodeSeparateColor", {"Color": cell.outputs["Color"]})
        return ramp(tree, pick.outputs["Red"], palette)

    return pattern


def stripes_of(palette, width, axis=(1, 0, 0)):
    def pattern(tree, where):
        period = Vector(axis).normalized() / (width * len(palette))
        along = node(tree, "ShaderNodeVectorMath", {0: where, 1: period}, operation="DOT_PRODUCT")
        phase = node(tree, "ShaderNodeMath", {0: along.outputs["Value"], 1: 0.37}, operation="ADD")
        turn = node(tree, "ShaderNodeMath", {0: phase.outputs["Value"]}, operation="FRACT")
        return ramp(tree, turn.outputs["Value"], palette)

    return pattern


def wedges(tree, where):
    turn = node(tree, "ShaderNodeTexGradient", {"Vector": where}, gradient_type="RADIAL")
    return ramp(tree, turn.outputs["Fac"], TOYS)


def planks(tree, where):
    return brickwork(tree, where, WOOD[0], WOOD[3], WOOD[2], length=1.3, width=0.28, joint=0.012)


def masonry(tree, where):
    return brickwork(tree, where, SAND[3], CLAY[1], SAND[0], length=1.0, width=0.42, joint=0.07)


def brickwork(tree, where, light, dark, joint_colour, length, width, joint):
    colours = {"Color1": linear(light), "Color2": linear(dark), "Mortar": linear(joint_colour)}
    sizes = {"Scale": 1.0, "Brick Width": length, "Row Height": width, "Mortar Size": joint}
    return node(tree, "ShaderNodeTexBrick", {"Vector": where, **colours, **sizes}).outputs["Color"]


def plaster(tree, where):
    soft = node(tree, "ShaderNodeTexNoise", {"Vector": where, "Scale": 1.6, "Detail": 1.0})
    return ramp(tree, soft.outputs["Fac"], ["#b9a98c", "#cbbd9f", "#d8ccb2", "#c4b08a"], 0.3, 0.7)


def ramp(tree, value, palette, low=0.0, high=1.0):
    """The palette in equal steps of `value` from `low` to `high`."""
    made = tree.nodes.new("ShaderNodeValToRGB")
    tree.links.new(value, made.inputs["Fac"])
    made.color_ramp.interpolation = "CONSTANT"
    stops = made.color_ramp.elements
    while len(stops) < len(palette):
        stops.new(0.5)
    for k, colour in enumerate(palette):
        stops[k].position = low + (high - low) * k / len(palette)
        stops[k].color = linear(colour)
    return made.outputs["Color"]


def node(tree, kind, inputs, **properties):
    """A shader node with its properties set and its inputs linked or given."""
    made = tree.nodes.new(kind)
    for key, value in properties.items():
        setattr(made, key, value)
    for key, value in inputs.items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, made.inputs[key])
        else:
            made.inputs[key].default_value = value
    return made


def linear(code):
    """Linear RGBA of an sRGB hex code."""
    srgb = [int(code[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in srgb] + [1.0]


def blotches_of(palette, size):
    """Cloudy patches, `size` across, whose edges follow the noise."""

    def pattern(tree, where):
        cloud = {"Vector": where, "Scale": 0.6 / size, "Detail": 1.5}
        soft = node(tree, "ShaderNodeTexNoise", cloud)
        return ramp(tree, soft.outputs["Fac"], palette, 0.32, 0.68)

    return pattern


def bricks_of(one, other, joint_colour, length, width, joint):
    """Courses of bricks between two colours."""

    def pattern(tree, where):
        return brickwork(tree, where, one, other, joint_colour, length, width, joint)

    return pattern


def wedges_of(palette):
    """Gores of a ball from pole to pole, about z."""

    def pattern(tree, where):
        turn = node(tree, "ShaderNodeTexGradient", {"Vector": where}, gradient_type="RADIAL")
        return ramp(tree, turn.outputs["Fac"], palette)

    return pattern
