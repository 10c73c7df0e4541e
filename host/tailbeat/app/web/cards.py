"""The cards on which something is chosen or looked up: reference, limit, parameters, notes, report,
event log.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from nicegui import events, ui

from tailbeat.app.web import parts
from tailbeat.app.web.parts import Live, titled, warn
from tailbeat.app.web.state import LOG_LINES, PageState
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference, from_csv, from_text
from tailbeat.link.params import Parameter
from tailbeat.session.limit import AMP_MAX

_SHAPES = ("thesis", "trapezoid", "cosine")
_CSV_BYTES_MAX = 1_000_000


def reference_of_text(text: str) -> Reference:
    """A shape by its name. Never a file of this computer: whoever looks at the page gave it."""

    words = text.strip()
    kind, _, numbers = words.partition(":")
    if kind not in _SHAPES or (not numbers and words != "thesis"):
        raise InputError(
            f"'{words}' is no reference.",
            "Write thesis, thesis:SPEED,SECONDS, trapezoid:SPEED,RAMP,HOLD or"
            " cosine:SPEED,RAMP,HOLD (m/s and s), or choose a CSV file.",
        )
    return from_text(words)


def reference_of_csv(name: str, content: bytes) -> Reference:
    """The columns t_s,v_m_s of a file that was sent."""

    with TemporaryDirectory() as folder:
        path = Path(folder) / (Path(name).name or "reference.csv")
        path.write_bytes(content)
        return from_csv(path)


class ReferenceCard:
    """Another reference: by its name or as a file."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._chosen: Reference | None = None
        self._is_known = False
        with (
            ui.element("section").classes("card reference"),
            ui.expansion("Change the reference").props(parts.UNFOLDED) as self._fold,
        ):
            ui.label(
                "The desired speed of each beat. Type thesis, or trapezoid:0.06,8,20 (0.06 m/s, 8 s"
                " up and down, 20 s between). Or choose a CSV file with the columns t_s,v_m_s."
                " Learning restarts."
            ).classes("hint")
            with ui.element("div").classes("line").style("width:100%"):
                self._text = ui.input("Shape", value="thesis").props("outlined").classes("shape")
                ui.button("Use it", on_click=self._by_text).classes("use").style("min-height:56px")
            self._file()
            live.refusal("upload")
        label = 'aria-label="Change the reference?"'
        with (
            ui.dialog().props(f"{parts.AT_ONCE} {label}") as self._sure,
            ui.card().classes("dialog"),
        ):
            self._question = ui.label().style("line-height:1.4")
            with ui.element("div").classes("choices").style("grid-template-columns:1fr 1fr"):
                ui.button("Change it", on_click=self._use).classes("sure")
                ui.button("Cancel", on_click=self._sure.close).props("outline")
        live.follow(self._found, lambda found: self._fold.set_value(not found))

    def _found(self, now: PageState) -> object:
        """What folds it: a reference, or that it is not known yet whether there is one."""
        self._is_known = self._is_known or now.phase not in ("connecting", "failed")
        return now.reference_m_s or now.run or not self._is_known

    def _file(self) -> None:
        """Chosen in the browser itself: it opens its window of files only straight from a tap."""
        upload = ui.upload(
            auto_upload=True,
            max_files=1,
            max_file_size=_CSV_BYTES_MAX,
            on_upload=self._by_file,
            on_rejected=lambda: warn("This is no CSV file below 1 MB. Choose another."),
        )
        upload.props("accept=.csv").classes("csv")
        choose = ui.button("Choose a CSV file").props("outline").classes("choose")
        choose.on("click", js_handler=f"() => getElement({upload.id}).$refs.qRef.pickFiles()")

    def _by_text(self) -> None:
        self._offer(lambda: reference_of_text(self._text.value or ""))

    async def _by_file(self, upload: events.UploadEventArguments) -> None:
        content = await upload.file.read()
        self._offer(lambda: reference_of_csv(upload.file.name, content))
        if isinstance(upload.sender, ui.upload):
            upload.sender.reset()

    def _offer(self, make: Callable[[], Reference]) -> None:
        try:
            self._chosen = make()
        except InputError as error:
            warn(str(error))
            return
        now = self._live.worker.now
        if now.iteration == 0 or not now.reference_m_s:
            self._use()
            return
        self._question.set_text(
            f"The fish has learned its present reference for {now.iteration} iterations."
            " With another one, learning restarts at iteration 1. All trials so far are kept."
        )
        self._sure.open()

    def _use(self) -> None:
        self._sure.close()
        self._live.ask("upload", reference=self._chosen)


