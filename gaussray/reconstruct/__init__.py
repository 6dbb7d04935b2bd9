"""Stage 1: pictures become a scene.

The package can be called: `gaussray.reconstruct(...)` is `reconstruct.pipeline.reconstruct`.
"""

import sys

from gaussray.reconstruct.options import ReconstructOptions as ReconstructOptions
from gaussray.reconstruct.pipeline import reconstruct as reconstruct
from gaussray.runtime.callable_package import callable_package


sys.modules[__name__].__class__ = callable_package(reconstruct)
