"""Stage 1: pictures become a scene."""

from gaussray.reconstruct.options import ReconstructOptions as ReconstructOptions
from gaussray.reconstruct.pipeline import reconstruct as reconstruct
