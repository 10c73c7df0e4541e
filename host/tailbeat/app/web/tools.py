"""The lower part of the page: another reference, notes, what has happened."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from nicegui import events, ui

from tailbeat.app.web.status import wish
from tailbeat.app.web.view import LOG_LINES
from tailbeat.core.errors import InputError

if TYPE_CHECKING:
    from tailbeat.app.web.view import Snapshot
    from tailbeat.app.web.worker import Conductor
    from tailbeat.core.reference import Reference

_SHAPES = ("thesis", "trapezoid", "cosine")
_CSV_BYTES_MAX = 1_000_000


def reference_of_text(text: str) -> Reference:
    """A shape by its name. Never a file of this computer: whoever looks at the page gave it."""
    from tailbeat.core.reference import from_text

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
    from tailbeat.core.reference import from_csv

    with TemporaryDirectory() as folder:
        path = Path(folder) / (Path(name).name or "reference.csv")
        path.write_bytes(content)
        return from_csv(path)


class ReferenceCard:
    """The wanted speed: by its name or as a file."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor
        self._wanted: Reference | None = None
        self._is_known = False
        with (
            ui.element("section").classes("card reference"),
            ui.expansion("Another reference: the speed to swim") as self._fold,
        ):
            ui.label(
                "thesis; or trapezoid:0.06,8,20 = 0.06 m/s, 8 s up and down, 20 s between; or a CSV"
                " file with the columns t_s,v_m_s. Learning begins anew."
            ).classes("hint")
            with ui.element("div").classes("line").style("width:100%"):
                self._text = ui.input("Shape", value="thesis").props("outlined").classes("shape")
                ui.button("Use it", on_click=self._by_text).classes("use").style("min-height:56px")
            self._file()
        with ui.dialog() as self._sure, ui.card().classes("dialog"):
            self._question = ui.label().style("line-height:1.4")
            with ui.element("div").classes("choices").style("grid-template-columns:1fr 1fr"):
                ui.button("Begin anew", on_click=self._use).classes("sure")
                ui.button("Leave it", on_click=self._sure.close).props("outline")

    def refresh(self, now: Snapshot) -> None:
        """Unfolds it for a board without a reference, once it is known which this is."""
        if not self._is_known and now.phase not in ("connecting", "failed"):
            self._is_known = True
            self._fold.set_value(not now.reference_m_s)

    def _file(self) -> None:
        """Chosen in the browser itself: it opens its window of files only straight from a tap."""
        upload = ui.upload(
            auto_upload=True,
            max_files=1,
            max_file_size=_CSV_BYTES_MAX,
            on_upload=self._by_file,
            on_rejected=self._too_large,
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

    def _too_large(self) -> None:
        ui.notify("that is no CSV file of less than 1 MB", type="warning", position="top")

    def _offer(self, make: object) -> None:
        assert callable(make)
        try:
            self._wanted = make()
        except InputError as error:
            ui.notify(str(error), type="warning", position="top", multi_line=True, timeout=8000)
            return
        now = self._conductor.now
        if now.iteration == 0 or not now.reference_m_s:
            self._use()
            return
        self._question.set_text(
            f"The fish has learned for {now.iteration} iterations along its present reference."
            " With another one the board begins from nothing; the swims so far stay as they are."
        )
        self._sure.open()

    def _use(self) -> None:
        self._sure.close()
        if wish(self._conductor, "upload", reference=self._wanted):
            self._fold.set_value(False)


class NotesCard:
    """A line with its time for the experiment's notes."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor
        with ui.element("section").classes("card notes"):
            ui.label("Note").classes("title")
            ui.label("Water temperature, who helped, what was odd: kept with its time.").classes(
                "hint"
            )
            with ui.element("div").classes("line"):
                self._text = ui.input("What to remember").props("outlined").classes("note")
                self._text.on("keydown.enter", self._add)
                ui.button("Add", on_click=self._add).classes("add").style("min-height:56px")

    def _add(self) -> None:
        if wish(self._conductor, "note", text=self._text.value or ""):
            self._text.set_value("")


class LogCard:
    """What has happened, newest first: that is what is looked for."""

    def __init__(self) -> None:
        self._seen = 0
        with ui.element("section").classes("card"):
            ui.label("What happened").classes("title")
            self._lines = ui.element("div").classes("log")

    def refresh(self, now: Snapshot) -> None:
        """Adds what is new, and forgets the oldest."""
        new = now.logged - self._seen
        self._seen = now.logged
        for text in now.log[-new:] if new > 0 else ():
            with self._lines:
                line = ui.label(text)
            line.move(self._lines, 0)
        for old in self._lines.default_slot.children[LOG_LINES:]:
            self._lines.remove(old)
