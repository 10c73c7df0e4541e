/*
 * A mocked board for the unit tests: every seam function, with what was asked of it on record and
 * faults to order. Plain data: set and read the fields.
 */
#ifndef MOCK_MOCK_HAL_H
#define MOCK_MOCK_HAL_H

#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/guard.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"

#include <setjmp.h>
#include <stdbool.h>

/* Which flash the board has, chosen when a test is built. */
#define MOCK_FLASH_SAM3X 1   /* bank 1 of the SAM3X8E: programming erases, in pages */
#define MOCK_FLASH_NOR_4K 2  /* Winbond W25Q64JV, 8 MiB: sectors of 4 KiB */
#define MOCK_FLASH_NOR_64K 3 /* Winbond W25Q128JV, 16 MiB: blocks of 64 KiB */
#ifndef MOCK_FLASH
#define MOCK_FLASH MOCK_FLASH_SAM3X
#endif

#define MOCK_FLASH_PROGRAM_BYTES 256u
#if MOCK_FLASH == MOCK_FLASH_SAM3X
#define MOCK_FLASH_SIZE_BYTES (256u * 1024u)
#define MOCK_FLASH_ERASE_BYTES MOCK_FLASH_PROGRAM_BYTES
#elif MOCK_FLASH == MOCK_FLASH_NOR_4K
#define MOCK_FLASH_SIZE_BYTES (8u * 1024u * 1024u)
#define MOCK_FLASH_ERASE_BYTES 4096u
#else
#define MOCK_FLASH_SIZE_BYTES (16u * 1024u * 1024u)
#define MOCK_FLASH_ERASE_BYTES 65536u
#endif
#define MOCK_FLASH_ERASES_FIRST (MOCK_FLASH != MOCK_FLASH_SAM3X)

/* What is backed by memory: 256 blocks of a store (store/store.h) at most. */
#if MOCK_FLASH == MOCK_FLASH_NOR_4K
#define MOCK_FLASH_BYTES (256u * MOCK_FLASH_ERASE_BYTES)
#else
#define MOCK_FLASH_BYTES MOCK_FLASH_SIZE_BYTES
#endif
#define MOCK_FLASH_PAGES (MOCK_FLASH_BYTES / MOCK_FLASH_PROGRAM_BYTES)

/* Pieces of the flash whose changes are noted, to copy a large one fast. */
#define MOCK_PIECE_BYTES (MOCK_FLASH_BYTES / 256u)

#define MOCK_PORT_BYTES 65536u
#define MOCK_PULSES 8192u

/* A queue of bytes; |head| is the next to take, |tail| where the next goes. */
typedef struct {
    uint8_t bytes[MOCK_PORT_BYTES];
    size_t head, tail;
} mock_queue_t;

struct hal {
    uint64_t now_us;
    uint16_t pulse_ticks[HAL_SERVO_COUNT]; /* the last of each servo */
    uint16_t pulses[MOCK_PULSES];          /* of the tail */
    size_t pulse_count;
    mock_queue_t rx[HAL_PORT_COUNT]; /* filled by the test, read by the firmware */
    mock_queue_t tx[HAL_PORT_COUNT]; /* filled by the firmware */
    size_t tx_limit;                 /* write space reported at most; 0 = no limit */
    hal_serial_errors_t serial_errors[HAL_PORT_COUNT];
    hal_flash_geometry_t flash_geometry; /* size_bytes 0: that of MOCK_FLASH */
    uint8_t flash[MOCK_FLASH_BYTES];
    bool flash_changed[MOCK_FLASH_BYTES / MOCK_PIECE_BYTES]; /* since the last mock_flash_copy() */
    uint32_t flash_writes;                                   /* units programmed */
    uint32_t flash_erases;                                   /* of a chip that erases first */
    uint32_t flash_misuses; /* programs that would set bits; refused by a chip that erases first */
    uint32_t flash_fail_after; /* writes that succeed before all fail; 0 = never fail */
    /* A flash with a life of its own, as tests/unit/flash_model.h; NULL: none fails or wears. The
     * first writes a page, the second erases a unit, the third changes what was read. */
    bool (*flash_write)(hal_t *hal, uint32_t offset, const uint8_t *page);
    bool (*flash_erase)(hal_t *hal, uint32_t offset);
    void (*flash_read)(hal_t *hal, uint32_t offset, uint8_t *read, uint32_t length);
    void *flash_context;
    uint16_t battery_mv; /* at the pack; from 9900 on the reading is full scale */
    const char *board_name;
    hal_reset_cause_t reset_cause;
    bool clock_inexact;
    bool crashed;
    hal_crash_t crash; /* valid when |crashed| */
    uint32_t baud[HAL_PORT_COUNT];
    uint32_t baud_max; /* faster ones are refused; 0 = none */
    bool led;
    uint32_t watchdog_feeds;
    uint32_t resets;
    int irq_locked; /* must be 0 or 1 */
    uint64_t guarded[HAL_GUARDED_BYTES / 8u];
    uint64_t guarded_closed[HAL_GUARDED_BYTES / 8u]; /* as it was closed; else it aborts */
    bool guard_open;
    void (*on_unlock)(struct hal *hal); /* an interrupt that waited for it; NULL = none */
};

/* Flash all 0xFF, 8 V battery, time 0. */
void mock_hal_init(hal_t *hal);

/* Makes |to|'s flash what |from|'s is, if they were the same at the last copy, or |all| is copied;
 * clears what both note as changed. */
void mock_flash_copy(hal_t *to, hal_t *from, bool all);

/* The same from bytes that do not change. */
void mock_flash_load(hal_t *to, const uint8_t from[MOCK_FLASH_BYTES], bool all);

/* The name of the flash, for what a test prints. */
const char *mock_flash_name(void);

void mock_feed(hal_t *hal, hal_port_t port, const void *bytes, size_t length);

/* Takes up to |max| bytes the firmware has sent. */
size_t mock_take(hal_t *hal, hal_port_t port, void *out, size_t max);

/* What a reset does to the guarded memory. */
void mock_reset_guarded(hal_t *hal);

/* Runs |statement| and sets |panicked| to whether it ended in panic(). */
#define MOCK_EXPECT_PANIC(panicked, statement)                                                     \
    do {                                                                                           \
        mock_panic_armed = true;                                                                   \
        (panicked) = true;                                                                         \
        if (setjmp(mock_panic_jump) == 0) {                                                        \
            statement;                                                                             \
            (panicked) = false;                                                                    \
        }                                                                                          \
        mock_panic_armed = false;                                                                  \
    } while (0)

extern jmp_buf mock_panic_jump;
extern bool mock_panic_armed;
extern const char *mock_panic_where;

#endif
