"""The four quadrants of an object by geometry and structure, and their limits.

The paper names the quadrants' meaning and gives examples, no limits. They are fidpipe's, fixed so that runs compare,
and stand with their reasons in the catalogue of metrics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...schemas.metric_catalogue import QUADRANT_LIMITS
from ...stages.arrays import FloatArray

CDC_LIMIT, R_LAMBDA_LIMIT = QUADRANT_LIMITS["cdc"], QUADRANT_LIMITS["r_lambda"]

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
    cdc, r_lambda : (n,) float64; NaN if a score is null

    Examples
    --------
    >>> import numpy as np
    >>> quadrant_of(np.array([0.1, 0.1, 0.9, 0.9, 0.1]), np.array([0.1, 0.7, 0.1, 0.7, np.nan])).tolist()
    ['faithful', 'structure lost', 'displaced', 'failed', 'no score']
    """
    names = np.array([*QUADRANTS, UNKNOWN])
    index = (r_lambda > R_LAMBDA_LIMIT) + 2 * (cdc > CDC_LIMIT)
    return names[np.where(np.isnan(r_lambda), len(QUADRANTS), index)]
