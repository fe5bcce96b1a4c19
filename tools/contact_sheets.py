"""Pictures of pages and commands of two versions side by side: python tools/contact_sheets.py BEFORE AFTER OUT

BEFORE and AFTER are folders with report.html, compare.html, and NAME.txt for the output of commands with their colours.
Pages are shown at 1280 and 390 pixels, light and dark, and as they print (pdftoppm of poppler-utils).
"""

import base64
import io
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont
from rich.console import Console
from rich.text import Text

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from browsers import open_page, resize, settle, start_browser

#: By name of a sheet: the page, the element at the top of the window, and if an object is chosen before.
SCREENS = {
    "first_screen": ("report", "header", False),
    "view_3d": ("report", "#view", False),
    "object_panel": ("report", "#panel", True),
    "tables": ("report", "#objects", False),
    "compare": ("compare", "body", False),
    "compare_3d": ("compare", "[id^=worst_], body:not(:has([id^=worst_])) figure", False),
}
LOOKS = [(1280, False), (390, False), (1280, True), (390, True)]
WORST = "const one = document.querySelector('#worst a'); return one ? one.getAttribute('href') : ''"
SCALE, GAP, HEAD, PAGE_WIDTH = 0.55, 12, 30, 400


def grid(pictures, n_columns):
    """Pictures row by row, each column as wide as its widest."""
    rows = [pictures[i : i + n_columns] for i in range(0, len(pictures), n_columns)]
    widths = [max(row[k].width for row in rows if k < len(row)) for k in range(n_columns)]
    heights = [max(picture.height for picture in row) for row in rows]
    sheet = Image.new("RGB", (sum(widths) + GAP * (n_columns - 1), sum(heights) + GAP * (len(rows) - 1)), "#8a8f99")
    for i, row in enumerate(rows):
        for k, picture in enumerate(row):
            sheet.paste(picture, (sum(widths[:k]) + GAP * k, sum(heights[:i]) + GAP * i))
    return sheet


def save_sheet(path, before, after):
    """Save two pictures side by side, with headings."""
    headed = []
    for words, picture in (("before", before), ("after", after)):
        own = Image.new("RGB", (picture.width, picture.height + HEAD), "white")
        ImageDraw.Draw(own).text((4, 3), words, "black", ImageFont.load_default(20))
        own.paste(picture, (0, HEAD))
        headed.append(own)
    grid(headed, 2).save(path, quality=80, method=6)


def opened(png):
    """A picture from the bytes of a PNG file."""
    return Image.open(io.BytesIO(png)).convert("RGB")


def take_screens(browser, page, screens):
    """By name, the screens of a page in all looks, one grid each."""
    taken = {name: [] for name in screens}
    for width, dark in LOOKS:
        resize(browser, width, dark)
        browser.get("about:blank")
        open_page(browser, page)
        for name, (_, selector, is_chosen) in screens.items():
            if is_chosen:
                open_page(browser, page, browser.execute_script(WORST))
            place = browser.find_element("css selector", selector)
            browser.execute_script("arguments[0].scrollIntoView({block: 'start'})", place)
            for _ in range(3):
                settle(browser)
            picture = opened(browser.get_screenshot_as_png())
            taken[name].append(picture.resize([round(SCALE * size) for size in picture.size], Image.Resampling.LANCZOS))
    return {name: grid(pictures, 2) for name, pictures in taken.items()}


def take_print(browser, page):
    """All printed pages of a page."""
    resize(browser, 1280)
    open_page(browser, page)
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True, "printBackground": True})
    with tempfile.TemporaryDirectory() as folder:
        command = ["pdftoppm", "-png", "-scale-to-x", str(PAGE_WIDTH), "-scale-to-y", "-1", "-", f"{folder}/page"]
        subprocess.run(command, input=base64.b64decode(printed["data"]), check=True)
        return grid([opened(path.read_bytes()) for path in sorted(Path(folder).iterdir())], 2)


def take_terminal(browser, path):
    """The output of a command as a terminal shows it."""
    console = Console(record=True, width=100, file=io.StringIO())
    console.print(Text.from_ansi(path.read_text()))
    page = path.with_suffix(".html")
    page.write_text(console.export_html(), encoding="utf-8")
    resize(browser, 960)
    browser.get(page.resolve().as_uri())
    browser.execute_script("document.body.style.zoom = 0.7")  # or wide and long output is cut
    picture = opened(browser.find_element("css selector", "pre").screenshot_as_png)
    page.unlink()
    return picture


def main(before, after, out):
    """Write all sheets."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as profile:
        browser = start_browser(profile)
        browser.execute_cdp_cmd("Emulation.setScrollbarsHidden", {"hidden": True})
        for kind in ("report", "compare"):
            screens = {name: screen for name, screen in SCREENS.items() if screen[0] == kind}
            pages = [(folder / f"{kind}.html").resolve() for folder in (before, after)]
            taken = [take_screens(browser, page, screens) for page in pages]
            for name in screens:
                save_sheet(out / f"{name}.webp", *(one[name] for one in taken))
            save_sheet(out / f"{kind}_print.webp", *(take_print(browser, page) for page in pages))
        for path in sorted(after.glob("*.txt")):
            save_sheet(out / f"{path.stem}.webp", *(take_terminal(browser, one / path.name) for one in (before, after)))
        browser.quit()


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
