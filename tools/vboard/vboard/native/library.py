"""The native library, and the structures that it shares with Python.

Mirrors tools/vboard/native/{clock,line,engine,state,chip}.h by name and order; sizes are compared
when the library is loaded.
"""

from __future__ import annotations

import ctypes
from ctypes import (
    CFUNCTYPE,
    POINTER,
    c_bool,
    c_char,
    c_char_p,
    c_double,
    c_int,
    c_int32,
    c_int64,
    c_uint32,
    c_uint64,
    c_void_p,
)
from pathlib import Path
from typing import Any

NEVER = (1 << 63) - 1
MESSAGE_BYTES = 256
OK, VIOLATION, LOCKUP, PYTHON = range(4)
DONE, UNKNOWN = range(2)
RUN_DONE, RUN_STOPPED, RUN_FAILED = range(3)
CHUNK_BYTES_MAX = 2 * 0xFFFF + 2

Call = CFUNCTYPE(None)
Ask = CFUNCTYPE(c_int)


class ClockFields(ctypes.Structure):
    """vb_clock_t, as far as it is shared."""

    _fields_ = [
        ("now", c_int64),
        ("number", c_uint64),
        ("foreign_due", c_int64),
        ("foreign_number", c_uint64),
        ("steady_at", c_int64),
        ("steady_value", c_int64),
        ("failure", c_int64),
        ("message", c_char * MESSAGE_BYTES),
    ]


class Run(ctypes.Structure):
    """vb_run_t."""

    _fields_ = [
        ("start", c_int64),
        ("baud", c_int64),
        ("data", c_char_p),
        ("bad", c_char_p),
        ("length", c_int64),
        ("taken", c_int64),
    ]


class ChunkFields(ctypes.Structure):
    """vb_chunk_t."""

    _fields_ = [("first", c_int64), ("char_ticks", c_int64), ("length", c_int64)]


class LineFields(ctypes.Structure):
    """vb_line_t."""

    _fields_ = [
        ("connected", c_int64),
        ("head", c_int64),
        ("count", c_int64),
        ("capacity", c_int64),
        ("done", c_int64),
        ("runs", POINTER(Run)),
        ("chunk_count", c_int64),
        ("chunk_capacity", c_int64),
        ("byte_count", c_int64),
        ("byte_capacity", c_int64),
        ("chunks", POINTER(ChunkFields)),
        ("bytes", c_void_p),
        ("drain", Call),
        ("cut_to_chip", c_int64),
        ("receiver_off", c_int64),
        ("overrun", c_int64),
        ("garbled_to_chip", c_int64),
        ("in_flight_at_reset", c_int64),
    ]


class Engine(ctypes.Structure):
    """vb_engine_t."""

    _fields_ = [
        *((name, c_void_p) for name in ("emu_start", "emu_stop", "reg_read", "reg_write")),
        *((name, c_void_p) for name in ("reg_read_batch", "reg_write_batch")),
        *((name, c_void_p) for name in ("handle", "begun", "wanted")),
        ("entry", c_int32 * 9),
        ("masks", c_int32 * 3),
        *((name, c_int32) for name in ("pc", "msp", "psp", "apsr")),
        *((name, c_int32) for name in ("ok", "read_unmapped", "write_unmapped", "fetch_unmapped")),
        *((name, c_int32) for name in ("read_prot", "write_prot", "fetch_prot", "insn_invalid")),
        *((name, c_int32) for name in ("exception", "mem_read_prot", "mem_write_prot")),
        ("mem_fetch", c_int32),
        *((name, c_uint32) for name in ("prot_all", "prot_exec")),
    ]


class State(ctypes.Structure):
    """vb_state_t."""

    _fields_ = [
        *((name, c_uint64) for name in ("pending", "active", "enabled", "lines")),
        *((name, c_int64) for name in ("group_mask", "vector_table", "ccr", "sleep_on_exit")),
        *((name, c_int64) for name in ("debug_monitor", "cfsr", "hfsr", "mmfar", "bfar")),
        *((name, c_int64) for name in ("attention", "exit_to_sleep", "taken")),
        ("priority", c_int64 * 61),
        ("mpu_control", c_int64),
        ("mpu_base", c_int64 * 8),
        ("mpu_attributes", c_int64 * 8),
        *((name, c_int64) for name in ("pc", "thumb", "executed", "address_of_fault")),
        *((name, c_int64) for name in ("off", "sleeping", "deferred", "reset_cause")),
        *((name, c_int64) for name in ("tracing", "masked_steps", "cost")),
        *((name, c_int64) for name in ("slice_start", "slice_end")),
        ("blocked", c_int64 * 2),
        *((name, c_int64) for name in ("instructions", "idle_ticks", "asleep_since")),
        ("mck_ticks", c_int64),
        ("clocked", c_uint64),
    ]


