"""What can be taken home from the page: logs as they came from the board, and their beats."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from tailbeat.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.ui.conductor import Conductor


def serve_downloads(conductor: Conductor) -> None:
    """``/raw/NAME``: a log; ``/beats/NAME.csv``: its beats. Only those in the trial list."""
    from fastapi import HTTPException
    from fastapi.responses import FileResponse, Response
    from nicegui import app

    @app.get("/raw/{name}")
    def raw(name: str) -> Response:
        path = conductor.raw_file(name)
        if path is None or not path.is_file():
            raise HTTPException(404, "there is no such trial")
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    @app.get("/beats/{name}.csv")
    def beats(name: str) -> Response:
        path = conductor.raw_file(f"{name}.ulg")
        if path is None or not path.is_file():
            raise HTTPException(404, "there is no such trial")
        try:
            text = _beats_csv(path)
        except TailbeatError as error:
            raise HTTPException(422, str(error)) from error
        headers = {"content-disposition": f'attachment; filename="{name}.csv"'}
        return Response(text, media_type="text/csv", headers=headers)


def _beats_csv(path: Path) -> str:
    from tailbeat.trial_log import beats_csv, read_trial

    with TemporaryDirectory() as folder:
        out = Path(folder) / "beats.csv"
        beats_csv(read_trial(path), out)
        return out.read_text(encoding="utf-8")
