/*
 * The storage flash: bank 1, with a controller of its own (EFC1). The code runs from bank 0, so
 * that interrupts and all go on while a page is written; only nobody may read bank 1 meanwhile.
 *
 * A page takes about 5 ms. The main loop sleeps through them: the controller's interrupt wakes it.
 * That interrupt is asked for as long as FRDY is up, before the command too. So the core lets it
 * through only for a sleep, and the handler shuts it out again.
 */
#include "board.h"
#include "registers/eefc.h"

#include <string.h>

#define BANK_ADDRESS 0x000C0000u
#define PAGE_WORDS (STORAGE_PAGE_BYTES / 4u)
#define LOCK_REGIONS 16u
#define LOCK_REGION_PAGES 64u

/* While a page is filled and written, whatever the clock (errata). */
#define WRITE_WAIT_STATES 6u

#define COMMAND_ERRORS (EFC_FSR_FCMDE | EFC_FSR_FLOCKE)

static const uint8_t *bank(uint32_t offset) {
    return (const uint8_t *)(uintptr_t)(BANK_ADDRESS + offset);
}

void storage_flash_isr(void) { interrupt_disable(ID_EFC1); }

/* Status of the controller; when it is busy, after an interrupt, its own or another. The request
 * that comes between the look and the WFI ends the WFI, as interrupts are off. A request from
 * before the command that is still on its way ends it too early; the next look sends it to sleep
 * again. Before the tick runs nothing would wake it from a controller that hangs: then no sleep. */
static uint32_t status_or_sleep(const hal_t *hal) {
    cpu_interrupts_off();
    const uint32_t status = EFC1->FSR;
    if ((status & EFC_FSR_FRDY) == 0 && hal->ticks != 0) {
        interrupt_enable(ID_EFC1, PRIORITY_DMA);
        cpu_wait_for_interrupt();
    }
    cpu_interrupts_on();
    return status;
}

static bool ready(void) { return (EFC1->FSR & EFC_FSR_FRDY) != 0; }

/* Reading the status clears its error bits, so they are gathered. The tick ends each sleep after
 * 20 ms at the latest. */
static bool command(const hal_t *hal, uint32_t code, uint32_t argument) {
    const uint64_t start_us = hal_time_us(hal);
    uint32_t status = 0;
    EFC1->FCR = EFC_FCR_FKEY_PASSWD | FIELD(EFC_FCR_FARG, argument) | code;
    do {
        status |= status_or_sleep(hal);
    } while ((status & EFC_FSR_FRDY) == 0 && hal_time_us(hal) - start_us < STORAGE_LIMIT_US);
    interrupt_disable(ID_EFC1);
    return (status & (EFC_FSR_FRDY | COMMAND_ERRORS)) == EFC_FSR_FRDY;
}

/* Returns the mode to go back to. */
static uint32_t begin_commands(void) {
    const uint32_t mode = EFC1->FMR;
    EFC1->FMR = (mode & ~EFC_FMR_FWS) | FIELD(EFC_FMR_FWS, WRITE_WAIT_STATES) | EFC_FMR_FRDY;
    return mode;
}

static void end_commands(uint32_t mode) { EFC1->FMR = mode; }

/* A programmer may have locked regions; nothing here does. */
void storage_flash_init(hal_t *hal) {
    const uint32_t mode = begin_commands();
    const uint32_t locked = command(hal, EFC_FCR_FCMD_GLB, 0) ? EFC1->FRR : 0;
    for (uint32_t region = 0; region < LOCK_REGIONS; region++) {
        if ((locked & 1u << region) != 0) {
            (void)command(hal, EFC_FCR_FCMD_CLB, region * LOCK_REGION_PAGES);
        }
    }
    end_commands(mode);
}

bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    (void)hal;
    if (offset > STORAGE_BYTES || length > STORAGE_BYTES - offset || !ready()) {
        return false;
    }
    memcpy(out, bank(offset), length);
    return true;
}

static bool holds(uint32_t offset, const void *page) {
    return memcmp(bank(offset), page, STORAGE_PAGE_BYTES) == 0;
}

/* The page buffer takes whole words only, in order. |page| may lie anywhere. */
static void fill_page_buffer(uint32_t offset, const void *page) {
    volatile uint32_t *to = (volatile uint32_t *)(uintptr_t)(BANK_ADDRESS + offset);
    const uint8_t *from = page;
    for (uint32_t i = 0; i < PAGE_WORDS; i++) {
        uint32_t word;
        memcpy(&word, from + i * sizeof word, sizeof word);
        to[i] = word;
    }
    cpu_barrier();
}

static bool write_page(hal_t *hal, uint32_t offset, const void *page) {
    const uint32_t mode = begin_commands();
    fill_page_buffer(offset, page);
    const bool done = command(hal, EFC_FCR_FCMD_EWP, offset / STORAGE_PAGE_BYTES);
    end_commands(mode);
    return done;
}

bool hal_flash_erase(hal_t *hal, uint32_t offset) {
    (void)hal;
    return offset % STORAGE_PAGE_BYTES == 0 && offset < STORAGE_BYTES;
}

bool hal_flash_program(hal_t *hal, uint32_t offset, const void *bytes) {
    if (offset % STORAGE_PAGE_BYTES != 0 || offset >= STORAGE_BYTES || !ready()) {
        return false;
    }
    return supply_good() && write_page(hal, offset, bytes) && holds(offset, bytes);
}