def notes_card(live: Live) -> None:
    """A line with its time for the experiment's notes."""
    with titled("Note", "notes"):
        ui.label("For example the water temperature. It is saved with its time.").classes("hint")
        with ui.element("div").classes("line"):
            text = ui.input("Text of the note").props("outlined").classes("note")

            def add() -> None:
                if live.ask("note", text=text.value or ""):
                    text.set_value("")

            text.on("keydown.enter", add)
            ui.button("Add", on_click=add).classes("add").style("min-height:56px")


def log_card(live: Live) -> None:
    """What has happened, newest first: that is what is looked for."""
    seen = 0

    def show(log: tuple[int, tuple[str, ...]]) -> None:
        """Adds what is new, and forgets the oldest."""
        nonlocal seen
        new, seen = log[0] - seen, log[0]
        for text in log[1][-new:] if new > 0 else ():
            with lines:
                line = ui.label(text)
            line.move(lines, 0)
        for old in lines.default_slot.children[LOG_LINES:]:
            lines.remove(old)

    with titled("Event log"):
        lines = ui.element("div").classes("log")
        lines.props('tabindex=0 role=region aria-label="Events, newest first"')
    live.follow(lambda now: (now.logged, now.log), show)


def limit_card(live: Live) -> None:
    """The largest amplitude: lower at once, larger only as far as a run went."""
    with titled("Amplitude limit", "limit"):
        live.label(_limit_line, "hint")
        with ui.element("div").classes("line"):
            number = ui.input("Limit, rad").props("outlined inputmode=decimal").classes("limit-rad")
            set_ = ui.button(
                "Set", on_click=lambda: live.ask("set", name=AMP_MAX, value=number.value or "")
            )
            set_.props('outline aria-label="Set the amplitude limit"').classes("set-limit tall")
        live.refusal(AMP_MAX)


def _limit_line(now: PageState) -> str:
    if now.amplitude_max_rad is None:
        return "Not known yet."
    return (
        f"The tail beats {now.amplitude_max_rad:.2f} rad to either side at most. A larger limit is"
        " accepted only up to what this fish reached in a trial."
    )


_SHOWN_MAX = 8
_CROSS = "M6 7.4 7.4 6 12 10.6 16.6 6 18 7.4 13.4 12 18 16.6 16.6 18 12 13.4 7.4 18 6 16.6 10.6 12z"


class ParamsCard:
    """All parameters: found by any part of name or meaning, set one by one."""

    def __init__(self, live: Live) -> None:
        self._live = live
        with (
            ui.element("section").classes("card params"),
            ui.expansion("Parameters", on_value_change=self._unfold).props(parts.UNFOLDED),
        ):
            self._search = ui.input("Search name or meaning").props(
                f'outlined clearable clear-icon="{_CROSS}"'
            )
            self._search.classes("search").on_value_change(self._draw)
            self._count = ui.label().classes("hint")
            self._rows = ui.element("div").classes("param-rows")
        live.follow(lambda now: (now.params, now.failed and now.problem), lambda _: self._draw())

    def _unfold(self, change: events.ValueChangeEventArguments[bool]) -> None:
        if change.value and not self._live.worker.now.params:
            self._live.ask("params")

    def _draw(self) -> None:
        params = self._live.worker.now.params
        wanted = str(self._search.value or "").lower().split()
        found = [p for p in params if all(w in f"{p.name} {p.text}".lower() for w in wanted)]
        shown = found[:_SHOWN_MAX]
        more = f"{len(shown)} of {len(found)} shown; type to find others" if params else "..."
        self._count.set_text(more)
        self._rows.clear()
        with self._rows:
            for param in shown:
                self._row(param)

    def _row(self, param: Parameter) -> None:
        unit = f" ({param.unit})" if param.unit else ""
        with ui.element("div").classes("param"):
            ui.label(f"{param.name}{unit}").classes("param-name")
            ui.label(f"{param.text}; default {param.default:g}").classes("hint")
            with ui.element("div").classes("line"):
                value = ui.input(param.name, value=f"{param.value:.7g}").props("outlined")
                set_ = ui.button("Set").props(f'outline aria-label="Set {param.name}"')
                set_.classes("tall").on_click(
                    lambda: self._live.ask("set", name=param.name, value=value.value or "")
                )
            if (now := self._live.worker.now).failed == param.name:
                ui.label(now.problem).classes("banner problem refusal")


def report_card(live: Live) -> None:
    """The experiment's report, once it is written."""
    with titled("Report", "report"):
        ui.label("Figures and tables of all trials of this experiment.").classes("hint")
        with ui.element("div").classes("two"):
            write = ui.button("Write the report", on_click=lambda: live.ask("report"))
            write.props("outline").classes("write-report")
            with ui.element("a").classes("file open-report") as link:
                ui.label("Open the report")
            link.props('href="/report" target="_blank" rel="noopener"')
        live.refusal("report")
    live.follow(lambda now: bool(now.rows) and now.phase == "idle", write.set_enabled)
    live.follow(lambda now: now.reported, link.set_visibility)
