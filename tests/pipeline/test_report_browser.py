"""The report in a real browser: Debian's Chromium, headless, with WebGL in software."""

import base64
import io
import json
import os
import re
from urllib.parse import quote

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from browsers import (
    IN_3D,
    by_id,
    choose,
    missing_programs,
    open_page,
    resize,
    settle,
    start_browser,
    wait_for,
)
from fidpipe.pipeline.report.page.compare_page import compare_page
from fidpipe.pipeline.report.page.run_page import write_report
from fidpipe.pipeline.report.run_frames import read_results
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.schemas.metric_catalogue import QUADRANT_LIMITS
from reports import HOSTILE_CLASS, HOSTILE_PAIRS

WIDTHS = (1280, 390)
BLUE = (0, 114, 178)
VERMILION = (184, 78, 0)
FIRST_PAIR = HOSTILE_PAIRS[0]
NO_SCORE = "-"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Chromium; without it the tests are skipped, or fail where real data and so a whole machine are required."""
    if missing_programs():
        reason = f"{missing_programs()} not installed (Debian: apt-get install chromium chromium-driver)"
        if os.environ.get("FIDPIPE_REQUIRE_REAL_DATA") == "1":
            pytest.fail(f"FIDPIPE_REQUIRE_REAL_DATA=1 and {reason}")
        pytest.skip(reason)
    found = start_browser(tmp_path_factory.mktemp("profile"))
    yield found
    found.quit()


@pytest.fixture(scope="session")
def page_path(report_run):
    return report_run.with_name("report") / "report.html"


@pytest.fixture(scope="module")
def opened(browser, page_path):
    """The page, opened once; errors and requests of the browser meanwhile."""
    browser.get("about:blank")  # the page that a browser starts with still asks for its parts
    complaints(browser), requests(browser)
    resize(browser, WIDTHS[0])
    open_page(browser, page_path)
    return complaints(browser), requests(browser)


@pytest.fixture
def page(browser, opened, page_path):
    """The page as it is opened: wide, light, the first pair, no object chosen."""
    resize(browser, WIDTHS[0])
    if browser.current_url.partition("#")[0] != page_path.as_uri():
        open_page(browser, page_path)
    for name, value in (
        ("theme", "auto"),
        ("pair", FIRST_PAIR),
        ("colour", "side"),
        ("object", ""),
    ):
        choose(browser, name, value)
    browser.execute_script("document.getElementById('show_road').checked = true")
    browser.execute_script(
        "for (const box of document.querySelectorAll('input[type=search]')) {"
        " box.value = ''; box.dispatchEvent(new Event('input')); }"
    )
    return browser


def pixels(browser, name):
    """(h, w, 3) what an element looks like; its details are opened."""
    place = by_id(browser, name)
    browser.execute_script(
        "for (let at = arguments[0]; at; at = at.parentElement) if (at.tagName === 'DETAILS') at.open = true",
        place,
    )
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", place)
    settle(browser)
    return np.asarray(Image.open(io.BytesIO(place.screenshot_as_png)).convert("RGB")).astype(
        int
    )


def see_all(browser):
    """Looks at every chart, so that all are drawn."""
    browser.execute_script(
        "for (const one of document.querySelectorAll('details')) one.open = true"
    )
    for chart in browser.find_elements("css selector", ".chart"):
        browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
        settle(browser)


def near(picture, colour):
    return np.abs(picture - np.array(colour)).max(axis=2) < 12


def complaints(browser):
    return [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def requests(browser):
    """Addresses that the browser requested outside the page itself."""
    events = [
        json.loads(entry["message"])["message"] for entry in browser.get_log("performance")
    ]
    asked = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    return [url for url in asked if not url.startswith(("data:", "blob:"))]


def table(browser, name):
    """The texts of a table's rows as a frame."""
    script = """const table = document.querySelector('#' + arguments[0] + ' table');
    return [...table.rows].filter((row) => !row.hidden).map((row) => [...row.cells].map((cell) => cell.textContent))"""
    head, *rows = browser.execute_script(script, name)
    return pd.DataFrame(rows, columns=head)


