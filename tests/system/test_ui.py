"""The live page in a real browser against a simulated fish in a process of its own: connect, learn,
abort, pull a log; who may open it; what a load of it costs.
"""

from __future__ import annotations

import http.client
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

from tailbeat.board.fish import Fish

from .accessibility import require_accessible
from .browser import LAPTOP, PATIENCE_S, PHONE, SPEED, START, Browser, Page, browsing, page_of

NOBODY = "tcp:127.0.0.1:1"


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    with browsing(tmp_path / "downloads", watched=True) as browser:
        yield browser


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
    dropped = (
        "document.querySelector('.log').innerText.split('but not executed: press again').length"
    )
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
    _costs(browser)
    _moves_little(browser)
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


REQUESTS_MAX, BYTES_MAX = 27, 800_000


def _costs(browser: Browser) -> None:
    """Of a first load, with an empty cache: requests and bytes on the wire."""
    loaded = "performance.getEntries().filter(one => 'transferSize' in one)"
    sizes = browser.ask(f"{loaded}.map(one => [one.name, one.transferSize])")
    requests, sent = len(sizes), sum(size for _, size in sizes)
    print(f"a load: {requests} requests, {sent} bytes")
    assert 1 < requests <= REQUESTS_MAX, sizes
    assert 100_000 < sent <= BYTES_MAX, sizes


def _moves_little(browser: Browser) -> None:
    """Who wishes for less motion gets none."""
    moves = "document.querySelector('.start .q-btn__content')"
    lasts = f"parseFloat(getComputedStyle({moves}).transitionDuration)"
    assert browser.ask(lasts) > 0
    browser.colours("light", prefers_reduced_motion="reduce")
    assert browser.ask(lasts) == 0
    browser.colours("light")


def _note(browser: Browser) -> None:
    """Before there is an experiment."""
    browser.type(".note input", "water 21 degrees")
    browser.click(".add")
    browser.until("document.querySelector('.log').innerText.includes('water 21 degrees')")


# The steps are shown for a few seconds only, and a starved test looks too seldom to see them.
_COUNT_STEPS = """
    window.stepsDone = 0
    new MutationObserver(() => {
        const done = document.querySelectorAll('.steps .done').length
        window.stepsDone = Math.max(window.stepsDone, done)
    }).observe(document.body, {subtree: true, childList: true, attributes: true})
"""


def _learn(browser: Browser) -> None:
    """Three trials that are kept; the first with all that comes before a trial."""
    browser.type(".shape input", "trapezoid:0.065,6,10")
    browser.press(".use", "document.querySelector('.next').innerText.startsWith('START: trial 1')")
    assert len(browser.chart("speed-chart")) == 22
    browser.driver.execute_script(_COUNT_STEPS)
    _start(browser, "preflight")
    browser.until("window.stepsDone >= 3")
    browser.looks("preflight")
    browser.phase("deciding")
    browser.looks("deciding", partial(require_accessible, browser))
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
    path = 2  # behind the two end walls
    assert len(browser.chart("tank-chart", path, 20)) > 20  # where it has been
    browser.until("document.querySelector('.compare').innerText.includes('trial 3: largest')")
    browser.click(".params .q-item")
    browser.until("document.querySelectorAll('.param').length > 0")
    browser.type(".search input", "gain law")
    browser.until("document.querySelector('.param-name')?.innerText.startsWith('ILC_GAIN')")
    browser.press(".write-report", "document.querySelector('.open-report').checkVisibility()")
    assert "<h1" in browser.ask("fetch('/report').then(answer => answer.text())")
    browser.require_large_targets()
    browser.looks("learned", partial(require_accessible, browser))


def _begin_anew(browser: Browser) -> None:
    """With a reference so long that even a starved browser is in time to stop it; it asks first."""
    asks = "document.querySelector('.sure')?.checkVisibility() ?? false"
    browser.press(".reference .q-item", "document.querySelector('.use')?.checkVisibility()")
    browser.press(".use", asks)  # the same reference as before
    browser.press(".dialog .sure + button", f"!({asks})")
    browser.type(".shape input", "trapezoid:0.1,5,60")
    browser.press(".use", asks)
    browser.press(".sure", "document.querySelector('.reference .refusal')?.checkVisibility()")
    assert "tank has" in browser.text(".reference .refusal"), "beside what was pressed"
    browser.type(".shape input", "trapezoid:0.01,5,180")
    browser.press(".use", asks)
    browser.press(
        ".sure", "document.querySelector('.next').innerText.includes('trial 4, iteration 1')"
    )
    assert len(browser.chart("speed-chart")) == 190


def _abort(browser: Browser) -> None:
    """In the middle of the fourth, with the key of a laptop; dropped with a reason. Only a trial
    with speeds is decided on: a starved camera has none for a while."""
    _start(browser, "swimming")
    browser.until("/: ([4-9]|[0-9]{2,}) of/.test(document.querySelector('.headline').innerText)")
    browser.chart("speed-chart", 1, 3)
    browser.require_abort(*LAPTOP)
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
    browser.until("/: ([3-9]|[0-9]{2,}) of/.test(document.querySelector('.headline').innerText)")
    page.send_signal(signal.SIGINT)
    assert page.wait(PATIENCE_S) == 0
    asked_for = [line for line in page.stderr if not line.endswith("/settings.json not found\n")]
    assert asked_for == []
    browser.until("document.body.classList.contains('cut')")
    assert "ABORT may not arrive" in browser.text("#cut")
    browser.require_abort(*LAPTOP)
