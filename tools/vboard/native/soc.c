#include "soc.h"

#include <math.h>

static bool within(uint32_t address, uint32_t length, uint32_t start, uint32_t size) {
    return address >= start && (uint64_t)address + length <= (uint64_t)start + size;
}

uint8_t *vb_soc_memory(const vb_soc_t *soc, uint32_t address, uint32_t length, bool writable) {
    if (within(address, length, VB_RAM_START, VB_RAM_BYTES)) {
        return soc->ram + (address - VB_RAM_START);
    }
    if (address >= VB_MIRROR_START && address < VB_RAM_START) {
        uint32_t offset = address % VB_MIRROR_BYTES;
        return offset + (uint64_t)length <= VB_MIRROR_BYTES ? soc->ram + offset : NULL;
    }
    if (writable) {
        return NULL;
    }
    if (within(address, length, VB_FLASH_START, VB_FLASH_BYTES)) {
        return soc->flash + (address - VB_FLASH_START);
    }
    return within(address, length, 0, VB_BANK_BYTES) ? soc->flash + address : NULL;
}

int64_t vb_soc_slow_ticks(const vb_soc_t *soc, int cycles) {
    return (int64_t)nearbyint((double)(cycles * VB_TICKS_PER_S) / (double)soc->slow_hz);
}

bool vb_only_bits(vb_clock_t *clock, const char *name, const char *reg, uint32_t value,
                  uint32_t allowed) {
    if (value & ~allowed) {
        vb_violation(clock, "%s%s: bits 0x%08x are unknown or not modelled", name, reg,
                     (unsigned)(value & ~allowed));
        return false;
    }
    return true;
}
