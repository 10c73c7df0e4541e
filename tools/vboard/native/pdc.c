#include "pdc.h"

#include "check.h"

void vb_pdc_reset(vb_pdc_t *pdc) {
    pdc->pointer = pdc->counter = pdc->next_pointer = pdc->next_counter = 0;
    pdc->enabled = false;
    pdc->ended = true;
}

int64_t vb_pdc_remaining(const vb_pdc_t *pdc) {
    return pdc->enabled ? (int64_t)pdc->counter + pdc->next_counter : 0;
}

bool vb_pdc_empty(const vb_pdc_t *pdc) { return pdc->counter == 0 && pdc->next_counter == 0; }

static void load_next(vb_pdc_t *pdc) {
    pdc->pointer = pdc->next_pointer;
    pdc->counter = pdc->next_counter;
    pdc->next_counter = 0;
}

static void advance(vb_pdc_t *pdc, uint32_t count) {
    pdc->pointer += count;
    pdc->counter -= count;
    if (pdc->counter == 0) {
        pdc->ended = true;
        if (pdc->next_counter) {
            load_next(pdc);
        }
    }
}

int64_t vb_pdc_put(vb_pdc_t *pdc, const uint8_t *data, int64_t length, uint8_t mask) {
    int64_t done = 0;
    while (done < length && pdc->enabled && pdc->counter) {
        int64_t left = length - done;
        uint32_t part = left < pdc->counter ? (uint32_t)left : pdc->counter;
        uint8_t *place = vb_soc_memory(pdc->soc, pdc->pointer, part, true);
        if (place == NULL) {
            vb_violation(pdc->soc->clock, "write of %u bytes to 0x%08x, which is no RAM",
                         (unsigned)part, (unsigned)pdc->pointer);
            return done;
        }
        for (uint32_t i = 0; i < part; i++) {
            place[i] = data[done + i] ^ mask;
        }
        advance(pdc, part);
        done += part;
    }
    return done;
}

uint8_t vb_pdc_get(vb_pdc_t *pdc) {
    VB_CHECK(pdc->enabled && pdc->counter);
    const uint8_t *place = vb_soc_memory(pdc->soc, pdc->pointer, 1, false);
    if (place == NULL) {
        vb_violation(pdc->soc->clock, "read of 1 bytes at 0x%08x, which is no memory",
                     (unsigned)pdc->pointer);
        return 0;
    }
    advance(pdc, 1);
    return *place;
}

static bool still(vb_pdc_t *pdc, const char *what) {
    if (pdc->enabled && pdc->counter) {
        vb_violation(pdc->soc->clock, "%s %s: the %s changed while a transfer is under way",
                     pdc->port, pdc->name, what);
        return false;
    }
    return true;
}

static bool sixteen(vb_pdc_t *pdc, uint32_t value) {
    if (value > 0xFFFF) {
        vb_violation(pdc->soc->clock, "%s %s: a counter of %u does not fit in 16 bits", pdc->port,
                     pdc->name, (unsigned)value);
        return false;
    }
    return true;
}

static void written(vb_pdc_t *pdc) {
    pdc->ended = false;
    if (pdc->counter == 0 && pdc->next_counter) {
        load_next(pdc);
    }
    if (pdc->counter == 0) {
        pdc->ended = true;
    }
}

void vb_pdc_set_pointer(vb_pdc_t *pdc, uint32_t value) {
    if (still(pdc, "pointer")) {
        pdc->pointer = value;
    }
}

void vb_pdc_set_counter(vb_pdc_t *pdc, uint32_t value) {
    if (still(pdc, "counter") && sixteen(pdc, value)) {
        pdc->counter = value;
        written(pdc);
    }
}

void vb_pdc_set_next_pointer(vb_pdc_t *pdc, uint32_t value) {
    if (pdc->enabled && pdc->next_counter) {
        vb_violation(pdc->soc->clock, "%s %s: next pointer changed while the next buffer waits",
                     pdc->port, pdc->name);
        return;
    }
    pdc->next_pointer = value;
}

void vb_pdc_set_next_counter(vb_pdc_t *pdc, uint32_t value) {
    if (sixteen(pdc, value)) {
        pdc->next_counter = value;
        written(pdc);
    }
}
