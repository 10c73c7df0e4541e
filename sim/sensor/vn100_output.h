/* What a VN-100 sends of a sample: ASCII messages and binary frames. UM001, "Asynchronous output
 * messages", "Binary output messages". */
#ifndef SIM_VN100_OUTPUT_H
#define SIM_VN100_OUTPUT_H

#include "vn100_sense.h"
#include "vn100_settings.h"

/* The body for the newest sample, without '$' and check. */
void vn100_ascii(const vn100_settings_t *settings, uint32_t type, const vn100_sense_t *sense,
                 vn100_text_t *out);

/* A measurement that can be asked for as a register: appends ",value,..."; false when |id| is none.
 */
bool vn100_measured(unsigned id, const vn100_sense_t *sense, vn100_text_t *out);

/* Of the newest sample. Returns its length. */
size_t vn100_binary_frame(const vn100_binary_t *binary, const vn100_sense_t *sense,
                          uint8_t out[VN100_BINARY_MAX]);

/* The check of so many bytes. */
uint16_t vn100_check_of(vn100_check_t check, const void *bytes, size_t length);

/* '$', |body|, '*', check, CR, LF. Returns the length. */
size_t vn100_sealed(vn100_check_t check, const vn100_text_t *body, uint8_t out[VN100_MESSAGE_MAX]);

#endif
