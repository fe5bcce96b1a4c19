"""CPU seconds of the commands that only read, and seconds until a browser has drawn the page of a run.

    python benchmarks/small_commands.py RUN [REPEATS]     of a finished run; medians, of 5 by default
    python benchmarks/small_commands.py PAGE.html ...     of each page, alternating; medians of 5:
        first paint; load; end of the last task over 50 ms; CPU of the page's main thread, and of all processes of the
        browser; and both again after each chart was in view

FIDPIPE_BENCH_COMMAND names the command of another version, as RUN has to be of its own.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from statistics import median

import psutil
from measure import FIDPIPE

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from browsers import resize, settle, start_browser

#: A browser is quiet if it takes less CPU than this in as many seconds as that; plotly's scenes never stop completely.
QUIET_S, QUIET_FOR_S = 0.2, 1.5
TIMES = """const done = arguments[0], ends = [0];
new PerformanceObserver((list) => { for (const one of list.getEntries()) ends.push(one.startTime + one.duration); })
  .observe({ type: "longtask", buffered: true });
setTimeout(() => done([
  performance.getEntriesByName("first-contentful-paint")[0].startTime,
  performance.getEntriesByType("navigation")[0].loadEventEnd,
  Math.max(...ends),
]), 500);"""


def cpu_seconds(*words):
    """User and system seconds of the command and its processes; Python may cache compiled modules, as at a user's."""
    command = [os.environ.get("FIDPIPE_BENCH_COMMAND", FIDPIPE), *map(str, words)]
    cached = {
        name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"
    }
    process = subprocess.Popen(
        command, env=cached, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{command}: failed")
    return used.ru_utime + used.ru_stime


def tree_seconds(pid):
    """User and system seconds of the processes below a process."""
    seconds = 0.0
    for process in psutil.Process(pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # ended meanwhile
            seconds += sum(process.cpu_times()[:2])
    return seconds


def seconds_when_quiet(browser):
    """CPU seconds of the page's main thread, and of all processes of a browser, when it has nothing left to do."""
    last = -1.0
    now = 0.0
    while now - last > QUIET_S:
        last = now
        time.sleep(QUIET_FOR_S)
        now = tree_seconds(browser.service.process.pid)
    metrics = browser.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return next(one["value"] for one in metrics if one["name"] == "TaskDuration"), now


def page_seconds(page):
    """Times of a page in a fresh browser at 1280 pixels, as the module describes them."""
    with tempfile.TemporaryDirectory() as profile:
        browser = start_browser(profile)
        resize(browser, 1280)
        browser.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
        _, before = seconds_when_quiet(browser)
        browser.get(page.resolve().as_uri())
        main_thread, whole = seconds_when_quiet(browser)
        times = [own / 1000 for own in browser.execute_async_script(TIMES)]
        browser.execute_script(
            "for (const one of document.querySelectorAll('details')) one.open = true"
        )
        for chart in browser.find_elements("css selector", ".chart"):
            browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
            settle(browser)
        main_thread_after, whole_after = seconds_when_quiet(browser)
        browser.quit()
    return [*times, main_thread, whole - before, main_thread_after, whole_after - before]


def main(paths, repeats=5):
    if paths[0].suffix == ".html":
        tries = [[page_seconds(page) for page in paths] for _ in range(repeats)]
        for page, own in zip(paths, zip(*tries, strict=True), strict=True):
            print(page, *(f"{median(values):.2f}" for values in zip(*own, strict=True)))
        return
    run = paths[0]
    dataset = json.loads((run / "run.json").read_text())["dataset"]
    again = ["run", dataset, "--out", run, "--settings", run / "settings.toml"]
    for words in (["--help"], ["status", run], ["show", run], again, ["report", run]):
        print(words[0], f"{median(cpu_seconds(*words) for _ in range(repeats)):.2f} s")


if __name__ == "__main__":
    main(
        [Path(word) for word in sys.argv[1:] if not word.isdigit()],
        *map(int, filter(str.isdigit, sys.argv[1:])),
    )
