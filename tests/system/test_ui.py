"""The live page in a real browser (headless Chromium), against a simulated fish in a process of its
own: connect, learn, abort, pull a log. Waits are for conditions, each bounded.

TAILBEAT_NO_BROWSER=1 skips what needs the browser, where there is none.
"""

from __future__ import annotations

import http.client
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

from tailbeat.board.fish import Fish

START = "from tailbeat.app.cli import main; main()"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
LAPTOP, PHONE = (1366, 768), (390, 844)
PATIENCE_S = 600.0
SETTLED_S = 60.0  # what opens has opened long before, on a busy machine too
AGAIN_S = 30.0  # until somebody presses a button once more
SPEED = 10.0  # much faster, and a starved page loses the link by the board's own clock
NOBODY = "tcp:127.0.0.1:1"
FOLDER = "TAILBEAT_PICTURES"  # of the pictures, where somebody wants to look at them


@contextmanager
def page_of(address: str, root: Path, *options: str) -> Iterator[tuple[str, Any]]:
    """(URL, process) of 'tailbeat session web' on any free port; ended by Ctrl-C."""
    command = [sys.executable, "-c", START, "ui", "--connect", address, "--port", "0", "--json"]
    command += ["--root", str(root / "experiments"), *options]
    own = {"TAILBEAT_LOGBOOK": str(root / "fish"), "TAILBEAT_KEYS": str(root / "keys")}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | own
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
    """What a person does with it."""

    def __init__(self, driver: Any, downloads: Path) -> None:
        self.driver = driver
        self.downloads = downloads

    def size(self, width: int, height: int) -> None:
        phone = width < 600
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def ask(self, script: str) -> Any:
        return self.driver.execute_script(f"return {script}")

    def until(self, script: str, patience_s: float = PATIENCE_S) -> None:
        from selenium.common.exceptions import TimeoutException
        from selenium.webdriver.support.ui import WebDriverWait

        try:
            WebDriverWait(self.driver, patience_s, 0.03).until(lambda _: self.ask(script))
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
        from selenium.common.exceptions import (
            ElementClickInterceptedException,
            ElementNotInteractableException,
            StaleElementReferenceException,
        )
        from selenium.webdriver.common.by import By

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
        from selenium.webdriver.common.by import By
        from selenium.webdriver.common.keys import Keys

        field = self.driver.find_element(By.CSS_SELECTOR, selector)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(text)

    def choose(self, selector: str, value: str) -> None:
        """In a select of the browser's own."""
        from selenium.webdriver.common.by import By
        from selenium.webdriver.support.ui import Select

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

    def looks(self, name: str) -> None:
        """At both sizes; nothing may stick out to the side, and ABORT is in reach."""
        for what, (width, height) in (("phone", PHONE), ("laptop", LAPTOP)):
            self.size(width, height)
            self.until(f"window.innerWidth === {width}")
            assert self.ask("document.documentElement.scrollWidth") <= width, name
            box = self.ask("document.getElementById('abort').getBoundingClientRect().toJSON()")
            assert box["bottom"] <= height, name
            assert box["height"] >= 60, name
            if what == "phone":
                assert box["top"] > 0.6 * height  # where the thumb is
            if folder := os.environ.get(FOLDER):
                self.driver.save_screenshot(str(Path(folder) / f"{name}-{what}.png"))

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
        from selenium.webdriver.support.ui import WebDriverWait

        name = self.ask(f"document.querySelector({json.dumps(selector)}).download")
        self.click(selector)
        path = self.downloads / str(name)
        WebDriverWait(self.driver, PATIENCE_S, 0.05).until(lambda _: path.is_file())
        return path

    def complaints(self) -> list[str]:
        """Errors in the console, without those the abrupt end of a server brings."""
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def strangers(self) -> set[str]:
        """Hosts other than this computer that anything was asked of."""
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


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    program, driver = _programs()
    from selenium import webdriver

    downloads = tmp_path / "downloads"
    downloads.mkdir()
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage",
                     "--hide-scrollbars", "--disable-background-networking"):  # fmt: skip
        options.add_argument(argument)
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "SEVERE", "performance": "ALL"})
    chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield Browser(chrome, downloads)
    finally:
        chrome.quit()


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


