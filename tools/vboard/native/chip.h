/* One ATSAM3X8E: processor, interrupts, the bus and the peripherals that are accessed most; the
 * native half of vboard/chip.py. What is accessed rarely is in Python and is called.
 *
 * The caller owns a vb_chip_t of vb_chip_bytes() bytes, the clock, memories and engine, all of
 * which outlive it. Calls that may fail leave the reason in the clock.
 */
#ifndef VBOARD_CHIP_H
#define VBOARD_CHIP_H

#include "exceptions.h"
#include "port.h"
#include "pwm.h"
#include "timer.h"
#include "watchdog.h"

#define VB_PORTS 5
#define VB_TIMERS 3
#define VB_PERIPHERALS (VB_PORTS + VB_TIMERS + 2)
#define VB_ALWAYS_CLOCKED (-1)

typedef enum { VB_RUN_DONE, VB_RUN_STOPPED, VB_RUN_FAILED } vb_run_end_t;

typedef enum { VB_KIND_PORT, VB_KIND_TIMER, VB_KIND_PWM, VB_KIND_WATCHDOG } vb_kind_t;

/* Python's part; mirrored in vboard/native/library.py. None of them raises: a failure is left in
 * the clock. */
typedef struct {
    uint32_t (*load)(uint32_t address, uint32_t width);
    void (*store)(uint32_t address, uint32_t width, uint32_t value);
    uint32_t (*load_system)(uint32_t address, uint32_t width);
    void (*store_system)(uint32_t address, uint32_t width, uint32_t value);
    /* A page that is restricted is accessed; 0: a fault. A load has |stores| 0. */
    int (*protected_page)(uint32_t address, uint32_t width, uint32_t value, int stores);
    int (*invalid_instruction)(void); /* not 0: carried out */
    int (*served_breakpoint)(void);
    int (*divided)(void);
    int (*restricts)(uint32_t address);
    void (*run_deferred)(void); /* all that waits for the end of a slice */
    void (*reset)(void);
    void (*set_irq)(int number, int level); /* NULL: there is a processor */
    void (*request_reset)(int cause);       /* likewise */
    int (*txd_given)(int port);
    void (*pwm_period)(int channel, int64_t start, int64_t period, int64_t high);
    void (*pwm_changed)(void);
} vb_calls_t;

typedef struct {
    uint32_t base, size;
    int32_t pid; /* or VB_ALWAYS_CLOCKED */
    vb_kind_t kind;
    void *model;
} vb_place_t;

typedef struct {
    vb_state_t state; /* first: Python knows where it is */
    vb_soc_t soc;
    vb_calls_t calls;
    vb_engine_t engine;
    vb_cpu_t cpu;
    vb_exceptions_t exceptions;
    bool powered;
    int places_used, ports_used, timers_used;
    bool has_watchdog, has_pwm;
    vb_place_t places[VB_PERIPHERALS];
    vb_port_t ports[VB_PORTS];
    vb_timer_t timers[VB_TIMERS];
    vb_pwm_t pwm;
    vb_watchdog_t watchdog;
} vb_chip_t;

/* Sizes, by which Python checks what it mirrors. */
uint64_t vb_chip_bytes(void);
uint64_t vb_state_bytes(void);
uint64_t vb_clock_bytes(void);
uint64_t vb_line_bytes(void);
uint64_t vb_calls_bytes(void);
uint64_t vb_engine_bytes(void);

/* |flash| and |ram|: 512 and 96 KB. */
void vb_chip_init(vb_chip_t *chip, vb_clock_t *clock, uint8_t *flash, uint8_t *ram,
                  const vb_calls_t *calls);

/* The processor, without which vb_chip_run() must not be called. */
void vb_chip_connect(vb_chip_t *chip, const vb_engine_t *engine);

/* The frequency of the 32 kHz clock, from now on. */
void vb_chip_set_slow_hz(vb_chip_t *chip, int64_t hz);

/* Puts a model at its place on the bus; |pid| also is its interrupt. Returns it. */
vb_port_t *vb_chip_add_port(vb_chip_t *chip, const char *name, uint32_t base, int pid, int usart);
vb_timer_t *vb_chip_add_timer(vb_chip_t *chip, const char *name, uint32_t base, int pid);
vb_pwm_t *vb_chip_add_pwm(vb_chip_t *chip, uint32_t base, int pid);
vb_watchdog_t *vb_chip_add_watchdog(vb_chip_t *chip, uint32_t base);

/* The power is gone: nothing happens any more. */
void vb_chip_drop(vb_chip_t *chip);

/* Runs until the clock reaches |tick| or |stop|, if not NULL, is not 0; |stop| is asked after each
 * millisecond at the latest and whenever something happened. Ends early when the power goes. */
vb_run_end_t vb_chip_run(vb_chip_t *chip, int64_t tick, int (*stop)(void));

/* In a run: brings the clock to the instruction that accesses something. May fail. */
void vb_chip_catch_up(vb_chip_t *chip);

/* A register of a native model by itself. */
int vb_place_read(vb_chip_t *chip, uint32_t address, uint32_t *value);
int vb_place_write(vb_chip_t *chip, uint32_t address, uint32_t value);

/* Unicorn's callbacks, |user|: the chip. */
uint64_t vb_chip_on_load(void *engine, uint64_t offset, unsigned size, void *user);
void vb_chip_on_store(void *engine, uint64_t offset, unsigned size, uint64_t value, void *user);
uint64_t vb_chip_on_system_load(void *engine, uint64_t offset, unsigned size, void *user);
void vb_chip_on_system_store(void *engine, uint64_t offset, unsigned size, uint64_t value,
                             void *user);
bool vb_chip_on_page(void *engine, uint64_t address, int kind, vb_page_t *page, void *user);
void vb_chip_on_interrupt(void *engine, uint32_t number, void *user);
bool vb_chip_on_invalid_instruction(void *engine, void *user);
bool vb_chip_on_invalid_memory(void *engine, int kind, uint64_t address, int size, int64_t value,
                               void *user);

#endif
