"""Chromium for the tests of pages."""

import json
from pathlib import Path
from typing import Any, Literal

from selenium import webdriver
from selenium.webdriver.chrome.service import Service

Mode = Literal["light", "dark"]
WIDE, HIGH = 1200, 900
FLAGS = """--headless=new --no-sandbox --disable-gpu --disable-dev-shm-usage --disable-quic --no-first-run
--disable-background-networking --disable-component-update --disable-sync --hide-scrollbars"""


class Browser:
    """Chromium without a window, and what it says of the pages that it shows."""

    def __init__(self, binary: str, driver: str, profile: Path) -> None:
        options = webdriver.ChromeOptions()
        options.binary_location = binary
        for flag in (*FLAGS.split(), f"--user-data-dir={profile}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(driver))

    def show(self, path: Path, width: int = WIDE, mode: Mode = "light") -> None:
        """Open a page in a window of this width, with everything in it unfolded and drawn."""
        size = {"width": width, "height": HIGH, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        self.prefer(mode)
        self.driver.get(path.as_uri())
        self.unfold()

    def prefer(self, mode: Mode) -> None:
        """Light or dark, as a user's system says."""
        self.driver.execute_cdp_cmd(
            "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": mode}]}
        )
        self.settle()

    def unfold(self) -> None:
        """Open what is folded."""
        self.driver.execute_script("document.querySelectorAll('details').forEach(d => { d.open = true; })")
        self.settle()

    def settle(self) -> None:
        """Wait until the page has been laid out and drawn: two frames."""
        self.driver.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 0)))"
        )

    def ask(self, script: str, *arguments: Any) -> Any:
        """What a piece of JavaScript returns on the page."""
        return self.driver.execute_script(script, *arguments)

    def requests(self) -> list[str]:
        """Addresses that were asked for since the last call."""
        messages = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        sent = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
        return [address for address in sent if not address.startswith("data:")]

    def complaints(self) -> list[str]:
        """What stands on the console since the last call."""
        return [entry["message"] for entry in self.driver.get_log("browser")]
