// What must work even when the rest of the page does not: the ABORT button, its keys, and the
// warning that this page no longer hears from the laptop.
(() => {
  const CUT_MS = 4000;
  const TRIES = 6;
  const TRY_MS = 1500;
  const PAUSE_MS = 100;
  const body = document.body;
  let heardMs = Date.now();

  async function post() {
    const answer = await fetch("/abort", {
      method: "POST", cache: "no-store", signal: AbortSignal.timeout(TRY_MS),
    });
    if (!answer.ok) throw new Error(answer.status);
  }

  async function abort() {
    body.classList.add("asked");
    navigator.vibrate?.(60);
    for (let tries = 0; tries < TRIES; tries++) {
      try {
        await post();
        body.classList.remove("unheard");
        setTimeout(() => body.classList.remove("asked"), 700);
        return;
      } catch {
        await new Promise((done) => setTimeout(done, PAUSE_MS)); // then said again
      }
    }
    body.classList.remove("asked");
    body.classList.add("unheard");
  }

  const button = document.getElementById("abort");
  button.addEventListener("pointerdown", abort); // a wet finger that slips still counts
  button.addEventListener("click", (event) => { if (event.detail === 0) abort(); }); // Enter

  function isTyping(target) {
    return target.isContentEditable || ["INPUT", "TEXTAREA"].includes(target.tagName);
  }

  function stops(event) {
    if (!document.querySelector(".moving")) return false;
    return event.key === "Escape" || (event.key === " " && !isTyping(event.target));
  }

  addEventListener("keydown", (event) => {
    if (!stops(event)) return;
    event.preventDefault();
    event.stopPropagation();
    if (!event.repeat) abort();
  }, true);
  addEventListener("keyup", (event) => { // else Space would press the button that has the focus
    if (stops(event)) { event.preventDefault(); event.stopPropagation(); }
  }, true);

  function heard() { heardMs = Date.now(); body.classList.remove("cut", "unheard"); }

  function watch() {
    const tick = document.querySelector(".tick");
    if (!tick) { setTimeout(watch, 100); return; }
    heard();
    new MutationObserver(heard).observe(tick, { childList: true, characterData: true, subtree: true });
    const log = document.querySelector(".log"); // the newest line is above, and stays in sight
    const first = () => { if (!log.matches(":hover")) log.scrollTop = 0; };
    new MutationObserver(first).observe(log, { childList: true });
    setInterval(() => body.classList.toggle("cut", Date.now() - heardMs > CUT_MS), 500);
  }
  watch();

  setInterval(() => { // what the camera sees, while anybody can see it
    for (const picture of document.querySelectorAll("img.camera")) {
      if (picture.checkVisibility() && !document.hidden) picture.src = `/camera.jpg?${Date.now()}`;
    }
  }, 1000);
})();
