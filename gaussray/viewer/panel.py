"""The viewer's control panel, and the capture's cameras and points over the picture."""

from typing import Any

from gaussray.viewer import controls as table
from gaussray.viewer.overlay import Overlay
from gaussray.viewer.path_panel import PathPanel
from gaussray.viewer.preset import preset_names
from gaussray.viewer.viewpoint import subject_distance
from gaussray.viewer.window import LAYOUTS


def add_controls(page: Any) -> None:
    """Add all controls, from top to bottom."""
    gui = page.client.gui
    gui.configure_theme(dark_mode=page.dark, show_logo=False, show_share_button=False)
    gui.set_panel_label("gaussray")
    gui.main_panel.dock_right()
    page.handles["status"] = gui.add_markdown("Starting ...")
    _build_view(page, gui)
    for group, title in table.GROUPS.items():
        with gui.add_folder(title.capitalize(), expand_by_default=group != "sensor"):
            _build_group(page, gui, group)
    with gui.add_folder("Final picture", expand_by_default=False):
        _build_final(page, gui)
    with gui.add_folder("Camera path", expand_by_default=False):
        page.path = PathPanel(page, gui)
    with gui.add_folder("Presets", expand_by_default=False):
        _build_presets(page, gui)
    page.update_visibility()


def _build_view(page: Any, gui: Any) -> None:
    first, last, _ = page.model.times
    h = page.handles
    span = max(last - first, 1e-6)
    now = min(max(page.time, first), first + span)
    h["time"] = gui.add_slider(
        "time",
        first,
        first + span,
        span / 500,
        now,
        hint="Scene time, in the capture's unit of time.",
    )
    h["play"] = gui.add_checkbox("play", False, hint="Play the scene in a loop.")
    h["layout"] = gui.add_dropdown(
        "show",
        LAYOUTS,
        initial_value="camera",
        hint="The camera set below, an ideal pinhole at the same viewpoint, or both.",
    )
    h["split"] = gui.add_slider(
        "split",
        0.0,
        1.0,
        0.01,
        0.5,
        visible=False,
        hint="Fraction of the width that shows the pinhole, at the left.",
    )
    for name, hint in (
        ("cameras", "Show the capture's cameras (orange: held out). Click one to go there."),
        ("points", "Show the capture's points, or the centres of the Gaussians."),
        ("dark", "Dark colours."),
    ):
        h[name] = gui.add_checkbox(name, name == "dark" and page.dark, hint=hint)
    for name in ("time", "layout", "split", "cameras", "points", "dark"):
        h[name].on_update(lambda _, name=name: page.changed(name))


def _build_final(page: Any, gui: Any) -> None:
    h = page.handles
    sizes = [f"{width} x {height}" for width, height in page.model.sizes]
    hint = "Size of the final picture and of saved presets in pixels. Previews stay as fast."
    h["size"] = gui.add_dropdown("size (pixels)", sizes, initial_value=sizes[0], hint=hint)
    samples = str(page.values["render.samples"])
    counts = sorted({*table.SAMPLES, samples}, key=int)
    hint = "Rays per pixel of the final picture. More rays: less noise in blur, more time."
    h["samples"] = gui.add_dropdown("rays per pixel", counts, initial_value=samples, hint=hint)
    for name in ("size", "samples"):
        h[name].on_update(lambda _, name=name: page.changed(name))


def _build_group(page: Any, gui: Any, group: str) -> None:
    names = table.offered_choices(group)
    name = table.nearest_choice(group, page.values)
    h = page.handles[group] = gui.add_dropdown(
        "kind", names, initial_value=name, hint=f"{table.KIND_HINTS[group]} Key: {group}=..."
    )
    h.on_update(lambda _: page.choose(group))
    first, last, _ = page.model.times
    distance = subject_distance(page.model.scene, page.model.initial_viewpoint)
    for one in table.sliders(distance, last - first):
        if one.group != group:
            continue
        value = min(max(float(page.values[one.key]), one.low), one.high)
        numbers = one.low, one.high, one.step, type(one.step)(value)
        h = page.handles[one.key] = gui.add_slider(one.label, *numbers, hint=one.hint)
        h.on_update(lambda _, one=one: page.moved(one))


def _build_presets(page: Any, gui: Any) -> None:
    h = page.handles
    h["name"] = gui.add_text("name", "mine", hint="Name of the preset to save.")
    hint = "Write the camera as a preset for `gaussray render`."
    h["save"] = gui.add_button("Save this camera", hint=hint)
    names = ["-", *preset_names(page.out)]
    hint = "Set all controls and the viewpoint to those of a preset."
    h["preset"] = gui.add_dropdown("open", names, initial_value="-", hint=hint)
    h["command"] = gui.add_markdown(f"Presets are saved in `{page.out}`.")
    h["save"].on_click(lambda _: page.save())
    h["preset"].on_update(lambda _: page.open())


def add_overlay(page: Any, overlay: Overlay) -> None:
    """Add the capture's cameras and points to the 3D view.

    Args:
        page: the page of one browser (`viewer.page.Page`), which a click on a camera moves.
        overlay: cameras, points, and the scale of what is drawn.
    """
    scene, h, scale = page.client.scene, page.handles, overlay.scale
    h["/points"] = scene.add_point_cloud(
        "/points", overlay.position, overlay.color, point_size=scale / 250, visible=True
    )
    h["/cameras"] = scene.add_frame("/cameras", show_axes=False, visible=False)
    for marker in overlay.camera_markers:
        node = scene.add_camera_frustum(
            f"/cameras/{marker.name}",
            marker.fov,
            marker.aspect,
            scale=scale / 15,
            thickness=1.5,
            thickness_units="screen",
            color=(235, 120, 40) if marker.held_out else (60, 140, 230),
            wxyz=marker.viewpoint.quat,
            position=marker.viewpoint.position,
        )
        node.on_click(lambda _, marker=marker: page.jump_to_camera(marker))
