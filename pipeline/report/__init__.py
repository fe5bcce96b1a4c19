"""Pictures and pages from finished tables; computes no new score.

terminal/, page/ and figures/ draw. What they share: results (reads a run), aggregates, quadrants and verdict
(count and judge), charts (of the pages), colours and names (the look).
"""
