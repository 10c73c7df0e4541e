/*
 * What the LED shows while the fish swims: a code that tells a camera the time within the swim and
 * the number of the trial, so that a film and a trial's file can be put together.
 *
 * Blocks of 5 s, as long as the swim lasts. A block is 50 symbols of 0.1 s (5 frames of the 50 Hz
 * tick): 3 off, 3 on, then 16 bits in Manchester code (1 = on off, 0 = off on), highest bit first:
 *   15..8  number of the trial, modulo 256
 *    7..4  number of the block, modulo 16
 *    3..0  CRC-4 (x^4 + x + 1, initial value 0) of the other twelve, highest first
 * then on to the end of the block. Outside a swim the LED says whether the board is armed, so the
 * edge before the first block, on to off, is the begin of the swim.
 *
 * Pure. May be called from interrupts; some 200 cycles of a Cortex-M3.
 */
#ifndef BLINK_BLINK_H
#define BLINK_BLINK_H

#include <stdbool.h>
#include <stdint.h>

#define BLINK_SYMBOL_FRAMES 5u
#define BLINK_BLOCK_SYMBOLS 50u
#define BLINK_BLOCK_FRAMES (BLINK_SYMBOL_FRAMES * BLINK_BLOCK_SYMBOLS)

/* Whether the LED is on in frame |frame| (0 = first of the swim, 20 ms each) of |trial|. */
bool blink_on(uint32_t frame, uint32_t trial);

#endif
