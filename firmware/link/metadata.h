/*
 * Files that describe the board for ground stations. They are part of the image, made from
 * params.def by wire/param_metadata.py, and served over MAVLink FTP beside the files of the store.
 * Constant; of no cost until one is read.
 */
#ifndef LINK_METADATA_H
#define LINK_METADATA_H

#include <stdint.h>

#define LINK_METADATA_FILES 2u

typedef struct {
    const char *path;
    const uint8_t *bytes;
    uint32_t size;
} link_file_bytes_t;

/* [0]: the general metadata, which names the other; [1]: names, units, ranges, defaults and texts
 * of all parameters, xz. */
extern const link_file_bytes_t link_metadata[LINK_METADATA_FILES];

/* Of the first one, as MAVLink FTP computes it. */
extern const uint32_t link_metadata_crc;

#endif
