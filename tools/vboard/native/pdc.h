/* Peripheral DMA of a port: a buffer and the next one for each direction; as vboard/periph/pdc.py.
 */
#ifndef VBOARD_PDC_H
#define VBOARD_PDC_H

#include "soc.h"

#define VB_PDC_FIRST 0x100u /* offset of the first register in its peripheral */

/* One direction. |ended|: the counter has reached 0 since it or the next one was written. */
typedef struct {
    const vb_soc_t *soc;
    const char *port;
    const char *name;
    uint32_t pointer, counter, next_pointer, next_counter;
    bool enabled, ended;
} vb_pdc_t;

/* Off and empty. Both flags are up then: nothing is left to transfer. */
void vb_pdc_reset(vb_pdc_t *pdc);

/* Bytes it will still move without the processor; 0 while off. */
int64_t vb_pdc_remaining(const vb_pdc_t *pdc);

/* RXBUFF or TXBUFE: both counters 0. */
bool vb_pdc_empty(const vb_pdc_t *pdc);

/* Stores received bytes, each XORed with |mask|; returns how many had room. May fail. */
int64_t vb_pdc_put(vb_pdc_t *pdc, const uint8_t *data, int64_t length, uint8_t mask);

/* Fetches a byte to send; vb_pdc_remaining() must not be 0. May fail. */
uint8_t vb_pdc_get(vb_pdc_t *pdc);

/* The registers; these may fail. */
void vb_pdc_set_pointer(vb_pdc_t *pdc, uint32_t value);
void vb_pdc_set_counter(vb_pdc_t *pdc, uint32_t value);
void vb_pdc_set_next_pointer(vb_pdc_t *pdc, uint32_t value);
void vb_pdc_set_next_counter(vb_pdc_t *pdc, uint32_t value);

#endif