@pytest.fixture(scope="module")
def page(simulator: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    root = tmp_path_factory.mktemp("page")
    with simulator(SPEED) as (address, fish), page_of(address, root) as (url, process):
        yield Page(address, fish, url, process, root)


Get = Callable[..., tuple[int, dict[str, str], bytes]]


def _getter(url: str) -> Get:
    where = urlsplit(url)

    def get(path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", where.port, timeout=PATIENCE_S)
        try:
            names = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, headers=names)
            answer = connection.getresponse()
            found = {name.lower(): value for name, value in answer.getheaders()}
            return answer.status, found, b"" if answer.status == 101 else answer.read()
        finally:
            connection.close()

    return get


WEBSOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
    "Sec_WebSocket_Version": "13",
}


def test_the_network_needs_the_token(tmp_path: Path) -> None:
    """Plain clients against the real server, which finds no fish."""
    with page_of(NOBODY, tmp_path, "--host", "0.0.0.0") as (url, _):
        get, port = _getter(url), urlsplit(url).port
        token = urlsplit(url).query.removeprefix("token=")
        origin = {"Origin": f"http://127.0.0.1:{port}"}
        assert len(token) >= 16
        for path in ("/", "/?token=wrong", "/raw/0001.ulg", "/favicon.ico", WEBSOCKET):
            status, _, body = get(path)
            assert (status, b"<script" in body) == (403, False), path
        assert get("/abort", "POST", **origin)[0] == 403
        assert get(WEBSOCKET, **UPGRADE, **origin)[0] == 403
        status, headers, _ = get(f"/?token={token}")
        cookie = headers["set-cookie"].partition(";")[0]
        status, headers, body = get("/", Cookie=cookie)
        assert (status, b"tailbeat" in body) == (200, True)
        assert token.encode() not in body
        assert get(WEBSOCKET, Cookie=cookie, **UPGRADE, **origin)[0] == 101
        foreign = {"Origin": "http://evil.example"}
        assert get(WEBSOCKET, Cookie=cookie, **UPGRADE, **foreign)[0] == 403
        assert get("/abort", "POST", Cookie=cookie, **foreign)[0] == 403
        assert get("/abort", "POST", Cookie=cookie, **origin)[0] == 200
        assert get("/", Cookie=cookie, Host="evil.example")[0] == 403


def test_this_computer_only(page: Page) -> None:
    get = _getter(page.url)
    assert urlsplit(page.url).hostname == "127.0.0.1"
    assert get("/")[0] == 200
    assert get("/", Host="evil.example")[0] == 403
    assert get(WEBSOCKET, **UPGRADE, Origin="http://evil.example")[0] == 403
    assert get("/raw/..%2fsettings.json")[0] == 404


def test_a_taken_port_is_told(page: Page) -> None:
    port = str(urlsplit(page.url).port)
    command = [sys.executable, "-c", START, "ui", "--connect", NOBODY, "--port", port]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "--port" in done.stderr


def _start(browser: Browser, phase: str) -> None:
    """Presses START until ``phase`` begins. A link that breaks at that moment drops the request;
    the page says so once it has connected again, and START is pressed again."""
    dropped = "document.querySelector('.log').innerText.split('but not done: ask again').length"
    ends = json.dumps([phase, "failed"])
    while True:
        before = browser.ask(dropped)
        browser.click(".start")
        reached = f"{ends}.includes(document.querySelector('.root')?.dataset.phase)"
        browser.until(f"{reached} || {dropped} > {before}")
        if browser.ask(dropped) == before:
            assert browser.ask("document.querySelector('.root').dataset.phase") != "failed"
            return


