#include "timer.h"

#include "check.h"
#include <string.h>

#define COVFS (1u << 0)
#define CLKSTA (1u << 16)
#define CLKEN 1u
#define CLKDIS 2u
#define SWTRG 4u
#define CPCTRG (1u << 14)
#define WAVE (1u << 15)
#define WAVSEL_UP 0u
#define WAVSEL_UP_RC 2u
#define SLOW 4u
#define WRAP (1LL << 32)
#define RC (VB_COMPARES - 1)

enum {
    CCR = 0x00,
    CMR = 0x04,
    CV = 0x10,
    RA = 0x14,
    REG_RC = 0x1C,
    SR = 0x20,
    IER = 0x24,
    IDR = 0x28,
    IMR = 0x2C
};

static const uint32_t COMPARE_FLAGS[VB_COMPARES] = {1u << 2, 1u << 3, 1u << 4};
static const int64_t MCK_DIVIDER[SLOW] = {2, 8, 32, 128};

static void sync(vb_timer_t *timer);
static void plan(vb_timer_t *timer);

static void happen(void *owner) {
    sync(owner);
    plan(owner);
}

static void drive(vb_timer_t *timer) {
    timer->soc->set_irq(timer->soc, timer->pid, (timer->flags & timer->mask) != 0);
}

void vb_timer_init(vb_timer_t *timer, vb_soc_t *soc, const char *name, int pid) {
    VB_CHECK(strlen(name) < VB_TIMER_NAME_BYTES);
    memset(timer, 0, sizeof *timer);
    timer->soc = soc;
    strcpy(timer->name, name);
    timer->pid = pid;
    timer->slot = vb_clock_reserve(soc->clock, happen, timer);
}

void vb_timer_reset(vb_timer_t *timer) {
    vb_clock_disarm(timer->soc->clock, timer->slot);
    timer->running = false;
    timer->unit = 2;
    timer->since = timer->soc->clock->now;
    timer->count = 0;
    timer->flags = timer->mask = timer->mode = 0;
    memset(timer->compare, 0, sizeof timer->compare);
    drive(timer);
}

/* Counting, carried out when somebody looks. */

static bool to_rc(const vb_timer_t *timer) {
    if (timer->mode & WAVE) {
        return (timer->mode >> 13 & 3) == WAVSEL_UP_RC;
    }
    return timer->mode & CPCTRG;
}

static int64_t period(const vb_timer_t *timer) {
    return to_rc(timer) && timer->compare[RC] ? timer->compare[RC] : WRAP;
}

/* Whether a count from |start| (excluded) to |end|, wrapping at |wrap|, meets |target|. A target of
 * the period itself is met at the wrap. */
static bool passed(int64_t start, int64_t end, int64_t target, int64_t wrap) {
    return target <= wrap && (target > start ? target : target + wrap) <= end;
}

static void sync(vb_timer_t *timer) {
    int64_t now = timer->soc->clock->now;
    int64_t steps = timer->running ? (now - timer->since) / timer->unit : 0;
    if (steps == 0) {
        return;
    }
    int64_t rest = (now - timer->since) % timer->unit;
    int64_t start = timer->count, end = start + steps;
    int64_t wrap = period(timer);
    if (start >= wrap) { /* RC was moved below the count: on to the wrap first */
        wrap = WRAP;
    }
    for (int i = 0; i < VB_COMPARES; i++) {
        timer->flags |= passed(start, end, timer->compare[i], wrap) ? COMPARE_FLAGS[i] : 0;
    }
    if (wrap == WRAP && end >= WRAP) {
        timer->flags |= COVFS;
    }
    timer->count = end % wrap;
    timer->since = now - rest;
}

static int64_t unit_ticks(const vb_timer_t *timer) {
    uint32_t source = timer->mode & 7;
    return source == SLOW ? vb_soc_slow_ticks(timer->soc, 1)
                          : MCK_DIVIDER[source] * *timer->soc->mck_ticks;
}

void vb_timer_retime(vb_timer_t *timer) {
    sync(timer);
    timer->since = timer->soc->clock->now;
    timer->unit = unit_ticks(timer);
    plan(timer);
}

