/*
 * The flash: bounds, contents, times, wear. It writes into units that are erased, the last such
 * ones, and leaves them erased: data of the firmware stay.
 */
#include "flash_access.h"
#include "report.h"
#include "time_checks.h"

#include "hal/clock.h"

#include <string.h>

#define REWRITES 200u        /* of one unit: 200 cycles of its life */
#define REWRITES_PER_STEP 5u /* without a pause: ticks fall into them */
#define STEP_MAX_US 25000u   /* then the watchdog is fed */
#define ALL_MAX_US 8000000u  /* of a slow flash fewer are made: the host waits 10 s */
#define UNITS_SEARCHED 64u
#define NO_AREA UINT32_MAX
#define MARK 0xC5u /* of the page that outlives a restart */

#define NO_AREA_WHY "the last 64 erase units hold data: there is no free unit to write to"

static bool is_blank(hal_t *hal, uint32_t offset, uint32_t length) {
    uint8_t part[64];
    for (uint32_t done = 0; done < length; done += sizeof part) {
        if (!hal_flash_read(hal, offset + done, part, sizeof part)) {
            return false;
        }
        for (uint32_t i = 0; i < sizeof part; i++) {
            if (part[i] != 0xFFu) {
                return false;
            }
        }
    }
    return true;
}

/* The last two neighbouring units that are erased; NO_AREA when there are none. */
static uint32_t find_area(hal_t *hal) {
    const uint32_t unit = flash_unit_bytes(hal);
    const uint32_t units = flash_size(hal) / unit;
    for (uint32_t back = 2; back <= units && back <= UNITS_SEARCHED; back++) {
        const uint32_t offset = flash_size(hal) - back * unit;
        if (is_blank(hal, offset, 2u * unit)) {
            return offset;
        }
    }
    return NO_AREA;
}

static void fill_page(uint8_t *page, uint32_t number) {
    for (uint32_t i = 0; i < FLASH_PAGE_BYTES_MAX; i++) {
        page[i] = (uint8_t)(i * 5u + number * 29u + (number >> 3));
    }
}

static bool holds(hal_t *hal, uint32_t offset, const uint8_t *page) {
    uint8_t read[FLASH_PAGE_BYTES_MAX];
    const uint32_t length = flash_page_bytes(hal);
    return hal_flash_read(hal, offset, read, length) && memcmp(read, page, length) == 0;
}

static void begin(suite_t *suite) { suite->progress.offset = find_area(suite->hal); }

/* flash_bounds */

static uint32_t refused_reads(suite_t *suite) {
    hal_t *hal = suite->hal;
    const uint32_t size = flash_size(hal);
    uint8_t *out = suite->block;
    uint32_t refused = 0;
    refused += !hal_flash_read(hal, size, out, 1) ? 1u : 0u;
    refused += !hal_flash_read(hal, size - 1u, out, 2) ? 1u : 0u;
    refused += !hal_flash_read(hal, UINT32_MAX, out, 2) ? 1u : 0u;
    refused += !hal_flash_read(hal, size - 16u, out, 17) ? 1u : 0u;
    return refused;
}

static uint32_t refused_writes(suite_t *suite) {
    hal_t *hal = suite->hal;
    const uint32_t area = suite->progress.offset;
    const uint32_t size = flash_size(hal);
    uint8_t page[FLASH_PAGE_BYTES_MAX];
    uint32_t refused = 0;
    fill_page(page, 1);
    refused += !flash_accepts(hal, area + 1u, page) ? 1u : 0u;
    refused += !flash_accepts(hal, area + flash_page_bytes(hal) - 4u, page) ? 1u : 0u;
    refused += !flash_accepts(hal, size, page) ? 1u : 0u;
    refused += !flash_accepts(hal, UINT32_MAX - flash_unit_bytes(hal) + 1u, page) ? 1u : 0u;
    return refused;
}

/* The last bytes there are can be read. */
static uint32_t allowed_reads(suite_t *suite) {
    const uint32_t size = flash_size(suite->hal);
    uint32_t allowed = 0;
    allowed += hal_flash_read(suite->hal, size - 1u, suite->block, 1) ? 1u : 0u;
    allowed += hal_flash_read(suite->hal, 0, suite->block, flash_page_bytes(suite->hal)) ? 1u : 0u;
    return allowed;
}

static bool step_bounds(suite_t *suite) {
    report_cases(suite, "flash_reads_inside", allowed_reads(suite), 2,
                 "a read inside the flash was refused");
    report_cases(suite, "flash_reads_outside", refused_reads(suite), 4,
                 "a read beyond the end was accepted");
    const uint32_t area = suite->progress.offset;
    if (area == NO_AREA) {
        report_absent(suite, "flash_writes_outside", NO_AREA_WHY);
        return true;
    }
    report_cases(suite, "flash_writes_outside", refused_writes(suite), 4,
                 "a misaligned write or one beyond the end was accepted");
    const bool untouched = is_blank(suite->hal, area, 2u * flash_unit_bytes(suite->hal));
    report_cases(suite, "flash_refused_writes_nothing", untouched ? 1u : 0u, 1,
                 "a refused write changed the flash");
    if (!untouched) {
        (void)flash_blank(suite->hal, area);
    }
    return true;
}

