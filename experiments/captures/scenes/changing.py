"""Things that change without moving: puffs that fade, and screens that show other pictures."""

import math
from typing import Any, NamedTuple

import numpy as np

from experiments.blender.paint import node
from experiments.blender.shapes import plane
from experiments.captures.scenes.fabric import SECONDS, blob


class Fading(NamedTuple):
    """A soft thing with an opacity."""

    soft: Any
    socket: Any
    opacity: Any

    @property
    def thing(self):
        return self.soft.thing

    def pose(self, time):
        """The form and the opacity at a time."""
        self.soft.pose(time)
        self.socket.default_value = float(self.opacity(time))


class Screen(NamedTuple):
    """A surface that shows a part of a pattern; `place(time)` is where that part begins."""

    thing: Any
    socket: Any
    place: Any

    def pose(self, time):
        """Show the picture of a time."""
        self.socket.default_value = self.place(time)


def fading(soft, opacity):
    """Give a soft thing an opacity in time."""
    tree = soft.thing.data.materials[0].node_tree
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    surface = output.inputs["Surface"].links[0].from_socket
    clear = node(tree, "ShaderNodeBsdfTransparent", {})
    mixed = node(tree, "ShaderNodeMixShader", {1: clear.outputs["BSDF"], 2: surface})
    tree.links.new(mixed.outputs["Shader"], output.inputs["Surface"])
    made = Fading(soft, mixed.inputs["Fac"], opacity)
    made.pose(0.0)
    return made


def puffs(name, source, count, pattern, rise=1.1, radius=0.2, lives=1.3, drift=0.35):
    """Puffs of smoke that leave `source` one after another, rise, grow and fade."""
    made = []
    for k in range(count):
        phase = k / count

        def age(time, phase=phase):
            return (lives * time + phase) % 1.0

        def way(time, k=k, age=age):
            a = age(time)
            side = drift * a * math.cos(2.4 * k), drift * a * math.sin(2.4 * k)
            swirl = 0.09 * math.sin(2 * math.pi * (1.2 * a + 0.3 * k))
            return np.array([side[0] + swirl, side[1], rise * a**0.8]), 0.35 + 1.1 * a

        def opacity(time, age=age):
            a = age(time)
            return 0.85 * min(a / 0.12, 1.0) * (1 - a) ** 0.8

        ball = blob(f"{name}_{k}", source, radius, pattern, k, strength=0.22, drift=way)
        made.append(fading(ball, opacity))
    return made


def screen(name, size, middle, rotation, pattern, shown=0.25, pan=0.5):
    """A glowing screen: another picture every `shown` seconds, which pans meanwhile."""
    thing = plane(name, size, middle, rotation, pattern)
    tree = thing.data.materials[0].node_tree
    place = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeTexCoord").outputs["Object"]
    links = [link.to_socket for link in place.links]
    moved = node(tree, "ShaderNodeVectorMath", {0: place}, operation="ADD")
    for socket in links:
        tree.links.new(moved.outputs["Vector"], socket)
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    matte = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBsdfDiffuse")
    colour = matte.inputs["Color"].links[0].from_socket
    glow = node(tree, "ShaderNodeEmission", {"Color": colour, "Strength": 0.8})
    tree.links.new(glow.outputs["Emission"], output.inputs["Surface"])

    def where(time):
        t = SECONDS * time
        number = int(t / shown + 1e-6)
        return 2.7 * number + pan * (t - number * shown), 1.9 * number, 0.0

    made = Screen(thing, moved.inputs[1], where)
    made.pose(0.0)
    return made