/* Counts until |target| is met, 1 at least. */
static int64_t steps_to(const vb_timer_t *timer, int64_t target, int64_t wrap) {
    return ((target - timer->count - 1) % wrap + wrap) % wrap + 1;
}

/* An event at the next flag that an interrupt waits for. */
static void plan(vb_timer_t *timer) {
    drive(timer);
    vb_clock_disarm(timer->soc->clock, timer->slot);
    uint32_t wanted = timer->mask & ~timer->flags;
    if (!timer->running || !wanted) {
        return;
    }
    int64_t wrap = timer->count < period(timer) ? period(timer) : WRAP;
    int64_t steps = VB_NEVER;
    for (int i = 0; i < VB_COMPARES; i++) {
        if (wanted & COMPARE_FLAGS[i] && timer->compare[i] <= wrap) {
            int64_t found = steps_to(timer, timer->compare[i], wrap);
            steps = found < steps ? found : steps;
        }
    }
    if (wanted & COVFS && wrap == WRAP) {
        int64_t found = steps_to(timer, WRAP, wrap);
        steps = found < steps ? found : steps;
    }
    if (steps != VB_NEVER) {
        vb_clock_arm(timer->soc->clock, timer->slot, timer->since + steps * timer->unit);
    }
}

/* Registers. */

vb_access_t vb_timer_read(vb_timer_t *timer, uint32_t offset, uint32_t *value) {
    switch (offset) {
    case CMR:
        *value = timer->mode;
        return VB_DONE;
    case CV:
        sync(timer);
        *value = (uint32_t)timer->count;
        return VB_DONE;
    case RA:
    case RA + 4:
    case REG_RC:
        *value = timer->compare[(offset - RA) / 4];
        return VB_DONE;
    case SR:
        sync(timer);
        *value = timer->flags | (timer->running ? CLKSTA : 0);
        timer->flags = 0;
        plan(timer);
        return VB_DONE;
    case IMR:
        *value = timer->mask;
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}

static void write_ccr(vb_timer_t *timer, uint32_t value) {
    if (!vb_only_bits(timer->soc->clock, timer->name, " CCR", value, CLKEN | CLKDIS | SWTRG)) {
        return;
    }
    sync(timer);
    bool was = timer->running;
    if (value & (CLKEN | CLKDIS)) {
        timer->running = !(value & CLKDIS);
    }
    if (timer->running && (value & SWTRG || !was)) {
        timer->unit = unit_ticks(timer);
        timer->since = timer->soc->clock->now;
    }
    if (value & SWTRG) {
        timer->count = 0;
    }
    plan(timer);
}

/* Clock 1 to 5, up or up to RC; not while it counts. */
static void write_cmr(vb_timer_t *timer, uint32_t value) {
    const char *wrong = NULL;
    uint32_t shape = value >> 13 & 3;
    if (timer->running) {
        wrong = " while the channel counts";
    } else if ((value & 7) > SLOW || value & 0x78) {
        wrong = ": clock not modelled";
    } else if (value & WAVE && shape != WAVSEL_UP && shape != WAVSEL_UP_RC) {
        wrong = ": up-down counting is not modelled";
    }
    if (wrong != NULL) {
        vb_violation(timer->soc->clock, "%s CMR 0x%08x%s", timer->name, (unsigned)value, wrong);
        return;
    }
    timer->mode = value;
}

static void write_ier(vb_timer_t *timer, uint32_t value) {
    uint32_t allowed = COVFS | COMPARE_FLAGS[0] | COMPARE_FLAGS[1] | COMPARE_FLAGS[2];
    if (vb_only_bits(timer->soc->clock, timer->name, " IER", value, allowed)) {
        sync(timer);
        timer->mask |= value;
        plan(timer);
    }
}

vb_access_t vb_timer_write(vb_timer_t *timer, uint32_t offset, uint32_t value) {
    switch (offset) {
    case CCR:
        write_ccr(timer, value);
        return VB_DONE;
    case CMR:
        write_cmr(timer, value);
        return VB_DONE;
    case RA:
    case RA + 4:
    case REG_RC:
        sync(timer);
        timer->compare[(offset - RA) / 4] = value;
        plan(timer);
        return VB_DONE;
    case IER:
        write_ier(timer, value);
        return VB_DONE;
    case IDR:
        timer->mask &= ~value;
        plan(timer);
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}
