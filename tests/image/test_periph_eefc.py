"""Flash: page latch, commands and their times, what breaks when the power goes."""

from __future__ import annotations

from collections import Counter

import pytest

from vboard.core.bus import BusViolation
from vboard.core.clock import ticks_of_us
from vboard.periph.bench import Bench
from vboard.periph.eefc import Eefc
from vboard.periph.flash import PAGE_BYTES, UNIT_BYTES, Flash

BANK1 = 0xC0000
NEW = bytes(range(256))
WP, EWP, EWPL, EA, SLB, CLB, GLB = 1, 3, 4, 5, 8, 9, 0xA
SGPB, GGPB, STUI, SPUI = 0xB, 0xD, 0xE, 0xF
FRDY, FCMDE, FLOCKE = 1, 2, 4


def _bench(**options: object) -> Bench:
    bench = Bench(**options)  # type: ignore[arg-type]
    bench.write("EEFC1.FMR", 0x600)
    return bench


def _eefc(bench: Bench, bank: int = 1) -> Eefc:
    eefc = bench.periph[f"EEFC{bank}"]
    assert isinstance(eefc, Eefc)
    return eefc


def _fill(bench: Bench, page: int, data: bytes = NEW) -> None:
    for at in range(0, PAGE_BYTES, 4):
        word = int.from_bytes(data[at : at + 4], "little")
        _eefc(bench).latch_store(BANK1 + page * PAGE_BYTES + at, 4, word)


def _command(bench: Bench, command: int, argument: int = 0, bank: int = 1) -> None:
    bench.write(f"EEFC{bank}.FCR", 0x5A000000 | argument << 8 | command)


def _write_page(bench: Bench, page: int, data: bytes = NEW, command: int = EWP) -> None:
    _fill(bench, page, data)
    _command(bench, command, page)
    bench.run_us(5000)


@pytest.mark.parametrize(("command", "us"), [(EWP, 4600), (WP, 2300)])
def test_page_takes_its_time_and_then_holds_the_bytes(command: int, us: int) -> None:
    bench = _bench()
    busy: list[bool] = []
    changed: list[tuple[int, int]] = []
    _eefc(bench).on_busy.append(busy.append)
    bench.flash.on_change.append(lambda first, last: changed.append((first, last)))
    _fill(bench, 5)
    assert bench.flash.page(1, 5) == b"\xff" * PAGE_BYTES
    _command(bench, command, 5)
    bench.run_us(us - 1)
    assert bench.read("EEFC1.FSR") == 0
    assert not _eefc(bench).readable(BANK1)
    assert busy == [True]
    bench.run_us(2)
    assert bench.read("EEFC1.FSR") == FRDY
    assert _eefc(bench).readable(BANK1)
    assert busy == [True, False]
    assert bench.flash.page(1, 5) == NEW
    assert changed == [(BANK1 + 5 * PAGE_BYTES, BANK1 + 6 * PAGE_BYTES)]
    assert bench.flash.wear[1].programmed[5] == 1
    assert bench.flash.wear[1].erased[5] == (command == EWP)


def test_ready_interrupt() -> None:
    bench = _bench()
    bench.write("EEFC1.FMR", 0x601)
    assert bench.irq[7]
    _fill(bench, 0)
    _command(bench, EWP)
    assert not bench.irq[7]
    bench.run_us(4601)
    assert bench.irq_rises[7][-1] == ticks_of_us(4600)


def test_write_without_erase_only_clears_bits() -> None:
    bench = _bench()
    half = NEW[:UNIT_BYTES] + b"\xff" * (PAGE_BYTES - UNIT_BYTES)
    rest = b"\xff" * UNIT_BYTES + NEW[UNIT_BYTES:]
    _write_page(bench, 0, half, WP)
    _write_page(bench, 0, rest, WP)
    assert bench.flash.page(1, 0) == NEW
    _fill(bench, 0, half)
    with pytest.raises(BusViolation, match=r"\+0 programmed twice"):
        _command(bench, WP)


