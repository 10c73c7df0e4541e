/* The run loop: one decision and one slice, or one sleep, at a time. */
#include "check.h"
#include "chip.h"

enum { CYCLES_PER_INSTRUCTION = 2, MASKED_STEPS = 20000, MASKED_SLICE = 256 };
enum { BREAKPOINT_BYTES = 2 };
#define LONGEST_SLICE_TICKS (VB_TICKS_PER_S / 1000)

static bool failed(const vb_chip_t *chip) { return chip->soc.clock->failure != VB_OK; }

/* Sleep. */

static void tell_watchdog(vb_chip_t *chip) {
    if (chip->has_watchdog) {
        vb_watchdog_idle(&chip->watchdog, chip->state.sleeping != 0);
    }
}

static void fall_asleep(vb_chip_t *chip) {
    if (!vb_exceptions_wakes(&chip->exceptions)) {
        chip->state.sleeping = 1;
        tell_watchdog(chip);
    }
}

static bool awake(vb_chip_t *chip) {
    if (vb_exceptions_wakes(&chip->exceptions)) {
        chip->state.sleeping = 0;
        tell_watchdog(chip);
    }
    return !chip->state.sleeping;
}

/* From event to event until one of them wants something. */
static void sleep_on(vb_chip_t *chip, int64_t tick, int (*stop)(void)) {
    vb_state_t *state = &chip->state;
    vb_clock_t *clock = chip->soc.clock;
    state->attention = 0;
    int64_t begun = clock->now;
    state->asleep_since = begun;
    while (clock->now < tick && !state->attention) {
        int64_t due = vb_clock_next_due(clock);
        if (!vb_clock_advance(clock, due < tick ? due : tick)) {
            return;
        }
        if (stop != NULL && stop()) {
            break;
        }
    }
    state->idle_ticks += clock->now - begun;
    state->asleep_since = VB_AWAKE;
}

/* Slices. */

static bool is_flash(uint32_t address) {
    return address < VB_BANK_BYTES || address - VB_FLASH_START < VB_FLASH_BYTES;
}

static bool bank_blocked(const vb_chip_t *chip, uint32_t address) {
    return is_flash(address) &&
           chip->state.blocked[address >= VB_FLASH_START + VB_BANK_BYTES ? 1 : 0];
}

static void stopped(vb_chip_t *chip, vb_stop_t stop) {
    vb_state_t *state = &chip->state;
    if (stop == VB_STOP_SLEEP) {
        fall_asleep(chip);
        return;
    }
    if (stop == VB_STOP_BREAKPOINT && chip->calls.served_breakpoint()) {
        state->pc += BREAKPOINT_BYTES;
        return;
    }
    if (stop == VB_STOP_UNDEFINED && state->ccr & VB_CCR_DIV_0_TRP && chip->calls.divided()) {
        return;
    }
    if (failed(chip)) {
        return;
    }
    if (stop == VB_STOP_PROTECTED_FETCH && bank_blocked(chip, (uint32_t)state->pc)) {
        vb_violation(chip->soc.clock,
                     "code runs from a flash bank that is busy or shows the unique id");
        return;
    }
    vb_exceptions_handle(&chip->exceptions, stop);
    if (state->exit_to_sleep && !failed(chip)) {
        state->exit_to_sleep = 0;
        fall_asleep(chip);
    }
}

/* With an interrupt pending that a mask holds back, single steps see the unmasking at once. Code
 * that masks for longer than MASKED_STEPS hangs: then slices see it soon enough. */
static int64_t budget(vb_state_t *state, int64_t instructions, bool masked) {
    state->masked_steps = masked ? state->masked_steps + 1 : 0;
    if (masked && state->masked_steps < MASKED_STEPS) {
        return 1;
    }
    if (masked && instructions > MASKED_SLICE) {
        return MASKED_SLICE;
    }
    return instructions > 1 ? instructions : 1;
}

static void run_slice(vb_chip_t *chip, int64_t tick, bool masked) {
    vb_state_t *state = &chip->state;
    vb_clock_t *clock = chip->soc.clock;
    int64_t start = clock->now;
    int64_t due = vb_clock_next_due(clock), end = start + LONGEST_SLICE_TICKS;
    end = tick < end ? tick : end;
    end = due < end ? due : end;
    int64_t cost = CYCLES_PER_INSTRUCTION * state->mck_ticks;
    state->cost = cost;
    state->slice_start = start;
    state->slice_end = end;
    state->attention = 0;
    vb_stop_t stop = vb_cpu_run(&chip->cpu, budget(state, (end - start + cost - 1) / cost, masked));
    state->instructions += state->executed;
    if (failed(chip)) {
        return;
    }
    int64_t reached = start + state->executed * cost;
    if (!vb_clock_advance(clock, reached > clock->now ? reached : clock->now)) {
        return;
    }
    if (stop != VB_STOP_COUNT && !state->off) {
        stopped(chip, stop);
    }
}

static void step(vb_chip_t *chip, int64_t tick, int (*stop)(void)) {
    vb_state_t *state = &chip->state;
    vb_clock_t *clock = chip->soc.clock;
    if (!vb_clock_advance(clock, clock->now) || state->off) {
        return;
    }
    if (state->deferred) {
        chip->calls.run_deferred();
    }
    if (state->reset_cause != VB_NO_RESET && !failed(chip)) {
        chip->calls.reset();
    }
    if (failed(chip)) {
        return;
    }
    if (state->sleeping && !awake(chip)) {
        sleep_on(chip, tick, stop);
        return;
    }
    bool masked = vb_exceptions_dispatch(&chip->exceptions);
    if (clock->now < tick && !failed(chip)) {
        run_slice(chip, tick, masked);
    }
}

vb_run_end_t vb_chip_run(vb_chip_t *chip, int64_t tick, int (*stop)(void)) {
    VB_CHECK(chip->engine.handle != NULL);
    chip->soc.clock->steady_at = 0; /* Python's code has run since */
    while (chip->soc.clock->now < tick && !chip->state.off) {
        if (stop != NULL && stop()) {
            return VB_RUN_STOPPED;
        }
        if (!failed(chip)) {
            step(chip, tick, stop);
        }
        if (failed(chip)) {
            return VB_RUN_FAILED;
        }
    }
    return VB_RUN_DONE;
}
