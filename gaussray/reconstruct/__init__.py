"""Stage 1: pictures become a scene.

`pipeline` leads from a capture to a scene: `auto` chooses options, `checks` looks for what is
wrong with the capture, `data` reads the pictures, `initialize` finds the first points and motion,
`loop` and `step` fit with `optimize`, and `simplify` removes what the pictures do not need.

The package can be called: `gaussray.reconstruct(...)` is `reconstruct.pipeline.reconstruct`.
"""

import sys

from gaussray.reconstruct.options import ReconstructOptions as ReconstructOptions
from gaussray.reconstruct.pipeline import reconstruct as reconstruct
from gaussray.runtime.callable_package import callable_package


sys.modules[__name__].__class__ = callable_package(reconstruct)
