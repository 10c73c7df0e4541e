/* The messages that the board reads; only their checksums are in the image. */
#ifndef LINK_INBOUND_H
#define LINK_INBOUND_H

#include "link/mavlink.h"

/* NULL when the board does not use message |id|. */
const message_form_t *inbound_form(uint32_t id);

#endif
