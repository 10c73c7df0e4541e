/* The storage: the SPI NOR flash on SPI0, a Spansion S25FL128S. */
#include "board.h"

#include <string.h>

#define READ_IDENTIFICATION 0x9Fu
#define READ_STATUS 0x05u
#define WRITE_ENABLE 0x06u
#define READ 0x03u
#define PAGE_PROGRAM 0x02u
#define SECTOR_ERASE 0xD8u

#define STATUS_BUSY 0x01u
#define IDENTIFICATION 0x012018u /* Spansion, 128 Mbit */

/* Sizes and times of the data sheet, for sectors of 64 KiB. */
#define SECTOR_BYTES (64u * 1024u)
#define PAGE_BYTES 256u
#define SECTOR_ERASE_TYPICAL_US 130000u
#define SECTOR_ERASE_MAX_US 650000u
#define PAGE_PROGRAM_MAX_US 750u

static const hal_flash_geometry_t geometry = {
    .size_bytes = 16u * 1024u * 1024u,
    .erase_bytes = SECTOR_BYTES,
    .program_bytes = PAGE_BYTES,
    .erase_typical_us = SECTOR_ERASE_TYPICAL_US,
    .erase_max_us = SECTOR_ERASE_MAX_US,
    .program_max_us = PAGE_PROGRAM_MAX_US,
};

#define CLOCK_DIVIDER 1u  /* SPI clock = APB0 / 4: 17.75 MHz */
#define PASSES_MAX 10000u /* for one byte: 0.5 us */

static uint8_t exchange(uint8_t byte) {
    SPI0->TX_DATA = byte;
    uint32_t passes = PASSES_MAX;
    while ((SPI0->STATUS & SPI_STATUS_RX_EMPTY) != 0 && passes > 0) {
        passes--;
    }
    return (uint8_t)SPI0->RX_DATA;
}

/* The controller selects the flash for the number of frames that is set beforehand. */
static void begin(uint32_t frames) {
    SPI0->CONTROL = SPI_CONTROL_MASTER | SPI_CONTROL_SPS | SPI_CONTROL_BIGFIFO |
                    FIELD(SPI_CONTROL_FRAMES, frames) | SPI_CONTROL_ENABLE;
}

/* A command with |address_bytes| of |offset|, and |length| bytes to or from the flash: |out| and
 * |in| may be NULL. */
static void command(uint8_t code, uint32_t address_bytes, uint32_t offset, const uint8_t *out,
                    uint8_t *in, uint32_t length) {
    begin(1u + address_bytes + length);
    (void)exchange(code);
    for (uint32_t i = address_bytes; i > 0; i--) {
        (void)exchange((uint8_t)(offset >> (8u * (i - 1u))));
    }
    for (uint32_t i = 0; i < length; i++) {
        const uint8_t came = exchange(out != NULL ? out[i] : 0);
        if (in != NULL) {
            in[i] = came;
        }
    }
}

static bool wait_ready(hal_t *hal, uint32_t limit_us) {
    const uint64_t start_us = hal_time_us(hal);
    uint8_t status = STATUS_BUSY;
    do {
        hal_watchdog_feed(hal);
        command(READ_STATUS, 0, 0, NULL, &status, 1);
    } while ((status & STATUS_BUSY) != 0 && hal_time_us(hal) - start_us < limit_us);
    return (status & STATUS_BUSY) == 0;
}

void nor_init(hal_t *hal) {
    SPI0->CONTROL = SPI_CONTROL_MASTER;
    SPI0->DFSIZE = 8u;
    SPI0->CLK_GEN = CLOCK_DIVIDER;
    SPI0->SLAVE_SELECT = 1u;
    uint8_t id[3] = {0};
    command(READ_IDENTIFICATION, 0, 0, NULL, id, sizeof id);
    hal->nor_there = ((uint32_t)id[0] << 16 | (uint32_t)id[1] << 8 | id[2]) == IDENTIFICATION;
}

const hal_flash_geometry_t *hal_flash_geometry(const hal_t *hal) {
    (void)hal;
    return &geometry;
}

bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    if (!hal->nor_there || offset > geometry.size_bytes || length > geometry.size_bytes - offset) {
        return false;
    }
    uint8_t *to = out;
    for (uint32_t done = 0; done < length; done += PAGE_BYTES) {
        const uint32_t left = length - done;
        command(READ, 3, offset + done, NULL, to + done, left < PAGE_BYTES ? left : PAGE_BYTES);
    }
    return true;
}

static bool reads_as(hal_t *hal, uint32_t offset, const uint8_t *page) {
    uint8_t read[PAGE_BYTES];
    return hal_flash_read(hal, offset, read, sizeof read) && memcmp(read, page, sizeof read) == 0;
}

static bool reads_erased(hal_t *hal, uint32_t offset) {
    uint8_t erased[PAGE_BYTES];
    memset(erased, 0xFF, sizeof erased);
    bool good = true;
    for (uint32_t at = 0; at < SECTOR_BYTES; at += PAGE_BYTES) {
        good = good && reads_as(hal, offset + at, erased);
    }
    return good;
}

static bool unit_fits(const hal_t *hal, uint32_t offset, uint32_t unit_bytes) {
    return hal->nor_there && offset % unit_bytes == 0 && offset < geometry.size_bytes;
}

bool hal_flash_erase(hal_t *hal, uint32_t offset) {
    if (!unit_fits(hal, offset, SECTOR_BYTES)) {
        return false;
    }
    command(WRITE_ENABLE, 0, 0, NULL, NULL, 0);
    command(SECTOR_ERASE, 3, offset, NULL, NULL, 0);
    return wait_ready(hal, 2u * SECTOR_ERASE_MAX_US) && reads_erased(hal, offset);
}

bool hal_flash_program(hal_t *hal, uint32_t offset, const void *bytes) {
    if (!unit_fits(hal, offset, PAGE_BYTES)) {
        return false;
    }
    command(WRITE_ENABLE, 0, 0, NULL, NULL, 0);
    command(PAGE_PROGRAM, 3, offset, bytes, NULL, PAGE_BYTES);
    return wait_ready(hal, 4u * PAGE_PROGRAM_MAX_US) && reads_as(hal, offset, bytes);
}