def _choose(browser: Browser, choice: str) -> None:
    """The trial is decided when this returns."""
    ends = '["idle", "failed"].includes(document.querySelector(".root")?.dataset.phase)'
    browser.press(f".choose-{choice}", ends)
    browser.phase("idle")


def _trial_and(browser: Browser, choice: str) -> None:
    _start(browser, "deciding")
    _choose(browser, choice)


def _preflight(browser: Browser, is_on: bool) -> None:
    state = "document.querySelector('.q-toggle').getAttribute('aria-checked')"
    if (browser.ask(state) == "true") is not is_on:
        browser.click(".q-toggle")
        browser.until(f"{state} === '{str(is_on).lower()}'")


def test_a_session(page: Page, browser: Browser) -> None:
    """Last of all in here: it ends the page."""
    browser.size(*LAPTOP)
    browser.driver.get(page.url)
    browser.phase("idle")
    assert "SIMULATED" in browser.text(".top")
    assert "8.2 V" in browser.text(".chip.battery")
    browser.looks("fresh")
    browser.choose(".commission", "never")
    browser.choose(".until", "1")
    _note(browser)
    _learn(browser)
    log = browser.download("a.file[download='0002.ulg']")
    _begin_anew(browser)
    _abort(browser)
    _silence(browser, page.fish)
    assert browser.complaints() == []
    assert browser.strangers() == set()
    (raw,) = (page.root / "experiments").glob("*/raw/0002.ulg")
    assert log.read_bytes() == raw.read_bytes()
    _end_in_a_trial(browser, page.process)
    with Fish.connect(page.address) as board:
        assert board.ftp.read("/trials/0002.ulg") == log.read_bytes()
        status = board.status()
        assert (status.state, status.fault.name) == ("ABORTED", "ABORT_COMMAND")
        assert status.pending_trial == status.next_trial - 1  # nothing is lost
    decided = [(e["trial"], e["decision"], e["reason"]) for e in page.journalled("decided")]
    assert sorted(decided) == [
        (1, "keep", ""), (2, "keep", ""), (3, "keep", ""), (4, "discard", "bumped the wall"),
    ]  # fmt: skip
    assert [entry["text"] for entry in page.journalled("note")] == ["water 21 degrees"]


def _note(browser: Browser) -> None:
    """Before there is an experiment."""
    browser.type(".note input", "water 21 degrees")
    browser.click(".add")
    browser.until("document.querySelector('.log').innerText.includes('water 21 degrees')")


def _learn(browser: Browser) -> None:
    """Three trials that are kept; the first with all that comes before a trial."""
    browser.type(".shape input", "trapezoid:0.065,6,10")
    browser.press(".use", "document.querySelector('.next').innerText.startsWith('START: trial 1')")
    assert len(browser.chart("speed-chart")) == 22
    _start(browser, "preflight")
    browser.until("document.querySelectorAll('.steps .done').length >= 3")
    browser.looks("preflight")
    browser.phase("deciding")
    browser.looks("deciding")
    browser.require_large_targets()
    _choose(browser, "keep")
    assert len(browser.chart("speed-chart", 1, 22)) == 22
    _preflight(browser, False)
    _trial_and(browser, "keep")
    _trial_and(browser, "keep")
    browser.until("document.querySelectorAll('.trial.keep').length === 3")
    points = browser.chart("error-chart")
    assert [x for x, _ in points] == [1, 2, 3]
    assert points[2][1] < points[0][1]  # it has learned something
    assert len(browser.chart("beat-error-chart", 0, 20)) == 22
    assert len(browser.chart("tank-chart", 0, 20)) > 20  # where it has been
    browser.until("document.querySelector('.compare').innerText.includes('trial 3: largest')")
    browser.click(".params .q-item")
    browser.until("document.querySelectorAll('.param').length > 0")
    browser.type(".search input", "gain law")
    browser.until("document.querySelector('.param-name')?.innerText.startsWith('ILC_GAIN')")
    browser.press(".write-report", "document.querySelector('.open-report').checkVisibility()")
    assert "<h1" in browser.ask("fetch('/report').then(answer => answer.text())")
    browser.require_large_targets()
    browser.looks("learned")


