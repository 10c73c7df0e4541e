/*
 * The chip's clocks: 84 MHz from the board's 12 MHz crystal, and what to do without it.
 * Source: ATSAM3X8E datasheet, "Power Management Controller".
 */
#ifndef SAM3X8E_CLOCK_TREE_H
#define SAM3X8E_CLOCK_TREE_H

#include <stdbool.h>
#include <stdint.h>

/* |mck_hz| is 84 MHz, or 12 MHz when the PLL does not lock: a whole number of MHz in any case. Not
 * |exact|: it comes from the RC oscillator, a few percent off, or is 12 MHz; no servo pulses then.
 */
typedef struct {
    uint32_t mck_hz;
    bool exact;
} clock_tree_t;

/* Brings the chip from its reset clock to full speed. Called once, before RAM is set up: uses no
 * variables. Takes 20 ms, with a dead crystal 0.3 s: every wait is bounded. */
clock_tree_t clock_tree_init(void);

/* Gives peripheral |id| (registers/peripherals.h) its clock. Before that, writes to it are lost. */
void clock_enable(uint32_t id);

#endif
