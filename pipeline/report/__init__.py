"""Pictures and pages from finished tables; computes no new score.

views/ describes each subject as plain data (`view`), `render` shows it in the terminal, page/ and
figures/ draw. They share run_frames (reads a run) and look (colours).
"""

import logging

# where its cache is, or is not, does not concern our users
logging.getLogger("matplotlib").setLevel(logging.ERROR)
