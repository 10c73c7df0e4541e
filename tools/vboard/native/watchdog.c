#include "watchdog.h"

#include <math.h>
#include <string.h>

#define KEY 0xA5u
#define WDRSTT 1u
#define WDFIEN (1u << 12)
#define WDRSTEN (1u << 13)
#define WDRPROC (1u << 14)
#define WDDIS (1u << 15)
#define WDIDLEHLT (1u << 29)
#define WDUNF 1u
#define WDERR 2u
#define MODE_RESET 0x3FFF2FFFu
#define RESET_WATCHDOG 2
#define SLOW_PER_COUNT 128
#define SETTLE_SLOW_CLOCKS 3
#define WDT_IRQ 4

enum { CR = 0x0, MR = 0x4, SR = 0x8 };

static void bite(vb_watchdog_t *dog, uint32_t flag);

static void underflow(void *owner) { bite(owner, WDUNF); }

void vb_watchdog_init(vb_watchdog_t *dog, vb_soc_t *soc) {
    memset(dog, 0, sizeof *dog);
    dog->shortest_left_s = -1;
    dog->soc = soc;
    dog->slot = vb_clock_reserve(soc->clock, underflow, dog);
}

void vb_watchdog_reset(vb_watchdog_t *dog) {
    dog->mode = MODE_RESET;
    dog->mode_written = dog->idle = false;
    dog->fed_at = VB_NEVER;
    dog->flags = 0;
    dog->left = 0xFFF;
    dog->since = VB_NEVER;
    vb_watchdog_run(dog);
}

static int64_t count_ticks(const vb_watchdog_t *dog) {
    return vb_soc_slow_ticks(dog->soc, SLOW_PER_COUNT);
}

double vb_watchdog_counter(const vb_watchdog_t *dog) {
    if (dog->since == VB_NEVER) {
        return dog->left;
    }
    double gone = (double)(dog->soc->clock->now - dog->since) / (double)count_ticks(dog);
    return dog->left > gone ? dog->left - gone : 0.0;
}

void vb_watchdog_idle(vb_watchdog_t *dog, bool sleeping) {
    dog->idle = sleeping;
    if (dog->mode & WDIDLEHLT) {
        vb_watchdog_hold(dog);
        vb_watchdog_run(dog);
    }
}

void vb_watchdog_hold(vb_watchdog_t *dog) {
    dog->left = vb_watchdog_counter(dog);
    dog->since = VB_NEVER;
    vb_clock_disarm(dog->soc->clock, dog->slot);
}

void vb_watchdog_run(vb_watchdog_t *dog) {
    if (dog->mode & WDDIS || (dog->mode & WDIDLEHLT && dog->idle)) {
        return;
    }
    dog->since = dog->soc->clock->now;
    int64_t ticks = (int64_t)nearbyint(dog->left * (double)count_ticks(dog));
    vb_clock_arm(dog->soc->clock, dog->slot, dog->since + ticks);
}

static void reload(vb_watchdog_t *dog) {
    vb_watchdog_hold(dog);
    dog->left = dog->mode & 0xFFF;
    vb_watchdog_run(dog);
}

static void bite(vb_watchdog_t *dog, uint32_t flag) {
    dog->flags |= flag;
    if (dog->mode & WDFIEN) {
        dog->soc->set_irq(dog->soc, WDT_IRQ, true);
    }
    uint32_t mode = dog->mode;
    reload(dog);
    if (mode & WDRSTEN) {
        dog->soc->request_reset(dog->soc, RESET_WATCHDOG);
    }
}

vb_access_t vb_watchdog_read(vb_watchdog_t *dog, uint32_t offset, uint32_t *value) {
    switch (offset) {
    case MR:
        *value = dog->mode;
        return VB_DONE;
    case SR:
        *value = dog->flags;
        dog->flags = 0;
        dog->soc->set_irq(dog->soc, WDT_IRQ, false);
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}

/* Once. */
static void write_mr(vb_watchdog_t *dog, uint32_t value) {
    vb_clock_t *clock = dog->soc->clock;
    if (!vb_only_bits(clock, "WDT_MR", "", value, 0x3FFFFFFFu)) {
        return;
    }
    if (dog->mode_written) {
        vb_violation(clock, "WDT_MR written a second time; the chip ignores it");
    } else if (value & WDRPROC) {
        vb_violation(clock, "WDT_MR with WDRPROC: this chip then does not reset at all");
    } else if (dog->fed_at != VB_NEVER &&
               clock->now < dog->fed_at + vb_soc_slow_ticks(dog->soc, SETTLE_SLOW_CLOCKS)) {
        vb_violation(clock, "WDT_MR written within three slow clocks after WDT_CR");
    } else {
        dog->mode_written = true;
        vb_watchdog_hold(dog);
        dog->mode = value;
        reload(dog);
    }
}

/* Feeds it; while the counter is above WDD that is an error. */
static void write_cr(vb_watchdog_t *dog, uint32_t value) {
    vb_clock_t *clock = dog->soc->clock;
    if (value >> 24 != KEY) {
        vb_violation(clock, "WDT_CR written without its key (0x%08x)", (unsigned)value);
        return;
    }
    if (!vb_only_bits(clock, "WDT_CR", "", value & 0xFFFFFFu, WDRSTT) || !(value & WDRSTT)) {
        return;
    }
    double left = vb_watchdog_counter(dog);
    dog->fed_at = clock->now;
    dog->fed++;
    double seconds = left * SLOW_PER_COUNT / (double)dog->soc->slow_hz;
    if (dog->shortest_left_s < 0 || seconds < dog->shortest_left_s) {
        dog->shortest_left_s = seconds;
    }
    if (left > (dog->mode >> 16 & 0xFFF)) {
        bite(dog, WDERR);
    } else {
        reload(dog);
    }
}

vb_access_t vb_watchdog_write(vb_watchdog_t *dog, uint32_t offset, uint32_t value) {
    if (offset == MR) {
        write_mr(dog, value);
    } else if (offset == CR) {
        write_cr(dog, value);
    } else {
        return VB_UNKNOWN;
    }
    return VB_DONE;
}
