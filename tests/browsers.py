"""Chromium without a display, with WebGL in software, and what tests and screenshots do with it."""

import shutil
import time

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--use-angle=swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)


#: Whether the points of a pair are drawn, in JavaScript.
IN_3D = "Boolean(document.getElementById('scene').data)"
PROGRAMS = ("chromium", "chromedriver")


def missing_programs():
    """Names of the missing programs as text; "" if both are installed."""
    return " and ".join(name for name in PROGRAMS if not shutil.which(name))


def start_browser(profile):
    """A browser whose log of complaints and of requests is kept."""
    from selenium import webdriver

    chromium, driver = map(shutil.which, PROGRAMS)
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    found.set_script_timeout(60)
    return found


def open_page(browser, path, fragment=""):
    browser.get(path.as_uri() + fragment)
    wait_for(browser, "return document.documentElement.dataset.ready === 'yes'")
    browser.execute_script(
        "document.getElementById('scene')?.scrollIntoView({block: 'center'})"
    )
    wait_for(
        browser,
        "const viewer = document.getElementById('viewer'); return !viewer || viewer.hidden || "
        + IN_3D,
    )
    settle(browser)


def wait_for(browser, script, seconds=60):
    end = time.monotonic() + seconds
    while not (found := browser.execute_script(script)):
        assert time.monotonic() < end, f"still false after {seconds} s: {script}"
        time.sleep(0.05)
    return found


def settle(browser):
    """Wait until the page is drawn."""
    browser.execute_async_script(
        "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 300)))"
    )


def resize(browser, width, dark=False):
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False},
    )
    theme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": theme})


def by_id(browser, name):
    return browser.find_element("id", name)


def choose(browser, name, value):
    """Chooses in a list by value; selenium's own way fails on values with control characters."""
    place = by_id(browser, name)
    values = browser.execute_script(
        "return [...arguments[0].options].map((option) => option.value)", place
    )
    place.find_elements("css selector", "option")[values.index(value)].click()
    settle(browser)
