"""CPU seconds of the commands that only read, and seconds until a browser has drawn the page of a run.

    python benchmarks/small_commands.py RUN [REPEATS]     of a finished run; medians, of 5 by default
    python benchmarks/small_commands.py PAGE.html ...     first paint, load, and the end of the last task over 50 ms

FIDPIPE_BENCH_COMMAND names the command of another version, as RUN has to be of its own.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from measure import FIDPIPE

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from browsers import resize, start_browser

SECONDS_TO_DRAW = 15
TIMES = """const done = arguments[0], ends = [0];
new PerformanceObserver((list) => { for (const one of list.getEntries()) ends.push(one.startTime + one.duration); })
  .observe({ type: "longtask", buffered: true });
setTimeout(() => done([
  performance.getEntriesByName("first-contentful-paint")[0].startTime,
  performance.getEntriesByType("navigation")[0].loadEventEnd,
  Math.max(...ends),
]), 500);"""


def cpu_seconds(*words):
    """User and system seconds of the command and its processes."""
    command = [os.environ.get("FIDPIPE_BENCH_COMMAND", FIDPIPE), *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{command}: failed")
    return used.ru_utime + used.ru_stime


def page_seconds(page):
    """First paint, load event, and end of the last long task, in a fresh browser at 1280 pixels."""
    with tempfile.TemporaryDirectory() as profile:
        browser = start_browser(profile)
        resize(browser, 1280)
        browser.get(page.resolve().as_uri())
        time.sleep(SECONDS_TO_DRAW)
        times = browser.execute_async_script(TIMES)
        browser.quit()
    return [own / 1000 for own in times]


def main(paths, repeats=5):
    if paths[0].suffix == ".html":
        for page in paths:
            tries = zip(*(page_seconds(page) for _ in range(3)), strict=True)
            print(page, *(f"{median(own):.2f}" for own in tries))
        return
    run = paths[0]
    for words in (["--help"], ["status", run], ["show", run], ["report", run]):
        print(words[0], f"{median(cpu_seconds(*words) for _ in range(repeats)):.2f} s")


if __name__ == "__main__":
    main([Path(word) for word in sys.argv[1:] if not word.isdigit()], *map(int, filter(str.isdigit, sys.argv[1:])))
