"""Names of a camera's values in the keys of public files."""

import re


# In small letters and digits alone (`plain_key`).
VALUE_NAMES = {
    "matrix": (
        *("m", "k", "mtx", "mat", "cm", "cameramatrix", "cammtx", "cammatrix", "cammats"),
        *("cameramtx", "intrinsic", "intrinsics", "intrinsicmatrix", "intrinsicmtx", "matrix"),
        *("cameraintrinsic", "cameraintrinsics"),
    ),
    "distortion": (
        *("d", "dist", "dst", "distcoef", "distcoefs", "distcoeff", "distcoeffs"),
        *("distortion", "distortions", "distortioncoefficients", "distortioncoeffs"),
    ),
    "rotation": ("r", "rot", "rotation", "rotationmatrix", "rmat", "rotmat", "stereor", "rstereo"),
    "translation": (
        *("t", "trans", "translation", "translationvector", "tvec", "transvec"),
        *("stereot", "tstereo"),
    ),
    # Columns and rows of the calibrated pictures.
    "size": ("imagesize", "imgsize", "framesize", "size", "resolution", "resolutionwh"),
    "width": ("imagewidth", "imgwidth", "framewidth", "width", "w"),
    "height": ("imageheight", "imgheight", "frameheight", "height", "h"),
}
# The key of a projection of any scale, a direct linear transform (DLT), that text files have.
DLT_KEY = "P (DLT)"
# One matrix K [R | t] from the world to pixels.
PROJECTION_NAMES = (
    "pdlt",
    *("p", "proj", "projection", "projections", "projectionmatrix", "projectionmatrices"),
    *("projmat", "projmats", "projmatrix", "projs", "ps", "pmat", "pmats"),
)


def plain_key(key: object) -> str:
    """A key in small letters and digits alone, as `VALUE_NAMES` has them.

    Args:
        key: the key as the file has it.
    """
    return re.sub("[^a-z0-9]", "", str(key).lower())
