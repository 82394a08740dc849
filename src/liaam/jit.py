"""How loops over pixels are compiled."""

import numba
import numpy as np

# fastmath without "no NaNs": images are finite by contract, but points of a diverging fit need not be. nogil: others
# draw and write videos meanwhile.
jit = numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")
F = np.float32
