#include "mpu.h"

#define CTRL_ENABLE 1
#define CTRL_HFNMIENA 2
#define CTRL_PRIVDEFENA 4
#define RASR_ENABLE 1u
#define NO_REGION (-1)
#define PARTS 8u
#define SMALLEST_WITH_PARTS 256u

/* By the AP field: privileged may read, write; unprivileged may read, write. 4 is reserved. */
static const bool ACCESS[8][4] = {{false, false, false, false}, {true, true, false, false},
                                  {true, true, true, false},    {true, true, true, true},
                                  {false, false, false, false}, {true, false, false, false},
                                  {true, false, true, false},   {true, false, true, false}};

bool vb_mpu_active(const vb_state_t *state, int priority) {
    if (!(state->mpu_control & CTRL_ENABLE)) {
        return false;
    }
    return priority >= 0 || state->mpu_control & CTRL_HFNMIENA;
}

static bool holds(const vb_state_t *state, int region, uint32_t address) {
    uint32_t attributes = (uint32_t)state->mpu_attributes[region];
    if (!(attributes & RASR_ENABLE)) {
        return false;
    }
    uint64_t size = 2ull << (attributes >> 1 & 0x1F);
    uint64_t start = (uint64_t)state->mpu_base[region] & ~(size - 1);
    if (address < start || address >= start + size) {
        return false;
    }
    uint64_t part = (address - start) * PARTS / size;
    return size < SMALLEST_WITH_PARTS || !(attributes >> (8 + part) & 1);
}

/* The highest enabled region that holds the address. */
static int find(const vb_state_t *state, uint32_t address) {
    for (int region = VB_REGIONS - 1; region >= 0; region--) {
        if (holds(state, region, address)) {
            return region;
        }
    }
    return NO_REGION;
}

bool vb_mpu_allows(const vb_state_t *state, uint32_t address, bool write, bool privileged) {
    int region = find(state, address);
    if (region == NO_REGION) {
        return privileged && state->mpu_control & CTRL_PRIVDEFENA;
    }
    uint32_t access = (uint32_t)state->mpu_attributes[region] >> 24 & 7;
    return ACCESS[access][(privileged ? 0 : 2) + (write ? 1 : 0)];
}