def test_latch_wants_whole_pages_of_words_in_order() -> None:
    for steps, told in (
        ([(BANK1, 2)], "with 16 bits"),
        ([(BANK1 + 4, 4)], "word 1 of the page where 0 is due"),
        ([(BANK1, 4), (BANK1 + PAGE_BYTES, 4)], "page 1, but the latch holds page 0"),
    ):
        bench = _bench()
        with pytest.raises(BusViolation, match=told):
            for address, width in steps:
                _eefc(bench).latch_store(address, width, 0)
    bench = _bench()
    _eefc(bench).latch_store(BANK1, 4, 0)
    with pytest.raises(BusViolation, match="1 of 64 words"):
        _command(bench, EWP)
    bench = _bench()
    _fill(bench, 3)
    with pytest.raises(BusViolation, match="latch was filled for page 3"):
        _command(bench, EWP, 4)


def test_wait_states_of_the_erratum() -> None:
    bench = Bench()
    with pytest.raises(BusViolation, match="erratum asks for 6"):
        _fill(bench, 0)
    bench = _bench()
    _fill(bench, 0)
    bench.write("EEFC1.FMR", 0x400)
    with pytest.raises(BusViolation, match="erratum asks for 6"):
        _command(bench, EWP)


def test_wait_states_of_the_erratum_can_corrupt_instead() -> None:
    bench = Bench()
    _eefc(bench).strict = False
    _write_page(bench, 0)
    wrong = sum(a != b for a, b in zip(bench.flash.page(1, 0), NEW, strict=True))
    assert wrong == 1


def test_nobody_touches_a_busy_bank() -> None:
    bench = _bench()
    _fill(bench, 0)
    _command(bench, EWP)
    with pytest.raises(BusViolation, match="busy"):
        _eefc(bench).latch_store(BANK1, 4, 0)
    with pytest.raises(BusViolation, match="while FRDY is 0"):
        _command(bench, GLB)
    assert _eefc(bench, 0).readable(0x80000)


def test_errors_are_flags_cleared_by_reading() -> None:
    bench = _bench()
    for command, argument in ((0x11, 0), (EWP, 1024), (SGPB, 3)):
        _command(bench, command, argument)
        assert bench.read("EEFC1.FSR") == FRDY | FCMDE
        assert bench.read("EEFC1.FSR") == FRDY
    with pytest.raises(BusViolation, match="without its key"):
        bench.write("EEFC1.FCR", EWP)
    _eefc(bench).fail_next = FCMDE
    _fill(bench, 0)
    _command(bench, EWP)
    assert bench.read("EEFC1.FSR") == FRDY | FCMDE
    assert bench.flash.page(1, 0) == b"\xff" * PAGE_BYTES
    _write_page(bench, 0)
    assert bench.flash.page(1, 0) == NEW


def test_locked_regions() -> None:
    bench = _bench()
    _command(bench, SLB, 64)
    bench.run_us(2000)
    _fill(bench, 127)
    _command(bench, EWP, 127)
    assert bench.read("EEFC1.FSR") == FRDY | FLOCKE
    _command(bench, GLB)
    bench.run_us(2)
    assert bench.read("EEFC1.FRR") == 0b10
    _command(bench, CLB, 100)
    bench.run_us(2000)
    _write_page(bench, 127)
    _write_page(bench, 128, command=EWPL)
    assert bench.flash.page(1, 127) == NEW
    assert bench.flash.locked[1] == {2}


def test_descriptor_and_boot_bits() -> None:
    bench = _bench()
    _command(bench, 0)
    bench.run_us(2)
    answer = [bench.read("EEFC1.FRR") for _ in range(7)]
    assert answer == [0, 0x40000, 256, 1, 0x40000, 16, 0x4000]
    _command(bench, SGPB, 2, bank=0)
    bench.run_us(2000)
    _command(bench, GGPB, bank=0)
    bench.run_us(2)
    assert bench.read("EEFC0.FRR") == 0b110
    _write_page(bench, 9)
    _command(bench, EA)
    bench.run_us(11_000)
    assert bench.flash.bank(1) == b"\xff" * 0x40000


