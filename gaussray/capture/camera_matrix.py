"""The camera matrix and the rotation that are the left part of a projection K [R | t]."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import rq


# Skew is left out up to this part of the focal length, as rounding makes it.
SLIGHT_SKEW = 1e-3


def matrix_and_rotation(
    product: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """K with positive focal lengths and 1 in the last place, and R, of a multiple of K R with a
    determinant above 0.

    It is a product of an upper triangular matrix and a rotation, which is unique up to signs.
    """
    upper, rotation = rq(product)
    signs = np.sign(np.diag(upper))
    return upper * signs / (upper[2, 2] * signs[2]), signs[:, None] * rotation
