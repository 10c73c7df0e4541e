/*
 * The seam between the portable firmware and a board.
 *
 * Every board (hal/sam3x8e, hal/host, hal/mock) implements the functions declared in
 * hal/include/hal. They are bound at link time. The handle is opaque to the firmware and lets one
 * process hold several boards; a board with one set of hardware may ignore it.
 *
 * Unless a comment says otherwise a function is called from the main loop only, never blocks, and
 * returns within 10 us.
 */
#ifndef HAL_HAL_H
#define HAL_HAL_H

typedef struct hal hal_t;

#endif
