#include "nor.h"

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

#define SECTOR_ERASE_LIMIT_US 1000000u
#define PAGE_PROGRAM_LIMIT_US 5000u

#define CLOCK_DIVIDER 1u /* SPI clock = APB0 / 4: 17.75 MHz */
#define PIECE_BYTES 256u
#define PASSES_MAX 10000u /* for one byte: 0.5 us */

static uint8_t exchange(uint8_t byte) {
    SPI0->TX_DATA = byte;
    uint32_t passes = PASSES_MAX;
    while ((SPI0->STATUS & SPI_STATUS_RX_EMPTY) != 0 && passes > 0) {
        passes--;
    }
    return (uint8_t)SPI0->RX_DATA;
}

/* The controller selects the flash for as many frames as it is told beforehand. */
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

static bool wait_ready(const hal_t *hal, uint32_t limit_us) {
    const uint64_t start_us = hal_time_us(hal);
    uint8_t status = STATUS_BUSY;
    do {
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

bool nor_read(hal_t *hal, uint32_t offset, uint8_t *out, uint32_t length) {
    uint32_t done = 0;
    while (hal->nor_there && done < length) {
        const uint32_t left = length - done;
        const uint32_t piece = left < PIECE_BYTES ? left : PIECE_BYTES;
        command(READ, 3, offset + done, NULL, out + done, piece);
        done += piece;
    }
    return hal->nor_there;
}

bool nor_erase(hal_t *hal, uint32_t offset) {
    command(WRITE_ENABLE, 0, 0, NULL, NULL, 0);
    command(SECTOR_ERASE, 3, offset, NULL, NULL, 0);
    return hal->nor_there && wait_ready(hal, SECTOR_ERASE_LIMIT_US);
}

bool nor_program(hal_t *hal, uint32_t offset, const uint8_t *page) {
    command(WRITE_ENABLE, 0, 0, NULL, NULL, 0);
    command(PAGE_PROGRAM, 3, offset, page, NULL, NOR_PAGE_BYTES);
    return hal->nor_there && wait_ready(hal, PAGE_PROGRAM_LIMIT_US);
}