class Calls(ctypes.Structure):
    """vb_calls_t."""

    _fields_ = [
        ("load", CFUNCTYPE(c_uint32, c_uint32, c_uint32)),
        ("store", CFUNCTYPE(None, c_uint32, c_uint32, c_uint32)),
        ("load_system", CFUNCTYPE(c_uint32, c_uint32, c_uint32)),
        ("store_system", CFUNCTYPE(None, c_uint32, c_uint32, c_uint32)),
        ("protected_page", CFUNCTYPE(c_int, c_uint32, c_uint32, c_uint32, c_int)),
        ("invalid_instruction", Ask),
        ("served_breakpoint", Ask),
        ("divided", Ask),
        ("restricts", CFUNCTYPE(c_int, c_uint32)),
        ("run_deferred", Call),
        ("reset", Call),
        ("set_irq", CFUNCTYPE(None, c_int, c_int)),
        ("request_reset", CFUNCTYPE(None, c_int)),
        ("txd_given", CFUNCTYPE(c_int, c_int)),
        ("pwm_period", CFUNCTYPE(None, c_int, c_int64, c_int64, c_int64)),
        ("pwm_changed", Call),
    ]


class WatchdogFields(ctypes.Structure):
    """vb_watchdog_t, as far as it is shared."""

    _fields_ = [("fed", c_int64), ("shortest_left_s", c_double)]


_P, _I, _Q, _U = c_void_p, c_int, c_int64, c_uint32
# Function: (result, arguments).
_PROTOTYPES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    **{f"vb_{name}_bytes": (c_uint64, ()) for name in
       ("chip", "state", "clock", "line", "calls", "engine")},
    "vb_clock_init": (None, (_P, Call)),
    "vb_clock_next_due": (_Q, (_P,)),
    "vb_clock_advance": (c_bool, (_P, _Q)),
    "vb_line_push": (None, (_P, POINTER(Run))),
    "vb_line_move": (None, (_P, _P, _Q)),
    "vb_line_end": (_Q, (_P,)),
    "vb_line_queued": (_Q, (_P,)),
    "vb_port_reset": (None, (_P,)),
    "vb_port_sync": (None, (_P,)),
    "vb_port_replan": (None, (_P,)),
    "vb_port_retime": (None, (_P,)),
    "vb_port_next_sent": (_Q, (_P,)),
    "vb_port_all_sent": (_Q, (_P,)),
    "vb_port_connect": (None, (_P, _P)),
    "vb_timer_reset": (None, (_P,)),
    "vb_timer_retime": (None, (_P,)),
    "vb_watchdog_reset": (None, (_P,)),
    "vb_watchdog_counter": (c_double, (_P,)),
    "vb_watchdog_idle": (None, (_P, c_bool)),
    "vb_watchdog_hold": (None, (_P,)),
    "vb_watchdog_run": (None, (_P,)),
    "vb_pwm_reset": (None, (_P,)),
    "vb_pwm_retime": (None, (_P,)),
    "vb_pwm_refuse_if_running": (c_bool, (_P, c_char_p)),
    "vb_pwm_waveform": (c_bool, (_P, _I, c_bool, POINTER(_Q))),
    "vb_pwm_high_counts": (_Q, (_P, _I, c_bool)),
    "vb_pwm_running": (c_bool, (_P, _I)),
    "vb_chip_init": (None, (_P, _P, _P, _P, POINTER(Calls))),
    "vb_chip_connect": (None, (_P, POINTER(Engine))),
    "vb_chip_set_slow_hz": (None, (_P, _Q)),
    "vb_chip_add_port": (_P, (_P, c_char_p, _U, _I, _I)),
    "vb_chip_add_timer": (_P, (_P, c_char_p, _U, _I)),
    "vb_chip_add_pwm": (_P, (_P, _U, _I)),
    "vb_chip_add_watchdog": (_P, (_P, _U)),
    "vb_chip_drop": (None, (_P,)),
    "vb_place_read": (_I, (_P, _U, POINTER(_U))),
    "vb_place_write": (_I, (_P, _U, _U)),
}  # fmt: skip
_MIRRORED = {"state": State, "line": LineFields, "calls": Calls, "engine": Engine}


def _path() -> Path:
    found = sorted(Path(__file__).parent.glob("*vboard_native.*"))
    if not found:
        raise ImportError(
            "the native library of the emulator is missing; install it: "
            "pip install ./tools/vboard in a clone of tailbeat"
        )
    return found[0]


def _load() -> tuple[Any, Any]:
    """(library whose calls hold the interpreter's lock, library whose calls give it away)."""
    library = ctypes.PyDLL(str(_path()))
    for name, (result, arguments) in _PROTOTYPES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    for name, mirror in _MIRRORED.items():
        size = getattr(library, f"vb_{name}_bytes")()
        if size != ctypes.sizeof(mirror):
            raise ImportError(f"vboard: {name} has {size} bytes in the native library, not "
                              f"{ctypes.sizeof(mirror)}; install the emulator anew")  # fmt: skip
    running = ctypes.CDLL(str(_path()))
    running.vb_chip_run.restype = c_int
    running.vb_chip_run.argtypes = (c_void_p, c_int64, c_void_p)
    return library, running


library, running = _load()


def address_of(name: str) -> c_void_p:
    """Of a function of the library, for callbacks."""
    return ctypes.cast(getattr(library, name), c_void_p)


def handle_of(structure: Any) -> c_void_p:
    """Address of a structure or buffer, which the caller keeps alive."""
    return c_void_p(ctypes.addressof(structure))
