"""What flashing would do, without touching a board: the image, the program, the port, the steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from tailbeat.board.flash.ports import find_port
from tailbeat.board.flash.procedure import FlashPlan, Surroundings
from tailbeat.board.flash.programs import OPENOCD, PACKAGES, Image
from tailbeat.core.errors import TailbeatError

_T = TypeVar("_T")


@dataclass
class FlashPreview:
    """``steps``: in order. ``missing``: what to mend first, with its remedy; empty = ready."""

    image: Path
    size_bytes: int
    build_id: str
    tool: str
    port: str | None = None
    steps: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def ready(self) -> bool:
        """Whether flashing could begin now."""
        return not self.missing


def preview(plan: FlashPlan, around: Surroundings | None = None) -> FlashPreview:
    """What ``flash(plan)`` would do.

    Raises
    ------
    InputError
        When the image is missing or cannot boot.
    """
    world = around or Surroundings()
    image = Image.load(plan.image)
    found = FlashPreview(plan.image, image.size_bytes, image.build_id, plan.tool)
    _try(found, lambda: world.require_program(plan.tool, PACKAGES[plan.tool]))
    if plan.tool == OPENOCD:
        _try(found, image.elf)
    if plan.tool != OPENOCD or plan.port:
        port = _try(found, lambda: find_port(plan.port, world.enumerate_ports))
        if port is not None:
            found.port = port.device
            _try(found, lambda: world.require_free(port.device))
    found.steps = list(_steps(plan, image, found.port))
    return found


def _try(found: FlashPreview, check: Callable[[], _T]) -> _T | None:
    """What ``check`` returns; None when it fails, and then its message is noted."""
    try:
        return check()
    except TailbeatError as error:
        found.missing.append(str(error))
        return None


def _steps(plan: FlashPlan, image: Image, port: str | None) -> list[str]:
    where = f"on {port}" if port else "on the board"
    write = f"erase the flash {where} and write {image.size_bytes} bytes with {plan.tool}"
    check = f"restart the board and check that it runs {image.build_id}"
    if not plan.keep:
        return [write, check]
    save = f"save parameters, reference and learned data {where}, and pull trials not yet here"
    return [save, write, check, "restore what was saved"]
