/* TAILBEAT_AMPLITUDES: a piece of the learned input, beat by beat. */
#ifndef LINK_AMPLITUDES_H
#define LINK_AMPLITUDES_H

#include "ilc/memory.h"
#include "link/channel.h"

/* |set| is a TAILBEAT_AMPLITUDE_SET; the piece begins at beat |first|. */
void amplitudes_send(const memory_t *memory, channel_t *channel, uint8_t set, uint16_t first);

#endif
