/*
 * littlefs' settings. Its assertions end where ours do. They are 61, and all name the same place:
 * a text for each, and a jump of its own, would take 0.9 KB of flash. The crash record's return
 * address tells the function. Its CRC-32 is ours: same polynomial, same start, no inversion.
 */
#ifndef STORE_LFS_DEFINES_H
#define STORE_LFS_DEFINES_H

#include "base/crc.h"
#include "base/panic.h"

#define LFS_ASSERT(condition) ((condition) ? (void)0 : panic("lfs.c"))
#define LFS_CRC(crc, buffer, size) crc32_update(crc, buffer, size)

#endif
