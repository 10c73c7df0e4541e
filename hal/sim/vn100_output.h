/* What a VN-100 sends of a sample: ASCII messages and binary frames. UM001, "Asynchronous output
 * messages", "Binary output messages". */
#ifndef SIM_VN100_OUTPUT_H
#define SIM_VN100_OUTPUT_H

#include "vn100_sense.h"
#include "vn100_settings.h"

/* Register 6. */
bool vn100_ascii_known(uint32_t type);
/* Length of such a message with all that register 30 adds; 0 for none. */
size_t vn100_ascii_bytes(const vn100_settings_t *settings, uint32_t type);
/* The body for the newest sample, without '$' and check. */
void vn100_ascii(const vn100_settings_t *settings, uint32_t type, const vn100_sense_t *sense,
                 vn100_text_t *out);

/* A measurement that can be asked for as a register: appends ",value,..."; false when |id| is none.
 */
bool vn100_measured(unsigned id, const vn100_sense_t *sense, vn100_text_t *out);

/* Length of the frame; 0 when the sensor has no such group or field. */
size_t vn100_binary_bytes(const vn100_binary_t *binary, unsigned firmware);
/* Of the newest sample. Returns its length. */
size_t vn100_binary_frame(const vn100_binary_t *binary, const vn100_sense_t *sense,
                          uint8_t out[VN100_BINARY_MAX]);

/* 8 or 16 bits, as register 30 asks. */
typedef enum { VN100_CHECK8 = 1, VN100_CHECK16 = 3 } vn100_check_t;
vn100_check_t vn100_check(const vn100_settings_t *settings);
uint16_t vn100_check_of(vn100_check_t check, const void *bytes, size_t length);

/* '$', |body|, '*', check, CR, LF. Returns the length. */
size_t vn100_sealed(vn100_check_t check, const vn100_text_t *body, uint8_t out[VN100_MESSAGE_MAX]);

#endif
