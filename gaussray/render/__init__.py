"""Stage 2: a scene and a camera become pictures, labels and datasets."""

from gaussray.render.renderer import Renderer as Renderer, RenderOptions as RenderOptions
