#include "flash_model.h"

#include <string.h>

#define PAGE STORE_PAGE_BYTES
#define UNIT MOCK_FLASH_ERASE_BYTES
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
    model->unstable_at = offset;
    memset(model->unstable, 0, sizeof model->unstable);
    for (uint32_t i = 0; i < PAGE; i++) {
        model->unstable[i] = (uint8_t)(~page[i] & some_bits(model) & some_bits(model));
    }
}

/* Bits of the unit that was being erased come up or not each time they are read. */
static void unstable_unit(flash_model_t *model, const uint8_t *at, uint32_t offset) {
    model->unstable_at = offset;
    for (uint32_t i = 0; i < UNIT; i++) {
        model->unstable[i] = (uint8_t)(~at[i] & some_bits(model));
    }
}

static void fill_pages(flash_model_t *model, uint8_t *at, uint8_t fill) {
    for (uint32_t page = 0; page < UNIT; page += PAGE) {
        if (flash_model_random(model, 2) == 0) {
            memset(at + page, fill, PAGE);
        }
    }
}

static void cut_erase(flash_model_t *model, uint8_t *at, cut_kind_t kind, uint32_t offset) {
    switch (kind) {
    case CUT_ERASED:
    case CUT_WRITTEN:
        memset(at, 0xFF, UNIT);
        break;
    case CUT_TORN_OVER_BLANK:
        memset(at, 0xFF, (1u + flash_model_random(model, UNIT / PAGE)) * PAGE / 2u);
        break;
    case CUT_TORN_OVER_OLD:
        fill_pages(model, at, 0xFF);
        break;
    case CUT_TORN_EARLY:
        fill_pages(model, at, 0);
        break;
    case CUT_HALF_QUADWORD:
        memset(at, 0, UNIT);
        break;
    case CUT_HALF_ERASED:
        for (uint32_t i = 0; i < UNIT; i++) {
            at[i] |= some_bits(model);
        }
        break;
    case CUT_UNSTABLE:
        unstable_unit(model, at, offset);
        break;
    case CUT_UNTOUCHED:
    case CUT_KINDS:
        break;
    }
}

/* The bits of a blank page that have come down already. */
static void half_program(flash_model_t *model, uint8_t *at, const uint8_t *page) {
    for (uint32_t i = 0; i < PAGE; i++) {
        at[i] = MOCK_FLASH_ERASES_FIRST ? (uint8_t)(page[i] | some_bits(model))
                                        : (uint8_t)(at[i] | some_bits(model));
    }
}

void flash_model_cut(flash_model_t *model, hal_t *hal, cut_kind_t kind, uint32_t offset,
                     const uint8_t *page) {
    uint8_t *at = hal->flash + offset;
    hal->flash_changed[offset / MOCK_PIECE_BYTES] = true;
    if (page == NULL) {
        cut_erase(model, at, kind, offset);
        return;
    }
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
        half_program(model, at, page);
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

static uint32_t life_of(const flash_model_t *model, uint32_t number) {
    return model->endurance + (number * 2654435761u >> 16) % (model->endurance / WEAR_SPREAD + 1u);
}

static bool is_worn(flash_model_t *model, uint32_t number, uint32_t cycles) {
    const bool worn = model->endurance != 0 && cycles > life_of(model, number);
    model->worn += worn;
    return worn;
}

/* The power may go now. */
static void begin_work(hal_t *hal, uint32_t offset, const uint8_t *page) {
    flash_model_t *model = hal->flash_context;
    if (model->before_write != NULL) {
        model->before_write(model->context, offset, page);
    }
    if (model->cut_in != 0 && --model->cut_in == 0) {
        flash_model_cut(model, hal, model->cut_kind, offset, page);
        longjmp(flash_model_off, 1);
    }
}

/* Each page wears by itself where programming erases, else the unit by its erases. */
static bool write_page(hal_t *hal, uint32_t offset, const uint8_t *page) {
    flash_model_t *model = hal->flash_context;
    const uint32_t number = offset / PAGE;
    model->writes++;
    model->page_writes[number]++;
    model->busy_us += hal_flash_geometry(hal)->program_max_us;
    begin_work(hal, offset, page);
    memcpy(hal->flash + offset, page, PAGE);
    if (model->unstable_at == offset && !MOCK_FLASH_ERASES_FIRST) {
        model->unstable_at = FLASH_STABLE;
    }
    if (!MOCK_FLASH_ERASES_FIRST && is_worn(model, number, model->page_writes[number])) {
        flash_model_rot(model, hal, offset);
        return false;
    }
    return true;
}

static bool erase_unit(hal_t *hal, uint32_t offset) {
    flash_model_t *model = hal->flash_context;
    const uint32_t number = offset / UNIT;
    model->erases++;
    model->unit_erases[number]++;
    model->busy_us += hal_flash_geometry(hal)->erase_typical_us;
    begin_work(hal, offset, NULL);
    memset(hal->flash + offset, 0xFF, UNIT);
    if (model->unstable_at != FLASH_STABLE && model->unstable_at / UNIT == number) {
        model->unstable_at = FLASH_STABLE;
    }
    if (is_worn(model, number, model->unit_erases[number])) {
        flash_model_rot(model, hal, offset);
        return false;
    }
    return true;
}

static void read_back(hal_t *hal, uint32_t offset, uint8_t *read, uint32_t length) {
    flash_model_t *model = hal->flash_context;
    for (uint32_t i = 0; i < length && model->unstable_at != FLASH_STABLE; i++) {
        const uint32_t in_unit = offset + i - model->unstable_at;
        if (in_unit < FLASH_UNSTABLE_BYTES && model->unstable[in_unit] != 0) {
            read[i] |= (uint8_t)(model->unstable[in_unit] & flash_model_random(model, 256));
        }
    }
}

void flash_model_attach(flash_model_t *model, hal_t *hal, uint32_t seed) {
    memset(model, 0, sizeof *model);
    model->random = seed;
    model->unstable_at = FLASH_STABLE;
    hal->flash_write = write_page;
    hal->flash_erase = erase_unit;
    hal->flash_read = read_back;
    hal->flash_context = model;
}
