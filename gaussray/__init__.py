"""Dynamic scenes as 4D Gaussians, ray traced through real cameras."""

from gaussray.camera.rays import Rays as Rays
from gaussray.scene.deformation import Deformation as Deformation
from gaussray.scene.gaussians import Gaussians as Gaussians
from gaussray.scene.planes import Planes as Planes
from gaussray.scene.scene import Scene as Scene, at as at
from gaussray.scene.segmented import Clip as Clip
from gaussray.scene.store import load_scene as load_scene, save_scene as save_scene
from gaussray.tracer.composite import Pixels as Pixels
from gaussray.tracer.motion import Motion as Motion, still as still
from gaussray.tracer.trace import TraceOptions as TraceOptions, measure as measure, trace as trace
