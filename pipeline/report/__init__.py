"""Pictures and pages from finished tables; computes no new score.

terminal/, page/ and figures/ draw. What they share: results (reads a run), aggregates and verdict
(count and judge), charts (of the pages), look (colours, names).
"""

import logging

logging.getLogger("matplotlib").setLevel(logging.ERROR)  # where its cache is, or is not, does not concern our users
