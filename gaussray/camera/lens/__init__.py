"""Lenses, one file each: maps between pixels and viewing directions.

A new lens is a new file that lists its models (`registry.py`); it needs no line here.
"""

from gaussray.camera.lens.abstract import AbstractLens as AbstractLens, FocalLens as FocalLens
from gaussray.camera.lens.blender_polynomial import FisheyePolynomial as FisheyePolynomial
from gaussray.camera.lens.check import check_lens as check_lens
from gaussray.camera.lens.division import Division as Division
from gaussray.camera.lens.equirectangular import Equirectangular as Equirectangular
from gaussray.camera.lens.f_theta import (
    POLYNOMIALS as POLYNOMIALS,
    FTheta as FTheta,
    limit_of_angle as limit_of_angle,
)
from gaussray.camera.lens.fisheye import PROJECTIONS as PROJECTIONS, Fisheye as Fisheye
from gaussray.camera.lens.kannala_brandt import KannalaBrandt as KannalaBrandt
from gaussray.camera.lens.perspective import Pinhole as Pinhole, pinhole as pinhole
from gaussray.camera.lens.radial import RadialLens as RadialLens
from gaussray.camera.lens.ray_table import RayTable as RayTable, ray_table as ray_table
from gaussray.camera.lens.sphere import DoubleSphere as DoubleSphere, UnifiedSphere as UnifiedSphere
from gaussray.camera.lens.thin_prism import ThinPrismFisheye as ThinPrismFisheye
