"""Whether people who see or hear less can use the page: axe-core's rules, and the contrast inside
charts, which these do not look at.
"""

from __future__ import annotations

from contextlib import suppress
from importlib.resources import files
from typing import Any

from selenium.common.exceptions import JavascriptException

from .browser import Browser

_AXE = files("axe_core_python").joinpath("axe.min.js")
_GRAVE = ("serious", "critical")
_RUN = """
const [source, done] = arguments;
(async () => {
if (!window.axe) {
  const script = document.createElement("script");
  script.textContent = source;
  document.head.append(script);
}
const found = await axe.run(document, {resultTypes: ["violations"]});
done(document.body.classList.contains("cut") ? null : found.violations);
})();
"""
_TRIES = 10
_CONTRAST_MIN = 4.5  # WCAG 2 AA, for small text
# Of each text in a chart against its card, as the browser draws them.
_CONTRASTS = """
const light = (colour) => {
  const parts = colour.match(/[\\d.]+/g).slice(0, 3).map((part) => {
    const v = part / 255;
    return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2];
};
return [...document.querySelectorAll(".chart text")].map((text) => {
  const ink = light(getComputedStyle(text).fill);
  const paper = light(getComputedStyle(text.closest(".card")).backgroundColor);
  const [low, high] = [Math.min(ink, paper), Math.max(ink, paper)];
  return [text.textContent, (high + 0.05) / (low + 0.05)];
});
"""


def require_accessible(browser: Browser, where: str) -> None:
    """No serious or critical finding of axe, and every text in a chart can be read."""
    found = [one for one in findings(browser) if one["impact"] in _GRAVE]
    assert found == [], f"{where}: {[(one['id'], _places(one)) for one in found]}"
    contrasts = browser.driver.execute_script(_CONTRASTS)
    assert contrasts, f"{where}: no chart has a text"
    faint = [(text, ratio) for text, ratio in contrasts if ratio < _CONTRAST_MIN]
    assert faint == [], f"{where}: too faint in a chart: {faint}"


def findings(browser: Browser) -> list[dict[str, Any]]:
    """All that axe-core finds. On a busy machine it keeps the page from hearing the laptop for so
    long that the page greys everything, or is loaded anew: then once more."""
    source = _AXE.read_text(encoding="utf-8")
    for _ in range(_TRIES):
        browser.until("document.querySelector('.root') && !document.body.matches('.cut')")
        with suppress(JavascriptException):  # loaded anew meanwhile
            found = browser.driver.execute_async_script(_RUN, source)
            if found is not None:
                return list(found)
    raise AssertionError("axe-core never saw the page in peace")


def _places(finding: dict[str, Any]) -> list[str]:
    return [node["html"][:150] for node in finding["nodes"][:5]]
