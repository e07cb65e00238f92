# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report in a browser: an estimate with gaps, and two of which one jumps."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import chromium, opened

import trajeval_ros as te
from trajeval_ros.commands.simulation import simulate
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.parameters import complete
from trajeval_ros.report import Report
from trajeval_ros.report.page import page_of_several

AXE = "TRAJEVAL_AXE"
"""Names the file axe.min.js of axe-core (npm pack axe-core), which is under another licence."""
KINDS = ("translation", "rotation", "translation-axes", "rotation-axes", "height", "rates")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as program:
        yield program


@pytest.fixture(scope="module")
def results(browser: Any) -> te.Results:
    """Of a run with dropouts; the second estimate jumps by 0.4 m."""
    run = simulate(40.0, seed=3)
    jumped = run.estimate.poses.copy()
    jumped[400:, :3, 3] += [0.4, 0.0, 0.0]
    return te.evaluate(
        te.Trajectory(run.ground_truth.stamps, run.ground_truth.poses),
        {
            "smooth": te.Trajectory(run.estimate.stamps, run.estimate.poses),
            "jumped": te.Trajectory(run.estimate.stamps, jumped),
        },
    )


@pytest.fixture(scope="module")
def pages(results: te.Results, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The pages of one, of the other, and of both."""
    folder = tmp_path_factory.mktemp("pages")
    written = {
        "smooth": results["smooth"].report(folder / "smooth.html"),
        "jumped": results["jumped"].report(folder / "jumped.html"),
        "both": results.report(folder / "both.html"),
    }
    return {name: path.read_text(encoding="utf-8") for name, path in written.items()}


@pytest.mark.parametrize("which", ["jumped", "both"])
def test_every_figure_is_drawn(browser: Any, pages: dict[str, str], which: str) -> None:
    with opened(browser, pages[which]) as tab:
        assert tab.evaluate("document.documentElement.className") == "drawn"
        assert tab.locator(".map canvas").count() == 6
        for kind in (*KINDS, "likelihood", "likelihood-window", "chi2", "clock"):
            box = tab.locator(f"#{kind} .over").bounding_box()
            assert box is not None, kind
            assert box["width"] > 800, kind
            assert box["height"] > 60, kind
        assert "could not be drawn" not in tab.inner_text("main")
        lines = tab.evaluate("board.figures.map((f) => f.drawn ? f.drawn.length : 1)")
        assert all(lines)


def still() -> te.Result:
    """A body that stands, and an estimate without any error."""
    poses = np.tile(np.eye(4), (400, 1, 1))
    stamps = np.arange(400) * 0.05
    return te.evaluate(te.Trajectory(stamps, poses), te.Trajectory(stamps, poses))


def test_a_run_without_motion_or_error_is_drawn(browser: Any, tmp_path: Path) -> None:
    page = still().report(tmp_path / "page.html").read_text(encoding="utf-8")
    with opened(browser, page) as tab:
        assert tab.evaluate("document.documentElement.className") == "drawn"
        tab.evaluate("board.setCursor(7); board.zoom(0.5)")
        tab.evaluate("dispatchEvent(new Event('beforeprint'))")
        drawn = tab.evaluate("[...document.querySelectorAll('.printed')].map((e) => e.innerHTML)")
        assert all("<svg" in each for each in drawn)
        assert "NaN" not in "".join(drawn)


def test_of_two_one_may_have_no_pose(browser: Any) -> None:
    dead = Report(complete({}), {}).run(Engine({}).summary())
    alive = still()
    page = page_of_several({"dead": dead, "alive": alive._record.run(alive.summary)}, ["x"], print)
    with opened(browser, page) as tab:
        assert tab.evaluate("document.documentElement.className") == "drawn"
        assert "No estimate has been evaluated." in tab.inner_text("main")
        assert tab.get_by_role("checkbox").count() == 1


def test_hover_brush_and_moments_are_linked(browser: Any, pages: dict[str, str]) -> None:
    with opened(browser, pages["jumped"]) as tab:
        over = tab.locator("#translation .over")
        over.scroll_into_view_if_needed()
        box = over.bounding_box()
        middle = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
        tab.mouse.move(*middle)
        assert tab.evaluate("board.cursor") == pytest.approx(20.0, abs=0.2)
        said = tab.locator("#rotation .legend b").first.inner_text()
        assert said.endswith("°")
        assert "m along the ground truth" in tab.locator("#controls output").inner_text()
        tab.mouse.down()
        tab.mouse.move(middle[0] + 0.25 * box["width"], middle[1], steps=4)
        tab.mouse.up()
        assert tab.evaluate("board.range") == pytest.approx([20.0, 30.0], abs=0.3)
        tab.mouse.dblclick(*middle)
        assert not tab.evaluate("board.isZoomed")
        # The jump is named, and gone to.
        jump = tab.locator("#controls button.jump").first
        jump.click()
        data = "JSON.parse(document.getElementById('data').textContent)"
        stamps = tab.evaluate(
            f"{data}.moments.filter((m) => m.kind === 'jump').map((m) => m.begin)"
        )
        assert tab.evaluate("board.cursor") == pytest.approx(stamps[0], abs=1e-3)
        assert min(abs(stamp - 20.0) for stamp in stamps) < 0.5
        assert tab.evaluate("board.isZoomed")


def test_the_worst_moment_is_the_one_that_the_answer_names(
    browser: Any, pages: dict[str, str], results: te.Results
) -> None:
    worst = results["smooth"].summary["headline"]["worst"]
    with opened(browser, pages["smooth"]) as tab:
        tab.get_by_role("button", name="worst").click()
        value, unit = tab.locator("#translation .legend b").first.inner_text().split()
        assert unit == "m"
        assert float(value) == pytest.approx(worst["translation"], rel=0.01)
        start = int(tab.evaluate("JSON.parse(document.getElementById('data').textContent).start"))
        assert tab.evaluate("board.cursor") == pytest.approx(
            (worst["stamp"] - start) * 1e-9, abs=1e-3
        )


def test_aligned_and_raw(browser: Any, pages: dict[str, str], results: te.Results) -> None:
    with opened(browser, pages["smooth"]) as tab:
        errors = "[...board.figures.find((f) => f.host.id === 'translation').u.data[1]]"
        aligned = max(e for e in tab.evaluate(errors) if e is not None)
        tab.get_by_role("button", name="Poses: raw").click()
        raw = max(e for e in tab.evaluate(errors) if e is not None)
        # Its world is another one.
        assert raw > 3.0 * aligned
        turned = tab.evaluate(errors.replace("'translation'", "'rotation'"))
        assert max(e for e in turned if e is not None) > 10.0


def test_one_of_two_is_switched_off(browser: Any, pages: dict[str, str]) -> None:
    with opened(browser, pages["both"]) as tab:
        count = "board.figures.find((f) => f.host.id === 'translation').u.series.length"
        assert tab.evaluate(count) == 3
        tab.get_by_role("checkbox", name="jumped").uncheck()
        assert tab.evaluate(count) == 2
        assert "smooth" in tab.locator("#translation .legend").inner_text()


def test_a_telephone_shows_all_without_moving_sideways(browser: Any, pages: dict[str, str]) -> None:
    with opened(browser, pages["both"], viewport={"width": 400, "height": 800}) as tab:
        assert tab.evaluate("document.documentElement.scrollWidth") <= 400
        assert tab.locator("#top .plot").bounding_box()["width"] > 340
        assert tab.locator("#translation .plot").bounding_box()["width"] > 340


def test_on_paper_all_is_vectors_and_unfolded(browser: Any, pages: dict[str, str]) -> None:
    with opened(browser, pages["jumped"], color_scheme="dark") as tab:
        document = tab.pdf(format="A4")
        assert document.startswith(b"%PDF")
        assert b"/Subtype /Image" not in document
        assert 40_000 < len(document) < 1_500_000
        tab.emulate_media(media="print", color_scheme="dark")
        tab.evaluate("dispatchEvent(new Event('beforeprint'))")
        assert tab.locator(".printed svg").count() == tab.evaluate("board.figures.length")
        assert tab.locator("details:not([open])").count() == 0
        # Ink on paper, however dark the screen is.
        assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == (
            "rgb(255, 255, 255)"
        )


def test_without_a_script_there_are_the_words_and_tables(
    browser: Any, pages: dict[str, str]
) -> None:
    with opened(browser, pages["smooth"], java_script_enabled=False) as tab:
        assert "drawn by this page's script, which does not run here" in tab.inner_text("main")
        assert "ATE" in tab.inner_text("main")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_serious_fault(browser: Any, pages: dict[str, str], scheme: str) -> None:
    path = os.environ.get(AXE, "")
    if not path:
        pytest.skip(f"{AXE} does not name axe-core's axe.min.js")
    with opened(browser, pages["both"], color_scheme=scheme) as tab:
        tab.evaluate(Path(path).read_text(encoding="utf-8"))
        found = tab.evaluate("axe.run()")["violations"]
        serious = [each for each in found if each["impact"] in ("serious", "critical")]
        assert [(each["id"], each["nodes"][0]["html"]) for each in serious] == []