const scenario_t flash_bounds_scenario = {"flash_bounds", begin, step_bounds};

/* flash_write */

static void begin_write(suite_t *suite) {
    begin(suite);
    ticks_begin(&suite->ticks, suite->hal);
}

static void note_time(progress_t *progress, uint32_t time_us) {
    progress->least = time_us < progress->least ? time_us : progress->least;
    progress->most = time_us > progress->most ? time_us : progress->most;
    progress->total += time_us;
}

/* Each time other bytes. */
static void rewrite_once(suite_t *suite) {
    progress_t *progress = &suite->progress;
    uint8_t page[FLASH_PAGE_BYTES_MAX];
    fill_page(page, progress->done);
    const uint64_t start = hal_time_us(suite->hal);
    const bool written = flash_rewrite(suite->hal, progress->offset, page);
    note_time(progress, (uint32_t)(hal_time_us(suite->hal) - start));
    progress->wrong += written && holds(suite->hal, progress->offset, page) ? 0 : 1u;
    progress->done++;
}

static uint64_t passed_us(const suite_t *suite, uint64_t since_us) {
    return hal_time_us(suite->hal) - since_us;
}

/* True when that is all. */
static bool rewrite_some(suite_t *suite) {
    const progress_t *progress = &suite->progress;
    const uint64_t start = hal_time_us(suite->hal);
    uint32_t left = REWRITES_PER_STEP;
    while (left-- > 0 && progress->done < REWRITES && passed_us(suite, start) < STEP_MAX_US) {
        rewrite_once(suite);
    }
    return progress->done == REWRITES || passed_us(suite, progress->since_us) > ALL_MAX_US;
}

static void report_writes(suite_t *suite) {
    const progress_t *progress = &suite->progress;
    const uint32_t most = flash_rewrite_max_us(suite->hal);
    const uint32_t done = progress->done;
    report_cases(suite, "flash_reads_back", done - progress->wrong, done,
                 "a page does not hold what was written");
    report_range(suite, "flash_time_min", progress->least, "us", 0, most, "too slow");
    report_range(suite, "flash_time_mean", progress->total / done, "us", 0, most, "too slow");
    report_range(suite, "flash_time_max", progress->most, "us", 0, most, "too slow");
    report_range(suite, "flash_wear", done, "cycles", 0, REWRITES, "");
    time_checks_ticks(suite, "tick_period_flash", "tick_jitter_flash");
}

static void report_neighbour(suite_t *suite) {
    const uint32_t unit = flash_unit_bytes(suite->hal);
    const bool untouched = is_blank(suite->hal, suite->progress.offset + unit, unit);
    report_cases(suite, "flash_neighbour_untouched", untouched ? 1u : 0u, 1,
                 "writing changed the next erase unit");
    const bool blanked = flash_blank(suite->hal, suite->progress.offset) &&
                         is_blank(suite->hal, suite->progress.offset, unit);
    report_cases(suite, "flash_erases", blanked ? 1u : 0u, 1, "an erased unit is not all 0xFF");
}

static bool step_write(suite_t *suite) {
    if (suite->progress.offset == NO_AREA) {
        report_absent(suite, "flash_reads_back", NO_AREA_WHY);
        return true;
    }
    if (!rewrite_some(suite)) {
        return false;
    }
    report_writes(suite);
    report_neighbour(suite);
    return true;
}

const scenario_t flash_write_scenario = {"flash_write", begin_write, step_write};

/* flash_keep, a restart, flash_kept */

static void mark_page(uint8_t *page) {
    fill_page(page, 7);
    page[0] = MARK;
}

static bool step_keep(suite_t *suite) {
    uint8_t page[FLASH_PAGE_BYTES_MAX];
    mark_page(page);
    const uint32_t area = suite->progress.offset;
    if (area == NO_AREA) {
        report_absent(suite, "flash_marked", NO_AREA_WHY);
        return true;
    }
    report_cases(suite, "flash_marked", flash_rewrite(suite->hal, area, page) ? 1u : 0u, 1,
                 "the page could not be written");
    return true;
}

const scenario_t flash_keep_scenario = {"flash_keep", begin, step_keep};

/* The marked unit. A bit that changed over the restart leaves none. */
static uint32_t find_mark(hal_t *hal) {
    uint8_t page[FLASH_PAGE_BYTES_MAX];
    mark_page(page);
    const uint32_t unit = flash_unit_bytes(hal);
    const uint32_t units = flash_size(hal) / unit;
    for (uint32_t back = 1; back <= units && back <= UNITS_SEARCHED; back++) {
        if (holds(hal, flash_size(hal) - back * unit, page)) {
            return flash_size(hal) - back * unit;
        }
    }
    return NO_AREA;
}

static void begin_kept(suite_t *suite) { suite->progress.offset = find_mark(suite->hal); }

static bool step_kept(suite_t *suite) {
    const uint32_t area = suite->progress.offset;
    report_cases(suite, "flash_survives_restart", area != NO_AREA ? 1u : 0u, 1,
                 "the page written before the restart is not there");
    if (area != NO_AREA) {
        (void)flash_blank(suite->hal, area);
    }
    return true;
}

const scenario_t flash_kept_scenario = {"flash_kept", begin_kept, step_kept};
