#include "chip.h"

#include "check.h"
#include <string.h>

uint64_t vb_chip_bytes(void) { return sizeof(vb_chip_t); }
uint64_t vb_state_bytes(void) { return sizeof(vb_state_t); }
uint64_t vb_clock_bytes(void) { return sizeof(vb_clock_t); }
uint64_t vb_line_bytes(void) { return sizeof(vb_line_t); }
uint64_t vb_calls_bytes(void) { return sizeof(vb_calls_t); }
uint64_t vb_engine_bytes(void) { return sizeof(vb_engine_t); }

/* What the models ask for. */

static vb_chip_t *chip_of(vb_soc_t *soc) {
    return (vb_chip_t *)((char *)soc - offsetof(vb_chip_t, soc));
}

static void set_irq(vb_soc_t *soc, int number, bool level) {
    vb_chip_t *chip = chip_of(soc);
    if (chip->calls.set_irq != NULL) {
        chip->calls.set_irq(number, level);
    } else {
        vb_exceptions_set_line(&chip->exceptions, number, level);
    }
}

static void request_reset(vb_soc_t *soc, int cause) {
    vb_chip_t *chip = chip_of(soc);
    if (chip->calls.request_reset != NULL) {
        chip->calls.request_reset(cause);
        return;
    }
    if (chip->state.reset_cause == VB_NO_RESET) {
        chip->state.reset_cause = cause;
    }
    chip->state.attention = 1;
}

void vb_chip_init(vb_chip_t *chip, vb_clock_t *clock, uint8_t *flash, uint8_t *ram,
                  const vb_calls_t *calls) {
    memset(chip, 0, sizeof *chip);
    chip->calls = *calls;
    chip->soc = (vb_soc_t){clock,
                           flash,
                           ram,
                           &chip->state.mck_ticks,
                           1,
                           set_irq,
                           request_reset,
                           calls->txd_given,
                           calls->pwm_period,
                           calls->pwm_changed};
    chip->cpu = (vb_cpu_t){.engine = &chip->engine, .state = &chip->state, .clock = clock};
    chip->exceptions = (vb_exceptions_t){&chip->state, &chip->cpu, &chip->soc, calls->restricts};
    chip->state.mck_ticks = chip->state.cost = 1;
    chip->state.reset_cause = VB_NO_RESET;
    chip->state.asleep_since = VB_AWAKE;
    chip->state.clocked = UINT64_MAX;
    chip->powered = true;
}

void vb_chip_connect(vb_chip_t *chip, const vb_engine_t *engine) {
    VB_CHECK(engine->handle != NULL && engine->emu_start != NULL);
    chip->engine = *engine;
}

void vb_chip_set_slow_hz(vb_chip_t *chip, int64_t hz) {
    VB_CHECK(hz > 0);
    chip->soc.slow_hz = hz;
}

static void add(vb_chip_t *chip, uint32_t base, uint32_t size, int pid, vb_kind_t kind,
                void *model) {
    VB_CHECK(chip->places_used < VB_PERIPHERALS);
    chip->places[chip->places_used++] = (vb_place_t){base, size, pid, kind, model};
}

vb_port_t *vb_chip_add_port(vb_chip_t *chip, const char *name, uint32_t base, int pid, int usart) {
    VB_CHECK(chip->ports_used < VB_PORTS);
    int index = chip->ports_used++;
    vb_port_init(&chip->ports[index], &chip->soc, name, index, pid, usart != 0);
    add(chip, base, 0x128, pid, VB_KIND_PORT, &chip->ports[index]);
    return &chip->ports[index];
}

vb_timer_t *vb_chip_add_timer(vb_chip_t *chip, const char *name, uint32_t base, int pid) {
    VB_CHECK(chip->timers_used < VB_TIMERS);
    vb_timer_t *timer = &chip->timers[chip->timers_used++];
    vb_timer_init(timer, &chip->soc, name, pid);
    add(chip, base, 0x40, pid, VB_KIND_TIMER, timer);
    return timer;
}

vb_pwm_t *vb_chip_add_pwm(vb_chip_t *chip, uint32_t base, int pid) {
    VB_CHECK(!chip->has_pwm);
    chip->has_pwm = true;
    vb_pwm_init(&chip->pwm, &chip->soc);
    add(chip, base, 0x300, pid, VB_KIND_PWM, &chip->pwm);
    return &chip->pwm;
}

