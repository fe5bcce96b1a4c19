"""Renew the pictures of the pages: python tools/screenshots.py RUN, of a diagnosed run with a report, or COMPARE.html.

The comparison in docs/decision.md is of the runs of build41 and build42 of tools/builds.py, preset reference.
"""

import sys
import tempfile
from pathlib import Path

from PIL import Image

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from browsers import by_id, choose, open_page, resize, settle, start_browser

DOCS = Path(__file__).resolve().parents[1] / "docs"


def take(browser, name, selector):
    """A picture of the window with an element at its top."""
    place = browser.find_element("css selector", selector)
    browser.execute_script("arguments[0].scrollIntoView({block: 'start'})", place)
    settle(browser)
    path = DOCS / f"{name}.png"
    browser.save_screenshot(str(path))
    Image.open(path).convert("RGB").save(path, optimize=True)


def take_comparison(page):
    """Take a picture of the decision, the causes and the decided families."""
    with tempfile.TemporaryDirectory() as profile:
        browser = start_browser(profile)
        browser.execute_cdp_cmd("Emulation.setScrollbarsHidden", {"hidden": True})
        resize(browser, 1280)
        open_page(browser, page)
        take(browser, "decision", "body")
        browser.quit()
    path = DOCS / "decision.png"
    Image.open(path).crop((0, 0, 1280, 580)).save(path, optimize=True)


def main(run):
    """Take the pictures."""
    if run.is_file():
        take_comparison(run.resolve())
        return
    page = (run / "report.html").resolve()
    with tempfile.TemporaryDirectory() as profile:
        browser = start_browser(profile)
        browser.execute_cdp_cmd("Emulation.setScrollbarsHidden", {"hidden": True})
        resize(browser, 1280)
        open_page(browser, page)
        take(browser, "report", "header")
        choose(browser, "colour", "signed")
        take(browser, "report-3d", "#view")
        choose(browser, "colour", "side")
        place = by_id(browser, "panel")
        browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", place)
        settle(browser)
        place.screenshot(str(DOCS / "report-object.png"))
        browser.quit()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
