"""Dynamic scenes as 4D Gaussians, ray traced through real cameras.

Every name below is imported when it is first used: `import gaussray` itself loads nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from gaussray.calibrate.options import CalibrateOptions as CalibrateOptions
    from gaussray.calibrate.pipeline import calibrate as calibrate
    from gaussray.camera.aperture import Aperture as Aperture, Rim as Rim
    from gaussray.camera.camera import Camera as Camera
    from gaussray.camera.film import Film as Film
    from gaussray.camera.focus_pull import FocusPull as FocusPull
    from gaussray.camera.lens.abstract import AbstractLens as AbstractLens
    from gaussray.camera.lens.blender_polynomial import FisheyePolynomial as FisheyePolynomial
    from gaussray.camera.lens.division import Division as Division
    from gaussray.camera.lens.equirectangular import Equirectangular as Equirectangular
    from gaussray.camera.lens.f_theta import FTheta as FTheta
    from gaussray.camera.lens.fisheye import Fisheye as Fisheye
    from gaussray.camera.lens.kannala_brandt import KannalaBrandt as KannalaBrandt
    from gaussray.camera.lens.perspective import Pinhole as Pinhole
    from gaussray.camera.lens.radial import RadialLens as RadialLens
    from gaussray.camera.lens.ray_table import RayTable as RayTable
    from gaussray.camera.lens.sphere import (
        DoubleSphere as DoubleSphere,
        UnifiedSphere as UnifiedSphere,
    )
    from gaussray.camera.lens.thin_prism import ThinPrismFisheye as ThinPrismFisheye
    from gaussray.camera.placement import look_at as look_at, orbit as orbit
    from gaussray.camera.rays import Rays as Rays
    from gaussray.camera.shutter import (
        Shutter as Shutter,
        global_shutter as global_shutter,
        rolling_shutter as rolling_shutter,
    )
    from gaussray.camera.trajectory import Trajectory as Trajectory
    from gaussray.capture.capture import Capture as Capture, View as View
    from gaussray.capture.open import open_capture as open_capture
    from gaussray.capture.selection import Selection as Selection
    from gaussray.dataset.images import write_image as write_image
    from gaussray.evaluate.options import EvaluateOptions as EvaluateOptions
    from gaussray.evaluate.pipeline import evaluate as evaluate
    from gaussray.prepare.options import PrepareOptions as PrepareOptions
    from gaussray.prepare.pipeline import prepare_capture as prepare  # noqa: F401
    from gaussray.reconstruct.options import (
        FitOptions as FitOptions,
        ReconstructOptions as ReconstructOptions,
    )
    from gaussray.reconstruct.pipeline import reconstruct as reconstruct
    from gaussray.render.frame import Frame as Frame
    from gaussray.render.options import RenderOptions as RenderOptions
    from gaussray.render.picture import (
        Picture as Picture,
        render as render,
        render_rays as render_rays,
    )
    from gaussray.render.plan import Plan as Plan, plan as plan
    from gaussray.render.renderer import Renderer as Renderer
    from gaussray.scene.deformation import Deformation as Deformation
    from gaussray.scene.formats.any_file import load as load, save as save
    from gaussray.scene.gaussians import Gaussians as Gaussians
    from gaussray.scene.planes import Planes as Planes
    from gaussray.scene.scene import Scene as Scene, at as at
    from gaussray.scene.segmented import Clip as Clip
    from gaussray.scene.store import load_scene as load_scene, save_scene as save_scene
    from gaussray.tracer.composite import Pixels as Pixels
    from gaussray.tracer.measure import measure as measure
    from gaussray.tracer.motion import Motion as Motion, still as still
    from gaussray.tracer.options import TraceOptions as TraceOptions
    from gaussray.tracer.trace import trace as trace

# The modules of all public names but those of packages that can be called (_CALLABLE).
_MODULES = {
    "calibrate.options": ("CalibrateOptions",),
    "camera.aperture": ("Aperture", "Rim"),
    "camera.camera": ("Camera",),
    "camera.film": ("Film",),
    "camera.focus_pull": ("FocusPull",),
    "camera.lens.abstract": ("AbstractLens",),
    "camera.lens.blender_polynomial": ("FisheyePolynomial",),
    "camera.lens.division": ("Division",),
    "camera.lens.equirectangular": ("Equirectangular",),
    "camera.lens.f_theta": ("FTheta",),
    "camera.lens.fisheye": ("Fisheye",),
    "camera.lens.kannala_brandt": ("KannalaBrandt",),
    "camera.lens.perspective": ("Pinhole",),
    "camera.lens.radial": ("RadialLens",),
    "camera.lens.ray_table": ("RayTable",),
    "camera.lens.sphere": ("DoubleSphere", "UnifiedSphere"),
    "camera.lens.thin_prism": ("ThinPrismFisheye",),
    "camera.placement": ("look_at", "orbit"),
    "camera.rays": ("Rays",),
    "camera.shutter": ("Shutter", "global_shutter", "rolling_shutter"),
    "camera.trajectory": ("Trajectory",),
    "capture.capture": ("Capture", "View"),
    "capture.open": ("open_capture",),
    "capture.selection": ("Selection",),
    "dataset.images": ("write_image",),
    "evaluate.options": ("EvaluateOptions",),
    "prepare.options": ("PrepareOptions",),
    "reconstruct.options": ("FitOptions", "ReconstructOptions"),
    "render.frame": ("Frame",),
    "render.options": ("RenderOptions",),
    "render.picture": ("Picture", "render_rays"),
    "render.plan": ("Plan", "plan"),
    "render.renderer": ("Renderer",),
    "scene.deformation": ("Deformation",),
    "scene.formats.any_file": ("load", "save"),
    "scene.gaussians": ("Gaussians",),
    "scene.planes": ("Planes",),
    "scene.scene": ("Scene", "at"),
    "scene.segmented": ("Clip",),
    "scene.store": ("load_scene", "save_scene"),
    "tracer.composite": ("Pixels",),
    "tracer.motion": ("Motion", "still"),
    "tracer.measure": ("measure",),
    "tracer.options": ("TraceOptions",),
    "tracer.trace": ("trace",),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}
_CALLABLE = ("calibrate", "evaluate", "prepare", "reconstruct", "render")


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("gaussray")
    if name in _CALLABLE:
        return importlib.import_module(f"gaussray.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'gaussray' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"gaussray.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*_HOME, *_CALLABLE, "__version__"])
