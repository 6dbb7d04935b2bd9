"""Stage 1: pictures become a scene."""

from gaussray.reconstruct.pipeline import reconstruct as reconstruct
from gaussray.reconstruct.session import ReconstructOptions as ReconstructOptions