vb_watchdog_t *vb_chip_add_watchdog(vb_chip_t *chip, uint32_t base) {
    VB_CHECK(!chip->has_watchdog);
    chip->has_watchdog = true;
    vb_watchdog_init(&chip->watchdog, &chip->soc);
    add(chip, base, 0x10, VB_ALWAYS_CLOCKED, VB_KIND_WATCHDOG, &chip->watchdog);
    return &chip->watchdog;
}

static void release(vb_clock_t *clock, int *slot) {
    vb_clock_release(clock, *slot);
    *slot = VB_NO_SLOT;
}

void vb_chip_drop(vb_chip_t *chip) {
    if (!chip->powered) {
        return;
    }
    chip->powered = false;
    vb_clock_t *clock = chip->soc.clock;
    for (int i = 0; i < chip->ports_used; i++) {
        release(clock, &chip->ports[i].slot);
    }
    for (int i = 0; i < chip->timers_used; i++) {
        release(clock, &chip->timers[i].slot);
    }
    for (int i = 0; chip->has_pwm && i < VB_PWM_CHANNELS; i++) {
        release(clock, &chip->pwm.channels[i].slot);
    }
    if (chip->has_watchdog) {
        release(clock, &chip->watchdog.slot);
    }
}

/* The bus. */

static const vb_place_t *find(const vb_chip_t *chip, uint32_t address) {
    for (int i = 0; i < chip->places_used; i++) {
        if (address - chip->places[i].base < chip->places[i].size) {
            return &chip->places[i];
        }
    }
    return NULL;
}

static vb_access_t read_model(const vb_place_t *place, uint32_t offset, uint32_t *value) {
    switch (place->kind) {
    case VB_KIND_PORT:
        return vb_port_read(place->model, offset, value);
    case VB_KIND_TIMER:
        return vb_timer_read(place->model, offset, value);
    case VB_KIND_PWM:
        return vb_pwm_read(place->model, offset, value);
    case VB_KIND_WATCHDOG:
        return vb_watchdog_read(place->model, offset, value);
    }
    return VB_UNKNOWN;
}

static vb_access_t write_model(const vb_place_t *place, uint32_t offset, uint32_t value) {
    switch (place->kind) {
    case VB_KIND_PORT:
        return vb_port_write(place->model, offset, value);
    case VB_KIND_TIMER:
        return vb_timer_write(place->model, offset, value);
    case VB_KIND_PWM:
        return vb_pwm_write(place->model, offset, value);
    case VB_KIND_WATCHDOG:
        return vb_watchdog_write(place->model, offset, value);
    }
    return VB_UNKNOWN;
}

int vb_place_read(vb_chip_t *chip, uint32_t address, uint32_t *value) {
    const vb_place_t *place = find(chip, address);
    VB_CHECK(place != NULL);
    return read_model(place, address - place->base, value);
}

int vb_place_write(vb_chip_t *chip, uint32_t address, uint32_t value) {
    const vb_place_t *place = find(chip, address);
    VB_CHECK(place != NULL);
    return write_model(place, address - place->base, value);
}

/* The model that takes this access of the processor. What no correct image does is Python's, which
 * finds words for it, and so is all while accesses are traced. */
static const vb_place_t *taker(const vb_chip_t *chip, uint32_t address, unsigned size) {
    const vb_place_t *place = size == 4 && !chip->state.tracing ? find(chip, address) : NULL;
    if (place == NULL || place->pid == VB_ALWAYS_CLOCKED) {
        return place;
    }
    return chip->state.clocked >> place->pid & 1 ? place : NULL;
}

/* The processor meets the bus. */

void vb_chip_catch_up(vb_chip_t *chip) {
    int64_t ran = vb_cpu_begun(&chip->cpu) * chip->state.cost;
    (void)vb_clock_advance(chip->soc.clock, chip->state.slice_start + ran);
}

static int64_t instructions_until(const vb_chip_t *chip, int64_t due) {
    int64_t cost = chip->state.cost, span = due - chip->state.slice_start;
    return span > 0 ? (span + cost - 1) / cost : 0;
}

/* The access may have made something due earlier than it was. */
static void adjust_slice(vb_chip_t *chip) {
    if (chip->state.attention) {
        vb_cpu_end_slice(&chip->cpu);
        return;
    }
    int64_t due = vb_clock_next_due(chip->soc.clock);
    if (due < chip->state.slice_end) {
        chip->state.slice_end = due;
        vb_cpu_shorten_slice(&chip->cpu, instructions_until(chip, due));
    }
}

