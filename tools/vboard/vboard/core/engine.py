"""Unicorn's engine. The package has no types for its calls; this is the one place that says so."""

from __future__ import annotations

from typing import Any

from unicorn.unicorn_py3 import unicorn as _binding

library: Any = _binding.uclib
Uc: Any = _binding.Uc
UcError: Any = _binding.UcError
InvalidInstructionHook: Any = _binding.HOOK_INSN_INVALID_CFUNC
InterruptHook: Any = _binding.HOOK_INTR_CFUNC
InvalidMemoryHook: Any = _binding.HOOK_MEM_INVALID_CFUNC
IoRead: Any = _binding.MMIO_READ_CFUNC
IoWrite: Any = _binding.MMIO_WRITE_CFUNC
