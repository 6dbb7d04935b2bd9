"""PyTorch datasets: the pictures of a written dataset, and pictures rendered while they are read.

Needs the extra `torch`. `import gaussray` does not import this package.
"""

try:
    import torch as torch
except ImportError as error:
    raise ModuleNotFoundError(
        "gaussray.torch needs PyTorch: pip install -e '.[torch]', or a build for your GPU from "
        "pytorch.org.",
        name="torch",
    ) from error

from gaussray.torch.rendered import RenderedFrames as RenderedFrames
from gaussray.torch.saved import SavedFrames as SavedFrames
from gaussray.torch.tensors import picture_tensors as picture_tensors
