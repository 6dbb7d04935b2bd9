"""Blender as a renderer of numbered pictures: quality, one picture, files without a date."""

import contextlib
import os
import sys
import zlib
from pathlib import Path

import bpy
import numpy as np


# The wheel of bpy carries OpenImageIO in a folder of its own.
for folder in Path(bpy.utils.resource_path("LOCAL")).glob("python/lib/python3*/site-packages"):
    sys.path.append(str(folder))
import OpenImageIO as oiio  # noqa: E402


def quality(width, height, samples):
    """Cycles with OpenImageDenoise, plain sRGB, no dither, nothing in the files but pixels."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    scene.render.use_persistent_data = False  # else Cycles ignores a change of motion_steps
    scene.render.dither_intensity = 0.0
    scene.render.use_file_extension = False
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.compression = 100
    for stamp in [key for key in dir(scene.render) if key.startswith("use_stamp")]:
        setattr(scene.render, stamp, False)  # no dates or paths in the files
    scene.view_settings.view_transform = "Standard"
    scene.cycles.device = "GPU" if gpu() else "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_light_tree = False
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 4
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"
    scene.cycles.denoising_use_gpu = scene.cycles.device == "GPU"


def gpu():
    """Name of the first kind of GPU that Cycles finds and is now told to use; None without one."""
    cycles = bpy.context.preferences.addons["cycles"].preferences
    for kind in ("OPTIX", "CUDA", "HIP", "METAL", "ONEAPI"):
        try:
            cycles.compute_device_type = kind
        except TypeError:  # not built for this system
            continue
        cycles.refresh_devices()
        found = [device for device in cycles.devices if device.type == kind]
        for device in cycles.devices:
            device.use = device in found
        if found:
            return kind
    return None


def render(path, frame, label):
    """Render the current camera at a frame, which may be fractional, to a file that is complete if
    it exists. The noise depends on the `label` alone."""
    scene = bpy.context.scene
    scene.cycles.seed = zlib.crc32(label.encode()) >> 1
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    scene.render.filepath = str(partial.resolve())
    with silence():
        bpy.ops.render.render(write_still=True)
    store(partial, path.suffix)
    partial.replace(path)


def render_depth(path, frame):
    """Depth along the optical axis at the pixels' middles, in whole millimetres of 16 bits; what is
    farther than they reach, or empty, is 0."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    kept = scene.cycles.samples, scene.cycles.filter_width, scene.cycles.use_denoising
    form = scene.render.image_settings
    scene.cycles.samples, scene.cycles.filter_width, scene.cycles.use_denoising = 1, 0.01, False
    layer.use_pass_z, form.file_format = True, "OPEN_EXR_MULTILAYER"
    scene.render.use_persistent_data = False
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    path.parent.mkdir(parents=True, exist_ok=True)
    passes, partial = path.with_name(path.name + ".exr"), path.with_name(path.name + ".part")
    scene.render.filepath = str(passes.resolve())
    with silence():
        bpy.ops.render.render(write_still=True)
    layer.use_pass_z, form.file_format, form.color_mode = False, "PNG", "RGB"
    scene.cycles.samples, scene.cycles.filter_width, scene.cycles.use_denoising = kept
    buffer = oiio.ImageBuf(str(passes))
    names = list(buffer.spec().channelnames)
    z = buffer.get_pixels(oiio.FLOAT)[..., names.index(f"{layer.name}.Depth.Z")]
    codes = np.where(z < 65.5, np.round(1000 * z), 0).astype(np.uint16)
    made = oiio.ImageBuf(oiio.ImageSpec(codes.shape[1], codes.shape[0], 1, oiio.UINT16))
    made.set_pixels(oiio.ROI(0, codes.shape[1], 0, codes.shape[0], 0, 1, 0, 1), codes[..., None])
    if not made.write(str(partial), oiio.UINT16, "png"):
        raise OSError(f"{path}: {made.geterror()}")
    passes.unlink()
    partial.replace(path)


def store(path, suffix):
    """Rewrite Blender's PNG in place: no render times in it, and JPEG with full chroma."""
    array = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
    height, width, channels = array.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8)
    if suffix == ".jpg":
        spec.attribute("Compression", "jpeg:95")
        spec.attribute("jpeg:subsampling", "4:4:4")
    else:
        spec.attribute("png:compressionLevel", 9)
    made = oiio.ImageBuf(spec)
    made.set_pixels(oiio.ROI(0, width, 0, height, 0, 1, 0, channels), array)
    if not made.write(str(path), oiio.UINT8, "jpeg" if suffix == ".jpg" else "png"):
        raise OSError(f"{path}: {made.geterror()}")


@contextlib.contextmanager
def silence():
    """Keep Blender's own lines off the screen."""
    sys.stdout.flush()
    screen = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(screen, 1)
        os.close(screen)


def read(path):
    """sRGB values in 0..1, top row first."""
    image = bpy.data.images.load(str(path.resolve()))
    width, height = image.size
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, image.channels)[::-1, :, :3].copy()
    bpy.data.images.remove(image)
    return pixels
