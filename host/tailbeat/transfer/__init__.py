"""What was learned along one reference, carried over to another of its shape (thesis chapter 4)."""

from tailbeat.transfer.alike import TOLERANCE, Likeness, likeness
from tailbeat.transfer.rule import scaled_input
from tailbeat.transfer.swim import Transferred, transfer

__all__ = ["TOLERANCE", "Likeness", "Transferred", "likeness", "scaled_input", "transfer"]
