/* What the native peripherals ask of the chip around them. */
#ifndef VBOARD_SOC_H
#define VBOARD_SOC_H

#include "clock.h"
#include <stddef.h>

#define VB_FLASH_START 0x00080000u
#define VB_FLASH_BYTES 0x80000u
#define VB_BANK_BYTES 0x40000u
#define VB_RAM_START 0x20070000u
#define VB_RAM_BYTES 0x18000u
#define VB_MIRROR_START 0x20000000u
#define VB_MIRROR_BYTES 0x10000u

typedef struct vb_soc vb_soc_t;

struct vb_soc {
    vb_clock_t *clock;
    uint8_t *flash;
    uint8_t *ram;
    int64_t *mck_ticks; /* clock ticks per cycle of the master clock */
    int64_t slow_hz;
    void (*set_irq)(vb_soc_t *soc, int number, bool level);
    void (*request_reset)(vb_soc_t *soc, int cause);
    /* Python's, by index of the port and of the channel. */
    int (*txd_given)(int port);
    void (*pwm_period)(int channel, int64_t start, int64_t period, int64_t high);
    void (*pwm_changed)(void);
};

typedef enum { VB_DONE, VB_UNKNOWN } vb_access_t;

/* The bytes at |address|, all in one memory, or NULL; |writable|: only RAM. */
uint8_t *vb_soc_memory(const vb_soc_t *soc, uint32_t address, uint32_t length, bool writable);

/* Clock ticks of so many slow clocks, to the nearest. */
int64_t vb_soc_slow_ticks(const vb_soc_t *soc, int cycles);

/* Notes a violation and tells false when |value| has bits that are not in |allowed|. */
bool vb_only_bits(vb_clock_t *clock, const char *name, const char *reg, uint32_t value,
                  uint32_t allowed);

#endif
