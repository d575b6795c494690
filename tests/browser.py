"""Headless Chromium: what a page does when it is really opened."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

AXE = Path(os.environ.get("BIAXBAYES_AXE", ""))
needs_axe = pytest.mark.skipif(not AXE.is_file(), reason="BIAXBAYES_AXE names no axe.min.js")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or ""


def running_chromium() -> Iterator[Browser]:
    """A browser for the tests of a module, skipped where there is no Chromium."""
    if not CHROMIUM:
        pytest.skip("no Chromium here")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def opened(browser: Browser, path: Path, **context: Any) -> tuple[Page, list[str], list[str]]:
    """A file in a tab of its own, the addresses that it asks for, and its errors."""
    page = browser.new_page(**context)
    addresses: list[str] = []
    errors: list[str] = []
    page.on("request", lambda request: addresses.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("dialog", lambda dialog: errors.append(dialog.message))
    page.on("console", lambda m: errors.append(m.text) if m.type in ("error", "warning") else None)
    page.goto(path.resolve().as_uri())
    return page, addresses, errors


def audit(browser: Browser, path: Path, scheme: str) -> dict[str, Any]:
    """The passes that axe counts on a page in a colour scheme, and its violations."""
    page, _, _ = opened(browser, path, color_scheme=scheme, bypass_csp=True)
    page.add_script_tag(path=AXE)
    return page.evaluate(
        "axe.run().then(r => ({passes: r.passes.length, violations: "
        "r.violations.map(v => [v.impact, v.id, v.nodes.length, v.nodes[0].html])}))"
    )
