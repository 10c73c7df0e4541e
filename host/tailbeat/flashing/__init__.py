"""New firmware onto the board, without losing what the board has learned."""

from tailbeat.flashing.backup import Backup
from tailbeat.flashing.image import Image
from tailbeat.flashing.procedure import FlashError, FlashPlan, FlashReport, Surroundings, flash
from tailbeat.flashing.putback import Restored, put_back

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