def sort_by(browser, name, title):
    for button in browser.find_elements("css selector", f"#{name} th button"):
        if button.text == title:
            browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
            return button.click()
    raise AssertionError(f"no column {title}")


def address(pair, name=None):
    """Fragment of an address that opens a pair, or an object of it."""
    return f"#pair={quote(pair, safe='')}" + (f"&object={quote(name, safe='')}" if name else "")


def fragment(browser):
    return browser.execute_script("return decodeURIComponent(location.hash)")


def drawn(browser, place, name):
    """(n, 3) the points of a trace of a plot in space."""
    script = """const trace = document.getElementById(arguments[0]).data.find(({name}) => name === arguments[1]);
    return trace ? [trace.x, trace.y, trace.z].map((values) => Array.from(values)) : [[], [], []]"""
    return np.array(browser.execute_script(script, place, name), dtype=float).T


def camera_of(browser):
    return browser.execute_script(
        "return document.getElementById('scene')._fullLayout.scene.camera.center"
    )


def turn_on(browser, name, is_on=True):
    if by_id(browser, name).is_selected() != is_on:
        by_id(browser, name).click()
        settle(browser)


def shown_numbers(browser, place="panel_numbers"):
    found = browser.find_elements("css selector", f"#{place} .value")
    names = browser.find_elements("css selector", f"#{place} .name")
    return {name.text: value.text for name, value in zip(names, found, strict=True)}


def test_the_page_opens_from_disk_without_a_complaint_or_a_request(browser, opened, page_path):
    complained, asked = opened
    assert complained == []
    assert asked == [page_path.as_uri()]
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0


@pytest.mark.exhaustive
def test_both_sides_are_drawn_in_3d_and_the_colouring_switches(page):
    side = pixels(page, "scene")
    assert near(side, BLUE).sum() > 200
    assert near(side, VERMILION).sum() > 200
    looks = [side]
    for by in ("community", "r_lambda", "cdc", "quadrant"):
        choose(page, "colour", by)
        looks.append(pixels(page, "scene"))
        assert (looks[-1] != looks[-2]).any(axis=2).sum() > 200, by
    choose(page, "colour", "side")
    by_id(page, "show_sim").click()
    alone = pixels(page, "scene")
    by_id(page, "show_sim").click()
    assert near(alone, VERMILION).sum() == 0
    assert near(alone, BLUE).sum() > 200


def test_a_click_on_a_point_shows_its_object_with_the_numbers_of_the_parquet(page, report_run):
    from selenium.webdriver import ActionChains

    metrics = pd.read_parquet(report_run / "metrics")
    metrics = metrics[metrics.pair_id == FIRST_PAIR].set_index("real_id")
    choose(page, "colour", "r_lambda")
    picture = pixels(page, "scene")
    # A spot well inside of an object that has a score: its colour is neither grey nor the background.
    coloured = np.ptp(picture, axis=2) > 80
    crowd = sum(
        np.roll(coloured, (down, right), (0, 1)).astype(int)
        for down in range(-3, 4)
        for right in range(-3, 4)
    )
    crowd[:60], crowd[-60:] = 0, 0
    y, x = np.unravel_index(np.argmax(crowd), crowd.shape)
    scene = by_id(page, "scene")
    dx = int(x) - scene.size["width"] // 2
    dy = int(y) - scene.size["height"] // 2
    ActionChains(page).move_to_element_with_offset(scene, dx, dy).pause(0.5).click().perform()
    wait_for(page, "return !document.getElementById('panel').hidden")
    row = metrics.loc[int(by_id(page, "object").get_attribute("value").removeprefix("real "))]
    pixels(page, "overlay")
    shown = shown_numbers(page)
    names = {"cdc": "CDC", "r_lambda": "r_lambda", "centroid_distance_m": "offset (m)"}
    for column, name in names.items():
        assert shown[name] == f"{row[column]:.3f}", column
    assert shown["real points"] == str(row.n_real)
    note = by_id(page, "overlay_note").text
    assert (
        f"{row.n_real:,} of {row.n_real:,} real points, {row.n_sim:,} of {row.n_sim:,} simulated points"
        in note
    )
    assert f"{row.n_keep:,} nodes a side are kept" in note
    assert (pixels(page, "scene") != picture).any(axis=2).sum() > 50, "the object is marked"


