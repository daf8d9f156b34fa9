"""Take the pictures of a report that docs/guide/report.md shows, and a PDF of it printed.

Needs Chromium and `pip install "driftcore[dev]"`.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

import driftcore as dc

HERE = Path(__file__).parent
SCENARIO = HERE.parent / "examples/container.toml"
DESKTOP, PHONE = {"width": 1000, "height": 1330}, {"width": 390, "height": 1300}
# Stop of the slider.
STOP = "3"


def opened(browser: Browser, report: Path, stop: str = STOP, **options: object) -> Page:
    """Open a report at a stop of its slider."""
    page = browser.new_context(**options).new_page()  # type: ignore[arg-type]
    page.goto(report.as_uri())
    page.wait_for_selector("html[data-ready]", state="attached")
    page.fill("#time", stop)
    page.evaluate("document.activeElement.blur()")
    page.wait_for_timeout(1000)  # charts are drawn a little later
    return page


def main() -> None:
    """Run the example, write its report, and look at it in four ways."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=HERE / "figures")
    parser.add_argument("--members", type=int, default=10_000)
    options = parser.parse_args()
    folder = options.output
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    configuration = dc.read_configuration(SCENARIO)
    ensemble = configuration.ensemble.replace(members=options.members)
    forecast = dc.run(configuration.replace(ensemble=ensemble), folder=SCENARIO.parent)
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        report = Path(scratch) / "report.html"
        dc.report.write(forecast, report)
        print(f"{report.stat().st_size / 1e6:.2f} MB for {options.members} members")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for scheme in ("light", "dark"):
            page = opened(browser, report, viewport=DESKTOP, color_scheme=scheme)
            page.screenshot(path=folder / f"report_{scheme}.png")
        phone = {"viewport": PHONE, "is_mobile": True, "has_touch": True}
        page = opened(browser, report, **phone)
        page.evaluate("document.getElementById('where').scrollIntoView()")
        page.screenshot(path=folder / "report_phone.png")
        if folder != HERE / "figures":
            opened(browser, report).pdf(path=folder / "report.pdf", prefer_css_page_size=True)
        browser.close()


if __name__ == "__main__":
    main()
