"""The live page in a real browser (headless Chromium), used by mouse or by touch.
Waits are for conditions, each bounded.

TAILBEAT_NO_BROWSER=1 skips what needs the browser, where there is none.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from selenium import webdriver
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    StaleElementReferenceException,
    TimeoutException,
)
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

START = "from tailbeat.app.cli import main; main()"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
LAPTOP, PHONE = (1366, 768), (390, 844)
PATIENCE_S = 600.0
LOOK_S = 0.1  # from one look at the page to the next; each makes it lay out its text
SETTLED_S = 60.0  # what opens has opened long before, on a busy machine too
AGAIN_S = 30.0  # until somebody presses a button once more
SPEED = 10.0  # much faster, and a starved page loses the link by the board's own clock
FOLDER = "TAILBEAT_PICTURES"  # of the pictures, where somebody wants to look at them


@contextmanager
def page_of(address: str, root: Path, *options: str) -> Iterator[tuple[str, Any]]:
    """(URL, process) of 'tailbeat session web' on any free port; ended by Ctrl-C."""
    command = [sys.executable, "-c", START, "ui", "--connect", address, "--port", "0", "--json"]
    command += ["--root", str(root / "experiments"), *options]
    own = {"TAILBEAT_LOGBOOK": str(root / "fish"), "TAILBEAT_KEYS": str(root / "keys")}
    # NiceGUI compresses nothing where it finds pytest.
    others = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=others | own
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, process.stderr and process.stderr.read()
            yield json.loads(line)["urls"][0], process
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(PATIENCE_S)
            finally:
                process.kill()


class Browser:
    """What a person does with it, by mouse and keyboard."""

    def __init__(self, driver: Any, downloads: Path) -> None:
        self.driver = driver
        self.downloads = downloads

    def size(self, width: int, height: int) -> None:
        phone = width < 600
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone}
        self.command("Emulation.setDeviceMetricsOverride", **metrics)

    def colours(self, scheme: str, **media: str) -> None:
        """``light`` or ``dark``; ``media``: other wishes, like prefers_reduced_motion."""
        wishes = {"prefers-color-scheme": scheme}
        wishes |= {name.replace("_", "-"): value for name, value in media.items()}
        features = [{"name": name, "value": value} for name, value in wishes.items()]
        self.command("Emulation.setEmulatedMedia", features=features)
        dark = json.dumps(scheme == "dark")
        self.until(f"document.body.classList.contains('body--dark') === {dark}")
        running = "document.getAnimations().filter(one => one.playState === 'running')"
        self.until(f"{running}.length === 0", SETTLED_S)  # a colour that fades is neither

    def command(self, name: str, **values: Any) -> Any:
        """Of the browser's own protocol."""
        return self.driver.execute_cdp_cmd(name, values)

    def ask(self, script: str) -> Any:
        return self.driver.execute_script(f"return {script}")

    def until(self, script: str, patience_s: float = PATIENCE_S) -> None:
        try:
            WebDriverWait(self.driver, patience_s, LOOK_S).until(lambda _: self.ask(script))
        except TimeoutException:
            shown = self.ask("document.body.innerText")
            raise AssertionError(f"never: {script}\nthe page shows:\n{shown}") from None

    def phase(self, *phases: str) -> str:
        """The first of these that is reached; fails at once when the worker has failed."""
        ends = json.dumps([*phases, "failed"])
        self.until(f"{ends}.includes(document.querySelector('.root')?.dataset.phase)")
        reached = str(self.ask("document.querySelector('.root').dataset.phase"))
        if reached == "failed" and "failed" not in phases:
            shown = self.ask("document.body.innerText")
            raise AssertionError(f"failed before {phases}\nthe page shows:\n{shown}")
        return reached

    def click(self, selector: str) -> None:
        """As soon as it can be: what unfolds or opens moves for a moment."""
        moving = (
            ElementClickInterceptedException,
            ElementNotInteractableException,
            StaleElementReferenceException,
        )
        found = f"document.querySelector({json.dumps(selector)})"
        for _ in range(100):
            self.until(f"{found}?.checkVisibility() && !{found}.disabled")
            self.ask(f"{found}?.scrollIntoView({{block: 'nearest'}})")
            try:
                self.driver.find_element(By.CSS_SELECTOR, selector).click()
                return
            except moving as error:
                last = error
            self.until("new Promise(done => requestAnimationFrame(() => done(true)))")
        raise last

    def press(self, selector: str, then: str) -> None:
        """Clicks until ``then`` holds. What is pressed while the page's connection to the laptop is
        being made anew is lost, and a person presses again."""
        for patience_s in (AGAIN_S, AGAIN_S, PATIENCE_S):
            self.click(selector)
            try:
                self.until(then, patience_s)
                return
            except AssertionError:
                if patience_s == PATIENCE_S:
                    raise

    def type(self, selector: str, text: str) -> None:
        field = self.driver.find_element(By.CSS_SELECTOR, selector)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(text)

    def choose(self, selector: str, value: str) -> None:
        """In a select of the browser's own."""

        Select(self.driver.find_element(By.CSS_SELECTOR, f"{selector} select")).select_by_value(
            value
        )

    def text(self, selector: str) -> str:
        return str(self.ask(f"document.querySelector({json.dumps(selector)}).innerText"))

    def chart(self, name: str, series: int = 0, length: int = 0) -> list[Any]:
        """The data that a chart has drawn; ``length``: once so many of them are there."""
        element = f"document.querySelector('.{name}')"
        option = f"getElement(+{element}.id.slice(1)).chart.getOption()"
        data = f"{option}.series[{series}].data"
        self.until(f"{data}.filter(v => v !== null).length >= {length}", 20.0)
        return list(self.ask(data))

    def looks(self, name: str, judge: Callable[[str], None] | None = None) -> None:
        """At both sizes nothing may stick out to the side, and ABORT is in reach with nothing over
        it. ``judge`` sees both in the dark and in the light."""
        for what, (width, height) in (("phone", PHONE), ("laptop", LAPTOP)):
            self.size(width, height)
            self.until(f"window.innerWidth === {width}")
            assert self.ask("document.documentElement.scrollWidth") <= width, name
            self.require_abort(width, height)
            folder = os.environ.get(FOLDER)
            for scheme in ("dark", "light") if judge is not None or folder else ():
                self.colours(scheme)
                if judge is not None:
                    judge(f"{name}, {what}, {scheme}")
                if folder:
                    self.driver.save_screenshot(str(Path(folder) / f"{name}-{what}-{scheme}.png"))

    def require_abort(self, width: int, height: int) -> None:
        """In sight, large, under the thumb of a phone, and nothing covers it."""
        box = self.ask("document.getElementById('abort').getBoundingClientRect().toJSON()")
        assert box["bottom"] <= height and box["height"] >= 60
        assert width >= 600 or box["top"] > 0.6 * height
        for across, down in ((0.5, 0.5), (0.05, 0.1), (0.95, 0.9)):
            x, y = box["left"] + across * box["width"], box["top"] + down * box["height"]
            hit = self.ask(f"document.elementFromPoint({x}, {y})?.closest('#abort') !== null")
            assert hit, f"something lies over ABORT at {x:.0f}, {y:.0f}"

    def require_large_targets(self) -> None:
        """Whatever is to be touched is 44 px high and wide, once what opens has opened."""
        small = (
            "[...document.querySelectorAll('button, a, .q-toggle, .q-field, .q-item')]"
            ".filter(e => e.checkVisibility())"
            ".filter(e => e.getBoundingClientRect().height < 44"
            " || e.getBoundingClientRect().width < 44).map(e => e.outerHTML.slice(0, 120))"
        )
        try:
            self.until(f"{small}.length === 0", SETTLED_S)
        except AssertionError:
            left = self.ask(small)
            assert left == [], f"too small to touch: {left}"

    def download(self, selector: str) -> Path:
        name = self.ask(f"document.querySelector({json.dumps(selector)}).download")
        self.click(selector)
        path = self.downloads / str(name)
        WebDriverWait(self.driver, PATIENCE_S, LOOK_S).until(lambda _: path.is_file())
        return path

    def complaints(self) -> list[str]:
        """Errors in the console, without those the abrupt end of a server brings."""
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def strangers(self) -> set[str]:
        """Hosts other than this computer that a watched browser asked anything of."""
        hosts = set()
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                url = urlsplit(message["params"]["request"]["url"])
                hosts.add(url.hostname if url.scheme in ("http", "https", "ws") else None)
            elif message["method"] == "Network.webSocketCreated":
                hosts.add(urlsplit(message["params"]["url"]).hostname)
        assert "127.0.0.1" in hosts
        return {str(host) for host in hosts - {"127.0.0.1", None}}