def _begin_anew(browser: Browser) -> None:
    """With a reference so long that even a starved browser is in time to stop it; it asks first."""
    asks = "document.querySelector('.sure')?.checkVisibility() ?? false"
    browser.press(".reference .q-item", "document.querySelector('.use')?.checkVisibility()")
    browser.press(".use", asks)  # the same reference as before
    browser.press(".dialog .sure + button", f"!({asks})")
    browser.type(".shape input", "trapezoid:0.01,5,180")
    browser.press(".use", asks)
    browser.press(
        ".sure", "document.querySelector('.next').innerText.includes('trial 4, iteration 1')"
    )
    assert len(browser.chart("speed-chart")) == 190


def _abort(browser: Browser) -> None:
    """In the middle of the fourth, with the key of a laptop; dropped with a reason."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    _start(browser, "swimming")
    browser.until("/beat ([4-9]|[0-9]{2,}) of/.test(document.querySelector('.headline').innerText)")
    ActionChains(browser.driver).send_keys(Keys.ESCAPE).perform()
    browser.phase("deciding")
    assert browser.ask("document.querySelector('.root').dataset.state") == "ABORTED"
    assert "stopped by hand" in browser.text(".deciding")
    browser.looks("aborted")
    _second_browser(browser)
    browser.type(".deciding .reason input", " ")
    browser.click(".choose-discard")
    browser.until("document.querySelector('.deciding .refusal').checkVisibility()")
    assert "needs a reason" in browser.text(".deciding .refusal")
    browser.looks("refused")
    edge = "document.querySelector('.deciding .refusal').getBoundingClientRect().bottom"
    browser.size(*PHONE)
    browser.until(f"{edge} <= document.getElementById('stop-bar').getBoundingClientRect().top")
    browser.size(*LAPTOP)
    browser.click(".reasons button")
    _choose(browser, "discard")
    browser.until("document.querySelectorAll('.trial.discard').length === 1")
    assert "bumped the wall" in browser.text(".trial.discard")
    assert browser.chart("error-chart") == []  # a new experiment, with nothing kept


def _second_browser(browser: Browser) -> None:
    """Sees the same question, and may go away."""
    first = browser.driver.current_window_handle
    url = browser.driver.current_url
    browser.driver.switch_to.new_window("window")
    browser.driver.get(url)
    browser.phase("deciding")
    browser.until("document.querySelector('.deciding')?.checkVisibility()")
    browser.driver.close()
    browser.driver.switch_to.window(first)


def _silence(browser: Browser, fish: Any) -> None:
    """A board that says nothing is not taken for one that is well."""
    fish.send_signal(signal.SIGSTOP)
    try:
        browser.until("document.querySelector('.root').classList.contains('stale')")
        assert browser.text(".chip.link").startswith("silent for ")
    finally:
        fish.send_signal(signal.SIGCONT)
    browser.until("document.querySelector('.root').classList.contains('fresh')")
    browser.phase("idle")


def _end_in_a_trial(browser: Browser, page: Any) -> None:
    """Ctrl-C while the tail beats; the page says that it hears nothing any more."""
    _start(browser, "swimming")
    browser.until("/beat ([3-9]|[0-9]{2,}) of/.test(document.querySelector('.headline').innerText)")
    page.send_signal(signal.SIGINT)
    assert page.wait(PATIENCE_S) == 0
    asked_for = [line for line in page.stderr if not line.endswith("/settings.json not found\n")]
    assert asked_for == []
    browser.until("document.body.classList.contains('cut')")
    assert "ABORT may not arrive" in browser.text("#cut")
