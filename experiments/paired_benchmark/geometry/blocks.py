"""From Blender's camera settings to the blocks of a paired capture that say the same."""

POSITION = {"START": 0.5, "CENTER": 0.0, "END": -0.5}
# Name in a capture, and what turns Blender's filter_width (None: not used) into the total width.
FILTER = {
    "BLACKMAN_HARRIS": ("blackman_harris", 2.0),
    "GAUSSIAN": ("gaussian", 3.0),
    "BOX": ("box", None),
}
# Cycles draws the instants of an exposure from a table of 256 entries, which covers 127/128 of the
# shutter time and has its middle 1/512 of it too early (measured: 0.99220 and 0.001953).
COVERED, EARLY = 127 / 128, 1 / 512


def blocks(scene, clip, through_filter):
    """Intrinsics and blocks of the scene's camera as Cycles sees them.

    `clip` frames make one unit of the capture's time. Without `through_filter` rays pass through
    the pixels' centres, as Cycles' first sample of a pixel does.
    """
    data, size = scene.camera.data, (scene.render.resolution_x, scene.render.resolution_y)
    made = intrinsics(data, *size)
    if data.type == "PANO":
        made |= fisheye(data, *size)
    if data.dof.use_dof:
        made["aperture"] = aperture(data)
    if scene.render.use_motion_blur:
        made["shutter"] = shutter(scene, clip)
    made["film"] = film(scene.cycles) if through_filter else {"filter": "center"}
    return made


def millimetres_per_pixel(data, width, height):
    """AUTO takes `sensor_width` for the longer side, `sensor_height` counts for VERTICAL alone."""
    if data.sensor_fit == "VERTICAL":
        return data.sensor_height / height
    across = data.sensor_fit == "HORIZONTAL" or width >= height
    return data.sensor_width / (width if across else height)


def intrinsics(data, width, height):
    """Pinhole: one focal length, and shifts in units of the side that the sensor is fitted to."""
    scale = millimetres_per_pixel(data, width, height)
    along = data.sensor_fit == "VERTICAL" or (data.sensor_fit == "AUTO" and width < height)
    side = height if along else width
    return {
        "w": width,
        "h": height,
        "fl_x": data.lens / scale,
        "fl_y": data.lens / scale,
        "cx": width / 2 - data.shift_x * side,
        "cy": height / 2 + data.shift_y * side,
        "camera_model": "PINHOLE",
    }


def fisheye(data, width, height):
    """Polynomial fisheye as Blender has it; the equidistant one, in a square picture, as a
    Kannala-Brandt lens without coefficients."""
    if data.panorama_type == "FISHEYE_EQUIDISTANT":
        if width != height or data.shift_x or data.shift_y:
            raise ValueError("FISHEYE_EQUIDISTANT must be square and not shifted.")
        return {
            "lens": {"model": "kannala_brandt", "fov": data.fisheye_fov},
            "fl_x": width / data.fisheye_fov,
            "fl_y": height / data.fisheye_fov,
        }
    if data.panorama_type != "FISHEYE_LENS_POLYNOMIAL":
        raise ValueError(f"panorama_type {data.panorama_type} has no block in a capture.")
    scale = millimetres_per_pixel(data, width, height)
    lens = {
        "model": "blender_fisheye_polynomial",
        "k": [getattr(data, f"fisheye_polynomial_k{k}") for k in range(5)],
        "sensor_width_mm": width * scale,
        "sensor_height_mm": height * scale,
        "fov": data.fisheye_fov,
        "shift": [data.shift_x, data.shift_y],
    }
    return {"lens": lens, "cx": width / 2, "cy": height / 2}


def aperture(data):
    """One scene unit is a metre, whatever `unit_settings` says; fisheyes focus on a sphere."""
    return {
        "radius": data.lens * 1e-3 / (2 * data.dof.aperture_fstop),
        "focus_distance": data.dof.focus_distance,
        "focus": "sphere" if data.type == "PANO" else "plane",
        "blades": data.dof.aperture_blades,
        "rotation": data.dof.aperture_rotation,
        "ratio": data.dof.aperture_ratio,
    }


def shutter(scene, clip):
    """With rolling shutter the exposure takes its share of the shutter time, rows get the rest."""
    height, time = scene.render.resolution_y, scene.render.motion_blur_shutter
    rolling = scene.cycles.rolling_shutter_type == "TOP"
    exposure = time * scene.cycles.rolling_shutter_duration if rolling else time
    readout = time - exposure
    middle = POSITION[scene.render.motion_blur_position] * time - EARLY * exposure
    return {
        "row_offset": (middle + rolling * readout * (1 / height - 0.5)) / clip,
        "row_step": readout / height / clip,
        "exposure": COVERED * exposure / clip,
        "direction": "top_to_bottom",
    }


def film(cycles):
    """A capture tells the filter's total width."""
    name, factor = FILTER[cycles.pixel_filter_type]
    return {"filter": name, "filter_width": factor * cycles.filter_width if factor else 1.0}