def test_unique_id_covers_the_start_of_bank_0() -> None:
    bench = Bench(unique_id=b"tailbeat vboard ")
    code = bytes(bench.flash.memory[:16])
    with pytest.raises(BusViolation, match="SCOD"):
        _command(bench, STUI, bank=0)
    bench.write("EEFC0.FMR", 1 << 16)
    _command(bench, STUI, bank=0)
    assert bench.read("EEFC0.FSR") == 0
    assert bench.read_memory(0x80000, 16) == b"tailbeat vboard "
    assert _eefc(bench, 0).readable(0x80000)
    assert not _eefc(bench, 0).readable(0x80010)
    _command(bench, SPUI, bank=0)
    bench.run_us(2)
    assert bench.read("EEFC0.FSR") == FRDY
    assert bytes(bench.flash.memory[:16]) == code
    bench.write("EEFC1.FMR", 1 << 16)
    with pytest.raises(BusViolation, match="only known to work on bank 0"):
        _command(bench, STUI)


def _torn(progress: float, seed: int, old: bytes, command: int = EWP) -> bytes:
    flash = Flash()
    flash.set(1, 0, old)
    bench = _bench(flash=flash, seed=seed)
    _fill(bench, 0)
    _command(bench, command)
    bench.run_us(progress * (4600 if command == EWP else 2300))
    _eefc(bench).power_off()
    bench.run_us(10_000)
    assert flash.torn == [(1, 0)]
    return flash.page(1, 0)


def _kinds(page: bytes, old: bytes) -> Counter[str]:
    kinds: Counter[str] = Counter()
    for at in range(0, PAGE_BYTES, 4):
        word = page[at : at + 4]
        names = ((old, "old"), (NEW, "new"), (b"\xff" * PAGE_BYTES, "blank"))
        kinds[next((n for d, n in names if word == d[at : at + 4]), "mixed")] += 1
    return kinds


def test_power_cut_tears_the_page_and_the_same_seed_tears_alike() -> None:
    old = bytes(255 - byte for byte in NEW)
    assert _torn(0.3, 1, old) == _torn(0.3, 1, old)
    assert _torn(0.3, 1, old) != _torn(0.3, 2, old)
    early, late = _kinds(_torn(0.25, 1, old), old), _kinds(_torn(0.75, 1, old), old)
    assert early["old"] and early["blank"] and not early["new"]
    assert late["new"] and late["blank"] and late["mixed"] and not late["old"]
    assert _torn(0.0, 1, old) == old or _kinds(_torn(0.0, 1, old), old)["old"] > 40


def test_power_cut_of_a_write_without_erase_leaves_no_bit_set_that_was_clear() -> None:
    old = b"\xff" * PAGE_BYTES
    page = _torn(0.5, 1, old, WP)
    kinds = _kinds(page, old)
    assert kinds["new"] and kinds["old"] and kinds["mixed"]
    assert all(byte & new == new for byte, new in zip(page, NEW, strict=True))


def test_power_cut_before_the_command_changes_nothing() -> None:
    bench = _bench()
    _fill(bench, 0)
    _eefc(bench).power_off()
    assert bench.flash.page(1, 0) == b"\xff" * PAGE_BYTES
    assert not bench.flash.torn


def test_supply_dip_tears_and_says_nothing() -> None:
    bench = _bench()
    _fill(bench, 0)
    _command(bench, EWP)
    bench.run_us(1000)
    bench.rail.set(1.8)
    bench.run_us(10)
    bench.rail.set(3.3)
    bench.run_us(5000)
    assert bench.read("EEFC1.FSR") == FRDY
    assert bench.flash.torn == [(1, 0)]
    assert bench.flash.page(1, 0) != NEW
    _write_page(bench, 0)
    assert bench.flash.page(1, 0) == NEW


def test_reset_during_a_write_tears() -> None:
    bench = _bench()
    _fill(bench, 0)
    _command(bench, EWP)
    bench.run_us(2000)
    _eefc(bench).reset()
    bench.run_us(5000)
    assert bench.flash.torn == [(1, 0)]
    assert bench.read("EEFC1.FSR") == FRDY
