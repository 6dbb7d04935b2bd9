"""Stage 2: a scene and a camera become pictures, labels and datasets.

The package can be called: `gaussray.render(scene, camera)` is `render.picture.render`.
"""

import sys

from gaussray.render.options import RenderOptions as RenderOptions
from gaussray.render.picture import Picture as Picture, render as _render
from gaussray.render.renderer import Renderer as Renderer
from gaussray.runtime.callable_package import callable_package


sys.modules[__name__].__class__ = callable_package(_render)
