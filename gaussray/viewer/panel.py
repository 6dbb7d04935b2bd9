"""The controls of the page from top to bottom, and what stands around the scene."""

from typing import Any

from gaussray.viewer import controls as table
from gaussray.viewer.overlay import Around
from gaussray.viewer.preset import presets
from gaussray.viewer.viewpoint import distance_of
from gaussray.viewer.window import LAYOUTS


def build(page: Any) -> None:
    """All controls, from top to bottom."""
    gui = page.client.gui
    gui.configure_theme(dark_mode=page.dark, show_logo=False, show_share_button=False)
    gui.set_panel_label("gaussray")
    gui.main_panel.dock_right()
    page.handles["status"] = gui.add_markdown("starting ...")
    _build_view(page, gui)
    for group, title in table.GROUPS.items():
        with gui.add_folder(title.capitalize(), expand_by_default=group != "sensor"):
            _build_group(page, gui, group)
    with gui.add_folder("Presets", expand_by_default=False):
        _build_presets(page, gui)
    page.reveal()


def _build_view(page: Any, gui: Any) -> None:
    first, last, _ = page.studio.times
    h = page.handles
    span = max(last - first, 1e-6)
    now = min(max(page.time, first), first + span)
    h["time"] = gui.add_slider("time [t]", first, first + span, span / 500, now)
    h["play"] = gui.add_checkbox("play", False, hint="Let time pass, again and again.")
    h["layout"] = gui.add_dropdown("show", LAYOUTS, initial_value="effect")
    h["split"] = gui.add_slider("split", 0.0, 1.0, 0.01, 0.5, visible=False)
    samples = str(page.values["render.samples"])
    offered = sorted({*table.SAMPLES, samples}, key=int)
    hint = "Rays a pixel of the picture when nothing moves."
    h["samples"] = gui.add_dropdown("rays", offered, initial_value=samples, hint=hint)
    for name, hint in (
        ("cameras", "Those of the capture. A click stands where one stood."),
        ("points", "The capture's, or the centres of the Gaussians."),
        ("dark", "Colours of the page."),
    ):
        h[name] = gui.add_checkbox(name, name == "dark" and page.dark, hint=hint)
    for name in ("time", "layout", "split", "samples", "cameras", "points", "dark"):
        h[name].on_update(lambda _, name=name: page.changed(name))


def _build_group(page: Any, gui: Any, group: str) -> None:
    offered = table.offered(group)
    name = table.choice_of(group, page.values)
    h = page.handles[group] = gui.add_dropdown("kind", offered, initial_value=name)
    h.on_update(lambda _: page.choose(group))
    first, last, _ = page.studio.times
    distance = distance_of(page.studio.scene, page.studio.stance)
    for one in table.controls(distance, last - first):
        if one.group != group:
            continue
        value = min(max(float(page.values[one.key]), one.low), one.high)
        numbers = one.low, one.high, one.step, type(one.step)(value)
        h = page.handles[one.key] = gui.add_slider(one.label, *numbers, hint=one.hint)
        h.on_update(lambda _, one=one: page.moved(one))


def _build_presets(page: Any, gui: Any) -> None:
    h = page.handles
    h["name"] = gui.add_text("name", "mine")
    h["save"] = gui.add_button("Save this camera")
    known = presets(page.out)
    h["preset"] = gui.add_dropdown("open", ["-", *known], initial_value="-")
    h["command"] = gui.add_markdown(f"Saved into `{page.out}`.")
    h["save"].on_click(lambda _: page.save())
    h["preset"].on_update(lambda _: page.open())


def surround(page: Any, around: Around) -> None:
    """The capture's cameras and points."""
    scene, h, scale = page.client.scene, page.handles, around.scale
    h["/points"] = scene.add_point_cloud(
        "/points", around.place, around.color, point_size=scale / 250, visible=True
    )
    h["/cameras"] = scene.add_frame("/cameras", show_axes=False, visible=False)
    for mark in around.marks:
        node = scene.add_camera_frustum(
            f"/cameras/{mark.name}",
            mark.field,
            mark.aspect,
            scale=scale / 15,
            thickness=1.5,
            thickness_units="screen",
            color=(235, 120, 40) if mark.held_out else (60, 140, 230),
            wxyz=mark.stance.quat,
            position=mark.stance.place,
        )
        node.on_click(lambda _, mark=mark: page.jump(mark))