def test_tables_sort_and_filter(page, report_run):
    metrics = pd.read_parquet(report_run / "metrics")
    everything = table(page, "objects_table")
    sort_by(page, "objects_table", "CDC")
    falling = table(page, "objects_table").CDC
    assert falling[0] == f"{metrics.cdc.max():.3f}"
    assert falling[falling != NO_SCORE].astype(float).is_monotonic_decreasing
    sort_by(page, "objects_table", "CDC")
    assert table(page, "objects_table").CDC[0] == f"{metrics.cdc.min():.3f}"
    box = page.find_element("css selector", "#objects_table input")
    box.send_keys("WALL")
    found = table(page, "objects_table")
    assert 0 < len(found) < len(everything)
    assert set(found["class"]) == {"wall"}
    sort_by(page, "pairs_table", "pair")
    assert len(table(page, "pairs_table")) == len(HOSTILE_PAIRS)


@pytest.mark.exhaustive
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_window(page, width, dark):
    resize(page, width, dark)
    choose(page, "object", "real 0")
    assert page.execute_script("return document.documentElement.scrollWidth") <= width
    colour = (
        "return getComputedStyle(document.body).backgroundColor.match(/[0-9]+/g).map(Number)"
    )
    assert (sum(page.execute_script(colour)) < 200) == dark
    wait_for(
        page,
        "return [...document.querySelectorAll('.main-svg')].every((svg) => svg.clientWidth <= innerWidth)",
    )
    assert complaints(page) == []


@pytest.mark.exhaustive
def test_the_theme_can_be_chosen(page):
    before = pixels(page, "signed")
    choose(page, "theme", "dark")
    assert pixels(page, "signed").mean() < before.mean() - 100


@pytest.mark.exhaustive
def test_the_keyboard_reaches_the_objects(page):
    from selenium.webdriver import ActionChains, Keys

    page.execute_script("document.getElementById('object').focus()")
    ActionChains(page).send_keys(Keys.TAB, Keys.TAB, Keys.ENTER).perform()
    wait_for(page, "return !document.getElementById('panel').hidden")
    first = page.execute_script("return document.querySelector('#pairs_table tbody a')")
    first.send_keys(Keys.ENTER)
    settle(page)
    assert by_id(page, "pair").get_attribute("value").replace("\u202e", "\\u202e") == first.text


def test_hostile_names_are_shown_as_they_are_but_for_direction_marks(page):
    assert set(table(page, "pairs_table").pair) == {
        name.replace("\u202e", "\\u202e") for name in HOSTILE_PAIRS
    }
    assert HOSTILE_CLASS in set(table(page, "objects_table")["class"])
    for pair in HOSTILE_PAIRS:
        choose(page, "pair", pair)
    assert (
        page.execute_script("return document.querySelectorAll('img, main script').length") == 0
    )
    assert "broken <b>pair</b>" in by_id(page, "failures").text
    assert complaints(page) == []


BUTTONS_3D = [
    "Download plot as a PNG",
    "Zoom",
    "Pan",
    "Orbital rotation",
    "Reset camera to default",
]


def buttons(browser):
    """The titles of the buttons of each chart that has any, and all the addresses that charts could be uploaded to."""
    return browser.execute_script(
        "const charts = [...document.querySelectorAll('.js-plotly-plot')];"
        "const titles = (chart) => [...chart.querySelectorAll('.modebar-btn')].map(({dataset}) => dataset.title);"
        "const found = charts.map((chart) => [chart.id, titles(chart)]).filter(([, own]) => own.length);"
        "return [Object.fromEntries(found), [...new Set(charts.map((chart) => chart._context.plotlyServerURL))]]"
    )


@pytest.mark.exhaustive
def test_no_chart_of_any_page_has_a_button_that_uploads_it(browser, report_run, tmp_path):
    (tmp_path / "compare.html").write_text(
        compare_page(compare_runs([report_run, report_run])), encoding="utf-8"
    )
    open_page(browser, write_report(report_run, out=tmp_path).page)
    choose(browser, "object", "real 0")
    see_all(browser)
    assert browser.execute_script("return Boolean(document.getElementById('overlay').data)")
    assert buttons(browser) == [{"scene": BUTTONS_3D}, [""]]
    open_page(browser, tmp_path / "compare.html")
    see_all(browser)
    assert buttons(browser)[0] == {}


