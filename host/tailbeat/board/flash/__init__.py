"""New firmware onto the board, without losing what the board has learned."""

from tailbeat.board.flash.image import Image
from tailbeat.board.flash.procedure import FlashError, FlashPlan, FlashReport, Surroundings, flash
from tailbeat.board.restore import Restored, put_back
from tailbeat.board.snapshot import Backup

__all__ = [
    "Backup",
    "FlashError",
    "FlashPlan",
    "FlashReport",
    "Image",
    "Restored",
    "Surroundings",
    "flash",
    "put_back",
]
