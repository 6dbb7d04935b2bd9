"""Cameras, estimated from pictures of a known scene.

The package can be called: `gaussray.calibrate(...)` is `calibrate.pipeline.calibrate`.
"""

import sys

from gaussray.calibrate.options import CalibrateOptions as CalibrateOptions
from gaussray.calibrate.pipeline import calibrate as calibrate
from gaussray.runtime.callable_package import callable_package


sys.modules[__name__].__class__ = callable_package(calibrate)