@pytest.mark.exhaustive
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", WIDTHS)
def test_a_comparison_draws_its_charts_in_the_theme_and_fits_the_window(
    browser, report_run, tmp_path, width, dark
):
    (comparison,) = compare_runs([report_run] * 2)
    resize(browser, width, dark)
    path = tmp_path / "compare.html"
    path.write_text(compare_page([comparison]), encoding="utf-8")
    complaints(browser), requests(browser)
    open_page(browser, path)
    see_all(browser)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert (pixels(browser, "numbers_0").mean() < 100) == dark
    assert complaints(browser) == []
    assert requests(browser) == [path.as_uri()]


@pytest.mark.exhaustive
def test_an_address_shows_its_object_also_if_it_changes_and_says_what_is_not_there(
    page, page_path
):
    def ask(ending):
        page.execute_script("location.hash = arguments[0]", ending)
        settle(page)
        return by_id(page, "asked").text

    for i, pair in enumerate(HOSTILE_PAIRS):
        assert ask(address(pair, f"real {i % 2}")) == ""
        wait_for(page, f"return document.getElementById('object').value === 'real {i % 2}'")
        assert by_id(page, "pair").get_attribute("value") == pair
        assert by_id(page, "panel").is_displayed()
    assert "This run has no scored pair nowhere." in ask(address("nowhere", "real 1"))
    assert "has no object real 999" in ask(address(FIRST_PAIR, "real 999"))
    assert ask(address(FIRST_PAIR)) == ""
    assert by_id(page, "object").get_attribute("value") == ""
    partner = page.execute_script(
        "return document.getElementById('object').options[1].textContent"
    ).split()
    assert ask(address(FIRST_PAIR, f"sim {partner[3].strip(':')}")) == "", (
        "the simulated name of a matched object"
    )
    assert by_id(page, "object").get_attribute("value") == f"real {partner[1].strip(',')}"
    page.get("about:blank")
    open_page(page, page_path, address(HOSTILE_PAIRS[2], "real 1"))
    wait_for(page, "return document.getElementById('object').value === 'real 1'")
    assert by_id(page, "pair").get_attribute("value") == HOSTILE_PAIRS[2]
    assert complaints(page) == []


@pytest.mark.exhaustive
def test_next_and_previous_move_camera_list_and_address(page):
    whole = camera_of(page)
    names = page.execute_script(
        "return [...document.getElementById('object').options].map(({value}) => value).slice(1)"
    )
    seen = []
    for name in names[:3]:
        by_id(page, "next").click()
        settle(page)
        assert by_id(page, "object").get_attribute("value") == name
        assert fragment(page) == f"#pair={FIRST_PAIR}&object={name}"

        seen.append(camera_of(page))
    assert len({str(camera) for camera in (whole, *seen)}) == 4
    by_id(page, "previous").click()
    settle(page)
    assert camera_of(page) == pytest.approx(seen[1])
    choose(page, "object", "")
    assert camera_of(page) == pytest.approx(whole)


@pytest.mark.exhaustive
def test_road_and_sensor_are_seen_and_road_can_be_left_out(page):
    assert drawn(page, "scene", "sensor").tolist() == [[0, 0, 0]]
    assert drawn(page, "scene", "forward")[1].tolist() == [4, 0, 0]
    for side in ("real", "sim"):
        road = drawn(page, "scene", f"road {side}")
        assert len(road) > 100
        assert np.median(road[:, 2]) == pytest.approx(-1.7, abs=0.02), (
            "where the road of these scenes is"
        )
        assert road[:, 2].max() < -1.2, "nothing of the objects"
    assert "road" in by_id(page, "legend").text
    with_road = pixels(page, "scene")
    turn_on(page, "show_road", False)
    assert (pixels(page, "scene") != with_road).any(axis=2).sum() > 200
    assert "road" not in by_id(page, "legend").text
    turn_on(page, "show_road")


