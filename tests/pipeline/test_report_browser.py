"""The report in a real browser: Debian's Chromium, headless, with WebGL in software."""

import io
import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from browsers import by_id, choose, missing_programs, open_page, resize, settle, start_browser, wait_for
from fidpipe.pipeline.report.page.compare import compare_page, history_page
from fidpipe.pipeline.report.page.page import write_report
from fidpipe.pipeline.report.results import PairTables, read_results
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.pipeline.results.history import read_history
from reports import HOSTILE_CLASS, HOSTILE_PAIRS

pytestmark = pytest.mark.slow

WIDTHS = (1280, 390)
BLUE, VERMILLION, GREY = (0, 114, 178), (213, 94, 0), (153, 153, 153)
FARTHEST = "rgb(252,166,54)"  # the end of the light ramp
FIRST_PAIR = HOSTILE_PAIRS[0]
NO_SCORE = "\N{EN DASH}"


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


@pytest.fixture(scope="module")
def run_folder(report_run, tmp_path_factory):
    return shutil.copytree(report_run, tmp_path_factory.mktemp("browser") / "run")


@pytest.fixture(scope="module")
def page_path(run_folder):
    return write_report(run_folder).page


@pytest.fixture(scope="module")
def opened(browser, page_path):
    """The page, opened once; what the browser complained of and asked for meanwhile."""
    complaints(browser), requests(browser)
    resize(browser, WIDTHS[0])
    open_page(browser, page_path)
    return complaints(browser), requests(browser)


@pytest.fixture
def page(browser, opened):
    """The page as it is opened: wide, light, the first pair, no object chosen."""
    resize(browser, WIDTHS[0])
    for name, value in (("theme", "auto"), ("pair", FIRST_PAIR), ("colour", "side"), ("object", "")):
        choose(browser, name, value)
    browser.execute_script(
        "for (const box of document.querySelectorAll('input[type=search]')) {"
        " box.value = ''; box.dispatchEvent(new Event('input')); }"
    )
    return browser


def pixels(browser, name):
    """(h, w, 3) what an element looks like."""
    place = by_id(browser, name)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", place)
    settle(browser)
    return np.asarray(Image.open(io.BytesIO(place.screenshot_as_png)).convert("RGB")).astype(int)


def near(picture, colour):
    return np.abs(picture - np.array(colour)).max(axis=2) < 12


