#include "flash_model.h"

#include <string.h>

#define PAGE HAL_FLASH_PAGE_BYTES
#define TORN_EARLY_BYTES 20u
#define WEAR_SPREAD 8u /* pages live up to 1/8 longer than the weakest */

jmp_buf flash_model_off;

uint32_t flash_model_random(flash_model_t *model, uint32_t limit) {
    model->random = model->random * 1664525u + 1013904223u;
    return (model->random >> 8) % limit;
}

static uint8_t some_bits(flash_model_t *model) {
    return (uint8_t)(flash_model_random(model, 256) & flash_model_random(model, 256));
}

/* Whole quadwords, at least one and never all. */
static uint32_t some_quadwords(flash_model_t *model) {
    return (1u + flash_model_random(model, PAGE / FLASH_QUADWORD_BYTES - 1u)) *
           FLASH_QUADWORD_BYTES;
}

static void half_quadword(flash_model_t *model, uint8_t *at, const uint8_t *page) {
    const uint32_t whole = some_quadwords(model);
    memset(at, 0xFF, PAGE);
    memcpy(at, page, whole);
    for (uint32_t i = whole; i < whole + FLASH_QUADWORD_BYTES; i++) {
        at[i] = (uint8_t)(page[i] | some_bits(model));
    }
}

static void unstable(flash_model_t *model, uint8_t *at, const uint8_t *page, uint32_t offset) {
    memcpy(at, page, PAGE);
    model->unstable_page = offset;
    for (uint32_t i = 0; i < PAGE; i++) {
        model->unstable[i] = (uint8_t)(~page[i] & some_bits(model) & some_bits(model));
    }
}

void flash_model_cut(flash_model_t *model, hal_t *hal, cut_kind_t kind, uint32_t offset,
                     const uint8_t *page) {
    uint8_t *at = hal->flash + offset;
    switch (kind) {
    case CUT_ERASED:
        memset(at, 0xFF, PAGE);
        break;
    case CUT_TORN_OVER_BLANK:
        memset(at, 0xFF, PAGE);
        memcpy(at, page, some_quadwords(model));
        break;
    case CUT_TORN_OVER_OLD:
        memcpy(at, page, some_quadwords(model));
        break;
    case CUT_TORN_EARLY:
        memset(at, 0xFF, PAGE);
        memcpy(at, page, TORN_EARLY_BYTES);
        break;
    case CUT_HALF_QUADWORD:
        half_quadword(model, at, page);
        break;
    case CUT_HALF_ERASED:
        for (uint32_t i = 0; i < PAGE; i++) {
            at[i] |= some_bits(model);
        }
        break;
    case CUT_UNSTABLE:
        unstable(model, at, page, offset);
        break;
    case CUT_WRITTEN:
        memcpy(at, page, PAGE);
        break;
    case CUT_UNTOUCHED:
    case CUT_KINDS:
        break;
    }
}

void flash_model_rot(flash_model_t *model, hal_t *hal, uint32_t offset) {
    hal->flash[offset + flash_model_random(model, PAGE)] ^=
        (uint8_t)(1u << flash_model_random(model, 8));
}

static uint32_t life_of(const flash_model_t *model, uint32_t page) {
    return model->endurance + (page * 2654435761u >> 16) % (model->endurance / WEAR_SPREAD + 1u);
}

static bool write_page(hal_t *hal, uint32_t offset, const uint8_t *page) {
    flash_model_t *model = hal->flash_context;
    const uint32_t number = offset / PAGE;
    if (model->before_write != NULL) {
        model->before_write(model->context, offset, page);
    }
    model->writes++;
    model->page_writes[number]++;
    if (model->cut_in != 0 && --model->cut_in == 0) {
        flash_model_cut(model, hal, model->cut_kind, offset, page);
        longjmp(flash_model_off, 1);
    }
    memcpy(hal->flash + offset, page, PAGE);
    if (model->unstable_page == offset) {
        model->unstable_page = FLASH_STABLE;
    }
    if (model->endurance != 0 && model->page_writes[number] > life_of(model, number)) {
        model->worn++;
        flash_model_rot(model, hal, offset);
        return false;
    }
    return true;
}

static void read_back(hal_t *hal, uint32_t offset, uint8_t *read, uint32_t length) {
    flash_model_t *model = hal->flash_context;
    for (uint32_t i = 0; i < length && model->unstable_page != FLASH_STABLE; i++) {
        const uint32_t in_page = offset + i - model->unstable_page;
        if (in_page < PAGE && model->unstable[in_page] != 0) {
            read[i] |= (uint8_t)(model->unstable[in_page] & flash_model_random(model, 256));
        }
    }
}

void flash_model_attach(flash_model_t *model, hal_t *hal, uint32_t seed) {
    memset(model, 0, sizeof *model);
    model->random = seed;
    model->unstable_page = FLASH_STABLE;
    hal->flash_write = write_page;
    hal->flash_read = read_back;
    hal->flash_context = model;
}