@pytest.mark.exhaustive
def test_an_unmatched_object_says_how_much_of_it_is_road(page, report_run):
    results = read_results(report_run)
    lone = results.unmatched[results.unmatched.pair_id == FIRST_PAIR]
    for row in lone.head(3).itertuples():
        choose(page, "object", f"{row.side} {row.community_id}")
        share = row.road_share
        other = {"real": "simulated", "sim": "real"}[row.side]
        said = (
            f"{round(100 * share)} % of it is road on the {other} side"
            in by_id(page, "panel_sentence").text
        )
        assert said == (share >= 0.005)
        assert len(drawn(page, "overlay", f"own {row.side}")) == row.n_points


@pytest.mark.exhaustive
def test_the_scene_is_as_wide_as_the_page_and_the_panel_below_it(page):
    def place(name):
        return page.execute_script(
            "return document.getElementById(arguments[0]).getBoundingClientRect().toJSON()",
            name,
        )

    choose(page, "object", "real 0")
    scene, overlay, numbers = map(place, ("scene", "overlay", "panel_numbers"))
    assert scene["width"] > 1150
    assert overlay["top"] > scene["bottom"]
    assert numbers["left"] >= overlay["right"]
    assert len(shown_numbers(page)) <= 8
    resize(page, WIDTHS[1])
    settle(page)
    assert place("panel_numbers")["top"] >= place("overlay")["bottom"]


@pytest.mark.exhaustive
def test_both_scenes_turn_together(page):
    choose(page, "object", "real 0")
    pixels(page, "overlay")
    page.execute_script(
        "const camera = {eye: {x: 0, y: -2, z: 0.5}, center: {x: 0, y: 0, z: 0}, up: {x: 0, y: 0, z: 1}};"
        "return Plotly.relayout('scene', {'scene.camera': camera})"
    )
    settle(page)
    eye, center = page.execute_script(
        "const {eye, center} = document.getElementById('overlay')._fullLayout.scene._scene.getCamera();"
        "return [[eye.x, eye.y, eye.z], [center.x, center.y, center.z]]"
    )
    direction = np.subtract(eye, center) / np.linalg.norm(np.subtract(eye, center))
    assert direction == pytest.approx(np.array([0, -2, 0.5]) / np.hypot(2, 0.5), abs=1e-6)


@pytest.mark.exhaustive
@pytest.mark.parametrize("width", WIDTHS)
def test_the_box_of_a_whole_pair_is_inside_of_the_scene_with_room_for_its_labels(page, width):
    resize(page, width)
    choose(page, "object", "real 0")
    choose(page, "object", "")
    pixels(page, "scene")
    seen = page.execute_script(
        """const {scene} = document.getElementById('scene')._fullLayout;
        const {_scene: {glplot, dataScale}, xaxis, yaxis, zaxis} = scene;
        const {model, view, projection} = glplot.cameraParams;
        const apply = (m, v) => [0, 1, 2, 3].map((row) => v.reduce((sum, x, k) => sum + m[4 * k + row] * x, 0));
        return [...Array(8).keys()].map((i) => {
          const corner = [xaxis, yaxis, zaxis].map(({range}, k) => range[(i >> k) & 1] * dataScale[k]);
          const [x, y, , w] = apply(projection, apply(view, apply(model, [...corner, 1])));
          return [x / w, y / w];
        })"""
    )
    size = by_id(page, "scene").size
    room = 1 - 60 / np.array([size["width"], size["height"]])
    assert (np.abs(seen) < room).all()
    assert np.abs(seen).max() > 0.5, "not far away"