class Touched(Browser):
    """By finger: touch events, which the browser makes a tap of."""

    def __init__(self, driver: Any, downloads: Path) -> None:
        super().__init__(driver, downloads)
        self.command("Emulation.setTouchEmulationEnabled", enabled=True)

    def click(self, selector: str) -> None:
        """Where nothing lies over it and the browser does not move it any more."""
        found = f"document.querySelector({json.dumps(selector)})"
        self.until(f"{found}?.checkVisibility() && !{found}.disabled")
        self.ask(f"{found}.scrollIntoView({{block: 'nearest'}})")
        self.until(f"(() => {{ {_MIDDLE} return middle({found}) !== null; }})()", SETTLED_S)
        x, y = self.ask(f"(() => {{ {_MIDDLE} return middle({found}); }})()")
        self.command("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        self.command("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def type(self, selector: str, text: str) -> None:
        """With the phone's keyboard, which comes up with a tap."""
        self.click(selector)
        self.until(f"document.activeElement === document.querySelector({json.dumps(selector)})")
        self.command("Input.insertText", text=text)


# Where a finger meets it; null = elsewhere, or under something.
_MIDDLE = """
const middle = (element) => {
  const box = element.getBoundingClientRect();
  const [x, y] = [box.left + box.width / 2, box.top + box.height / 2];
  return element.contains(document.elementFromPoint(x, y)) ? [x, y] : null;
};"""


def _programs() -> tuple[str, str]:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which("chromedriver")
    if browser is None or driver is None:
        if os.environ.get("TAILBEAT_NO_BROWSER") == "1":
            pytest.skip("no chromium here, and TAILBEAT_NO_BROWSER=1")
        pytest.fail(
            "the page is tested in a real browser, and chromium or chromedriver is missing: run"
            " tools/bootstrap test, or set TAILBEAT_NO_BROWSER=1 to go without"
        )
    return browser, driver


@dataclass(frozen=True)
class Page:
    """'tailbeat session web' of a simulated fish. ``fish``, ``process``: of the two."""

    address: str
    fish: Any
    url: str
    process: Any
    root: Path

    def journalled(self, what: str) -> list[dict[str, Any]]:
        """Of all experiments."""
        journals = sorted((self.root / "experiments").glob("*/journal.jsonl"))
        entries = [json.loads(line) for j in journals for line in j.read_text().splitlines()]
        return [entry for entry in entries if entry["what"] == what]


@contextmanager
def browsing(
    downloads: Path, kind: type[Browser] = Browser, *, watched: bool = False
) -> Iterator[Browser]:
    """One that begins with an empty cache; ended after. ``watched``: for ``strangers``; to note
    down what goes over the network takes a fifth of the processor time."""
    program, driver = _programs()
    downloads.mkdir()
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage",
                     "--hide-scrollbars", "--disable-background-networking"):  # fmt: skip
        options.add_argument(argument)
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    watching = {"performance": "ALL"} if watched else {}
    options.set_capability("goog:loggingPrefs", {"browser": "SEVERE", **watching})
    chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    chrome.set_script_timeout(PATIENCE_S)
    try:
        yield kind(chrome, downloads)
    finally:
        chrome.quit()