/* After an access: a failure ends the run on this very instruction. */
static void accessed(vb_chip_t *chip, bool adjust) {
    if (chip->soc.clock->failure == VB_OK) {
        if (adjust) {
            adjust_slice(chip);
        }
    } else {
        vb_cpu_stop_if_failed(&chip->cpu);
    }
}

#define PERIPHERALS_START 0x40000000u
#define PPB_START 0xE0000000u

static uint32_t load(vb_chip_t *chip, uint32_t address, unsigned size) {
    const vb_clock_t *clock = chip->soc.clock;
    if (size == 4 && address == clock->steady_at) {
        return (uint32_t)clock->steady_value;
    }
    uint32_t value = 0;
    const vb_place_t *place = taker(chip, address, size);
    if (place == NULL || read_model(place, address - place->base, &value) == VB_UNKNOWN) {
        value = chip->calls.load(address, size);
    }
    return value;
}

uint64_t vb_chip_on_load(void *engine, uint64_t offset, unsigned size, void *user) {
    (void)engine;
    vb_chip_t *chip = user;
    uint32_t address = PERIPHERALS_START + (uint32_t)offset, value = 0;
    vb_chip_catch_up(chip);
    if (chip->soc.clock->failure == VB_OK) {
        value = load(chip, address, size);
    }
    accessed(chip, true);
    return value;
}

void vb_chip_on_store(void *engine, uint64_t offset, unsigned size, uint64_t value, void *user) {
    (void)engine;
    vb_chip_t *chip = user;
    uint32_t address = PERIPHERALS_START + (uint32_t)offset;
    vb_chip_catch_up(chip);
    if (chip->soc.clock->failure == VB_OK) {
        const vb_place_t *place = taker(chip, address, size);
        if (place == NULL ||
            write_model(place, address - place->base, (uint32_t)value) == VB_UNKNOWN) {
            chip->calls.store(address, size, (uint32_t)value);
        }
    }
    accessed(chip, true);
}

uint64_t vb_chip_on_system_load(void *engine, uint64_t offset, unsigned size, void *user) {
    (void)engine;
    vb_chip_t *chip = user;
    uint32_t value = 0;
    vb_chip_catch_up(chip);
    if (chip->soc.clock->failure == VB_OK) {
        value = chip->calls.load_system(PPB_START + (uint32_t)offset, size);
    }
    accessed(chip, false);
    return value;
}

void vb_chip_on_system_store(void *engine, uint64_t offset, unsigned size, uint64_t value,
                             void *user) {
    (void)engine;
    vb_chip_t *chip = user;
    vb_chip_catch_up(chip);
    if (chip->soc.clock->failure == VB_OK) {
        chip->calls.store_system(PPB_START + (uint32_t)offset, size, (uint32_t)value);
    }
    accessed(chip, true);
}

bool vb_chip_on_page(void *engine, uint64_t address, int kind, vb_page_t *page, void *user) {
    (void)engine;
    return vb_cpu_on_page(&((vb_chip_t *)user)->cpu, (uint32_t)address, kind, page);
}

void vb_chip_on_interrupt(void *engine, uint32_t number, void *user) {
    (void)engine;
    vb_cpu_on_interrupt(&((vb_chip_t *)user)->cpu, number);
}

bool vb_chip_on_invalid_instruction(void *engine, void *user) {
    (void)engine;
    vb_chip_t *chip = user;
    bool done = chip->calls.invalid_instruction() != 0;
    vb_cpu_stop_if_failed(&chip->cpu);
    return done;
}

bool vb_chip_on_invalid_memory(void *engine, int kind, uint64_t address, int size, int64_t value,
                               void *user) {
    (void)engine;
    vb_chip_t *chip = user;
    chip->state.address_of_fault = (uint32_t)address;
    bool stores = kind == chip->engine.mem_write_prot;
    if (!stores && kind != chip->engine.mem_read_prot) {
        return false;
    }
    uint32_t mask = size < 4 ? (1u << 8 * size) - 1 : UINT32_MAX;
    bool passes = chip->calls.protected_page((uint32_t)address, (uint32_t)size,
                                             (uint32_t)value & mask, stores) != 0;
    if (chip->soc.clock->failure != VB_OK) {
        vb_cpu_stop_if_failed(&chip->cpu);
        return false;
    }
    if (passes) {
        vb_cpu_go_on(&chip->cpu);
    }
    return passes;
}