@pytest.mark.exhaustive
@pytest.mark.parametrize("width", WIDTHS)
def test_tables_hint_at_columns_on_the_right_and_keep_rows_low_and_the_first_column(
    browser, report_run, tmp_path, width
):
    resize(browser, width)
    (tmp_path / "compare.html").write_text(
        compare_page(compare_runs([report_run] * 2)), encoding="utf-8"
    )
    for path in (report_run.with_name("report") / "report.html", tmp_path / "compare.html"):
        open_page(browser, path)
        browser.execute_script(
            "for (const one of document.querySelectorAll('details')) one.open = true"
        )
        settle(browser)
        tables = browser.execute_script(
            """return [...document.querySelectorAll('.scroll')].map((hint) => {
              const box = hint.nextElementSibling;
              const rows = [...box.querySelectorAll('tbody tr:not([hidden])')].map((row) => row.offsetHeight);
              box.scrollLeft = 9999;
              const first = box.querySelector('td').getBoundingClientRect().left - box.getBoundingClientRect().left;
              return [!hint.hidden, box.scrollWidth - box.clientWidth, Math.max(...rows), first];
            })"""
        )
        assert [one for one in tables if one[0] != (one[1] > 2) or abs(one[3]) > 2] == []
        assert width == WIDTHS[0] or max(height for _, _, height, _ in tables) < 60
        assert width == WIDTHS[0] or any(hidden_px > 2 for _, hidden_px, *_ in tables)


