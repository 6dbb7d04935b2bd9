"""What Blender must be told so that a camera sees as the blocks of a paired capture say."""

import bpy

from experiments.blender.blocks import SENSOR_MM


def new_camera(lens_mm):
    """The scene's camera: square pixels, `lens_mm` of focal length before 36 mm of width."""
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    bpy.context.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    data = camera.data
    data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", SENSOR_MM, lens_mm
    data.clip_start = 0.01
    return camera


def configure(camera, blocks, readout, moving):
    """Set the camera to the blocks (lens, aperture, shutter; without any it is a pinhole).

    `readout` frames pass from the first to the last row of a rolling shutter.
    """
    scene, data = bpy.context.scene, camera.data
    lens, aperture, shutter = (blocks.get(name) for name in ("lens", "aperture", "shutter"))
    data.type = "PANO" if lens else "PERSP"
    if lens:
        data.panorama_type, data.fisheye_fov = "FISHEYE_LENS_POLYNOMIAL", lens["fov"]
        for k, value in enumerate(lens["k"]):
            setattr(data, f"fisheye_polynomial_k{k}", value)
    data.dof.use_dof = aperture is not None
    if aperture:
        data.dof.focus_distance = aperture["focus_distance"]
        data.dof.aperture_fstop = data.lens * 1e-3 / (2 * aperture["radius"])
        data.dof.aperture_blades = aperture["blades"]
        data.dof.aperture_rotation = aperture["rotation"]
        data.dof.aperture_ratio = aperture["ratio"]
    scene.cycles.denoising_prefilter = "ACCURATE" if aperture else "NONE"
    scene.render.use_motion_blur = shutter is not None
    scene.render.motion_blur_shutter = readout
    scene.render.motion_blur_position = "CENTER"
    scene.cycles.rolling_shutter_type = "TOP"
    scene.cycles.rolling_shutter_duration = 0.0
    for thing in moving:
        # 129 poses over the readout: Blender's default of three is too coarse for what bounces.
        thing.cycles.motion_steps = 7
