"""Decides what geometry and structure say together of an object: the four quadrants and their limits.

The paper names the quadrants' meaning and gives examples, no limits. These are ours, fixed so that runs compare:

CDC_LIMIT = 0.5: each side lies on average about half a metre from the other (1 - exp(-0.54^2) = 0.25, twice).
R_LAMBDA_LIMIT = 0.4: what is usual for an object of a twin that was meshed from scans ends there (paper: mean 0.37).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...stages.arrays import FloatArray

CDC_LIMIT = 0.5
R_LAMBDA_LIMIT = 0.4

#: Keys of the quadrants, best first, and how they are called.
QUADRANTS = {
    "faithful": "faithful",
    "structure lost": "shape right but structure lost",
    "displaced": "structure right but displaced",
    "failed": "failed",
}
UNKNOWN = "no score"


def quadrant_of(cdc: FloatArray, r_lambda: FloatArray) -> NDArray[np.str_]:
    """The quadrant of each object, (n,) strings; "no score" where r_lambda is null.

    Parameters
    ----------
    cdc, r_lambda : (n,) float64; NaN where a score is null

    Examples
    --------
    >>> import numpy as np
    >>> quadrant_of(np.array([0.1, 0.1, 0.9, 0.9, 0.1]), np.array([0.1, 0.7, 0.1, 0.7, np.nan])).tolist()
    ['faithful', 'structure lost', 'displaced', 'failed', 'no score']
    """
    names = np.array([*QUADRANTS, UNKNOWN])
    index = (r_lambda > R_LAMBDA_LIMIT) + 2 * (cdc > CDC_LIMIT)
    return names[np.where(np.isnan(r_lambda), len(QUADRANTS), index)]