@pytest.mark.exhaustive
def test_the_scene_is_drawn_when_a_third_of_it_is_in_view(browser, page_path):
    low = {"width": WIDTHS[0], "height": 400, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", low)
    browser.get("about:blank")
    browser.get(page_path.as_uri())
    wait_for(browser, "return document.documentElement.dataset.ready === 'yes'")
    for share, is_drawn in ((0.2, False), (0.5, True)):
        browser.execute_script(
            "const {top, height} = document.getElementById('scene').getBoundingClientRect();"
            "window.scrollBy(0, top + arguments[0] * height - window.innerHeight)",
            share,
        )
        settle(browser)
        assert browser.execute_script(f"return {IN_3D}") == is_drawn
    camera = "return document.getElementById('scene').layout.scene.camera.center"
    first = browser.execute_script(camera)
    browser.execute_script(
        "arguments[0].dispatchEvent(new Event('change'))", by_id(browser, "object")
    )
    settle(browser)
    assert browser.execute_script(camera) == pytest.approx(first), (
        "seen as when it is chosen in view"
    )


@pytest.mark.exhaustive
def test_pieces_are_a_layer_with_as_many_points_as_their_table_has(
    browser, by_reference, tmp_path
):
    resize(browser, WIDTHS[0])
    open_page(browser, write_report(by_reference, out=tmp_path).page)
    pair = by_id(browser, "pair").get_attribute("value")
    pieces = pd.read_parquet(by_reference / "pieces")
    pieces = pieces[pieces.pair_id == pair]
    for side, name in (("real", "missing"), ("sim", "invented")):
        n = pieces[pieces.side == side].n_points.sum()
        assert len(drawn(browser, "scene", name)) == n
    assert pieces.n_points.sum() > 0
    turn_on(browser, "show_missing", False)
    visible = "return document.getElementById('scene').data.find(({name}) => name === 'missing').visible"
    assert browser.execute_script(visible) is False


@pytest.mark.exhaustive
def test_a_filter_is_one_text_that_a_row_contains(page):
    box = page.find_element("css selector", "#objects_table input")
    everything = table(page, "objects_table")
    lines = everything.agg(" ".join, axis="columns").str.lower()
    for text in ("wall", HOSTILE_CLASS, everything.CDC[0], "real 1", "no such text"):
        box.clear()
        box.send_keys(text)
        assert (
            len(table(page, "objects_table"))
            == lines.str.contains(text.lower(), regex=False).sum()
        ), text
    note = page.find_element("css selector", "#objects_table .count").text
    assert note == f"0 of {len(everything)}"


@pytest.mark.exhaustive
def test_the_scores_are_seen_without_scrolling_and_hover_tells_whole_names(page):
    for name, heading in (("pairs_table", "offset"), ("objects_table", "alignment")):
        right, edge = page.execute_script(
            "const box = document.querySelector('#' + arguments[0] + ' .wide');"
            "const head = [...box.querySelectorAll('th')].find((one) => one.textContent.startsWith(arguments[1]));"
            "return [head.getBoundingClientRect().right, box.getBoundingClientRect().right]",
            name,
            heading,
        )
        assert right <= edge, name
        missing = page.execute_script(
            "const cells = [...document.querySelectorAll('#' + arguments[0] + ' :is(th, td.text)')];"
            "return cells.filter((cell) => ![cell, ...cell.children].some((one) => "
            "one.title.includes(cell.textContent))).map((cell) => cell.textContent)",
            name,
        )
        assert missing == []


@pytest.mark.exhaustive
def test_every_chart_has_a_text_alternative(page):
    charts = page.execute_script(
        "return [...document.querySelectorAll('.chart')].map((one) => [one.id, one.getAttribute('role'), "
        "one.getAttribute('aria-label') ?? document.getElementById(one.getAttribute('aria-labelledby'))?.textContent])"
    )
    assert len(charts) == 3
    for name, role, text in charts:
        assert role == "img", name
        assert text is not None, name


@pytest.mark.exhaustive
@pytest.mark.parametrize("width", WIDTHS)
def test_no_label_of_a_chart_is_cut(page, width):
    resize(page, width)
    see_all(page)
    script = """return [...document.querySelectorAll('.chart .main-svg text')].flatMap((text) => {
      const [own, all] = [text.getBoundingClientRect(), text.closest('.chart').getBoundingClientRect()];
      const isIn = own.left >= all.left - 1 && own.right <= all.right + 1 && own.bottom <= all.bottom + 1;
      return isIn || !own.width || text.closest('.hoverlayer') ? [] : [[text.closest('.chart').id, text.textContent]];
    })"""
    assert page.execute_script(script) == []


@pytest.mark.exhaustive
def test_paper_is_light_and_shows_whole_tables_and_charts(page):
    resize(page, WIDTHS[0], dark=True)
    page.execute_script(
        """window.printed = [];
    window.addEventListener('beforeprint', () => {
      const wide = [...document.querySelectorAll('.chart .main-svg')].map((svg) => svg.getBoundingClientRect().right);
      const background = getComputedStyle(document.body).backgroundColor;
      const scene = document.querySelector('#scene canvas.printed');
      const {data} = scene.getContext('2d').getImageData(0, 0, scene.width, scene.height);
      let blue = 0;
      for (let i = 0; i < data.length; i += 4) blue += data[i] < 12 && Math.abs(data[i + 1] - 114) < 12;
      window.printed.push({background, widest: Math.max(...wide), page: document.body.offsetWidth, blue});
    });"""
    )
    pdf = base64.b64decode(
        page.execute_cdp_cmd(
            "Page.printToPDF", {"preferCSSPageSize": True, "printBackground": True}
        )["data"]
    )
    (printed,) = page.execute_script("return window.printed")
    assert printed["background"] == "rgb(255, 255, 255)"
    assert printed["blue"] > 200, "the blue of real points on white, not that on black"
    assert printed["widest"] - 1 <= printed["page"] <= 1048, "A4 across, less its margins"
    sizes = {
        tuple(map(float, box.split())) for box in re.findall(rb"/MediaBox \[([\d. ]+)\]", pdf)
    }
    assert all(right > bottom for _, _, right, bottom in sizes), "all pages lie across"
    assert 4 < len(re.findall(rb"/Type /Page\b", pdf)) <= 12
    page.execute_cdp_cmd(
        "Emulation.setEmulatedMedia",
        {"media": "print", "features": [{"name": "prefers-color-scheme", "value": "light"}]},
    )
    resize_to_paper = {"width": 1047, "height": 718, "deviceScaleFactor": 1, "mobile": False}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", resize_to_paper)
    cut = page.execute_script(
        "return [...document.querySelectorAll('table')].filter((one) => one.getBoundingClientRect().right > 1048)"
        ".map((one) => one.textContent.slice(0, 80))"
    )
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert cut == []
    assert page.execute_script("return document.documentElement.dataset.printing === undefined")
    width = "const scene = document.getElementById('scene'); return [scene._fullLayout.width, scene.offsetWidth]"
    assert len(set(page.execute_script(width))) == 1, "as wide as the window again"
    assert complaints(page) == []


@pytest.mark.exhaustive
def test_the_legend_of_a_score_says_over_which_range_it_is_coloured(page):
    for score, limit in QUADRANT_LIMITS.items():
        choose(page, "colour", score)
        assert f"faithful up to {limit}" in by_id(page, "legend").text
    choose(page, "colour", "quadrant")
    assert "structure lost" in by_id(page, "legend").text