def complaints(browser):
    return [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def requests(browser):
    """Addresses that the browser asked for, but for what lies inside the page."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"]
    return [url for url in asked if not url.startswith(("data:", "blob:"))]


def table(browser, name):
    """The texts of a table's rows as a frame."""
    script = """const table = document.querySelector('#' + arguments[0] + ' table');
    return [...table.rows].map((row) => [...row.cells].map((cell) => cell.textContent))"""
    head, *rows = browser.execute_script(script, name)
    return pd.DataFrame(rows, columns=head)


def sort_by(browser, name, title):
    for button in browser.find_elements("css selector", f"#{name} th button"):
        if button.text == title:
            browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
            return button.click()
    raise AssertionError(f"no column {title}")


def shown_numbers(browser):
    found = browser.find_elements("css selector", "#panel_numbers .value")
    return {one.get_attribute("data-key"): one.text for one in found}


def test_the_page_opens_from_disk_without_a_complaint_or_a_request(browser, opened, page_path):
    complained, asked = opened
    assert complained == []
    assert asked == [page_path.as_uri()]
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0


def test_both_sides_are_drawn_in_3d_and_the_colouring_switches(page):
    side = pixels(page, "scene")
    assert near(side, BLUE).sum() > 200
    assert near(side, VERMILLION).sum() > 200
    looks = [side]
    for by in ("community", "r_lambda", "cdc", "status"):
        choose(page, "colour", by)
        looks.append(pixels(page, "scene"))
        assert (looks[-1] != looks[-2]).any(axis=2).sum() > 200, by
    assert near(looks[-1], GREY).sum() > 200, "matched objects are grey by status"
    choose(page, "colour", "side")
    by_id(page, "show_sim").click()
    alone = pixels(page, "scene")
    by_id(page, "show_sim").click()
    assert near(alone, VERMILLION).sum() == 0
    assert near(alone, BLUE).sum() > 200


def test_a_click_on_a_point_shows_its_object_with_the_numbers_of_the_parquet(page, run_folder):
    from selenium.webdriver import ActionChains

    metrics = pd.read_parquet(run_folder / "metrics")
    metrics = metrics[metrics.pair_id == FIRST_PAIR].set_index("real_id")
    choose(page, "colour", "r_lambda")
    picture = pixels(page, "scene")
    # A spot well inside of an object that has a score: its colour is neither grey nor the background.
    coloured = np.ptp(picture, axis=2) > 80
    crowd = sum(np.roll(coloured, (down, right), (0, 1)).astype(int) for down in range(-3, 4) for right in range(-3, 4))
    crowd[:60], crowd[-60:] = 0, 0
    y, x = np.unravel_index(np.argmax(crowd), crowd.shape)
    scene = by_id(page, "scene")
    dx, dy = int(x) - scene.size["width"] // 2, int(y) - scene.size["height"] // 2
    ActionChains(page).move_to_element_with_offset(scene, dx, dy).pause(0.5).click().perform()
    wait_for(page, "return !document.getElementById('panel').hidden")
    row = metrics.loc[int(by_id(page, "object").get_attribute("value").removeprefix("real "))]
    shown = shown_numbers(page)
    for column in ("cdc", "r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m"):
        assert shown[column] == f"{row[column]:.6f}", column
    assert shown["n_keep"] == f"{row.n_keep:,}"
    assert (pixels(page, "scene") != picture).any(axis=2).sum() > 50, "the object is marked"


def test_a_chosen_object_has_its_numbers_points_and_spectra(page, run_folder):
    metrics = pd.read_parquet(run_folder / "metrics")
    for row in metrics[metrics.pair_id == FIRST_PAIR].head(2).itertuples():
        choose(page, "object", f"real {row.real_id}")
        shown = shown_numbers(page)
        assert shown["cdc"] == f"{row.cdc:.6f}"
        assert shown["r_lambda"] == f"{row.r_lambda:.6f}"
        assert f"largest shift {row.max_eigenvalue_shift:.3f}" in by_id(page, "spectrum").text
        assert f"{row.max_eigenvalue_shift:.4f} / {row.laplacian_change:.4f}" in by_id(page, "spectrum_note").text
        assert f"({row.n_keep:,} of {row.n_real:,})" in by_id(page, "object_real_note").text
    assert near(pixels(page, "object_real"), BLUE).sum() > 50
    assert near(pixels(page, "object_sim"), VERMILLION).sum() > 50


def test_tables_sort_and_filter(page, run_folder):
    metrics = pd.read_parquet(run_folder / "metrics")
    everything = table(page, "objects_table")
    sort_by(page, "objects_table", "CDC")
    falling = table(page, "objects_table").CDC
    assert falling[0] == f"{metrics.cdc.max():.3f}"
    assert falling[falling != NO_SCORE].astype(float).is_monotonic_decreasing
    sort_by(page, "objects_table", "CDC")
    assert table(page, "objects_table").CDC[0] == f"{metrics.cdc.min():.3f}"
    box = page.find_element("css selector", "#objects_table input")
    box.send_keys("wall r_lambda > 0.3")
    found = table(page, "objects_table")
    assert 0 < len(found) < len(everything)
    assert set(found["class"]) == {"wall"}
    assert (found.r_lambda.astype(float) >= 0.3).all()
    sort_by(page, "pairs_table", "pair")
    assert len(table(page, "pairs_table")) == len(HOSTILE_PAIRS)


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_window(page, width, dark):
    resize(page, width, dark)
    choose(page, "object", "real 0")
    assert page.execute_script("return document.documentElement.scrollWidth") <= width
    colour = "return getComputedStyle(document.body).backgroundColor.match(/[0-9]+/g).map(Number)"
    assert (sum(page.execute_script(colour)) < 200) == dark
    wait_for(page, "return [...document.querySelectorAll('.main-svg')].every((svg) => svg.clientWidth <= innerWidth)")
    assert complaints(page) == []


def test_each_scan_and_each_class_has_a_box_of_both_scores(page):
    for chart, n_groups in (("box_scan", len(HOSTILE_PAIRS)), ("box_class", 2)):
        assert len(page.find_elements("css selector", f"#{chart} path.box")) == 2 * n_groups
        assert [one.text for one in page.find_elements("css selector", f"#{chart} .legendtext")] == ["r_lambda", "CDC"]


def test_the_theme_can_be_chosen(page):
    before = pixels(page, "hist_cdc")
    choose(page, "theme", "dark")
    assert pixels(page, "hist_cdc").mean() < before.mean() - 100


def test_the_keyboard_reaches_the_objects(page):
    from selenium.webdriver import ActionChains, Keys

    page.execute_script("document.getElementById('object').focus()")
    ActionChains(page).send_keys(Keys.TAB, Keys.TAB, Keys.ENTER).perform()
    wait_for(page, "return !document.getElementById('panel').hidden")
    first = page.execute_script("return document.querySelector('#pairs_table tbody button')")
    first.send_keys(Keys.ENTER)
    settle(page)
    assert by_id(page, "pair").get_attribute("value") == first.text


def test_hostile_names_are_shown_as_they_are_but_for_direction_marks(page):
    assert set(table(page, "pairs_table").pair) == {name.replace("\u202e", "\\u202e") for name in HOSTILE_PAIRS}
    assert HOSTILE_CLASS in set(table(page, "objects_table")["class"])
    for pair in HOSTILE_PAIRS:
        choose(page, "pair", pair)
    assert page.execute_script("return document.querySelectorAll('img, main script').length") == 0
    assert "broken <b>pair</b>" in by_id(page, "failures").text
    assert complaints(page) == []


def test_pages_of_single_pairs_open_at_the_object_that_was_asked_for(browser, run_folder):
    index = write_report(run_folder, one_page_a_pair=True).page
    resize(browser, WIDTHS[0])
    requests(browser), complaints(browser)
    open_page(browser, index)
    links = {a.text: a.get_attribute("href") for a in browser.find_elements("css selector", "#pairs_table td a")}
    assert len(links) == len(HOSTILE_PAIRS)
    browser.get(links[FIRST_PAIR] + "#real%200")
    wait_for(browser, "return document.documentElement.dataset.ready === 'yes'")
    assert by_id(browser, "pair").get_attribute("value") == FIRST_PAIR
    assert by_id(browser, "object").get_attribute("value") == "real 0"
    assert complaints(browser) == []
    assert all(url.startswith(index.parent.as_uri()) for url in requests(browser))


def test_a_click_on_a_dot_of_a_chart_opens_its_object(page):
    names = page.execute_script("return JSON.parse(document.getElementById('report').textContent).names")
    for chart in ("quadrants", "polar"):
        point = page.execute_script(
            "const plot = document.getElementById(arguments[0]);"
            "const customdata = plot.data.findLast((trace) => trace.customdata.length).customdata.at(-1);"
            "plot.emit('plotly_click', {points: [{customdata}]}); return customdata",
            chart,
        )
        assert by_id(page, "pair").get_attribute("value") == names[point[0]]
        assert by_id(page, "object").get_attribute("value") == point[1]
    assert complaints(page) == []


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", WIDTHS)
def test_a_comparison_draws_its_chart_in_the_theme_and_fits_the_window(browser, run_folder, tmp_path, width, dark):
    path = tmp_path / "compare.html"
    path.write_text(compare_page(compare_runs([run_folder, run_folder])), encoding="utf-8")
    complaints(browser), requests(browser)
    resize(browser, width, dark)
    open_page(browser, path)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    drawn = pixels(browser, "changes_0").mean(axis=2)
    assert (drawn.mean() < 100) == dark
    assert drawn.std() > 2, "an empty chart"
    assert len(browser.find_elements("css selector", "#changes_0 .ytick")) == 12
    assert complaints(browser) == []
    assert requests(browser) == [path.as_uri()]


@pytest.mark.parametrize("width", WIDTHS)
def test_the_worst_changes_are_drawn_and_lead_into_both_reports(browser, by_reference, tmp_path, width):
    base, other = (shutil.copytree(by_reference, tmp_path / name) for name in ("base", "other"))
    for folder in (base, other):
        write_report(folder)
    (comparison,) = compare_runs([base, other])
    gone = next(one for one in comparison.objects if one.kind == "alike")
    changed = replace(comparison, objects=(replace(gone, kind="vanished", sim_after=None),))
    path = tmp_path / "compare.html"
    path.write_text(compare_page([changed], tmp_path), encoding="utf-8")
    resize(browser, width)
    open_page(browser, path)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    boxes = browser.execute_script(
        "return [...document.querySelectorAll('.panels path')].map((path) => path.getBBox().width)"
    )
    assert [width > 0 for width in boxes[1:5:3]] == [True, True], "the real object and the simulated one before"
    links = browser.find_elements("css selector", ".panels a")
    addresses = [link.get_attribute("href") for link in links]
    assert [address.partition("#")[0] for address in addresses] == [
        (folder / "report.html").as_uri() for folder in (base, other)
    ]
    links[1].click()
    wait_for(browser, "return location.pathname.endsWith('report.html')")
    wait_for(browser, "return document.documentElement.dataset.ready === 'yes'")


@pytest.mark.parametrize("width", WIDTHS)
def test_a_history_draws_a_line_for_each_score_and_fits_the_window(browser, run_folder, tmp_path, width):
    path = tmp_path / "history.html"
    path.write_text(history_page(read_history([run_folder] * 3)), encoding="utf-8")
    complaints(browser), requests(browser)
    resize(browser, width)
    open_page(browser, path)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert len(browser.find_elements("css selector", ".chart .js-line")) >= 10
    assert complaints(browser) == []
    assert requests(browser) == [path.as_uri()]


def test_points_are_coloured_by_their_distance_to_the_other_side(browser, by_reference, tmp_path):
    results = read_results(by_reference)
    pair_id = results.pairs.pair_id[0]
    resize(browser, WIDTHS[0])
    open_page(browser, write_report(by_reference, out=tmp_path).page)
    choose(browser, "colour", "distance")
    tables = PairTables(results, pair_id)
    sims = tables.clouds["sim"]
    traces = browser.execute_script(
        "return document.getElementById('scene').data.slice(0, 2).map(({text, marker}) => [text, marker.color])"
    )
    for (side, distance_m), (texts, colours) in zip(tables.distances_m.items(), traces, strict=True):
        assert len(texts) == len(colours) == len(distance_m), "few points, of which none is left out"
        for text, colour, value_m in zip(texts, colours, distance_m, strict=True):
            shown = text.rpartition("<br>")[2]
            assert shown.endswith("to the other side"), side
            is_far = value_m >= 1 - 0.5 / 255
            assert ("1 m or more" in shown) == is_far
            assert is_far or float(shown.split()[0]) == pytest.approx(value_m, abs=0.008)
            assert (colour == FARTHEST) == is_far
    assert near(pixels(browser, "scene"), (252, 166, 54)).sum() > 200
    assert "1 m or more to the nearest point of the other side" in by_id(browser, "legend").text
    browser.find_element("css selector", "#objects_table input").send_keys("missing covered_real_0p3m > 0.2")
    covered = pd.read_parquet(by_reference / "coverage").merge(
        results.unmatched[["pair_id", "side", "community_id"]], on=["pair_id", "side", "community_id"]
    )
    assert len(table(browser, "objects_table")) == (covered.covered_0p3m > 0.2).sum() == 2
    # The few simulated points of a missing object belong to it, not to any other.
    lone = {f"real {own.community_id}:" for own in tables.unmatched.itertuples() if own.side == "real"}
    few = [text for text, i in zip(traces[1][0], sims.community, strict=True) if f"real {i}:" in lone]
    assert len(few) == 3 or pair_id == "1"
    assert few
    assert all(any(text.startswith(name) for name in lone) for text in few)
    assert complaints(browser) == []
