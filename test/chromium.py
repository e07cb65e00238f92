# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A Chromium without a screen, for the tests of pages."""

import contextlib
import shutil
from collections.abc import Iterator
from typing import Any

import pytest


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """Playwright's browser on the Chromium that is installed; skips where one of the two is not."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("no Chromium is installed")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextlib.contextmanager
def opened(browser: Any, page: str, **context: Any) -> Iterator[Any]:
    """A page of this HTML that may fetch nothing and that may report no error."""
    context.setdefault("viewport", {"width": 1100, "height": 900})
    session = browser.new_context(offline=True, **context)
    said: list[str] = []
    tab = session.new_page()
    tab.on("console", lambda message: message.type == "error" and said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    try:
        tab.set_content(page)
        tab.wait_for_function("document.readyState === 'complete'")
        yield tab
        assert said == []
    finally:
        session.close()
